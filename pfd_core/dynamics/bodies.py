# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Numbers of links that vary: of a payload given at run time, or of bodies that differ among arms.

    with_payload_input   a plant whose payload is an input
    payload_inputs       that input, for a scene and a payload
    links_of             numbers of the links of robots with other bodies, and payloads

Grouping moves a part of a body to each link before, and is linear in mass, first moment and
inertia of the body if a translational joint passes the whole inertia on. So grouped parameters are
those of the robot, plus a sum over the changes of bodies, computed once an arm. No evaluation
groups anything. A payload is a change of the last link's body. Parameters that do not change stay
constants.

Sums have a fixed order, so an arm has the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.links import (
    CENTERED,
    GROUPED,
    NUMBERS,
    Body,
    Link,
    body_numbers,
    centered_links,
    grouped,
    link_numbers,
    moments,
)
from pfd_core.dynamics.numbers import PARAMETERS, parameters, with_inputs
from pfd_core.machine.vectors import UPPER
from pfd_core.model.effects import INPUT
from pfd_core.model.geometry import Placement, merged, moved
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Payload, Robot
from pfd_core.model.scene import Scene
from pfd_core.model.values import Array, quote

# Robots whose parameters, and payloads whose numbers, are kept.
KEPT = 64


def with_payload_input(plant: Plant) -> Plant:
    """Return a plant that has the numbers that a payload changes as inputs."""
    links = {kind: numbers.copy() for kind, numbers in _own(plant.robot).numbers.items()}
    links[CENTERED][-1] = np.nan
    links[GROUPED][_slopes(plant.robot, plant.robot.links - 1).any(axis=2)] = np.nan
    return with_inputs(replace(plant, links=links))


def payload_numbers(robot: Robot, payload: Payload | None) -> Array:
    """Return the input for a payload of a robot, None for no payload; read-only."""
    if payload is not None and not isinstance(payload, Payload):
        raise ValueError(f'payload must be a Payload or None, got {quote(payload)}')
    return _payload_numbers(robot, payload)


def payload_inputs(
    robot: Robot, scene: Scene, dtype: str, payload: Payload | None
) -> dict[str, NDArray[Any]]:
    """Return the input of a scene with payload="input"; ValueError for a payload in others."""
    if scene.payload == INPUT:
        return {PARAMETERS: payload_numbers(robot, payload).astype(dtype)}
    if payload is not None:
        raise ValueError(
            "payload was given, but the scene takes none as an input: use Scene(payload='input')"
        )
    return {}


@lru_cache(KEPT)
def _payload_numbers(robot: Robot, payload: Payload | None) -> Array:
    links = links_of(robot, [robot], [payload])
    numbers: Array = parameters(_loaded(robot), Plant(robot, np.zeros(3), links=links), 1)[0]
    numbers.setflags(write=False)
    return numbers


@lru_cache(KEPT)
def _loaded(robot: Robot) -> Plant:
    return with_payload_input(Plant(robot, np.zeros(3)))


def links_of(
    robot: Robot, robots: Sequence[Robot], payloads: Sequence[Payload | None]
) -> dict[str, Array]:
    """
    Return the numbers of the links of some arms, by kind, (arms, n, NUMBERS), in a robot's axes.

    Each arm has the bodies of one of `robots`, with the same frames, and one of `payloads`.
    """
    own = _own(robot)
    size, n = len(robots), robot.links
    centered = np.tile(own.numbers[CENTERED], (size, 1, 1))
    changes = np.zeros((size, n, NUMBERS))
    for k, (other, payload) in enumerate(zip(robots, payloads, strict=True)):
        bodies = own.bodies
        if other is not robot:
            bodies = _bodies(centered_links(robot, bodies=other))
            centered[k] = [body_numbers(body) for body in bodies]
            changes[k] = np.array([_about_origin(body) for body in bodies]) - own.about_origins
        if payload is not None:
            held = payload.mass, np.asarray(payload.center), np.asarray(payload.inertia)
            held = moved(own.tip, held)
            centered[k, -1] = body_numbers(merged(bodies[-1], held))
            changes[k, -1] = changes[k, -1] + _about_origin(held)
    found = np.tile(own.numbers[GROUPED], (size, 1, 1))
    for i in range(n):
        if changes[:, i].any():
            slopes = np.moveaxis(_slopes(robot, i), 2, 0)
            for slope, change in zip(slopes, changes[:, i].T, strict=True):
                found = found + slope * change[:, np.newaxis, np.newaxis]
    return {CENTERED: centered, GROUPED: found}


class _Own(NamedTuple):
    """Bodies of the links of a robot."""

    bodies: list[Body]
    tip: Placement
    about_origins: Array  # (n, NUMBERS)
    numbers: dict[str, Array]  # by kind, (n, NUMBERS)


@lru_cache(KEPT)
def _own(robot: Robot) -> _Own:
    links = centered_links(robot)
    bodies = _bodies(links)
    numbers = {kind: link_numbers(robot, kind) for kind in (CENTERED, GROUPED)}
    return _Own(bodies, links[-1].end, np.array([_about_origin(body) for body in bodies]), numbers)


def _bodies(links: Sequence[Link]) -> list[Body]:
    return [(x.m, x.center, x.J) for x in links]


def _about_origin(body: Body) -> Array:
    """Return mass, first moment and inertia about the origin of a body about its centre."""
    m, center, J = body
    return body_numbers((m, m * center, J + m * moments(center, center)))


@lru_cache(KEPT)
def _slopes(robot: Robot, i: int) -> Array:
    """Return the derivatives of all grouped parameters by a body on link i, (n, 10, 10)."""
    links = centered_links(robot)
    none = _unit(NUMBERS)
    units = []
    for k in range(NUMBERS):
        bodies = [_unit(k) if j == i else none for j in range(robot.links)]
        found = grouped(links, bodies, np.asarray, whole=True)
        units.append([body_numbers(body) for body in found])
    slopes: Array = np.moveaxis(np.array(units), 0, 2)
    slopes.setflags(write=False)
    return slopes


def _unit(k: int) -> Body:
    """Return the body whose number k is one, and the others zero; all for k = NUMBERS."""
    numbers = np.eye(NUMBERS + 1)[k][:NUMBERS]
    inertia = np.zeros((3, 3))
    for (i, j), value in zip(UPPER, numbers[4:], strict=True):
        inertia[i, j] = inertia[j, i] = value
    return float(numbers[0]), numbers[1:4], inertia
