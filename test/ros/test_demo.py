# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo` and the motion it follows."""

from __future__ import annotations

from pathlib import Path
import re
import subprocess
import sys

import numpy as np
import pytest
from ros_processes import PATIENCE, environment

import pfd_core as pfd
from pfd_ros import demo
from pfd_ros.demo_motion import motion_of
from pfd_ros.replay import read

# Central differences with step h err by h^2 / 6 times a derivative of third or fourth order,
# which stays below 1000 for this motion; rounding over h is a hundred times less.
STEP = 1e-5
DIFFERENCE_TOLERANCE = STEP**2 / 6 * 1000


@pytest.mark.parametrize('name', pfd.known_robots())
def test_the_motion_starts_at_rest_and_stays_within_the_limits(name: str) -> None:
    robot = pfd.load_robot(name)
    motion = motion_of(robot)
    q, qd, qdd = motion.at(0.0)
    np.testing.assert_array_equal(q, motion.start)
    assert not qd.any()
    assert not qdd.any()
    q = motion.at(np.linspace(0, 20, 20001))[0]
    assert (q >= robot.position_lower).all()
    assert (q <= robot.position_upper).all()
    assert (np.ptp(q, axis=0) > 0).all()


def test_the_motion_has_the_derivatives_it_states() -> None:
    motion = motion_of(pfd.load_robot('puma560'))
    t = np.linspace(0.1, 5, 50)
    (q0, v0, _), (_, v, a), (q1, v1, _) = (motion.at(t + k * STEP) for k in (-1, 0, 1))
    np.testing.assert_allclose((q1 - q0) / (2 * STEP), v, rtol=0, atol=DIFFERENCE_TOLERANCE)
    np.testing.assert_allclose((v1 - v0) / (2 * STEP), a, rtol=0, atol=DIFFERENCE_TOLERANCE)


def test_a_run_takes_a_name_of_its_own(tmp_path: Path) -> None:
    assert demo.free_name(tmp_path) == tmp_path / 'arm_0'
    (tmp_path / 'arm_0.mcap').touch()
    assert demo.free_name(tmp_path) == tmp_path / 'arm_1'


@pytest.mark.parametrize('seconds', [0.0, -1.0, float('nan'), float('inf')])
def test_a_length_that_is_none_is_refused(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(ValueError, match='--seconds is'):
        demo.run('puma560', seconds, tmp_path)


def test_an_unknown_robot_is_named_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='r2d2'):
        demo.run('r2d2', 1.0, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


@pytest.mark.ros
def test_the_demo_runs_proves_itself_and_leaves_its_files(tmp_path: Path) -> None:
    env = environment(1)
    del env['ROS_DOMAIN_ID'], env['ROS_AUTOMATIC_DISCOVERY_RANGE']
    done = subprocess.run(
        [sys.executable, '-m', 'pfd_ros.command_line', 'demo', '--seconds', '1', '--out', 'here'],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        check=False,
        timeout=2 * PATIENCE,
    )
    told = done.stdout + done.stderr
    # The rate is the machine's business: a busy one may miss it, and nothing else.
    failures = re.findall('FAILED: (.*)', told)
    assert all(failure.startswith('the rate is') for failure in failures), told
    assert done.returncode == (1 if failures else 0), told
    assert re.search(r'replay +\d+ states, \d+ steps: every bit equal', told)
    assert re.search(r'commands +sent \d+, recorded \d+, lost \d+', told)
    assert re.search(r'joint6 +\d\.\d+e-\d+ +\d\.\d+e-\d+', told)
    assert (tmp_path / 'here' / 'arm_0.png').read_bytes().startswith(b'\x89PNG')
    assert read(tmp_path / 'here' / 'arm_0.mcap', verify=True).complete
