# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Mechanisms of turns and slides in unusual proportions, for the hard cases.

At q = 0 all rods lie along x of the world. Each joint turns about, or slides along, one of the
axes of the world. A lift is a distance along a joint's own axis to the next joint: a massless
stick, behind which the rod starts.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pfd_core.model import Payload, Robot, load_robot, with_payload
from pfd_core.report.hard_case_problems import (
    RADIUS,
    Array,
    Problem,
    problem,
    single,
)

# Not a round number: squares of round numbers add up without rounding, which hides errors.
LENGTH = float(np.float32(0.3))
# Frames whose z is an axis of the world: signed permutations, which round nothing.
_FRAMES: dict[str, Array] = {
    'x': np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    'y': np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]).T,
    'z': np.eye(3),
}


def mechanism(
    axes: str,
    *,
    lifts: Mapping[int, float] | None = None,
    drops: Mapping[int, float] | None = None,
    masses: Mapping[int, float] | None = None,
    lengths: Mapping[int, float] | None = None,
    inertias: Mapping[int, float] | None = None,
) -> Robot:
    """
    Return rods of 0.3 m and 1 kg on joints along axes of the world.

    Parameters
    ----------
    axes : str
        A letter for each joint: 'x', 'y', 'z' for a turn, 'X', 'Y', 'Z' for a slide.
    lifts, lengths, masses : mapping, optional
        Index of a link to its lift (else 0), its length (else 0.3) [m], its mass (else 1) [kg].
    drops : mapping, optional
        Index of a link to the distance by which its frame lies behind, along the next axis [m].
    inertias : mapping, optional
        Index of a link to its moments of inertia [kg m^2], where they are not those of a rod.

    """
    n = len(axes)
    frames = [_FRAMES[letter] for letter in axes.lower()]
    frames.append(frames[-1])
    bodies = []
    for k in range(n):
        here, beyond = frames[k], frames[k + 1]
        length, mass = (lengths or {}).get(k, LENGTH), (masses or {}).get(k, 1.0)
        rod = np.array([length, 0.0, 0.0])
        across = length**2 / 12 + RADIUS**2 / 4
        moments = mass * np.array([RADIUS**2 / 2, across, across])
        if inertias and k in inertias:
            moments = np.full(3, inertias[k])
        drop = (drops or {}).get(k, 0.0) * beyond[:, 2]
        bodies.append(
            {
                'rotations': here.T @ beyond,
                'translations': here.T @ (rod - drop)
                + np.array([0.0, 0.0, (lifts or {}).get(k, 0.0)]),
                'masses': np.array(mass),
                'centers': beyond.T @ (drop - rod / 2),
                'inertias': beyond.T @ np.diag(single(moments)) @ beyond,
            }
        )
    stacked = {key: single(np.array([body[key] for body in bodies])) for key in bodies[0]}
    return Robot(
        name=f'mechanism_{axes}',
        joint_names=tuple(f'joint{k + 1}' for k in range(n)),
        joint_types=tuple('continuous' if a.islower() else 'prismatic' for a in axes),
        base_rotation=frames[0],
        rotations=stacked['rotations'],
        translations=stacked['translations'],
        masses=stacked['masses'],
        centers=stacked['centers'],
        inertias=stacked['inertias'],
    )


def lifted(axes: str, lifts: Mapping[int, float]) -> Problem:
    """Return a mechanism with distances along joints' own axes to the next joints [m]."""
    return problem(mechanism(axes, lifts=lifts))


def dropped(axes: str, index: int, distance: float) -> Problem:
    """Return a mechanism in which the origin of one frame lies far along its joint's axis [m]."""
    return problem(mechanism(axes, drops={index - 1: distance}, lifts={index: distance}))


def weighed(axes: str, masses: Mapping[int, float]) -> Problem:
    """Return a mechanism in which some links have other masses [kg]."""
    return problem(mechanism(axes, masses=masses))


def graded(axes: str, ratio: float) -> Problem:
    """Return a mechanism whose links are each heavier than the one before by a ratio."""
    return weighed(axes, {k: ratio**k for k in range(len(axes))})


def on_one_axis(axes: str, count: int, inertia: float, mass: float = 0.0) -> Problem:
    """Return a mechanism whose first `count` joints share an axis, with small links between."""
    between = range(count - 1)
    robot = mechanism(
        axes,
        masses=dict.fromkeys(between, mass),
        lengths=dict.fromkeys(between, 0.0),
        inertias=dict.fromkeys(between, inertia),
    )
    return problem(robot)


def extended(axes: str, reach: float) -> Problem:
    """Return a mechanism whose slides are up to a distance [m] out; turns stay within pi."""
    drawn = problem(mechanism(axes))
    scale = np.array([reach if letter.isupper() else 1.0 for letter in axes])
    return Problem(drawn.plant, drawn.states | {'q': single(drawn.states['q'] * scale)})


def loaded(name: str, mass: float, distance: float) -> Problem:
    """Return an arm of config/robots with a point load [kg] on a tool of a length [m]."""
    return problem(with_payload(load_robot(name), Payload(mass, (0.0, 0.0, distance))))
