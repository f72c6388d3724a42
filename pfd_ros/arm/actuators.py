# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuators: from commanded efforts and targets to the efforts that act on the joints.

    effort = commanded effort + p (target - position) + d (target velocity - velocity)

within the limits of the motors. As drives do, they decide once per cycle and hold the effort for
it; so the effort that joint_states tells is exactly the one that acted. It is the effort after the
limits, without friction, and without the gravity torque that drives with gravity compensation add:
commands and states have one convention. Motors with a lag follow it.

See docs/decisions/0019-limits-of-actuators.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.command_settings import check_servo
from pfd_ros.arm.drive import Drive, Gains, held
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import ActuatorState
from pfd_ros.text import cut

# For a joint whose model states no limit: the weight of all links at an arm of 5 m, N m or N, and
# at least 1000; rad/s or m/s.
LEVER, WIDE_EFFORT, WIDE_SPEED = 50.0, 1000.0, 100.0


def effort_limits(robot: pfd.Robot) -> np.ndarray:
    """Return the largest effort of each joint, (n,) in model order, N m or N; all are finite."""
    wide = max(WIDE_EFFORT, LEVER * float(np.sum(robot.masses)))
    return _stated(robot.effort_limit, wide)


def speed_limits(robot: pfd.Robot) -> np.ndarray:
    """Return the speed up to which each motor has its full effort, (n,) in model order, finite."""
    return _stated(robot.velocity_limit, WIDE_SPEED)


def _stated(limits: np.ndarray, wide: float) -> np.ndarray:
    # Many models hold 0 for a limit that nobody knew.
    return np.where((limits > 0.0) & (limits < np.inf), limits, wide)


class Actuators:
    """The actuators of one arm: what its settings decide; their state is an ActuatorState.

    All arrays are in model order.

    Attributes
    ----------
    gains
        Of the servos, None if all are zero.
    limits
        Limits of the motors, (4, n), as pfd_core.MotorSimulator.bind takes them.

    Parameters
    ----------
    settings, robot
        Of the arm, as they are now.
    order
        Index in the model of each joint, in published order.
    """

    def __init__(self, settings: Settings, robot: pfd.Robot, order: Sequence[int]) -> None:
        check_servo(settings)
        self._names = robot.joint_names
        full, speeds = effort_limits(robot), speed_limits(robot)
        endless = np.full(robot.n, np.inf)
        self.limits = np.array(
            [
                full if settings.effort_limits else endless,
                *((full, speeds) if settings.torque_speed else (endless, endless)),
                speeds,
            ]
        )
        p, d = (in_model_order(x, order) for x in (settings.servo_p, settings.servo_d))
        self._gains = Gains(p, d)
        self.gains = self._gains if p.any() or d.any() else None
        self._servo: _Servo | None = None
        rate = settings.reflex_effort_rate
        self._largest_jump = rate * settings.step_size if rate else np.inf

    @property
    def has_reflex(self) -> bool:
        """Whether a reflex looks at the efforts."""
        return self._largest_jump < np.inf

    def wanted(self, state: ActuatorState, drive: Drive, q: np.ndarray, qd: np.ndarray) -> Drive:
        """Return the efforts and brakes of the next step before the limits of the motors.

        Parameters
        ----------
        state
            Of these actuators.
        drive
            As commanded.
        q, qd
            Positions and velocities of the joints, (n,), rad or m, rad/s or m/s.
        """
        if drive.position is not None:
            drive = Drive(self._followed(drive, q, qd), drive.braked)
        if not self.has_reflex:
            state.before = None
        elif self._jumps(state, drive):
            return held(len(drive.effort))
        return drive

    def _followed(self, drive: Drive, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the efforts of servos on the way to their targets, (n,)."""
        if self._servo is None or self._servo.drive is not drive:
            self._servo = _servo(drive, self._gains)
        _, p, position, d, velocity = self._servo
        effort: np.ndarray = drive.effort + p * (position - q) + d * (velocity - qd)
        return effort

    def _jumps(self, state: ActuatorState, wanted: Drive) -> bool:
        """Return whether an effort jumps by more than the reflex allows.

        The first effort of a joint that comes off its brake may be any: the brake held its load.
        """
        before, state.before = state.before, wanted
        if before is None or state.tripped:
            return state.tripped
        # Halves: a difference of the largest numbers would overflow.
        halves = np.abs(0.5 * wanted.effort - 0.5 * before.effort)
        halves[before.braked | wanted.braked] = 0.0
        joint = int(np.argmax(halves))
        jump = 2.0 * float(halves[joint])
        if jump > self._largest_jump:
            state.tripped = True
            state.trips += 1
            state.reflex = (
                f'the effort of {cut(self._names[joint])!r} jumped by {jump:.6g} in a '
                f'cycle, expected {self._largest_jump:.6g} at most; ~/reset ends it'
            )
        return state.tripped


def restart(state: ActuatorState) -> None:
    """Discard the last efforts, and end a reflex."""
    state.tripped = False
    state.before = None


def in_model_order(values: Sequence[float], order: Sequence[int]) -> np.ndarray:
    """Return a setting with a number for each joint in model order, (n,); zeros if it is empty."""
    numbers = np.zeros(len(order))
    if values:
        numbers[list(order)] = values
    return numbers


class _Servo(NamedTuple):
    """Gains and targets of one drive, (n,): a joint without a target has the gain 0."""

    drive: Drive
    p: np.ndarray
    position: np.ndarray
    d: np.ndarray
    velocity: np.ndarray


def _servo(drive: Drive, gains: Gains) -> _Servo:
    position, velocity = np.array([drive.position, drive.velocity])
    there, moving = ~np.isnan(position), ~np.isnan(velocity)
    return _Servo(
        drive,
        np.where(there, gains.p, 0.0),
        np.where(there, position, 0.0),
        # To a position without a velocity it goes to stay there.
        np.where(there | moving, gains.d, 0.0),
        np.where(moving, velocity, 0.0),
    )
