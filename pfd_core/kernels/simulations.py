# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations in native code: the programs of a step and its dynamics, over all steps of a rollout.

    compile_steps        arms in the lanes of a register  (pfd_core.kernels.simulate)
    compile_adaptive     one arm, adaptive steps          (pfd_core.simulation.adaptive_steps)
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
import ctypes
from dataclasses import dataclass, replace
from functools import cache
import hashlib
import math
import time

from pfd_core.dynamics.numbers import PARAMETERS, count
from pfd_core.kernels.generate import declarations
from pfd_core.kernels.lower import lower
from pfd_core.kernels.native import Native
from pfd_core.kernels.recipes import Recipe, digest, forward, quantity, recipe, turned_joints
from pfd_core.kernels.script import Frame
from pfd_core.kernels.simulate import MOTION, PLAN, Steps, simulation_functions
from pfd_core.kernels.spec import KernelSpec
from pfd_core.kernels.threads import address
from pfd_core.machine.program import Program
from pfd_core.model.effects import INERTIA, JOINTS, LINKS, MOTORS
from pfd_core.model.plant import Plant, has_drives
from pfd_core.model.values import Array

# Python looks for signals between the pieces of a run. One may take this many seconds, by the time
# that the one before took. A step is never cut.
PIECE_SECONDS = 0.05
UNTIL, EVERY, APART, FINITE = map(PLAN.index, ('until', 'every', 'apart', 'finite'))


@dataclass(frozen=True)
class NativeSteps:
    """Steps of a simulation in native code; pointers are given as addresses."""

    steps: Steps
    places: Mapping[str, int]  # of arrays in a plan
    work: int  # operations of the evaluations in one call of the integrator's step
    simulate: Callable[[int], int]  # @simulate (pfd_core.kernels.simulate)
    accelerations: Callable[[int], None] | None  # @accelerations, unless they are written
    digest: str  # of all its programs
    native: Native  # owner of the code


class Plan:
    """
    What @simulate and @accelerations do with a number of arms, in steps of `substeps` each.

    `arrays` are arrays by name, ([arms, [steps,]] elements). The code reads a spare number for
    those that it lacks, and writes it; it takes no notice of others.
    """

    def __init__(
        self, native: NativeSteps, arrays: Mapping[str, Array], substeps: int = 1, arms: int = 1
    ) -> None:
        self.native = native
        rows = len(native.steps.arrays)
        # Behind the plan the spare number, and the finite steps of one arm.
        self.numbers = array('q', [0, arms, 0, 1, substeps, 1, 0, 0, *[0] * (4 * rows + 2)])
        self._at, end = self.numbers.buffer_info()
        self.numbers[FINITE] = self._at + 8 * (end - 1)
        self.numbers[len(PLAN) : -2 : 4] = array('q', [self._at + 8 * (end - 2)]) * rows
        self._place({k: x for k, x in arrays.items() if k in native.places}, self.numbers)

    def run(self, steps: int) -> int:
        """Take some steps, at least one, of one arm; return after how many it was finite."""
        self.numbers[UNTIL], self.numbers[-1] = steps, 0
        self.native.simulate(self._at)
        return self.numbers[-1]

    def with_arrays(self, arrays: Mapping[str, Array]) -> array[int]:
        """Return the numbers with further arrays, for as long as the plan is there."""
        return self._place(arrays, self.numbers[:])

    def accelerations(self, qdd: Array) -> None:
        """Write qdd of each arm, ([arms,] n)."""
        assert self.native.accelerations is not None
        self._place({'qdd': qdd}, self.numbers)
        self.native.accelerations(self._at)

    def _place(self, arrays: Mapping[str, Array], numbers: array[int]) -> array[int]:
        """Write the address of each array, and bytes from arm to arm, element and step."""
        for name, x in arrays.items():
            place, strides = self.native.places[name], x.strides
            # One by one: an array of them takes twice the time.
            numbers[place] = address(x)
            numbers[place + 1] = strides[0] if len(strides) > 1 else 0
            numbers[place + 2] = strides[-1]
            numbers[place + 3] = strides[1] if len(strides) > 2 else 0
        return numbers


def run_block(
    native: NativeSteps, plan: array[int], begin: int, until: int, first: int, size: int
) -> int:
    """Take the steps from `begin` to before `until` of some arms; return whether one is lost."""
    own = array('q', [first, first + size, begin, until]) + plan[4:]
    return native.simulate(own.buffer_info()[0])


def pieces(steps: int, first: int, most: float = math.inf) -> Iterator[tuple[int, int]]:
    """Cut a run into pieces of PIECE_SECONDS and at most `most` steps, the first of `first`."""
    begin, count = 0, max(first, 1)
    while begin < steps:
        until = int(min(begin + count, begin + most, steps))
        began = time.perf_counter()
        yield begin, until
        spent = max(time.perf_counter() - began, 1e-9)
        count = max(1, min(2 * count, int((until - begin) * PIECE_SECONDS / spent)))
        begin = until


# Writes @advance and @accelerate, and what they call: from the steps, the lowered programs and
# dynamics, the layout of the frame, and the elements of q that turn.
Writer = Callable[
    [Steps, Mapping[str, Program], Mapping[str, Program], Frame, Sequence[int]], list[str]
]


@dataclass(frozen=True)
class StepCode:
    """One step of an integrator for a plant."""

    plant: Plant
    further: tuple[str, ...]  # rows of the state besides q and qd
    programs: Callable[[], dict[str, Program]]  # records the programs; returns them by name
    write: Writer
    evaluations: int  # how often a step without events evaluates the dynamics
    settings: str  # what determines programs and functions, except the plant
    shared: bool = False  # as of Steps
    contact: bool = False  # whether the step has events of dry friction or joint stops
    stops: bool = False  # whether it has stops
    # Time [s] by which the damping is multiplied that a smooth step solves with; above zero for a
    # step with events that solves with the damping; 0 for none.
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
    sources, inputs = step_dynamics(spec, step)
    steps = Steps(
        spec.robot.n, step.further, inputs, written, spec.dtype, width, step.shared, control
    )
    sampled = [] if 'qdd' in written else ['accelerations']
    native = _compiled(spec, step, steps, sources, ['simulate', *sampled])
    kind = ctypes.CFUNCTYPE
    places = {name: len(PLAN) + 4 * k for k, name in enumerate(steps.arrays)}
    if PARAMETERS in places:
        # The name in recorded states.
        places['payload'] = places[PARAMETERS]
    return NativeSteps(
        steps,
        places,
        max(_work(sources, step), 1),
        kind(ctypes.c_int64, ctypes.c_void_p)(native['simulate']),
        kind(None, ctypes.c_void_p)(native['accelerations']) if sampled else None,
        native.facts.digest,
        native,
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
    sources, inputs = step_dynamics(spec, step)
    steps, frame = Steps(spec.robot.n, (), inputs, (), spec.dtype), frame_of(spec.robot.n, inputs)
    native = _compiled(spec, step, steps, sources, ['adaptive', 'size'], frame)
    size = ctypes.CFUNCTYPE(ctypes.c_int64)(native['size'])()
    return AdaptiveSteps(_work(sources, step), frame, size, native['adaptive'], native)


def _work(sources: Mapping[str, Recipe], step: StepCode) -> int:
    """Return the operations of the evaluations in a step without events."""
    return next(iter(sources.values())).work * step.evaluations


def _compiled(
    spec: KernelSpec,
    step: StepCode,
    steps: Steps,
    sources: Mapping[str, Recipe],
    functions: Sequence[str],
    adaptive: Frame | None = None,
) -> Native:
    """Return native code of a step, on a frame if it is adaptive, else with its simulation."""
    control = steps.control

    @cache
    def lowered() -> dict[str, Program]:
        own = step.programs() | ({} if control is None else {'control': control})
        # Without fused operations: limited efforts are compared with those wanted.
        fma = adaptive is not None
        return {k: lower(program, spec.dtype, fma=fma).compiled for k, program in own.items()}

    def dynamics() -> dict[str, Program]:
        return {name: source.program for name, source in sources.items()}

    def ir() -> str:
        programs, angles = dict(lowered()), turned_joints(spec.robot)
        law, frame = programs.pop('control', None), adaptive or steps.frame()
        parts = step.write(steps, programs, dynamics(), frame, angles)
        if adaptive is None:
            parts += simulation_functions(steps, law, dynamics(), frame)
        widths = {1, steps.width}
        return '\n\n'.join([*parts, declarations(spec.dtype, widths, bool(angles))])

    def described() -> str:
        found = dynamics() | lowered()
        if control is not None:
            found['control'] = replace(found['control'], inputs=control.inputs)
        settings = [f'{name} {digest(program)}' for name, program in found.items()]
        return hashlib.sha256(
            '\n'.join([step.settings, spec.dtype, *settings]).encode()
        ).hexdigest()

    keys = {name: source.key for name, source in sources.items()}
    own = steps.width, steps.written, step.settings, step.plant.digest, keys
    controls = '' if control is None else digest(control)
    main = next(iter(sources.values()))
    module = f'{functions} {own} {controls}'
    return main.compile(module, functions, ir, described, branches=True)


def step_dynamics(spec: KernelSpec, step: StepCode) -> tuple[dict[str, Recipe], dict[str, int]]:
    """
    Return the sources of the dynamics of a step by name, and elements of its inputs.

    The first source is of the accelerations. Of a smooth step: `qdd`; if it is implicit,
    `undamped` and `solve`, (H + c h D)^-1 tau. Of a step with events: `accelerations` under
    torques of the joints, without damping; `held`, see record_held; `motor`, torques of the
    motors; and `solve`, (H + diag(rotor))^-1 tau, if it is implicit. With brakes or stops
    `momentum`, H qdd, and `inertial`, H^-1 tau of the free joints. The inputs are those besides
    the state.
    """
    plant, dtype = spec.plant, spec.dtype
    still = replace(plant.only(INERTIA), external_wrench=False)
    if step.contact:
        moved = replace(plant.only(LINKS, INERTIA, JOINTS), brakes=True)
        sources = {
            'accelerations': forward(spec, moved),
            'held': recipe('composite.record_held', moved, dtype),
        }
        if has_drives(plant):
            sources['motor'] = recipe('drives.record_motor_torques', plant, dtype)
        if step.implicit:
            sources['solve'] = recipe('composite.record_solve', moved, dtype)
    else:
        sources = {'qdd': forward(spec, plant)}
        heavier = replace(plant, implicit=step.implicit).implicit_inertia
        if heavier is not None:
            varied = dict(plant.varied)
            if 'implicit_inertia' in varied:
                varied['inertia'] = varied['implicit_inertia']
            solved = replace(still, effects={'armature': heavier}, varied=varied)
            sources['undamped'] = forward(spec, plant.only(LINKS, INERTIA, JOINTS, MOTORS))
            sources['solve'] = forward(spec, solved)
    if step.stops or plant.brakes:
        unbraked = replace(still, brakes=False)
        sources['momentum'] = quantity(unbraked, 'inverse_dynamics', dtype)
        sources['inertial'] = forward(spec, replace(still, brakes=True))
    inputs = {
        name: size
        for name, size in next(iter(sources.values())).facts.inputs.items()
        if name not in MOTION and (name != 'free' or step.plant.brakes)
    }
    return sources, inputs | ({PARAMETERS: count(step.plant)} if step.plant.varied else {})
