# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot that settings name, and what its URDF adds to them: `<ros2_control>`, mimic joints.

One file then configures both ends: the hardware of ros2_control that talks to the arm over topics,
and the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
import re
from typing import Any, NamedTuple
import xml.etree.ElementTree as ElementTree

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION, NAMED, STATES
from pfd_ros.arm.frames import LinkFrames
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.text import cut, listed

# Hardware that talks over topics, and the values that its source code has for parameters that
# the URDF leaves out. Its documentation names another topic of commands.
TOPIC_HARDWARE = (
    'joint_state_topic_hardware_interface/JointStateTopicSystem',
    'topic_based_ros2_control/TopicBasedSystem',
)
# The hardware sends no commands that differ less from its states; below zero it sends all.
THRESHOLD = 'trigger_joint_command_threshold'
CODE_DEFAULTS = {
    'joint_commands_topic': '/robot_joint_commands',
    'joint_states_topic': '/robot_joint_states',
    THRESHOLD: '1e-5',
}
NUMBER = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?', re.ASCII)
# Elements of a joint with an initial value of its position.
INITIAL_POSITION = "state_interface[@name='position']/param[@name='initial_value']"
UNREAD = 'ros2_control:=false leaves the block unread'


class Ros2Control(NamedTuple):
    """What the `<ros2_control>` blocks of a URDF configure."""

    # Role -> topic at which hardware that talks over topics has its other end.
    topics: Mapping[str, str] = {}
    # Joint -> initial value of its position, rad or m.
    positions: Mapping[str, float] = {}
    # Why its hardware will lose commands, or stop.
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class DescribedRobot:
    """A robot, and what its URDF configures.

    Attributes
    ----------
    robot
        As `load_robot` returns it.
    settings
        Those given, with initial values and followers of its URDF.
    urdf
        The URDF; None for a robot from another file.
    topics
        Role -> topic of its `<ros2_control>` blocks, if they are to be read.
    taken, warnings
        Lines about settings from these blocks, and about what is wrong with them.
    """

    robot: pfd.Robot
    settings: Settings
    urdf: pfd.Urdf | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    taken: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The URDF to publish: as it was read, or written of the robot."""
        return pfd.robot_to_urdf(self.robot) if self.urdf is None else self.urdf.text

    def recorded_frames(
        self, settings: Settings, report: Callable[[str], None]
    ) -> LinkFrames | None:
        """Return what makes the arm visible in a recording; None if the settings name no file.

        None also, with a line to `report`, for a robot that cannot be written as URDF.
        """
        if not settings.recording:
            return None
        try:
            return link_frames(self.text, settings, self.robot)
        except ValueError as error:
            report(f'no robot_description and no /tf in the recording: {error}')
            return None


def parsed_urdf(text: str, label: str) -> pfd.Urdf:
    """Return the model of a URDF's text; ValueError, with the label, for another text."""
    # Other text would be taken for the name of a robot or a file.
    urdf = pfd.read_urdf(text) if text.lstrip().startswith('<') else None
    if urdf is None:
        raise ValueError(f'{label} is not a URDF: it starts with {cut(text[:20])!r}')
    return urdf


def link_frames(text: str, settings: Settings, robot: pfd.Robot) -> LinkFrames:
    """Return the frames of a URDF for an arm; ValueError if the text is not a URDF of a tree."""
    urdf = parsed_urdf(text, DESCRIPTION)
    return LinkFrames(urdf, robot.joint_names, settings.locks, settings.tf_every)


def described_robot(settings: Settings, source: str | pfd.Urdf) -> DescribedRobot:
    """Return the robot of a source: a name, a path, the text of a URDF, or a URDF.

    Given positions have precedence over those of its blocks. ValueError if it cannot be loaded,
    or a block breaks a rule.
    """
    xacro = xacro_arguments(settings.xacro_args)
    urdf = source if isinstance(source, pfd.Urdf) else pfd.read_urdf(source, xacro)
    if urdf is not None and urdf.tip is not None and not settings.tip_link:
        # The text that is published and recorded does not state it.
        settings = replace(settings, tip_link=urdf.tip)
    if urdf is None:
        return with_start(
            DescribedRobot(load_robot(settings, source), with_locks(settings, source))
        )
    robot = load_robot(settings, urdf)
    filled, control = with_locks(settings, urdf), Ros2Control()
    if settings.ros2_control:
        at_rest = filled.locked if settings.publish_locked else ()
        control = read_ros2_control(urdf, robot.joint_names, at_rest)
    at, names = control.positions, settings.joints or robot.joint_names
    start = default_start(robot)
    chosen: dict[str, Any] = {}
    if not settings.initial_positions and not at.keys().isdisjoint(names):
        chosen['initial_positions'] = tuple(at.get(x, start.get(x, 0.0)) for x in names)
    if not settings.locked_positions:
        # Joints that mimic locked ones follow them, unless their own names are given.
        stated = {
            name: at[name]
            for name in filled.locked
            if name in at and (name in settings.locked or urdf.joints[name].mimic is None)
        }
        if stated:
            filled = with_locks(settings, urdf, stated)
            robot = load_robot(filled, urdf)
            chosen['locked_positions'] = tuple(stated.values())
    taken = tuple(f'{name} from <ros2_control>: {list(chosen[name])}' for name in chosen)
    filled = replace(filled, **chosen | {'locked_positions': filled.locked_positions})
    given = {**dict(zip(names, filled.initial_positions, strict=False)), **filled.locks}
    off = [name for name, position in at.items() if given.get(name, position) != position]
    warnings = control.warnings
    if off:
        warnings += (
            f'initial positions of {listed(off)} differ between <ros2_control> and the '
            'parameters: the parameters are used',
        )
    return with_start(DescribedRobot(robot, filled, urdf, control.topics, taken, warnings))


def with_start(found: DescribedRobot) -> DescribedRobot:
    """Fill in where the joints start, if nothing says so and 0 lies outside the model's limits.

    Here and not in the arm, so that a recording names the start, and an older one keeps its own.
    """
    settings, start = found.settings, default_start(found.robot)
    names = settings.joints or found.robot.joint_names
    if settings.initial_positions or not any(start.values()) or sorted(names) != sorted(start):
        return found
    at = tuple(start[name] for name in names)
    moved = ', '.join(f'{name} at {x:.6g}' for name, x in start.items() if x)
    line = f'initial_positions: {moved}, the middle of the limits, which exclude 0'
    return replace(
        found, settings=replace(settings, initial_positions=at), taken=(*found.taken, line)
    )


def default_start(robot: pfd.Robot) -> dict[str, float]:
    """Return where each joint of a robot starts by default, by name."""
    return dict(zip(robot.joint_names, pfd.start_positions(robot).tolist(), strict=True))


def xacro_arguments(words: Sequence[str]) -> dict[str, str]:
    """Return the arguments of a .xacro file in name:=value; ValueError for other words."""
    for word in words:
        if not word.partition(':=')[1]:
            raise ValueError(
                f'{cut(word)!r} is no argument of a .xacro file, expected name:=value'
            )
    return {name: value for name, _, value in (word.partition(':=') for word in words)}


def with_locks(
    settings: Settings, source: str | pfd.Urdf, stated: Mapping[str, float] | None = None
) -> Settings:
    """Return settings that name each locked joint, with its position; `stated` has precedence.

    Among them are those that match a pattern, that mimic locked ones, and that do not move the
    tip: all of them are published.
    """
    locks = pfd.locked_joints(
        source,
        base=settings.base_link or None,
        tip=settings.tip_link or None,
        locked={**settings.locks, **(stated or {})},
    )
    return replace(settings, locked=tuple(locks), locked_positions=tuple(locks.values()))


def load_robot(settings: Settings, source: str | pfd.Urdf) -> pfd.Robot:
    """Return the robot of a source with the ends and the locked joints that the settings name.

    ValueError if it cannot be loaded; for a tree it says which parameter makes it a chain.
    """
    try:
        return pfd.load_robot(
            source,
            base=settings.base_link or None,
            tip=settings.tip_link or None,
            locked=settings.locks or None,
        )
    except pfd.TreeError as error:
        names, positions = [*settings.locked, *error.patterns], settings.locked_positions
        if positions:
            names = [*settings.locked, *error.joints]
            positions = (*positions, *error.positions.values())
        written = f"-p tip_link:={error.tip}, or -p 'locked:=[{','.join(names)}]'"
        if positions:
            written += f" -p 'locked_positions:=[{','.join(map(str, positions))}]'"
        cures = f'of a test: tip_link={error.tip!r}; of the node: write {written}'
        raise ValueError(f'{error}; {cures}') from error


def read_ros2_control(
    urdf: pfd.Urdf, moving: Collection[str], locked: Collection[str] = ()
) -> Ros2Control:
    """Return the contents of the blocks of a URDF; ValueError if they break their format.

    `moving` are the joints of the arm; hardware without any of them belongs to another arm. The
    states have these joints, and `locked` ones.
    """
    hardware: set[tuple[str, str, float]] = set()
    ragged, takes_effort, lacking = set[str](), False, dict[str, None]()
    positions: dict[str, float] = {}
    for block in ElementTree.fromstring(urdf.text.strip()).findall('ros2_control'):
        # Where two joints have one name, the last one counts.
        joints = {joint.get('name', ''): joint for joint in block.findall('joint')}
        commands = {
            name: {kind.get('name', '') for kind in joint.findall('command_interface')}
            for name, joint in joints.items()
        }
        takes_effort |= any('effort' in commands[name] for name in joints if name in moving)
        if not joints.keys().isdisjoint(moving):
            found = set(filter(None, map(_hardware, block.findall('hardware'))))
            hardware |= found
            if found:
                kinds = list(commands.values())
                ragged |= set().union(*kinds) - kinds[0].intersection(*kinds)
                # It sets all numbers of the states, but for joints that mimic others.
                lacking |= dict.fromkeys(
                    f'{kind} of {name}'
                    for name, joint in joints.items()
                    for kind in JOINT_FIELDS
                    if (name in moving or (name in locked and urdf.joints[name].mimic is None))
                    and joint.find(f"state_interface[@name='{kind}']") is None
                )
        for name, joint in joints.items():
            for value in joint.findall(INITIAL_POSITION):
                position = _number(f'initial_value of joint {cut(name)!r}', _text(value))
                if positions.setdefault(name, position) != position:
                    raise ValueError(
                        f'<ros2_control> has two initial values for joint {cut(name)!r}; {UNREAD}'
                    )
    if not hardware:
        return Ros2Control({}, positions)
    if len(hardware) > 1:
        raise ValueError(
            f'two <ros2_control> blocks for joints of the arm have different topics; {UNREAD}'
        )
    ((commands_topic, states_topic, threshold),) = hardware
    warnings = []
    if threshold >= 0 and takes_effort:
        warnings.append(
            f'trigger_joint_command_threshold is {threshold:g}: the hardware compares its '
            'commands with joint_states, whose effort is the command, and sends none while an '
            f'effort is steady; set <param name="{THRESHOLD}">-1</param> in <hardware>'
        )
    if ragged:
        warnings.append(
            f'only some joints of the hardware have the command interface '
            f'{listed(sorted(ragged))}: it sends arrays shorter than its names, and such '
            'messages are dropped; give all joints of the block the same command interfaces'
        )
    if lacking:
        warnings.append(
            f'the hardware has no state interface for the {listed(lacking)} in joint_states: '
            'joint_state_topic_hardware_interface stops with an error at the first state; give '
            'each joint of the block the state interfaces position, velocity and effort'
        )
    topics = {NAMED: commands_topic, STATES: states_topic}
    return Ros2Control(topics, positions, tuple(warnings))


def _text(element: ElementTree.Element | None) -> str:
    return ((element is not None and element.text) or '').strip()


def _hardware(element: ElementTree.Element) -> tuple[str, str, float] | None:
    """Return topics and threshold of hardware that talks over topics, None for other hardware."""
    plugin = _text(element.find('plugin'))
    given = {param.get('name', ''): _text(param) for param in element.findall('param')}
    if plugin not in TOPIC_HARDWARE and given.keys().isdisjoint(CODE_DEFAULTS):
        return None
    commands, states, threshold = ({**CODE_DEFAULTS, **given}[key] for key in CODE_DEFAULTS)
    return commands, states, _number(THRESHOLD, threshold)


def _number(label: str, text: str) -> float:
    if not NUMBER.fullmatch(text):
        raise ValueError(
            f'{label} in <ros2_control> is {cut(text)!r}, expected a number; {UNREAD}'
        )
    return float(text)
