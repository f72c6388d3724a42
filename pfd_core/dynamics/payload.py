# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A payload as an input: the parameters of links that it changes, as numbers given at run time.

    payload_numbers      the input for a payload of a robot
    payload_inputs       the same for a scene, which may have none
    with_payload_input   grouped parameters of a recording, with inputs for changing ones
    last_body            the last link as given, for the residual of refinement

A payload is a body on the last link. Grouping moves a part of it to each link before, and is
linear in the payload's mass, first moment and inertia: on a translational joint its whole inertia
moves on. The input holds mass, centre of mass and inertia of the last link, and each grouped
parameter that a payload changes, robot and payload together. These numbers are computed once a
payload, so that an evaluation reads them in the place of constants. Parameters that no payload
changes stay constants.

Sums have a fixed order, so a payload has the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.links import Body, centered_links, grouped, grouped_links, moments
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.vectors import UPPER
from pfd_core.model import Payload, Plant, Robot, Scene
from pfd_core.model.geometry import merged, product
from pfd_core.model.scene_fields import INPUT
from pfd_core.model.values import quote

NAME = 'payload'
# Numbers of a body: mass, first moment or centre of mass, six elements of the inertia.
NUMBERS = 10
# Robots whose parameters, and payloads whose numbers, are kept.
KEPT = 64

Array = NDArray[Any]


class _Parameters(NamedTuple):
    """
    The parameters of a robot as functions of its payload.

    Attributes
    ----------
    last : tuple
        Mass, centre of mass and inertia of the last link, in its axes B_n.
    rotation, p : ndarray
        Axes of the tip's frame, (3, 3), and its origin, (3,) [m], in axes B_n.
    own : ndarray
        Grouped parameters of the robot alone, (n, NUMBERS).
    slopes : ndarray
        Their derivatives by mass, first moment and inertia of a payload about the origin of B_n,
        (n, NUMBERS, NUMBERS).
    changed : ndarray
        Which of them a payload changes, (n, NUMBERS).

    """

    last: Body
    rotation: Array
    p: Array
    own: Array
    slopes: Array
    changed: NDArray[np.bool_]


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
        return {NAME: payload_numbers(robot, payload).astype(dtype)}
    if payload is not None:
        raise ValueError(
            "payload was given, but the scene takes none as an input: use Scene(payload='input')"
        )
    return {}


@lru_cache(KEPT)
def _payload_numbers(robot: Robot, payload: Payload | None) -> Array:
    found = _parameters(robot)
    last, grouped = found.last, found.own
    if payload is not None:
        center = found.p + product(found.rotation, np.asarray(payload.center))
        J = product(found.rotation, np.asarray(payload.inertia), found.rotation.T)
        last = merged(last, (payload.mass, center, J))
        inertia = J + payload.mass * moments(center, center)
        for slope, number in zip(
            np.moveaxis(found.slopes, 2, 0),
            _numbers((payload.mass, payload.mass * center, inertia)),
            strict=True,
        ):
            grouped = grouped + slope * number
    numbers = np.concatenate([_numbers(last), grouped[found.changed]])
    numbers.setflags(write=False)
    return numbers


def with_payload_input(
    recorder: Recorder, robot: Robot, bodies: Sequence[Sequence[Lanes]]
) -> list[list[Lanes]]:
    """Return the grouped parameters of links, NUMBERS each, with inputs for changing ones."""
    _declare(recorder, robot)
    result = [list(body) for body in bodies]
    places = np.argwhere(_parameters(robot).changed).tolist()
    for element, (i, k) in enumerate(places, NUMBERS):
        result[i][k] = recorder.input(NAME, [element])
    return result


def last_body(recorder: Recorder, robot: Robot) -> list[Lanes]:
    """Return the NUMBERS of the last link about its centre of mass, as inputs."""
    _declare(recorder, robot)
    return [recorder.input(NAME, [k]) for k in range(NUMBERS)]


def _declare(recorder: Recorder, robot: Robot) -> None:
    """Read the last number, so that the input has its whole length in each program."""
    recorder.input(NAME, [NUMBERS + int(_parameters(robot).changed.sum()) - 1])


@lru_cache(KEPT)
def _parameters(robot: Robot) -> _Parameters:
    plant = Plant(robot, np.zeros(3))
    links, tip = centered_links(plant)
    last = links[-1]
    own = np.array([_numbers((x.m, x.h, x.inertia)) for x in grouped_links(plant)])
    none = _unit(NUMBERS)
    units = [
        [_numbers(body) for body in grouped(links, bodies, np.asarray, whole=True)]
        for bodies in ([*[none] * (robot.n - 1), _unit(k)] for k in range(NUMBERS))
    ]
    slopes: Array = np.moveaxis(np.array(units), 0, 2)
    body = last.m, last.center, last.J
    changed = np.asarray(slopes.any(axis=2), bool)
    return _Parameters(body, tip.rotation, tip.p, own, slopes, changed)


def _unit(k: int) -> Body:
    """Return the body whose number k is one, and the others zero; all for k = NUMBERS."""
    numbers = np.eye(NUMBERS + 1)[k][:NUMBERS]
    inertia = np.zeros((3, 3))
    for (i, j), value in zip(UPPER, numbers[4:], strict=True):
        inertia[i, j] = inertia[j, i] = value
    return float(numbers[0]), numbers[1:4], inertia


def _numbers(body: Body) -> Array:
    m, vector, inertia = body
    return np.array([m, *vector, *(inertia[k] for k in UPPER)])
