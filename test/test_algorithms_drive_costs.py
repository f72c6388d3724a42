# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Costs of drives and springs: closed forms of their steps, and none where they are off."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

from closed_forms import arithmetic, chain, levels
from drive_scenes import OTHER
import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.algorithms.programs import FORWARD
from pfd_core.model import resolve

OFF: dict[str, dict[str, Any]] = {
    'effort_limits': {'effort_limits': [np.inf] * 6},
    'torque_speed': {'torque_speed': [None] * 6},
    'springs': {'stiffness': [0.0] * 6, 'rest_position': [0.3] * 6},
    'gravity_compensation': {'gravity_compensation': pfd.Scene(gravity=None)},
    'friction': {'friction': [0.0] * 6},
    'joint_limits': {'joint_limits': [(-np.inf, np.inf)] * 6, 'restitution': 0.5},
    'motor_lag': {'motor_lag': [0.0] * 6},
    'damping': {'damping': [0.0] * 6},
    'armature': {'armature': [0.0] * 6},
}


@cache
def bare_kernel() -> pfd.Kernel:
    return pfd.compile_kernel(pfd.load_robot('ur5'), refine=1)


@pytest.mark.parametrize('effect', OFF)
def test_an_effect_that_is_off_costs_nothing(effect: str) -> None:
    bare = bare_kernel()
    robot = bare.robot
    off = pfd.compile_kernel(robot, scene=pfd.Scene(**OFF[effect]), refine=1)
    assert off.operations == bare.operations
    assert off.ir == bare.ir


ON: dict[str, tuple[dict[str, Any], int]] = {
    # Each joint: two comparisons of one subtraction and one selection.
    'effort_limits': ({'effort_limits': [40.0] * 6}, 6 * 4),
    # One joint of six has a limit.
    'one effort limit': ({'effort_limits': [np.inf] * 5 + [5.0]}, 4),
    # The stretch of a spring, its product and its sum; a rest position of zero needs none.
    'springs': ({'stiffness': [5.0] * 6}, 6 * 2),
    'springs at rest elsewhere': ({'stiffness': [5.0] * 6, 'rest_position': [0.1] * 6}, 6 * 3),
    # |qd|, tau along qd and back: 6; two rows: 3 + 1 and 2; two comparisons: 4.
    'torque_speed': ({'torque_speed': [[(2.0, 50.0), (3.0, 0.0)]] * 6}, 6 * 16),
}


@pytest.mark.parametrize('effect', ON)
def test_an_effect_that_is_on_costs_its_operations(effect: str) -> None:
    robot = pfd.load_robot('ur5')
    arguments, more = ON[effect]
    bare, on = (
        sum(pfd.compile_kernel(robot, scene=pfd.Scene(**given)).operations['folded'].values())
        for given in ({}, arguments)
    )
    assert on - bare == more


@pytest.mark.parametrize('n', [2, 3, 6, 8])
def test_gravity_compensation_has_its_closed_form_of_steps(n: int) -> None:
    robot = replace(chain(n), base_rotation=np.eye(3))
    for scene, products, sums in (
        (pfd.Scene(gravity_compensation=True, effort_limits=[1.0] * n), 9, 3 * levels(n) + 7),
        (pfd.Scene(gravity_compensation=pfd.Scene(payload=OTHER)), 18, 3 * levels(n) + 11),
    ):
        program = FORWARD['pcrbm'](resolve(robot, scene), 'parallel')
        assert arithmetic(program.count(section='drives'))[:2] == (products, sums)


@pytest.mark.parametrize('rows', [1, 2, 4])
def test_limits_have_their_closed_form_of_steps(rows: int) -> None:
    found = np.stack([np.arange(rows), 10.0 - np.arange(rows)], axis=1)
    program = FORWARD['pcrbm'](resolve(chain(5), pfd.Scene(torque_speed=[found] * 5)), 'parallel')
    steps = arithmetic(program.count(section='drives'))[:2]
    assert steps == ((0, 2) if rows == 1 else (rows - 1, 2 * (rows - 1) + 3))
