# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd compare`: the differences, the lag and the joints of two logs are those put into them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
import json
from pathlib import Path
from typing import Any

from arm_messages import named
from logs import JOINT_STATE, STATES, STRING, Row, joint_state, states, string, write_mcap
import numpy as np
import pytest
from recordings import NAMES as ARM_NAMES
from recordings import busy, simulate

from pfd_ros import read_log
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.recording.facts import facts as log_facts
from pfd_ros.replay.compare import compare as compare_logs

NAMES = ('shoulder', 'elbow')
HAND = ('finger',)
TIMES = np.arange(0, 4, 0.008)
# Linear interpolation of a sine of 2 rad/s between samples 8 ms apart, and what is left of a lag.
INTERPOLATED = 0.5 * (2 * 0.008 / 2) ** 2 + 1e-4
Motion = Callable[[float], tuple[list[float], list[float]]]


def sines(t: float) -> tuple[list[float], list[float]]:
    return (
        [np.sin(2 * t), 0.5 * np.sin(1.3 * t + 1)],
        [2 * np.cos(2 * t), 0.65 * np.cos(1.3 * t + 1)],
    )


def rows_of(
    motion: Motion,
    times: Any = TIMES,
    names: tuple[str, ...] = NAMES,
    start: float = 0.0,
    topic: str = STATES,
) -> list[Row]:
    """Return states at `times`, with the stamps start + time; joints beyond NAMES move as one."""
    order = [NAMES.index(name) if name in NAMES else 0 for name in names]
    found = []
    for t in times:
        q, qd = (np.array(x)[order] for x in motion(t))
        found.append(Row(topic, t + start, joint_state(names, q, qd, stamp=t + start)))
    return found


def log_of(path: Path, *rows: list[Row]) -> Any:
    """Write a log with messages in the order of their times, and read it."""
    return read_log(write_mcap(path, sorted(chain(*rows), key=lambda row: row.at)))


def pair(tmp_path: Path, a: list[Row], b: list[Row], **options: Any) -> Any:
    return compare_logs(log_of(tmp_path / 'a', a), log_of(tmp_path / 'b', b), **options)


# --- a log is equal to itself, whatever it holds

SAME = {
    'one publisher': states(30),
    'two publishers': [*states(30), *states(30, HAND, start=0.0004)],
    'two publishers with equal stamps': [*states(30), *states(30, HAND)],
    'one message': states(1),
    'zero stamps': [Row(STATES, 0.1 * k, joint_state(NAMES, [k, -k])) for k in range(20)],
    'some stamps': [
        Row(STATES, 0.1 * k, joint_state(NAMES, [k, -k], stamp=5.0 * (k % 3))) for k in range(20)
    ],
    'equal stamps': [Row(STATES, 1 + k, joint_state(NAMES, [k, -k], stamp=3.0)) for k in range(9)],
    'stamps that go back': [
        Row(STATES, k, joint_state(NAMES, [k, -k], stamp=20.0 - k)) for k in range(9)
    ],
    'times of the log that go back': [*states(20, start=1.0), *states(20)],
    'not a number': [
        Row(STATES, k, joint_state(NAMES, [k, np.nan], [np.nan] * 2, stamp=k + 1))
        for k in range(9)
    ],
    'positions of some messages': [
        Row(STATES, k, joint_state(NAMES, [k, 1.0] if k % 3 else [], stamp=k + 1))
        for k in range(9)
    ],
    'parts of the joints': [
        Row(STATES, k, joint_state(NAMES[: 1 + k % 2], [k, 1.0][: 1 + k % 2], stamp=k + 1))
        for k in range(9)
    ],
    'several topics': [*states(30), *states(9, HAND, topic='/hand')],
}


@pytest.mark.parametrize('name', SAME)
def test_a_log_is_equal_to_itself(tmp_path, name):
    path = write_mcap(tmp_path / 'a.mcap', SAME[name])
    assert pfd_main(['compare', str(path), str(path)]) == 0
    log = read_log(path)
    found = compare_logs(log, log)
    assert found.within
    assert (found.lag, found.shift) == (0.0, 0.0)
    counts = {
        (topic, item, joint): np.isfinite(
            log[topic][item][log[topic].rows(joint), log[topic].names.index(joint)]
        ).sum()
        for topic in log
        for item in ('position', 'velocity', 'effort')
        for joint in log[topic].names
    }
    # Each value is compared, not only those at times that differ.
    compared = {key: len(curve[0]) for key, curve in found.curves.items()}
    assert compared == {key: count for key, count in counts.items() if count}


def test_inputs_that_the_node_refused_are_no_obstacle(tmp_path):
    garbage = ArmMessage('joint_commands', bytes(7))
    simulate(tmp_path / 'a.mcap', 9, {3: [garbage], 5: [named(ARM_NAMES, (1.0, 2.0))]})
    simulate(tmp_path / 'b.mcap', 9, {5: [named(ARM_NAMES, (1.0, 2.0))]})
    a, b = (read_log(tmp_path / f'{name}.mcap') for name in 'ab')
    assert (a['/joint_commands'].unreadable, len(a['/joint_commands'])) == (1, 1)
    assert compare_logs(a, a).within
    found = compare_logs(a, b)
    assert found.only_in_a == ('/joint_commands: 1 messages that cannot be read',)
    assert not found.within
    facts = log_facts(tmp_path / 'a.mcap')['topics']['/joint_commands']
    assert (facts['messages'], facts['unreadable']) == (2, '')
    assert facts['obstacle'] == '1 of 2 messages, which the node refused'


def test_a_difference_between_messages_without_times_is_found(tmp_path):
    rows = SAME['zero stamps']
    other = [*rows[:7], Row(STATES, rows[7].at, joint_state(NAMES, [9.0, -7])), *rows[8:]]
    found = pair(tmp_path, rows, other, lag=0.0)
    (worst,) = (item for item in found.differences if item.largest)
    assert (worst.joint, worst.largest, worst.first_at) == ('shoulder', 2.0, pytest.approx(0.7))


def test_unreadable_messages_are_an_error_and_the_others_are_compared(tmp_path, capsys):
    rows = [Row(t, at, d[:60] if k % 2 else d) for k, (t, at, d) in enumerate(states(20))]
    path = write_mcap(tmp_path / 'a.mcap', rows)
    assert pfd_main(['compare', str(path), str(path)]) == 1
    shown = capsys.readouterr()
    assert '10 of 20 messages cannot be read' in shown.err
    assert any(line.endswith('equal') for line in shown.out.splitlines())


# --- clocks


@pytest.mark.sweep
@pytest.mark.parametrize('lag', [-0.3004, -0.008, 0.0013, 0.25])
@pytest.mark.parametrize('start', [0.0, 1.7e9])
def test_a_lag_between_the_clocks_is_found(tmp_path, lag, start):
    later = rows_of(lambda t: sines(t - lag), start=start)
    found = pair(tmp_path, rows_of(sines), later)
    assert found.lag == pytest.approx(lag, abs=2e-4)
    assert found.shift == pytest.approx(start, abs=1e-6)
    assert found.correlation > 0.999
    positions = [item for item in found.differences if item.field == 'position']
    assert [item.joint for item in positions] == list(NAMES)
    assert max(item.largest for item in positions) < INTERPOLATED + 2 * 2e-4


def test_logs_with_a_simulated_clock_have_no_lag(tmp_path):
    tick = bytes(4) + bytes(8)
    for name, begin in (('a', 0.0), ('b', 0.2)):
        rows = [
            Row('/clock', begin, b'\0\1' + tick[2:]),
            *rows_of(lambda t, late=begin: sines(t - late)),
        ]
        kinds = {'/clock': 'rosgraph_msgs/msg/Clock'}
        write_mcap(tmp_path / name, sorted(rows, key=lambda row: row.at), kinds)
    found = compare_logs(*(read_log(tmp_path / name) for name in 'ab'))
    assert (found.lag, found.shift, found.correlation) == (0.0, 0.0, None)
    assert not found.within


def test_a_weak_correlation_is_no_lag(tmp_path):
    rng = np.random.default_rng(1)
    noise = {name: rng.standard_normal((len(TIMES), 2)) for name in 'ab'}
    rows = [
        rows_of(lambda t, one=one: (one[round(t / 0.008)], [0.0, 0.0])) for one in noise.values()
    ]
    with pytest.raises(ValueError, match=r'no clear lag .* correlation of -?0\.\d+.*--lag 0'):
        pair(tmp_path, *rows)
    assert pair(tmp_path, *rows, lag=0.0).lag == 0


def still(q: float) -> list[Row]:
    return rows_of(lambda t: ([1.0, q], [0.0, 0.0]))


CLOCKS = {
    'of one clock that overlap in part': (
        (rows_of(sines), rows_of(sines, TIMES[350:])),
        {'shift': 0.0, 'lag': 0.0},
    ),
    'with a gap in the messages': (
        (
            rows_of(sines),
            rows_of(lambda t: sines(t - 0.02), TIMES[(TIMES < 1.0) | (TIMES >= 2.0)]),
        ),
        {'lag': pytest.approx(0.02, abs=2e-4)},
    ),
    'of arms at rest': ((still(2.0), still(2.5)), {'lag': 0.0, 'correlation': None}),
}


@pytest.mark.parametrize('name', CLOCKS)
def test_the_lag_of_logs(tmp_path, name):
    rows, expected = CLOCKS[name]
    found = pair(tmp_path, *rows)
    assert {key: getattr(found, key) for key in expected} == expected


def test_logs_of_different_rates_are_interpolated(tmp_path):
    rows = rows_of(sines), rows_of(sines, np.arange(0, 4, 0.005))
    assert pair(tmp_path, *rows, tolerance=2 * INTERPOLATED).within
    assert not pair(tmp_path, *rows, tolerance=1e-9).within


# --- joints, topics and missing values


def test_joints_are_matched_by_name_and_a_difference_has_its_place(tmp_path):
    def shifted(t):
        q, qd = sines(t)
        return [q[0] + 0.25 * (t >= 1.0), q[1]], qd

    other = rows_of(shifted, names=('elbow', 'shoulder', 'wrist'))
    found = pair(tmp_path, rows_of(sines), other, tolerance=1e-9, lag=0.0)
    by_joint = {(item.field, item.joint): item for item in found.differences}
    elbow, shoulder = by_joint['position', 'elbow'], by_joint['position', 'shoulder']
    assert (elbow.largest, elbow.first_at) == (0.0, None)
    assert shoulder.largest == pytest.approx(0.25, abs=1e-12)
    assert shoulder.first_at == pytest.approx(1.0, abs=1e-9)
    assert shoulder.rms == pytest.approx(0.25 * np.sqrt(np.mean(TIMES >= 1.0)), rel=1e-9)
    assert found.only_in_b == ('/joint_states: wrist',)
    assert not found.within


def lost_from(start: float) -> Motion:
    def motion(t: float) -> tuple[list[float], list[float]]:
        q, qd = sines(t)
        return [np.nan if t >= start else q[0], q[1]], qd

    return motion


def spiked(t: float) -> tuple[list[float], list[float]]:
    q, qd = sines(t)
    return [q[0] + 5.0 * (abs(t - 1.004) < 1e-6), q[1]], qd


@pytest.mark.parametrize(
    ('motion', 'times'),
    [(lost_from(3.0), TIMES), (lost_from(3.0), TIMES[::2]), (lost_from(-1.0), TIMES)],
)
def test_a_log_that_lacks_values_is_not_equal(tmp_path, motion, times):
    found = pair(tmp_path, rows_of(sines), rows_of(motion, times), lag=0.0, tolerance=0.01)
    assert not found.within
    assert any('values, position of shoulder' in line for line in found.only_in_a)
    assert all(item.first_at is None for item in found.differences)


def test_time_that_only_one_log_covers_and_a_spike_between_samples_are_stated(tmp_path):
    found = pair(tmp_path, rows_of(sines), rows_of(sines, TIMES[:50]), lag=0.0)
    assert not found.within
    assert found.uncovered == pytest.approx(TIMES[-1] - TIMES[49] - 2 * 0.008, abs=1e-9)
    found = pair(tmp_path, rows_of(sines), rows_of(spiked, np.arange(0, 3.99, 0.004)), lag=0.0)
    assert found.differences[0].largest == pytest.approx(5.0, abs=1e-3)


def test_a_topic_that_only_one_log_has_is_named(tmp_path):
    more = [*states(30), *states(9, HAND, topic='/hand')]
    assert pair(tmp_path, more, states(30)).only_in_a == ('/hand',)


def test_recordings_are_compared_by_role_whatever_their_topics_are_called(tmp_path):
    first, same, other = (tmp_path / f'{name}.mcap' for name in ('first', 'same', 'other'))
    busy(first)
    run = busy(same, topics={'joint_states': '/arm_7/states', 'joint_commands': '/arm_7/commands'})
    assert run.topics['joint_states'] == '/arm_7/states'
    found = compare_logs(read_log(first), read_log(same))
    assert found.within
    assert {item.topic for item in found.differences} == {STATES, '/joint_commands'}
    simulate(other, 60, {3: [named(ARM_NAMES, (1.0, 2.0))]})
    found = compare_logs(read_log(first), read_log(other))
    assert (found.lag, found.shift, found.correlation, found.within) == (0.0, 0.0, None, False)


@pytest.mark.parametrize(
    ('arguments', 'line'),
    [
        ({'tolerance': -1.0}, 'tolerance must be 0 or more and finite, got -1.0'),
        ({'tolerance': np.nan}, 'tolerance must be 0 or more and finite, got nan'),
        ({'topics': ('/text', '/text')}, "topic '/text' is std_msgs/msg/String"),
        ({'topics': ('/nix', '/text')}, "topic '/nix' is not in the log, expected sensor_msgs"),
        ({'lag': np.nan}, 'lag must be finite, got nan'),
        ({'lag': 1e9}, 'have no joint with values at common times'),
    ],
)
def test_bad_arguments_are_named(tmp_path, arguments, line):
    rows = [Row('/text', 1000.0, string('a')), *states(3)]
    path = write_mcap(tmp_path / 'a.mcap', rows, {'/text': STRING})
    for log in (read_log(path), read_log(path, types=[JOINT_STATE])):
        with pytest.raises(ValueError, match=line):
            compare_logs(log, log, **arguments)


def test_logs_without_a_common_joint_or_topic_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"joints are \['shoulder', 'elbow'\] and \['x', 'y'\]"):
        pair(tmp_path, rows_of(sines), rows_of(sines, names=('x', 'y')))
    # A command that both arms refused names a joint that one of them has.
    logs = []
    for robot in ('planar2', 'puma560'):
        refused = {3: [named(('elbow', 'shoulder'), (1.0,))]}
        simulate(tmp_path / f'{robot}.mcap', 10, refused, robot=robot)
        logs.append(read_log(tmp_path / f'{robot}.mcap'))
    with pytest.raises(ValueError, match=r"joints are \['shoulder', 'elbow'\] and \['joint1',"):
        compare_logs(*logs)
    two = [*states(3, topic='/a'), *states(3, topic='/b')]
    with pytest.raises(ValueError, match=rf'no topic of {JOINT_STATE} in both, name one of each'):
        pair(tmp_path, two, states(3))


# --- the command


def test_the_command_prints_a_line_for_each_joint_and_draws_both_logs(tmp_path, capsys):
    a = write_mcap(tmp_path / 'a.mcap', rows_of(sines))
    still = rows_of(
        lambda t: ([0.0, 0.0], [0.0, 0.0]), names=('r_shoulder', 'r_elbow'), topic='/arm'
    )
    b = write_mcap(tmp_path / 'b.mcap', still)
    picture = tmp_path / 'both.png'
    # The only topic of JointStates of each log, whatever its name.
    words = ['compare', str(a), str(b), '--lag', '0', '--rename', 'r_=']
    assert pfd_main([*words, '--tolerance', '0.1', '--plot', str(picture)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('lag of B 0.000 ms; 3.992 s compared')
    assert sum('first beyond 0.1 at' in line for line in lines) == 2 * len(NAMES)
    assert picture.read_bytes().startswith(b'\x89PNG')
    assert pfd_main([*words, '--topics', STATES, '/arm', '--tolerance', '9', '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found['within'], found['lag'], found['tolerance']) == (True, 0.0, 9.0)
    assert {item['joint'] for item in found['differences']} == set(NAMES)
    b.write_bytes(a.read_bytes()[:-8])
    assert pfd_main(['compare', str(a), str(b)]) == 0
    assert [x for x in capsys.readouterr().out.splitlines() if 'cut off' in x] == [
        'cut off: B was not closed; compared up to the cut'
    ]
