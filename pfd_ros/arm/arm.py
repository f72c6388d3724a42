# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm: its state, what follows from its settings, and the native code that is bound to both.

Native code reads efforts and targets, and writes positions, velocities and efforts, where the
state holds them. Only brakes, wrench and payload are handed over, when they have changed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm import actuators
from pfd_ros.arm.actuators import Actuators, Link, stop
from pfd_ros.arm.plant import Plant, Plants
from pfd_ros.arm.plant_settings import check_joints_without_values, in_model_order
from pfd_ros.arm.sensors import Sensors
from pfd_ros.arm.settings import Settings, check_counts, joint_order
from pfd_ros.arm.state import ACTED, BRAKE, EFFORT, POSITION, State


class Arm:
    """An arm at the start of a run; ValueError if the settings do not go with the robot.

    Attributes
    ----------
    names, order, place
        The name and the index in the model of each joint, in published order; index by name.
    locked
        The position of each joint that is published though it is welded, by name.
    start
        Positions (n,) in model order, rad or m, before the first step and after a reset.
    plant, actuators, sensors, link
        What follows from the settings now; no sensors where states are measured exactly.
    """

    def __init__(self, settings: Settings, robot: pfd.Robot) -> None:
        check_counts(settings, robot.n)
        self.robot = robot
        self.order = np.array(joint_order(settings.joints, robot))
        self.names = tuple(robot.joint_names[k] for k in self.order)
        self.place = {name: k for k, name in enumerate(robot.joint_names)}
        self.locked = settings.locks if settings.publish_locked else {}
        check_joints_without_values(settings, robot, self.names)
        same = list(self.order) == list(range(robot.n))
        self.all_joints: Any = slice(None) if same else self.order
        self.start = in_model_order(settings.initial_positions, self.order)
        self.plants = Plants(settings, robot, self.order)
        plant = self.plants.prepare(settings)
        simulator = plant.simulator
        outside = simulator.outside_stops(self.start)
        if outside:
            warnings.warn(f'initial_positions: {outside}', pfd.PhysicsWarning, stacklevel=2)
        settings = replace(
            settings,
            integrator=simulator.integrator,
            method=simulator.method,
            position_sums='compensated' if simulator.compensated else 'plain',
            recording_time=settings.log_time,
        )
        self.lockstep, self._step_ns = settings.lockstep, settings.step_ns
        self._delay = settings.state_delay_steps
        waits = settings.lockstep and settings.wait_for_controller
        count, none = robot.n, np.full(robot.n, np.nan)
        acting = np.array([np.zeros(count), np.ones(count), none, none])
        self.state = State(
            robot=robot.digest,
            first=settings,
            settings=settings,
            simulation=simulator.new_state(self.start),
            motors=pfd.MotorState(np.zeros(count)),
            acting=acting,
            newest=acting.copy() if settings.command_delay_steps else acting,
            rows=np.zeros((self._delay + 2, 3, count)),
            origin_ns=settings.start_ns,
            since_ns=settings.start_ns,
            reset_ns=settings.start_ns,
            active=settings.autostart,
            waits=waits,
            commanded=waits,
        )
        self.state.rows[0, 0] = self.start
        self.derive(plant)

    def derive(self, plant: Plant) -> None:
        """Take over what follows from the settings in the state, of which this is the plant."""
        settings = self.state.settings
        sensors = Sensors(settings, self.order, plant)
        self.plant, self.sensors = plant, None if sensors.exact else sensors
        self.actuators = Actuators(settings, self.robot, self.order, plant.scene)
        self.link = Link(settings)
        self.watches = actuators.watches(settings, self.robot, self.order, plant)
        # Whether each cycle has to look at the link and at the wrench, and whether the next one
        # tells about the payload.
        self.watched, self.wrenched = not self.link.idle, plant.scene.external_wrench
        self.tells = plant.payload != self.state.told
        self._bind()

    def _bind(self) -> None:
        state = self.state
        self._native = self.plant.simulator.bind(
            state.simulation, state.motors, self.actuators.limits, state.acting[POSITION:]
        )
        self._effort_at, self.newest_effort = state.acting.ctypes.data, state.newest[EFFORT]
        at = [row.ctypes.data for row in state.rows]
        self._following = [((k + 1) % len(at), at[(k + 1) % len(at)]) for k in range(len(at))]
        self.note_inputs()

    def note_inputs(self) -> None:
        """Note that brakes or targets are others: native code gets them before the next step."""
        newest = self.state.newest
        self.braked = bool(newest[BRAKE].any())
        self.targets = bool((newest[POSITION:] == newest[POSITION:]).any())
        self.stale = True
        # Then an effort alone is written in place, and that is all.
        self.direct = not (self.braked or self.targets or self.link.drop or self.link.delay)

    @property
    def stamp_ns(self) -> int:
        """Simulated time, ns: whole steps, so that it never drifts."""
        return self.state.origin_ns + self.state.step * self._step_ns

    def measured(self) -> NDArray[Any]:
        """Return measured positions, velocities and efforts, (3, n), published order."""
        state = self.state
        row = state.rows[state.now] if self.sensors is None else self.sensors.measured(state)
        # A copy: rows are overwritten.
        found: NDArray[Any] = row[:, self.all_joints].copy()
        return found

    def discard_commands(self, *, brake: bool = False) -> None:
        """Drop all commands from before the next step; the brakes are closed or as they are."""
        stop(self.state, brake=brake)
        actuators.restart(self.state)
        self.state.since_ns = self.stamp_ns + self._step_ns
        self.note_inputs()

    def advance(self) -> None:
        """Do one step; a reflex does it again, braked."""
        state = self.state
        following, at = self._following[state.now]
        try:
            if self.stale:
                self._set_inputs()
            done = self._native.run_at(self._effort_at, at, 1)
        except (ValueError, ArithmeticError) as error:
            self.fail(f'step {state.step + 1} failed: {error}')
            return
        if done:
            state.step += 1
            state.now = following
            if state.age < self._delay:
                state.age += 1
            if self.watches:
                why = actuators.violated(state, self.watches, self.robot.joint_names)
                if why:
                    self._brake(why)
        elif state.motors.jumped:
            # Native code has ended before the step; the efforts that it wanted are in the row.
            wanted = state.rows[following, 2]
            names, most = self.robot.joint_names, self.actuators.largest_jump
            self._brake(actuators.jumped(state, wanted, names, most))
            self.advance()
        elif state.simulation.status == 'too_many_events':
            self.fail(f'step {state.step + 1} has too many impacts and reversals of joints')
        else:
            self.fail(f'the state after step {state.step + 1} is not finite')

    def _brake(self, why: str) -> None:
        """Let a reflex brake all joints from the next step on."""
        actuators.trip(self.state, why)
        stop(self.state, brake=True)
        self.note_inputs()

    def _set_inputs(self) -> None:
        state = self.state
        if state.settings.reflex_effort_start:
            released = (state.simulation.arrays['free'] == 0.0) & (state.acting[BRAKE] == 0.0)
            state.motors.before[released] = 0.0
        self.plant.simulator.set_inputs(
            state.simulation,
            wrench=state.wrench[ACTED] if self.wrenched else None,
            brakes=state.acting[BRAKE] > 0.0,
            **self.plant.inputs,
        )
        # Only once they are checked: an error must come again.
        self.stale = False

    def fail(self, why: str) -> None:
        """Stop the simulation, unless it has stopped before."""
        if not self.state.failure:
            self.state.failure = why
            self.state.failures += 1

    def jump(self) -> None:
        """Do a step that ends in the state to jump to, unless the arm has failed."""
        state = self.state
        target, state.jump = state.jump, None
        if state.failure or target is None:
            return
        state.step += 1
        state.now, state.age = (state.now + 1) % len(state.rows), 0
        state.simulation = self.plant.simulator.new_state(*target)
        arrays = state.simulation.arrays
        state.rows[state.now] = arrays['q'], arrays['qd'], np.zeros(len(self.order))
        self._bind()
