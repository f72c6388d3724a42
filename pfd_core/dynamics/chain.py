# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain at the input q on one processor: joints, and the parameters of links.

The parameters of links are of one of three kinds; algorithms are the same for all of them.

    GROUPED     base parameters about the origins: the fewest operations
    CENTERED    about centres of mass, in the axes of grouped ones: the torque of each link is
                accurate relative to its own terms, and angular velocities are shared with grouped
    GIVEN       the same with origins as the robot has them: for rotations of zeros and ones no
                number of the robot is rounded before the first operation

Everything of link i is in axes B_i (pfd_core.dynamics.links).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from pfd_core.dynamics.joints import Body, Joint, sum_of_angles
from pfd_core.dynamics.links import GIVEN, GROUPED, Link, centered_links
from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.lanes import absolute, cos, sin, where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.vectors import (
    array,
    constants,
    parallel_axis,
    symmetric_matrix,
    symmetric_sum,
)
from pfd_core.model.geometry import Placement
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, coupled, spread

# Largest angle of a sine with all its digits [rad]: kernels.sines.WRAP_LIMIT.
LARGEST_ANGLE = 1e5


@dataclass(frozen=True)
class Chain:
    """A chain at the input q."""

    recorder: Recorder
    plant: Plant
    joints: list[Joint]
    # Mass [kg], first moment [kg m] and inertia about the origin of B_i [kg m^2], if parameters
    # are grouped, else mass, centre of mass [m] and inertia about this.
    links: list[Body]
    tip: Placement  # pose of frame n in axes B_n
    grouped: bool

    def inputs(self, name: str) -> list[Lanes]:
        """Return an input, such as 'qd', as n numbers."""
        return self.recorder.input_list(name, self.plant.robot.n)

    def bodies(self) -> list[Body]:
        """Return mass, first moment and inertia about the origin of each link."""
        if self.grouped:
            return self.links
        with self.recorder.section('parameters'):
            return [
                (m, m * c, symmetric_sum(J, symmetric_matrix(m * parallel_axis(c))))
                for m, c, J in self.links
            ]


def chain_of(plant: Plant, parameters: str = GROUPED, recorder: Recorder | None = None) -> Chain:
    """Return the chain of a plant at the input q, in a new recording if none is given."""
    recorder = Recorder(1, 'sequential') if recorder is None else recorder
    axes = centered_links(plant.robot, moved=parameters != GIVEN)
    joints = joints_at(recorder, axes, positions(recorder, plant.robot))
    rows = Numbers(recorder, plant).all(parameters)
    links = [(row[0], row[1:4], symmetric_matrix(row[4:])) for row in rows]
    if parameters == GIVEN:
        with recorder.section('parameters'):
            centers = [constants(recorder, x.end[1]) + constants(recorder, x.arm) for x in axes]
        if not plant.external_wrench:
            # Frame n lies at the last joint, as for the methods on lanes: no input refers to it.
            centers[-1] = links[-1][1]
        links = [(m, c, J) for (m, _, J), c in zip(links, centers, strict=True)]
    return Chain(recorder, plant, joints, links, axes[-1].end, parameters == GROUPED)


def positions(recorder: Recorder, robot: Robot) -> list[Lanes]:
    """
    Return the positions of all joints of a chain at the input q, those of followers included.

    The angle of a follower may have no period of 2 pi in q: it is NaN where its sine would lose
    digits.
    """
    q: list[Lanes] = spread(robot, recorder.input_list('q', robot.n), offsets=True)
    for k, mover in enumerate(robot.movers):
        if mover.name in coupled(robot) and mover.kind != 'prismatic':
            q[k] = where(LARGEST_ANGLE - absolute(q[k]), q[k], math.nan)
    return q


def joints_at(recorder: Recorder, links: Sequence[Link], q: Sequence[Lanes]) -> list[Joint]:
    """Return the joints of links at positions q [rad or m]."""
    return [_joint(recorder, link, x) for link, x in zip(links, q, strict=True)]


def _joint(recorder: Recorder, link: Link, q: Lanes) -> Joint:
    turn, twist = (tuple(constants(recorder, angle)) for angle in (link.start, link.twist))
    r = constants(recorder, link.p)
    if link.slides:
        with recorder.section('link vectors'):
            r = array([r[0], r[1] - twist[1] * q, r[2] + twist[0] * q])
    else:
        with recorder.section('joint rotation'):
            turn = sum_of_angles((cos(q), sin(q)), turn)
    square, parallel = (x == 0 for x in link.twist)
    return Joint(link.slides, turn, twist, square, parallel, r)
