# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of a scene: named motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scene_cases import DISC, WINDOW

import pfd_core as pfd
from pfd_core.report.cases import excitations
from pfd_core.report.cases.excitations import EXCITATIONS, SETTINGS, excited_motion
from pfd_core.report.measure.scene_effects import full_scene
from pfd_core.report.measure.scene_errors import run_full


@pytest.fixture(scope='module')
def disc() -> pfd.Robot:
    return pfd.load_robot(DISC)


@pytest.mark.parametrize('name', EXCITATIONS)
@pytest.mark.parametrize('arm', ['planar2', 'panda', 'puma560', 'ur5'])
@pytest.mark.slow
def test_a_named_motion_moves_every_joint_within_its_limits(arm: str, name: str) -> None:
    robot = pfd.load_robot(arm)
    scene, _ = full_scene(robot, pfd.Scene(), SETTINGS)
    motion = excited_motion(robot, scene, name)
    assert (np.abs(motion.taus) <= robot.effort_limit).all()
    assert (motion.q >= robot.position_lower).all()
    assert (motion.q <= robot.position_upper).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    assert (np.ptp(motion.q, axis=0) > 0.1).all()
    # The states are those of the full scene under these torques, bit for bit.
    full = run_full(robot, scene, motion, WINDOW)
    assert full.departure == 0.0
    np.testing.assert_array_equal(full.q[:-1], motion.q[1:])


@pytest.mark.parametrize('name', ['swing', 'sine'])
def test_the_derivatives_of_a_reference_are_those_of_its_position(name: str) -> None:
    h = 1e-4
    t = np.arange(0, excitations.SECONDS, h)
    y, yd, ydd = EXCITATIONS[name].reference(t, 3)
    assert y.shape == yd.shape == ydd.shape == (len(t), 3)
    assert np.abs(yd).max() <= EXCITATIONS[name].peak
    # Central differences: the third derivative is below 300, times h^2 / 6.
    for value, derivative in ((y, yd), (yd, ydd)):
        slope = (value[2:] - value[:-2]) / (2 * h)
        inner = np.abs(t[1:-1] - excitations.SECONDS / 2) > h  # the swing turns there
        np.testing.assert_allclose(slope[inner], derivative[1:-1][inner], atol=300 * h**2 / 6)


def test_limits_of_zero_are_none(disc: pfd.Robot) -> None:
    unknown = replace(disc, velocity_limit=np.zeros(1), effort_limit=np.zeros(1))
    assert np.ptp(excited_motion(unknown, pfd.Scene(), 'sine').q) > 0.9
