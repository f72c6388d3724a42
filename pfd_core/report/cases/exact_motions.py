# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motions of one wheel with a closed form, through events and motors (EXACT).

A wheel of inertia J about its joint, without gravity, moves by parabolas between events. Torques
are constant for whole steps of STEP seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import math

from pfd_core.model import Robot, Scene
from pfd_core.report.cases.robots import chain

STEP = 2.0**-10
WHEEL: Robot = chain(1, 'y')


@dataclass(frozen=True)
class ExactMotion:
    """
    A motion of WHEEL, with its angle at the end.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why the motion is hard.
    scene : Scene
        Effects, without gravity.
    torques : sequence of (float, int)
        Torque [N m] and for how many steps it is commanded.
    end : callable
        Returns the angle at the end [rad], from the inertia J [kg m^2].
    q, qd : float
        State at the start.
    events : int
        Impacts, and changes between rest and motion.
    method : callable
        Bound of the integrator's own error [rad], from J.

    """

    name: str
    cause: str
    scene: Scene
    torques: Sequence[tuple[float, int]]
    end: Callable[[float], float]
    q: float = 0.0
    qd: float = 0.0
    events: int = 0
    method: Callable[[float], float] = field(default=lambda J: 0.0)

    @property
    def steps(self) -> int:
        """Steps of the motion."""
        return sum(count for _, count in self.torques)


# Coulomb and static friction [N m], and a torque above both for PULL steps. Without torque the
# wheel then slides on for a little more than PULL steps, and sticks.
COULOMB, STATIC, PULLED, PULL, CYCLES = 1.0, 2.0, 3.0, 64, 5


def _stick_slip(J: float) -> float:
    """Return the angle of CYCLES pulls: accelerated by PULLED - COULOMB, slowed by COULOMB."""
    time = PULL * STEP
    speed = (PULLED - COULOMB) / J * time
    return CYCLES * (speed * time / 2 + speed**2 / 2 / (COULOMB / J))


# A torque towards a stop at zero, from which the wheel rebounds.
PUSH, RESTITUTION, HEIGHT, FLIGHT = 2.0, 0.75, 0.5, 512


def _bounces(J: float) -> float:
    """Return the angle above the stop after FLIGHT steps, bounce by bounce."""
    a, left = PUSH / J, FLIGHT * STEP - math.sqrt(2 * HEIGHT / (PUSH / J))
    speed = RESTITUTION * math.sqrt(2 * HEIGHT * a)
    while left > 2 * speed / a:
        left -= 2 * speed / a
        speed *= RESTITUTION
    return speed * left - a * left**2 / 2


LIMIT, COMMAND, SATURATED = 1.5, 10.0, 512
LAG, LAGGING = 2.0**-4, 1024


def _saturated(J: float) -> float:
    """Return the angle of LIMIT for SATURATED steps, and of -LIMIT for as many, to rest."""
    return LIMIT / J * (SATURATED * STEP) ** 2


def _lagging(J: float) -> float:
    """Return the angle under the torque 1 - exp(-t / LAG) [N m]: the command is 1 N m."""
    t = LAGGING * STEP
    return (t**2 / 2 - LAG * t - LAG**2 * math.expm1(-t / LAG)) / J


EXACT: Sequence[ExactMotion] = (
    ExactMotion(
        'stick_slip',
        'the wheel sticks, slips and comes to rest again',
        Scene(gravity=None, friction=(COULOMB,), static_friction=(STATIC,)),
        # Held below the static friction, pulled, without torque until it rests, held again.
        [((STATIC + COULOMB) / 2, 128), (PULLED, PULL), (0.0, 4 * PULL)] * CYCLES,
        _stick_slip,
        events=2 * CYCLES,
    ),
    ExactMotion(
        'impacts',
        'impacts at a stop reverse the velocity within a step, several times',
        Scene(gravity=None, joint_limits=((0.0, 3.0),), restitution=RESTITUTION),
        [(-PUSH, FLIGHT)],
        _bounces,
        q=HEIGHT,
        events=4,
    ),
    ExactMotion(
        'saturated_motor',
        'the motor torque is limited to a seventh of its command',
        Scene(gravity=None, effort_limits=(LIMIT,)),
        [(COMMAND, SATURATED), (-COMMAND, SATURATED)],
        _saturated,
    ),
    ExactMotion(
        'motor_lag',
        'the motor torque lags its command',
        Scene(gravity=None, motor_lag=(LAG,)),
        [(1.0, LAGGING)],
        _lagging,
        # Runge-Kutta's relative error of exp(-h / T) a step, (h / T)^5 / 120, times the steps.
        method=lambda J: LAG**2 / J * (STEP / LAG) ** 4 / 120 * LAGGING * STEP / LAG,
    ),
)
