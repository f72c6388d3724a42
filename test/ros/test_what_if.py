# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What-if of recordings: equal bits without a change, else what others compute."""

from __future__ import annotations

import math
from pathlib import Path
import re
import shutil

from arm_messages import UNLIMITED, change, efforts, named, placed, request, tick, trajectory
from logs import Row, joint_state, write_mcap
import numpy as np
import pytest
from recordings import Run, rewritten, simulate

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.recording.format import LogError
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.recording.recorder import Recorder as LogRecorder
from pfd_ros.replay.verify import verify as verify_log
from pfd_ros.replay.what_if import WhatIf, what_if
from pfd_ros.replay.what_if import as_json as what_if_json
from pfd_ros.replay.what_if import lines as what_if_lines

GOLDEN = Path(__file__).resolve().parents[1] / 'data' / 'golden_3_ur5.mcap'
STATES, ARRAY = '/joint_states', '/sim_arm/commands'
NAMES = ('shoulder', 'elbow')
REPORTS = ('diagnostics', 'transition_event')
H = 1e-3
BIT = 2.0**-52
OVERFLOWS = ['damping=[1e6, 1e6]', 'integrator=rk4']


def taus(count: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(-5.0, 5.0, (count, 2))


def swung(path: Path, cycles: int = 400) -> Path:
    """Record an arm that gets efforts without names in each cycle."""
    events = {k: [efforts(*tau)] for k, tau in enumerate(taus(cycles), 1)}
    simulate(path, cycles, events, **UNLIMITED)
    return path


@pytest.fixture(scope='module')
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return swung(tmp_path_factory.mktemp('swings') / 'swing.mcap')


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new log is written into the current folder."""
    folder = tmp_path / 'current'
    folder.mkdir()
    monkeypatch.chdir(folder)


def states_of(path: Path) -> list[bytes]:
    return [m.data for m in RecordedLog(path).messages() if m.role == 'joint_states']


def numbers(
    found: WhatIf, field: str, name: str = 'largest', *, of: str = 'divergences'
) -> list[float]:
    values = [getattr(item, name) for item in getattr(found, of) if item.field == field]
    assert values
    return values


# ---- recordings


def lockstep(path: Path) -> Path:
    """Record an arm that waits for answers: stamped ones, late ones, with a reset."""
    events = {}
    for k, tau in enumerate(taus(200), 1):
        stamp = 1_000_000_000 + (k - 1) * 1_000_000
        events[k] = [named(NAMES, effort=tau, stamp_ns=stamp if k > 1 else 0)]
        if k % 40 == 0:
            events[k].insert(0, named(NAMES, effort=(9.0, 9.0), stamp_ns=stamp - 5_000_000))
    events[100].append(request('reset'))
    # Refused; after the last one the arm waits.
    events[150].append(tick(5))
    events[201] = [efforts(1.0)]
    settings = {'start_time': 1.0, 'lockstep': True, 'wait_for_controller': True}
    simulate(path, 201, events, roles=('clock_ticks',), **settings)
    return path


def golden(path: Path) -> Path:
    """Return a recording of all inputs, with delays, drops and noise."""
    return Path(shutil.copy(GOLDEN, path))


def paused(path: Path) -> Path:
    """Record steps on request, by an arm that is activated later."""
    events = {k: [efforts(*tau)] for k, tau in enumerate(taus(100), 1)}
    events[2] = [request('activate')]
    events[30] = [request('pause'), request('step', count=3), efforts(4.0, -4.0)]
    events |= {k: [request('step')] for k in range(36, 60, 2)}
    events[70] = [request('resume')]
    simulate(path, 100, events, autostart=False)
    return path


def following(path: Path) -> Path:
    """Record an arm that follows the clock of another node."""
    events = {
        k: [tick(5_000_000_000 + k * 1_500_000), efforts(*tau)]
        for k, tau in enumerate(taus(200), 1)
    }
    settings = {'time_source': 'clock', 'publish_clock': False}
    simulate(path, 200, events, roles=('clock_ticks',), **settings)
    return path


def failing(path: Path) -> Path:
    """Record a simulation that does not stay finite, and is reset."""
    settings = {'joint_damping': (1e6, 1e6), 'integrator': 'rk4'}
    events = {5: [efforts(1.0, 2.0)], 100: [request('reset')], 150: [efforts(2.0, 1.0)]}
    simulate(path, 200, events, **settings)
    return path


@pytest.mark.parametrize('record', [golden, lockstep, paused, following, failing])
def test_a_run_without_a_change_has_the_states_of_the_log(record, tmp_path):
    log = record(tmp_path / 'a.mcap')
    assert verify_log(log).complete
    found = what_if(log)
    assert found.log == Path('a_what_if.mcap')
    assert len(states_of(log)) > 50
    assert states_of(found.log) == states_of(log)
    assert found.states == len(states_of(log))
    assert {(item.largest, item.first_at) for item in found.divergences} == {(0.0, None)}
    assert not found.rejected
    assert found.complete
    assert verify_log(found.log).complete
    if record is golden:
        # All inputs and outputs, but for what a node reports of itself.
        kept = (m for m in RecordedLog(log).messages() if m.role not in REPORTS)
        assert [*RecordedLog(found.log).messages()] == [*kept]


def test_another_arm_with_shorter_steps_diverges_as_its_simulation_says(swing):
    words = ['payload.mass=0.7', 'payload.center=[0.05, -0.02, 0.1]', 'outputs=[energy]']
    found = what_if(swing, [*words, f'step_size={H / 4}', 'substeps=3', 'integrator=rk4'])
    scene = pfd.Scene(payload=pfd.Payload(0.7, (0.05, -0.02, 0.1)))
    own = {'step_size': H / 4, 'substeps': 3, 'integrator': 'rk4'}
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, **own)
    motion, states = sim.rollout(np.repeat(taus(400), 4, axis=0)), read_log(swing)[STATES]
    for field, values, limit in (('position', motion.q, 1e-3), ('velocity', motion.qd, 1e-2)):
        sizes = np.abs(values[3::4] - states[field])
        # The kernels have brakes as inputs or not: other rounding.
        np.testing.assert_allclose(numbers(found, field), sizes.max(0), atol=1e-9)
        rms = np.sqrt(np.mean(sizes**2, axis=0))
        np.testing.assert_allclose(numbers(found, field, 'rms'), rms, atol=1e-9)
        at = (1 + sizes.argmax(0)) * 1e-3
        np.testing.assert_allclose(numbers(found, field, 'largest_at'), at, atol=1e-12)
        first = [1e-3 * (1 + int(np.argmax(column > limit))) for column in sizes.T]
        np.testing.assert_allclose(numbers(found, field, 'first_at'), first, atol=1e-12)
    # The commands act at their times.
    assert numbers(found, 'effort') == [0.0, 0.0]
    assert not found.rejected
    assert len(read_log(found.log)['/sim_arm/energy']) == 1600
    assert verify_log(found.log).complete


def test_the_rounding_run_is_one_bit_away(swing, tmp_path):
    found = what_if(swing, ['payload.mass=0.5'], rounding=True)
    largest = np.array(numbers(found, 'position', of='rounding'))
    assert ((largest >= BIT) & (largest < 1e-12)).all()
    assert numbers(found, 'position', 'first_at', of='rounding') == [None, None]
    # A state that is set is a bit away, too.
    simulate(tmp_path / 'a.mcap', 2, {2: [placed(NAMES, (0.3, 0.2))]})
    found = what_if(tmp_path / 'a.mcap', rounding=True)
    assert numbers(found, 'position', 'rms', of='rounding') == [BIT, BIT]


def test_sensors_of_another_seed_change_what_is_measured_alone(tmp_path):
    events = {3: [efforts(1.0, 2.0)]}
    simulate(tmp_path / 'a.mcap', 400, events, noise_position=1e-3, drop_state=0.2)
    found = what_if(tmp_path / 'a.mcap', ['seed=3', 'drop.state=0'])
    assert numbers(found, 'position', 'rms') == pytest.approx([math.sqrt(2) * 1e-3] * 2, rel=0.3)
    # Where the log lacks a state nothing is compared.
    assert numbers(found, 'velocity') == [0.0, 0.0]
    assert {len(curve[0]) for curve in found.curves.values()} == {found.states}


def test_an_arm_that_follows_a_clock_has_the_times_of_its_ticks(tmp_path):
    found = what_if(following(tmp_path / 'a.mcap'), ['start_time=4'])
    assert {(item.largest, item.first_at) for item in found.divergences} == {(0.0, None)}


def test_longer_steps_end_between_recorded_states(tmp_path):
    slow = {k: [efforts(math.sin(0.02 * k), 0.0)] for k in range(1, 401)}
    simulate(tmp_path / 'a.mcap', 400, slow)
    found = what_if(tmp_path / 'a.mcap', ['step_size=0.004'])
    # At most a step late.
    assert 0 < max(numbers(found, 'position')) < 0.01
    assert (found.seconds, found.states) == (pytest.approx(0.4), 400)


def test_a_lower_rate_of_the_states_is_no_difference(swing):
    found = what_if(swing, ['publish_rate=100'])
    assert [len(found.divergences), *{item.largest for item in found.divergences}] == [6, 0.0]


@pytest.mark.parametrize('words', [['start_time=7'], ['step_size=0.0005'], ['step_size=0.002']])
def test_stamped_answers_act_in_other_steps_and_at_other_times(words, tmp_path):
    found = what_if(lockstep(tmp_path / 'a.mcap'), words)
    assert not found.rejected
    # Late answers were refused for their time, and are left out of 205.
    taken = [m for m in RecordedLog(found.log).messages() if m.role == 'joint_commands']
    assert len(taken) == 200
    # Steps of 2 ms take every other one of these efforts.
    assert '0.002' in words[0] or max(numbers(found, 'position')) < 1e-9


@pytest.mark.parametrize('stamp_ns', [0, 1_050_000_000])
def test_a_trajectory_starts_as_much_later_as_the_run(stamp_ns, tmp_path):
    plan = trajectory(NAMES, [0.05, 0.2], stamp_ns, positions=[[0.1, 0.2], [0.3, 0.0]])
    servo = {'servo_p': (300.0, 300.0), 'servo_d': (60.0, 15.0)}
    simulate(tmp_path / 'a.mcap', 300, {20: [plan]}, start_time=1.0, **servo)
    found = what_if(tmp_path / 'a.mcap', ['start_time=7'])
    assert not found.rejected
    assert {(item.largest, item.first_at) for item in found.divergences} == {(0.0, None)}


def test_steps_on_request_take_the_time_that_they_took(tmp_path):
    log = paused(tmp_path / 'a.mcap')
    seconds = read_log(log)[STATES].time[-1]
    for size in ('0.0005', '0.002'):
        found = what_if(log, [f'step_size={size}'])
        assert found.seconds == pytest.approx(seconds, abs=0.002)
        assert not found.rejected
        # The commands are taken at their times: half as long steps have the same efforts.
        if size == '0.0005':
            assert numbers(found, 'effort') == [0.0, 0.0]


def with_wrist(path: Path) -> Path:
    """Write planar2 with one more joint."""
    text = pfd.robot_to_urdf(pfd.load_robot('planar2'))
    (tip,) = re.findall(r'<link name="(tip_link)"', text)
    more = (
        f'<joint name="wrist" type="revolute"><parent link="{tip}"/><child link="hand"/>'
        '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        '<link name="hand"><inertial><mass value="0.2"/><inertia ixx="0.01" iyy="0.01" '
        'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    path.write_text(text.replace('</robot>', more))
    return path


def test_efforts_without_names_reach_the_joints_of_another_robot_by_name(swing, tmp_path):
    robot = with_wrist(tmp_path / 'three.urdf')
    found = what_if(swing, [f'robot={robot}'])
    assert (found.only_in_arm, found.only_in_log) == (('wrist',), ())
    assert {item.joint for item in found.divergences} == set(NAMES)
    assert not found.rejected
    events = {k: [named(NAMES, effort=tau)] for k, tau in enumerate(taus(400), 1)}
    simulate(tmp_path / 'alone.mcap', 400, events, robot=str(robot), **UNLIMITED)
    assert states_of(found.log) == states_of(tmp_path / 'alone.mcap')
    assert '/tf' in read_log(found.log).topics
    assert verify_log(found.log).complete


def test_the_order_of_the_joints_permutes_efforts_without_names(swing):
    found = what_if(swing, ['joints=[elbow, shoulder]'])
    assert {item.largest for item in found.divergences} == {0.0}
    np.testing.assert_array_equal(read_log(found.log)[ARRAY].data, taus(400)[:, ::-1])


def test_start_and_numbers_of_each_joint_follow_their_joints(tmp_path):
    settings = {'joint_damping': (0.3, 0.4), 'joints': ('elbow', 'shoulder')}
    settings['initial_positions'] = (0.1, 0.2)
    # Numbers that were set while it ran follow, too.
    events = {3: [efforts(1.0, 2.0)], 20: [change(bias_position=[0.0, 0.5])]}
    simulate(tmp_path / 'a.mcap', 50, events, **settings)
    for words in (['joints=[shoulder, elbow]'], ['joints=[]'], ['robot=planar2', 'joints=[]']):
        found = what_if(tmp_path / 'a.mcap', words)
        assert found.settings.initial_positions == (0.2, 0.1)
        assert found.settings.joint_damping == (0.4, 0.3)
        assert set(numbers(found, 'position')) == {0.0}
    robot = with_wrist(tmp_path / 'three.urdf')
    other = what_if(tmp_path / 'a.mcap', [f'robot={robot}', 'damping.wrist=0.5']).settings
    assert other.initial_positions == (0.2, 0.1, 0.0)
    assert other.joint_damping == (0.4, 0.3, 0.5)


def test_numbers_of_joints_are_changed_in_each_spelling(tmp_path):
    simulate(tmp_path / 'a.mcap', 3, servo_p=(1.0, 2.0), servo_d=(1.0, 9.0))
    for words, stiffness, damping in (
        (['servo_p={"elbow": 3.0}'], (1.0, 3.0), (1.0, 9.0)),
        (['servo_p=[0.5, 3]'], (0.5, 3.0), (1.0, 9.0)),
        (['servo_p.elbow=3', 'servo_d.elbow=8'], (1.0, 3.0), (1.0, 8.0)),
    ):
        found = what_if(tmp_path / 'a.mcap', words).settings
        assert (found.servo_p, found.servo_d) == (stiffness, damping)


def with_damping(path: Path, *damping: float) -> str:
    """Write planar2, for three numbers with a wrist, with damping in the model."""
    text = with_wrist(path).read_text()
    if len(damping) == 2:
        text = pfd.robot_to_urdf(pfd.load_robot('planar2'))
    heads = re.findall('<joint [^>]*type="[cr][^>]*>', text)
    for head, number in zip(heads, damping, strict=True):
        text = text.replace(head, f'{head}<dynamics damping="{number}"/>')
    path.write_text(text)
    return str(path)


def test_numbers_that_were_defaults_are_those_of_the_new_model_convention_and_switch(tmp_path):
    path, three = tmp_path / 'a.mcap', with_damping(tmp_path / 'three.urdf', 5.0, 6.0, 7.0)
    usual = {'convention': 'franka', 'damping': True}
    # As the node holds damping.elbow, viscous_scale.elbow and servo_p.elbow.
    usual |= {'joint_damping': (1.0, 3.0), 'viscous_scale': (1.0, 0.5), 'servo_p': (0.0, 4.0)}
    usual['robot'] = with_damping(tmp_path / 'two.urdf', 1.0, 2.0)
    simulate(path, 9, {3: [efforts(1.0, 2.0)], 5: [change(servo_p=[1.0, 2.0])]}, **usual)
    for words, damping, scale in (
        ([f'robot={three}'], (5, 3, 7), (1, 0.5, 1)),
        (['damping=false'], (0, 3), (1, 0.5)),
        (['convention=plain'], (1, 3), (0, 0.5)),
        (['damping.shoulder=9'], (9, 3), (1, 0.5)),
    ):
        found = what_if(path, words).settings
        assert (found.joint_damping, found.viscous_scale) == (damping, scale)
    # What was set while it ran is of the joints of the log. What a convention sets is stated.
    scales = ['viscous_scale=[1, 1, 1]', 'coulomb_scale=[1, 1, 1]']
    found = what_if(path, [f'robot={three}', 'servo_p.wrist=7', 'convention=ur', *scales])
    (event,) = (m for m in RecordedLog(found.log).messages() if m.role == 'parameters')
    assert event.data == change(servo_p=[1.0, 2.0, 7.0]).data
    assert 'step_size=0.002' in found.also


def test_a_scene_file_takes_the_place_of_all_effects(tmp_path):
    settings = {'joint_damping': (0.3, 0.4), 'gravity': (0.0, 0.0, -1.0)}
    events = {3: [efforts(1.0, 2.0)]}
    simulate(tmp_path / 'a.mcap', 80, events, **settings)
    scene = pfd.Scene(damping=(0.1, 0.2), external_wrench=True)
    scene.save(tmp_path / 'scene.yaml')
    found = what_if(tmp_path / 'a.mcap', [f'scene={tmp_path / "scene.yaml"}'])
    simulate(tmp_path / 'b.mcap', 80, events, scene=pfd.scene_to_yaml(scene))
    assert states_of(found.log) == states_of(tmp_path / 'b.mcap')
    assert len(read_log(found.log)['/sim_arm/tip_wrench']) == 80
    with pytest.raises(ValueError, match=r'damping cannot be changed by itself.*scene=FILE'):
        what_if(found.log, ['damping=[1, 2]'])
    # None of them.
    bare = what_if(found.log, ['scene=']).settings
    assert (bare.scene, bare.joint_damping, bare.gravity) == ('', (), (0.0, 0.0, -9.81))


def test_what_the_log_changes_later_or_the_arm_validates_otherwise_is_stated(tmp_path):
    events = {2: [named(['elbow'], position=[1.0]), named(['nobody'], effort=[1.0])]}
    events[9] = [change(payload_mass=0.5)]
    simulate(tmp_path / 'a.mcap', 20, events, servo_p=(9.0, 9.0))
    found = what_if(tmp_path / 'a.mcap', ['payload.mass=2', 'damping.elbow=1', 'servo_p=[]'])
    assert found.replaced == ('payload.mass',)
    assert found.rejected == {'no_effort': 1}
    assert found.first_rejected.startswith('cycle 2: joint_commands is no_effort')
    lines = what_if_lines(found)[1:]
    assert any('payload.mass' in line for line in lines)
    assert any('no_effort' in line for line in lines)
    back = what_if(found.log, ['servo_p=[9, 9]'])
    assert (back.rejected, back.replaced) == ({'accepted': 1}, ())


def test_a_run_that_overflows_says_when(swing):
    found = what_if(swing, OVERFLOWS)
    assert found.failure == 'the state after step 2 is not finite'
    assert found.failed_at == pytest.approx(0.001)
    assert any(line.startswith('FAILED') and '0.001' in line for line in what_if_lines(found))
    # The other way round: the states of the failed arm are there, and the new run continues.
    back = what_if(found.log, ['damping=[0, 0]'])
    assert (back.failure, back.seconds) == ('', pytest.approx(0.4))


def test_nothing_after_a_failure_is_compared_though_a_reset_lets_the_arm_go_on(tmp_path):
    events = {3: [efforts(1.0, 1.0)], 100: [request('reset')], 120: [efforts(1.0, 1.0)]}
    simulate(tmp_path / 'a.mcap', 200, events)
    found = what_if(tmp_path / 'a.mcap', OVERFLOWS, rounding=True)
    assert found.failed_at == pytest.approx(0.003)
    assert read_log(found.log)[STATES].time[-1] > 0.1
    for item in (*found.divergences, *found.rounding):
        assert item.largest_at <= found.failed_at
    for times, _, _ in found.curves.values():
        assert times[-1] <= found.failed_at
    # A log with a state every 50 ms.
    simulate(tmp_path / 'b.mcap', 100, {3: [efforts(1.0, 1.0)]}, publish_rate=20.0)
    with pytest.raises(LogError, match=r'failed before the first recorded state.*b_what_if\.mcap'):
        what_if(tmp_path / 'b.mcap', OVERFLOWS)


def test_a_log_that_was_cut_off_is_compared_up_to_the_cut(swing, tmp_path):
    path = tmp_path / 'a.mcap'
    path.write_bytes(swing.read_bytes()[: swing.stat().st_size * 2 // 3])
    found = what_if(path)
    assert not found.complete
    assert 0 < found.states <= 400
    assert states_of(found.log)[: found.states] == states_of(swing)[: found.states]
    assert any(line.startswith('cut off') for line in what_if_lines(found))


def test_states_that_are_missing_unreadable_or_out_of_reach_are_named(swing, tmp_path):
    def cut(role, record):
        if role == 'joint_states' and record.sequence == 9:
            record.data = record.data[:-4]
        return record

    found = what_if(rewritten(swing, tmp_path / 'cut.mcap', cut), out=tmp_path / 'out.mcap')
    (problem,) = found.problems
    assert f'topic {STATES!r}: 1 of 400 messages cannot be read' in problem
    assert found.states == 399

    def late(role, record):
        if record.sequence > 300:
            record.sequence += 1 << 30
        return record

    for alter, line in (
        (lambda role, m: m if role == 'commands' else None, "topic '/joint_states' has no such"),
        (late, 'cycle 1073742124 after 300 recorded states'),
    ):
        with pytest.raises(LogError, match=rf'a\.mcap:? {line}'):
            what_if(rewritten(swing, tmp_path / 'a.mcap', alter))
        assert list(Path().iterdir()) == []
    # A head that names other topics.
    for topics, line in (
        ('{}', r"has no topic \['']"),
        ('{"joint_states": "/sim_arm/commands"}', 'is std'),
    ):
        path = tmp_path / 'a.mcap'
        rewritten(
            swing,
            path,
            metadata=lambda _, x, y=topics: x | ({'topics': y} if 'topics' in x else {}),
        )
        with pytest.raises(ValueError, match=line):
            what_if(path)


def test_the_result_is_rows_for_people_and_json(swing):
    words, seen = ['payload.mass=0.5', 'payload.center=[0, 0, 0]'], list[float]()
    found = what_if(swing, words, rounding=True, thresholds=(1e-3, 1e-2, 1e-1))
    lines = what_if_lines(found)
    assert lines[0].endswith('planar2, payload.mass=0.5 payload.center=[0, 0, 0]')
    assert str(found.log) in lines[1]
    rows = [line for line in lines if line.startswith(('position', 'velocity', 'effort'))]
    assert len(rows) == 6
    assert all(' from 0.' in line and line.endswith(' never') for line in rows[:4])
    assert all(line.count('equal') == 2 for line in rows[4:])
    json = what_if_json(found)
    assert (json['changes'], json['robot']) == (tuple(words), 'planar2')
    for key in ('divergences', 'rounding'):
        assert [row['joint'] for row in json[key]] == [*NAMES] * 3
    assert json['thresholds'] == {'position': 1e-3, 'velocity': 1e-2, 'effort': 1e-1}
    what_if(swing, ['step_size=0.0001'], progress=seen.append)
    assert seen == sorted(seen)
    assert 0.0 <= seen[0] < seen[-1] <= 1.0


def test_topics_stay_and_new_ones_are_of_the_same_node(tmp_path):
    topics = {'requests': '/ns/arm/requests', 'joint_states': '/ns/joint_states'}
    with_topics = Run(tmp_path / 'a.mcap', topics=topics)
    with_topics.step(efforts(1.0, 2.0), times=5)
    with_topics.close()
    found = what_if(tmp_path / 'a.mcap', ['outputs=energy'])
    filled = {message.role for message in RecordedLog(found.log).messages()}
    topics = RecordedLog(found.log).topics
    assert {topics[role] for role in filled} == {
        '/sim_arm/commands',
        '/ns/joint_states',
        '/ns/arm/energy',
        '/clock',
    }


def test_a_what_if_of_a_what_if_publishes_its_clock_again(swing):
    silent = what_if(swing, ['publish_clock=false']).log
    again = what_if(silent, ['publish_clock=true']).log
    assert [m.data for m in RecordedLog(again).messages() if m.role == 'clock'] == [
        m.data for m in RecordedLog(swing).messages() if m.role == 'clock'
    ]


def test_an_interruption_leaves_no_file_and_a_disk_that_hangs_what_is_written(
    swing, tmp_path, monkeypatch
):
    def stop(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        what_if(swing, ['step_size=0.0001'], progress=stop)
    assert list(Path().iterdir()) == []
    monkeypatch.setattr(LogRecorder, 'waiting_share', 1.0)
    monkeypatch.setattr('pfd_ros.recording.recorder.DISK_SECONDS', 0.05)
    with pytest.raises(OSError, match=r'swing_what_if\.mcap stopped: the disk is too slow'):
        what_if(swing)
    assert not verify_log(Path('swing_what_if.mcap')).complete


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['payload.mas=2'], "unknown setting 'payload.mas': did you mean 'payload.mass'?"),
        (['payload_mass=2'], "unknown setting 'payload_mass': did you mean 'payload.mass'?"),
        (['zzzzzzzz=text'], "unknown setting 'zzzzzzzz': `pfd info LOG` lists all"),
        (['payload.mass'], "--what-if takes KEY=VALUE, got 'payload.mass'"),
        (['=2'], "--what-if takes KEY=VALUE, got '=2'"),
        (['substeps=1', 'substeps=2'], 'substeps is given twice'),
        (['friction.elbow=1', 'friction={"elbow": 2}'], 'is given twice'),
        (['friction=[1,2]', 'friction.elbow=2'], 'is given for all joints and for one'),
        (['payload.mass=-1'], 'payload.mass is -1.0, expected 0.0 to 100000.0'),
        (['damping=[.5, 1]'], "damping is '[.5, 1]', expected JSON such as 0.5, [0.5, 1.0]"),
        (['damping.elbow=.5'], "damping.elbow is '.5', expected JSON such as 0.5"),
        (['damping=' + '[' * 100_000], 'characters), expected JSON'),
        (['damping.wrist=2'], "damping.wrist: no such joint; joints are ['shoulder', 'elbow']"),
        (['robot=ur5'], "'ur5' has none of the joints ['shoulder', 'elbow'] of the log"),
        (['tip_link=hand'], 'tip_link needs robot='),
        (['scene=/nowhere.yaml'], "no scene file '/nowhere.yaml'"),
        (['recording=b.mcap'], 'recording cannot be changed: --out names the log'),
        (['lockstep=false'], 'lockstep cannot be changed'),
        (['time_source=clock'], 'time_source cannot be changed: the log says when'),
        (['recording_time=wall'], 'recording_time cannot be changed'),
        (['on_timeout=hold'], "on_timeout is 'hold', expected servo_p above 0"),
        ({'states': '/a'}, '--states and --rename are for bags'),
        ({'rename': {'a': 'b'}}, '--states and --rename are for bags'),
        ({'commands': '/a', 'changes': ['robot=planar2']}, "topic '/a' is not in the log"),
        ({'commands': ARRAY}, '--commands needs robot='),
        ({'thresholds': (1.0, math.nan, 1.0)}, 'thresholds must be 3 numbers'),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else str(value)[:40],
)
def test_a_wrong_word_or_argument_is_one_line_and_writes_nothing(words, message, swing):
    given = words if isinstance(words, dict) else {'changes': words}
    with pytest.raises(ValueError, match=re.escape(message)) as refused:
        what_if(swing, **given)
    assert len(str(refused.value)) < 800
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize('kind', ['folder', 'foreign', 'text'])
def test_other_logs_are_refused_with_the_option_for_bags_and_other_files_without(kind, tmp_path):
    path = tmp_path / 'a.mcap'
    if kind == 'folder':
        path.mkdir()
    elif kind == 'foreign':
        write_mcap(path, [Row('/s', 1.0, joint_state(NAMES, (0.0, 0.0)))])
    else:
        path.write_text('a text')
    with pytest.raises(LogError, match=r'a\.mcap is') as error:
        what_if(path, ['payload.mass=1'])
    assert ('--commands' in str(error.value)) == (kind != 'text')
