# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Free motions of arms, without torques, and the bounds of their runs.

    HARD     motions that are hard to integrate
    ENDS     stored ends of HARD in 25 digits (benchmarks.references.motions computes them)
    CHECKS   runs of HARD with their bounds

HARD is data/motions.yaml, ENDS is data/motion_references.yaml.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from benchmarks.cases import problems
from benchmarks.cases.robots import robot
from benchmarks.table import stored_table
from pfd_core.forking import cached_property
from pfd_core.model import Plant, Robot, Scene, resolve
from pfd_core.simulation.adaptive import AdaptiveTrajectory, integrate


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
        Time of the motion, or of its stored end [s].
    steps, halvings : int
        Macro steps of the reference, and halvings of the first one, for strong damping.
    scheme : {'midpoint', 'implicit'}
        Substeps of the reference.

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
    scheme: str = 'midpoint'

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


_arm = cache(robot)


def _stored(kind: str) -> Iterator[Motion]:
    for name, row in stored_table('motions')[kind].items():
        yield _motion(name, **row)


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
    **reference: Any,
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
    return Motion(name, cause, chosen, Scene(**effects), q, qd, duration, **reference)


HARD = tuple(_stored('hard'))
# Name of a motion of HARD -> angles [rad] as text, `q`, and `self_difference` [rad], the largest
# distance of an angle from a second computation with longer macro steps.
ENDS: Mapping[str, Mapping[str, Any]] = stored_table('motion_references')


@dataclass(frozen=True)
class Check:
    """
    A run of a motion of HARD, and its bound.

    Attributes
    ----------
    motion, integrator : str
        Their names.
    step : float
        Step [s], or the relative tolerance of dop853.
    quantity : {'angle', 'energy'}
        Largest error of an angle at the stored end [rad]; or largest error of the energy up to
        `duration` over the peak kinetic energy.
    bound : float
        Largest value allowed.
    duration : float, optional
        Time of the run [s]; default: the motion's.
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
        for motion in HARD
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
        for motion in HARD
        if motion.scheme == 'midpoint'
    ),
)
