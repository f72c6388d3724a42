# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations in native code: an integrator's step around @evaluate, over all steps of a rollout.

    compile_rollout      one arm                    (pfd_core.kernels.codegen.rollout)
    compile_ensemble     one arm per SIMD lane      (pfd_core.kernels.codegen.arms)
    compile_adaptive     one arm, adaptive steps    (pfd_core.kernels.codegen.adaptive)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import ctypes
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pfd_core.algorithms.chain.actuators import record_actuators
from pfd_core.kernels.codegen.adaptive import WRITTEN, AdaptivePair, carried
from pfd_core.kernels.codegen.arms import PARAMETERS
from pfd_core.kernels.codegen.cycles import block_names
from pfd_core.kernels.codegen.module import adaptive_module, ensemble_module, rollout_module
from pfd_core.kernels.codegen.rollout import written
from pfd_core.kernels.codegen.segments import Contact
from pfd_core.kernels.codegen.step import extra_arguments, further_rows, torque_row
from pfd_core.kernels.lower import lower, operations
from pfd_core.kernels.native import Native, simd_width
from pfd_core.kernels.source import KernelSource, forward, motors, quantity_source, turned_joints
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.program import Program
from pfd_core.model import Plant, has_drives
from pfd_core.model.effects import INERTIA, JOINTS, LINKS, MOTORS, VISCOSITY
from pfd_core.model.values import Array


@dataclass(frozen=True)
class Rollout:
    """The simulation of one arm in native code; pointers are given as addresses."""

    work: int  # operations of the evaluations in one call of @step
    operations: Callable[[], int]  # all of one call of @step, see step_operations
    rows: tuple[str, ...]  # of the state, except q and qd
    written: tuple[str, ...]  # rows that `run` writes after each step
    torque: str  # the row, or input, that is the torque at the end of a step
    run: Callable[..., int]  # @rollout (pfd_core.kernels.codegen.rollout)
    accelerations: Callable[..., None]  # @accelerations
    native: Native  # owner of the code
    cycles: Callable[..., int] | None = None  # @cycles (pfd_core.kernels.codegen.cycles)
    block: tuple[str, ...] = ()  # what the addresses in the block of @cycles are of


@dataclass(frozen=True)
class NativeEnsemble:
    """The simulation of many arms in native code; pointers are given as addresses."""

    width: int  # arms in a vector register
    work: int  # operations of one evaluation of the accelerations
    operations: Callable[[], int]  # of one call of @step, see step_operations
    rows: tuple[str, ...]  # of the state, except q and qd
    run: Callable[..., None]  # @ensemble (pfd_core.kernels.codegen.arms)
    native: Native  # owner of the code


def compile_rollout(
    spec: KernelSpec,
    step_program: Program,
    *,
    implicit: float = 0.0,
    contact: Contact | None = None,
    motors: bool = False,
) -> Rollout:
    """
    Compile the simulation of a robot by an integrator's step; `spec` is of a STEP.

    `implicit` is the time [s] by which the viscosity of the plant that the step solves with is
    multiplied; 0 for a step that calls the accelerations alone. With `contact` the step is that
    of dry friction and joint stops, with programs that are not lowered yet, and `step_program`
    has only its state. With `motors` there is @cycles, whose efforts pass actuators.
    """
    sources = _sources(spec, implicit, contact)

    def ir() -> str:
        actuators = None
        if motors:
            # Without fused operations: limited efforts are compared with those wanted.
            recorded = record_actuators(spec.robot.n)
            actuators = lower(recorded, spec.dtype, fma=False).compiled
        return rollout_module(
            step_program,
            sources.signature,
            spec.dtype,
            turned_joints(spec.robot),
            *sources.further(),
            actuators,
        )

    name = 'rollout with motors' if motors else 'rollout'
    functions = ['rollout', 'accelerations', *(['cycles'] if motors else [])]
    native = sources.compile(f'{name}{sources.key} {step_program}', functions, ir)
    integer = ctypes.c_int64
    inputs: list[Any] = [ctypes.c_void_p] * len(sources.inputs)
    rows, out = further_rows(step_program), written(step_program)
    states: list[Any] = [ctypes.c_void_p] * len((*rows, *out))
    run = ctypes.CFUNCTYPE(integer, integer, ctypes.c_void_p, *inputs, *states)
    accelerate = ctypes.CFUNCTYPE(None, integer, *inputs, ctypes.c_void_p)
    pointed = ctypes.CFUNCTYPE(integer, integer, ctypes.c_void_p)
    # Inputs without instructions: code from disk needs no recording.
    inputs_alone = Program(1, (), dict(sources.inputs), {})
    calls = sum(instruction.op == 'call' for instruction in step_program.instructions)
    return Rollout(
        sources.main.work * calls,
        partial(sources.step_operations, step_program),
        rows,
        out,
        torque_row(step_program),
        run(native.address('rollout')),
        accelerate(native.address('accelerations')),
        native,
        pointed(native.address('cycles')) if motors else None,
        block_names(step_program, inputs_alone) if motors else (),
    )


def compile_ensemble(
    spec: KernelSpec,
    step_program: Program,
    *,
    arms: int,
    implicit: float = 0.0,
    contact: Contact | None = None,
) -> NativeEnsemble:
    """
    Compile many simulations of a robot by an integrator's step; as compile_rollout.

    One of `arms` alone needs no vectors: scalar code takes half the time, with the same bits.
    """
    sources = _sources(spec, implicit, contact)
    width = 1 if arms == 1 else simd_width(spec.dtype)

    def ir() -> str:
        return ensemble_module(
            step_program,
            sources.signature,
            spec.dtype,
            width,
            turned_joints(spec.robot),
            *sources.further(),
        )

    native = sources.compile(f'ensemble {width}{sources.key} {step_program}', ['ensemble'], ir)
    kinds = [ctypes.c_void_p if kind.startswith('ptr') else ctypes.c_int64 for kind in PARAMETERS]
    run = ctypes.CFUNCTYPE(None, *kinds)(native.address('ensemble'))
    rows = further_rows(step_program)
    count = partial(sources.step_operations, step_program)
    return NativeEnsemble(width, sources.main.work, count, rows, run, native)


@dataclass(frozen=True)
class AdaptiveSteps:
    """Adaptive steps of one arm in native code; pointers are given as addresses."""

    work: int  # operations of the evaluations in one attempt
    inputs: tuple[str, ...]  # of the dynamics, besides the state
    arrays: tuple[str, ...]  # that both functions take before the output arrays
    begin: Callable[..., None]  # @begin (pfd_core.kernels.codegen.adaptive)
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
            main, f' {contact.key}', {'_braked': main}, main.inputs, spec.dtype, contact
        )
    inputs = tuple(extra_arguments(sources.signature))

    def ir() -> str:
        _, lowered = sources.further()
        assert lowered is not None
        return adaptive_module(pair, lowered, inputs, spec.dtype, turned_joints(spec.robot))

    native = sources.compile(f'adaptive {pair}{sources.key}', ['begin', 'adaptive'], ir)
    arrays, integer = carried(contact, inputs), ctypes.c_int64
    # The law is an object of Python, or a null pointer.
    state: list[Any] = [ctypes.c_void_p] * (4 + len(arrays))
    own: list[Any] = [integer, integer, *state, *([ctypes.c_void_p] * len(WRITTEN))]
    begin, run = (native.address(name) for name in ('begin', 'adaptive'))
    return AdaptiveSteps(
        sources.main.work * len(pair.nodes),
        inputs,
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
    main : KernelSource
        The dynamics that a step evaluates most.
    settings : str
        Everything that determines the module except the sources and the step's program.
    others : dict
        Sources of other functions, by the names that the step calls them.
    contact : Contact or None
        Dry friction and joint stops, with lowered programs.

    """

    main: KernelSource
    settings: str
    others: Mapping[str, KernelSource]
    inputs: Mapping[str, int]
    dtype: str
    contact: Contact | None = None

    @property
    def key(self) -> str:
        """Everything that determines the module except the main source and the step's program."""
        others = {name: source.key for name, source in self.others.items()}
        return f'{self.settings} {others}'

    @property
    def signature(self) -> Program:
        """A program with the inputs of the simulation."""
        return Program(1, (), dict(self.inputs), {}) if self.contact else self.main.program

    def compile(self, module: str, functions: Sequence[str], ir: Callable[[], str]) -> Native:
        """Return native code as KernelSource.compile; steps cut at events have many branches."""
        optimisation = self.main.optimisation
        if self.contact is not None:
            optimisation = replace(optimisation, pipeline=not optimisation.long)
        return self.main.compile(module, functions, ir, optimisation)

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


def impulses(spec: KernelSpec, plant: Plant) -> dict[str, KernelSource]:
    """Return the sources of `momentum`, H qdd, and `inertial`, H^-1 tau of the free joints."""
    still = _at_rest(plant)
    return {
        'momentum': quantity_source(replace(still, brakes=False), 'inverse_dynamics', spec.dtype),
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
    others = {'_motor': motors(plant, dtype)} if has_drives(plant) else {}
    plant = plant.only(LINKS, INERTIA, VISCOSITY, JOINTS)
    held = replace(plant, brakes=True)
    main = forward(spec, held)
    others |= {'_braked': main, '_inverse': quantity_source(plant, 'inverse_dynamics', dtype)}
    if 'hits' in contact.programs or brakes:
        found = impulses(spec, plant)
        others |= {f'_{name}': source for name, source in found.items()}
    if heavier is not None:
        others['_stiff'] = forward(spec, _at_rest(held, heavier))
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
    return still if inertia is None else replace(still, effects={'armature': inertia})
