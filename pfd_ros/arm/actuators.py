# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuators: from accepted commands to the efforts that act on the joints.

    accepted command -> drop-out (drop.commands) -> delay (delay.commands) -> actuators

    effort = commanded effort + p (target - position) + d (target velocity - velocity)

within the limits of the motors. Native code computes the effort once a step, and it is constant
over the step: the effort in joint_states is exactly the effort that acted. It is the effort after
the limits, without friction and without the torque of gravity compensation: commands and states
have one convention. Motors with a lag follow it. A reflex, if there is one, brakes all joints in
the step in which an effort would jump; and after a step in which a joint has left its limits, or
the external wrench is too large. Commands are refused then until a reset.

The delay applies to targets and feed-forward efforts; servos act after it, on the true state. So
does the watchdog: after `command_timeout` without a command it brakes the joints, sets zero
efforts, or has the servos hold the position, until the next command; or it is a reflex, which ends
at a reset. Commands in flight are lost then. It counts cycles, so it stops in a pause, and a
replay is equal.

See docs/decisions/0033-one-state-one-step.md and 0032-one-table-of-effects.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.conventions import named
from pfd_ros.arm.noise import Channel, uniform
from pfd_ros.arm.plant import EXTERNAL, Plant
from pfd_ros.arm.plant_settings import in_model_order
from pfd_ros.arm.settings import Settings, timeout_steps
from pfd_ros.arm.state import ACTED, BRAKE, EFFORT, POSITION, VELOCITY, State
from pfd_ros.text import cut

# For a joint whose model states no limit: the weight of all links at an arm of 5 m, N m or N, and
# at least 1000; rad/s or m/s.
LEVER, WIDE_EFFORT, WIDE_SPEED = 50.0, 1000.0, 100.0
# Reactions of the watchdog, by `on_timeout`.
ACTIONS = {
    'brake': 'brakes on',
    'zero': 'zero efforts',
    'hold': 'servos hold the position',
    'stop': 'brakes on until ~/reset',
}
# Settings of the reflexes.
REFLEXES = 'reflex_effort_rate', 'reflex_position', 'reflex_velocity', 'reflex_external_effort'


def has_reflex(settings: Mapping[str, Any]) -> bool:
    """Return whether settings, by field, have a reflex."""
    return settings.get('on_timeout') == 'stop' or any(settings.get(x) for x in REFLEXES)


def speed_limits(robot: pfd.Robot) -> NDArray[Any]:
    """Return the speed up to which each motor has its full effort, (n,) in model order, finite."""
    return np.where(np.isfinite(robot.velocity_limit), robot.velocity_limit, WIDE_SPEED)


class Actuators:
    """What the settings decide about the actuators; arrays in model order.

    `p` and `d` are the gains of the servos (n,), of which `servo` says whether one is not zero.
    Beyond `largest_jump`, N m or N, of an effort in a step a reflex acts. `limits` are limits of
    the motors and gains, (7, n), as pfd_core.MotorSimulator.bind takes them; limits of the scene
    act within the step, in the place of those here.
    """

    def __init__(
        self, settings: Settings, robot: pfd.Robot, order: NDArray[Any], scene: pfd.Scene
    ) -> None:
        self.p, self.d = (in_model_order(x, order) for x in (settings.servo_p, settings.servo_d))
        self.servo = bool(self.p.any() or self.d.any())
        rate = settings.reflex_effort_rate
        self.largest_jump = rate * settings.step_size if rate else np.inf
        wide = max(WIDE_EFFORT, LEVER * float(np.sum(robot.masses)))
        full = np.where(np.isfinite(robot.effort_limit), robot.effort_limit, wide)
        speeds = speed_limits(robot)
        endless = np.full(robot.n, np.inf)
        table = settings.torque_speed and scene.torque_speed is None
        # The first row of a torque-speed table is the largest torque at any speed.
        limited = table or (settings.effort_limits and scene.effort_limits is None)
        self.limits = np.array(
            [
                full if limited else endless,
                *((full, speeds) if table else (endless, endless)),
                speeds,
                self.p,
                self.d,
                np.full(robot.n, self.largest_jump),
            ]
        )


class Watch(NamedTuple):
    """A reflex on numbers after a step, (n,) in model order, with the bounds of each joint."""

    # Its setting, what is bounded, and the numbers of a state.
    setting: str
    what: str
    values: Callable[[State], NDArray[Any]]
    lower: NDArray[Any]
    upper: NDArray[Any]


def watches(
    settings: Settings, robot: pfd.Robot, order: NDArray[Any], plant: Plant
) -> list[Watch]:
    """Return the reflexes of settings that look at the state after a step."""
    found = []
    if settings.reflex_position:
        bounds = robot.position_lower, robot.position_upper
        found.append(Watch('reflex_position', 'position', lambda s: s.rows[s.now, 0], *bounds))
    if settings.reflex_velocity:
        most = robot.velocity_limit
        found.append(Watch('reflex_velocity', 'velocity', lambda s: s.rows[s.now, 1], -most, most))
    if EXTERNAL in plant.kernels:
        torques = plant.kernels[EXTERNAL]
        most = in_model_order(settings.reflex_external_effort, order)
        most = np.where(most > 0.0, most, np.inf)
        found.append(
            Watch(
                'reflex_external_effort',
                'external effort',
                lambda s: torques(s.rows[s.now, 0], wrench=s.wrench[ACTED]),
                -most,
                most,
            )
        )
    return found


def violated(state: State, found: Sequence[Watch], names: Sequence[str]) -> str:
    """Return why a reflex acts on the state of a step, '' if none does; not on braked joints."""
    for watch in found:
        values = watch.values(state)
        beyond = (values < watch.lower) | (values > watch.upper)
        if not beyond.any():  # as almost always
            continue
        for k in np.flatnonzero(beyond & (state.acting[BRAKE] == 0.0)).tolist():
            bound = (watch.upper if values[k] > watch.upper[k] else watch.lower)[k]
            text = f'the {watch.what} of {cut(names[k])!r} is {values[k]:.6g}, limit {bound:.6g}'
            return named(state.settings.convention, watch.setting, text)
    return ''


def trip(state: State, why: str) -> None:
    """Note why a reflex acts."""
    state.trips += 1
    state.tripped = why


def jumped(state: State, wanted: NDArray[Any], names: Sequence[str], largest_jump: float) -> str:
    """Return why the reflex acts: one of the wanted efforts (n,) jumped."""
    # Halves: a difference of the largest numbers would overflow.
    halves = np.abs(0.5 * wanted - 0.5 * state.motors.before)
    joint = int(np.nanargmax(halves))
    text = (
        f'the effort of {cut(names[joint])!r} changed by {2.0 * float(halves[joint]):.6g} '
        f'in one step, limit {largest_jump:.6g}'
    )
    return named(state.settings.convention, 'reflex_effort_rate', text)


def restart(state: State) -> None:
    """Discard the last efforts, and end a reflex."""
    state.tripped = ''
    state.motors.before[:] = np.nan


def timeout_text(settings: Settings) -> str:
    """Return the line about a watchdog that has acted."""
    seconds, action = settings.command_timeout, ACTIONS[settings.on_timeout]
    return f'no command for {seconds:g} s (command_timeout): {action}'


class Link:
    """What the settings decide about the link.

    `drop` is the share of the commands that are lost, and after `delay` cycles one acts. If it is
    `idle`, nothing acts but commands, at once.
    """

    def __init__(self, settings: Settings) -> None:
        self._on_timeout, self._seed = settings.on_timeout, settings.seed
        self.drop, self.delay = settings.drop_commands, settings.command_delay_steps
        self._convention, self._seconds = settings.convention, settings.command_timeout
        self._timeout = timeout_steps(settings.command_timeout, settings.step_size)
        self.idle = not self.delay and math.isinf(self._timeout)

    def loses(self, state: State) -> bool:
        """Return whether chance loses a command that was sent."""
        lost = bool(uniform(self._seed, Channel.COMMAND_DROP, state.sent, 1)[0] < self.drop)
        state.lost += lost
        return lost

    def send(self, state: State) -> None:
        """Let the newest command act after the delay."""
        arrival = state.cycle + 1 + self.delay
        if state.line and state.line[-1][0] == arrival:
            state.line.pop()
        state.line.append((arrival, state.newest.copy()))

    def advance(self, state: State) -> bool:
        """Begin a cycle; return whether brakes have changed, which native code must be told."""
        changed = False
        while state.line and state.line[0][0] <= state.cycle:
            arrived = state.line.pop(0)[1]
            # To compare the brakes is faster than to set all inputs.
            changed |= arrived[BRAKE].tobytes() != state.acting[BRAKE].tobytes()
            state.acting[:], state.heard = arrived, state.cycle
        if state.heard is None or state.cycle - state.heard < self._timeout:
            return changed
        if self._on_timeout == 'hold':
            held = np.where(state.acting[BRAKE] > 0.0, np.nan, state.rows[state.now, 0])
            stop(state)
            state.acting[POSITION] = state.newest[POSITION] = held
        else:
            stop(state, brake=self._on_timeout in ('brake', 'stop'))
        state.silenced = True
        state.timeouts += 1
        # A reflex ignores the jumps that the watchdog causes.
        restart(state)
        if self._on_timeout == 'stop':
            text = f'no command for {self._seconds:g} s'
            trip(state, named(self._convention, 'command_timeout', text))
        return True


def stop(state: State, *, brake: bool = False) -> None:
    """Discard all commands: zero efforts, no targets, the brakes closed or as they are."""
    acting = state.acting
    acting[EFFORT] = 0.0
    acting[[POSITION, VELOCITY]] = np.nan
    if brake:
        acting[BRAKE] = 1.0
    state.newest[:] = acting
    state.line.clear()
    state.trajectory = None
    state.heard, state.silenced = None, False
