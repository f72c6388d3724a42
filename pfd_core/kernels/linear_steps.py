# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearised steps: A and B of a step of a simulation, as a kernel of q, qd and tau.

pfd_core.dynamics.acceleration gives the derivatives of the accelerations at each
stage of the integrator; native code combines them by the chain rule (kernels.linear_step).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
import hashlib
from operator import attrgetter

from pfd_core.dynamics.joint_torques import record_joint_torques
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.linear_step import called, carried_rows, linear_functions, state_rows
from pfd_core.kernels.native import Optimisation
from pfd_core.kernels.recipes import Facts, ProductRecipe, Recipe, check_stack, derivatives
from pfd_core.kernels.simulations import plants
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.program import Program
from pfd_core.model.effects import JOINTS


class LinearSource(Recipe):
    """The source of a linearised step, composed of the sources of the functions that it calls."""

    def __init__(
        self,
        step: Program,
        substeps: int,
        sources: Mapping[str, ProductRecipe],
        periodic: bool,
    ) -> None:
        self._step, self._substeps, self._sources = step, substeps, sources
        self._periodic = periodic
        self.key = ('linear step', str(step), str(substeps))
        for source in sources.values():
            self.key += source.key

    def _facts(self) -> Facts:
        n, rows, sources = self._step.lanes, state_rows(self._step), self._sources.values()
        inputs = {name: size for source in sources for name, size in source.inputs.items()}
        operations, *_ = (source.facts.operations for source in sources)
        own = [str(self._step), str(self._substeps), *(x.facts.digest for x in sources)]
        digest = hashlib.sha256('\n'.join(own).encode()).hexdigest()
        return Facts(inputs, [n * len(rows), n * (len(rows) + 1) + 1], operations, False, digest)

    @property
    def work(self) -> int:
        """The operations of the derivatives in all substeps."""
        calls = [i.data for i in self._step.instructions if i.op == 'call']
        return self._substeps * sum(self._sources[name].work for name in calls)

    @property
    def optimisation(self) -> Optimisation:
        """The effort for the longest function, with LLVM's pipeline for products of matrices."""
        longest = max(self._sources.values(), key=attrgetter('work')).optimisation
        return replace(longest, pipeline=not longest.long)

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel, whose batches go from state to state."""
        programs = {name: source.lowered.compiled for name, source in self._sources.items()}
        return linear_functions(
            self._step, programs, self._substeps, dtype, angles, self._periodic
        )


def compile_linear_step(spec: KernelSpec, step: Program, substeps: int, implicit: float) -> Kernel:
    """
    Compile the linearisation of some steps of an integrator, a kernel of q, qd and tau.

    Its result, (r n, (r + 1) n + 1), is the derivative of the r rows of the state at the end by
    those at the beginning and by the torque, and last the state at the end. The spec is of a STEP,
    or for scenes with dry friction or stops of a STEP_IN_MOTION. `implicit` is as for
    compile_steps. Positions must be plain sums in `step`: the digits that these lose have no
    derivative.
    """
    check_stack(f'a linearised step of {spec.robot.n} joints', _matrices(step))
    functions = dict(plants(spec.plant, implicit))
    sources = {name: derivatives(spec, functions[name]) for name in called(step)}
    recreate = partial(compile_linear_step, spec, step, substeps, implicit)
    # Torques of springs and cogging change from turn to turn.
    periodic = 'q' not in record_joint_torques(spec.plant.only(JOINTS)).inputs
    return Kernel(spec, LinearSource(step, substeps, sources, periodic), recreate)


def _matrices(step: Program) -> int:
    """Return how many numbers of a state native code keeps on the stack."""
    calls = sum(instruction.op == 'call' for instruction in step.instructions)
    n, rows = step.lanes, len(carried_rows(step))
    columns = n * (rows + 1)
    # Products of all calls, derivatives of their arguments; four of the state; J and its factors.
    return (calls + 3) * n * columns + 4 * n * rows * columns + 6 * n * n
