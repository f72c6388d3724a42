# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations in native code: an integrator's step around @evaluate, over all steps of a rollout.

    compile_rollout      one arm                    (pfd_core.kernels.codegen.rollout)
    compile_ensemble     one arm per SIMD lane      (pfd_core.kernels.codegen.arms)
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pfd_core.algorithms.chain.joint_torques import without_joint_torques
from pfd_core.kernels.auto import choose
from pfd_core.kernels.codegen.arms import PARAMETERS
from pfd_core.kernels.codegen.module import ensemble_module, rollout_module
from pfd_core.kernels.codegen.step import STATE
from pfd_core.kernels.runtime.jit import Native, simd_width
from pfd_core.kernels.source import KernelSource, forward, plant_of, turned_joints
from pfd_core.machine.program import Program
from pfd_core.model import Robot, Scene


@dataclass(frozen=True)
class Rollout:
    """The simulation of one arm in native code; pointers are given as addresses."""

    method: str  # the method it was recorded from
    work: int  # operations of one call of @step
    run: Callable[..., int]  # @rollout (pfd_core.kernels.codegen.rollout)
    accelerations: Callable[..., None]  # @accelerations
    native: Native  # owner of the code


@dataclass(frozen=True)
class NativeEnsemble:
    """The simulation of many arms in native code; pointers are given as addresses."""

    method: str  # the method it was recorded from
    width: int  # arms in a vector register
    work: int  # operations of one evaluation of the accelerations
    run: Callable[..., None]  # @ensemble (pfd_core.kernels.codegen.arms)
    native: Native  # owner of the code


def compile_rollout(
    robot: Robot,
    step_program: Program,
    *,
    scene: Scene,
    method: str,
    dtype: str,
    refine: int,
    implicit: float = 0.0,
) -> Rollout:
    """
    Compile the simulation of a robot by an integrator's step; errors as compile_kernel.

    `implicit` is the time [s] by which the damping of the plant that the step solves with is
    multiplied; 0 for a step that calls the accelerations alone.
    """
    source, others, method = _sources(robot, scene, method, dtype, refine, implicit)

    def text() -> str:
        programs = {name: other.program for name, other in others.items()}
        return rollout_module(step_program, source.program, dtype, turned_joints(robot), programs)

    native = source.compile(f'rollout{_implicit_key(implicit)} {step_program}', text)
    integer = ctypes.c_int64
    inputs: list[Any] = [ctypes.c_void_p] * len(source.inputs)
    run = ctypes.CFUNCTYPE(integer, integer, integer, *inputs, *inputs[: len(STATE)])
    accelerate = ctypes.CFUNCTYPE(None, integer, *inputs, ctypes.c_void_p)
    calls = sum(instruction.op == 'call' for instruction in step_program.instructions)
    return Rollout(
        method,
        source.work * calls,
        run(native.address('rollout')),
        accelerate(native.address('accelerations')),
        native,
    )


def compile_ensemble(
    robot: Robot,
    step_program: Program,
    *,
    scene: Scene,
    method: str,
    dtype: str,
    refine: int,
    implicit: float = 0.0,
) -> NativeEnsemble:
    """Compile many simulations of a robot by an integrator's step; as compile_rollout."""
    source, others, method = _sources(robot, scene, method, dtype, refine, implicit)
    width = simd_width(dtype)

    def text() -> str:
        programs = {name: other.program for name, other in others.items()}
        return ensemble_module(
            step_program, source.program, dtype, width, turned_joints(robot), programs
        )

    native = source.compile(f'ensemble {width}{_implicit_key(implicit)} {step_program}', text)
    kinds = [ctypes.c_void_p if kind.startswith('ptr') else ctypes.c_int64 for kind in PARAMETERS]
    run = ctypes.CFUNCTYPE(None, *kinds)(native.address('ensemble'))
    return NativeEnsemble(method, width, source.work, run, native)


def _sources(
    robot: Robot, scene: Scene, method: str, dtype: str, refine: int, implicit: float
) -> tuple[KernelSource, dict[str, KernelSource], str]:
    """
    Return the source of the dynamics, those of other functions, and what 'auto' stands for.

    With `implicit` = c and a damping D in the scene these are `undamped`, the accelerations
    without damping, and `solve`, those of a torque at rest, without gravity and wrench, with
    rotors that are heavier by c D: (H + c D)^-1 tau.
    """
    plant, _ = plant_of(robot, scene, dtype)
    method = choose(plant, method, refine)
    others: dict[str, KernelSource] = {}
    if implicit and plant.damping is not None:
        undamped = replace(plant, damping=None)
        heavier = implicit * plant.damping
        armature = heavier if plant.armature is None else plant.armature + heavier
        solved = replace(
            without_joint_torques(plant),
            gravity=np.zeros(3),
            armature=armature,
            external_wrench=False,
        )
        others = {
            'undamped': forward(undamped, method, refine, dtype),
            'solve': forward(solved, method, refine, dtype),
        }
    return forward(plant, method, refine, dtype), others, method


def _implicit_key(implicit: float) -> str:
    return f' implicit {implicit.hex()}' if implicit else ''
