# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuators: from commanded efforts and targets to the efforts that act on the joints.

    effort = commanded effort + p (target - position) + d (target velocity - velocity)

within the limits of the motors. Native code computes the effort once a step, and it is constant
over the step: the effort in joint_states is exactly the effort that acted. It is the effort after
the limits, without friction and without the torque of gravity compensation: commands and states
have one convention. Motors with a lag follow it. A reflex, if there is one, brakes all joints in
the step in which an effort would jump.

See docs/decisions/0033-one-state-one-step.md and 0032-one-table-of-effects.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.plant_settings import in_model_order
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import State
from pfd_ros.text import cut

# For a joint whose model states no limit: the weight of all links at an arm of 5 m, N m or N, and
# at least 1000; rad/s or m/s.
LEVER, WIDE_EFFORT, WIDE_SPEED = 50.0, 1000.0, 100.0


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


def trip(state: State, wanted: NDArray[Any], names: Sequence[str], largest_jump: float) -> None:
    """Note why the reflex acts: one of the wanted efforts (n,) jumped."""
    # Halves: a difference of the largest numbers would overflow.
    halves = np.abs(0.5 * wanted - 0.5 * state.motors.before)
    joint = int(np.nanargmax(halves))
    state.trips += 1
    state.tripped = (
        f'the effort of {cut(names[joint])!r} changed by {2.0 * float(halves[joint]):.6g} '
        f'in one step, limit {largest_jump:.6g}'
    )


def restart(state: State) -> None:
    """Discard the last efforts, and end a reflex."""
    state.tripped = ''
    state.motors.before[:] = np.nan
