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
from pfd_core.forking import cached_property, no_fork
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
    """

    def __init__(
        self,
        key: tuple[str, ...],
        record: Callable[[], Program],
        dtype: str,
        outputs: Collection[str] | None = None,
    ) -> None:
        self.key, self._record, self._dtype, self._outputs = key, record, dtype, outputs

    @cached_property
    def lowered(self) -> Stages:
        """The stages of the program that native code is written from."""
        with no_fork:
            from pfd_core.kernels.lower import lower

        with uncollected():
            return lower(self._record(), self._dtype, self._outputs)

    @property
    def stages(self) -> Stages:
        """The stages of the program."""
        return self.lowered

    @cached_property
    def program(self) -> Program:
        """The lowered program."""
        with no_fork:
            from pfd_core.kernels.lower import joined

        return joined(self.stages.compiled)

    @cached_property
    def facts(self) -> Facts:
        """The facts about the program, from disk where there is no code that has them."""
        head, _ = kept((*self.key, 'facts'), lambda: (self._facts()._asdict(), b''))
        return Facts(**head)

    @property
    def inputs(self) -> dict[str, int]:
        """Elements of each input, in the order in which a kernel takes them."""
        return self.facts.inputs

    @property
    def work(self) -> int:
        """The operations of the lowered program."""
        return sum(self.facts.operations['compiled'].values())

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        with no_fork:
            from pfd_core.kernels.schedule import LONGEST

        return Optimisation(long=self.work > LONGEST, reorder=not self.facts.ordered)

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel without its entry, as generate.kernel_functions."""
        with no_fork:
            from pfd_core.kernels.generate import kernel_functions

        size = len(next(iter(self.program.outputs.values())).places)
        return kernel_functions(self.program, dtype, width, angles, size)

    def compile(
        self,
        module: str,
        functions: Sequence[str],
        ir: Callable[[], str],
        described: Callable[[], str] | None = None,
    ) -> Native:
        """
        Return native code of the program.

        `module` is everything that determines the IR except the program, such as the name of a
        kind of module; `functions` are those whose addresses are needed. `ir` writes the module if
        its object is not on disk, and `described` returns the digest of all its programs, default
        that of this one.
        """
        own = vars(self)

        def source() -> tuple[str, Optimisation, dict[str, Any]]:
            if 'facts' not in own:
                own['facts'] = self._facts()
            facts = self.facts if described is None else self.facts._replace(digest=described())
            return ir(), self.optimisation, facts._asdict()

        native = compile_kept((*self.key, module), source, functions, Facts)
        own.setdefault('facts', native.facts)
        return native

    def _facts(self) -> Facts:
        with no_fork:
            from pfd_core.kernels.generate import inputs_of
            from pfd_core.kernels.lower import operations
            from pfd_core.kernels.schedule import can_be_ordered

        (output,) = self.program.outputs.values()
        return Facts(
            {name: self.program.inputs[name] for name in inputs_of(self.program)},
            list(output.shape),
            {name: operations(p) for name, p in vars(self.stages).items()},
            can_be_ordered(self.program),
            digest(self.program),
        )


class ProductRecipe(Recipe):
    """
    A program whose lowered outputs are factors of the result (pfd_core.kernels.lower.multiplied).

    Its program and facts describe the result, with the operations of the product one by one.
    Native code multiplies in loops.
    """

    @cached_property
    def stages(self) -> Stages:
        """The stages of the program."""
        with no_fork:
            from pfd_core.kernels.lower import Stages, multiplied

        return Stages(**{k: multiplied(p) for k, p in vars(self.lowered).items()})

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler: no order of the operations is written."""
        return replace(super().optimisation, reorder=True)

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel, which compute the factors and multiply them."""
        with no_fork:
            from pfd_core.kernels.matmul import product_functions

        return product_functions(self.lowered.compiled, dtype, width, angles)


def recipe_of(spec: KernelSpec) -> Recipe:
    """Return the recipe of a spec."""
    if spec.quantity == 'derivatives':
        return derivatives(spec)
    row = QUANTITIES.get(spec.quantity)
    if row is None or not row.method:  # a step, or forward dynamics: the spec has the method
        return forward(spec)
    return quantity(spec.plant, spec.quantity, spec.dtype, spec.frame, spec.place)


def forward(spec: KernelSpec, plant: Plant | None = None) -> Recipe:
    """Return the recipe of forward dynamics, of a plant instead of the spec's if given."""
    plant = spec.plant if plant is None else plant
    method, refine, dtype = spec.method, spec.refine, spec.dtype

    def record() -> Program:
        with no_fork:
            from pfd_core.dynamics.refinement import record_refined, with_nan_unless_converged
            from pfd_core.machine.iteration import TOLERANCES

        recorded = record_refined(plant, method, refine, TOLERANCES[dtype])
        return with_nan_unless_converged(recorded, plant)

    key = ('forward', plant.digest, method, str(refine), dtype)
    return Recipe(key, record, dtype, ['qdd'])


def error_estimate(spec: KernelSpec) -> Recipe:
    """Return the recipe of the estimated error of accelerations, which are the input qdd."""

    def record() -> Program:
        with no_fork:
            from pfd_core.dynamics.refinement import record_error
            from pfd_core.machine.iteration import TOLERANCES

        return record_error(spec.plant, spec.method, spec.dtype, TOLERANCES[spec.dtype])

    return Recipe(('error', spec.plant.digest, spec.method, spec.dtype), record, spec.dtype)


def quantity(
    plant: Plant, name: str, dtype: str, frame: str | None = None, place: str = ''
) -> Recipe:
    """Return the recipe of a quantity with one algorithm, of a frame or of none."""
    row = QUANTITIES[name]

    def record() -> Program:
        recorded = row(plant, frame)
        # A program need not read all arguments: a sliding joint alone has the same H everywhere.
        arguments = dict.fromkeys(row.arguments, plant.robot.n)
        return replace(recorded, inputs=arguments | recorded.inputs)

    return Recipe((name, plant.digest, place, dtype), record, dtype)


def derivatives(spec: KernelSpec) -> ProductRecipe:
    """Return the recipe of d qdd / d(q, qd, tau), (n, 3n)."""
    plant, method, refine, dtype = spec.plant, spec.method, spec.refine, spec.dtype

    def record() -> Program:
        with no_fork:
            from pfd_core.dynamics.acceleration import record_derivatives

        return record_derivatives(plant, method, refine, dtype)

    n = plant.robot.n
    # The factors, and a copy of the result.
    check_stack(f'a kernel of derivatives for {n} joints', 6 * n * n)
    return ProductRecipe(('derivatives', plant.digest, method, str(refine), dtype), record, dtype)


def motors(plant: Plant, dtype: str) -> Recipe:
    """Return the recipe of the torques of motors under commanded ones."""

    def record() -> Program:
        with no_fork:
            from pfd_core.dynamics.drives import record_motor_torques

        return record_motor_torques(plant)

    return Recipe(('motors', plant.digest, dtype), record, dtype)


def check_stack(name: str, numbers: int) -> None:
    """Raise ValueError if the numbers of a state exceed the stack of a thread."""
    # One register holds one number of each of the states that run at once.
    size = REGISTER_BYTES * numbers
    if size > STACK_BYTES:
        raise ValueError(
            f'{name} needs {size / 2**20:.1f} MB of the stack, more than {STACK_BYTES >> 20} MB: '
            'the robot has too many joints'
        )


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
