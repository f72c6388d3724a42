# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parts of a URDF that no dynamics need: its `<ros2_control>` blocks and its mimic joints.

One file then configures both ends: the hardware of ros2_control that talks to the arm over topics,
and the arm. `pfd_core.load_robot` must have read the text before, which refuses document types and
bounds size and depth.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
import re
import xml.etree.ElementTree as ElementTree

from pfd_ros.arm.events import STATES, Source
from pfd_ros.arm.settings import Settings
from pfd_ros.text import cut, listed

# Hardware that talks over topics, and the values that its source code has for parameters that
# the URDF leaves out. Its documentation names another topic of commands.
TOPIC_HARDWARE = (
    'joint_state_topic_hardware_interface/JointStateTopicSystem',
    'topic_based_ros2_control/TopicBasedSystem',
)
CODE_DEFAULTS = {
    'joint_commands_topic': '/robot_joint_commands',
    'joint_states_topic': '/robot_joint_states',
    'trigger_joint_command_threshold': '1e-5',
}
NUMBER = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?', re.ASCII)
UNREAD = 'ros2_control:=false leaves the block unread'


@dataclass(frozen=True)
class Hardware:
    """The hardware of ros2_control that talks over topics.

    Attributes
    ----------
    commands_topic, states_topic
        Topics as the URDF names them.
    threshold
        It sends no commands that differ less from its states; negative: it sends all.
    """

    commands_topic: str
    states_topic: str
    threshold: float


@dataclass(frozen=True)
class Follower:
    """A joint that stands at multiplier * (position of `leader`) + offset, rad or m."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Description:
    """The contents of the `<ros2_control>` blocks, and the mimic joints.

    Attributes
    ----------
    hardware
        The hardware of the arm that talks over topics, if there is any.
    takes_effort
        The joints that have a command interface for effort.
    positions
        Joint -> initial value of its position, rad or m.
    followers
        Joint -> the joint that it mimics.
    ragged
        Command interfaces that only some joints of the hardware have: it sends an array for
        these, beside the names of all its joints.
    """

    hardware: Hardware | None = None
    takes_effort: frozenset[str] = frozenset()
    positions: Mapping[str, float] = field(default_factory=dict)
    followers: Mapping[str, Follower] = field(default_factory=dict)
    ragged: frozenset[str] = frozenset()

    @property
    def topics(self) -> dict[Source | str, str]:
        """The topics of the hardware, by the source or output of the arm at the other end."""
        if self.hardware is None:
            return {}
        return {Source.NAMED: self.hardware.commands_topic, STATES: self.hardware.states_topic}


def read_description(text: str, moving: Collection[str], *, ros2_control: bool) -> Description:
    """Return the description in a URDF.

    Parameters
    ----------
    text
        The URDF, as `load_robot` accepted it.
    moving
        The joints of the arm; hardware without any of them is that of another arm.
    ros2_control
        Whether to read the blocks of that name.

    Raises
    ------
    ValueError
        If a block breaks its format, or two of them disagree.
    """
    root = ElementTree.fromstring(text.strip())
    followers = dict(_followers(root))
    if not ros2_control:
        return Description(followers=followers)
    hardware: set[Hardware] = set()
    ragged: set[str] = set()
    takes_effort: set[str] = set()
    positions: dict[str, float] = {}
    for block in root.findall('ros2_control'):
        joints = {joint.get('name', ''): joint for joint in block.findall('joint')}
        if not joints.keys().isdisjoint(moving):
            found = set(_hardware(block))
            hardware |= found
            ragged |= _ragged(joints.values()) if found else set()
        for name, joint in joints.items():
            takes_effort.update({name} if 'effort' in _commanded(joint) else ())
            for position in _initial_positions(joint, name):
                if positions.setdefault(name, position) != position:
                    raise ValueError(
                        f'<ros2_control> has two initial values for joint {cut(name)!r}; {UNREAD}'
                    )
    if len(hardware) > 1:
        raise ValueError(
            f'two <ros2_control> blocks for joints of the arm have different topics; {UNREAD}'
        )
    one = next(iter(hardware), None)
    return Description(one, frozenset(takes_effort), positions, followers, frozenset(ragged))


def _commanded(joint: ElementTree.Element) -> set[str]:
    return {kind.get('name', '') for kind in joint.findall('command_interface')}


def _ragged(joints: Collection[ElementTree.Element]) -> set[str]:
    kinds = [_commanded(joint) for joint in joints]
    return {kind for one in kinds for kind in one if not all(kind in other for other in kinds)}


def _hardware(block: ElementTree.Element) -> Iterator[Hardware]:
    for element in block.findall('hardware'):
        given = {p.get('name', ''): (p.text or '').strip() for p in element.findall('param')}
        plugin = (element.findtext('plugin') or '').strip()
        if plugin in TOPIC_HARDWARE or not given.keys().isdisjoint(CODE_DEFAULTS):
            commands, states, threshold = ({**CODE_DEFAULTS, **given}[k] for k in CODE_DEFAULTS)
            yield Hardware(commands, states, _number('trigger_joint_command_threshold', threshold))


def _initial_positions(joint: ElementTree.Element, name: str) -> Iterator[float]:
    for interface in joint.findall('state_interface'):
        for param in interface.findall('param'):
            if (interface.get('name'), param.get('name')) == ('position', 'initial_value'):
                yield _number(f'initial_value of joint {cut(name)!r}', (param.text or '').strip())


def _number(label: str, text: str) -> float:
    if not NUMBER.fullmatch(text):
        raise ValueError(
            f'{label} in <ros2_control> is {cut(text)!r}, expected a number; {UNREAD}'
        )
    return float(text)


def _followers(root: ElementTree.Element) -> Iterator[tuple[str, Follower]]:
    for joint in root.findall('joint'):
        mimic = joint.find('mimic')
        if mimic is not None and joint.get('type') != 'fixed':
            numbers = (float(mimic.get('multiplier', '1')), float(mimic.get('offset', '0')))
            yield joint.get('name', ''), Follower(mimic.get('joint', ''), *numbers)


def with_initial_values(
    settings: Settings, moving: Collection[str], description: Description
) -> Settings:
    """Return settings whose positions are those of the description where none are given.

    Parameters
    ----------
    settings
        Those of the parameters.
    moving
        The joints of the arm, in the order of the model.
    description
        Of its URDF.
    """
    at = description.positions
    chosen: dict[str, tuple[float, ...]] = {}
    if not settings.initial_positions and not at.keys().isdisjoint(moving):
        order = settings.joints or moving
        chosen['initial_positions'] = tuple(at.get(name, 0.0) for name in order)
    if not settings.locked_positions and not at.keys().isdisjoint(settings.locked):
        chosen['locked_positions'] = tuple(at.get(name, 0.0) for name in settings.locked)
    return replace(settings, **chosen)  # type: ignore[arg-type]


def with_followers(settings: Settings, description: Description) -> Settings:
    """Return settings that lock the joints that mimic locked ones too, and so publish them."""
    at = settings.locks
    found = dict(at)
    while True:
        more = {
            name: rule.multiplier * found[rule.leader] + rule.offset
            for name, rule in description.followers.items()
            if name not in found and rule.leader in found
        }
        if not more:
            break
        found |= more
    if found == at:
        return settings
    return replace(settings, locked=tuple(found), locked_positions=tuple(found.values()))


def differences(settings: Settings, moving: Collection[str], description: Description) -> str:
    """Return in which positions given parameters and the description differ, '' if in none."""
    names = settings.joints or tuple(moving)
    given = dict(zip(names, settings.initial_positions, strict=False)) | settings.locks
    off = [
        name
        for name, position in description.positions.items()
        if given.get(name, position) != position
    ]
    if not off:
        return ''
    return f'<ros2_control> has other initial values for {listed(off)} than the parameters'


def ragged_trap(description: Description) -> str:
    """Return a warning about hardware whose messages are dropped, '' without any."""
    if not description.ragged:
        return ''
    return (
        f'only some joints of the hardware have the command interface '
        f'{listed(sorted(description.ragged))}: it sends arrays shorter than its names, and such '
        'messages are dropped; give all joints of the block the same command interfaces'
    )


def silence_trap(moving: Collection[str], description: Description) -> str:
    """Return a warning about hardware that falls silent at a steady effort, '' without any."""
    hardware = description.hardware
    if hardware is None or hardware.threshold < 0 or description.takes_effort.isdisjoint(moving):
        return ''
    return (
        f'trigger_joint_command_threshold is {hardware.threshold:g}: the hardware compares its '
        'commands with joint_states, whose effort is the command, and sends none while an effort '
        'is steady; set <param name="trigger_joint_command_threshold">-1</param> in <hardware>'
    )
