# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What-if of bags of any arm: equal to the motion that was recorded, else refused by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arm_messages import UNLIMITED, named
from logs import Row, joint_state, string, write_mcap
import numpy as np
import pytest
from recordings import simulate
from test_what_if import NAMES, STATES, H, numbers, taus

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.messages.values import encode_floats
from pfd_ros.recording.format import LogError
from pfd_ros.replay.verify import verify as verify_log
from pfd_ros.replay.what_if import WhatIf, what_if

# Rounding of a run of half a second; kernels with brakes and limits have other operations.
ROUNDING = 1e-11


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new log is written into the current folder."""
    folder = tmp_path / 'current'
    folder.mkdir()
    monkeypatch.chdir(folder)


Q0, QD0 = np.array([0.3, -0.4]), np.array([0.5, 1.5])
FLOATS = 'std_msgs/msg/Float64MultiArray'


def floats(topic: str, at: float, *values: float) -> Row:
    return Row(topic, at, encode_floats(values))


def shown(at: float, names: Sequence[str] = NAMES, q: Any = Q0, qd: Any = QD0) -> Row:
    """Return a state with its time as its stamp."""
    return Row('/s', at, joint_state(names, q, qd, stamp=at))


def told(at: float, tau: Any, names: Sequence[str] = NAMES) -> Row:
    """Return a command with its time as its stamp."""
    return Row('/c', at, joint_state(names, (), tau=tau, stamp=at))


def motion(rows: np.ndarray) -> pfd.Trajectory:
    """Return the motion of planar2 under efforts for each step."""
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=H)
    sim.reset(Q0, QD0)
    return sim.rollout(rows)


def held(count: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of planar2 every 4 steps, under efforts that change with them."""
    found = motion(np.repeat(taus(count), 4, axis=0))
    return np.vstack([[Q0], found.q[3:-1:4]]), np.vstack([[QD0], found.qd[3:-1:4]])


def bag_of(path: Path, start: float = 100.0, prefix: str = '') -> Path:
    """Write a bag of planar2 with states and efforts in one topic, 4 steps apart."""
    names = [f'{prefix}{name}' for name in NAMES]
    rows = []
    for k, state in enumerate(zip(*held(), taus(120), strict=True)):
        at = start + 4 * k * H
        rows.append(Row(STATES, at, joint_state(names, *state, stamp=at)))
    return write_mcap(path, rows)


def run(path: Path, commands: str = STATES, *words: str, **given: Any) -> WhatIf:
    found = what_if(path, ['robot=planar2', *words], commands=commands, **given)
    assert verify_log(found.log).complete
    return found


@pytest.mark.parametrize('start', [0.0, 100.0, 1.7e9])
def test_an_arm_that_is_the_recorded_one_follows_its_bag(tmp_path, start):
    found = run(bag_of(tmp_path / 'bag.mcap', start), rounding=start == 100.0)
    assert found.states == 120
    assert max(numbers(found, 'position')) < ROUNDING
    assert max(numbers(found, 'velocity')) < 100 * ROUNDING
    assert numbers(found, 'effort', 'first_at') == [0.0, 0.0]
    assert not found.rejected
    assert found.log == Path('bag_what_if.mcap')
    # Its stamps continue the clock of the bag, as far as a float of seconds has it.
    new = read_log(found.log)[STATES]
    assert new.time[0] == pytest.approx(max(start, H), abs=1e-6)
    np.testing.assert_array_equal(new.position[0], Q0)
    if start == 100.0:
        assert 0 < max(numbers(found, 'position', of='rounding')) < 1e-12


def test_efforts_without_names_act_in_the_order_of_the_joints(tmp_path):
    rows = []
    for k, (q, qd, tau) in enumerate(zip(*held(), taus(120), strict=True)):
        at = 5.0 + 4 * k * H
        # Their stamps have another clock.
        state = joint_state(NAMES[::-1], q[::-1], qd[::-1], stamp=at + 77.0)
        rows += [Row('/states', at, state), floats('/efforts', at, *tau[::-1])]
    bag = write_mcap(tmp_path / 'bag.mcap', rows, {'/efforts': FLOATS})
    result = run(bag, '/efforts', 'joints=[elbow, shoulder]')
    # Without stamps of the commands the times are the log's.
    assert result.times == 'log times'
    assert max(numbers(result, 'position')) < ROUNDING


def test_efforts_between_two_steps_act_from_the_next_one_on(tmp_path):
    # In steps 1, 3 (two of them, of which the newer one acts) and 8.
    times = ((0.2, 1.0), (1.0011, 2.0), (1.0015, 3.0), (1.0062, -4.0))
    rows = [shown(1.0), *(told(at, (tau, -tau)) for at, tau in times)]
    rows += [shown(1.0052), shown(1.012)]
    found = run(write_mcap(tmp_path / 'bag.mcap', rows), '/c')
    acting = np.array([1.0, 1.0, 3.0, 3.0, 3.0, 3.0, 3.0, -4.0, -4.0, -4.0, -4.0, -4.0])
    wanted = motion(np.stack([acting, -acting], axis=1)).q
    new = read_log(found.log)[STATES]
    np.testing.assert_allclose(new.position[1:13], wanted, atol=ROUNDING)
    np.testing.assert_array_equal(new.effort[1:13, 0], acting)
    # At 5.2 ms the new run is between two steps.
    between = 0.8 * wanted[4] + 0.2 * wanted[5]
    times_of, _, other = found.curves['/s', 'position', 'shoulder']
    (place,) = np.flatnonzero(np.isclose(times_of, 0.0052, atol=1e-9))
    assert other[place] == pytest.approx(between[0], abs=ROUNDING)


def test_messages_are_put_in_the_order_of_their_stamps(tmp_path):
    rows = [shown(1.0)]
    rows += [told(at, tau) for at, tau in zip((1.0, 1.004), taus(2), strict=True)]
    # States come late in the log.
    rows += [shown(at)._replace(at=1.02 + at) for at in (1.002, 1.008)]
    wanted = motion(np.repeat(taus(2), 4, axis=0)).q
    for order in (1, -1):
        found = run(write_mcap(tmp_path / f'bag{order}.mcap', rows[::order]), '/c')
        assert found.times == 'stamps'
        new = read_log(found.log)[STATES]
        np.testing.assert_allclose(new.position[1:9], wanted, atol=ROUNDING)


def test_several_publishers_of_one_topic_are_joined_by_joint(tmp_path):
    rows = []
    for k, tau in enumerate(taus(60)):
        at = 1.0 + 4 * k * H
        if k:
            rows.append(shown(at, ['finger'], [0.01], [0.0]))
        rows.append(shown(at + 1e-4, ['elbow'], Q0[1:], QD0[1:]))
        rows.append(shown(at + 2e-4, ['shoulder'], Q0[:1], QD0[:1]))
        rows += [told(at + 2e-4, tau[:1], ['shoulder']), told(at + 2e-4, tau[1:], ['elbow'])]
    found = run(write_mcap(tmp_path / 'bag.mcap', rows), '/c')
    assert found.only_in_log == ('finger',)
    assert {item.joint for item in found.divergences} == set(NAMES)
    new = read_log(found.log)[STATES]
    wanted = motion(np.repeat(taus(60), 4, axis=0)).q
    np.testing.assert_allclose(new.position[1:200], wanted[:199], atol=1e-9)


def test_joints_without_a_command_stay_braked(tmp_path):
    known = [*NAMES, 'finger']
    rows = [shown(at, known, [*Q0, 9.0], [0.0] * 3) for at in (1.0, 1.009)]
    rows += [told(1 + k * H, (2.0, 5.0), ['elbow', 'finger']) for k in range(9)]
    found = run(write_mcap(tmp_path / 'bag.mcap', rows), '/c')
    new = read_log(found.log)[STATES]
    assert (new.position[:, 0] == Q0[0]).all()
    assert new.position[-1, 1] != Q0[1]


def test_messages_that_cannot_be_used_are_counted(tmp_path):
    given = ([1.0, 2.0], [1.0], [np.inf, 1.0], [np.nan, 3.0], [4.0, 5.0])
    rows = [shown(1.0), *(told(1 + k * H, tau) for k, tau in enumerate(given)), shown(1.008)]
    rows.append(Row('/c', 1.004, told(1.004, (1, 2)).data[:-9]))
    found = run(write_mcap(tmp_path / 'bag.mcap', rows), '/c')
    assert found.rejected == {'ragged': 1, 'infinite': 1}
    (problem,) = found.problems
    assert "topic '/c': 1 of 6 messages cannot be read" in problem
    new = read_log(found.log)[STATES]
    assert new.effort[1:7].tolist() == [[1, 2]] * 3 + [[1, 3], [4, 5], [4, 5]]
    arrays = [shown(1.0), floats('/f', 1.0, 1.0), floats('/f', 1.001, 1.0, 2.0)]
    arrays += [floats('/f', 1.002, 1.0, np.nan), shown(1.008)]
    bag = write_mcap(tmp_path / 'floats.mcap', arrays, {'/f': FLOATS})
    found = run(bag, '/f')
    assert found.rejected == {'wrong_size': 1, 'not_finite': 1}
    assert read_log(found.log)[STATES].effort[-1].tolist() == [1.0, 2.0]


def test_names_of_joints_are_replaced_from_their_beginning(tmp_path):
    bag = bag_of(tmp_path / 'bag.mcap', prefix='left_')
    with pytest.raises(LogError, match=r"none of its joints \['left_shoulder', 'left_elbow'\]"):
        what_if(bag, ['robot=planar2'], commands=STATES)
    assert max(numbers(run(bag, rename={'left_': ''}), 'position')) < ROUNDING


@pytest.mark.parametrize(
    ('rows', 'message'),
    [
        ([told(1.0, (1, 2))], r'name the topic .* topics with positions are \[\]'),
        ([Row('/c', 1.0, string('x'))], 'is std_msgs/msg/String, expected'),
        (
            [shown(1.0, q=(1e12, 0.0)), told(1.0, (1, 2)), shown(1.01, q=(0.0, 0.0))],
            'its first state cannot be set: set_state is refused',
        ),
        ([shown(1.0), told(2.0, (1, 2), ['a', 'b'])], 'has efforts for the joints'),
        ([shown(1.0), told(1.0, (1, 2)), told(1.7e9, (1, 2))], 'its clock was changed'),
        (
            [shown(1.0), shown(1.0)._replace(topic='/t'), told(1.0, (1, 2))],
            r"name the topic of the recorded states with --states; .*\['/s', '/t'\]",
        ),
    ],
    ids=range(6),
)
def test_a_bag_that_cannot_be_used_is_refused_by_name(tmp_path, rows, message):
    kinds = {'/c': 'std_msgs/msg/String'} if rows[0].data == string('x') else {}
    bag = write_mcap(tmp_path / 'bag.mcap', rows, kinds)
    with pytest.raises(LogError, match=message) as refused:
        what_if(bag, ['robot=planar2'], commands='/c')
    assert str(bag) in str(refused.value)
    assert list(Path().iterdir()) == []


def test_the_named_topic_of_states_is_taken(tmp_path):
    rows = [shown(1.0), shown(1.0, q=(0.1, 0.2))._replace(topic='/t'), told(1.0, (1, 2))]
    rows += [shown(1.01), shown(1.01)._replace(topic='/t')]
    bag = write_mcap(tmp_path / 'bag.mcap', rows)
    found = run(bag, '/c', states='/t')
    np.testing.assert_array_equal(read_log(found.log)[STATES].position[0], (0.1, 0.2))
    with pytest.raises(LogError, match=r"topic '/u' has no .* with positions"):
        what_if(bag, ['robot=planar2'], commands='/c', states='/u')


def test_a_recording_of_the_node_is_a_bag_too(tmp_path):
    events = {
        k: [named(NAMES, effort=tau, stamp_ns=(k - 1) * 1_000_000)]
        for k, tau in enumerate(taus(100), 1)
        if k % 4 == 2
    }
    simulate(tmp_path / 'a.mcap', 100, events, **UNLIMITED)
    words = ['robot=planar2', 'effort_limits=false', 'torque_speed=false']
    found = what_if(tmp_path / 'a.mcap', words, commands='/joint_commands')
    assert found.times == 'stamps'
    assert {item.largest for item in found.divergences} == {0.0}
