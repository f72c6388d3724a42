# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""FOHRA at the price of item (a) of section 2.5: what twists of right angles save."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from zoo import random_chain

import pfd_core as pfd
from pfd_core.algorithms.paper.fohra_first_level import record_fohra, structure_of
from pfd_core.machine.emulator import run
from pfd_core.report.cases.robots import uniform_chain

EXACT = 1e-14  # units of rounding of up to twelve products of rotations; seen up to 5e-16


def rotations(robot: pfd.Robot, q: np.ndarray) -> np.ndarray:
    """Return R_i, (n, 3, 3): rotation about z by q_i, then the link's own."""
    R = robot.rotations.copy()
    for i, kind in enumerate(robot.joint_types):
        if kind != 'prismatic':
            c, s = np.cos(q[i]), np.sin(q[i])
            R[i] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ R[i]
    return R


@pytest.mark.parametrize('name', ['puma560', 'ur5'])
def test_a_puma_takes_27_l_minus_19_multiplications_and_18_l_minus_14_additions(name: str) -> None:
    robot = pfd.load_robot(name)
    L = (robot.n - 1).bit_length()
    counts = record_fohra(structure_of(robot)).count()
    # By hand, twists 0 and 90 degrees: four elements are sums of two products, four others free.
    assert (counts.multiplications, counts.additions) == (27 * L - 19, 18 * L - 14)
    assert counts.routes == 9 * L


def test_an_arm_whose_twists_are_all_right_angles_takes_less() -> None:
    # R_i has columns (c, s, 0), (0, 0, 1) and (s, -c, 0) but for signs: in R_(i-1) R_i four
    # elements are one product each, and no two are added.
    counts = record_fohra(structure_of(pfd.load_robot('panda'))).count()
    assert (counts.multiplications, counts.additions) == (27 * 2 + 4, 18 * 2)


@pytest.mark.parametrize('n', [2, 3, 6, 9])
def test_other_twists_save_six_products_of_the_first_level(n: int) -> None:
    # R_i has one zero, below the cosine: three products by it from the left, three from the right.
    L = (n - 1).bit_length()
    counts = record_fohra(structure_of(uniform_chain(n))).count()
    assert (counts.multiplications, counts.additions) == (27 * L - 6, 18 * L - 6)


def test_nothing_known_saves_nothing() -> None:
    counts = record_fohra(np.full((6, 3, 3), np.nan)).count()
    assert (counts.multiplications, counts.additions) == (81, 54)


def test_the_products_are_pinocchios_orientations() -> None:
    rng = np.random.default_rng(4)
    for robot in (pfd.load_robot('puma560'), random_chain(rng, 7), random_chain(rng, 12)):
        q = rng.uniform(-3, 3, robot.n)
        program = record_fohra(structure_of(robot))
        found = run(program, {'R': rotations(robot, q).ravel()})['products']
        oracle = Oracle(robot)
        pin.forwardKinematics(oracle.model, oracle.data, q)
        for i in range(robot.n):
            # Pinocchio's frame turns about its own z; the link's own rotation follows.
            wanted = oracle.data.oMi[i + 1].rotation @ robot.rotations[i]
            wanted = robot.base_rotation.T @ wanted
            np.testing.assert_allclose(found[i], wanted, atol=EXACT)


def test_a_sliding_joint_has_the_rotation_of_its_link_alone() -> None:
    robot = uniform_chain(2)
    slide = replace(robot, joint_types=('prismatic', 'revolute'))
    known = structure_of(slide)[0]
    np.testing.assert_array_equal(known == 1.0, robot.rotations[0] == 1.0)
    np.testing.assert_array_equal(known == 0.0, robot.rotations[0] == 0.0)
