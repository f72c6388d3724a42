# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sources of kernels: a robot, a scene and a method as a lowered program, recorded only if needed.

Recording and lowering take longer than loading compiled code from disk. What a kernel needs to
know about its program is therefore kept on disk with its code.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
import gc
import hashlib
import math
from typing import Any, NamedTuple

import numpy as np

from pfd_core.dynamics.methods import TOLERANCES
from pfd_core.dynamics.quantities import QUANTITIES, RECORDERS
from pfd_core.forking import cached_property, no_fork
from pfd_core.kernels.auto import select
from pfd_core.kernels.cache import kept
from pfd_core.kernels.generate import inputs_of, kernel_functions
from pfd_core.kernels.lower import Stages, joined, lower, multiplied, operations
from pfd_core.kernels.native import Native, Optimisation, compile_kept
from pfd_core.kernels.schedule import LONGEST, can_be_ordered
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.program import Program
from pfd_core.model import Plant, Robot

# The widest register, and half of the stack that a thread has on Linux.
REGISTER_BYTES = 64
STACK_BYTES = 4 << 20


class Facts(NamedTuple):
    """What a kernel needs to know about its program, kept with its code."""

    inputs: dict[str, int]  # elements of each input, in the order in which a kernel takes them
    shape: list[int]  # of the output
    operations: dict[str, dict[str, int]]  # by name, of each stage
    ordered: bool  # whether native code is to keep the order of its operations
    digest: str  # of the lowered program


class KernelSource:
    """
    A lowered program with one output, recorded at the first look at it.

    Parameters
    ----------
    lowered : callable
        Records and lowers the program.
    key : tuple of str, optional
        Everything that determines the program, except the source of this package (a plant's
        digest, a method, a number format); without it nothing is kept on disk.

    """

    def __init__(self, lowered: Callable[[], Stages], key: tuple[str, ...] = ()) -> None:
        self._lowered = lowered
        self.key = key

    @cached_property
    def facts(self) -> Facts:
        """The facts about its program, from disk where there is no code that has them."""
        return kept(
            (*self.key, 'facts') if self.key else (),
            lambda: (self._facts()._asdict(), b''),
            lambda head, _: Facts(**head),
        )

    @property
    def inputs(self) -> dict[str, int]:
        """Elements of each input, in the order in which a kernel takes them."""
        return self.facts.inputs

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the output."""
        return tuple(self.facts.shape)

    @property
    def operations(self) -> dict[str, dict[str, int]]:
        """Operations by name, of each stage."""
        return self.facts.operations

    @property
    def elements(self) -> int:
        """Elements of the output."""
        return math.prod(self.shape)

    @cached_property
    def program(self) -> Program:
        """The lowered program."""
        return joined(self._stages.compiled)

    @cached_property
    def _stages(self) -> Stages:
        return self._recorded()

    def _recorded(self) -> Stages:
        # A recording has no cycles of references; to look for them would take a third of the time
        # of a long program.
        with uncollected():
            return self._lowered()

    @property
    def work(self) -> int:
        """The operations of the lowered program."""
        return sum(self.operations['compiled'].values())

    def compile(
        self,
        module: str,
        functions: Sequence[str],
        ir: Callable[[], str],
        optimisation: Optimisation | None = None,
        described: Callable[[], str] | None = None,
    ) -> Native:
        """
        Return native code of the program.

        Parameters
        ----------
        module : str
            Everything that determines the IR except the program, such as the name of a kind of
            module.
        functions : sequence of str
            The functions whose addresses are needed.
        ir : callable
            Writes the module of LLVM IR; called only if its object is not on disk.
        optimisation : Optimisation, optional
            The effort of the compiler; default: the property `optimisation`.
        described : callable, optional
            Returns the digest of all programs of the module; default: that of the program alone.

        """
        own = vars(self)

        def source() -> tuple[str, Optimisation, dict[str, Any]]:
            if 'facts' not in own:
                own['facts'] = self._facts()
            facts = self.facts if described is None else self.facts._replace(digest=described())
            return ir(), optimisation or self.optimisation, facts._asdict()

        key = (*self.key, module) if self.key else ()
        native = compile_kept(key, source, functions, Facts)
        own.setdefault('facts', native.facts)
        return native

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        return Optimisation(long=self.work > LONGEST, reorder=not self.facts.ordered)

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel without its entry, as generate.kernel_functions."""
        return kernel_functions(self.program, dtype, width, angles, self.elements)

    def _facts(self) -> Facts:
        (output,) = self.program.outputs.values()
        return Facts(
            {name: self.program.inputs[name] for name in inputs_of(self.program)},
            list(output.shape),
            {name: operations(p) for name, p in vars(self._stages).items()},
            can_be_ordered(self.program),
            digest(self.program),
        )


class ProductSource(KernelSource):
    """
    A lowered program whose outputs are factors of the result (pfd_core.kernels.lower.multiplied).

    Its `program`, `elements` and `operations` describe the result, with the operations of the
    product one by one. Native code uses `factors` and multiplies in loops.
    """

    @cached_property
    def factors(self) -> Program:
        """The lowered program of the factors."""
        return self._factor_stages.compiled

    @cached_property
    def _factor_stages(self) -> Stages:
        return self._recorded()

    @cached_property
    def _stages(self) -> Stages:
        return Stages(**{k: multiplied(p) for k, p in vars(self._factor_stages).items()})

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        return Optimisation(long=self.work > LONGEST)

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel, which compute the factors and multiply them."""
        with no_fork:
            from pfd_core.kernels.matmul import product_functions

        return product_functions(self.factors, dtype, width, angles)


def source_of(spec: KernelSpec) -> KernelSource:
    """Return the source of a spec."""
    if spec.quantity == 'derivatives':
        return derivatives(spec)
    if spec.quantity in RECORDERS:
        return quantity_source(spec.plant, spec.quantity, spec.dtype, spec.frame, spec.place)
    return forward(spec)


def forward(
    spec: KernelSpec, plant: Plant | None = None, names: Collection[str] = ('qdd',)
) -> KernelSource:
    """Return the source of forward dynamics, of a plant instead of the spec's if given."""
    plant = spec.plant if plant is None else plant
    method, refine, dtype = spec.method, spec.refine, spec.dtype

    def lowered() -> Stages:
        with no_fork:
            from pfd_core.dynamics.convergence import with_nan_unless_converged
            from pfd_core.dynamics.refinement import record_refined

        estimate = dtype if 'error' in names else None
        recorded = record_refined(plant, method, refine, TOLERANCES[dtype], estimate)
        return lower(with_nan_unless_converged(recorded, plant), dtype, names)

    return KernelSource(lowered, ('forward', plant.digest, method, str(refine), dtype, *names))


def quantity_source(
    plant: Plant, quantity: str, dtype: str, frame: str | None = None, place: str = ''
) -> KernelSource:
    """Return the source of a quantity in pfd_core.dynamics.quantities, of a frame or of none."""
    arguments = dict.fromkeys(QUANTITIES[quantity].arguments, plant.robot.n)

    def lowered() -> Stages:
        recorded = RECORDERS[quantity](plant, frame)
        # A program need not read all arguments: a sliding joint alone has the same H everywhere.
        return lower(replace(recorded, inputs=arguments | recorded.inputs), dtype)

    return KernelSource(lowered, (quantity, plant.digest, place, dtype))


def derivatives(spec: KernelSpec, plant: Plant | None = None) -> ProductSource:
    """
    Return the source of d qdd / d(q, qd, tau), (n, 3n), of a plant as for `forward`.

    The accelerations are those of the spec. The method of a step is chosen by other rules than the
    method of the inverse inertia, which is one for all functions of a step.
    """
    plant = spec.plant if plant is None else plant
    of_step = spec.quantity != 'derivatives'
    inverse = select(spec.plant, use='derivatives') if of_step else (spec.method, spec.refine)

    def lowered() -> Stages:
        with no_fork:
            from pfd_core.dynamics.acceleration import record_derivatives

        recorded = record_derivatives(plant, spec.method, spec.refine, spec.dtype, inverse)
        return lower(recorded, spec.dtype)

    n = plant.robot.n
    # The factors, and a copy of the result.
    check_stack(f'a kernel of derivatives for {n} joints', 6 * n * n)
    how = (spec.method, str(spec.refine), *map(str, inverse))
    key = ('derivatives', plant.digest, *how, spec.dtype)
    return ProductSource(lowered, key)


def check_stack(name: str, numbers: int) -> None:
    """Raise ValueError if the numbers of a state exceed the stack of a thread."""
    # One register holds one number of each of the states that run at once.
    size = REGISTER_BYTES * numbers
    if size > STACK_BYTES:
        raise ValueError(
            f'{name} needs {size / 2**20:.1f} MB of the stack, more than {STACK_BYTES >> 20} MB: '
            'the robot has too many joints'
        )


def motors(plant: Plant, dtype: str) -> KernelSource:
    """Return the source of the torques of motors under commanded ones."""

    def lowered() -> Stages:
        with no_fork:
            from pfd_core.dynamics.drives import record_motor_torques

        return lower(record_motor_torques(plant), dtype)

    return KernelSource(lowered, ('motors', plant.digest, dtype))


def digest(program: Program) -> str:
    """Return the SHA-256 of a program of one lane, in hex; its sections have no part in it."""
    instructions = [
        (op, args, [float(x).hex() for x in data] if op == 'constant' else data)
        for op, args, data, *_ in program.instructions
    ]
    described = repr((instructions, dict(program.inputs), list(program.outputs.items())))
    return hashlib.sha256(described.encode()).hexdigest()


def turned_joints(robot: Robot) -> tuple[int, ...]:
    """Return the joints whose position is an angle."""
    return tuple(np.flatnonzero(robot.turning).tolist())


@contextmanager
def uncollected() -> Iterator[None]:
    """
    Switch off the collection of reference cycles.

    The collector is common to all threads, so threads do this in turn, and no process forks
    meanwhile.
    """
    with no_fork:
        running = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            if running:
                gc.enable()
