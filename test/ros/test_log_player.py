# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay --publish` as a process, and what subscriptions of another process receive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
import os
from pathlib import Path
import pty
import re
import signal
import subprocess
import sys
import time
from typing import Any

from bridge import Bag, claimed_domain, decode_clock, encode_string, pfd_main, qos_text
from forked_process import failing
import pytest
from rewriting import (
    ARRAY,
    CLOCK,
    GOLDEN,
    NAMED,
    STATES,
    TAKEN,
    WITHHELD,
    Recording,
    Sent,
    flipped,
    load,
    ros_topic,
)
from ros_processes import Peer, Process, Processes, call, environment
from sampling import one_fast
from test_played_topics import install_definition
from test_read_log import rosbag2
from test_signals import wait_for_handlers

pytestmark = pytest.mark.ros

STRING, DEFINITION = 'std_msgs/msg/String', 'string data\n'
MAP, WORDS = '/map', '/words'
SECOND = 1_000_000_000
PFD = ('-m', 'pfd_ros.cli.main')
PeerOf = Callable[..., Peer]


class Listener:
    """Raw subscriptions of a peer, and their messages in the order in which they came."""

    def __init__(self, peer: Peer, *topics: tuple[str, str], latched: bool = False) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self.peer = peer
        self.messages: list[tuple[str, bytes]] = []
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        self.ends = [
            peer.node.create_subscription(
                class_of(kind),
                topic,
                lambda data, topic=topic: self.messages.append((topic, bytes(data))),
                QoSProfile(depth=5000, durability=durability),
                raw=True,
            )
            for topic, kind in topics
        ]

    def on(self, topic: str) -> list[bytes]:
        return [data for name, data in self.messages if name == topic]

    def connect(self) -> None:
        """Wait until every subscription has a publisher."""
        self.peer.wait(lambda: all(end.get_publisher_count() for end in self.ends))

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


def installed(kind: str) -> bool:
    return find_spec(kind.split('/')[0]) is not None


def class_of(kind: str) -> Any:
    package, _, name = kind.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def start(processes: Processes, log: Path, *options: str, **replaced: Any) -> Process:
    """Start a player, perhaps with other values of bridge.PATCHED.

    It waits for no subscriptions: where some are to be there, `begin` waits.
    """
    faults = {'PLAYER_DISCOVERY_SECONDS': 0.0, **replaced}
    args = ('replay', str(log), '--publish', *options)
    return processes.forked('pfd_ros.cli.main', *args, replaced=faults)


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


def begin(peer: Peer, player: Process, listener: Listener) -> None:
    """Wait until a paused player and the subscriptions know each other."""
    player.wait_for_text('paused at')
    listener.connect()


def word(k: int) -> bytes:
    # A multiple of 4 bytes, to which DDS pads every message.
    return encode_string(f'word {k:02d}')


def write_words(path: Path, count: int, apart: float = 1.0, maps: Sequence[int] = (0, 3)) -> Path:
    """Write an MCAP file with a word every so many s, and transient local maps before some."""
    bag = Recording()
    for topic, durability in ((WORDS, 'volatile'), (MAP, 'transient_local')):
        qos = qos_text(1, durability=durability)
        bag.channels.append(ros_topic(topic, STRING, DEFINITION, qos=qos))
    for k in range(count):
        at = SECOND + round(k * apart * SECOND)
        if k in maps:
            bag.messages.append(Sent(MAP, 0, at, encode_string(f'map {k:03d}')))
        bag.messages.append(Sent(WORDS, 0, at, word(k)))
    return bag.save(path)


def kinds_of(log: Path) -> dict[str, str]:
    bag = Bag(log)
    for _ in bag.messages():
        pass
    return {name: topic.type for name, topic in bag.topics.items() if installed(topic.type)}


def test_each_message_of_a_recording_comes_bit_for_bit_and_no_command(
    processes: Processes, peer_of: PeerOf
) -> None:
    peer = peer_of(processes)
    kinds = kinds_of(GOLDEN)
    listener = Listener(peer, *kinds.items())
    player = start(processes, GOLDEN, '--rate', '0.5', '--start-paused', '--clock')
    player.wait_for_text('paused at')
    peer.wait(
        lambda: all(
            end.get_publisher_count()
            for end in listener.ends
            if end.topic_name in (STATES, CLOCK, TAKEN)
        )
    )
    paused(peer, False)
    assert listener.end_of(player) == 0, player.text()
    recorded = load(GOLDEN)
    for topic in (STATES, CLOCK, TAKEN):
        assert listener.on(topic) == [sent.data for sent in recorded.on(topic)]
    assert listener.on(NAMED) == listener.on(ARRAY) == []
    text = player.text()
    assert f'Not publishing 7 command topics: {WITHHELD}. Name them in --topics' in text
    assert 'Ignoring --clock: the log contains /clock' in text
    count = sum(len(recorded.on(topic)) for topic in kinds if topic not in WITHHELD)
    assert f'published {count} messages' in text


def test_named_commands_are_published_under_another_name(
    processes: Processes, peer_of: PeerOf
) -> None:
    peer = peer_of(processes)
    kind = kinds_of(GOLDEN)[NAMED]
    listener = Listener(peer, ('/other', kind), (NAMED, kind))
    player = start(
        processes,
        GOLDEN,
        *('--topics', NAMED, '--remap', f'{NAMED}:=/other', '--start-paused', '--rate', '5'),
    )
    player.wait_for_text('paused at')
    peer.wait(listener.ends[0].get_publisher_count)
    paused(peer, False)
    assert listener.end_of(player) == 0
    assert listener.on('/other') == [sent.data for sent in load(GOLDEN).on(NAMED)]
    assert listener.on(NAMED) == []


def test_a_paused_log_steps_seeks_and_resumes(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    peer = peer_of(processes)
    listener = Listener(peer, (MAP, STRING), latched=True)
    plain = Listener(peer, (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 6)
    player = start(processes, log, '--start-offset', '2', '--start-paused')
    begin(peer, player, plain)
    assert 'paused at 2.000 s' in player.text()
    # The map from before the offset comes first, though it is paused.
    listener.wait_for(MAP, 1)
    assert listener.on(MAP) == [encode_string('map 000')]
    assert step(peer) == (True, '/words at 2.000 s')
    assert step(peer) == (True, '/map at 3.000 s')
    plain.wait_for(WORDS, 1)
    assert plain.on(WORDS) == [word(2)]
    assert set_parameter(peer, 'seek_to', 0.5) == ''
    listener.wait_for(MAP, 3)
    assert listener.on(MAP) == [encode_string(f'map {k:03d}') for k in (0, 3, 0)]
    assert 'seek: jumped back from 3.000 s to 0.500 s' in player.text()
    assert step(peer) == (True, '/words at 1.000 s')
    for outside in (5.5, 1e300, -1e300, 2**62):
        assert 'outside of the log, expected 0 to 5 s' in set_parameter(peer, 'seek_to', outside)
    assert 'expected a number' in set_parameter(peer, 'seek_to', 'soon')
    assert set_parameter(peer, 'seek_to', 4) == ''
    assert 'rate is 0, expected' in set_parameter(peer, 'rate', 0)
    assert set_parameter(peer, 'rate', 100.0) == ''
    assert paused(peer, False).startswith('resumed at 4.')
    assert listener.end_of(player) == 0
    assert plain.on(WORDS) == [word(k) for k in (2, 1, 4, 5)]


def test_a_step_of_a_log_that_is_not_paused_is_refused(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    peer = peer_of(processes)
    player = start(processes, write_words(tmp_path / 'words.mcap', 200), '--duration', '100')
    player.wait_for_text('begin at')
    assert step(peer) == (False, 'refused: player is not paused: call ~/pause first')
    assert paused(peer, True).startswith('paused at')
    assert step(peer)[0]
    assert player.end(signal.SIGINT) == 128 + signal.SIGINT


def test_a_step_behind_the_last_message_says_that_it_is_the_end(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    peer = peer_of(processes)
    player = start(processes, write_words(tmp_path / 'a.mcap', 1, maps=()), '--start-paused')
    player.wait_for_text('paused at')
    assert step(peer) == (True, '/words at 0.000 s')
    assert step(peer) == (False, 'refused: end of the log reached')
    paused(peer, False)
    assert player.process.wait(60) == 0


def test_an_offset_a_duration_and_a_rate_choose_what_comes_and_how_fast(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    peer = peer_of(processes)
    listener = Listener(peer, (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 20, apart=0.1)
    player = start(
        processes,
        log,
        *('--start-offset', '0.5', '--duration', '0.8', '--rate', '0.5', '--start-paused'),
    )
    begin(peer, player, listener)
    begun = time.monotonic()
    paused(peer, False)
    assert listener.end_of(player) == 0
    assert listener.on(WORDS) == [word(k) for k in range(5, 13)]
    # Never faster than asked; how late a message is depends on the machine.
    assert time.monotonic() - begun >= 0.8 / 0.5


def test_a_clock_ticks_through_the_log_and_never_back(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    peer = peer_of(processes)
    listener = Listener(peer, (CLOCK, 'rosgraph_msgs/msg/Clock'), (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 11, apart=0.1)
    # Ticks that are due together are one: far more than are counted below.
    player = start(processes, log, '--clock', '1000', '--start-paused')
    begin(peer, player, listener)
    paused(peer, False)
    assert listener.end_of(player) == 0
    ticks = [decode_clock(data) for data in listener.on(CLOCK)]
    assert ticks == sorted(ticks)
    assert len(set(ticks)) > 50
    assert ticks[0] == SECOND
    assert ticks[-1] <= 2 * SECOND + 1
    assert len(listener.on(WORDS)) == 11


def test_a_loop_says_that_time_goes_back_and_a_signal_ends_it_with_status_0(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    peer = peer_of(processes)
    listener = Listener(peer, (WORDS, STRING))
    log = write_words(tmp_path / 'words.mcap', 4, apart=0.05)
    player = start(processes, log, '--loop', '--start-paused')
    begin(peer, player, listener)
    paused(peer, False)
    listener.wait_for(WORDS, 9)
    assert listener.on(WORDS)[:9] == [word(k % 4) for k in range(9)]
    assert 'loop 1: jumped back from 0.150 s to 0.000 s' in player.text()
    assert 'loop 2: jumped back' in player.text()
    assert player.end(signal.SIGTERM) == 0


@pytest.mark.parametrize('number', one_fast([signal.SIGINT, signal.SIGTERM]))
@pytest.mark.parametrize('options', [(), ('--start-paused',)])
def test_a_signal_before_the_end_has_the_status_of_a_shell(
    processes: Processes, tmp_path: Path, number: signal.Signals, options: tuple[str, ...]
) -> None:
    player = start(processes, write_words(tmp_path / 'words.mcap', 100), *options)
    player.wait_for_text(' at 0.000 s')
    assert player.end(number) == 128 + number
    assert 'published' in player.text()
    assert 'Traceback' not in player.text()


@pytest.mark.slow
@pytest.mark.long
def test_a_signal_at_any_moment_ends_the_player_cleanly(
    processes: Processes, tmp_path: Path
) -> None:
    # While modules are imported, the log is read, publishers are created, and later.
    log = write_words(tmp_path / 'words.mcap', 100)
    for k in range(8):
        player = processes.python(*PFD, 'replay', str(log), '--publish')
        wait_for_handlers(player)
        time.sleep(0.3 * k)
        assert player.end(signal.SIGTERM) == 128 + signal.SIGTERM, player.text()
        assert 'Traceback' not in player.text()


@pytest.mark.parametrize('error', one_fast([NotImplementedError, RecursionError, OverflowError]))
def test_an_error_of_the_player_itself_is_a_traceback_and_not_called_ros(
    processes: Processes, tmp_path: Path, error: type[Exception]
) -> None:
    log = write_words(tmp_path / 'words.mcap', 2)
    player = start(processes, log, PlayerSchedule_next_ns=partial(failing, error))
    assert player.process.wait(60) == 1
    assert 'Traceback' in player.text()
    assert f'{error.__name__}: a bug' in player.text()
    assert 'ROS:' not in player.text()


def test_a_callback_that_fails_ends_the_player(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    from std_srvs.srv import SetBool

    peer = peer_of(processes)
    log = write_words(tmp_path / 'words.mcap', 200)
    player = start(processes, log, PlayerSchedule_pause=partial(failing, KeyError))
    player.wait_for_text('begin at')
    client = peer.node.create_client(SetBool, '/log_player/pause')
    peer.wait(client.service_is_ready)
    client.call_async(SetBool.Request(data=True))
    peer.wait(lambda: player.process.poll() is not None)
    assert player.process.returncode == 1
    assert "KeyError: 'a bug'" in player.text()
    peer.node.destroy_client(client)


def test_a_request_that_rclpy_cannot_answer_does_not_end_the_player(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    peer = peer_of(processes)
    log = write_words(tmp_path / 'words.mcap', 200)
    player = start(processes, log)
    player.wait_for_text('begin at')
    client = peer.node.create_client(SetParameters, '/log_player/set_parameters')
    peer.wait(client.service_is_ready)
    unknown = Parameter(name='rate', value=ParameterValue(type=200))
    client.call_async(SetParameters.Request(parameters=[unknown]))
    player.wait_for_text('ROS: a request failed: ')
    assert set_parameter(peer, 'rate', 2.0) == ''
    peer.node.destroy_client(client)
    assert player.end(signal.SIGINT) == 128 + signal.SIGINT


@pytest.mark.slow
def test_an_output_that_is_closed_ends_the_player(processes: Processes, tmp_path: Path) -> None:
    log = write_words(tmp_path / 'words.mcap', 4, apart=0.05)
    command = [sys.executable, *PFD, 'replay', str(log), '--publish', '--loop']
    with subprocess.Popen(
        command,
        env=environment(processes.domain),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as player:
        assert player.stdout is not None
        assert player.stdout.readline().startswith(str(log))
        player.stdout.close()
        # As of a process that SIGPIPE ended, in a shell.
        assert player.wait(60) == 128 + signal.SIGPIPE
        assert player.stderr is not None
        assert player.stderr.read() == ''


@pytest.mark.slow
def test_a_terminal_shows_the_position_on_one_line(processes: Processes, tmp_path: Path) -> None:
    log = write_words(tmp_path / 'words.mcap', 5, apart=0.2)
    ours, theirs = pty.openpty()
    player = subprocess.Popen(
        [sys.executable, *PFD, 'replay', str(log), '--publish'],
        env=environment(processes.domain),
        stdout=theirs,
        stderr=theirs,
    )
    os.close(theirs)
    shown = b''
    try:
        # A terminal whose last process has ended raises an error in place of an end.
        while block := os.read(ours, 4096):
            shown += block
    except OSError:
        pass
    finally:
        assert player.wait(60) == 0
        os.close(ours)
    text = shown.decode()
    assert re.search(r'\r\x1b\[K0\.\d{3} s of 0\.800 s, rate 1\r\x1b\[K', text), text
    assert '\r\x1b[Kpublished 7 messages' in text


def test_a_type_that_is_not_installed_is_named_and_the_others_are_played(
    processes: Processes, peer_of: PeerOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = install_definition(tmp_path, monkeypatch)
    bag = Recording()
    for type_name, topic in ((kind, '/things'), (STRING, WORDS)):
        bag.channels.append(ros_topic(topic, type_name, DEFINITION))
        bag.messages += [Sent(topic, 0, SECOND + k, word(k)) for k in range(3)]
    path = bag.save(tmp_path / 'things.mcap')
    peer = peer_of(processes)
    listener = Listener(peer, (WORDS, STRING))
    player = start(processes, path, '--start-paused')
    begin(peer, player, listener)
    paused(peer, False)
    assert listener.end_of(player) == 0
    assert listener.on(WORDS) == [word(k) for k in range(3)]
    text = player.text()
    assert '3 messages of 1 topics' in text
    assert f'not published: /things: type {kind} is not installed' in text


def test_a_second_publisher_of_a_topic_is_reported(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    from std_msgs.msg import String

    peer = peer_of(processes)
    other = peer.node.create_publisher(String, WORDS, 1)
    log = write_words(tmp_path / 'words.mcap', 2, apart=0.01)
    player = start(processes, log, '--start-paused')
    player.wait_for_text('Another publisher on /words: stop it, or use --remap')
    paused(peer, False)
    assert player.process.wait(60) == 0
    assert player.text().count('Another publisher') == 1
    peer.node.destroy_publisher(other)


def test_messages_far_out_of_order_are_counted_at_the_end(
    processes: Processes, tmp_path: Path
) -> None:
    # One more than can wait lies before the last one in the file.
    messages = [Sent(WORDS, 0, at, word(0)) for at in (*range(1, 4099), 0)]
    bag = Recording(channels=[ros_topic(WORDS, STRING, DEFINITION)], messages=messages)
    path = bag.save(tmp_path / 'unordered.mcap')
    player = start(processes, path)
    assert player.process.wait(60) == 0
    line = '1 messages are out of order by more than 4096 messages or 16 MiB; published late'
    assert line in player.text()


def test_a_log_that_was_cut_off_is_published_up_to_the_cut(
    processes: Processes, peer_of: PeerOf, tmp_path: Path
) -> None:
    path = tmp_path / 'cut.mcap'
    data = GOLDEN.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    peer = peer_of(processes)
    listener = Listener(peer, (STATES, 'sensor_msgs/msg/JointState'))
    player = start(processes, path, '--rate', '2', '--start-paused')
    begin(peer, player, listener)
    paused(peer, False)
    assert listener.end_of(player) == 0
    assert 'the log was cut off' in player.text()
    readable = [m.data for m in Bag(path).messages() if m.topic == STATES]
    assert listener.on(STATES) == readable
    assert readable


@pytest.mark.parametrize(
    ('name', 'content', 'options', 'line'),
    [
        ('empty.mcap', b'', (), 'not an MCAP file'),
        ('text.mcap', b'certainly no log', (), 'not an MCAP file'),
        ('text.db3', b'certainly no log', (), 'text.db3'),
        ('damaged.mcap', None, (), 'damaged.mcap'),
        ('words.mcap', None, ('--topics', '/nix'), "has no topic ['/nix']"),
        ('words.mcap', None, ('--start-offset', '9'), 'start offset 9 s'),
        ('words.mcap', None, ('--remap', '/words:=/a b'), '--remap /words: Invalid topic name'),
        ('words.mcap', None, ('--loop', '--duration', '1e-6'), 'a loop over 1e-06 s'),
    ],
)
def test_a_log_that_cannot_be_published_is_one_line_and_status_1(
    tmp_path: Path,
    name: str,
    content: bytes | None,
    options: tuple[str, ...],
    line: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    elif name == 'damaged.mcap':
        data = GOLDEN.read_bytes()
        path.write_bytes(flipped(data, len(data) // 2))
    else:
        write_words(path, 3, maps=())
    with claimed_domain():
        assert pfd_main(['replay', str(path), '--publish', *options]) == 1
    (error,) = capfd.readouterr().err.splitlines()
    assert error.startswith('pfd replay: ')
    assert line in error


@pytest.mark.parametrize(
    ('options', 'line'),
    [
        (('--verify',), '--publish and --verify exclude each other'),
        (('--rate', '0'), "rate is '0', expected a number from 0.001 to 1000"),
        (('--rate', 'nan'), "rate is 'nan'"),
        (('--clock', '1e9'), "clock is '1e9'"),
        (('--start-offset', '-1'), "start offset is '-1'"),
        (('--duration', '0'), "duration is '0'"),
        (('--remap', 'a'), "'a' is not a remapping, expected A:=B"),
    ],
)
def test_options_that_make_no_sense_have_status_2(
    options: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        raise SystemExit(pfd_main(['replay', str(GOLDEN), '--publish', *options]))
    assert end.value.code == 2
    assert line in capsys.readouterr().err


@pytest.mark.parametrize('name', ['panda_exciting_trajectory', 'ur10_exciting_trajectory'])
def test_a_log_of_a_real_arm_comes_bit_for_bit(
    processes: Processes, peer_of: PeerOf, real_arms: Path, name: str
) -> None:
    peer = peer_of(processes)
    listener = Listener(peer, (STATES, 'sensor_msgs/msg/JointState'))
    player = start(processes, real_arms / name, '--rate', '10', '--start-paused')
    begin(peer, player, listener)
    paused(peer, False)
    assert listener.end_of(player) == 0, player.text()
    with rosbag2.Reader(real_arms / name) as reader:
        assert listener.on(STATES) == [bytes(data) for _, _, data in reader.messages()]
