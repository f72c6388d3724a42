# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots written as URDF: read back they are the same robots, here and in Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bridge import ROBOT_JOINT_FIELDS, ROBOT_LINK_FIELDS
import numpy as np
import pinocchio as pin
import pytest
from zoo import ODD_ARM, random_chain, to_pinocchio

import pfd_core as pfd

# Angles and products of a few rotations, relative to numbers of about one.
ROUNDING = 1e-14
# Forces of chains of up to ten such rotations.
TORQUE_ROUNDING = 1e-11


def robots() -> list[pfd.Robot]:
    rng = np.random.default_rng(5)
    made = [random_chain(rng, n) for n in (1, 4, 7)]
    return [*map(pfd.load_robot, pfd.known_robots()), pfd.load_robot(ODD_ARM), *made]


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('robot', robots(), ids=lambda robot: f'{robot.name}-{robot.n}')
def test_a_robot_written_as_urdf_is_read_as_the_same_robot(robot: pfd.Robot) -> None:
    found = pfd.load_robot(pfd.robot_to_urdf(robot), base=robot.base, tip=robot.tip)
    for key in ('name', 'joint_names', 'joint_types', 'base', 'tip'):
        assert getattr(found, key) == getattr(robot, key)
    for key in (*ROBOT_LINK_FIELDS, *ROBOT_JOINT_FIELDS, 'base_rotation', 'base_position'):
        # A link without mass has no centre of mass.
        present = robot.masses > 0 if key == 'centers' else ...
        wanted = getattr(robot, key)[present]
        np.testing.assert_allclose(
            getattr(found, key)[present], wanted, rtol=ROUNDING, atol=ROUNDING, err_msg=key
        )
    for name, frame in robot.frames.items():
        assert found.frames[name].link == frame.link
        np.testing.assert_allclose(found.frames[name].rotation, frame.rotation, atol=ROUNDING)
        np.testing.assert_allclose(
            found.frames[name].translation, frame.translation, atol=ROUNDING
        )


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('robot', robots(), ids=lambda robot: f'{robot.name}-{robot.n}')
def test_pinocchio_computes_the_torques_of_the_robot_from_the_urdf(robot: pfd.Robot) -> None:
    read = pin.buildModelFromXML(pfd.robot_to_urdf(robot))
    own = to_pinocchio(robot)
    q, qd, qdd = np.random.default_rng(2).uniform(-1.0, 1.0, size=(3, robot.n))
    turning = [kind == 'continuous' for kind in robot.joint_types]
    whole = [
        x
        for a, turns in zip(q, turning, strict=True)
        for x in ((np.cos(a), np.sin(a)) if turns else (a,))
    ]
    found = pin.rnea(read, read.createData(), np.array(whole), qd, qdd)
    wanted = pfd.inverse_dynamics(robot, q, qd, qdd)
    assert own.nv == read.nv
    np.testing.assert_allclose(found, wanted, rtol=0, atol=TORQUE_ROUNDING * np.abs(wanted).max())


def test_the_urdf_of_a_urdf_is_itself(tmp_path: Path) -> None:
    path = tmp_path / 'odd.urdf'
    path.write_text(ODD_ARM, encoding='utf-8')
    assert pfd.urdf_of(path) == ODD_ARM
    assert pfd.urdf_of(ODD_ARM) == ODD_ARM


def test_a_robot_that_no_urdf_can_hold_is_refused() -> None:
    arm = pfd.load_robot('planar2')
    for names in (('a\x01b', 'c'), ('a\ud800', 'c')):
        with pytest.raises(ValueError, match="'planar2' cannot be written as URDF: the URDF"):
            pfd.robot_to_urdf(replace(arm, joint_names=names))
