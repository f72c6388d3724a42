# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Numbers of a plant in a recording: what does not vary is a constant, what varies is an input.

    numbers = Numbers(recorder, plant)
    numbers('viscosity', i)        a constant, or an element of the one input `p` of the program

A plant has NaN for each number that varies. `with_inputs` gives each of them a place in `p`, and
`parameters` computes `p` for plants that have numbers there, once a plant, in NumPy. All plants
derived from one (Plant.only) and all their programs share the same `p`. Numbers vary one by one: a
structural zero stays a constant, since an input in its place costs half of a kernel's operations.

VARYING are the numbers that algorithms read, many of them computed from fields of a scene: so no
program divides by a Stribeck velocity or groups inertial parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.links import CENTERED, GROUPED, link_numbers
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model.plant import Plant
from pfd_core.model.values import Array

# The input of a program that holds the numbers that vary.
PARAMETERS = 'p'
# Fields in the order of `p`: attributes of Plant, and numbers of links.
VARYING = (
    CENTERED,
    GROUPED,
    'base_acceleration',
    'viscosity',
    'inertia',
    'implicit_inertia',
    'friction',
    'static_friction',
    'friction_drop',
    'stribeck_rate',
    'restitution',
    'stiffness',
    'rest_position',
)


class Numbers:
    """Numbers of a plant in a recording, of one lane where numbers vary."""

    def __init__(self, recorder: Recorder, plant: Plant) -> None:
        self._recorder, self._plant = recorder, plant

    def __call__(self, field: str, *index: Any) -> Lanes:
        """Return a number of a field, or, for an index of all lanes, a row of numbers."""
        return self._lanes(field, index, values(self._plant, field)[index])

    def known(self, field: str, *index: int) -> Any:
        """Return a number known while recording; one that varies as a value."""
        value = values(self._plant, field)[index]
        return self._lanes(field, index, value) if np.isnan(value) else float(value)

    def all(self, field: str) -> LaneArray:
        """Return all numbers of a field as an object array of its shape."""
        found = values(self._plant, field)
        each = [self._lanes(field, index, found[index]) for index in np.ndindex(found.shape)]
        return array(each).reshape(found.shape)

    def _lanes(self, field: str, index: Any, value: Any) -> Lanes:
        if not np.isnan(value).any():
            return self._recorder.constant(value)
        # The last number is read as well, so that `p` has its whole length in each program.
        self._recorder.input(PARAMETERS, [count(self._plant) - 1])
        places = np.ravel(self._plant.varied[field][index])
        return self._recorder.input(PARAMETERS, places.tolist())


def rotors(recorder: Recorder, plant: Plant) -> list[Any]:
    """Return the inertia of the joints themselves, (n,) [kg m^2 or kg], known or varying."""
    n = plant.robot.n
    if plant.inertia is None:
        return [0.0] * n
    numbers = Numbers(recorder, plant)
    return [numbers.known('inertia', i) for i in range(n)]


def free_input(recorder: Recorder, plant: Plant) -> list[Lanes] | None:
    """Return the input `free` as n numbers on one processor; None for a plant without brakes."""
    return recorder.input_list('free', plant.robot.n) if plant.brakes else None


def wrench_input(recorder: Recorder) -> LaneArray:
    """Return the six components of the wrench, on the last lane."""
    empty = [None] * (recorder.lanes - 1)
    return array([recorder.input('wrench', [*empty, k]) for k in range(6)])


def values(plant: Plant, field: str) -> Array:
    """Return the numbers of a field, NaN for those that vary; the field must be on."""
    if field in plant.links:
        return plant.links[field]
    found: Array = getattr(plant, field, None)  # type: ignore[assignment]
    return link_numbers(plant.robot, field) if found is None else found


def count(plant: Plant) -> int:
    """Return the number of elements of `p`; 0 for a plant without numbers that vary."""
    return max((1 + int(places.max()) for places in plant.varied.values()), default=0)


def with_inputs(plant: Plant) -> Plant:
    """Return a plant with a place in `p` for each of its numbers that is NaN."""
    varied: dict[str, NDArray[np.int64]] = {}
    first = 0
    for field in VARYING:
        found = plant.links.get(field, getattr(plant, field, None))
        if found is not None and np.isnan(found).any():
            varies = np.isnan(found)
            places = np.full(found.shape, -1)
            places[varies] = first + np.arange(varies.sum())
            varied[field] = places
            first += int(varies.sum())
    return replace(plant, varied=varied)


def parameters(plant: Plant, arms: Plant, size: int) -> Array:
    """
    Return `p` of some arms, (size, count), for a plant from `with_inputs`.

    `arms` holds the numbers of all arms: those that vary have a first axis of this size.
    """
    rows = []
    for field, places in plant.varied.items():
        found = np.broadcast_to(values(arms, field), (size, *places.shape))
        rows.append(found[:, places >= 0])
    return np.concatenate(rows, axis=1) if rows else np.zeros((size, 0))
