# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conventions: torque control as vendors document it, as defaults of settings.

docs/conventions.yaml has each documented behaviour with its source. Settings that are given have
precedence. Two things follow from the name of a convention alone: the drives add gravity torques,
and reflexes have the vendor's names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Convention(NamedTuple):
    """The defaults of a convention, by setting."""

    values: Mapping[str, Any] = {}
    # Of settings with a number for each joint: one for all, or in the order of the model.
    numbers: Mapping[str, float | Sequence[float]] = {}
    # Setting of a reflex -> the vendor's name for it.
    errors: Mapping[str, str] = {}


PLAIN = 'plain'
CONVENTIONS: Mapping[str, Convention] = {
    PLAIN: Convention(),
    'franka': Convention(
        values={
            'step_size': 0.001,
            'state_effort': 'torque',
            'reflex_effort_rate': 1000.0,
            'reflex_effort_start': True,
            'effort_limits': True,
            'reflex_position': True,
            'reflex_velocity': True,
            'command_timeout': 0.02,
            'on_timeout': 'stop',
        },
        numbers={'viscous_scale': 1.0, 'coulomb_scale': 1.0},
        errors={
            'reflex_effort_rate': 'controller_torque_discontinuity',
            'reflex_position': 'joint_position_limits_violation',
            'reflex_velocity': 'joint_velocity_violation',
            'command_timeout': 'communication_constraints_violation',
            'reflex_external_effort': 'joint_reflex',
        },
    ),
    'ur': Convention(
        values={
            'step_size': 0.002,
            'substeps': 4,
            'command_timeout': 0.04,
            'on_timeout': 'stop',
            'state_effort': 'command',
            'effort_limits': True,
            'reflex_velocity': True,
            'reflex_position': True,
        },
        numbers={
            'viscous_scale': (0.9, 0.9, 0.8, 0.9, 0.9, 0.9),
            'coulomb_scale': (0.8, 0.8, 0.7, 0.8, 0.8, 0.8),
        },
        errors={
            'command_timeout': 'external control ended',
            'reflex_velocity': 'joint speed limit, stop category 0',
            'reflex_position': 'joint position limit, stop category 0',
        },
    ),
}


def defaults(convention: str) -> dict[str, Any]:
    """Return the values of settings in a convention; none of an unknown one."""
    return dict(CONVENTIONS.get(convention, Convention()).values)


def joint_numbers(name: str) -> Callable[[Any, Any], NDArray[Any]]:
    """Return the function of settings and robot that returns a setting's default numbers, (n,).

    They are in model order. It raises ValueError if the robot has another number of joints.
    """

    def numbers(settings: Any, robot: Any) -> NDArray[Any]:
        given = CONVENTIONS[settings.convention].numbers.get(name, 0.0)
        if isinstance(given, Sequence) and len(given) != robot.n:
            raise ValueError(
                f'convention {settings.convention} has {name} for {len(given)} joints, but '
                f'{robot.name!r} has {robot.n}: give {name} for each joint'
            )
        return np.full(robot.n, given, dtype=float)

    return numbers


def named(convention: str, setting: str, text: str) -> str:
    """Return why a reflex has acted, after the vendor's name for it."""
    name = CONVENTIONS[convention].errors.get(setting, '')
    return f'{name}: {text}' if name else text
