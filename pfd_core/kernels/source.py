# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sources of kernels: a robot, a scene and a method as a lowered program, recorded only if needed.

Recording and lowering take longer than loading compiled code from disk. The facts that a kernel
needs about its program and about its modules is therefore cached on disk, too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache
import gc
import math
from typing import Any

import numpy as np

from pfd_core.algorithms.programs import TOLERANCES
from pfd_core.algorithms.quantities import QUANTITIES, RECORDERS
from pfd_core.forking import cached_property, no_fork
from pfd_core.kernels.auto import default_inverse
from pfd_core.kernels.codegen.spelling import arguments
from pfd_core.kernels.passes.pipeline import Stages, joined, lower, operations
from pfd_core.kernels.passes.schedule import LONGEST, ORDERED, can_be_ordered
from pfd_core.kernels.runtime.jit import (
    USUAL,
    Native,
    Optimisation,
    Outline,
    compile_outlined,
    outline,
)
from pfd_core.kernels.runtime.json_cache import T, get_or_compute
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.program import Program
from pfd_core.model import Plant, Robot

# The widest register, and half of the stack that a thread has on Linux.
REGISTER_BYTES = 64
STACK_BYTES = 4 << 20


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

    Attributes
    ----------
    inputs : dict
        Elements of each input, in the order in which a kernel takes them.
    key : tuple of str
        As given.
    shape : tuple of int
        Shape of the output.
    operations : dict
        Operations by name, of each stage.
    ordered : bool
        Whether native code is to keep the order of its operations.

    """

    def __init__(self, lowered: Callable[[], Stages], key: tuple[str, ...] = ()) -> None:
        self._lowered = lowered
        self.key = key
        facts = self._get_or_compute('facts', self._facts, _are_facts)
        self.inputs: dict[str, int] = facts['inputs']
        self.shape: tuple[int, ...] = tuple(facts['shape'])
        self.operations: dict[str, dict[str, int]] = facts['operations']
        self.ordered: bool = facts['ordered']

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
        self, module: str, ir: Callable[[], str], optimisation: Optimisation | None = None
    ) -> Native:
        """
        Return native code of the program.

        Parameters
        ----------
        module : str
            Everything that determines the IR except the program, such as the name of a kind of
            module.
        ir : callable
            Writes the module of LLVM IR; called only if its object is not on disk.
        optimisation : Optimisation, optional
            The effort of the compiler; default: the property `optimisation`.

        """
        once = cache(ir)
        known = self._get_or_compute(module, lambda: asdict(outline(once())), _is_outline)
        return compile_outlined(Outline(**known), once, optimisation or self.optimisation)

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        # The passes find nothing to do in a long program, and take their time.
        passes = USUAL.passes if self.work <= LONGEST else ()
        return Optimisation(passes=passes, reorder=not self.ordered)

    def module(self, dtype: str, width: int, angles: Sequence[int]) -> str:
        """Return the module of a kernel, of one state or a batch (pfd_core.kernels.codegen)."""
        with no_fork:
            from pfd_core.kernels.codegen.module import kernel_module

        return kernel_module(self.program, dtype, width, angles)

    def _get_or_compute(
        self, name: str, compute: Callable[[], T], valid: Callable[[Any], bool]
    ) -> T:
        return get_or_compute((*self.key, name), compute, valid) if self.key else compute()

    def _facts(self) -> dict[str, Any]:
        (output,) = self.program.outputs.values()
        return {
            'inputs': {name: self.program.inputs[name] for name in arguments(self.program)},
            'shape': list(output.shape),
            'operations': {name: operations(p) for name, p in vars(self._stages).items()},
            'ordered': can_be_ordered(self.program, LONGEST),
        }


class ProductSource(KernelSource):
    """
    A lowered program whose outputs are factors of the result (pfd_core.kernels.passes.product).

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
        with no_fork:
            from pfd_core.kernels.passes.product import multiplied

        return Stages(**{k: multiplied(p) for k, p in vars(self._factor_stages).items()})

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        # Level 2 of the code generator doubles the time to compile the parts of a long program,
        # which are no faster then.
        return Optimisation(passes=(), code=1) if self.work > LONGEST else USUAL

    def module(self, dtype: str, width: int, angles: Sequence[int]) -> str:
        """Return the module of a kernel, which computes the factors and multiplies them."""
        with no_fork:
            from pfd_core.kernels.codegen.module import product_module

        return product_module(self.factors, dtype, width, angles)


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
            from pfd_core.algorithms.convergence import with_nan_unless_converged
            from pfd_core.algorithms.refinement import record_refined

        estimate = dtype if 'error' in names else None
        recorded = record_refined(plant, method, refine, TOLERANCES[dtype], estimate)
        return lower(with_nan_unless_converged(recorded, plant), dtype, names)

    return KernelSource(lowered, ('forward', plant.digest, method, str(refine), dtype, *names))


def quantity_source(
    plant: Plant, quantity: str, dtype: str, frame: str | None = None, place: str = ''
) -> KernelSource:
    """Return the source of a quantity in pfd_core.algorithms.quantities, of a frame or of none."""
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
    inverse = default_inverse(spec.plant) if of_step else (spec.method, spec.refine)

    def lowered() -> Stages:
        with no_fork:
            from pfd_core.algorithms.acceleration_derivatives import record_derivatives

        recorded = record_derivatives(plant, spec.method, spec.refine, spec.dtype, inverse)
        return lower(recorded, spec.dtype, longest=ORDERED)

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
            from pfd_core.algorithms.chain.drives import record_motor_torques

        return lower(record_motor_torques(plant), dtype)

    return KernelSource(lowered, ('motors', plant.digest, dtype))


def turned_joints(robot: Robot) -> tuple[int, ...]:
    """Return the joints whose position is an angle."""
    return tuple(np.flatnonzero(robot.turning).tolist())


def _are_facts(value: Any) -> bool:
    """Return whether a JSON value can be the facts that KernelSource keeps of its program."""
    return (
        isinstance(value, dict)
        and value.keys() == {'inputs', 'shape', 'operations', 'ordered'}
        and isinstance(value['ordered'], bool)
        and _are_counts(value['inputs'])
        and isinstance(value['shape'], list)
        and _are_counts(dict(enumerate(value['shape'])))
        and isinstance(value['operations'], dict)
        and value['operations'].keys() == Stages.__annotations__.keys()
        and all(_are_counts(stage) for stage in value['operations'].values())
    )


def _are_counts(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and bool(value)
        and all(type(count) is int and count > 0 for count in value.values())
    )


def _is_outline(value: Any) -> bool:
    """Return whether a JSON value can be an Outline."""
    return (
        isinstance(value, dict)
        and value.keys() == {'digest', 'functions'}
        and isinstance(value['digest'], str)
        and isinstance(value['functions'], list)
        and all(isinstance(name, str) for name in value['functions'])
    )


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
