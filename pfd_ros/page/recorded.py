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
# Publishers of joint states that are shown.
MOST_PUBLISHERS = 8
# Stamps so close to those of the states are of the same clock [s].
SAME_CLOCK = 1.0
# A first stamp before this time is a simulated one, and is shown as it is [s].
LATEST_START = 1e6


@dataclass(frozen=True, eq=False)
class Joints:
    """N states of n joints that are published together.

    Attributes
    ----------
    names
        The joints.
    time
        Times (N,) on the page [s], not decreasing.
    values
        Position, velocity and effort by name, (N, n), NaN where a message has none.
    bounds
        Lower and upper limits (2, n) by the same names; infinite without one.
    units
        Units by the same names.
    period
        Expected time between states [s], 0 with fewer than two of them.
    """

    names: tuple[str, ...]
    time: Array = field(repr=False)
    values: Mapping[str, Array] = field(repr=False)
    bounds: Mapping[str, Array] = field(repr=False)
    units: Mapping[str, str]
    period: float

    @cached_property
    def gaps(self) -> Array:
        """Places of the states before which states are missing."""
        late = np.diff(self.time) > (1.5 * self.period if self.period else np.inf)
        return np.flatnonzero(late) + 1


class Recorded:
    """A log as a page needs it.

    Parameters
    ----------
    log
        The log, read with `unreadable='count'`.
    robot
        The robot of a log that holds none.

    Attributes
    ----------
    topic
        The topic of the joint states, '' if none can be read.
    joints
        Its joints by publisher.
    unreadable, notes
        Lines on topics that cannot be read, and on what else a reader should know.
    """

    def __init__(self, log: LogArrays, robot: pfd.Robot | None = None) -> None:
        self.log, self.robot = log, log.robot or robot
        known = () if self.robot is None else self.robot.joint_names
        self._place = {name: k for k, name in enumerate(known)}
        self.settings: Mapping[str, Any] = log.settings or {}
        self.topics = {role: topic for topic, role in log.roles.items() if topic in log}
        self.unreadable: dict[str, None] = {}
        self.notes: dict[str, None] = {}
        self.topic = self._states_topic()
        states = self.read(self.topic)
        self._logged_ns, self._axis_ns = np.empty(0, np.int64), np.empty(0, np.int64)
        if states is not None and len(states):
            self._logged_ns = states.log_ns
            self._axis_ns = np.maximum.accumulate(self._stamps_of(states))
        else:
            self._note_other_types()
        every = [x.log_ns[0] for t in log if (x := self.read(t)) is not None and len(x)]
        first = int(self._axis_ns[0] if len(self._axis_ns) else min(every, default=0))
        self.origin_ns = first if first > LATEST_START * NANOSECONDS else 0
        self.joints = () if states is None else tuple(self._by_publisher(states))

    def read(self, topic: str) -> TopicArrays | None:
        """Return the messages of a topic, None if it cannot be read; note what is lost."""
        if topic not in self.log:
            return None
        obstacle = self.log.obstacle(topic)
        if obstacle:
            self.unreadable[one_line(obstacle)] = None
            return None
        found = self.log[topic]
        # A malformed input is in the log as it came, and was rejected.
        if found.unreadable and self.log.roles.get(topic) not in INPUTS:
            lost = f'{found.unreadable} of {len(found) + found.unreadable}'
            self.unreadable[one_line(f'{lost} messages of {cut(topic)} cannot be read')] = None
        return found

    def of_role(self, role: str) -> TopicArrays | None:
        """Return the messages of a role in a recording of ours, None without any."""
        found = self.read(self.topics.get(role, ''))
        return found if found is not None and len(found) else None

    def of_type(self, kind: str) -> Iterator[tuple[str, TopicArrays]]:
        """Yield the topics of a type that have messages."""
        for topic in self.log:
            if self.log.topics[topic] == kind:
                found = self.read(topic)
                if found is not None and len(found):
                    yield topic, found

    def times(self, found: TopicArrays) -> Array:
        """Return the times (N,) of messages on the page [s], not decreasing."""
        axis, logged, ns = self._axis_ns, self._logged_ns, found.simulated_ns
        if ns is None and len(axis):
            stamps, margin = found.stamp_ns, int(SAME_CLOCK * NANOSECONDS)
            places = (np.searchsorted(logged, found.log_ns, side='right') - 1).clip(0)
            # Numbers of Python: differences of times in hostile logs overflow.
            first, last = int(axis[0]), int(axis[-1])
            if (
                stamps is not None
                and int(stamps.min(initial=first)) >= first - margin
                and int(stamps.max(initial=last)) <= last + margin
            ):
                ns = stamps
            else:
                after = np.append(axis[1:], np.iinfo(np.int64).max)[places]
                since = found.log_ns - logged[places]
                ns = np.minimum(axis[places] + since, after)
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

    def _states_topic(self) -> str:
        """Return the topic of joint states: by role, by name, or the one with most messages."""
        if STATES in self.topics:
            return self.topics[STATES]
        found = {topic: len(x) for topic, x in self.of_type(JOINT_STATE) if x.names}
        return max(found, key=lambda t: (t.endswith('joint_states'), found[t]), default='')

    def _note_other_types(self) -> None:
        """Note joint states of other types in a log that has none to read."""
        for topic, kind in self.log.topics.items():
            named = topic.endswith('joint_states') or 'JointState' in kind
            if named and kind != JOINT_STATE and len(self.log.received_ns[topic]):
                text = f'{cut(topic)} has the type {cut(kind)}, expected {JOINT_STATE}'
                self.unreadable[one_line(f'{text}: it cannot be read')] = None

    def _stamps_of(self, states: TopicArrays) -> Array:
        """Return the stamps of the states, or log times where stamps are no times."""
        stamps = states.stamp_ns
        assert stamps is not None  # a JointState has one
        # Those of several publishers are ahead of each other by their delays.
        back = np.diff(stamps).min(initial=0) < -SAME_CLOCK * NANOSECONDS
        if len(stamps) == 1 or (stamps[-1] > stamps[0] and not back):
            return stamps
        self.notes[f'the stamps of {cut(self.topic)} do not increase: times are log times'] = None
        return states.log_ns

    def _by_publisher(self, states: TopicArrays) -> Iterator[Joints]:
        """Yield the joints that are named in the same messages."""
        together: dict[tuple[bool, ...], list[int]] = {}
        for j, name in enumerate(states.names):
            together.setdefault(tuple(name in x for x in states.lists), []).append(j)
        for columns in list(together.values())[:MOST_PUBLISHERS]:
            rows: Any = states.rows(states.names[columns[0]])
            # A view of a long log takes no memory.
            whole = len(columns) == len(states.names) and len(rows) == len(states)
            rows, taken = (slice(None), slice(None)) if whole else (rows, columns)
            time = (self._axis_ns[rows] - self.origin_ns) / NANOSECONDS
            names = tuple(states.names[j] for j in columns)
            yield Joints(
                names,
                time,
                {item: getattr(states, item)[rows][:, taken] for item in JOINT_FIELDS},
                self._bounds(names),
                {item: self.unit(item, names) for item in JOINT_FIELDS},
                self._period(time),
            )
        if len(together) > MOST_PUBLISHERS:
            self.notes[
                f'{len(together)} publishers of joint states: {MOST_PUBLISHERS} are shown'
            ] = None

    def _period(self, time: Array) -> float:
        rate = float(self.settings.get('publish_rate') or 0.0)
        step = float(self.settings.get('step_size') or 0.0)
        if step:
            return 1.0 / rate if rate else step
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

    def unit(self, item: str, names: tuple[str, ...]) -> str:
        """Return the unit of the position, velocity or effort of joints."""
        turns, slides = JOINT_UNITS[item]
        types = () if self.robot is None else self.robot.joint_types
        kinds = {types[self._place[name]] == 'prismatic' for name in names if name in self._place}
        return f'{turns} or {slides}' if len(kinds) != 1 else slides if kinds.pop() else turns
