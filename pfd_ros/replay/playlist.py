# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What of a log is published: topics, their names and QoS, a window of time; no commands.

The log is read once before anything is sent, so that damage is found first. Its time 0 is that of
the first message that is not transient local; those before it are sent at once.

A recorded command must not reach a real arm by accident. In a recording of the node the commands
are the topics of its inputs. In every log a topic is also a command if its last name is the name
of an input of the node, if its name contains a word of COMMAND_PARTS or COMMAND_WORDS, or if its
type is one of COMMAND_TYPES. Outputs of the node under their own names are not commands. A topic
named by the caller is published.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np

from pfd_ros.arm.events import CLOCK_TICKS, INPUTS, ROLES
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.columns import known_types, store_of, type_hash
from pfd_ros.messages.qos import Qos, offered_qos
from pfd_ros.messages.topics import message_class
from pfd_ros.recording.arrays import roles_of
from pfd_ros.recording.bags import Bag, BagTopic
from pfd_ros.recording.format import MESSAGE_ENCODING
from pfd_ros.replay.schedule import Window
from pfd_ros.text import cut, listed

CLOCK = '/clock'
# A longer gap of the log is reported; a Clock has 31 bits for the seconds.
GAP_NS, CLOCK_NS = 10 * NANOSECONDS, (1 << 31) * NANOSECONDS
# Last names of the topics that the node `sim_arm` subscribes to, but for the clock.
INPUT_NAMES = frozenset(
    ROLES[role].topic.rpartition('/')[2]
    for role in INPUTS
    if role != CLOCK_TICKS and not ROLES[role].service
)
COMMAND_PARTS = ('command', 'cmd', 'setpoint')
COMMAND_WORDS = frozenset(
    {
        *('desired', 'equilibrium', 'goal', 'jog', 'move', 'reference', 'references', 'script'),
        *('effort', 'efforts', 'set', 'target', 'targets', 'torque', 'torques'),
    }
)
COMMAND_TYPES = frozenset(
    {
        'ackermann_msgs/msg/AckermannDrive',
        'ackermann_msgs/msg/AckermannDriveStamped',
        'control_msgs/msg/GripperCommand',
        'control_msgs/msg/JointJog',
        'control_msgs/msg/MultiDOFCommand',
        'geometry_msgs/msg/Twist',
        'geometry_msgs/msg/TwistStamped',
        'trajectory_msgs/msg/JointTrajectory',
        'trajectory_msgs/msg/MultiDOFJointTrajectory',
    }
)
# QoS by the last name of a topic, where the log has none; others are reliable with depth 10.
KNOWN_QOS = {
    'clock': Qos(depth=1),
    'diagnostics': Qos(depth=1),
    'robot_description': Qos(depth=1, transient_local=True),
    'tf_static': Qos(depth=1, transient_local=True),
}
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+')


@dataclass(frozen=True)
class PlayOptions:
    """The options of the player; times in s from the time 0 of the log."""

    rate: float = 1.0
    loop: bool = False
    start_offset: float = 0.0
    duration: float = math.inf
    topics: Collection[str] | None = None
    remaps: Sequence[tuple[str, str]] = ()
    clock_hz: float | None = None
    start_paused: bool = False


class Played(NamedTuple):
    """What a topic of the log is published as."""

    published: str
    type: str
    qos: Qos


class Playlist(NamedTuple):
    """The published part of a log, and lines that its user has to know.

    `tick_ns` is the period of a clock, None without one. In the file a message is up to `late_ns`
    earlier than one before it.
    """

    bag: Bag
    topics: dict[str, Played]
    window: Window
    tick_ns: int | None
    late_ns: int
    lines: list[str]


def playlist(path: Path, options: PlayOptions, stopped: Callable[[], bool]) -> Playlist | None:
    """Read a log and return what of it is published; None if it was stopped.

    ValueError if nothing is to be published, or a topic or time is not in the log.
    """
    bag = Bag(path)
    times: dict[str, array[int]] = {}
    latest = late_ns = 0
    for message in bag.messages():
        if stopped():
            return None
        if message.log_ns >= 1 << 63:
            raise ValueError(f'{path}, topic {cut(message.topic)!r}: log time {message.log_ns} ns')
        times.setdefault(message.topic, array('q')).append(message.log_ns)
        latest = max(latest, message.log_ns)
        late_ns = max(late_ns, latest - message.log_ns)
    topics, lines = choose(bag, roles_of(bag), options.topics, options.remaps)
    times = {name: times[name] for name in topics if name in times}
    if not times:
        raise ValueError(f'{path} has no messages of the topics to publish')
    timed = [min(x) for name, x in times.items() if not topics[name].qos.transient_local]
    ordered = np.sort(np.concatenate([np.array(x, np.int64) for x in times.values()]))
    ordered = ordered[ordered >= min(timed, default=0)]
    first_ns, last_ns = int(ordered[0]), int(ordered[-1])
    length, count = (last_ns - first_ns) / NANOSECONDS, sum(map(len, times.values()))
    if options.start_offset > length:
        raise ValueError(f'start offset {options.start_offset:g} s: {path} lasts {length:g} s')
    begin_ns = min(first_ns + round(options.start_offset * NANOSECONDS), last_ns)
    end_ns = last_ns + 1
    if options.duration < length:
        end_ns = min(end_ns, begin_ns + max(1, round(options.duration * NANOSECONDS)))
    lines.insert(0, f'{path}: {length:.3f} s, {count} messages of {len(topics)} topics')
    if not bag.complete:
        lines.append('the log was cut off; it is published up to the cut')
    gaps = np.diff(ordered)
    if len(gaps) and gaps.max() > GAP_NS:
        at = (ordered[gaps.argmax()] - first_ns) / NANOSECONDS
        lines.append(f'longest gap of the log: {gaps.max() / NANOSECONDS:.3f} s after {at:.3f} s')
    tick_ns = None
    if options.clock_hz is not None:
        if any(topic.published == CLOCK for topic in topics.values()):
            lines.append(f'Ignoring --clock: the log contains {CLOCK}')
        elif end_ns > CLOCK_NS:
            raise ValueError(f'log times up to {end_ns} ns exceed the range of {CLOCK}')
        else:
            tick_ns = round(NANOSECONDS / options.clock_hz)
    return Playlist(bag, topics, Window(first_ns, begin_ns, end_ns), tick_ns, late_ns, lines)


def choose(
    bag: Bag,
    roles: Mapping[str, str],
    wanted: Collection[str] | None = None,
    remaps: Sequence[tuple[str, str]] = (),
) -> tuple[dict[str, Played], list[str]]:
    """Return the topics to publish of a bag that was read, and lines about the others.

    `roles` are those of its topics in a recording of ours. `wanted` may name commands; by default
    all but commands are published. ValueError if a topic is not in the log, is remapped twice or
    on a topic of another type, or nothing is left.
    """
    known = sorted(bag.topics)
    missing = sorted({*(wanted or ()), *(name for name, _ in remaps)} - set(known))
    if missing:
        raise ValueError(f'{bag.path} has no topic {listed(missing)}; topics are {listed(known)}')
    names = dict(remaps)
    if len(names) < len(remaps):
        raise ValueError(f'a topic is remapped twice: {listed([name for name, _ in remaps])}')
    chosen: dict[str, Played] = {}
    notes, withheld = [], []
    for name, topic in sorted(bag.topics.items()):
        if wanted is not None and name not in wanted:
            continue
        if wanted is None and is_command(topic, roles.get(name, '')):
            withheld.append(name)
            continue
        obstacle = obstacle_of(topic)
        if obstacle:
            notes.append(f'not published: {cut(name)}: {obstacle}')
            continue
        chosen[name] = Played(names.get(name, name), topic.type, _qos(topic, notes))
    if withheld:
        notes.append(
            f'Not publishing {len(withheld)} command topics: {listed(withheld)}. Name them in '
            '--topics to publish them'
        )
    if not chosen:
        raise ValueError(f'{bag.path} has nothing to publish: {"; ".join(notes) or "no topics"}')
    kinds: dict[str, str] = {}
    for name, played in chosen.items():
        if kinds.setdefault(played.published, played.type) != played.type:
            raise ValueError(
                f'{cut(name)!r} has type {played.type}, but {cut(played.published)!r} '
                f'has type {kinds[played.published]}'
            )
    return chosen, notes


def is_command(topic: BagTopic, role: str = '') -> bool:
    """Return whether a topic holds commands, by its role in a recording of ours or by its name."""
    if role in INPUTS:
        return role != CLOCK_TICKS or topic.type != ROLES[CLOCK_TICKS].type
    folder, _, last = topic.name.rpartition('/')
    # Outputs of the node are called `bias_torques`; under another name, the name decides.
    own = role == last and role in ROLES and topic.type == ROLES[role].type
    words = {word.lower() for word in _WORD.findall(folder if own else topic.name)}
    return (
        last in INPUT_NAMES
        or topic.type in COMMAND_TYPES
        or not words.isdisjoint(COMMAND_WORDS)
        or any(part in topic.name.lower() for part in COMMAND_PARTS)
    )


def obstacle_of(topic: BagTopic) -> str:
    """Return why the messages of a topic cannot be published here, '' if they can."""
    if topic.other:
        return f'it has messages of {cut(topic.type)!r} and of {cut(topic.other)!r}'
    if topic.encoding != MESSAGE_ENCODING:
        return f'its messages are encoded as {cut(topic.encoding)!r}, not {MESSAGE_ENCODING!r}'
    if not re.fullmatch(r'[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*', topic.type):
        return f'{cut(topic.type)!r} is not a message type'
    try:
        message_class(topic.type)
    except (ImportError, AttributeError):
        return f'type {cut(topic.type)} is not installed'
    if not topic.definition or topic.type not in known_types().fielddefs:
        return ''
    try:
        found = store_of(topic.type, topic.definition).hash_rihs01(topic.type)
    except ValueError as error:
        return str(error)
    if found != type_hash(topic.type):
        return f'its type {cut(topic.type)} has other fields than the installed one'
    return ''


def _qos(topic: BagTopic, notes: list[str]) -> Qos:
    """Return the recorded QoS, or the QoS for the name."""
    default = KNOWN_QOS.get(topic.name.rpartition('/')[2], Qos())
    try:
        return offered_qos(topic.qos) or default
    except ValueError as error:
        notes.append(f'{cut(topic.name)} is published with the default QoS: {error}')
        return default
