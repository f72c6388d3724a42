# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a log: what it finds by a table of faults, its curves, and browsers that show it."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
import hashlib
from html.parser import HTMLParser
import json
from pathlib import Path
import random
import re
from typing import Any
import zlib

from arm_messages import change, efforts, named, placed, request, trajectory
from devtools import needs_browser
import gripper_arm
from logs import JOINT_STATE, STORE, STRING, Row, random_message, write_mcap
import numpy as np
import pytest
from recordings import rewritten, simulate
from ros_processes import wait_until

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.arm.events import BUSY
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.messages.joints import encode_joints
from pfd_ros.messages.values import encode_string
from pfd_ros.page.curves import Reference as PageReference
from pfd_ros.page.findings import Finding as PageFinding
from pfd_ros.page.page import TYPES as PAGE_TYPES
from pfd_ros.page.page import page as page_of_log

HOSTILE = '</script><img src=x onerror=alert(1)>&"\'{{}}\u2028'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
UR5 = (
    'shoulder_pan_joint',
    'shoulder_lift_joint',
    'elbow_joint',
    *(f'wrist_{k}_joint' for k in (1, 2, 3)),
)
# A joint of planar2 turns freely, and reaches its limit of 20 rad/s.
FREE: dict[str, Any] = {'gravity': [0.0, 0.0, 0.0]}
DAY = 1_700_000_000.0


def shown(path: Path, *marks: Any, **more: Any) -> Any:
    """Return the page of a log."""
    return page_of_log(read_log(path, types=PAGE_TYPES, unreadable='count'), marks, **more)


def data_of(page: Any) -> dict[str, Any]:
    """Return what the script of a page draws."""
    found = re.search('id="data">(.*?)</script>', page.html, re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


def decoded(text: str, kind: str) -> Any:
    """Return numbers as the script of a page decodes them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    return np.ascontiguousarray(planes.reshape(np.dtype(kind).itemsize, -1).T).view(kind).ravel()


def write_bag(path: Path, messages: Iterable[tuple[Any, ...]], **more: Any) -> Path:
    """Write a log of another program: topic, log time [s], a JointState's fields or bytes, type.

    `more` are type and encoding of all topics, where they are not those of a JointState.
    """
    rows, kinds = [], {}
    for topic, time, given, *own in messages:
        kinds[topic] = own[0] if own else more.get('kind', JOINT_STATE)
        data = given
        if isinstance(given, Mapping):
            data = encode_joints(**{'stamp_ns': round(time * 1e9), **given})
        rows.append(Row(topic, time, data))
    schemas = {more['kind']: ('ros2msg', b'', more['encoding'])} if 'encoding' in more else None
    return write_mcap(path, rows, kinds, schemas=schemas)


def states(
    names: Iterable[str], times: Iterable[float], topic: str = '/joint_states', shift: float = 0.0
) -> list[tuple[str, float, Any]]:
    """Return messages of joints that turn."""
    names = list(names)
    found = []
    for time in times:
        angle = np.sin(time - DAY + np.arange(len(names)))
        given = {'names': names, 'position': angle, 'velocity': angle.copy(), 'effort': angle}
        found.append((topic, time + shift, given))
    return found


TIMES = DAY + 0.01 * np.arange(200)


# Inputs by cycle, cycles, settings; then severity, joint, time, number of spans, kind and words.
STEADY = {k: [efforts(0.0, 0.0)] for k in range(1, 201)}
JUMP = {'reflex_effort_rate': 1000.0, **FREE}
OUT = {'effort_limits': False, 'torque_speed': False, **FREE}
FAULTS: dict[str, tuple[Any, int, dict[str, Any], tuple[Any, ...], str, str]] = {
    'effort at its limit': (
        {1: [efforts(0.0, 0.0)], 50: [efforts(25.0, 0.0)], 60: [efforts(0.0, 0.0)]},
        *(100, FREE, ('warning', 'shoulder', 0.051, 1), 'effort limit', 'effort 20 N m'),
    ),
    'too fast': (
        {1: [efforts(15.0, 0.0)]},
        *(600, FREE, ('bad', 'elbow', 0.312, 3), 'velocity limit', 'velocity 20.06 rad/s'),
    ),
    'wrong size': (
        {**STEADY, 40: [efforts(1.0)]},
        *(100, FREE, ('bad', '', 0.041, 1), 'rejected input', 'commands wrong_size'),
    ),
    'NaN of one joint': (
        {**STEADY, 40: [efforts(1.0, np.nan)], 41: [efforts(1.0, np.nan)]},
        *(100, FREE, ('bad', '', 0.041, 2), 'rejected input', 'commands not_finite'),
    ),
    'silence': (
        # A rejected command does not count.
        {
            1: [efforts(0.5, 0.2)],
            100: [efforts(1.0)],
            150: [efforts(0.0, 0.0)],
            190: [efforts(0.0, 0.0)],
        },
        *(200, {'command_timeout': 0.05, **FREE}, ('bad', '', 0.052, 1)),
        *('watchdog', 'command_timeout 0.05 s: brake'),
    ),
    'jump of an effort': (
        {**STEADY, 40: [efforts(15.0, 0.0)]},
        *(100, JUMP, ('bad', '', 0.042, 60), 'reflex', 'commands are refused until ~/reset'),
    ),
    'jump of the last effort': (
        {1: [efforts(0.0, 0.0)], 100: [efforts(15.0, 0.0)]},
        *(100, JUMP, ('bad', '', 0.101, 1), 'reflex', 'braked at the end'),
    ),
    'run away': (
        {40: [efforts(1e300, 0.0)]},
        *(100, OUT, ('bad', '', None, 1), 'failure', 'the simulation stopped'),
    ),
    'run away of a clock that shows the time of day': (
        {40: [efforts(1e300, 0.0)]},
        *(100, {**OUT, 'start_time': DAY}, ('bad', '', None, 1)),
        *('failure', 'the simulation stopped'),
    ),
    'states are lost': (
        *({}, 100, {'drop_state': 0.2, 'seed': 3}, ('note', '', None, None)),
        *('gap', 'no state on /joint_states for'),
    ),
    'parameters': (
        {20: [change(noise_position=1e-4)]},
        *(100, {}, ('note', '', 0.021, 1), 'event', 'parameters {"noise_position"'),
    ),
    'reset': ({20: [request('reset')]}, 100, {}, ('note', '', 0.021, 1), 'event', 'reset'),
    'state is set': (
        {20: [placed(('shoulder', 'elbow'), (0.1, 0.2))]},
        *(100, {}, ('note', '', 0.021, 1), 'event', 'set_state'),
    ),
}


@pytest.mark.parametrize('name', FAULTS)
def test_each_fault_is_found_with_its_kind_joint_time_and_count(name, tmp_path):
    events, cycles, given, (severity, joint, time, count), kind, words = FAULTS[name]
    simulate(tmp_path / 'a.mcap', cycles, events, **given)
    page = shown(tmp_path / 'a.mcap')
    found = [x for x in page.findings if x.kind == kind and words in x.text]
    assert [(x.severity, x.joint) for x in found] == [(severity, joint)]
    assert time is None or found[0].time == pytest.approx(time, abs=1.5e-3)
    assert count in (None, len(found[0].spans))
    worse = [x for x in page.findings if x.severity != 'note']
    assert (page.first is not None) == (severity != 'note') == bool(worse)
    good = re.search('nothing( else)? went wrong', page.said)
    assert bool(good) == (severity == 'note')


def test_a_run_without_faults_says_so_and_lists_the_checks(tmp_path):
    simulate(tmp_path / 'a.mcap', 200, STEADY, **FREE)
    page = shown(tmp_path / 'a.mcap')
    said = page.said, page.first, page.findings, [*page.run.unreadable]
    assert said == ('nothing went wrong', None, [], [])
    for check in ('limits', 'finite numbers', 'missing states', 'rejected inputs', 'failure'):
        assert re.search(f'Checked: [^.]*{check}', page.html), check


def test_a_joint_that_begins_at_its_limit_reaches_it_when_it_comes_back(tmp_path):
    robot = pfd.load_robot('ur5')
    rows = states(UR5, TIMES)
    for k, (_, _, given) in enumerate(rows):
        given['position'][0] = robot.position_lower[0] + (0.1 if 10 <= k < 150 else 0.0)
        given['position'][1] = robot.position_upper[1] + 1e-6
    page = shown(write_bag(tmp_path / 'a.mcap', rows), robot=robot)
    found = [(x.joint, x.time) for x in page.findings if x.kind == 'position limit']
    assert found == [(UR5[1], 0.0), (UR5[0], pytest.approx(1.5))]


def test_a_recording_without_states_takes_no_command_for_one(tmp_path):
    refused = named(('shoulder', 'elbow'), [25.0, np.inf])
    simulate(tmp_path / 'a.mcap', 3, {1: [refused]}, publish_rate=100.0, **FREE)
    page = shown(tmp_path / 'a.mcap')
    assert (page.run.topic, page.first.kind) == ('', 'rejected input')


def test_the_end_of_a_controller_is_no_fault(tmp_path):
    path = tmp_path / 'a.mcap'
    # The arm swings under gravity with its last efforts, until the watchdog brakes it.
    events = {k: [efforts(2.0, 1.0)] for k in range(1, 300)}
    simulate(path, 1500, events, command_timeout=1.0, effort_limits=False)
    page = shown(path)
    assert page.first is None
    assert page.said == 'nothing went wrong up to the last command at t = 0.299 s'
    late = {x.kind: x.severity for x in page.findings if x.time > 0.299}
    assert late['watchdog'] == 'note'
    assert 'headline good' in page.html


def test_a_window_of_a_log_shows_only_what_is_in_it(tmp_path):
    path = tmp_path / 'a.mcap'
    events = {500: [efforts(1.0)], 3000: [efforts(1e300, 0.0)]}
    limits = {'effort_limits': False, 'torque_speed': False, 'recording_time': 'simulated'}
    simulate(path, 3200, events, **limits, **FREE)
    kinds = []
    for window in ({}, {'start': 0.2, 'end': 1.0}, {'end': 0.3}):
        log = read_log(path, types=PAGE_TYPES, unreadable='count', **window)
        kinds.append({x.kind for x in page_of_log(log).findings if x.severity == 'bad'})
    assert kinds == [{'rejected input', 'failure'}, {'rejected input'}, set()]


@pytest.mark.parametrize('last', [False, True])
def test_a_second_controller_that_is_refused_hides_no_command_of_the_first(last, tmp_path):
    path = tmp_path / 'a.mcap'
    both = [efforts(1.0), efforts(0.3, 0.2)]
    events = dict.fromkeys(range(1, 201), both[::-1] if last else both)
    simulate(path, 200, events, command_timeout=0.05, **FREE)
    page = shown(path)
    assert {(x.kind, len(x.spans)) for x in page.findings} == {('rejected input', 200)}
    (plot,) = (x for x in page.plots if x.title.startswith('commanded effort'))
    assert len(plot.time) == 201
    np.testing.assert_array_equal(plot.values[:, 1], 0.2)


def test_commanded_positions_are_the_reference_of_a_joint(tmp_path):
    path = tmp_path / 'a.mcap'
    # A motion of 2 Hz that a servo follows; the other joint is set to one position.
    wanted = 0.1 * (1.0 - np.cos(2 * np.pi * 2.0 * 1e-3 * np.arange(2000)))
    events = {k + 1: [named(['elbow'], position=[x])] for k, x in enumerate(wanted)}
    events[100].append(named(['shoulder'], position=[0.01]))
    servo = {'servo_p': (300.0, 300.0), 'servo_d': (60.0, 15.0), 'gravity_compensation': True}
    simulate(path, 2000, events, **servo, **FREE)
    page = shown(path)
    assert page.plots[0].references == (('elbow', 'reference'), ('shoulder', 'reference'))
    elbow, shoulder = page.plots[0].values[:, 2:].T
    assert np.isnan(shoulder[:98]).all()
    assert (shoulder[100:] == 0.01).all()
    assert elbow[5:-5] == pytest.approx(wanted[5:-5], abs=0.005)
    lines = re.findall('<li>(.*?)</li>', page.html)
    assert any(line.startswith('elbow: follows its reference within 0.0') for line in lines), lines


def test_points_of_trajectories_are_drawn_up_to_the_next_and_feed_the_watchdog(tmp_path):
    path = tmp_path / 'a.mcap'
    first = trajectory(('elbow', 'shoulder'), [0.1, 0.3], positions=[[0.1, 0.0], [0.2, 0.05]])
    events = {
        101: [first],
        301: [trajectory(('shoulder',), [0.5], 250_000_000, positions=[[0.0]], effort=[[1.0]])],
    }
    servo = {'servo_p': (300.0, 300.0), 'servo_d': (60.0, 15.0), 'gravity_compensation': True}
    simulate(path, 2000, events, command_timeout=0.05, **servo, **FREE)
    page = shown(path)
    position, effort = (x for x in page.plots if x.title.startswith('commanded points'))
    assert position.source == '/sim_arm/joint_trajectory'
    assert position.labels == effort.labels == ('elbow', 'shoulder')
    assert position.time == pytest.approx([0.2, 0.75], abs=1e-6)
    assert position.values[0].tolist() == [0.1, 0.0]
    assert np.isnan(position.values[1, 0])
    assert position.values[1, 1] == 0.0
    assert effort.values[:, 1].tolist()[-1] == 1.0
    assert not {'watchdog', 'rejected input'} & {finding.kind for finding in page.findings}
    assert 'shoulder: never commanded' not in page.html


@pytest.mark.parametrize(
    ('event', 'last'),
    [
        (trajectory(('nobody',), [0.2], positions=[[9.0]]), 0.4),
        (named(['elbow'], [0.0], position=[0.0]), 0.1),
        (placed(['elbow'], [0.1]), 0.1),
        (request('reset'), 0.1),
    ],
    ids=['refused trajectory', 'command', 'jump', 'reset'],
)
def test_points_are_drawn_up_to_what_ends_their_trajectory(event, last, tmp_path):
    path = tmp_path / 'a.mcap'
    plan = trajectory(('elbow',), [0.1, 0.3, 0.4], positions=[[0.1], [0.2], [0.3]])
    simulate(path, 600, {1: [plan], 201: [event]}, servo_p=(4.0, 4.0))
    (points,) = (x for x in shown(path).plots if x.title.startswith('commanded points'))
    assert points.time[-1] == pytest.approx(last, abs=1e-6)
    assert np.nanmax(points.values) < 1.0


def test_a_joint_is_compared_with_its_trajectory_as_the_arm_samples_it(tmp_path):
    still = np.zeros((2, 1))
    plan = trajectory(('elbow',), [0.0, 0.5], positions=[[0.1], [0.6]], velocities=still)
    servo = {'servo_p': (0.0, 100.0), 'servo_d': (0.0, 8.0), 'gravity': (0.0,) * 3}
    held, refused = named(['elbow'], position=[0.05]), named(['shoulder'], position=[1e9])
    events = {21: [held], 101: [plan], 801: [placed(['elbow'], [0.1])], 901: [refused]}
    simulate(tmp_path / 'a.mcap', 1000, events, **servo)
    page = shown(tmp_path / 'a.mcap')
    position = next(plot for plot in page.plots if plot.title == 'position [rad]')
    assert list(position.references) == [('elbow', 'reference')]
    # A cubic of 0.5 s from 0.1 to 0.6 from the state on that the message met, held up to the jump.
    x = (position.time - 0.1) / 0.5
    cubic = 0.1 + 0.5 * (3.0 * x**2 - 2.0 * x**3)
    wanted = np.where(x < -1e-9, 0.05, np.where(x < 1.0, cubic, 0.6))
    found, time = position.values[:, 2], position.time
    assert np.isfinite(found).tolist() == ((time > 0.0205) & (time < 0.8005)).tolist()
    chosen = np.isfinite(found)
    np.testing.assert_allclose(found[chosen], wanted[chosen], rtol=0, atol=1e-9)
    assert any(line.startswith('elbow: follows its reference within') for line in page.joints)
    assert 'shoulder: never commanded: braked' in page.joints


# Logs of other programs.


def test_joints_of_several_publishers_are_apart_and_have_no_gaps(tmp_path):
    sources = {
        'arms': (
            states([f'left_{x}' for x in UR5], TIMES),
            states([f'right_{x}' for x in UR5], TIMES, shift=4e-4),
        ),
        'gripper': (states(['finger'], TIMES), states(UR5, TIMES, shift=1e-3)),
        'one stamp': (states(UR5, TIMES), states(['finger'], TIMES)),
    }
    for name, (one, other) in sources.items():
        both = [message for pair in zip(one, other, strict=True) for message in pair]
        page = shown(write_bag(tmp_path / f'{name}.mcap', both))
        assert page.said == 'nothing went wrong', name
        assert [plot.labels for plot in page.plots[:2]] == [
            tuple(one[0][2]['names']),
            tuple(other[0][2]['names']),
        ]
        for plot in page.plots:
            assert len(plot.time) == len(TIMES)
            assert np.isfinite(plot.values).all()


def test_missing_states_are_a_gap_and_no_line_crosses_it(tmp_path):
    times = [t for k, t in enumerate(TIMES) if not 40 <= k < 60]
    page = shown(write_bag(tmp_path / 'a.mcap', states(['a', 'b'], times)))
    (gap,) = page.findings
    assert (gap.kind, gap.severity) == ('gap', 'warning')
    assert gap.spans == pytest.approx(np.array([[0.39, 0.60]]), abs=1e-6)
    drawn = data_of(page)['plots'][0]
    values = decoded(drawn['values'], '<f4').reshape(2, -1)
    assert np.isnan(values[:, 40]).all()
    assert np.isfinite(np.delete(values, 40, axis=1)).all()


@pytest.mark.parametrize('kind', ['JSON', 'half of them cut off'])
def test_a_log_that_cannot_be_read_is_never_good(kind, tmp_path, capsys):
    path, more = tmp_path / 'a.mcap', {}
    rows = [('/joint_states', t, b'{"joints": []}') for t in TIMES]
    if kind == 'JSON':
        more = {'kind': 'foxglove.JointStates', 'encoding': 'json'}
    else:
        whole = encode_joints(UR5, np.zeros(6), stamp_ns=0)
        rows = [(topic, t, whole[: 60 if k % 2 else None]) for k, (topic, t, _) in enumerate(rows)]
    page = shown(write_bag(path, rows, **more))
    assert '/joint_states' in page.said
    assert page.run.unreadable
    assert 'headline bad' in page.html
    assert 'othing went wrong' not in page.html
    assert pfd_main(['report', 'log', str(path), '--out', str(tmp_path / 'a.html')]) == 1
    printed = capsys.readouterr()
    assert '/joint_states' in printed.err
    assert 'nothing went wrong' not in printed.out


def test_messages_without_a_stamp_are_placed_by_the_state_before_them(tmp_path):
    path = tmp_path / 'a.mcap'
    # Simulated time at a tenth of the wall clock, logged by the wall clock.
    rows: list[tuple[str, float, Any]] = []
    for k in range(100):
        wall = DAY + 0.1 * k
        given = {'names': ['a'], 'position': [0.0], 'stamp_ns': round(1e9 * (5.0 + 0.01 * k))}
        rows.append(('/joint_states', wall, given))
        if k == 50:
            rows.append(('/arm_commands', wall + 0.001, {**given, 'stamp_ns': 0}))
    page = shown(write_bag(path, rows))
    commands = next(plot for plot in page.plots if plot.title.startswith('commanded'))
    assert commands.time == pytest.approx([5.501])
    assert [page.plots[0].time[0], page.plots[0].time[-1]] == pytest.approx([5.0, 5.99])


def test_stamps_that_are_no_times_are_replaced_by_log_times(tmp_path):
    rows = [(topic, t, {**given, 'stamp_ns': 17}) for topic, t, given in states(['a'], TIMES)]
    page = shown(write_bag(tmp_path / 'a.mcap', rows))
    assert any('times are log times' in note for note in page.run.notes)
    assert page.plots[0].time == pytest.approx(TIMES - DAY, abs=1e-6)


def test_the_robot_of_another_log_gives_its_limits(tmp_path):
    path, robot = write_bag(tmp_path / 'a.mcap', states(UR5, TIMES)), pfd.load_robot('ur5')
    assert 'limits (the log names no robot; --robot adds one)' in shown(path).html
    other = shown(path, robot=pfd.load_robot('planar2'))
    assert 'limits (no joint of the log is one of planar2)' in other.html
    page = shown(path, robot=robot)
    assert re.search('Checked: limits', page.html)
    assert page.plots[1].title == 'velocity [rad/s]'
    bounds = page.plots[1].bounds
    assert bounds.tolist() == [(-robot.velocity_limit).tolist(), robot.velocity_limit.tolist()]
    # Of joints that turn and slide each has its unit.
    sliding = gripper_arm.urdf().replace('type="revolute"', 'type="prismatic"', 1)
    moving = states(gripper_arm.ARM, TIMES)
    moving[70][2]['velocity'][:] = 9.5, 9.5
    bag = write_bag(tmp_path / 'b.mcap', moving)
    found = shown(bag, robot=pfd.load_robot(sliding, locked={'finger': 0.0})).findings
    assert [x.text.split()[2] for x in found] == ['m/s,', 'rad/s,']


def test_limits_that_a_log_has_no_numbers_for_are_named(tmp_path):
    robot = pfd.load_robot('ur5')
    other = write_bag(tmp_path / 'a.mcap', states(['a', *UR5[:5]], TIMES))
    (note,) = (x for x in shown(other, robot=robot).run.notes if 'limits' in x)
    assert note.startswith("no limits of ['a']: joints of ur5 are ['shoulder_pan_joint'")
    rows = states(UR5, TIMES)
    bare = [(topic, t, {**given, 'velocity': [], 'effort': []}) for topic, t, given in rows]
    notes = shown(write_bag(tmp_path / 'b.mcap', bare), robot=robot).run.notes
    assert [note.partition(' of ')[0] for note in notes] == ['no velocities', 'no efforts']


@pytest.mark.parametrize('arms', [0, 1, 2])
def test_the_one_description_in_another_log_gives_the_limits(tmp_path, arms):
    # Of a tree the longest chain.
    text = gripper_arm.urdf()
    # A text that is not a URDF is not taken for the name of a robot.
    texts = [text, text.replace('mass value="1"', 'mass value="2"')][:arms] or ['ur5']
    topics = [f'/{k}/robot_description' for k in range(len(texts))]
    rows = [(t, DAY, encode_string(x), STRING) for t, x in zip(topics, texts, strict=True)]
    moving = states([*gripper_arm.ARM, 'other'], TIMES)
    moving[70][2]['effort'][1] = 91.0
    page = shown(write_bag(tmp_path / 'a.mcap', [*rows, *moving]))
    (first,) = [x for x in page.findings if x.kind == 'effort limit'] if arms == 1 else [None]
    assert first is None or (first.joint, len(first.spans)) == (gripper_arm.ARM[1], 1)
    notes = [note for note in page.run.notes if note.startswith('limits are not checked')]
    assert len(notes) == (arms != 1)
    # A joint that the robot lacks may slide.
    assert page.plots[0].title == 'position [rad or m]'
    assert not page.findings or arms == 1


def test_of_several_joint_states_those_shown_are_named_and_others_can_be_chosen(tmp_path, capsys):
    left, right = (states(['a', 'b'], TIMES, f'/{x}/joint_states') for x in ('left', 'right'))
    right[70][2]['velocity'][1] = np.inf
    both = [message for pair in zip(left, right, strict=True) for message in pair]
    path = write_bag(tmp_path / 'a.mcap', both)
    (note,) = (x for x in shown(path).run.notes if '--topic' in x)
    assert note.startswith("joint states are those of /left/joint_states, not of ['/right/joint")
    for topic, status, printed in (
        ('/left/joint_states', 0, 'nothing went wrong'),
        ('/right/joint_states', 0, 'not finite: b: velocity is inf'),
        ('/nix', 1, "'/nix' is not in the log"),
    ):
        words = ['--topic', topic, '--out', str(tmp_path / f'{status}{len(topic)}.html')]
        assert pfd_main(['report', 'log', str(path), *words]) == status
        assert printed in ''.join(capsys.readouterr())


def test_infinite_states_are_found(tmp_path):
    rows = states(['a', 'b'], TIMES)
    rows[70][2]['velocity'][1] = np.inf
    page = shown(write_bag(tmp_path / 'a.mcap', rows))
    (found,) = page.findings
    of = found.kind, found.severity, found.joint, found.text
    assert of == ('not finite', 'bad', 'b', 'velocity is inf')
    assert found.time == pytest.approx(0.7, abs=1e-6)


def test_diagnostics_are_findings_by_their_level(tmp_path):
    types, rows = STORE.types, []
    warm = [(1, f'joint{text} C') for text in ('1 at 31.5', '1 at 7e+01', '2 at 9')]
    for k, (level, text) in enumerate([(0, 'ok'), (1, BUSY), *warm, (2, 'hot'), (2, 'hot')]):
        stamp = types['builtin_interfaces/msg/Time'](sec=k + 1, nanosec=0)
        header = types['std_msgs/msg/Header'](stamp=stamp, frame_id='')
        status = types['diagnostic_msgs/msg/DiagnosticStatus'](
            level=level, name='drive', message=text, hardware_id='', values=[]
        )
        data = STORE.serialize_cdr(types[DIAGNOSTICS](header=header, status=[status]), DIAGNOSTICS)
        rows.append(('/diagnostics', k + 1.0, bytes(data)))
    page = shown(write_bag(tmp_path / 'a.mcap', rows, kind=DIAGNOSTICS))
    found = [(x.severity, x.text, len(x.spans)) for x in page.findings]
    # What the machine misses is no fault of the arm.
    own = ('note', f'drive: {BUSY}', 1)
    # One row for a joint, whatever its numbers.
    lines = [('warning', 'drive: joint1 at 31.5 C', 2), ('warning', 'drive: joint2 at 9 C', 1)]
    assert found == [own, *lines, ('bad', 'drive: hot', 2)]
    assert 'the log has no joint states' in page.run.notes


# Curves, marks, energy.


def test_commands_are_drawn_as_they_acted_and_nan_after_one_went_wrong(tmp_path):
    path = tmp_path / 'a.mcap'
    names = pfd.load_robot('planar2').joint_names
    lost = named(names, [np.nan, np.nan])
    simulate(path, 300, {1: [named(names, [0.5, 0.2])], 100: [named(['x'], [3.0])], 200: [lost]})
    page = shown(path)
    first = next(x for x in page.findings if x.severity == 'bad')
    assert first.text.startswith("joint_commands unknown_names: none of ['x']")
    assert [x.text for x in page.findings if 'all_nan' in x.text]
    (plot,) = (x for x in data_of(page)['plots'] if x['title'].startswith('commanded'))
    # The last command acts up to the end.
    time = 1e-6 * np.cumsum(decoded(plot['time'], '<u4').astype(np.int64))
    assert (tuple(plot['labels']), time[-1]) == (names, pytest.approx(0.3, abs=0.01))
    values = decoded(plot['values'], '<f4').reshape(len(names), -1)
    np.testing.assert_allclose(values.T, np.tile([0.5, 0.2], (len(time), 1)), rtol=1e-6)


def test_curves_hold_the_values_of_the_log(tmp_path):
    path = tmp_path / 'a.mcap'
    simulate(path, 300, {1: [efforts(0.5, 0.2)]})
    log, page = read_log(path)['/joint_states'], shown(path)
    for item, plot in zip(
        ('position', 'velocity', 'effort'), data_of(page)['plots'], strict=False
    ):
        assert plot['title'].startswith(item)
        assert plot['labels'] == list(log.names)
        time = plot['start'] + 1e-6 * np.cumsum(decoded(plot['time'], '<u4').astype(np.int64))
        assert time == pytest.approx(log.time, abs=1e-6)
        values = decoded(plot['values'], '<f4').reshape(len(log.names), -1)
        np.testing.assert_array_equal(values, getattr(log, item).T.astype('f4'))


def test_a_long_curve_keeps_its_peaks(tmp_path):
    names, count = ['a', 'b'], 25_001
    rng = np.random.default_rng(1)
    values = rng.standard_normal((count, 2))
    values[[17, 13_333, -1], 0] = 40.0, -50.0, 60.0
    rows = [
        ('/joint_states', DAY + 1e-3 * k, {'names': names, 'position': x})
        for k, x in enumerate(values)
    ]
    plot = data_of(shown(write_bag(tmp_path / 'a.mcap', rows)))['plots'][0]
    drawn = decoded(plot['values'], '<f4').reshape(2, -1)
    assert drawn.shape[1] <= 20_002
    time = plot['start'] + 1e-6 * np.cumsum(decoded(plot['time'], '<u4').astype(np.int64))
    for peak, at in ((40.0, 17), (-50.0, 13_333), (60.0, count - 1)):
        (k,) = np.flatnonzero(drawn[0] == peak)
        assert time[k] == pytest.approx(1e-3 * at, abs=6e-3)
    assert drawn.min(axis=1) == pytest.approx(values.min(axis=0), rel=1e-6)
    assert drawn.max(axis=1) == pytest.approx(values.max(axis=0), rel=1e-6)


def test_reference_tolerance_push_and_failed_assertion_are_drawn(tmp_path):
    path = tmp_path / 'a.mcap'
    simulate(path, 100, STEADY, **FREE)
    time = np.array([0.02, 0.08])
    reference = PageReference(('elbow',), time, np.array([[0.2], [0.8]]), within=0.1)
    push = PageFinding('push', 'note', '', '20 N', np.array([[0.03, 0.05]]))
    text = 'AssertionError: far <away>\nsecond line'
    failed = PageFinding('failed assertion', 'bad', '', text, np.array([[0.06, 0.06]]))
    page = shown(path, reference, push, failed)
    assert (page.first.kind, page.first.time) == ('failed assertion', 0.06)
    assert '<pre>AssertionError: far &lt;away&gt;\nsecond line</pre>' in page.html
    drawn = data_of(page)
    assert drawn['lanes']['push'] == [[0.03, 0.05, 'note']]
    assert drawn['marks'][0][:3] == [0.03, 0.05, 'push']
    position = drawn['plots'][0]
    assert position['references'] == [['elbow', 'reference'], ['elbow', 'low'], ['elbow', 'high']]
    values = decoded(position['values'], '<f4').reshape(5, -1)
    k = int(np.flatnonzero(np.isclose(page.plots[0].time, 0.05))[0])
    assert values[2:, k] == pytest.approx([0.5, 0.4, 0.6], abs=1e-5)
    assert np.isnan(values[2:, [0, -1]]).all()


def test_the_energy_follows_the_payload_of_the_run(tmp_path):
    pin = pytest.importorskip('pinocchio')
    path = tmp_path / 'a.mcap'
    events = {
        1: [efforts(0.5, -0.2)],
        100: [change(payload_mass=2.5)],
        200: [change(payload_mass=0.0)],
    }
    simulate(path, 300, events, payload_mass=1.0, roles=['payload_in_use'])
    plot = next(plot for plot in shown(path).plots if plot.title == 'energy [J]')
    found = read_log(path)['/joint_states']
    for mass, some in ((1.0, slice(0, 99)), (2.5, slice(99, 199)), (0.0, slice(199, 300))):
        model = pin.buildModelFromXML(pfd.urdf_of('planar2'))
        tip = model.frames[model.getFrameId(pfd.load_robot('planar2').tip)]
        body = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
        if mass:
            model.appendBodyToJoint(tip.parentJoint, body, tip.placement)
        data = model.createData()
        for q, qd, values in zip(
            found.position[some], found.velocity[some], plot.values[some], strict=True
        ):
            # Continuous joints have the cosine and the sine of their angle.
            place = np.stack([np.cos(q), np.sin(q)], axis=1).ravel()
            wanted = (
                pin.computeKineticEnergy(model, data, place, qd),
                pin.computePotentialEnergy(model, data, place),
            )
            # Energies of ten joules, summed in another order.
            assert values[:2] == pytest.approx(wanted, rel=0, abs=1e-13)
            assert values[2] == values[:2].sum()


KINDS = (JOINT_STATE, DIAGNOSTICS, 'std_msgs/msg/Float64MultiArray', STRING)
NUMBERS = (0.0, 1.0, -2.5, np.nan, np.inf, 1e308)


@pytest.mark.parametrize('seed', range(8))
def test_random_and_damaged_messages_are_shown_or_named(seed, tmp_path):
    rng, rows = random.Random(seed), []
    for k in range(60):
        kind = rng.choice(KINDS)
        data = bytes(STORE.serialize_cdr(random_message(kind, rng), kind))
        if kind == JOINT_STATE and rng.random() < 0.8:
            names = [rng.choice('abcd') for _ in range(rng.randrange(4))]
            values = [[rng.choice(NUMBERS) for _ in names] for _ in range(3)]
            stamp = rng.choice((0, 10**7 * k, 10**18, (2**31 - 1) * 10**9))
            data = encode_joints(names, *values, stamp_ns=stamp)
        if rng.random() < 0.05:
            data = data[: rng.randrange(len(data))]
        time = rng.choice((0.0, 1e9 + 0.01 * k, 9e9)) if rng.random() < 0.1 else 1e9 + 0.01 * k
        rows.append((f'/{kind.rpartition("/")[2]}{rng.randrange(2)}', time, data, kind))
    page = shown(write_bag(tmp_path / 'a.mcap', rows), robot=pfd.load_robot('planar2'))
    assert page.plots
    assert len(data_of(page)['plots']) == len(page.plots)
    assert [x.time for x in page.findings] == sorted(x.time for x in page.findings)


@pytest.mark.parametrize('rate', ['"x"', '{"a": 1}'])
def test_a_damaged_head_is_an_error_with_the_name_of_the_file(rate, tmp_path, capsys):
    path, settings = tmp_path / 'b.mcap', {'settings': f'{{"publish_rate": {rate}}}'}
    simulate(tmp_path / 'a.mcap', 20)
    rewritten(
        tmp_path / 'a.mcap', path, metadata=lambda _, x: x | settings if 'settings' in x else x
    )
    assert pfd_main(['report', 'log', str(path), '--out', str(tmp_path / 'b.html')]) == 1
    assert capsys.readouterr().err.startswith(f'pfd report: {path}: ')


# The document.


class Tags(HTMLParser):
    """Collects the tags of a page and their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: dict[str, list[str]] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            self.attributes.setdefault(name, []).append(value or '')


def test_hostile_names_stay_text(tmp_path):
    pages = []
    for k, name in enumerate(('harmless', HOSTILE)):
        rows = states([name, 'b'], [*TIMES, TIMES[-1] + 1.0], topic=f'/{name}/joint_states')
        pages.append(shown(write_bag(tmp_path / f'{k}.mcap', rows)))
    tags = [Tags(page.html) for page in pages]
    assert tags[0].tags == tags[1].tags
    assert 'onerror' not in tags[1].attributes
    assert data_of(pages[1])['plots'][0]['labels'][0].startswith('</script><img')


def test_a_page_refers_to_nothing_and_runs_only_its_own_scripts(tmp_path):
    page = shown(write_bag(tmp_path / 'a.mcap', states(['a'], TIMES)))
    tags = Tags(page.html)
    assert not {'src', 'href', 'style', 'onclick', 'onload'} & tags.attributes.keys()
    assert 'link' not in tags.tags
    policy = tags.attributes['content'][0]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert 'unsafe' not in policy
    scripts = re.findall('<script>(.*?)</script>', page.html, re.DOTALL)
    assert len(scripts) == 2
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


# In a browser.


@pytest.fixture(scope='module')
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of an arm that reaches a limit, with a reference."""
    path = tmp_path_factory.mktemp('faulty') / 'a.mcap'
    simulate(path, 900, {1: [efforts(15.0, -3.0)], 700: [efforts(0.0)]}, **FREE)
    reference = PageReference(
        ('elbow',), np.array([0.1, 0.8]), np.array([[0.0], [-2.0]]), within=0.5
    )
    shown(path, reference).write(path.with_suffix('.html'))
    return path.with_suffix('.html')


@contextmanager
def drawn(browser: Any, path: Path) -> Iterator[int]:
    """Have a browser draw a page; yield the number of its plots; there are no errors then."""
    url = path.absolute().as_uri()
    number = f'location.href === {url!r} && document.documentElement.dataset.drawn'
    with browser.shows(url):
        wait_until(lambda: bool(browser.value(number)))
        yield int(browser.value(number))
        assert browser.value('document.documentElement.dataset.error') is None


CURVES = """JSON.stringify(plots.filter((u) => u.pfd).map(
    (u) => [u.pfd.title, u.data.map((x) => [x.length, x[0], x[x.length - 1]])]))"""
SHIFT_CLICK = """document.querySelectorAll('#joints button')[0].dispatchEvent(
    new MouseEvent('click', {shiftKey: true}))"""
RANGES = 'JSON.stringify(plots.map((u) => [u.scales.x.min, u.scales.x.max]))'
# Where 20 rad/s is in the second plot of curves.
LIMIT = """JSON.stringify([plots[2].over.getBoundingClientRect().left,
    plots[2].over.getBoundingClientRect().top + plots[2].valToPos(20, 'y')])"""


@needs_browser
def test_a_browser_draws_all_curves_a_drag_zooms_and_a_click_selects_a_joint(browser, faulty):
    states = read_log(faulty.with_suffix('.mcap'))['/joint_states']
    with drawn(browser, faulty) as count:
        curves = dict(json.loads(browser.value(CURVES)))
        assert count == len(curves) + 1  # and the timeline
        assert curves.keys() >= {'position [rad]', 'commanded effort [N m]', 'energy [J]'}
        for item, unit in (('velocity', 'rad/s'), ('effort', 'N m')):
            for k, (length, first, last) in enumerate(curves[f'{item} [{unit}]'][1:]):
                values = getattr(states, item)[:, k]
                assert length == len(values)
                assert [first, last] == pytest.approx(values[[0, -1]], rel=1e-6)
        box = json.loads(browser.value('JSON.stringify(plots[1].over.getBoundingClientRect())'))
        mouse = {'y': box['top'] + box['height'] / 2, 'button': 'left', 'buttons': 1}
        for kind, part in (('mousePressed', 0.25), ('mouseMoved', 0.5), ('mouseReleased', 0.5)):
            x = box['left'] + part * box['width']
            browser.call('Input.dispatchMouseEvent', type=kind, x=x, clickCount=1, **mouse)
        ranges = json.loads(browser.value(RANGES))
        assert all(found == ranges[0] for found in ranges)
        assert 0.15 < ranges[0][0] < 0.3 < 0.4 < ranges[0][1] < 0.55
        browser.value("document.getElementById('all').click()")
        assert json.loads(browser.value(RANGES))[0][0] < 0.01
        shows = 'JSON.stringify(plots[2].series.slice(1).map((s) => s.show))'
        browser.value("document.querySelectorAll('#joints button')[1].click()")
        assert json.loads(browser.value(shows)) == [False, True]
        browser.value(SHIFT_CLICK)
        assert json.loads(browser.value(shows)) == [True, True]


@needs_browser
def test_curves_are_seen_in_light_and_dark(browser, faulty):
    with drawn(browser, faulty):
        colours = []
        for dark in (False, True):
            if dark:
                browser.value("document.getElementById('theme').click()")
            pixels = browser.pixels().astype(int)
            # The corner is background; curves are the only saturated colours but red.
            assert (pixels[-5, 5].mean() < 80) == dark
            plots = pixels[60:, 400:]
            vivid = (plots.max(axis=2) - plots.min(axis=2) > 90) & (
                plots[..., 0] < plots[..., 1:].max(axis=2)
            )
            assert vivid.any(axis=0).mean() > 0.6
            colours.append(np.median(plots[vivid], axis=0))
        assert (colours[0] != colours[1]).any()


@needs_browser
def test_limits_of_a_joint_are_drawn_when_it_is_seen_alone(browser, faulty):
    with drawn(browser, faulty):
        browser.value('box.querySelectorAll(".plot")[2].scrollIntoView()')

        def red():
            """Return the number of red pixels in the row of the shoulder's velocity limit."""
            x, y = (round(place) for place in json.loads(browser.value(LIMIT)))
            rows = browser.pixels().astype(int)[y - 2 : y + 3, x:-40]
            return int(((rows[..., 0] - rows[..., 1:].max(axis=2)) > 60).any(axis=0).sum())

        before = red()
        browser.value("document.querySelectorAll('#joints button')[0].click()")
        wait_until(lambda: red() > before + 100)


@needs_browser
def test_hostile_names_draw_without_errors(browser, tmp_path):
    rows = states([HOSTILE, 'b'], TIMES, topic=f'/{HOSTILE}/joint_states')
    shown(write_bag(tmp_path / 'a.mcap', rows)).write(tmp_path / 'page.html')
    with drawn(browser, tmp_path / 'page.html') as count:
        assert count == 3
        name = browser.value("document.querySelector('#joints button').textContent")
        assert name.startswith('</script>')


@needs_browser
def test_a_curve_of_one_value_is_in_the_middle_of_its_axis(browser, tmp_path):
    names, still = ['a', 'b'], np.array([0.0, 0.0])
    rows = [('/joint_states', t, {'names': names, 'position': still}) for t in TIMES]
    shown(write_bag(tmp_path / 'a.mcap', rows)).write(tmp_path / 'page.html')
    with drawn(browser, tmp_path / 'page.html'):
        axis = browser.value('JSON.stringify([plots[0].scales.y.min, plots[0].scales.y.max])')
        assert json.loads(axis) == [-1.0, 1.0]
