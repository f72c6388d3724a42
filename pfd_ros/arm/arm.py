# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated arm: robot, scene, brakes and time, stepped under efforts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
import hashlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.actuator_command import ActuatorCommand, all_braked
from pfd_ros.arm.actuators import in_model_order
from pfd_ros.arm.events import StateChange
from pfd_ros.arm.model_kernels import model_kernels
from pfd_ros.arm.plant_settings import (
    INPUT,
    check_joints_without_values,
    payload_changes,
    payload_numbers,
)
from pfd_ros.arm.scene import payload_of, scene_of
from pfd_ros.arm.setting_fields import check_joint_counts
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import ActuatorState, ArmState, LinkState, WrenchState
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.text import cut, listed

# Joints in the cure for a tree.
MOST_TO_LOCK = 16
# States of single steps that share an array: to allocate one takes as long as a step.
ROWS = 256
# With payloads as an input: with the payload at the start or another one, with gravity
# compensation or without. A plant is freed while another one is compiled, not in a step.
MOST_COMPILED = 4
# A stamp has 31 bits for its seconds; a day is left for the steps that follow.
LATEST_NS = (2**31 - 86_400) * NANOSECONDS
# Settings that may differ between the run that saved a state and the run that continues from it:
# simulated time is a part of the state, and a recording is of one run.
PER_RUN = frozenset(
    {
        'start_time',
        'real_time_factor',
        'recording',
        'recording_time',
        'recording_tf_rate',
        'recording_state_period',
        'recording_flush_period',
        'recording_max_size',
        'recording_max_duration',
    }
)


def load_robot(settings: Settings, source: str | pfd.Urdf | None = None) -> pfd.Robot:
    """Return a robot with the ends and the locked joints that the settings name.

    Parameters
    ----------
    settings
        For base_link, tip_link and locked.
    source
        As `pfd_core.load_robot` takes it; default: the robot that the settings name.

    Raises
    ------
    ValueError
        If it cannot be loaded; for a tree the text says which parameter makes it a chain.
    """
    try:
        return pfd.load_robot(
            settings.robot if source is None else source,
            base=settings.base_link or None,
            tip=settings.tip_link or None,
            locked=settings.locks or None,
        )
    except pfd.TreeError as error:
        positions = dict([*settings.locks.items(), *error.positions.items()][:MOST_TO_LOCK])
        written = f'-p locked:=[{",".join(positions)}]'
        if any(positions.values()):
            written += f' -p locked_positions:=[{",".join(map(str, positions.values()))}]'
        raise ValueError(f'{error}; of the node: write {written}') from error


def simulator_settings(settings: Settings) -> dict[str, Any]:
    """Return the arguments of the simulator that the settings describe."""
    return {
        'step_size': settings.step_ns / NANOSECONDS,
        'substeps': settings.substeps,
        'integrator': settings.integrator,
        'method': settings.method,
        'compensated': settings.compensated,
    }


def joint_order(wanted: Sequence[str], robot: pfd.Robot) -> tuple[int, ...]:
    """Return the index in the model of each joint, in the order in which joints are published.

    Raises
    ------
    ValueError
        If `wanted` is not empty and not a permutation of the robot's joints.
    """
    names = list(robot.joint_names)
    if not wanted:
        return tuple(range(robot.n))
    if sorted(wanted) != sorted(names):
        raise ValueError(
            f'joints is {listed(wanted)}, expected each joint of {cut(robot.name)!r} once: {names}'
        )
    return tuple(names.index(name) for name in wanted)


class Compiled(NamedTuple):
    """Native code: the scene it was compiled for, the simulator, and the outputs' kernels."""

    scene: pfd.Scene
    simulator: Any
    kernels: Mapping[str, Any]


class Plant(NamedTuple):
    """A scene, and the native code that simulates the robot in it."""

    scene: pfd.Scene
    compiled: Compiled
    # Mass, center and inertia of its payload, () without one.
    payload: tuple[float, ...]

    @property
    def payload_input(self) -> dict[str, pfd.Payload | None]:
        """The payload as an argument of native code that takes it as an input, else nothing."""
        if self.compiled.scene.payload != INPUT:
            return {}
        return {'payload': payload_of(self.scene)}


class Arm:
    """The simulated arm: its native code, constants of its settings, and its state.

    Attributes
    ----------
    state
        The state; every change of it is made by the engine.
    robot, plant
        The robot, the effects that act on it, and their native code.
    order, names
        Index in the model and name of each joint, in published order.
    start
        Positions (n,) in model order, rad or m, before the first step and after a reset.
    jumped
        The efforts (n,) of a step that was not done, since one of them jumped; None if none did.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(self, settings: Settings, robot: pfd.Robot) -> None:
        check_joint_counts(settings, robot.n)
        self.order = joint_order(settings.joints, robot)
        self.names = tuple(robot.joint_names[i] for i in self.order)
        self.robot = robot
        self._step_ns = settings.step_ns
        # Native code by the digest of the scene it was compiled for.
        self._compiled: dict[str, Compiled] = {}
        check_joints_without_values(settings, robot, self.names)
        first = scene_of(settings, self.order)
        # The payload at the start is a constant of the native code.
        self._first_payload = first.payload
        self._take_over(_plant_of(first, self._native(settings, first)))
        settings = replace(
            settings,
            payload_changes=payload_changes(settings.payload_changes, self._simulator.method),
            integrator=self._simulator.integrator,
            method=self._simulator.method,
            position_sums='compensated' if self._simulator.compensated else 'plain',
            recording_time=settings.log_time,
        )
        # q, qd, tau and commanded efforts of single steps, (ROWS, 4, n); new when all are used.
        self._rows: NDArray[Any] = np.empty(0)
        self._rows_at, self._next_row = 0, ROWS
        # Whose brakes and targets, and which wrench, native code has as inputs.
        self._actuation: ActuatorCommand | None = None
        self._wrench: NDArray[Any] | None = None
        self.limits: NDArray[Any] = np.full((7, robot.n), np.inf)
        self.jumped: NDArray[Any] | None = None
        self.start = self._initial_positions(settings.initial_positions)
        zeros = np.zeros(robot.n)
        self.state = ArmState(
            robot=robot.digest,
            first=settings,
            settings=settings,
            origin_ns=settings.start_ns,
            since_ns=settings.start_ns,
            reset_ns=settings.start_ns,
            simulation=self._simulator.new_state(self.start),
            q=self.start,
            qd=zeros,
            tau=zeros,
            braked=np.ones(robot.n, bool),
            link=LinkState(all_braked(robot.n), all_braked(robot.n)),
            actuators=ActuatorState(pfd.MotorState(np.zeros(robot.n))),
            wrench=WrenchState(np.zeros(6), np.zeros(6)) if first.external_wrench else None,
        )

    def _initial_positions(self, given: Sequence[float]) -> NDArray[Any]:
        """Return the initial positions (n,) in model order; they are given in published order."""
        count = len(self.order)
        if given and len(given) != count:
            raise ValueError(
                f'initial_positions holds {len(given)} numbers, '
                f'expected {count}, one for each of {list(self.names)}, or none'
            )
        return in_model_order(given, self.order)

    @property
    def settings(self) -> Settings:
        """The settings now, with 'auto' resolved."""
        return self.state.settings

    @property
    def q(self) -> NDArray[Any]:
        """Positions (n,) of the last finite state, model order, rad or m."""
        return self.state.q

    @property
    def qd(self) -> NDArray[Any]:
        """Velocities (n,) of the last finite state, model order, rad/s or m/s."""
        return self.state.qd

    @property
    def tau(self) -> NDArray[Any]:
        """Efforts (n,) that led to the last finite state, model order, N m or N."""
        return self.state.tau

    @property
    def step(self) -> int:
        """Steps that ended in a finite state."""
        return self.state.step

    @property
    def failure(self) -> str:
        """Why the simulation stopped, '' while it runs."""
        return self.state.failure

    @property
    def stamp_ns(self) -> int:
        """Simulated time, ns: whole steps, so that it never drifts."""
        return self.state.origin_ns + self.state.step * self._step_ns

    @property
    def acceleration(self) -> NDArray[Any]:
        """Accelerations (n,) under the last efforts, model order, rad/s^2 or m/s^2.

        Zero before the first step, after a jump, and once the arm has failed.
        """
        if self.state.failure:
            return np.zeros(self.robot.n)
        qdd: NDArray[Any] = self._simulator.accelerations(self.state.simulation)
        return qdd

    @property
    def scene(self) -> pfd.Scene:
        """The effects that act on the robot, with its payload."""
        return self.plant.scene

    @property
    def program(self) -> str:
        """Digest of the compiled program of the plant and its outputs, the same everywhere."""
        compiled = self.plant.compiled
        kernels = (f'{name} {code.code_digest}' for name, code in compiled.kernels.items())
        lines = [compiled.simulator.code_digest, *kernels]
        return hashlib.sha256('\n'.join(lines).encode()).hexdigest()

    @property
    def kernels(self) -> Mapping[str, Any]:
        """The native code of the outputs by name."""
        return self.plant.compiled.kernels

    def _take_over(self, plant: Plant) -> None:
        self.plant = plant
        self._cycles: Any = None
        self._simulator = plant.compiled.simulator
        self._payload_input = plant.payload_input

    def _plant(self, settings: Settings) -> Plant:
        """Return the plant of settings, compiled now if it was not before."""
        scene = compiled = scene_of(settings, self.order)
        if settings.payload_changes == INPUT and scene.payload != self._first_payload:
            compiled = replace(scene, payload=INPUT)
        plant = _plant_of(scene, self._native(settings, compiled))
        if plant.payload_input:
            plant.compiled.simulator.prepare_payload(scene.payload)
        return plant

    def _native(self, settings: Settings, scene: pfd.Scene) -> Compiled:
        found = self._compiled.get(scene.digest)
        if found is None:
            simulator = pfd.MotorSimulator(self.robot, scene, **simulator_settings(settings))
            found = Compiled(scene, simulator, model_kernels(settings, self.robot, scene))
            while len(self._compiled) >= MOST_COMPILED:
                self._compiled.pop(next(iter(self._compiled)), None)
            self._compiled[scene.digest] = found
        return found

    def prepare(self, settings: Settings) -> None:
        """Compile the plant of other settings ahead, on any thread: it may take a second.

        A payload that is an input takes a tenth of a millisecond, but for the first.

        Raises
        ------
        ValueError
            If the settings do not go with the robot.
        """
        self._plant(settings)

    def plant_of(self, settings: Settings) -> Plant | None:
        """Return the plant of other settings, compiled before or now; None if it is the same.

        Raises
        ------
        ValueError
            As `prepare`.
        """
        same = scene_of(settings, self.order).digest == self.scene.digest
        return None if same else self._plant(settings)

    def change(self, settings: Settings, plant: Plant | None) -> None:
        """Take over other settings, and the state into another plant if there is one."""
        state = self.state
        state.settings = settings
        if plant is not None:
            if plant.compiled is not self.plant.compiled:
                state.simulation = plant.compiled.simulator.converted(state.simulation)
            self._take_over(plant)

    def restore(self, state: ArmState) -> None:
        """Continue from a copy of a state, of an arm with the same robot and first settings.

        Raises
        ------
        ValueError
            If the state is of another arm; with the difference.
        """
        if state.robot != self.robot.digest:
            raise ValueError(
                f'the state is of a robot with the digest {state.robot[:12]!r}, expected '
                f'{cut(self.robot.name)!r} with {self.robot.digest[:12]!r}'
            )
        values = (
            (field.name, getattr(state.first, field.name), getattr(self.state.first, field.name))
            for field in fields(state.first)
            if field.name not in PER_RUN
        )
        different = [
            f'{name}={cut(repr(theirs))}, expected {cut(repr(ours))}'
            for name, theirs, ours in values
            if theirs != ours
        ]
        if different:
            raise ValueError(f'the state is of an arm with {"; ".join(different)}')
        plant = self.plant_of(state.settings)
        if plant is not None:
            self._take_over(plant)
        self.state = state.copy()
        self._cycles = None

    def advance(self, effort: NDArray[Any], actuation: ActuatorCommand) -> NDArray[Any]:
        """Do one step under efforts (n,), with the brakes and targets of an actuator command.

        After a failure the arm stops and keeps its last finite state. No step is done if an
        effort of a joint jumps: `jumped` has the efforts then. Returns a copy of the efforts.
        """
        if self.state.failure:
            return effort
        k = self._next_row
        if k == ROWS:
            k = 0
            self._rows = np.empty((ROWS, 4, self.robot.n))
            self._rows_at = self._rows.ctypes.data
        self._next_row = k + 1
        row = self._rows[k]
        wanted: NDArray[Any]
        q, qd, tau, wanted = row
        wanted[:] = effort
        at = self._rows_at + k * row.nbytes
        if self._run(at + 3 * wanted.nbytes, at, 1, actuation):
            state = self.state
            state.q, state.qd, state.tau = q, qd, tau
        elif self.state.actuators.motors.jumped:
            self.jumped = tau
        return wanted

    def run(self, efforts: NDArray[Any], actuation: ActuatorCommand) -> NDArray[Any]:
        """Do a step for each row of efforts (steps, n), with the brakes and targets of a command.

        Returns q, qd and the efforts that acted, (steps, 3, n). The rows end where the arm fails,
        and the last one is then not finite; and before a step in which the effort of a joint
        jumps: `jumped` has the efforts then.
        """
        out, efforts = np.empty((len(efforts), 3, self.robot.n)), np.ascontiguousarray(efforts)
        done = self._run(efforts.ctypes.data, out.ctypes.data, len(out), actuation)
        if done:
            # Copies: whoever gets the rows may change them.
            self.state.q, self.state.qd, self.state.tau = out[done - 1].copy()
        if done < len(out) and self.state.actuators.motors.jumped:
            self.jumped = out[done, 2]
            return out[:done]
        return out[: done + 1]

    def _run(self, efforts: int, out: int, steps: int, actuation: ActuatorCommand) -> int:
        """Run native code on arrays at addresses; return the number of finite steps."""
        state = self.state
        state.braked = actuation.braked
        try:
            done: int = self._bound(actuation).run_at(efforts, out, steps)
        except (ValueError, ArithmeticError) as error:
            self._fail(f'step {state.step + 1} failed: {error}')
            return 0
        state.step += done
        if done < steps and not state.actuators.motors.jumped:
            if state.simulation.status == 'too_many_events':
                self._fail(f'step {state.step + 1} has too many impacts and reversals of joints')
            else:
                self._fail(f'the state after step {state.step + 1} is not finite')
        return done

    def _bound(self, actuation: ActuatorCommand) -> Any:
        """Return the native code, bound to the state, with the inputs of the next step."""
        state, cycles = self.state, self._cycles
        wrench = None if state.wrench is None else state.wrench.acting
        bound = cycles is not None and cycles.state is state.simulation
        if bound and actuation is self._actuation and wrench is self._wrench:
            return cycles
        last, self._actuation = (self._actuation if bound else None), actuation
        if not bound:
            motors = state.actuators.motors
            cycles = self._simulator.bind(state.simulation, motors, self.limits)
            self._cycles = cycles
        if last is None or last.braked is not actuation.braked or wrench is not self._wrench:
            # Only once they are checked: an error must come again.
            self._actuation = None
            self._simulator.set_inputs(
                state.simulation, wrench=wrench, brakes=actuation.braked, **self._payload_input
            )
            self._actuation, self._wrench = actuation, wrench
        if last is None or actuation.position is not last.position:
            cycles.set_targets(actuation.position, actuation.velocity)
        return cycles

    def set_limits(self, limits: NDArray[Any]) -> None:
        """Set the limits of the motors and gains, (7, n), from the next step on."""
        self.limits, self._cycles = limits, None

    def _fail(self, why: str) -> None:
        self.state.failure = why
        self.state.failures += 1

    def clear_failure(self, step: int) -> None:
        """Let an arm that failed continue from its initial state, at the time of this step.

        Raises
        ------
        ValueError
            If no stamp holds that time: only a damaged recording has such a gap.
        """
        state = self.state
        if not state.failure:
            return
        if state.origin_ns + step * self._step_ns > LATEST_NS:
            raise ValueError(f'a reset after step {step}, whose time overflows a stamp')
        state.failure = ''
        state.step = step - 1
        state.simulation = self._simulator.new_state(self.start)
        self._end_step(np.zeros(len(self.order)))

    def jump(self, changes: Sequence[StateChange | None]) -> None:
        """Do a step that ends in the state of these changes; None means the initial state."""
        state = self.state
        if state.failure:
            return
        q, qd = state.q.copy(), state.qd.copy()
        for change in changes:
            if change is None:
                q, qd = self.start.copy(), np.zeros_like(qd)
            else:
                joints = list(change.joints)
                q[joints], qd[joints] = change.positions, change.velocities
        state.simulation = self._simulator.new_state(q, qd)
        self._end_step(np.zeros(len(self.order)))

    def _end_step(self, effort: NDArray[Any]) -> None:
        state = self.state
        state.step += 1
        arrays = state.simulation.arrays
        state.q, state.qd, state.tau = arrays['q'].copy(), arrays['qd'].copy(), effort


def _plant_of(scene: pfd.Scene, compiled: Compiled) -> Plant:
    payload = payload_of(scene)
    return Plant(scene, compiled, () if payload is None else payload_numbers(payload))
