# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page needs of a log: joint states by publisher, and one time axis for all messages.

Several nodes may publish on one topic of joint states, an arm and its gripper for example. Joints
that come in the same messages are one `Joints`, with times and a period of their own.

The time axis is that of the stamps of the joint states. A message of another topic has its own
stamp if that is of the same clock. Otherwise it has the stamp of the last state that was logged
before it; in logs of other programs plus the time since then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import ARRAY, INPUTS, JOINT_STATE, NAMED, STATES
from pfd_ros.messages.joints import JOINT_FIELDS, JOINT_UNITS, NANOSECONDS
from pfd_ros.recording.arrays import LogArrays, TopicArrays
from pfd_ros.recording.format import LogError
from pfd_ros.text import cut, one_line

Array: TypeAlias = NDArray[Any]
# Joints that come in the same share of their messages are taken for those of one publisher.
TOGETHER = 0.9
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
        late = np.diff(self.time) > 1.5 * self.period if self.period else []
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
        self.settings: Mapping[str, Any] = log.settings or {}
        self.topics = {role: topic for topic, role in log.roles.items() if topic in log}
        self.unreadable: dict[str, None] = {}
        self.notes: dict[str, None] = {}
        self._read: dict[str, TopicArrays | None] = {}
        self.topic = self._states_topic()
        states = self.read(self.topic)
        self._logged_ns, self._axis_ns = np.empty(0, np.int64), np.empty(0, np.int64)
        if states is not None and len(states):
            self._logged_ns = np.maximum.accumulate(states.log_ns)
            self._axis_ns = np.maximum.accumulate(self._stamps_of(states))
        every = [
            found.log_ns[0] for t in log if (found := self.read(t)) is not None and len(found)
        ]
        first = int(self._axis_ns[0] if len(self._axis_ns) else min(every, default=0))
        self.origin_ns = first if first > LATEST_START * NANOSECONDS else 0
        self.joints = () if states is None else tuple(self._by_publisher(states))

    def read(self, topic: str) -> TopicArrays | None:
        """Return the messages of a topic, None if there are none to read; notes what is lost."""
        if topic not in self.log:
            return None
        if topic not in self._read:
            found = None
            try:
                found = self.log[topic]
            except LogError as error:
                # Topics of other types, which no check looks at, are none of a page's business.
                if 'JointState' in self.log.topics[topic]:
                    self.unreadable[one_line(error)] = None
            # A malformed input is in the log as it came, and was rejected.
            ours = self.log.roles.get(topic) in INPUTS
            if found is not None and len(found) < found.recorded and not ours:
                lost = f'{found.recorded - len(found)} of {found.recorded}'
                text = f'{lost} messages of {cut(topic)} cannot be read'
                self.unreadable[one_line(text)] = None
            self._read[topic] = found
        return self._read[topic]

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
        axis, logged = self._axis_ns, self._logged_ns
        if not len(axis):
            return (found.log_ns - self.origin_ns) / NANOSECONDS
        stamps, margin = found.stamp_ns, int(SAME_CLOCK * NANOSECONDS)
        if (
            stamps is None
            or not len(stamps)
            or stamps.min() < axis[0] - margin
            or stamps.max() > axis[-1] + margin
        ):
            places = np.searchsorted(logged, found.log_ns, side='left') - 1
            after = np.append(axis[1:], np.iinfo(np.int64).max)
            stamps = axis[places.clip(0)]
            if not self.settings:
                since = found.log_ns - logged[places.clip(0)]
                stamps = np.minimum(stamps + since, after[places.clip(0)])
        times: Array = np.maximum.accumulate((stamps - self.origin_ns) / NANOSECONDS)
        return times

    @cached_property
    def commanded(self) -> set[str]:
        """Joints for which a command was logged."""
        found: set[str] = set()
        named, array = self.of_role(NAMED), self.of_role(ARRAY)
        if named is not None:
            there = [np.isfinite(getattr(named, item)).any(axis=0) for item in JOINT_FIELDS]
            found.update(
                n for n, any_ in zip(named.names, np.any(there, axis=0), strict=True) if any_
            )
        if array is not None:
            found.update(name for joints in self.joints for name in joints.names)
        return found

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the states [s]."""
        times = [joints.time[[0, -1]] for joints in self.joints]
        return (float(np.min(times)), float(np.max(times))) if times else (0.0, 0.0)

    def _states_topic(self) -> str:
        """Return the topic of joint states: by role, by name, or the one with most messages."""
        if STATES in self.topics:
            return self.topics[STATES]
        kinds = {t: self.log.topics[t] for t in self.log if 'JointState' in self.log.topics[t]}
        found = {t: found for t in kinds if (found := self.read(t)) and kinds[t] == JOINT_STATE}
        return max(found, key=lambda t: (t.endswith('joint_states'), len(found[t])), default='')

    def _stamps_of(self, states: TopicArrays) -> Array:
        """Return the stamps of the states, or log times where stamps are no times."""
        stamps = states.stamp_ns
        assert stamps is not None  # a JointState has one
        steps = np.diff(stamps)
        # Those of several publishers are ahead of each other by their delays.
        if len(stamps) == 1 or (
            stamps[-1] > stamps[0] and steps.min() > -SAME_CLOCK * NANOSECONDS
        ):
            return stamps
        self.notes[f'the stamps of {cut(self.topic)} do not increase: times are log times'] = None
        return states.log_ns

    def _by_publisher(self, states: TopicArrays) -> Iterator[Joints]:
        values = {item: getattr(states, item) for item in JOINT_FIELDS}
        there = ~np.all([np.isnan(x) for x in values.values()], axis=0)
        left = [int(j) for j in np.flatnonzero(there.any(axis=0))]
        while left:
            same = (there[:, left] == there[:, left[:1]]).mean(axis=0) > TOGETHER
            columns = [j for j, with_first in zip(left, same, strict=True) if with_first]
            left = [j for j in left if j not in columns]
            rows = there[:, columns].any(axis=1)
            time = (self._axis_ns[rows] - self.origin_ns) / NANOSECONDS
            names = tuple(states.names[j] for j in columns)
            yield Joints(
                names,
                time,
                {item: x[rows][:, columns] for item, x in values.items()},
                self._bounds(names),
                {item: self.unit(item, names) for item in JOINT_FIELDS},
                self._period(time),
            )

    def _period(self, time: Array) -> float:
        rate = float(self.settings.get('publish_rate') or 0.0)
        step = float(self.settings.get('step_size') or 0.0)
        if step:
            return 1.0 / rate if rate else step
        return float(np.median(np.diff(time))) if len(time) > 1 else 0.0

    def _places(self, names: tuple[str, ...]) -> list[int]:
        known = [] if self.robot is None else list(self.robot.joint_names)
        return [known.index(name) if name in known else -1 for name in names]

    def _bounds(self, names: tuple[str, ...]) -> dict[str, Array]:
        if self.robot is None:
            return {}
        robot = self.robot
        # Many models hold 0 for a limit that nobody knew.
        speed, effort = (
            np.where(x > 0.0, x, np.inf) for x in (robot.velocity_limit, robot.effort_limit)
        )
        pairs = (robot.position_lower, robot.position_upper), (-speed, speed), (-effort, effort)
        none = np.array([[-np.inf], [np.inf]])
        return {
            item: np.concatenate([np.array(pair), none], axis=1)[:, self._places(names)]
            for item, pair in zip(JOINT_FIELDS, pairs, strict=True)
        }

    def unit(self, item: str, names: tuple[str, ...]) -> str:
        """Return the unit of the position, velocity or effort of joints."""
        turns, slides = JOINT_UNITS[item]
        places = [k for k in self._places(names) if k >= 0]
        kinds = {
            self.robot is not None and self.robot.joint_types[k] == 'prismatic' for k in places
        }
        return f'{turns} or {slides}' if len(kinds) != 1 else slides if kinds.pop() else turns
