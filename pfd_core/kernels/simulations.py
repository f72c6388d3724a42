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
from dataclasses import dataclass
from typing import Any

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
    robot: Robot, step_program: Program, *, scene: Scene, method: str, dtype: str, refine: int
) -> Rollout:
    """Compile the simulation of a robot by an integrator's step; errors as compile_kernel."""
    source, method = _source(robot, scene, method, dtype, refine)

    def text() -> str:
        return rollout_module(step_program, source.program, dtype, turned_joints(robot))

    native = source.compile(f'rollout {step_program}', text)
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
    robot: Robot, step_program: Program, *, scene: Scene, method: str, dtype: str, refine: int
) -> NativeEnsemble:
    """Compile many simulations of a robot by an integrator's step; errors as compile_kernel."""
    source, method = _source(robot, scene, method, dtype, refine)
    width = simd_width(dtype)

    def text() -> str:
        return ensemble_module(step_program, source.program, dtype, width, turned_joints(robot))

    native = source.compile(f'ensemble {width} {step_program}', text)
    kinds = [ctypes.c_void_p if kind.startswith('ptr') else ctypes.c_int64 for kind in PARAMETERS]
    run = ctypes.CFUNCTYPE(None, *kinds)(native.address('ensemble'))
    return NativeEnsemble(method, width, source.work, run, native)


def _source(
    robot: Robot, scene: Scene, method: str, dtype: str, refine: int
) -> tuple[KernelSource, str]:
    """Return the source of the dynamics, and the method that 'auto' stands for."""
    plant, _ = plant_of(robot, scene, dtype)
    method = choose(plant, method, refine)
    return forward(plant, method, refine, dtype), method
