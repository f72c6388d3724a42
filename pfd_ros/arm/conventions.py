# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conventions: torque control as vendors document it, read from the table conventions.yaml.

A convention is a set of defaults: values of settings, and numbers of each joint. Settings that are
given have precedence. Two things follow from its name alone: the drives add gravity torques, and
reflexes have the vendor's names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
import yaml

PLAIN = 'plain'
CONVENTIONS = (PLAIN, 'franka', 'ur')


class Behaviour(NamedTuple):
    """A documented behaviour; conventions.yaml describes the fields."""

    name: str
    text: str
    source: str
    here: str = ''
    # Why the arm does not do it, perhaps ''; None if it does.
    missing: str | None = None
    values: Mapping[str, Any] = {}
    numbers: Mapping[str, Any] = {}
    errors: Mapping[str, str] = {}


@cache
def _table() -> dict[str, Any]:
    text = files('pfd_ros.arm').joinpath('conventions.yaml').read_text(encoding='utf-8')
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def documents() -> dict[str, str]:
    """Return the documents by the key with which a source begins."""
    return dict(_table()['documents'])


@cache
def behaviours(convention: str) -> tuple[Behaviour, ...]:
    """Return the behaviours of a convention; none of plain."""
    return tuple(Behaviour(**row) for row in _table().get(convention, ()))


def defaults(convention: str, field: str = 'values') -> dict[str, Any]:
    """Return one of the last three fields of all behaviours of a convention, by setting."""
    if convention == PLAIN:
        return {}
    rows = (getattr(row, field) for row in behaviours(convention))
    return {name: value for row in rows for name, value in row.items()}


def joint_numbers(name: str) -> Callable[[Any, Any], NDArray[Any]]:
    """Return the function of settings and robot that returns a setting's default numbers, (n,).

    They are in model order. It raises ValueError if the robot has another number of joints.
    """

    def numbers(settings: Any, robot: Any) -> NDArray[Any]:
        given = defaults(settings.convention, 'numbers').get(name, 0.0)
        if isinstance(given, list) and len(given) != robot.n:
            raise ValueError(
                f'convention {settings.convention} has {name} for {len(given)} joints, but '
                f'{robot.name!r} has {robot.n}: give {name} for each joint'
            )
        return np.full(robot.n, given, dtype=float)

    return numbers


def named(convention: str, setting: str, text: str) -> str:
    """Return why a reflex has acted, after the vendor's name for it."""
    name = defaults(convention, 'errors').get(setting, '')
    return f'{name}: {text}' if name else text
