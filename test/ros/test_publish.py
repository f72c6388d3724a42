# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay --publish`: which topics, when, and what another process receives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from importlib import import_module
from pathlib import Path
import re
import signal
import time
from typing import Any

from faulty import failing
from hypothesis import given
from hypothesis import strategies as st
from logs import (
    JOINT_STATE,
    LATCHED,
    QOS,
    STATES,
    STRING,
    Row,
    definition,
    states,
    string,
    write_mcap,
)
import pytest
from recordings import busy
from ros_processes import Peer, Process, Processes, call, qos

from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.messages.qos import Qos, qos_text
from pfd_ros.messages.values import decode_clock
from pfd_ros.recording.bags import Bag, BagMessage, BagTopic
from pfd_ros.replay.playlist import INPUT_NAMES, is_command
from pfd_ros.replay.playlist import choose as choose_topics
from pfd_ros.replay.schedule import Schedule, Send, Window
from pfd_ros.testing.domains import claimed_domain

CLOCK, MAP, WORDS = '/clock', '/map', '/words'
FLOATS = 'std_msgs/msg/Float64MultiArray'
PeerOf = Callable[..., Peer]


# --- the topics


def read(path: Path) -> Bag:
    bag = Bag(path)
    list(bag.messages())
    return bag


@pytest.mark.ros
def test_inputs_of_a_recording_are_withheld_under_every_name(tmp_path):
    topics = {'joint_commands': '/harmless', 'commands': '/joint_states_2'}
    run = busy(tmp_path / 'a.mcap', topics=topics)
    bag = read(tmp_path / 'a.mcap')
    roles = {topic: role for role, topic in run.topics.items()}
    found, notes = choose_topics(bag, roles)
    inputs = {topic for topic, role in roles.items() if ARM_ROLES[role].kind == 'input'}
    assert {'/harmless', '/joint_states_2'} < inputs
    assert set(found) == set(bag.topics) - inputs
    assert notes[-1].startswith(f'Not publishing {len(inputs)} command topics: ')
    (only,) = choose_topics(bag, roles, ['/harmless'], [('/harmless', '/x')])[0].values()
    assert only.published == '/x'


@pytest.mark.ros
def test_outputs_of_the_node_are_published_under_their_own_names_only():
    def command(name, kind, role):
        return is_command(BagTopic(name, kind, 'cdr', ''), role)

    for role, row in ARM_ROLES.items():
        assert row.kind != 'output' or not command(f'/sim_arm/{role}', row.type, role), role
        assert command('/joint_commands', JOINT_STATE, role)
    for name, kind in (
        ('/effort_controller/effort', JOINT_STATE),
        ('/torques/bias_torques', JOINT_STATE),
        ('/sim_arm/bias_torques', FLOATS),
    ):
        assert command(name, kind, 'bias_torques')


@pytest.mark.ros
@pytest.mark.parametrize(
    ('name', 'kind', 'command'),
    [
        ('/joint_states', JOINT_STATE, False),
        ('/arm/joint_commands', JOINT_STATE, True),
        ('/effort_controller/commands', FLOATS, True),
        ('/sim_arm/external_wrench', 'geometry_msgs/msg/WrenchStamped', True),
        ('/sim_arm/payload_in_use', 'geometry_msgs/msg/InertiaStamped', False),
        ('/force_sensor/wrench', 'geometry_msgs/msg/WrenchStamped', False),
        ('/cmd_vel', 'geometry_msgs/msg/Twist', True),
        ('/arm/velocity', 'geometry_msgs/msg/Twist', True),
        ('/arm_controller/joint_trajectory', 'trajectory_msgs/msg/JointTrajectory', True),
        ('/gripper/GoalPose', 'geometry_msgs/msg/PoseStamped', True),
        ('/controller/reference', FLOATS, True),
        ('/arm/jointTorques', FLOATS, True),
        ('/ur_driver/script', STRING, True),
        ('/move_j', FLOATS, True),
        ('/removed', FLOATS, False),
        ('/tf', 'tf2_msgs/msg/TFMessage', False),
        ('/clock', 'rosgraph_msgs/msg/Clock', False),
    ],
)
def test_commands_of_other_logs_are_known_by_name_or_type(name, kind, command):
    assert is_command(BagTopic(name, kind, 'cdr', '')) is command


@pytest.mark.ros
def test_every_topic_that_the_node_takes_as_an_input_is_a_command():
    taken = {
        row.topic.rpartition('/')[2]
        for row in ARM_ROLES.values()
        if row.kind == 'input' and not row.service
    }
    assert taken - INPUT_NAMES == {'clock'}


UNPUBLISHED = {
    '/json': (STRING, 'json', 'string data', "its messages are encoded as 'json', not 'cdr'"),
    '/module': ('antigravity/msg/Fly', 'cdr', '', 'type antigravity/msg/Fly is not installed'),
    '/other': (JOINT_STATE, 'cdr', 'float64[] position', 'has other fields than the installed'),
    '/nested': (
        JOINT_STATE,
        'cdr',
        definition(JOINT_STATE).replace('uint32 nanosec', 'uint64 nanosec'),
        'has other fields than the installed one',
    ),
    '/path': ('../../etc/msg/Passwd', 'cdr', '', "'../../etc/msg/Passwd' is not a message type"),
    '/service': ('std_srvs/srv/SetBool_Event', 'cdr', '', 'is not a message type'),
    '/unknown': (
        'nobody_msgs/msg/Thing',
        'cdr',
        '',
        'type nobody_msgs/msg/Thing is not installed',
    ),
    '/wrong': (STRING, 'cdr', 'string', f'definition of {STRING} cannot be read: '),
}


@pytest.mark.ros
def test_topics_that_cannot_be_published_are_named_and_the_others_are(tmp_path):
    bag = Bag(tmp_path)
    bag.topics |= {name: BagTopic(name, *row[:3]) for name, row in UNPUBLISHED.items()}
    bag.topics['/good'] = BagTopic('/good', JOINT_STATE, 'cdr', definition(JOINT_STATE))
    bag.topics['/without'] = BagTopic('/without', STRING, 'cdr', '')
    found, notes = choose_topics(bag, {})
    assert list(found) == ['/good', '/without']
    lines = {note.split(': ')[1]: note for note in notes}
    assert lines.keys() == UNPUBLISHED.keys()
    for name, (*_, line) in UNPUBLISHED.items():
        assert line in lines[name]


@pytest.mark.ros
@pytest.mark.parametrize(
    ('wanted', 'remaps', 'line'),
    [
        (['/nix'], [], r"has no topic \['/nix'\]; topics are \['/a/commands'"),
        (None, [('/nix', '/x')], r"has no topic \['/nix'\]"),
        (None, [(STATES, '/x'), (STATES, '/y')], 'remapped twice'),
        (None, [(STATES, WORDS)], "but '/words' has type"),
        (['/a/commands'], [], ''),
    ],
)
def test_wrong_topics_and_remappings_are_named(tmp_path, wanted, remaps, line):
    rows = [*states(2), Row(WORDS, 1.0, string('a')), *states(2, topic='/a/commands')]
    bag = read(write_mcap(tmp_path / 'a.mcap', rows, {WORDS: STRING}))
    if not line:
        assert list(choose_topics(bag, {}, wanted, remaps)[0]) == wanted
        return
    with pytest.raises(ValueError, match=line):
        choose_topics(bag, {}, wanted, remaps)


@pytest.mark.ros
def test_a_log_of_commands_alone_has_nothing_to_publish(tmp_path):
    bag = read(write_mcap(tmp_path / 'a.mcap', states(2, topic='/a/commands')))
    with pytest.raises(
        ValueError, match=r"nothing to publish: .*\['/a/commands'\]\. Name them in"
    ):
        choose_topics(bag, {})


@pytest.mark.ros
def test_a_topic_has_the_strongest_recorded_qos_else_the_default_of_its_name(tmp_path):
    def qos_of(offer, *topics):
        rows = [Row(topic, 1.0, string('a')) for topic in topics]
        kinds = dict.fromkeys(topics, STRING)
        path = write_mcap(tmp_path / 'a.mcap', rows, kinds, dict.fromkeys(topics, offer))
        found, notes = choose_topics(read(path), {})
        assert bool(notes) is (offer == '- 1')
        return [found[topic].qos for topic in topics]

    latched = Qos(depth=1, transient_local=True)
    assert qos_of('', '/robot_description', '/x') == [latched, Qos()]
    weak = qos_text(Qos(depth=3, reliable=False))
    assert qos_of(weak, '/x') == [Qos(depth=3, reliable=False)]
    assert qos_of(weak + LATCHED, '/x') == [Qos(depth=3, reliable=True, transient_local=True)]
    assert qos_of('- 1', '/x') == [Qos()]


# --- the player


class Listener:
    """Raw subscriptions of a peer, and their messages in the order in which they came."""

    def __init__(self, peer: Peer, *topics: tuple[str, str], latched: bool = False) -> None:
        self.peer = peer
        self.messages: list[tuple[str, bytes]] = []
        durability = 'transient_local' if latched else 'volatile'
        self.ends = [
            peer.node.create_subscription(
                getattr(import_module(f'{kind.split("/")[0]}.msg'), kind.split('/')[2]),
                topic,
                lambda data, topic=topic: self.messages.append((topic, bytes(data))),
                qos(durability, 10_000),
                raw=True,
            )
            for topic, kind in topics
        ]

    def on(self, topic: str) -> list[bytes]:
        return [data for name, data in self.messages if name == topic]

    def connect(self, *topics: str) -> None:
        """Wait until every subscription, or that of each topic, has a publisher."""
        ends = [end for end in self.ends if not topics or end.topic_name in topics]
        self.peer.wait(lambda: all(end.get_publisher_count() for end in ends))

    def wait_for(self, topic: str, count: int) -> None:
        self.peer.wait(lambda: len(self.on(topic)) >= count)

    def end_of(self, player: Process) -> int:
        """Listen until the player ends, and return its exit status."""
        self.peer.wait(lambda: player.process.poll() is not None)
        # The player waited for the last acknowledgement; callbacks may still wait.
        # One turn may run another callback, or none on a busy machine.
        idle = 0
        while idle < 3:
            count = len(self.messages)
            self.peer.executor.spin_once(timeout_sec=0.1)
            idle = idle + 1 if len(self.messages) == count else 0
        return int(player.process.returncode)


def start(processes: Processes, log: Path, *options: str, **replaced: Any) -> Process:
    """Start a player, perhaps with other values for dotted paths.

    It waits for no subscriptions: where some are to be there, `begin` waits.
    """
    faults = {'pfd_ros.replay.publish.DISCOVERY_SECONDS': 0.0, **replaced}
    args = ('replay', str(log), '--publish', *options)
    return processes.forked('pfd_ros.cli.main', *args, replaced=faults)


def begin(player: Process, listener: Listener, *topics: str) -> None:
    """Wait until a paused player and the subscriptions know each other."""
    player.wait_for_text('paused at')
    listener.connect(*topics)


def paused(peer: Peer, value: bool) -> str:
    from std_srvs.srv import SetBool

    answer = call(peer, SetBool, '/log_player/pause', data=value)
    assert answer.success, answer.message
    return str(answer.message)


def step(peer: Peer) -> tuple[bool, str]:
    from std_srvs.srv import Trigger

    answer = call(peer, Trigger, '/log_player/step')
    return bool(answer.success), str(answer.message)


def set_parameter(peer: Peer, name: str, value: object) -> str:
    """Set a parameter of the player; return why it was refused, '' if it was not."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    wanted = [Parameter(name, value=value).to_parameter_msg()]
    answer = call(peer, SetParameters, '/log_player/set_parameters', parameters=wanted)
    assert answer.results[0].successful is not bool(answer.results[0].reason)
    return str(answer.results[0].reason)


def word(k: int) -> bytes:
    # A multiple of 4 bytes, to which DDS pads every message.
    return string(f'word {k:02d}')


def map_(k: int) -> bytes:
    return string(f'map {k:03d}')


def write_words(path: Path, count: int, apart: float = 1.0) -> Path:
    """Write an MCAP file with a word every so many s, and transient local maps before some."""
    rows = []
    for k in range(count):
        at = 1.0 + k * apart
        rows += [Row(MAP, at, map_(k))] if k in (0, 3) else []
        rows.append(Row(WORDS, at, word(k)))
    qos = {WORDS: QOS.format(durability='volatile'), MAP: LATCHED}
    return write_mcap(path, rows, {WORDS: STRING, MAP: STRING}, qos)


def test_each_message_of_a_recording_comes_bit_for_bit_and_no_command(
    processes, peer_of, tmp_path
):
    run = busy(tmp_path / 'a.mcap', cycles=100, recording_time='simulated')
    sent: dict[str, list[bytes]] = {role: [] for role in run.topics}
    for message in run.messages:
        # DDS pads every message to a multiple of 4 bytes.
        sent[message.role].append(message.data + bytes(-len(message.data) % 4))
    peer = peer_of(processes)
    listener = Listener(peer, *((run.topics[role], ARM_ROLES[role].type) for role in run.topics))
    player = start(processes, tmp_path / 'a.mcap', '--start-paused', '--clock', '--rate', '0.2')
    begin(player, listener, STATES, CLOCK)
    paused(peer, False)
    assert listener.end_of(player) == 0, player.text()
    for role, topic in run.topics.items():
        withheld = ARM_ROLES[role].kind == 'input'
        assert listener.on(topic) == ([] if withheld else sent[role])
    assert sent['commands']
    assert 'Ignoring --clock: the log contains /clock' in player.text()
    count = sum(len(sent[r]) for r in run.topics if ARM_ROLES[r].kind != 'input')
    assert f'published {count} messages' in player.text()


def test_messages_out_of_order_come_in_order_up_to_a_cut_and_an_early_one_is_not_waited_for(
    processes, peer_of, tmp_path
):
    rows = states(1000, period=1e-3, epoch=6000.0)
    # No reader is too slow for a publisher that keeps all of them.
    qos = {STATES: qos_text(Qos(depth=10_000)), MAP: LATCHED}
    file = [Row(MAP, 1000.0, map_(1)), *rows[500:], *rows[:500]]
    path = write_mcap(tmp_path / 'a.mcap', file, {MAP: STRING}, qos, chunk_size=1000)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 5])
    peer = peer_of(processes)
    latched = Listener(peer, (MAP, STRING), latched=True)
    plain = Listener(peer, (STATES, JOINT_STATE))
    player = start(processes, path, '--start-paused')
    begin(player, plain)
    assert re.search(r'a\.mcap: 0\.999 s, \d+ messages of 2 topics', player.text())
    assert 'the log was cut off' in player.text()
    latched.wait_for(MAP, 1)
    paused(peer, False)
    assert plain.end_of(player) == 0
    count = len(plain.on(STATES))
    assert 500 < count < 1000
    assert plain.on(STATES) == [row.data for row in (*rows[: count - 500], *rows[500:])]


def test_a_paused_log_steps_seeks_and_resumes(processes, peer_of, tmp_path):
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    peer = peer_of(processes)
    listener, plain = Listener(peer, (MAP, STRING), latched=True), Listener(peer, (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 6)
    player = start(processes, log, '--start-offset', '2', '--start-paused')
    begin(player, plain)
    assert 'paused at 2.000 s' in player.text()
    # The map from before the offset comes first, though it is paused.
    listener.wait_for(MAP, 1)
    assert listener.on(MAP) == [map_(0)]
    assert step(peer) == (True, '/words at 2.000 s')
    assert step(peer) == (True, '/map at 3.000 s')
    plain.wait_for(WORDS, 1)
    assert plain.on(WORDS) == [word(2)]
    assert set_parameter(peer, 'seek_to', 0.5) == ''
    listener.wait_for(MAP, 3)
    assert listener.on(MAP) == [map_(k) for k in (0, 3, 0)]
    assert 'seek: jumped back from 3.000 s to 0.500 s' in player.text()
    assert step(peer) == (True, '/words at 1.000 s')
    for outside in (5.5, 1e300, -1e300, 2**62, float('nan')):
        assert 'outside of the log, expected 0 to 5 s' in set_parameter(peer, 'seek_to', outside)
    for wrong in ('soon', True):
        assert 'expected a number' in set_parameter(peer, 'seek_to', wrong)
    # A request that rclpy cannot answer does not end the player.
    client = peer.node.create_client(SetParameters, '/log_player/set_parameters')
    unknown = Parameter(name='rate', value=ParameterValue(type=200))
    client.call_async(SetParameters.Request(parameters=[unknown]))
    player.wait_for_text('ROS: a request failed: ')
    peer.node.destroy_client(client)
    assert set_parameter(peer, 'seek_to', 5) == ''
    assert step(peer) == (True, '/words at 5.000 s')
    assert step(peer) == (False, 'refused: end of the log reached')
    assert set_parameter(peer, 'seek_to', 4) == ''
    assert 'rate is 0, expected' in set_parameter(peer, 'rate', 0)
    assert paused(peer, False).startswith('resumed at 4.')
    assert step(peer) == (False, 'refused: player is not paused: call ~/pause first')
    assert set_parameter(peer, 'rate', 100.0) == ''
    assert listener.end_of(player) == 0
    assert plain.on(WORDS) == [word(k) for k in (2, 1, 5, 4, 5)]


def test_an_offset_a_duration_and_a_rate_choose_what_comes_and_a_clock_ticks_through_it(
    processes, peer_of, tmp_path
):
    peer = peer_of(processes)
    listener = Listener(peer, (CLOCK, 'rosgraph_msgs/msg/Clock'), (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 20, apart=0.1)
    options = '--start-offset', '0.5', '--duration', '0.8', '--rate', '0.5', '--start-paused'
    # Ticks that are due together are one: far more than are counted below.
    player = start(processes, log, '--clock', '1000', *options)
    begin(player, listener)
    begun = time.monotonic()
    paused(peer, False)
    assert listener.end_of(player) == 0
    assert listener.on(WORDS) == [word(k) for k in range(5, 13)]
    # Never faster than asked; how late a message is depends on the machine.
    assert time.monotonic() - begun >= 0.8 / 0.5
    assert re.search(r'messages were more than 10 ms late, at most \d+\.\d ms', player.text())
    ticks = [decode_clock(data) for data in listener.on(CLOCK)]
    assert ticks == sorted(ticks)
    # More than messages; a busy machine has few turns for them.
    assert len(set(ticks)) > 16
    assert (ticks[0], ticks[-1] <= 2_300_000_001) == (1_500_000_000, True)


def test_a_loop_says_that_time_goes_back_and_a_signal_ends_it_with_status_0(
    processes, peer_of, tmp_path
):
    peer = peer_of(processes)
    listener = Listener(peer, (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 4, apart=0.05)
    player = start(processes, log, '--loop', '--start-paused')
    begin(player, listener)
    paused(peer, False)
    listener.wait_for(WORDS, 9)
    assert listener.on(WORDS)[:9] == [word(k % 4) for k in range(9)]
    assert 'loop 1: jumped back from 0.150 s to 0.000 s' in player.text()
    assert 'loop 2: jumped back' in player.text()
    assert player.end(signal.SIGTERM) == 0


@pytest.mark.parametrize(
    ('number', 'options'), [(signal.SIGINT, ()), (signal.SIGTERM, ('--start-paused',))]
)
def test_a_signal_before_the_end_has_the_status_of_a_shell(processes, tmp_path, number, options):
    player = start(processes, write_words(tmp_path / 'words.mcap', 100), *options)
    player.wait_for_text(' at 0.000 s')
    assert player.end(number) == 128 + number
    assert 'published' in player.text()
    assert 'Traceback' not in player.text()


def test_an_error_of_the_player_itself_is_a_traceback_and_not_called_ros(processes, tmp_path):
    log = write_words(tmp_path / 'words.mcap', 2)
    next_ns = 'pfd_ros.replay.schedule.Schedule.next_ns'
    player = start(processes, log, **{next_ns: partial(failing, RecursionError)})
    assert player.process.wait() == 1
    assert 'RecursionError: a bug' in player.text()
    assert 'ROS:' not in player.text()


@pytest.mark.ros
@pytest.mark.parametrize(
    ('options', 'line'),
    [
        (('--remap', '/words:=/a b'), '--remap /words: Invalid topic name'),
        (('--loop', '--duration', '1e-6'), 'a loop over 1e-06 s'),
    ],
)
def test_options_that_cannot_be_are_one_line_and_status_1(tmp_path, options, line, capfd):
    log = write_words(tmp_path / 'words.mcap', 3)
    with claimed_domain():
        assert pfd_main(['replay', str(log), '--publish', *options]) == 1
    (error,) = capfd.readouterr().err.splitlines()
    assert error.startswith(f'pfd replay: {line}')


UNIT = 1 << 20
SENT, LATCHED_MAP = '/states', '/map'


def message(at: int, k: int, topic: str = SENT) -> BagMessage:
    return BagMessage(topic, at, at, k.to_bytes(4, 'little'))


def log_of(times: Sequence[int]) -> list[BagMessage]:
    """Return messages at these times in units; every third one of a transient local topic."""
    return [
        message(UNIT * at, k, LATCHED_MAP if k % 3 == 0 else SENT) for k, at in enumerate(times)
    ]


def schedule_of(messages: Sequence[BagMessage], **options: Any) -> Schedule:
    first, last = messages[0].log_ns, messages[-1].log_ns
    window = Window(first, first, last + 1)
    jumped = options.pop('jumped', lambda *_: None)
    return Schedule(lambda: iter(messages), {LATCHED_MAP: 2}, window, jumped, **options)


def drain(schedule: Schedule, now: int) -> list[Send]:
    return list(iter(lambda: schedule.due(now), None))


def sends(found: Sequence[Send]) -> list[BagMessage]:
    return [send.message for send in found]


@given(
    times=st.lists(st.integers(0, 10**12), min_size=1, max_size=20),
    rate=st.floats(1e-3, 1e3),
    start=st.integers(0, 10**15),
    polls=st.lists(st.integers(0, 10**12), max_size=10),
)
def test_each_message_is_due_at_its_time_however_late_the_others_were(times, rate, start, polls):
    messages = [message(at, k) for k, at in enumerate(sorted(times))]
    schedule = schedule_of(messages, rate=rate)
    found = drain(schedule, start)
    now = start
    for wait in polls:
        now += wait
        found += drain(schedule, now)
    while not schedule.ended:
        when = schedule.next_ns()
        assert when is not None
        now = max(now, when)
        found += drain(schedule, now)
    assert sends(found) == messages
    for send in found:
        exact = start + Fraction(send.message.log_ns - messages[0].log_ns) / Fraction(rate)
        # Half a nanosecond, and the last bit of a float.
        assert send.due_ns is not None
        assert abs(send.due_ns - exact) <= 1 + exact * Fraction(1, 2**52)


def test_the_position_is_not_ahead_of_a_message_that_is_late():
    messages = log_of(range(0, 100, 3))
    schedule = schedule_of(messages)
    drain(schedule, 0)
    assert schedule.position_ns(2 * UNIT) == 2 * UNIT
    assert schedule.position_ns(50 * UNIT) == messages[1].log_ns
    assert sends(drain(schedule, 50 * UNIT)) == messages[1:17]
    assert schedule.position_ns(50 * UNIT) == 50 * UNIT


def test_a_pause_keeps_what_is_late_and_a_rate_acts_from_now_on():
    messages = log_of(range(40))
    schedule = schedule_of(messages)
    assert sends(drain(schedule, 100 * UNIT)) == messages[:1]
    assert schedule.next_ns() == 101 * UNIT
    # Messages 1 to 5 are late, and the position does not pass them.
    schedule.pause(105 * UNIT)
    assert schedule.position_ns(200 * UNIT) == UNIT
    assert drain(schedule, 200 * UNIT) == []
    assert sends([*schedule.step(200 * UNIT), *schedule.step(200 * UNIT)]) == messages[1:3]
    assert schedule.position_ns(200 * UNIT) == 2 * UNIT
    schedule.resume(300 * UNIT)
    assert sends(drain(schedule, 304 * UNIT)) == messages[3:7]
    schedule.set_rate(304 * UNIT, 4.0)
    assert sends(drain(schedule, 306 * UNIT)) == messages[7:15]
    with pytest.raises(ValueError, match='player is not paused'):
        list(schedule.step(306 * UNIT))


def test_a_seek_sends_the_last_latched_messages_before_it_and_then_goes_on():
    messages = log_of(range(40))
    jumps = []
    schedule = schedule_of(messages, jumped=lambda *jump: jumps.append(jump))
    drain(schedule, 0)
    # Forwards, only those that were not sent yet.
    schedule.seek(5 * UNIT, 14 * UNIT)
    schedule.seek(5 * UNIT, 16 * UNIT)
    found = drain(schedule, 5 * UNIT)
    assert sends(found) == [messages[12], messages[15], messages[16]]
    assert [send.due_ns for send in found] == [None, None, 5 * UNIT]
    # To the last message that was sent.
    schedule.seek(6 * UNIT, 16 * UNIT)
    assert sends(drain(schedule, 6 * UNIT)) == [messages[12], messages[15], messages[16]]
    schedule.seek(6 * UNIT, 4 * UNIT)
    assert sends(drain(schedule, 6 * UNIT)) == [messages[0], messages[3], messages[4]]
    assert sends(drain(schedule, 7 * UNIT)) == messages[5:6]
    ends = [(1, 14), (14, 16), (17, 16), (16, 4)]
    assert jumps == [(UNIT * one, UNIT * other, None) for one, other in ends]


def test_a_loop_begins_again_at_its_time_and_while_paused_by_a_step():
    messages = log_of(range(4))
    jumps = []
    schedule = schedule_of(messages, loop=True, jumped=lambda *jump: jumps.append(jump))
    drain(schedule, 0)
    assert sends(drain(schedule, 4 * UNIT)) == [*messages[1:], messages[0]]
    assert jumps == [(3 * UNIT + 1, 0, 1)]
    drain(schedule, 7 * UNIT)
    schedule.pause(7 * UNIT)
    assert sends([*schedule.step(8 * UNIT)]) == messages[:1]
    assert jumps[1:] == [(3 * UNIT, 0, 2)]
    assert not schedule.ended
