# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations in native code: the programs of a step and its dynamics, over all steps of a rollout.

    compile_steps        arms in the lanes of a register  (pfd_core.kernels.simulate)
    compile_adaptive     one arm, adaptive steps          (pfd_core.simulation.adaptive_steps)
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
import ctypes
from dataclasses import dataclass, replace
from functools import cache
import hashlib

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.numbers import PARAMETERS, count
from pfd_core.forking import load
from pfd_core.kernels.generate import declarations
from pfd_core.kernels.lower import lower
from pfd_core.kernels.native import Native, Optimisation
from pfd_core.kernels.recipes import (
    Recipe,
    digest,
    forward,
    motors,
    quantity,
    turned_joints,
)
from pfd_core.kernels.script import Frame
from pfd_core.kernels.simulate import MOTION, PLAN, Steps, simulation_functions
from pfd_core.kernels.spec import KernelSpec
from pfd_core.kernels.threads import address
from pfd_core.machine.program import Program
from pfd_core.model.effects import INERTIA, JOINTS, LINKS, MOTORS
from pfd_core.model.plant import Plant, has_drives
from pfd_core.model.values import Array

# A row of the table of a plan: an address, and bytes from arm to arm, element and step.
Row = tuple[int, int, int, int]
UNTIL, TABLE = PLAN.index('until'), len(PLAN)


@dataclass(frozen=True)
class NativeSteps:
    """Steps of a simulation in native code; pointers are given as addresses."""

    steps: Steps
    arrays: tuple[str, ...]  # of the table of a plan
    work: int  # operations of the evaluations in one call of the integrator's step
    simulate: Callable[[int], None]  # @simulate (pfd_core.kernels.simulate)
    accelerations: Callable[[int], None] | None  # @accelerations, unless they are written
    digest: str  # of all its programs
    native: Native  # owner of the code


def table_row(array: Array) -> Row:
    """Return the row of an array, ([arms, [steps,]] elements)."""
    *outer, element = array.strides
    arm, step = (*outer, 0, 0)[:2]
    return address(array), arm, element, step


class Plan:
    """
    What @simulate and @accelerations do with some arms.

    Parameters
    ----------
    native : NativeSteps
        The code.
    rows : mapping
        Row of each array by name. What lacks one is read from, and written to, a spare number.
    substeps : int
        Steps of the integrator in a step.
    arms : int
        Number of arms.
    every : int
        Steps between two states that are written.

    """

    def __init__(
        self,
        native: NativeSteps,
        rows: Mapping[str, Row],
        substeps: int = 1,
        arms: int = 1,
        every: int = 1,
    ) -> None:
        self._simulate, self._accelerations = native.simulate, native.accelerations
        self._names = native.arrays
        count = TABLE + 4 * len(native.arrays)
        self._numbers, self._finite = array('q', bytes(8 * (count + 1 + arms))), count + 1
        self._at, _ = self._numbers.buffer_info()
        spare = self._at + 8 * count
        plan = [0, arms, 0, 1, substeps, every, self._at + 8 * TABLE, spare + 8]
        for name in native.arrays:
            plan += rows.get(name, (spare, 0, 0, 0))
        self._numbers[:count] = array('q', plan)

    @property
    def finite(self) -> NDArray[np.int64]:
        """Number of steps of the last run after which each arm's state was finite, (arms,)."""
        return np.frombuffer(self._numbers, np.int64)[self._finite :]

    def addresses(self, *names: str) -> tuple[array[int], list[int]]:
        """Return the numbers of the plan, and where the address of each of these arrays is."""
        return self._numbers, [TABLE + 4 * self._names.index(name) for name in names]

    def run(self, steps: int) -> int:
        """Take some steps, at least one, of one arm; return after how many it was finite."""
        self._numbers[UNTIL] = steps
        self._simulate(self._at)
        return self._numbers[self._finite]

    def run_block(self, begin: int, until: int, first: int, size: int) -> int:
        """Take the steps from `begin` to before `until` of some of the arms."""
        head = array('q', [first, first + size, begin, until]) + self._numbers[4:TABLE]
        self._simulate(head.buffer_info()[0])
        return 0

    def accelerations(self) -> None:
        """Write qdd of each arm."""
        assert self._accelerations is not None
        self._accelerations(self._at)


# Writes @advance and @accelerate, and what they call: from the steps, the lowered programs and
# dynamics, the layout of the frame, and the elements of q that turn.
Writer = Callable[
    [Steps, Mapping[str, Program], Mapping[str, Program], Frame, Sequence[int]], list[str]
]


@dataclass(frozen=True)
class StepCode:
    """
    One step of an integrator for a plant.

    Attributes
    ----------
    plant : Plant
        Robot and scene.
    further : tuple of str
        Rows of the state besides q and qd.
    programs : dict
        Recorded programs by name.
    write : callable
        See Writer.
    evaluations : int
        How often a step without events evaluates the dynamics.
    settings : str
        Everything that determines the programs and the functions, except the plant.
    shared : bool
        As of Steps.
    contact, stops : bool
        Whether the step has events of dry friction or joint stops; whether it has stops.
    implicit : float
        Time [s] by which the damping is multiplied that a smooth step solves with; above zero for
        a step with events that solves with the damping; 0 for none.

    """

    plant: Plant
    further: tuple[str, ...]
    programs: Mapping[str, Program]
    write: Writer
    evaluations: int
    settings: str
    shared: bool = False
    contact: bool = False
    stops: bool = False
    implicit: float = 0.0


def compile_steps(
    spec: KernelSpec,
    step: StepCode,
    *,
    written: tuple[str, ...],
    width: int = 1,
    control: Program | None = None,
) -> NativeSteps:
    """
    Compile the simulation of a robot by an integrator's step; `spec` is of a STEP.

    `written`, `width` and `control`, a recorded program, are as for Steps.
    """
    sources = step_dynamics(spec, step)
    main = next(iter(sources.values()))
    inputs = step_inputs(main, step.plant)
    steps = Steps(
        spec.robot.n, step.further, inputs, written, spec.dtype, width, step.shared, control
    )

    @cache
    def lowered() -> dict[str, Program]:
        # Without fused operations: limited efforts are compared with those wanted.
        own = dict(step.programs) | ({} if control is None else {'control': control})
        return {k: lower(program, spec.dtype, fma=False).compiled for k, program in own.items()}

    def dynamics() -> dict[str, Program]:
        return {name: source.program for name, source in sources.items()}

    def ir() -> str:
        programs, frame, angles = dict(lowered()), steps.frame(), turned_joints(spec.robot)
        law = programs.pop('control', None)
        parts = step.write(steps, programs, dynamics(), frame, angles)
        parts += simulation_functions(steps, law, dynamics(), frame)
        return '\n\n'.join([*parts, declarations(spec.dtype, {1, width}, bool(angles))])

    def described() -> str:
        found = dynamics() | lowered()
        if control is not None:
            found['control'] = replace(found['control'], inputs=control.inputs)
        settings = [f'{name} {digest(program)}' for name, program in found.items()]
        return hashlib.sha256(
            '\n'.join([step.settings, spec.dtype, *settings]).encode()
        ).hexdigest()

    keys = {name: source.key for name, source in sources.items()}
    sampled = [] if 'qdd' in written else ['accelerations']
    native = main.compile(
        f'steps {width} {written} {step.settings} {step.plant.digest} {keys} {control}',
        ['simulate', *sampled],
        ir,
        branching(main) if step.contact else None,
        described,
    )
    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    return NativeSteps(
        steps,
        steps.arrays,
        main.work * step.evaluations,
        function(native['simulate']),
        function(native['accelerations']) if sampled else None,
        native.facts.digest,
        native,
    )


def step_dynamics(spec: KernelSpec, step: StepCode) -> dict[str, Recipe]:
    """
    Return the sources of the dynamics of a step by name, first of its accelerations.

    Of a smooth step: `qdd`; if it is implicit, `undamped` and `solve`, (H + c h D)^-1 tau. Of a
    step with events: `accelerations` under torques of the joints, without damping; `held`, see
    record_held; `motor`, torques of the motors; and `solve`, (H + diag(rotor))^-1 tau, if it is
    implicit. With brakes or stops `momentum`, H qdd, and `inertial`, H^-1 tau of the free joints.
    """
    plant, dtype = spec.plant, spec.dtype
    still = replace(plant.only(INERTIA), external_wrench=False)
    impulses = {
        'momentum': quantity(replace(still, brakes=False), 'inverse_dynamics', dtype),
        'inertial': forward(spec, replace(still, brakes=True)),
    }
    if not step.contact:
        sources = {'qdd': forward(spec)}
        heavier = replace(plant, implicit=step.implicit).implicit_inertia
        if heavier is not None:
            varied = dict(plant.varied)
            if 'implicit_inertia' in varied:
                varied['inertia'] = varied['implicit_inertia']
            solved = replace(still, effects={'armature': heavier}, varied=varied)
            sources['undamped'] = forward(spec, plant.only(LINKS, INERTIA, JOINTS, MOTORS))
            sources['solve'] = forward(spec, solved)
        return sources | (impulses if plant.brakes else {})
    moved = replace(plant.only(LINKS, INERTIA, JOINTS), brakes=True)
    sources = {'accelerations': forward(spec, moved)}
    sources['held'] = _recorded('record_held', moved, dtype)
    if has_drives(plant):
        sources['motor'] = motors(plant, dtype)
    if step.stops or plant.brakes:
        sources |= impulses
    if step.implicit:
        sources['solve'] = _recorded('record_solve', moved, dtype)
    return sources


def _recorded(name: str, plant: Plant, dtype: str) -> Recipe:
    """Return the recipe of a program of pfd_core.dynamics.composite."""
    return Recipe(
        (name, plant.digest, dtype), lambda: load(f'dynamics.composite.{name}')(plant), dtype
    )


@dataclass(frozen=True)
class AdaptiveSteps:
    """Adaptive steps of one arm in native code."""

    work: int  # operations of the evaluations in one attempt
    frame: Frame  # with the arrays that the caller sets and reads
    size: int  # its elements
    run: int  # the address of @adaptive
    native: Native  # owner of the code


def compile_adaptive(
    spec: KernelSpec, step: StepCode, frame_of: Callable[[int, Mapping[str, int]], Frame]
) -> AdaptiveSteps:
    """
    Compile adaptive steps of a robot; `spec` is of a STEP in float64.

    `frame_of` returns a frame for a number of joints and the elements of the inputs.
    """
    sources = step_dynamics(spec, step)
    main = next(iter(sources.values()))
    steps = Steps(spec.robot.n, (), step_inputs(main, step.plant), (), spec.dtype)
    frame = frame_of(steps.n, steps.inputs)

    def ir() -> str:
        programs = {k: lower(program, spec.dtype).compiled for k, program in step.programs.items()}
        dynamics = {k: source.program for k, source in sources.items()}
        angles = turned_joints(spec.robot)
        parts = step.write(steps, programs, dynamics, frame, angles)
        return '\n\n'.join([*parts, declarations(spec.dtype, {1}, bool(angles))])

    keys = {name: source.key for name, source in sources.items()}
    module = f'adaptive {step.settings} {step.plant.digest} {keys}'
    native = main.compile(module, ['adaptive', 'size'], ir, branching(main))
    size = ctypes.CFUNCTYPE(ctypes.c_int64)(native['size'])()
    work = main.work * step.evaluations
    return AdaptiveSteps(work, frame, size, native['adaptive'], native)


def step_inputs(main: Recipe, plant: Plant) -> dict[str, int]:
    """Return the elements of the inputs of the dynamics besides the state."""
    inputs = {
        name: size
        for name, size in main.inputs.items()
        if name not in MOTION and (name != 'free' or plant.brakes)
    }
    return inputs | ({PARAMETERS: count(plant)} if plant.varied else {})


def branching(main: Recipe) -> Optimisation:
    """Return the effort of the compiler for steps with many branches."""
    return replace(main.optimisation, pipeline=not main.optimisation.long)
