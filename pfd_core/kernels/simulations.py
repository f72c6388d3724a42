# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations in native code: the programs of a step and its dynamics, over all steps of a rollout.

    compile_steps        arms in the lanes of a register  (pfd_core.kernels.simulate)
    compile_adaptive     one arm, adaptive steps          (pfd_core.kernels.adaptive)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import ctypes
from dataclasses import dataclass, replace
from functools import cache, partial
import hashlib
from typing import Any

from pfd_core.dynamics.numbers import PARAMETERS, count
from pfd_core.kernels.adaptive import WRITTEN, AdaptivePair, adaptive_module, carried
from pfd_core.kernels.contact import Contact, contact_step
from pfd_core.kernels.lower import lower, operations
from pfd_core.kernels.native import Native
from pfd_core.kernels.recipes import (
    Recipe,
    digest,
    forward,
    motors,
    quantity,
    turned_joints,
)
from pfd_core.kernels.simulate import (
    MOTION,
    Steps,
    evaluations,
    new_frame,
    simulation_functions,
    simulation_module,
    smooth_step,
)
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.program import Program
from pfd_core.model import Plant, has_drives
from pfd_core.model.effects import INERTIA, JOINTS, LINKS, MOTORS, VISCOSITY
from pfd_core.model.values import Array

# Where the result, and the table, of one arm lie behind the numbers of its plan.
FINITE, TABLE = 6, 7


@dataclass(frozen=True)
class NativeSteps:
    """Steps of a simulation in native code; pointers are given as addresses."""

    steps: Steps
    arrays: tuple[str, ...]  # of the table of a plan
    work: int  # operations of the evaluations in one call of the integrator's step
    operations: Callable[[], int]  # all of that step, see step_operations
    simulate: Callable[[int], None]  # @simulate (pfd_core.kernels.simulate)
    accelerations: Callable[..., None] | None  # @accelerations, unless accelerations are written
    digest: str  # of all its programs
    native: Native  # owner of the code


class Plan:
    """
    What one call of @simulate does with one arm.

    Parameters
    ----------
    native : NativeSteps
        The code.
    substeps : int
        Steps of the integrator in a step.
    rows : iterable
        For each of its arrays the address, and bytes from element to element and step to step.

    """

    def __init__(
        self, native: NativeSteps, substeps: int, rows: Iterable[tuple[int, int, int]]
    ) -> None:
        self._simulate = native.simulate
        table = [x for place, element, step in rows for x in (place, 0, element, step)]
        self._numbers = (ctypes.c_int64 * (TABLE + len(table)))(1, 1, substeps, 1, 0, 0, 0, *table)
        self._at = ctypes.addressof(self._numbers)
        self._numbers[4] = self._at + 8 * TABLE
        self._numbers[5] = self._at + 8 * FINITE

    def move(self, k: int, place: int) -> None:
        """Set the address of an array."""
        self._numbers[TABLE + 4 * k] = place

    def run(self, steps: int) -> int:
        """Take some steps, at least one; return the number after which the state was finite."""
        self._numbers[1] = steps
        self._simulate(self._at)
        return self._numbers[FINITE]


def compile_steps(
    spec: KernelSpec,
    step_program: Program,
    *,
    written: tuple[str, ...],
    width: int = 1,
    implicit: float = 0.0,
    contact: Contact | None = None,
    control: Program | None = None,
) -> NativeSteps:
    """
    Compile the simulation of a robot by an integrator's step; `spec` is of a STEP.

    `implicit` is the time [s] by which the viscosity of the plant that the step solves with is
    multiplied; 0 for a step that calls the accelerations alone. With `contact` the step is that
    of dry friction and joint stops, with programs that are not lowered yet, and `step_program`
    has only its state. `written`, `width` and `control`, a recorded program, are as for Steps.
    """
    sources = _sources(spec, implicit, contact)
    inputs = {name: size for name, size in sources.inputs.items() if name not in MOTION}
    if spec.plant.varied:
        inputs[PARAMETERS] = count(spec.plant)
    steps = Steps(step_program, inputs, written, spec.dtype, width, control)
    lowered = cache(partial(_lowered, steps, sources))
    sampled = [] if 'qdd' in written else ['accelerations']
    native = sources.compile(
        f'steps {width} {written}{sources.key} {step_program} {control}',
        ['simulate', *sampled],
        lambda: _steps_module(*lowered(), turned_joints(spec.robot)),
        lambda: _digest(*lowered()),
    )
    integer, pointer = ctypes.c_int64, ctypes.c_void_p
    simulate = ctypes.CFUNCTYPE(None, pointer)
    accelerations = None
    if sampled:
        accelerate = ctypes.CFUNCTYPE(None, integer, pointer)
        accelerations = accelerate(native['accelerations'])
    calls = sum(instruction.op == 'call' for instruction in step_program.instructions)
    return NativeSteps(
        steps,
        steps.arrays,
        sources.main.work * calls,
        partial(sources.step_operations, step_program),
        simulate(native['simulate']),
        accelerations,
        native.facts.digest,
        native,
    )


def _lowered(steps: Steps, sources: _Sources) -> tuple[Steps, dict[str, Program], Contact | None]:
    """Return steps with a lowered control program, the dynamics, and the contact programs."""
    if steps.control is not None:
        # Without fused operations: limited efforts are compared with those wanted.
        control = lower(steps.control, steps.dtype, fma=False).compiled
        # The table has all arrays in the recorded order, read or not.
        steps = replace(steps, control=replace(control, inputs=steps.control.inputs))
    dynamics, contact = sources.further()
    if contact is None:
        return steps, {'qdd': sources.main.program, **dynamics}, None
    return steps, dict(contact.dynamics), contact


def _steps_module(
    steps: Steps,
    dynamics: Mapping[str, Program],
    contact: Contact | None,
    angles: tuple[int, ...],
) -> str:
    """Return the module of @simulate."""
    frame = new_frame(steps)
    if contact is None:
        parts = evaluations(dynamics, steps.dtype, steps.width, angles)
        parts += smooth_step(steps, dynamics, frame)
    else:
        parts = contact_step(steps, contact, frame, angles)
    parts += simulation_functions(steps, dynamics, frame)
    return simulation_module(parts, steps, bool(angles))


def _digest(steps: Steps, dynamics: Mapping[str, Program], contact: Contact | None) -> str:
    """Return the SHA-256 of all programs of a simulation, in hex."""
    programs = dict(dynamics)
    settings = [str(steps.program), steps.dtype]
    if steps.control is not None:
        programs['control'] = steps.control
    if contact is not None:
        programs |= contact.programs
        settings.append(f'{contact.h.hex()} {contact.pivots} {contact.segments} {contact.stages}')
    settings += [f'{name} {digest(program)}' for name, program in programs.items()]
    return hashlib.sha256('\n'.join(settings).encode()).hexdigest()


@dataclass(frozen=True)
class AdaptiveSteps:
    """Adaptive steps of one arm in native code; pointers are given as addresses."""

    work: int  # operations of the evaluations in one attempt
    inputs: tuple[str, ...]  # of the dynamics, besides the state
    arrays: tuple[str, ...]  # that both functions take before the output arrays
    begin: Callable[..., None]  # @begin (pfd_core.kernels.adaptive)
    run: Callable[..., int]  # @adaptive, without the interpreter's lock
    begin_law: Callable[..., None]  # the same with a law in Python, with the lock
    run_law: Callable[..., int]
    native: Native  # owner of the code


def compile_adaptive(spec: KernelSpec, pair: AdaptivePair, contact: Contact) -> AdaptiveSteps:
    """
    Compile adaptive steps of a robot; `spec` is of a STEP in float64.

    `contact` has the programs of the steps, not lowered yet, and in scenes with dry friction or
    joint stops the programs of events.
    """
    if 'modes' in contact.programs:
        sources = _contact_sources(spec, contact)
    else:
        main = forward(spec)
        sources = _Sources(
            main, f' {contact.key}', {'braked': main}, main.inputs, spec.dtype, contact
        )
    inputs = {name: size for name, size in sources.inputs.items() if name not in MOTION}

    def ir() -> str:
        _, lowered = sources.further()
        assert lowered is not None
        return adaptive_module(pair, lowered, inputs, turned_joints(spec.robot))

    native = sources.compile(f'adaptive {pair}{sources.key}', ['begin', 'adaptive'], ir)
    arrays, integer = carried(contact, inputs), ctypes.c_int64
    # The law is an object of Python, or a null pointer.
    state: list[Any] = [ctypes.c_void_p] * (4 + len(arrays))
    own: list[Any] = [integer, integer, *state, *([ctypes.c_void_p] * len(WRITTEN))]
    begin, run = (native[name] for name in ('begin', 'adaptive'))
    return AdaptiveSteps(
        sources.main.work * len(pair.nodes),
        tuple(inputs),
        arrays,
        ctypes.CFUNCTYPE(None, *state)(begin),
        ctypes.CFUNCTYPE(integer, *own)(run),
        ctypes.PYFUNCTYPE(None, *state)(begin),
        ctypes.PYFUNCTYPE(integer, *own)(run),
        native,
    )


@dataclass(frozen=True)
class _Sources:
    """
    Sources of the functions of a simulation.

    Attributes
    ----------
    main : Recipe
        The dynamics that a step evaluates most.
    settings : str
        Everything that determines the module except the sources and the step's program.
    others : dict
        Sources of other functions, by the names that the step calls them.
    inputs : dict
        Elements of the inputs of the dynamics.
    dtype : str
        Number format.
    contact : Contact or None
        Dry friction and joint stops, with lowered programs.

    """

    main: Recipe
    settings: str
    others: Mapping[str, Recipe]
    inputs: Mapping[str, int]
    dtype: str
    contact: Contact | None = None

    @property
    def key(self) -> str:
        """Everything that determines the module except the main source and the step's program."""
        others = {name: source.key for name, source in self.others.items()}
        return f'{self.settings} {others}'

    def compile(
        self,
        module: str,
        functions: Sequence[str],
        ir: Callable[[], str],
        described: Callable[[], str] | None = None,
    ) -> Native:
        """Return native code as Recipe.compile; steps cut at events have many branches."""
        optimisation = self.main.optimisation
        if self.contact is not None:
            optimisation = replace(optimisation, pipeline=not optimisation.long)
        return self.main.compile(module, functions, ir, optimisation, described=described)

    def further(self) -> tuple[dict[str, Program], Contact | None]:
        """Return the other programs, and dry friction and stops with lowered programs."""
        programs = {name: other.program for name, other in self.others.items()}
        if self.contact is None:
            return programs, None
        parts = {
            name: lower(program, self.dtype).compiled
            for name, program in self.contact.programs.items()
        }
        return {}, replace(self.contact, programs=parts, dynamics=programs)

    def step_operations(self, step: Program) -> int:
        """
        Return the operations of a step, as compiled: evaluations, and the step's own for n joints.

        With dry friction and stops: of a step in which no joint rests, reverses or reaches its
        stop.
        """
        if self.contact is None:
            calls = [i.data for i in step.instructions if i.op == 'call']
            evaluations = sum(self.others.get(name, self.main).work for name in calls)
            own = sum(count for op, count in operations(step).items() if op != 'call')
            return evaluations + own * step.lanes
        parts, functions = self.contact.quiet_step()
        own = sum(
            sum(operations(lower(self.contact.programs[name], self.dtype).compiled).values())
            for name in parts
        )
        return own + sum(self.others[name].work for name in functions if name in self.others)


def _sources(spec: KernelSpec, implicit: float, contact: Contact | None) -> _Sources:
    """
    Return the sources of a simulation.

    With `implicit` = c and a damping D in the scene there are `undamped`, the accelerations
    without damping, and `solve`, the accelerations at rest under a torque alone, with rotors that
    are heavier by c D: (H + c D)^-1 tau.
    """
    if contact is not None:
        return _contact_sources(spec, contact)
    main, *stiff = ((name, forward(spec, own)) for name, own in plants(spec.plant, implicit))
    settings = f' implicit {implicit.hex()}' if stiff else ''
    others = dict(stiff)
    if spec.plant.brakes:
        others |= impulses(spec, spec.plant)
    return _Sources(main[1], settings, others, main[1].inputs, spec.dtype)


def impulses(spec: KernelSpec, plant: Plant) -> dict[str, Recipe]:
    """Return the sources of `momentum`, H qdd, and `inertial`, H^-1 tau of the free joints."""
    still = _at_rest(plant)
    return {
        'momentum': quantity(replace(still, brakes=False), 'inverse_dynamics', spec.dtype),
        'inertial': forward(spec, replace(still, brakes=True)),
    }


def plants(plant: Plant, implicit: float) -> Iterator[tuple[str, Plant]]:
    """Yield the plants of the functions that a step may call, by name; `implicit` as above."""
    yield 'qdd', plant
    if implicit and plant.viscosity is not None:
        yield 'undamped', plant.only(LINKS, INERTIA, JOINTS, MOTORS)
        yield 'solve', _at_rest(plant, _heavier(plant, implicit))


def _contact_sources(spec: KernelSpec, contact: Contact) -> _Sources:
    """Return the sources of a simulation with dry friction and joint stops."""
    plant, dtype = spec.plant, spec.dtype
    brakes = plant.brakes
    heavier = None
    if contact.implicit and plant.viscosity is not None:
        heavier = _heavier(plant, contact.implicit)
        plant = plant.only(LINKS, INERTIA, JOINTS, MOTORS)
    others = {'motor': motors(plant, dtype)} if has_drives(plant) else {}
    plant = plant.only(LINKS, INERTIA, VISCOSITY, JOINTS)
    held = replace(plant, brakes=True)
    main = forward(spec, held)
    others |= {'braked': main, 'inverse': quantity(plant, 'inverse_dynamics', dtype)}
    if 'hits' in contact.programs or brakes:
        others |= impulses(spec, plant)
    if heavier is not None:
        others['stiff'] = forward(spec, _at_rest(held, heavier))
    inputs = {k: size for k, size in main.inputs.items() if k != 'free' or brakes}
    settings = f' {" ".join(inputs)} {contact.key}'
    return _Sources(main, settings, others, inputs, dtype, contact)


def _heavier(plant: Plant, time: float) -> Array:
    """Return the joints' inertia plus a time [s] times their viscosity."""
    assert plant.viscosity is not None
    added: Array = time * plant.viscosity
    return added if plant.inertia is None else plant.inertia + added


def _at_rest(plant: Plant, inertia: Array | None = None) -> Plant:
    """Return a plant on which no torque acts but inertia, of the joints given or its own."""
    still = replace(plant.only(INERTIA), external_wrench=False)
    if inertia is None:
        return still
    varied = dict(plant.varied)
    if 'implicit_inertia' in varied:
        varied['inertia'] = varied['implicit_inertia']
    return replace(still, effects={'armature': inertia}, varied=varied)
