# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuators: from commanded efforts and targets to the efforts that act on the joints.

    effort = commanded effort + p (target - position) + d (target velocity - velocity)

within the limits of the motors. As drives do, they decide once per cycle and hold the effort for
it; so the effort that joint_states tells is exactly the one that acted. It is the effort after the
limits, without friction, and without the gravity torque that drives with gravity compensation add:
commands and states have one convention. Motors with a lag follow it.

See docs/decisions/0019-limits-of-actuators.md and 0032-one-table-of-effects.md.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.command_settings import check_servo
from pfd_ros.arm.drive import Drive, Gains, held
from pfd_ros.arm.settings import Settings
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
    """The drives of one arm.

    Attributes
    ----------
    gains
        Of the servos, None if all are zero.
    saturated
        Cycles in which a limit cut an effort.
    tripped
        Whether a reflex has braked all joints, until `restart`.
    trips, reflex
        How often it has, and why it did last.
    speeds
        Speed up to which each motor has its full effort, (n,) in model order, rad/s or m/s.
    fast_cycles
        Cycles in which a joint was beyond its velocity limit.
    peaks
        Largest speed of each joint beyond its limit so far, as a multiple of the limit, in
        published order; 0 for a joint that was never beyond.

    Parameters
    ----------
    settings, robot
        Of the arm.
    order
        Index in the model of each joint, in published order.
    scene
        Of the arm. Limits of its own act within the step, in the place of those here.
    """

    def __init__(
        self,
        settings: Settings,
        robot: pfd.Robot,
        order: Sequence[int],
        scene: pfd.Scene | None = None,
    ) -> None:
        self.saturated = self.trips = self.fast_cycles = 0
        self.peaks = [0.0] * len(order)
        self.reflex = ''
        self._names = robot.joint_names
        self._order = list(order)
        self._place = np.argsort(order)
        self._full, self.speeds = effort_limits(robot), speed_limits(robot)
        self._scene = scene or pfd.Scene()
        self._servo: _Servo | None = None
        # The drive of the last cycle, before the limits, where a reflex looks at it.
        self._before: Drive | None = None
        self.tripped = False
        check_servo(settings)
        self.set(settings)

    def set(self, settings: Settings) -> None:
        """Take over settings."""
        full, endless = self._full.tolist(), [math.inf] * len(self._order)
        speeds = self.speeds.tolist()
        self._torque_speed = settings.torque_speed and self._scene.torque_speed is None
        # The first row of a torque-speed table is the largest torque at any speed.
        limited = settings.effort_limits and self._scene.effort_limits is None
        most = full if limited or self._torque_speed else endless
        # Index in the model, largest effort, speed up to which the motor has it, and effort of
        # the motor, of each joint in published order.
        self._motors = [(i, most[i], speeds[i], full[i]) for i in self._order]
        self._gains = Gains(self._of_joints(settings.servo_p), self._of_joints(settings.servo_d))
        self.gains = self._gains if self._gains.p.any() or self._gains.d.any() else None
        self._servo = None
        rate = settings.reflex_effort_rate
        self._largest_jump = rate * settings.step_size if rate else np.inf
        if not rate:
            self._before = None

    def restart(self) -> None:
        """Forget the last efforts and the reflex that they tripped."""
        self.tripped = False
        self._before = None

    def _of_joints(self, values: Sequence[float]) -> np.ndarray:
        """Return a setting with a number for each joint in model order, (n,)."""
        return np.array(values)[self._place] if values else np.zeros(len(self._order))

    def applied(self, drive: Drive, q: np.ndarray, qd: np.ndarray) -> Drive:
        """Return the efforts and brakes of the next step.

        Parameters
        ----------
        drive
            As commanded.
        q, qd
            Positions and velocities of the joints, (n,) in published order, rad or m, rad/s or
            m/s.
        """
        wanted = drive.effort if drive.position is None else self._followed(drive, q, qd)
        if self._largest_jump < np.inf and self._jumps(Drive(wanted, drive.braked)):
            return held(len(wanted))
        efforts = wanted.tolist()
        limited = self._limited(efforts, qd.tolist())
        if limited != efforts:
            self.saturated += 1
            wanted = np.array(limited)
        return Drive(wanted, drive.braked)

    def _followed(self, drive: Drive, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the efforts of servos on the way to their targets, (n,) in model order."""
        if self._servo is None or self._servo.drive is not drive:
            self._servo = _servo(drive, self._gains)
        _, p, position, d, velocity = self._servo
        effort: np.ndarray = (
            drive.effort + p * (position - q[self._place]) + d * (velocity - qd[self._place])
        )
        return effort

    def _jumps(self, wanted: Drive) -> bool:
        """Return whether an effort jumps by more than the reflex allows.

        The first effort of a joint that comes off its brake may be any: the brake held its load.
        """
        before, self._before = self._before, wanted
        if before is None or self.tripped:
            return self.tripped
        # Halves: a difference of the largest numbers would overflow.
        halves = np.abs(0.5 * wanted.effort - 0.5 * before.effort)
        halves[before.braked | wanted.braked] = 0.0
        joint = int(np.argmax(halves))
        jump = 2.0 * float(halves[joint])
        if jump > self._largest_jump:
            self.tripped = True
            self.trips += 1
            self.reflex = (
                f'the effort of {cut(self._names[joint])!r} jumped by {jump:.6g} in a '
                f'cycle, expected {self._largest_jump:.6g} at most; ~/reset ends it'
            )
        return self.tripped

    def _limited(self, efforts: list[float], velocities: list[float]) -> list[float]:
        """Return the efforts that motors have at these speeds, in model order.

        These are the limits of Scene(effort_limits='model', torque_speed='model'): beyond its
        speed limit a motor drives its joint along with less, and with none at twice that; it
        brakes it with all.

        Parameters
        ----------
        efforts
            Those wanted, in model order.
        velocities
            Of the joints, in published order.
        """
        # Lists: for a few joints faster than NumPy.
        limited = efforts.copy()
        fast = False
        for (i, most, speed, full), velocity in zip(self._motors, velocities, strict=True):
            effort = efforts[i]
            if not -most <= effort <= most:
                effort = min(max(effort, -most), most)
            if -speed <= velocity <= speed:
                limited[i] = effort
                continue
            fast = True
            place = self._place[i]
            self.peaks[place] = max(self.peaks[place], abs(velocity) / speed)
            if self._torque_speed:
                there = full * max(2.0 - abs(velocity) / speed, 0.0)
                effort = min(effort, there) if velocity > 0.0 else max(effort, -there)
            limited[i] = effort
        self.fast_cycles += fast
        return limited


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
