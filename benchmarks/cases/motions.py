# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Free motions of arms, without torques, and the bounds of their runs.

    HARD     motions that are hard to integrate
    ENDS     stored ends of HARD in 25 digits (benchmarks.references.motions computes them)
    CHECKS   runs of HARD with their bounds

HARD and CHECKS are data/motions.yaml, ENDS is data/motion_references.yaml.
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
    A free motion of an arm: the cause of its difficulty, start [rad or m, and per s] and time [s].

    Of its reference: macro steps, halvings of the first one for strong damping, and the substeps,
    'midpoint' or 'implicit'.
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


def _stored() -> Iterator[Motion]:
    arm = cache(robot)
    for name, row in stored_table('motions')['hard'].items():
        given = dict(row)
        if 'problem' in row:
            maker, *arguments = given.pop('problem')
            made = getattr(problems, maker)(*arguments)
            chosen = made.plant.robot
            given |= {key: made.states[key][0].tolist() for key in ('q', 'qd')}
        else:
            chosen = arm(given.pop('arm'))
        # A single number is of all joints.
        scene, start = (
            {key: (x,) * chosen.n if isinstance(x, float) else x for key, x in numbers.items()}
            for numbers in (given.pop('scene', {}), {key: given.pop(key) for key in ('q', 'qd')})
        )
        start = {key: tuple(x) for key, x in start.items()}
        yield Motion(name=name, robot=chosen, scene=Scene(**scene), **start, **given)


HARD = tuple(_stored())
# Name of a motion of HARD -> angles [rad] as text, `q`, and `self_difference` [rad], the largest
# distance of an angle from a second computation with longer macro steps.
ENDS: Mapping[str, Mapping[str, Any]] = stored_table('motion_references')


COLUMNS = ('motion', 'integrator', 'dtype', 'step', 'duration', 'quantity', 'bound')
CHECKS: Sequence[dict[str, Any]] = tuple(
    dict(zip(COLUMNS, row, strict=True)) for row in stored_table('motions')['runs']
)
