# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearised steps: A and B of a step of a simulation, as a kernel of q, qd and tau.

    compile_linear_step    A and B
    compile_in_motion      the accelerations of joints that are in motion or held

The derivatives of the accelerations are those of pfd_core.algorithms.acceleration_derivatives, at
each stage of the integrator; native code multiplies them up (codegen.linear_step).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter

from pfd_core.kernels.auto import choose
from pfd_core.kernels.codegen.linear_step import called, carried_rows, state_rows
from pfd_core.kernels.codegen.module import linear_module
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.runtime.jit import Optimisation
from pfd_core.kernels.simulations import plants
from pfd_core.kernels.source import (
    KernelSource,
    ProductSource,
    derivatives,
    forward,
    plant_of,
)
from pfd_core.kernels.stack import check_stack
from pfd_core.machine.program import Program
from pfd_core.model import Robot, Scene, in_motion, without_step_effects


class LinearSource(KernelSource):
    """The source of a linearised step, made of the sources of the functions that it calls."""

    def __init__(self, step: Program, substeps: int, sources: Mapping[str, ProductSource]) -> None:
        self._step, self._substeps, self._sources = step, substeps, sources
        self.key = ('linear step', str(step), str(substeps))
        for source in sources.values():
            self.key += source.key
        n, rows = step.lanes, state_rows(step)
        self.inputs = {
            name: size for source in sources.values() for name, size in source.inputs.items()
        }
        self.shape = (n * len(rows), n * (len(rows) + 1) + 1)
        (self.operations, *_) = (source.operations for source in sources.values())

    @property
    def work(self) -> int:
        """The operations of the derivatives in all substeps."""
        calls = [i.data for i in self._step.instructions if i.op == 'call']
        return self._substeps * sum(self._sources[name].work for name in calls)

    @property
    def optimisation(self) -> Optimisation:
        """That of the longest function."""
        return max(self._sources.values(), key=attrgetter('work')).optimisation

    def module(self, dtype: str, width: int, angles: Sequence[int]) -> str:
        """Return the LLVM text of the kernel."""
        programs = {name: source.factors for name, source in self._sources.items()}
        return linear_module(self._step, programs, self._substeps, dtype, width, angles)


def compile_linear_step(
    robot: Robot,
    step: Program,
    substeps: int,
    *,
    scene: Scene,
    method: str,
    dtype: str,
    refine: int,
    implicit: float,
    dry: bool,
) -> Kernel:
    """
    Compile the linearisation of some steps of an integrator, a kernel of q, qd and tau.

    Its result, (r n, (r + 1) n + 1), is the derivative of the r rows of the state at the end by
    those at the beginning and by the torque, and last the state at the end. `implicit` is as for
    compile_rollout, errors as for compile_kernel. With `dry`, for scenes with dry friction or
    stops, joints stay in motion or are held by brakes. Positions must be plain sums in `step`: the
    digits that these lose have no derivative.
    """
    check_stack(f'a linearised step of {robot.n} joints', _matrices(step))
    plant, _ = plant_of(robot, scene, dtype)
    plant = in_motion(plant) if dry else without_step_effects(plant)
    method = choose(plant, method, refine)
    functions = dict(plants(plant, implicit))
    sources = {name: derivatives(functions[name], method, refine, dtype) for name in called(step)}
    recreate = partial(
        compile_linear_step,
        robot,
        step,
        substeps,
        scene=scene,
        method=method,
        dtype=dtype,
        refine=refine,
        implicit=implicit,
        dry=dry,
    )
    if dry:
        scene = replace(scene, brakes=True)
    source = LinearSource(step, substeps, sources)
    return Kernel(robot, scene, method, dtype, source, recreate, quantity='linear_step')


def compile_in_motion(robot: Robot, scene: Scene) -> Kernel:
    """
    Compile the accelerations of joints that stay in motion, or are held by brakes.

    A kernel of q, qd and tau in float64, for scenes with dry friction or stops: friction is a
    torque that depends on the velocity, 0 at rest, and stops are out of reach.
    """
    plant, _ = plant_of(robot, scene, 'float64')
    plant = in_motion(plant)
    method = choose(plant, 'auto', 0)
    source = forward(plant, method, 0, 'float64')
    recreate = partial(compile_in_motion, robot, scene)
    return Kernel(robot, replace(scene, brakes=True), method, 'float64', source, recreate)


def _matrices(step: Program) -> int:
    """Return how many numbers of a state native code keeps on the stack."""
    calls = sum(instruction.op == 'call' for instruction in step.instructions)
    n, rows = step.lanes, len(carried_rows(step))
    columns = n * (rows + 1)
    # Products of all calls, derivatives of their arguments; four of the state; J and its factors.
    return (calls + 3) * n * columns + 4 * n * rows * columns + 6 * n * n
