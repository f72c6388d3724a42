# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Verify: what is equal, and that nothing else is; the facts of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
import json
from pathlib import Path
import random
import struct
import threading
import time
from typing import Any

from arm_messages import (
    INF,
    NAN,
    UNLIMITED,
    change,
    efforts,
    named,
    payload,
    placed,
    request,
    tick,
    trajectory,
    wrench,
)
from mcap.records import Message, Metadata
from mcap.writer import Writer
import pytest
from recordings import NAMES, Run, aside, busy, rewritten, simulate

from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.messages.values import decode_string, encode_string
from pfd_ros.node.inbox import Inbox
from pfd_ros.recording.facts import facts as log_facts
from pfd_ros.recording.facts import lines as fact_lines
from pfd_ros.recording.format import END as END_RECORD
from pfd_ros.recording.format import HEAD as HEAD_RECORD
from pfd_ros.recording.format import LogError
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.recording.mcap_records import records as mcap_records
from pfd_ros.replay.verify import DifferenceError
from pfd_ros.replay.verify import verify as verify_log

DATA = Path(__file__).resolve().parents[1] / 'data'
LOGS = sorted(DATA.glob('*.mcap'))
INPUTS = {role for role, row in ARM_ROLES.items() if row.kind == 'input'}
FRAME = 'tip_link'
# Settings with which each input and each rule has an effect.
EVERYTHING: dict[str, Any] = {
    'external_wrench': True,
    'servo_p': (100.0, 50.0),
    'servo_d': (5.0, 2.0),
    'noise_position': 1e-3,
    'noise_velocity': 1e-2,
    'delay_commands': 0.003,
    'delay_state': 0.002,
    'drop_commands': 0.1,
    'drop_state': 0.1,
    'command_timeout': 0.02,
    'reflex_effort_rate': 5e4,
    'joint_limits': True,
    'seed': 5,
    'outputs': ('tip_pose', 'energy', 'inertia_matrix', 'true_states'),
}
FURTHER = ('external_wrench', 'payload', 'payload_in_use', 'tip_pose', 'tip_wrench', 'energy')
# The wrist follows the elbow, as does a rod beside it.
FOLLOWING = """<robot name="following"><link name="base"/>{}</robot>""".format(
    ''.join(
        f'<link name="{child}"><inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia '
        'ixx="0.02" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>{rule}'
        '<limit lower="-2" upper="2.5" velocity="9" effort="90"/></joint>'
        for name, parent, child, rule in (
            ('shoulder', 'base', 'upper', ''),
            ('elbow', 'upper', 'fore', ''),
            ('rod', 'upper', 'side', '<mimic joint="elbow" multiplier="0.5"/>'),
            ('wrist', 'fore', FRAME, '<mimic joint="elbow" multiplier="-1"/>'),
        )
    )
)
SCENES: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    'everything': (EVERYTHING, (*FURTHER, 'inertia_matrix', 'true_states')),
    'lockstep': ({'lockstep': True, 'wait_for_controller': True, 'autostart': False}, ()),
    'sparse': ({'publish_rate': 250.0, 'clock_rate': 500.0, 'start_time': 12.5}, ()),
    'a clock and lockstep': (
        {'time_source': 'clock', 'publish_clock': False, 'lockstep': True},
        ('clock_ticks',),
    ),
    'followed clock': ({'time_source': 'clock', 'publish_clock': False}, ('clock_ticks',)),
    'followers': (EVERYTHING | {'robot': FOLLOWING, 'outputs': ()}, FURTHER[:3]),
    'overflow': (UNLIMITED, ()),
}


# Recordings with the inputs of real nodes of the first edition: equal bits over versions of the
# code, of NumPy and LLVM, and over processors. They are made anew when the format changes or there
# are new outputs, never to please a test: `pfd replay OLD --what-if --out NEW`, see test_what_if.


@pytest.mark.parametrize('path', LOGS, ids=lambda path: path.stem)
def test_a_recording_of_the_past_has_the_same_bits(path):
    found = verify_log(path)
    assert found.complete
    # A real run, long enough for a difference to grow.
    assert found.compared['joint_states'] > 200


def events(rng: random.Random, run: Run) -> list[ArmMessage]:
    """Return some inputs, good and bad."""
    numbers = [rng.gauss(0, 20) for _ in NAMES]
    one = rng.choice(NAMES)
    choices: list[Callable[[], ArmMessage]] = [
        lambda: efforts(*numbers),
        lambda: named(NAMES, numbers),
        lambda: named((one,), (rng.gauss(0, 5),), stamp_ns=rng.randrange(10**9)),
        lambda: named(NAMES, (), [rng.random() for _ in NAMES]),
        lambda: trajectory(NAMES, [0.0, rng.random()], effort=[numbers, numbers[::-1]]),
        lambda: trajectory((one,), [0.01, 0.1], rng.randrange(10**9), positions=[[1], [0]]),
        lambda: named(NAMES, [NAN, 1.0]),
        lambda: named(NAMES, [NAN, NAN]),
        lambda: named((), ()),
        lambda: named((one, one), (1.0, 2.0)),
        lambda: named(('nobody', one), (1.0, 2.0)),
        lambda: efforts(*numbers, 1.0),
        lambda: efforts(INF, 0.0),
        lambda: placed((one,), (rng.random(),)),
        lambda: request(rng.choice(['pause', 'resume', 'resume', 'reset', 'activate'])),
        lambda: request('step', count=rng.randrange(1, 4)),
        lambda: change(noise_position=rng.random(), gravity_compensation=rng.random() < 0.5),
        lambda: change(servo_p=[-1.0, 2.0]),
        lambda: wrench(FRAME, [rng.gauss(0, 5) for _ in range(3)]),
        lambda: wrench('moon', (1.0, 0.0, 0.0)),
        lambda: payload(FRAME, rng.random()),
        lambda: tick(run.engine.stamp_ns + rng.randrange(-1, 5) * 1_000_000),
        lambda: ArmMessage(
            rng.choice([role for role in run.topics if role in INPUTS]),
            rng.randbytes(rng.randrange(60)),
        ),
    ]
    found = [rng.choice(choices)() for _ in range(rng.choice([0, 1, 1, 1, 3]))]
    return [message for message in found if message.role in run.topics]


@pytest.mark.filterwarnings('ignore:.*mimic others:pfd_core.PhysicsWarning')
@pytest.mark.parametrize('scene', SCENES)
def test_random_inputs_recorded_in_their_order_verify(scene, tmp_path):
    path, rng = tmp_path / 'run.mcap', random.Random(scene)
    settings, roles = SCENES[scene]
    run = Run(path, roles, **settings)
    for k in range(600):
        run.step(*events(rng, run))
        if k % 50 == 0:
            run.record([aside()])
    if scene == 'overflow':
        run.step(request('resume'), efforts(1e300, 1e300), times=20)
    run.close()
    found = verify_log(path)
    assert found == (Counter(m.role for m in run.messages), run.engine.state.cycle, True)
    assert len(set(run.verdicts)) > 5
    assert found.cycles > 10
    taken = {role for role in run.topics if role in INPUTS}
    assert taken <= found.compared.keys()
    every = scene in ('everything', 'followers')
    assert run.accepted >= (taken if every else {'requests'})
    assert bool(run.engine.state.failure) == (scene == 'overflow')


def test_a_storm_of_threads_verifies(tmp_path):
    path, stop = tmp_path / 'run.mcap', threading.Event()
    run = Run(path, FURTHER, **EVERYTHING)
    box, sent = Inbox(lambda role, verdict: None), [0] * 8

    def talk(place):
        rng = random.Random(place)
        while not stop.is_set():
            for message in events(rng, run):
                box.put(message.role, message.data)
                sent[place] += 1
            # Diagnostics of a node come from other threads than the steps.
            run.recorder.put([aside(f'{place}')], run.engine.stamp_ns)
            told[place] += 1
            time.sleep(5e-3)

    told = [0] * len(sent)
    threads = [threading.Thread(target=talk, args=(k,)) for k in range(len(sent))]
    for thread in threads:
        thread.start()
    while min(sent) < 60 or run.engine.state.cycle < 50:
        run.step(*[message for message, _ in box.take(0.01)], request('resume'))
    stop.set()
    for thread in threads:
        thread.join()
    run.close()
    assert run.recorder.error == ''
    assert len(set(run.verdicts)) > 8
    counts = Counter(message.role for message in run.messages) + Counter(diagnostics=sum(told))
    assert verify_log(path) == (counts, run.engine.state.cycle, True)


# One thing altered.


@pytest.fixture(scope='module')
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording with commands, refused ones, and further outputs."""
    path = tmp_path_factory.mktemp('source') / 'run.mcap'
    busy(path, roles=FURTHER, **{**EVERYTHING, 'drop_state': 0.0, 'command_timeout': 0.0})
    assert verify_log(path).complete
    return path


def sent_in(role: str, cycle: int, alter: Callable[[Message], Any]) -> Any:
    return lambda found, m: alter(m) if (found, m.sequence) == (role, cycle) else m


def bit(role: str, place: int, cycle: int = 30, mask: int = 1) -> Any:
    """Return the change of one bit of a message."""

    def flipped(message: Message) -> Message:
        data = bytearray(message.data)
        data[place] ^= mask
        return replace(message, data=bytes(data))

    return sent_in(role, cycle, flipped)


def later(message: Message) -> Message:
    return replace(message, sequence=message.sequence + 1)


def moved(by: int) -> Any:
    return lambda role, m: replace(m, sequence=m.sequence + by) if m.sequence > 29 else m


# Bytes from the end of a state of two joints: efforts, velocities and positions are 8 bytes each.
BITS: dict[str, tuple[Any, str]] = {
    'effort of the last joint': (bit('joint_states', -8), r"30, joint_states: effort\['elbow'\]"),
    'effort of the first joint': (bit('joint_states', -16), r"effort\['shoulder'\]: recorded"),
    'velocity': (bit('joint_states', -32), r"velocity\['elbow'\]"),
    'position': (bit('joint_states', -64), r"position\['shoulder'\]"),
    'stamp': (bit('joint_states', 8), 'header.stamp.nanosec: recorded'),
    'name of a joint': (bit('joint_states', 29), r'name\['),
    'length of a name': (bit('joint_states', 25), 'cannot be decoded'),
    'clock': (bit('clock', 8), 'clock: clock.nanosec'),
    'tip_pose': (bit('tip_pose', -8), 'tip_pose: pose.orientation.w'),
    'tip_wrench': (bit('tip_wrench', -8), 'tip_wrench: wrench.torque.z'),
    'energy': (bit('energy', -8), r'energy: data\[2\]'),
    'sign of a zero': (bit('joint_states', -1, 1, 0x80), r'recorded -0\.0 .*, replayed 0\.0'),
}
ALTERED: dict[str, tuple[Any, str]] = {
    **BITS,
    'a state is left out': (sent_in('joint_states', 30, lambda m: None), 'recorded'),
    # It is delayed by three cycles.
    'a command is left out': (sent_in('commands', 30, lambda m: None), 'cycle 33, tip_pose'),
    'a tick comes twice': (sent_in('clock', 30, lambda m: [m, m]), 'recorded clock'),
    'a command comes twice': (sent_in('commands', 30, lambda m: [m, m]), 'cycle'),
    'a command of another cycle': (sent_in('commands', 30, later), 'cycle 3'),
    'a state of another cycle': (sent_in('joint_states', 30, later), 'cycle 31'),
    'the last message is left out': (sent_in('tip_pose', 60, lambda m: None), 'cycle 60'),
    'a rejection is altered': (bit('rejected', 10, 7), 'rejected'),
    'cycles far ahead': (moved(10**9), 'cycle 1000000029 after 29 recorded states'),
    'cycles that go back': (moved(-9), 'cycle 429496'),
}


@pytest.mark.parametrize('name', ALTERED)
def test_an_altered_recording_is_not_equal_and_the_place_is_named(name, source, tmp_path):
    alter, expected = ALTERED[name]
    # An end that counts the changed messages cannot know of a change.
    for counted in (True, False):
        path = rewritten(source, tmp_path / f'{counted}.mcap', alter, counted=counted)
        with pytest.raises(LogError, match=expected) as caught:
            verify_log(path)
        if name in BITS:  # the checksum is of the bytes
            assert ('cause: other data' in str(caught.value)) != counted
            assert ('cause: not the program' in str(caught.value)) == counted


def test_an_end_that_no_run_without_outputs_reaches_is_damage(source, tmp_path):
    def change(name, found):
        if name == HEAD_RECORD:
            return {**found, 'topics': '{"commands": "/sim_arm/commands"}'}
        return {**found, 'totals': json.dumps({'cycles': 10**12})}

    def only_commands(role, message):
        return message if role == 'commands' else None

    path = rewritten(source, tmp_path / 'new.mcap', only_commands, change, counted=True)
    with pytest.raises(LogError, match=f'cycle {10**12} after 0 recorded states'):
        verify_log(path)


def test_an_altered_input_without_effect_is_found(tmp_path):
    paths = tmp_path / 'run.mcap', tmp_path / 'new.mcap'
    simulate(paths[0], 20, {5: [efforts(1e6, 0.0)], 6: [efforts(INF, 0.0)]}, torque_speed=False)
    for cycle in (5, 6):
        rewritten(*paths, bit('commands', 22, cycle))
        old, new = (set(RecordedLog(path).messages()) for path in paths)
        assert [{m.role for m in some} for some in (old - new, new - old)] == [{'commands'}] * 2
        with pytest.raises(LogError, match='altered'):
            verify_log(paths[1])


def test_an_explanation_may_differ_and_a_rule_may_not(source, tmp_path):
    def explained(text):
        def alter(role, message):
            if role != 'rejected':
                return message
            rule, _, _ = decode_string(message.data).partition('\n')
            return replace(message, data=encode_string(text.format(rule=rule)))

        return alter

    path = tmp_path / 'new.mcap'
    rewritten(source, path, explained('{rule}\nin the words of another version'), counted=True)
    assert verify_log(path) == verify_log(source)
    rewritten(source, path, explained('{rule} x\n'), counted=True)
    with pytest.raises(DifferenceError, match="data: recorded 'commands wrong_size x', replayed"):
        verify_log(path)


@pytest.mark.parametrize('key', ['cycles', 'recorded', 'crc', 'totals'])
def test_an_altered_end_is_found(key, source, tmp_path):
    def alter(name, values):
        if name != END_RECORD:
            return values
        found = {k: json.loads(text) for k, text in values.items()}
        if key == 'cycles':
            found['totals']['cycles'] += 1
        elif key == 'recorded':
            found['recorded']['clock'] -= 1
        elif key == 'crc':
            found['crc'] ^= 1
        else:
            del found['totals']
        return {k: json.dumps(value) for k, value in found.items()}

    path = rewritten(source, tmp_path / 'new.mcap', metadata=alter)
    with pytest.raises(LogError):
        verify_log(path)


def with_head(**values: Any) -> Callable[[str, dict[str, str]], dict[str, str]]:
    """Return a change of the head; values that are tables are added to the recorded ones."""

    def alter(name: str, found: dict[str, str]) -> dict[str, str]:
        if name != HEAD_RECORD:
            return found
        tables = {k: v for k, v in values.items() if isinstance(v, dict)}
        return (
            found | values | {k: json.dumps(json.loads(found[k]) | v) for k, v in tables.items()}
        )

    return alter


def test_the_cause_of_a_difference_is_data_program_settings_or_processor(source, tmp_path):
    path = tmp_path / 'new.mcap'
    for versions, cause in (
        ({'program': 'abc', 'pfd': '9.9'}, 'cause: another program, program abc, here .*pfd 9.9'),
        ({'cpu': 'abacus'}, 'cause: not the program, the settings or the data; cpu abacus, here'),
    ):
        alter, head = bit('joint_states', -8), with_head(versions=versions)
        rewritten(source, path, alter, head, counted=True)
        with pytest.raises(DifferenceError, match=cause):
            verify_log(path)
        # Another program with the same bits is equal.
        assert verify_log(rewritten(source, path, metadata=head)).complete
    rewritten(source, path, metadata=with_head(settings={'seed': 6}))
    with pytest.raises(DifferenceError, match='cycle 1, joint_states: position'):
        verify_log(path)
    # A payload changes the program during the run.
    changing = {5: [payload(FRAME, 1.0)], 9: [efforts(1.0, 2.0)]}
    run = simulate(tmp_path / 'run.mcap', 30, changing, FURTHER)
    assert run.engine.plant.program != RecordedLog(tmp_path / 'run.mcap').versions['program']
    rewritten(tmp_path / 'run.mcap', path, bit('joint_states', -8, 20), counted=True)
    with pytest.raises(DifferenceError, match='cause: not the program'):
        verify_log(path)


# Cut and damaged files.


@pytest.mark.parametrize('many', [100, pytest.param(1500, marks=[pytest.mark.long])])
def test_a_flipped_bit_is_found_wherever_a_message_or_the_head_is(many, tmp_path):
    path = tmp_path / 'run.mcap'
    busy(path)
    data, every, rng, missed = path.read_bytes(), list(mcap_records(path)), random.Random(2), []
    # The index at the end is for other readers; nobody parses it here.
    (index,) = struct.unpack('<Q', data[-28:-20])
    for _ in range(many):
        at = rng.randrange(len(data))
        flipped = bytearray(data)
        flipped[at] ^= 1 << rng.randrange(8)
        path.write_bytes(flipped)
        try:
            # Compressed data that are changed may unpack to the same bytes.
            if verify_log(path).complete and at < index and list(mcap_records(path)) != every:
                missed.append(at)
        except LogError:
            continue
    assert missed == []


def test_what_is_no_recording_is_named(source, tmp_path):
    path = tmp_path / 'new.mcap'
    for text, why in (('2', 'first edition of pfd_ros .format 2.'), ('9', "format '9'")):
        rewritten(source, path, metadata=with_head(format=text))
        with pytest.raises(LogError, match=why):
            verify_log(path)
    rewritten(source, path, metadata=lambda name, found: None)
    with pytest.raises(LogError, match='not a recording of pfd_ros'):
        verify_log(path)
    path.write_bytes(b'hello')
    with pytest.raises(LogError, match=str(path)):
        verify_log(path)
    with pytest.raises(LogError, match='folder'):
        verify_log(tmp_path)
    with pytest.raises(OSError, match='missing'):
        verify_log(tmp_path / 'missing.mcap')


@pytest.mark.parametrize(
    ('key', 'value'),
    [
        *(('settings', text) for text in ('', '[' * 100_000, '{"robot": 5}', '[1]', '{}x')),
        *(('topics', text) for text in ('5', '{"joint_states": 5}', '{"clock": "/a"', '[[1]]')),
        *(('versions', text) for text in ('', 'null')),
    ],
)
def test_a_hostile_head_is_an_error_that_names_the_file(key, value, source, tmp_path):
    path = tmp_path / 'new.mcap'
    (head, *_) = [r.metadata for r in mcap_records(source) if isinstance(r, Metadata)]
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'test')
        writer.add_metadata(HEAD_RECORD, {**head, key: value})
        writer.finish()
    with pytest.raises(LogError, match=str(path)):
        verify_log(path)


def test_without_cycles_or_without_its_end_a_recording_is_equal(source, tmp_path):
    simulate(tmp_path / 'run.mcap', 0)
    assert verify_log(tmp_path / 'run.mcap') == ({}, 0, True)
    endless = rewritten(
        source,
        tmp_path / 'new.mcap',
        metadata=lambda name, found: None if name == END_RECORD else found,
    )
    assert verify_log(endless) == (*verify_log(source)[:2], False)


@pytest.mark.parametrize(
    ('key', 'value', 'words'),
    [
        ('settings', '[]', ['info']),
        ('versions', '[]', ['info']),
        ('versions', '1', ['replay', '--verify']),
        ('times', '"x"', ['info']),
        ('topics', '{"joint_states": 3}', ['replay', '--what-if']),
        ('topics', 'null', ['replay', '--verify']),
    ],
)
def test_a_head_without_tables_is_one_line(key, value, words, source, tmp_path, capsys):
    path = tmp_path / 'a.mcap'
    rewritten(source, path, metadata=lambda _, x: x | {key: value} if key in x else x)
    assert pfd_main([words[0], str(path), *words[1:]]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f'pfd {words[0]}: {path}')


# The facts.


def test_the_facts_count_rejections_and_cycles(tmp_path):
    path = tmp_path / 'run.mcap'
    run = busy(path, cycles=60, start_time=3.0)
    found = log_facts(path)
    assert found['messages'] == len(run.messages)
    about = found['run']
    assert about['rejected'] == {'commands wrong_size': 1, 'joint_commands infinite': 1}
    assert (about['robot'], about['cycles'], found['complete']) == ('planar2', 60, True)
    assert about['seconds'] == pytest.approx(0.06)
    path.write_bytes(path.read_bytes()[:-200])
    cut = log_facts(path)
    assert (cut['complete'], cut['run']['cycles'] <= 60) == (False, True)


def test_the_facts_count_floods_and_name_failures_that_a_reset_cleared_too(tmp_path):
    path, other = tmp_path / 'run.mcap', tmp_path / 'reset.mcap'
    run = Run(path, **UNLIMITED)
    run.step(*[ArmMessage('commands', bytes(9000))] * 20)
    run.step(efforts(1e300, 1e300), times=20)
    run.close()
    assert verify_log(path).complete
    found = log_facts(path)
    assert found['topics']['/sim_arm/commands']['messages'] < 20
    assert sum(found['run']['rejected'].values()) == 20
    (line,) = (x for x in fact_lines(found) if x.startswith('FAILED'))
    assert run.engine.state.failure in line
    simulate(other, 40, {1: [efforts(1e300, 1e300)], 30: [request('reset')]}, **UNLIMITED)
    (line,) = (x for x in fact_lines(log_facts(other)) if x.startswith('failed'))
    assert 'stopped 1 times' in line
