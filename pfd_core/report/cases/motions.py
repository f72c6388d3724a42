# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Free motions of arms, without torques, and the bounds of their runs.

    FREE          motions that integrators are compared on
    MOTIONS       motions that are hard to integrate, with the scheme of their references
    REFERENCES    stored references of MOTIONS
    CHECKS        runs of MOTIONS with their bounds
    STEADY        motions without acceleration, q(t) = q(0) + qd t. Joints at rest under friction
                  must not creep. A wheel must end at its angle after an hour, although its turns
                  use up the digits of q

FREE and MOTIONS are stored in data/motions.yaml, REFERENCES in data/motion_references.yaml.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from pfd_core.algorithms.programs import record_inverse_dynamics
from pfd_core.forking import cached_property
from pfd_core.machine.emulator import run
from pfd_core.model import Plant, Robot, Scene, load_robot, resolve
from pfd_core.report.cases import problems
from pfd_core.report.cases.robots import chain, robot
from pfd_core.report.cases.stored import table
from pfd_core.simulation.adaptive import AdaptiveTrajectory, integrate


@dataclass(frozen=True)
class Extrapolation:
    """
    How a reference motion is computed.

    Attributes
    ----------
    scheme : {'midpoint', 'implicit'}
        Method of the substeps.
    columns : int
        Sequences of substeps, k.
    digits : int
        Decimal digits of the numbers.

    """

    scheme: str
    columns: int
    digits: int

    @property
    def order(self) -> int:
        """Power of H with which the error of a smooth motion falls."""
        return 2 * self.columns if self.scheme == 'midpoint' else self.columns


# Order 24 in 34 digits, and order 20 in 50 digits for any damping.
MIDPOINT, IMPLICIT = Extrapolation('midpoint', 12, 34), Extrapolation('implicit', 20, 50)


@dataclass(frozen=True)
class Motion:
    """
    A free motion of an arm.

    Attributes
    ----------
    name, cause : str
        Name, and what makes the motion hard.
    robot : Robot
        The arm.
    scene : Scene
        Gravity, damping, friction and rotor inertia.
    q, qd : tuple of float
        State at the start [rad or m, and per s].
    duration : float
        Time of the motion, or of its reference [s].
    steps : int
        Macro steps of the reference.
    halvings : int
        Number of halvings of the first macro step, for a strongly damped motion.
    way : Extrapolation
        Scheme of the reference.
    bounds : mapping
        Number format -> largest allowed error of a motion of STEADY [rad].

    """

    name: str
    cause: str
    robot: Robot = field(repr=False)
    scene: Scene
    q: tuple[float, ...]
    qd: tuple[float, ...]
    duration: float
    steps: int = 0
    halvings: int = 0
    way: Extrapolation = MIDPOINT
    bounds: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def plant(self) -> Plant:
        """The arm in its scene, as numbers."""
        return resolve(self.robot, self.scene)

    def integrated(self, duration: float | None = None, **settings: Any) -> AdaptiveTrajectory:
        """Return the motion by `integrate`, from its start unless the settings have q and qd."""
        start = {'q': self.q, 'qd': self.qd}
        torques = np.zeros(self.robot.n)
        seconds = self.duration if duration is None else duration
        return integrate(self.robot, torques, seconds, scene=self.scene, **start | settings)

    def macro_steps(self, steps: int) -> list[Fraction]:
        """Return the lengths [s] of a number of macro steps and the halvings of the first."""
        length = Fraction(self.duration) / steps
        halved = [length / 2**k for k in range(self.halvings, 0, -1)]
        first = [halved[0], *halved] if halved else [length]
        return first + [length] * (steps - 1)


def _stored(kind: str) -> tuple[Motion, ...]:
    return tuple(_motion(name, **row) for name, row in table('motions')[kind].items())


def _motion(
    name: str,
    cause: str,
    duration: float,
    *,
    arm: str = '',
    problem: Sequence[Any] = (),
    scene: Mapping[str, Any] | None = None,
    q: Any = None,
    qd: Any = None,
    scheme: str = 'midpoint',
    steps: int = 0,
    halvings: int = 0,
) -> Motion:
    if problem:
        maker, *given = problem
        made = getattr(problems, maker)(*given)
        chosen, q, qd = made.plant.robot, *(made.states[key][0].tolist() for key in ('q', 'qd'))
    else:
        chosen = _arm(arm)

    def for_joints(value: Any) -> Any:
        return (value,) * chosen.n if isinstance(value, float) else value

    effects = {key: for_joints(value) for key, value in (scene or {}).items()}
    q, qd = (tuple(for_joints(value)) for value in (q, qd))
    way = IMPLICIT if scheme == 'implicit' else MIDPOINT
    return Motion(name, cause, chosen, Scene(**effects), q, qd, duration, steps, halvings, way)


_arm = cache(robot)
FREE = _stored('free')
MOTIONS = _stored('hard')


@dataclass(frozen=True)
class Reference:
    """
    End of a motion.

    Attributes
    ----------
    q : tuple of str
        Angles [rad] in 25 digits.
    self_difference : float
        Largest distance of an angle from a second computation with longer macro steps.

    """

    q: tuple[str, ...]
    self_difference: float


REFERENCES = {
    name: Reference(tuple(row['q']), row['self_difference'])
    for name, row in table('motion_references').items()
}


@dataclass(frozen=True)
class Check:
    """
    A run of a motion, and its bound.

    Attributes
    ----------
    motion, integrator : str
        Name in MOTIONS, and name of an integrator.
    step : float
        Step [s], or the relative tolerance of an adaptive integrator.
    quantity : {'angle', 'energy'}
        Largest error of an angle at the time of the reference [rad]; or largest error of the
        energy up to `duration` over the peak kinetic energy.
    bound : float
        Largest value allowed.
    duration : float, optional
        Time of the run [s]; default: the reference's.
    dtype : {'float64', 'float32'}
        Number format of a run in fixed steps.

    """

    motion: str
    integrator: str
    step: float
    quantity: str
    bound: float
    duration: float | None = None
    dtype: str = 'float64'


# Bounds were set before these motions were measured, except for the SO-100 and dop853.
CHECKS: Sequence[Check] = (
    *(
        Check(motion, integrator, 1e-3, 'energy', bound, 60.0)
        for motion in ('planar2_swing', 'puma560_fall')
        for integrator, bound in (('velocity_verlet', 2e-5), ('rk4', 1e-9))
    ),
    Check('puma560_fall', 'imex2', 1e-3, 'angle', 3e-5),
    Check('puma560_fall', 'rk4', 1e-3, 'angle', 1e-9),
    *(
        Check(motion.name, 'imex2', step, 'angle', bound, dtype=dtype)
        for motion in MOTIONS
        if motion.scene.damping is not None
        for step, bound in ((1e-3, 1e-4), (4e-3, 2e-3))
        for dtype in ('float64', 'float32')
    ),
    Check('so100_fall', 'rk4', 1e-3, 'angle', 1e-8),
    Check('so100_fall', 'rk4', 1e-3, 'energy', 1e-8),
    Check('so100_fall', 'dop853', 1e-12, 'energy', 1e-11),
    Check('so100_spin', 'dop853', 1e-12, 'energy', 1e-11),
    *(
        Check(motion.name, 'dop853', 1e-12, 'angle', 1e-10)
        for motion in MOTIONS
        if motion.way is MIDPOINT
    ),
)

# Part of its friction that gravity takes at each joint of the arm in equilibrium, and friction of
# the joints that gravity hardly loads [N m].
HELD, LEAST_FRICTION = 0.95, 0.1


def _held() -> Motion:
    """Return UR5 at rest; gravity takes the fraction HELD of its friction."""
    arm = load_robot('ur5')
    q, zero = (0.3, -0.8, 1.1, 0.4, -0.6, 0.2), np.zeros((1, arm.n))
    states = {'q': np.array([q]), 'qd': zero, 'qdd': zero}
    needed = run(record_inverse_dynamics(resolve(arm), 'parallel'), states)['tau'][0]
    return Motion(
        'stiction_hold',
        'friction as a steep slope, or as a soft constraint, lets a loaded joint creep',
        arm,
        Scene(friction=np.maximum(np.abs(needed) / HELD, LEAST_FRICTION)),
        q,
        (0.0,) * arm.n,
        10.0,
        bounds={'float64': 1e-12, 'float32': 1e-6},
    )


# The bounds were set before the motions were measured.
STEADY: Sequence[Motion] = (
    _held(),
    Motion(
        'one_hour_spin',
        'the turns take the digits of the angle, and h qd falls below the last one',
        chain(1, 'y'),
        Scene(gravity=None),
        (0.0,),
        (10.0,),
        3600.0,
        bounds={'float64': 1e-9, 'float32': 0.02},
    ),
)
