# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Recipes: how a spec becomes a program, and the program native code.

    spec -> recorded program -> lowered program -> LLVM IR -> native code
            dynamics            lower              generate   native

All this takes far longer than to load native code from disk, where the facts about a program that
a kernel needs are kept as well. A recipe therefore records its program at the first look at it,
and imports the modules that record, lower and write only then.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
import gc
import hashlib
from typing import TYPE_CHECKING, Any, NamedTuple

from pfd_core.dynamics.quantities import QUANTITIES
from pfd_core.forking import cached_property, load, no_fork
from pfd_core.kernels.cache import kept
from pfd_core.kernels.native import Native, Optimisation, compile_kept
from pfd_core.kernels.spec import KernelSpec
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, coupled

if TYPE_CHECKING:
    from pfd_core.kernels.lower import Stages
    from pfd_core.machine.program import Program

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


class Recipe:
    """
    A lowered program with one output, recorded at the first look at it by `record`.

    The key is everything that determines the program, except the source of this package. `outputs`
    are those that are wanted, default all; several become one, in which they follow each other.
    With `product` the lowered outputs are factors of the result, which native code multiplies in
    loops (pfd_core.kernels.matmul); program and facts have the operations of that one by one.
    """

    def __init__(
        self,
        key: tuple[str, ...],
        record: Callable[[], Program],
        dtype: str,
        outputs: Collection[str] | None = None,
        product: bool = False,
    ) -> None:
        self.key, self._record, self._dtype, self._outputs = key, record, dtype, outputs
        self._product = product

    @cached_property
    def lowered(self) -> Stages:
        """The stages of the program that native code is written from."""
        with uncollected():
            stages: Stages = load('kernels.lower.lower')(
                self._record(), self._dtype, self._outputs
            )
        return stages

    @cached_property
    def stages(self) -> Stages:
        """The stages of the program, of a product with all its operations."""
        if not self._product:
            return self.lowered
        multiplied = load('kernels.lower.multiplied')
        return replace(self.lowered, **{k: multiplied(p) for k, p in vars(self.lowered).items()})

    @cached_property
    def program(self) -> Program:
        """The lowered program."""
        program: Program = load('kernels.lower.joined')(self.stages.compiled)
        return program

    @cached_property
    def facts(self) -> Facts:
        """The facts about the program, from disk where there is no code that has them."""
        head, _ = kept((*self.key, 'facts'), lambda: (self._facts()._asdict(), b''))
        return Facts(**head)

    @property
    def work(self) -> int:
        """The operations of the lowered program."""
        return sum(self.facts.operations['compiled'].values())

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        longest, ordered = load('kernels.schedule.LONGEST'), self.facts.ordered
        return Optimisation(long=self.work > longest, reorder=self._product or not ordered)

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel without its entry, as generate.kernel_functions."""
        write, program = load('kernels.generate.kernel_functions'), self.program
        if self._product:
            write, program = load('kernels.matmul.product_functions'), self.lowered.compiled
        functions: list[str] = write(program, dtype, width, angles)
        return functions

    def compile(
        self,
        module: str,
        functions: Sequence[str],
        ir: Callable[[], str],
        described: Callable[[], str] | None = None,
        branches: bool = False,
    ) -> Native:
        """
        Return native code of the program.

        `module` is everything that determines the IR except the program, such as the name of a
        kind of module; `functions` are those whose addresses are needed. `ir` writes the module if
        its object is not on disk, and `described` returns the digest of all its programs, default
        that of this one. `branches` is as of Optimisation.
        """
        own = vars(self)

        def source() -> tuple[str, Optimisation, dict[str, Any]]:
            if 'facts' not in own:
                own['facts'] = self._facts()
            facts = self.facts if described is None else self.facts._replace(digest=described())
            return ir(), replace(self.optimisation, branches=branches), facts._asdict()

        native = compile_kept((*self.key, module), source, functions, Facts)
        own.setdefault('facts', native.facts)
        return native

    def _facts(self) -> Facts:
        program, count = self.program, load('kernels.lower.operations')
        (output,) = program.outputs.values()
        return Facts(
            {name: program.inputs[name] for name in load('kernels.generate.inputs_of')(program)},
            list(output.shape),
            {name: count(stage) for name, stage in vars(self.stages).items()},
            load('kernels.schedule.can_be_ordered')(program),
            digest(program),
        )


def recipe_of(spec: KernelSpec) -> Recipe:
    """Return the recipe of a spec."""
    plant = spec.plant
    if spec.quantity == 'derivatives':
        # A register for each number of the factors, and of a copy of the result.
        size = REGISTER_BYTES * 6 * plant.robot.n**2
        if size > STACK_BYTES:
            raise ValueError(
                f'a kernel of derivatives for {plant.robot.n} joints needs {size / 2**20:.1f} MB '
                f'of the stack, more than {STACK_BYTES >> 20} MB: the robot has too many joints'
            )
        path, options = 'acceleration.record_derivatives', (spec.method, spec.refine, spec.dtype)
        return recipe(path, plant, spec.dtype, *options, product=True)
    row = QUANTITIES.get(spec.quantity)
    if row is None or not row.method:  # a step, or forward dynamics: the spec has the method
        return forward(spec, plant)
    return quantity(plant, spec.quantity, spec.dtype, spec.frame, spec.place)


def recipe(
    path: str,
    plant: Plant,
    dtype: str,
    *options: str | int,
    outputs: Collection[str] | None = None,
    product: bool = False,
) -> Recipe:
    """Return the recipe of a program of pfd_core.dynamics, recorded of a plant with options."""
    key = path, plant.digest, dtype, *map(str, options)

    def record() -> Program:
        program: Program = load(f'dynamics.{path}')(plant, *options)
        return program

    return Recipe(key, record, dtype, outputs, product)


def forward(spec: KernelSpec, plant: Plant) -> Recipe:
    """Return the recipe of forward dynamics of a plant, with the other options of a spec."""
    options, path = (spec.method, spec.refine, spec.dtype), 'refinement.record_answer'
    return recipe(path, plant, spec.dtype, *options, outputs=['qdd'])


def error_estimate(spec: KernelSpec) -> Recipe:
    """Return the recipe of the estimated error of accelerations, which are the input qdd."""
    options, path = (spec.method, spec.dtype), 'refinement.record_error'
    return recipe(path, spec.plant, spec.dtype, *options)


def quantity(
    plant: Plant, name: str, dtype: str, frame: str | None = None, place: str = ''
) -> Recipe:
    """Return the recipe of a quantity with one algorithm, of a frame or of none."""
    key = name, plant.digest, place, dtype
    return Recipe(key, lambda: QUANTITIES[name](plant, frame), dtype)


def digest(program: Program) -> str:
    """Return the SHA-256 of a program of one lane, in hex; its sections have no part in it."""
    instructions = [
        (op, args, [float(x).hex() for x in data] if op == 'constant' else data)
        for op, args, data, *_ in program.instructions
    ]
    described = repr((instructions, dict(program.inputs), list(program.outputs.items())))
    return hashlib.sha256(described.encode()).hexdigest()


def turned_joints(robot: Robot) -> tuple[int, ...]:
    """Return the joints whose position is an angle that may change by whole turns."""
    pairs = zip(robot.joint_names, robot.turning, strict=True)
    return tuple(k for k, (x, turns) in enumerate(pairs) if turns and x not in coupled(robot))


@contextmanager
def uncollected() -> Iterator[None]:
    """
    Do not look for cycles of references, which a recording has none of.

    That would take a third of the time of a long program. The collector is common to all threads:
    they do this in turn, and no process forks meanwhile.
    """
    with no_fork:
        running = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            if running:
                gc.enable()
