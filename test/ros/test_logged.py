# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a log shows in the view: model, joint states, and the recorded wrench and payload."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from arm_messages import efforts, payload, placed, wrench
from bridge import WRENCH_TYPE, encode_joints, encode_numbers, logged
from logs import JOINT_STATE, Row, write_mcap
import numpy as np
import pytest
from recordings import simulate

import pfd_core as pfd
from pfd_ros import read_log

TIP = pfd.load_robot('planar2').tip
JOINTS = ('shoulder', 'elbow')


def write_bag(path: Path, rows: Iterable[tuple[str, str, float, bytes]]) -> Path:
    """Write a log of another program: topic, type, log time [s] and bytes."""
    rows = list(rows)
    kinds = {topic: kind for topic, kind, _, _ in rows}
    return write_mcap(path, [Row(topic, time, data) for topic, _, time, data in rows], kinds)


def state(
    time: float, names: Iterable[str] = JOINTS, stamp: float | None = None, **values: Any
) -> tuple[str, str, float, bytes]:
    """Return a message on /joint_states, stamped with its log time unless another is given."""
    values = {'position': [0.1 * time] * len(list(names)), **values}
    stamp_ns = round(1e9 * (time if stamp is None else stamp))
    return '/joint_states', JOINT_STATE, time, encode_joints(names, stamp_ns=stamp_ns, **values)


def test_a_recording_shows_its_states_and_the_loads_that_acted(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    body = payload(TIP, 2.0, (0.0, 0.1, 0.0), (0.02, 0.0, 0.0, 0.02, 0.0, 0.02))
    events = {
        1: [efforts(0.5, 0.2)],
        50: [wrench(TIP, (5.0, 0.0, 0.0), (0.0, 0.0, 1.0))],
        100: [body],
        150: [payload(TIP, 0.0)],
        160: [placed(JOINTS, (0.3, -0.2))],
    }
    settings = {'external_wrench': True, 'external_wrench_timeout': 0.03}
    roles = ['external_wrench', 'tip_wrench', 'payload', 'payload_in_use']
    simulate(path, 200, events, roles, **settings)
    found, states = logged(path), read_log(path)['/joint_states']
    assert (found.joints, found.tip, found.problems) == (JOINTS, TIP, ())
    assert found.start == states.time[0]
    np.testing.assert_allclose(found.time, states.time - states.time[0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.position, states.position)
    np.testing.assert_array_equal(found.effort, states.effort)
    # The first state is that of cycle 1.
    acted = [found.wrench[k - 1] for k in (49, 50, 79, 80)]
    assert acted[0] is acted[3] is None
    assert acted[1] == acted[2] == (TIP, (5.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    carried = [found.payload[k - 1] for k in (99, 100, 149, 150)]
    assert carried[0] is carried[3] is None
    assert carried[1] == carried[2]
    assert carried[1][:3] == (TIP, 2.0, (0.0, 0.1, 0.0))


def test_a_window_of_a_log_and_another_model_are_shown(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'a.mcap', [state(0.1 * k) for k in range(1, 51)])
    found = logged(path, robot='planar2', start=1.0, end=2.0)
    assert len(found.time) == 10
    assert found.start == pytest.approx(1.1)
    assert found.wrench == found.payload == [None] * 10
    assert np.isnan(found.effort).all()
    with pytest.raises(ValueError, match=r'no robot_description: name the robot with --robot'):
        logged(path)
    other = pfd.read_urdf(pfd.urdf_of('planar2'))
    assert logged(path, other=other).urdf is other


def test_wrenches_of_another_log_act_from_the_state_that_was_logged_after_them(
    tmp_path: Path,
) -> None:
    def push(time: float, newtons: float, frame: str = TIP) -> tuple[str, str, float, bytes]:
        data = encode_numbers(WRENCH_TYPE, 0, frame, [newtons, 0, 0, 0, 0, 0])
        return '/ft/external_wrench', WRENCH_TYPE, time, data

    rows = [
        *(state(0.1 * k) for k in range(1, 11)),
        push(0.35, 3.0),
        push(0.75, 0.0),
        push(0.95, 9.0, 'x'),
    ]
    path = write_bag(tmp_path / 'a.mcap', sorted(rows, key=lambda row: row[2]))
    for topic in (None, '/ft/external_wrench'):
        found = logged(path, robot='planar2', wrench_topic=topic)
        shown = [value is not None for value in found.wrench]
        assert shown == [3 <= k < 7 for k in range(10)]
        assert found.wrench[3].force == (3.0, 0.0, 0.0)
        (problem,) = found.problems
        assert "its frame 'x' is no link of the model" in problem
    with pytest.raises(ValueError, match=r"no topic '/nix' of geometry_msgs/msg/WrenchStamped"):
        logged(path, robot='planar2', wrench_topic='/nix')


def test_joints_of_several_publishers_hold_their_values_between_messages(tmp_path: Path) -> None:
    rows = []
    for k in range(1, 11):
        rows.append(state(0.1 * k, ['shoulder'], position=[k], effort=[k]))
        rows.append(state(0.1 * k + 0.03, ['elbow', 'finger'], position=[-k, 7.0]))
    found = logged(write_bag(tmp_path / 'a.mcap', rows), robot='planar2')
    assert found.joints == JOINTS
    assert found.position.tolist()[:4] == [[1, 0], [1, -1], [2, -1], [2, -2]]
    assert found.effort[:3, 0].tolist() == [1, 1, 2]
    assert np.isnan(found.effort[:, 1]).all()
    assert "1 joints are not in the model: ['finger']" in found.problems[0]


def test_joints_with_other_names_are_an_error_and_can_be_renamed(tmp_path: Path) -> None:
    names = ['left_shoulder', 'left_elbow']
    path = write_bag(tmp_path / 'a.mcap', [state(0.1 * k, names) for k in range(1, 11)])
    with pytest.raises(ValueError, match=r"'left_shoulder'.*'shoulder'.*--rename OLD=NEW"):
        logged(path, robot='planar2')
    assert logged(path, robot='planar2', rename={'left_': ''}).joints == JOINTS


STATES: Mapping[str, tuple[list[Any], str]] = {
    'stamps of zero': ([state(0.1 * k, stamp=0.0) for k in range(1, 11)], 'times are log times'),
    'no positions': ([state(0.1 * k, position=[]) for k in range(1, 11)], 'shown at zero'),
    'a cut message': (
        [state(0.1), ('/joint_states', JOINT_STATE, 0.2, state(0.2)[3][:30]), state(0.3)],
        '1 messages cannot be read',
    ),
}


@pytest.mark.parametrize('name', STATES)
def test_what_a_log_lacks_is_a_line(name: str, tmp_path: Path) -> None:
    rows, words = STATES[name]
    found = logged(write_bag(tmp_path / 'a.mcap', rows), robot='planar2')
    assert any(words in line for line in found.problems)
    assert (np.diff(found.time) > 0.0).all()


def test_joint_states_that_cannot_be_read_are_an_error(tmp_path: Path) -> None:
    garbage = [('/joint_states', JOINT_STATE, 0.1 * k, b'\0\7\0\0garbage') for k in range(1, 5)]
    for name, rows in (('none', []), ('garbage', garbage)):
        with pytest.raises(ValueError, match='JointState'):
            logged(write_bag(tmp_path / f'{name}.mcap', rows), robot='planar2')
