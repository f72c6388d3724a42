# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The published part of a log: topics, names, QoS, window of time; commands are withheld.

A recorded command must not reach a real arm by accident. In a recording of the node the commands
are the topics of its inputs. In every log a topic is also a command if its last name is the name
of an input of the node, if its name contains a word of COMMAND_PARTS or COMMAND_WORDS, or if its
type is one of COMMAND_TYPES. Outputs of the node under their own names are not commands. A topic
named by the caller is published.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
import re

from pfd_ros.arm.events import TAKEN
from pfd_ros.arm.settings import OUTPUTS
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.messages.definitions import full_text, parse_definition
from pfd_ros.messages.old_qos import Qos, offered_qos
from pfd_ros.recording.bags import Bag, BagTopic
from pfd_ros.recording.format import (
    CHANNELS,
    FOLLOWED,
    MESSAGE_ENCODING,
    OF_SERVICES,
    SOURCE_OF_ROLE,
)
from pfd_ros.recording.reader import damage_named
from pfd_ros.replay.log_order import Survey
from pfd_ros.replay.schedule import Window
from pfd_ros.text import cut, listed

CLOCK_TOPIC = '/clock'
# Last names of the topics that the node `sim_arm` subscribes to, but for the clock.
INPUT_NAMES = frozenset(
    CHANNELS[role].topic.rpartition('/')[2]
    for role in SOURCE_OF_ROLE.keys() - OF_SERVICES - {FOLLOWED}
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
_TYPE = re.compile(r'[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*')
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+')


@dataclass(frozen=True)
class Played:
    """A topic of the log and the topic it is published on."""

    name: str
    published: str
    type: str
    qos: Qos


@dataclass(frozen=True)
class Choice:
    """The topics that are published, by name in the log, and lines about the others."""

    topics: Mapping[str, Played]
    notes: tuple[str, ...]


def choose(
    bag: Bag, wanted: Collection[str] | None = None, remaps: Sequence[tuple[str, str]] = ()
) -> Choice:
    """Return the topics to publish of a bag that was read.

    Parameters
    ----------
    bag
        Its topics are known.
    wanted
        Topics to publish, also commands; default all but commands.
    remaps
        A topic of the log and the name under which it is published.

    Raises
    ------
    ValueError
        If a topic is not in the log, is remapped twice or on a topic of another type, or nothing
        is left.
    """
    known = sorted(bag.topics)
    missing = sorted({*(wanted or ()), *(name for name, _ in remaps)} - set(known))
    if missing:
        raise ValueError(f'{bag.path} has no topic {listed(missing)}; topics are {listed(known)}')
    names = dict(remaps)
    if len(names) < len(remaps):
        raise ValueError(f'a topic is remapped twice: {listed([name for name, _ in remaps])}')
    with damage_named(bag.path):
        roles = bag.roles
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
        chosen[name] = Played(name, names.get(name, name), topic.type, _qos(topic, notes))
    if withheld:
        notes.append(
            f'Not publishing {len(withheld)} command topics: {listed(withheld)}. Name them in '
            '--topics to publish them'
        )
    if not chosen:
        raise ValueError(f'{bag.path} has nothing to publish: {"; ".join(notes) or "no topics"}')
    kinds: dict[str, str] = {}
    for played in chosen.values():
        if kinds.setdefault(played.published, played.type) != played.type:
            raise ValueError(
                f'{cut(played.name)!r} has type {played.type}, but {cut(played.published)!r} '
                f'has type {kinds[played.published]}'
            )
    return Choice(chosen, tuple(notes))


def window_of(
    bag: Bag, found: Survey, choice: Choice, start_offset: float, duration: float
) -> Window:
    """Return the log times from an offset [s] on; ValueError if there is nothing to play."""
    if not sum(found.counts[name] for name in choice.topics):
        raise ValueError(f'{bag.path} has no messages of the topics to publish')
    length = (found.last_ns - found.first_ns) / NANOSECONDS
    if start_offset > length:
        raise ValueError(f'start offset {start_offset:g} s: {bag.path} lasts {length:g} s')
    begin = min(found.first_ns + round(start_offset * NANOSECONDS), found.last_ns)
    end = found.last_ns + 1
    if duration < length:
        end = min(end, begin + max(1, round(duration * NANOSECONDS)))
    return Window(found.first_ns, begin, end)


def is_command(topic: BagTopic, role: str = '') -> bool:
    """Return whether a topic holds commands, by its role in a recording of ours or by its name."""
    if role in SOURCE_OF_ROLE:
        return role != FOLLOWED or topic.type != CHANNELS[FOLLOWED].type
    if role == TAKEN and topic.type == CHANNELS[TAKEN].type:
        return False
    folder, _, last = topic.name.rpartition('/')
    # Outputs of the node are called `bias_torques`; under another name, the name decides.
    own = role == last and role in OUTPUTS and topic.type == OUTPUTS[role].type
    words = {word.lower() for word in _WORD.findall(folder if own else topic.name)}
    return (
        last in INPUT_NAMES
        or topic.type in COMMAND_TYPES
        or not words.isdisjoint(COMMAND_WORDS)
        or any(part in topic.name.lower() for part in COMMAND_PARTS)
    )


def obstacle_of(topic: BagTopic) -> str:
    """Return why the messages of a topic cannot be published here, '' if they can."""
    if topic.encoding != MESSAGE_ENCODING:
        return f'its messages are encoded as {cut(topic.encoding)!r}, not {MESSAGE_ENCODING!r}'
    if not _TYPE.fullmatch(topic.type):
        return f'{cut(topic.type)!r} is not a message type'
    missing = f'type {cut(topic.type)} is not installed'
    try:
        installed = full_text(topic.type)
        # A definition may be known without the package that publishes it; ValueError if a module
        # of this name has no specification.
        if find_spec(topic.type.partition('/')[0]) is None:
            return missing
    except ValueError:
        return missing
    if not topic.definition or topic.definition == installed:
        return ''
    try:
        same = parse_definition(topic.type, topic.definition) == parse_definition(
            topic.type, installed
        )
    except ValueError as error:
        return f'type {cut(topic.type)} cannot be compared with the installed one: {error}'
    return '' if same else f'type {cut(topic.type)} has other fields than the installed one'


def _qos(topic: BagTopic, notes: list[str]) -> Qos:
    """Return the recorded QoS, or the QoS for the name."""
    default = KNOWN_QOS.get(topic.name.rpartition('/')[2], Qos())
    try:
        return offered_qos(topic.qos) or default
    except ValueError as error:
        notes.append(f'{cut(topic.name)} is published with the default QoS: {error}')
        return default
