# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd compare`: the differences, the lag and the joints of two logs are those put into them."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

from bridge import compare_logs, pfd_main
import numpy as np
import pytest
from rewriting import GOLDEN

from pfd_ros import read_log

rosbag2 = pytest.importorskip('rosbags.rosbag2')
typesys = pytest.importorskip('rosbags.typesys')
STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
KIND = 'sensor_msgs/msg/JointState'
NAMES = ('shoulder', 'elbow')
Motion = Callable[[float], tuple[list[float], list[float]]]
# Linear interpolation of a sine of 2 rad/s between samples 8 ms apart, and what is left of a lag.
INTERPOLATED = 0.5 * (2 * 0.008 / 2) ** 2 + 1e-4


def sines(t: float) -> tuple[list[float], list[float]]:
    return [np.sin(2 * t), 0.5 * np.sin(1.3 * t + 1)], [
        2 * np.cos(2 * t),
        0.65 * np.cos(1.3 * t + 1),
    ]


def write(
    path: Path,
    motion: Motion,
    *,
    times: Any,
    names: tuple[str, ...] = NAMES,
    start: float = 0.0,
    topic: str = '/joint_states',
) -> Path:
    """Write a bag whose states at `times` have the stamps start + time."""
    header, stamp = STORE.types['std_msgs/msg/Header'], STORE.types['builtin_interfaces/msg/Time']
    order = [NAMES.index(name) if name in NAMES else 0 for name in names]
    with rosbag2.Writer(path, version=9) as writer:
        connection = writer.add_connection(topic, KIND, typestore=STORE)
        for t in times:
            at = round((t + start) * 1e9)
            q, qd = (np.array(x)[order] for x in motion(t))
            message = STORE.types[KIND](
                header(stamp(at // 10**9, at % 10**9), ''), list(names), q, qd, np.zeros(0)
            )
            writer.write(connection, at, bytes(STORE.serialize_cdr(message, KIND)))
    return path


TIMES = np.arange(0, 4, 0.008)


def test_a_log_is_equal_to_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert pfd_main(['compare', str(GOLDEN), str(GOLDEN), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['within']
    assert found['lag'] == 0
    assert {item['largest'] for item in found['differences']} == {0.0}
    # Its commands have no stamps; they are equal message by message.
    assert found['unordered'] == []
    assert not any(item['topic'] == '/joint_commands' for item in found['differences'])


@pytest.mark.sweep
@pytest.mark.parametrize('lag', [-0.3004, -0.008, 0.0013, 0.25])
@pytest.mark.parametrize('start', [0.0, 1.7e9])
def test_a_lag_between_the_clocks_is_found(tmp_path: Path, lag: float, start: float) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    later = write(tmp_path / 'b', lambda t: sines(t - lag), times=TIMES, start=start)
    found = compare_logs(a, read_log(later))
    assert found.lag == pytest.approx(lag, abs=2e-4)
    assert found.shift == pytest.approx(start, abs=1e-6)
    positions = [item for item in found.differences if item.field == 'position']
    assert [item.joint for item in positions] == list(NAMES)
    assert max(item.largest for item in positions) < INTERPOLATED + 2 * 2e-4


def test_joints_are_matched_by_name_and_a_difference_has_its_place(tmp_path: Path) -> None:
    def shifted(t: float) -> tuple[list[float], list[float]]:
        q, qd = sines(t)
        return [q[0] + 0.25 * (t >= 1.0), q[1]], qd

    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    other = write(tmp_path / 'b', shifted, times=TIMES, names=('elbow', 'shoulder', 'wrist'))
    found = compare_logs(a, read_log(other), tolerance=1e-9, lag=0.0)
    by_joint = {(item.field, item.joint): item for item in found.differences}
    elbow, shoulder = by_joint['position', 'elbow'], by_joint['position', 'shoulder']
    assert (elbow.largest, elbow.first_at) == (0.0, None)
    assert shoulder.largest == pytest.approx(0.25, abs=1e-12)
    assert shoulder.first_at == pytest.approx(1.0, abs=1e-9)
    share = np.mean(TIMES >= 1.0)
    assert shoulder.rms == pytest.approx(0.25 * np.sqrt(share), rel=1e-9)
    assert found.only_in_b == ('/joint_states: wrist',)
    assert not found.within


def test_logs_of_different_rates_are_interpolated(tmp_path: Path) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    b = read_log(write(tmp_path / 'b', sines, times=np.arange(0, 4, 0.005)))
    found = compare_logs(a, b, tolerance=INTERPOLATED, fields=['position'])
    assert found.within
    assert not compare_logs(a, b, tolerance=1e-9, fields=['position']).within


def lost_from(start: float) -> Motion:
    def motion(t: float) -> tuple[list[float], list[float]]:
        q, qd = sines(t)
        return [np.nan if t >= start else q[0], q[1]], qd

    return motion


def spiked(t: float) -> tuple[list[float], list[float]]:
    q, qd = sines(t)
    return [q[0] + 5.0 * (abs(t - 1.004) < 1e-6), q[1]], qd


@pytest.mark.parametrize(
    ('motion', 'times', 'missing'),
    [
        (lost_from(3.0), TIMES, ('values', 'position of shoulder')),
        (sines, TIMES[:50], ('uncovered', '')),
        (lost_from(-1.0), TIMES, ('values', 'position of shoulder')),
    ],
)
def test_a_log_that_lacks_values_or_time_is_not_equal(
    tmp_path: Path, motion: Motion, times: Any, missing: tuple[str, str]
) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    b = read_log(write(tmp_path / 'b', motion, times=times))
    found = compare_logs(a, b, lag=0.0)
    assert not found.within
    if missing[0] == 'values':
        assert any(missing[1] in text for text in found.only_in_a)
    else:
        assert found.uncovered == pytest.approx(TIMES[-1] - TIMES[49] - 2 * 0.008, abs=1e-9)
    assert all(item.first_at is None for item in found.differences)


def test_a_spike_between_the_samples_of_the_other_log_is_a_difference(tmp_path: Path) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    b = read_log(write(tmp_path / 'b', spiked, times=np.arange(0, 3.99, 0.004)))
    found = compare_logs(a, b, tolerance=0.1, lag=0.0, fields=['position'])
    assert found.differences[0].largest == pytest.approx(5.0, abs=1e-3)


def test_a_topic_that_only_one_log_has_is_named(tmp_path: Path) -> None:
    a = read_log(GOLDEN)
    b = read_log(GOLDEN, topics=['/joint_states'])
    assert compare_logs(a, b).only_in_a == ('/joint_commands',)


def test_logs_of_one_clock_that_overlap_in_part_have_no_shift(tmp_path: Path) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    b = read_log(write(tmp_path / 'b', sines, times=TIMES[350:] + 0.0))
    found = compare_logs(a, b)
    assert (found.shift, found.lag) == (0.0, 0.0)


def test_a_gap_in_the_messages_does_not_move_the_lag(tmp_path: Path) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    times = np.r_[TIMES[TIMES < 1.0], TIMES[TIMES >= 2.0]]
    b = read_log(write(tmp_path / 'b', lambda t: sines(t - 0.02), times=times))
    assert compare_logs(a, b).lag == pytest.approx(0.02, abs=2e-4)


def test_arms_at_rest_have_no_lag(tmp_path: Path) -> None:
    still = write(tmp_path / 'a', lambda t: ([1.0, 2.0], [0.0, 0.0]), times=TIMES)
    other = write(tmp_path / 'b', lambda t: ([1.0, 2.5], [0.0, 0.0]), times=TIMES)
    found = compare_logs(read_log(still), read_log(other))
    assert found.lag == 0
    assert [item.largest for item in found.differences][:2] == [0.0, 0.5]


def test_the_command_prints_a_line_for_each_joint_and_draws_both_logs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = write(tmp_path / 'a', sines, times=TIMES)
    b = write(tmp_path / 'b', lambda t: ([0.0, 0.0], [0.0, 0.0]), times=TIMES, topic='/arm')
    picture = tmp_path / 'both.png'
    # The only topic of JointStates of each log, whatever its name.
    arguments = ['compare', str(a), str(b), '--lag', '0', '--plot', str(picture)]
    assert pfd_main([*arguments, '--tolerance', '0.1', '--fields', 'position']) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('lag of B 0.000 ms; 3.992 s compared')
    assert sum('first beyond 0.1 at' in line for line in lines) == len(NAMES)
    assert picture.read_bytes().startswith(b'\x89PNG')
    assert pfd_main([*arguments[:3], '--tolerance', '9']) == 0


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'tolerance': -1.0}, 'tolerance must be 0 or more and finite, got -1.0'),
        ({'tolerance': float('nan')}, 'tolerance must be 0 or more and finite, got nan'),
        ({'tolerance': float('inf')}, 'tolerance must be 0 or more and finite, got inf'),
        ({'fields': ['torque']}, r"fields must be some of .*, got \['torque'\]"),
        ({'topics': ('/clock', '/clock')}, "topic '/clock' is rosgraph_msgs/msg/Clock"),
        (
            {'topics': ('/joint_commands',) * 2},
            "stamps of topic '/joint_commands' do not increase",
        ),
        ({'lag': 1e9}, 'have no joint with values at common times'),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    log = read_log(GOLDEN)
    with pytest.raises(ValueError, match=message):
        compare_logs(log, log, **arguments)


def test_logs_without_a_common_joint_are_refused(tmp_path: Path) -> None:
    a = read_log(write(tmp_path / 'a', sines, times=TIMES))
    b = read_log(write(tmp_path / 'b', sines, times=TIMES, names=('x', 'y')))
    with pytest.raises(ValueError, match=r"joints are \['shoulder', 'elbow'\] and \['x', 'y'\]"):
        compare_logs(a, b)
