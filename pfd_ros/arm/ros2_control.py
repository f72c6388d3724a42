# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The `<ros2_control>` blocks and the mimic joints of a URDF, as settings of the arm.

One file then configures both ends: the hardware of ros2_control that talks to the arm over topics,
and the arm.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
import re
import xml.etree.ElementTree as ElementTree

import pfd_core as pfd
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
# Elements of a joint with an initial value of its position.
INITIAL_POSITION = "state_interface[@name='position']/param[@name='initial_value']"
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
class Ros2Control:
    """The contents of the `<ros2_control>` blocks.

    Attributes
    ----------
    hardware
        The hardware of the arm that talks over topics, if there is any.
    takes_effort
        The joints that have a command interface for effort.
    positions
        Joint -> initial value of its position, rad or m.
    ragged
        Command interfaces that only some joints of the hardware have. Its messages then have the
        names of all joints and shorter arrays.
    """

    hardware: Hardware | None = None
    takes_effort: frozenset[str] = frozenset()
    positions: Mapping[str, float] = field(default_factory=dict)
    ragged: frozenset[str] = frozenset()

    @property
    def topics(self) -> dict[Source | str, str]:
        """The topics of the hardware, by the source or output of the arm at the other end."""
        if self.hardware is None:
            return {}
        return {Source.NAMED: self.hardware.commands_topic, STATES: self.hardware.states_topic}


def read_ros2_control(urdf: pfd.Urdf, moving: Collection[str]) -> Ros2Control:
    """Return the contents of the blocks of a URDF.

    Parameters
    ----------
    urdf
        The URDF.
    moving
        The joints of the arm; hardware without any of them belongs to another arm.

    Raises
    ------
    ValueError
        If a block breaks its format, or two of them disagree.
    """
    hardware: set[Hardware] = set()
    ragged: set[str] = set()
    takes_effort: set[str] = set()
    positions: dict[str, float] = {}
    for block in ElementTree.fromstring(urdf.text.strip()).findall('ros2_control'):
        # Where two joints have one name, the last one counts.
        joints = {joint.get('name', ''): joint for joint in block.findall('joint')}
        commands = {
            name: {kind.get('name', '') for kind in joint.findall('command_interface')}
            for name, joint in joints.items()
        }
        if not joints.keys().isdisjoint(moving):
            found = set(filter(None, map(_hardware, block.findall('hardware'))))
            hardware |= found
            if found:
                kinds = list(commands.values())
                ragged |= set().union(*kinds) - kinds[0].intersection(*kinds)
        for name, joint in joints.items():
            takes_effort.update({name} if 'effort' in commands[name] else ())
            for value in joint.findall(INITIAL_POSITION):
                position = _number(f'initial_value of joint {cut(name)!r}', _text(value))
                if positions.setdefault(name, position) != position:
                    raise ValueError(
                        f'<ros2_control> has two initial values for joint {cut(name)!r}; {UNREAD}'
                    )
    if len(hardware) > 1:
        raise ValueError(
            f'two <ros2_control> blocks for joints of the arm have different topics; {UNREAD}'
        )
    one = next(iter(hardware), None)
    return Ros2Control(one, frozenset(takes_effort), positions, frozenset(ragged))


def _text(element: ElementTree.Element | None) -> str:
    return ((element is not None and element.text) or '').strip()


def _hardware(element: ElementTree.Element) -> Hardware | None:
    """Return hardware that talks over topics, None for other hardware."""
    plugin = _text(element.find('plugin'))
    given = {param.get('name', ''): _text(param) for param in element.findall('param')}
    if plugin not in TOPIC_HARDWARE and given.keys().isdisjoint(CODE_DEFAULTS):
        return None
    commands, states, threshold = ({**CODE_DEFAULTS, **given}[key] for key in CODE_DEFAULTS)
    return Hardware(commands, states, _number('trigger_joint_command_threshold', threshold))


def _number(label: str, text: str) -> float:
    if not NUMBER.fullmatch(text):
        raise ValueError(
            f'{label} in <ros2_control> is {cut(text)!r}, expected a number; {UNREAD}'
        )
    return float(text)


def with_initial_values(
    settings: Settings, moving: Collection[str], control: Ros2Control
) -> Settings:
    """Return settings with the positions of the blocks where none are given.

    Parameters
    ----------
    settings
        Settings from the parameters.
    moving
        The joints of the arm, in the order of the model.
    control
        The blocks of its URDF.
    """
    at = control.positions
    chosen: dict[str, tuple[float, ...]] = {}
    if not settings.initial_positions and not at.keys().isdisjoint(moving):
        order = settings.joints or moving
        chosen['initial_positions'] = tuple(at.get(name, 0.0) for name in order)
    if not settings.locked_positions and not at.keys().isdisjoint(settings.locked):
        chosen['locked_positions'] = tuple(at.get(name, 0.0) for name in settings.locked)
    return replace(settings, **chosen)  # type: ignore[arg-type]


def with_followers(settings: Settings, urdf: pfd.Urdf) -> Settings:
    """Return settings that lock the joints that mimic locked ones too, and so publish them."""
    found = urdf.with_followers(settings.locks)
    if found == settings.locks:
        return settings
    return replace(settings, locked=tuple(found), locked_positions=tuple(found.values()))


def differences(settings: Settings, moving: Collection[str], control: Ros2Control) -> str:
    """Return in which positions given parameters and the blocks differ, '' if in none."""
    names = settings.joints or tuple(moving)
    given = dict(zip(names, settings.initial_positions, strict=False)) | settings.locks
    off = [
        name
        for name, position in control.positions.items()
        if given.get(name, position) != position
    ]
    if not off:
        return ''
    return (
        f'initial positions of {listed(off)} differ between <ros2_control> and the parameters: '
        'the parameters are used'
    )


def ragged_trap(control: Ros2Control) -> str:
    """Return a warning about hardware whose messages are dropped, '' without any."""
    if not control.ragged:
        return ''
    return (
        f'only some joints of the hardware have the command interface '
        f'{listed(sorted(control.ragged))}: it sends arrays shorter than its names, and such '
        'messages are dropped; give all joints of the block the same command interfaces'
    )


def silence_trap(moving: Collection[str], control: Ros2Control) -> str:
    """Return a warning about hardware that falls silent at a steady effort, '' without any."""
    hardware = control.hardware
    if hardware is None or hardware.threshold < 0 or control.takes_effort.isdisjoint(moving):
        return ''
    return (
        f'trigger_joint_command_threshold is {hardware.threshold:g}: the hardware compares its '
        'commands with joint_states, whose effort is the command, and sends none while an effort '
        'is steady; set <param name="trigger_joint_command_threshold">-1</param> in <hardware>'
    )
