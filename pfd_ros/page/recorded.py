# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page needs of a log: joint states by publisher, and one time axis for all messages.

Several nodes may publish on one topic of joint states, an arm and its gripper for example. Joints
that come in the same messages are one `Joints`, with times and a period of their own.

In a recording of the node all times are simulated time. Elsewhere the time axis is that of the
stamps of the joint states. A message of another topic has its own stamp if that is of the same
clock, or else the stamp of the last state that was logged before it, plus the time since then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import ARRAY, INPUTS, NAMED, STATES
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS, JOINT_UNITS
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.arrays import LogArrays
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import cut, one_line

Array: TypeAlias = NDArray[Any]
# Stamps so close to those of the states are of the same clock [ns].
SAME_CLOCK = NANOSECONDS
# A first stamp before this time is a simulated one, and is shown as it is [ns].
LATEST_START = 10**6 * NANOSECONDS


@dataclass(frozen=True, eq=False)
class Joints:
    """N states of n joints that are published together.

    Attributes
    ----------
    time
        Times (N,) on the page [s], not decreasing.
    values
        Position, velocity and effort by name, (N, n), NaN where a message has none.
    bounds
        Lower and upper limits (2, n) by the same names, infinite without one; {} without a robot.
    period
        Expected time between states [s], 0 with fewer than two of them.
    """

    names: tuple[str, ...]
    time: Array = field(repr=False)
    values: Mapping[str, Array] = field(repr=False)
    bounds: Mapping[str, Array] = field(repr=False)
    period: float

    @cached_property
    def gaps(self) -> Array:
        """Places of the states before which states are missing."""
        late = np.diff(self.time) > (1.5 * self.period if self.period else np.inf)
        return np.flatnonzero(late) + 1


class Recorded:
    """A log, read with `unreadable='count'`, as a page needs it.

    Attributes
    ----------
    robot
        That of the log, or else the one that was given.
    topic
        The topic of the joint states, '' if none can be read.
    joints
        Its joints by publisher.
    unreadable, notes
        Lines on what cannot be read, and on what else a reader should know.
    """

    def __init__(self, log: LogArrays, robot: pfd.Robot | None = None) -> None:
        self.log, self.robot = log, log.robot or robot
        known = () if self.robot is None else self.robot.joint_names
        self._place = {name: k for k, name in enumerate(known)}
        self.settings: Mapping[str, Any] = log.settings or {}
        self.unreadable: dict[str, None] = {}
        self.notes: dict[str, None] = {}
        self._read = {topic: self._topic(topic) for topic in log}
        self.topic = self._states_topic()
        states = self._read.get(self.topic)
        self._axis_ns = np.empty(0, np.int64) if states is None else self._stamps_of(states)
        self._logged_ns = np.empty(0, np.int64) if states is None else states.log_ns
        every = [x.log_ns[0] for x in self._read.values() if x is not None]
        first = int(self._axis_ns[0] if states is not None else min(every, default=0))
        self.origin_ns = first if first > LATEST_START else 0
        self.joints = () if states is None else tuple(self._by_publisher(states))

    def _topic(self, topic: str) -> TopicArrays | None:
        """Return the messages of a topic, None without any; note what cannot be read."""
        obstacle = self.log.obstacle(topic)
        found = None if obstacle else self.log[topic]
        # A malformed input is in the log as it came, and was rejected.
        if found is not None and found.unreadable and self.log.roles.get(topic) not in INPUTS:
            lost = f'{found.unreadable} of {len(found) + found.unreadable}'
            obstacle = f'{lost} messages of {cut(topic)} cannot be read'
        if obstacle:
            self.unreadable[one_line(obstacle)] = None
        return found if found is not None and len(found) else None

    def of_role(self, role: str) -> TopicArrays | None:
        """Return the messages of a role in a recording of ours, None without any."""
        topics = (topic for topic, other in self.log.roles.items() if other == role)
        return self._read.get(next(topics, ''))

    def of_type(self, kind: str) -> Iterator[tuple[str, TopicArrays]]:
        """Yield the topics of a type that have messages."""
        for topic, found in self._read.items():
            if found is not None and self.log.topics[topic] == kind:
                yield topic, found

    def times(self, found: TopicArrays) -> Array:
        """Return the times (N,) of messages on the page [s], not decreasing."""
        axis, ns, stamps = self._axis_ns, found.simulated_ns, found.stamp_ns
        if ns is None and len(axis):
            # Numbers of Python: differences of times in hostile logs overflow.
            first, last = int(axis[0]) - SAME_CLOCK, int(axis[-1]) + SAME_CLOCK
            if stamps is not None and first <= int(stamps.min()) and int(stamps.max()) <= last:
                ns = stamps
            else:
                places = (np.searchsorted(self._logged_ns, found.log_ns, 'right') - 1).clip(0)
                after = np.append(axis[1:], np.iinfo(np.int64).max)[places]
                ns = np.minimum(axis[places] + found.log_ns - self._logged_ns[places], after)
        ns = found.log_ns if ns is None else ns
        times: Array = np.maximum.accumulate((ns - self.origin_ns) / NANOSECONDS)
        return times

    @cached_property
    def commanded(self) -> set[str]:
        """Joints for which a command was logged."""
        if self.of_role(ARRAY) is not None:
            return {name for joints in self.joints for name in joints.names}
        named = self.of_role(NAMED)
        if named is None:
            return set()
        there = [np.isfinite(getattr(named, item)).any(axis=0) for item in JOINT_FIELDS]
        return {named.names[j] for j in np.flatnonzero(np.any(there, axis=0))}

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the states [s]."""
        times = [joints.time[[0, -1]] for joints in self.joints]
        return (float(np.min(times)), float(np.max(times))) if times else (0.0, 0.0)

    def unit(self, item: str, names: tuple[str, ...]) -> str:
        """Return the unit of the position, velocity or effort of joints."""
        turns, slides = JOINT_UNITS[item]
        types = () if self.robot is None else self.robot.joint_types
        kinds = {types[self._place[name]] == 'prismatic' for name in names if name in self._place}
        return f'{turns} or {slides}' if len(kinds) != 1 else slides if kinds.pop() else turns

    def _states_topic(self) -> str:
        """Return the topic of joint states: by role, by name, or the one with most messages."""
        found = {topic: len(x) for topic, x in self.of_type(JOINT_STATE) if x.names}
        if not found:
            for topic, kind in self.log.topics.items():
                named = topic.endswith('joint_states') or 'JointState' in kind
                if named and kind != JOINT_STATE and len(self.log.received_ns[topic]):
                    text = f'{cut(topic)} has the type {cut(kind)}, expected {JOINT_STATE}'
                    self.unreadable[one_line(f'{text}: it cannot be read')] = None
        roles = self.log.roles
        rank = {
            t: (roles.get(t) == STATES, t.endswith('joint_states'), n) for t, n in found.items()
        }
        return max(found, key=lambda topic: rank[topic], default='')

    def _stamps_of(self, states: TopicArrays) -> Array:
        """Return the stamps of the states, or log times where stamps are no times, increasing."""
        stamps = states.stamp_ns
        assert stamps is not None  # a JointState has one
        # Those of several publishers are ahead of each other by their delays.
        back = np.diff(stamps).min(initial=0) < -SAME_CLOCK
        if len(stamps) > 1 and (back or stamps[-1] <= stamps[0]):
            text = f'the stamps of {cut(self.topic)} do not increase: times are log times'
            self.notes[text] = None
            return states.log_ns
        increasing: Array = np.maximum.accumulate(stamps)
        return increasing

    def _by_publisher(self, states: TopicArrays) -> Iterator[Joints]:
        """Yield the joints that are named in the same messages."""
        together: dict[tuple[bool, ...], list[int]] = {}
        for j, name in enumerate(states.names):
            together.setdefault(tuple(name in x for x in states.lists), []).append(j)
        for columns in together.values():
            rows: Any = states.rows(states.names[columns[0]])
            # A view of a long log takes no memory.
            whole = len(columns) == len(states.names) and len(rows) == len(states)
            rows, taken = (slice(None), slice(None)) if whole else (rows, columns)
            time = (self._axis_ns[rows] - self.origin_ns) / NANOSECONDS
            names = tuple(states.names[j] for j in columns)
            values = {item: getattr(states, item)[rows][:, taken] for item in JOINT_FIELDS}
            yield Joints(names, time, values, self._bounds(names), self._period(time))

    def _period(self, time: Array) -> float:
        if self.settings:
            rate = float(self.settings.get('publish_rate') or 0.0)
            return 1.0 / rate if rate else float(self.settings['step_size'])
        return float(np.median(np.diff(time))) if len(time) > 1 else 0.0

    def _bounds(self, names: tuple[str, ...]) -> dict[str, Array]:
        robot = self.robot
        if robot is None:
            return {}
        # Many models hold 0 for a limit that nobody knew.
        limits = robot.velocity_limit, robot.effort_limit
        speed, effort = (np.where(x > 0.0, x, np.inf) for x in limits)
        pairs = (robot.position_lower, robot.position_upper), (-speed, speed), (-effort, effort)
        # The last column is of joints that the robot lacks.
        places, none = [self._place.get(name, -1) for name in names], [[-np.inf], [np.inf]]
        return {
            item: np.concatenate([pair, none], axis=1)[:, places]
            for item, pair in zip(JOINT_FIELDS, pairs, strict=True)
        }
