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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
import math
from typing import Any, TypeAlias
import warnings

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.description import parsed_urdf
from pfd_ros.arm.events import ARRAY, NAMED, REJECTED, STATES, TRAJECTORY, TRUE_STATES
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS, unit_of
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.arrays import LogArrays
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import cut, listed, one_line

Array: TypeAlias = NDArray[Any]
# Stamps so close to those of the states are of the same clock [ns].
SAME_CLOCK = NANOSECONDS
PLURALS = dict(zip(JOINT_FIELDS, ('positions', 'velocities', 'efforts'), strict=True))
# The value of `state_effort` with which efforts are those that the motors limit.
COMMAND = 'command'
# A first stamp before this time is a simulated one, and is shown as it is [ns].
LATEST_START = 10**6 * NANOSECONDS


def _chain(text: str) -> pfd.Robot:
    """Return the robot of a URDF; of a tree its longest chain."""
    urdf = parsed_urdf(text, 'it')
    try:
        return pfd.load_robot(urdf)
    except pfd.TreeError as error:
        return pfd.load_robot(urdf, tip=error.tip)


@dataclass(frozen=True, eq=False)
class Joints:
    """N states of n joints that are published together."""

    names: tuple[str, ...]
    time: Array = field(repr=False)  # (N,) on the page [s], not decreasing
    # Of position, velocity, effort: (N, n), NaN where a message has none, and limits (2, n).
    values: Mapping[str, Array] = field(repr=False)
    bounds: Mapping[str, Array] = field(repr=False)
    period: float  # expected [s], 0 with fewer than two states

    @cached_property
    def gaps(self) -> Array:
        """Places of the states before which states are missing."""
        late = np.diff(self.time) > (1.5 * self.period if self.period else np.inf)
        return np.flatnonzero(late) + 1


class Recorded:
    """A log, read with `unreadable='count'`, as a page needs it.

    `topic` is that of the joint states, if it is chosen; LogError if it has none.
    """

    def __init__(
        self, log: LogArrays, robot: pfd.Robot | None = None, topic: str | None = None
    ) -> None:
        if robot is not None and log.robot is not None:
            held = cut(repr(log.robot.name))
            raise ValueError(f'{log.path}: it holds its robot, {held}; robot is for other logs')
        self.log, self.robot = log, log.robot or robot
        self.settings: Mapping[str, Any] = log.settings or {}
        # Lines on what cannot be read, and on what else a reader should know.
        self.unreadable: dict[str, None] = dict.fromkeys(log.lost(log))
        self.notes: dict[str, None] = {}
        self.of_role, found = log.of_role, log.of_type()
        if log.settings is None and self.robot is None:
            self.robot = self._described()
        # The topic of the joint states, '' if none can be read.
        self.topic = self._states_topic() if topic is None else topic
        if topic is not None:
            log.required(topic, JOINT_STATE)
        states = found.get(self.topic)
        self._axis_ns = self._logged_ns = np.empty(0, np.int64)
        if states is not None:
            self._axis_ns, self._logged_ns = self._stamps_of(states), states.log_ns
        logged = ((x.log_ns, x.simulated_ns) for x in found.values())
        every = [int((log if ns is None else ns)[0]) for log, ns in logged]
        first = int(self._axis_ns[0] if states is not None else min(every, default=0))
        self.origin_ns = first if first > LATEST_START else 0
        self.joints = () if states is None else tuple(self._by_publisher(states))
        self.names = tuple(name for joints in self.joints for name in joints.names)
        self.notes |= dict.fromkeys(self._without_limits())
        # Efforts that have limits, where those of the states are torques with gravity or currents.
        self.drives: tuple[Joints, ...] = ()
        if self.settings.get('state_effort', COMMAND) != COMMAND:
            self.drives = tuple(self._commanded_efforts())

    def accepted(self, role: str) -> Array:
        """Return which messages of an input were not rejected, (N,) bool.

        A rejection follows its message in the file.
        """
        found, rejected = self.of_role(role), self.of_role(REJECTED)
        after = None if rejected is None else rejected.place
        if found is None or found.place is None or after is None:
            return np.ones(0 if found is None else len(found), bool)
        return ~np.isin(found.place + 1, after)

    def accepted_times(self, role: str, words: Sequence[str] = ('',)) -> Array:
        """Return the times of accepted messages [s], (N,); of texts with one of the words."""
        found = self.of_role(role)
        if found is None:
            return np.empty(0)
        chosen = self.accepted(role)
        if any(words):
            chosen = chosen & [any(word in str(text) for word in words) for text in found.data]
        times: Array = self.times(found)[chosen]
        return times

    def _on_axis(self, found: TopicArrays) -> bool:
        """Return whether messages have stamps of the clock of the states."""
        axis, stamps = self._axis_ns, found.stamp_ns
        if stamps is None or not len(axis):
            return False
        # Numbers of Python: differences of times in hostile logs overflow.
        first, last = int(axis[0]) - SAME_CLOCK, int(axis[-1]) + SAME_CLOCK
        return first <= int(stamps.min()) and int(stamps.max()) <= last

    def times(self, found: TopicArrays) -> Array:
        """Return the times (N,) of messages on the page [s], not decreasing."""
        axis, ns = self._axis_ns, found.simulated_ns
        if ns is None and len(axis):
            ns = found.stamp_ns if self._on_axis(found) else None
            if ns is None:
                places = (np.searchsorted(self._logged_ns, found.log_ns, 'right') - 1).clip(0)
                after = np.append(axis[1:], np.iinfo(np.int64).max)[places]
                ns = np.minimum(axis[places] + found.log_ns - self._logged_ns[places], after)
        ns = found.log_ns if ns is None else ns
        times: Array = np.maximum.accumulate((ns - self.origin_ns) / NANOSECONDS)
        return times

    def intended(self, found: TopicArrays) -> Array:
        """Return the times of the states that messages answer, by their stamps, if they have some.

        A command in a recording is there in the cycle that took it, which is after its state.
        """
        stamps = found.stamp_ns
        if stamps is None or not int(stamps.min()) > 0 or not self._on_axis(found):
            return self.times(found)
        times: Array = np.maximum.accumulate((stamps - self.origin_ns) / NANOSECONDS)
        return times

    @cached_property
    def command_period(self) -> float:
        """Median time between two commands of efforts or positions [s], NaN without three."""
        times = np.unique(np.concatenate([self.accepted_times(role) for role in (NAMED, ARRAY)]))
        return float(np.median(np.diff(times))) if len(times) > 2 else math.nan

    @cached_property
    def commanded(self) -> set[str]:
        """Joints for which a command was logged, and not rejected."""
        named, planned = self.of_role(NAMED), self.of_role(TRAJECTORY)
        if self.accepted(ARRAY).any():
            return set(self.names)
        found = set[str]()
        if planned is not None:
            found = {*planned.joint_names[self.accepted(TRAJECTORY)].ravel()} - {''}
        if named is None:
            return found
        values = np.array([getattr(named, item) for item in JOINT_FIELDS])
        there = np.isfinite(values[:, self.accepted(NAMED)]).any(axis=(0, 1))
        return found | {named.names[j] for j in np.flatnonzero(there)}

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the states [s]."""
        times = [time for joints in self.joints for time in joints.time[[0, -1]]]
        return (float(min(times)), float(max(times))) if times else (0.0, 0.0)

    def unit(self, item: str, names: tuple[str, ...]) -> str:
        """Return the unit of the position, velocity or effort of joints."""
        return unit_of(item, self.robot, names)

    def states_unit(self, item: str, names: tuple[str, ...]) -> str:
        """Return the unit in the states of the log, whose efforts may be currents."""
        currents = self.settings.get('state_effort') == 'current'
        return 'A' if item == 'effort' and currents else self.unit(item, names)

    def _states_topic(self) -> str:
        """Return the topic of joint states: by role in ours, by name, or with most messages."""
        read, roles = self.log.of_type(JOINT_STATE).items(), self.log.roles
        found = {t: len(x) for t, x in read if x.names and roles.get(t, STATES) == STATES}
        if not found:
            for topic, kind in self.log.topics.items():
                named = topic.endswith('joint_states') or 'JointState' in kind
                if named and kind != JOINT_STATE and len(self.log.received_ns[topic]):
                    text = f'{cut(topic)} has the type {cut(kind)}, expected {JOINT_STATE}'
                    self.unreadable[one_line(f'{text}: it cannot be read')] = None

        def rank(topic: str) -> tuple[bool, int]:
            return topic.endswith('joint_states'), found[topic]

        chosen = max(found, key=rank, default='')
        others = [x for x in found if x != chosen and rank(x)[0] == rank(chosen)[0]]
        if others:
            text = f'joint states are those of {cut(chosen)}, not of {listed(others)}'
            self.notes[one_line(f'{text}; --topic names another')] = None
        return chosen

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
        commanded = self.settings.get('state_effort', COMMAND) == COMMAND
        bounds = self._bounds(states.names, commanded=commanded)
        together: dict[tuple[bool, ...], list[int]] = {}
        for j, name in enumerate(states.names):
            together.setdefault(tuple(name in x for x in states.lists), []).append(j)
        for columns in together.values():
            rows: Any = states.rows(states.names[columns[0]])
            # A view of a long log takes no memory.
            whole = len(columns) == len(states.names) and len(rows) == len(states)
            rows, taken = (slice(None), slice(None)) if whole else (rows, columns)
            time = (self._axis_ns[rows] - self.origin_ns) / NANOSECONDS
            yield Joints(
                tuple(states.names[j] for j in columns),
                time,
                {item: getattr(states, item)[rows][:, taken] for item in JOINT_FIELDS},
                {item: pair[:, taken] for item, pair in bounds.items()},
                self._period(time),
            )

    def _described(self) -> pfd.Robot | None:
        """Return the robot of the one URDF in a log of another arm; note why there is none."""
        topics, why = self.log.descriptions(), 'no robot_description'
        if len(topics) == 1:
            (text,) = topics
            with warnings.catch_warnings():
                warnings.simplefilter('ignore')  # others than of limits
                try:
                    return _chain(text)
                except ValueError as error:
                    why = f'that on {cut(topics[text])} cannot be used: {error}'
        elif topics:
            why = f'{len(topics)} robots on {listed([*topics.values()])}'
        if self.log.of_type(JOINT_STATE):
            self.notes[one_line(f'limits are not checked, {why}; --robot names a robot')] = None
        return None

    def _without_limits(self) -> Iterator[str]:
        """Yield lines on the joints and numbers of a log whose limits are not checked."""
        robot = self.robot
        others = [name for name in self.names if robot and name not in robot.joint_names]
        if robot and others and self.log.robot is None:
            known = f'joints of {cut(robot.name)} are {listed(robot.joint_names)}'
            yield one_line(f'no limits of {listed(others)}: {known}')
        for joints in self.joints:
            for item, plural in PLURALS.items():
                limited = np.isfinite(joints.bounds[item]).any(axis=0)
                without = np.isnan(joints.values[item]).all(axis=0) & limited
                if without.any():
                    names = [joints.names[j] for j in np.flatnonzero(without)]
                    yield one_line(f'no {plural} of {listed(names)}: their limits are not checked')

    def _commanded_efforts(self) -> Iterator[Joints]:
        """Yield the efforts of the motors, from true_states; note if a recording has none."""
        found = self.of_role(TRUE_STATES)
        if found is None:
            text = 'efforts of the states are torques with gravity or currents: limits of efforts '
            self.notes[f'{text}are not checked; outputs:=[true_states] records what has them'] = (
                None
            )
            return
        values, bounds = {'effort': found.effort}, self._bounds(found.names, commanded=True)
        time = self.times(found)
        yield Joints(found.names, time, values, {'effort': bounds['effort']}, self._period(time))

    def _period(self, time: Array) -> float:
        if self.settings:
            rate = float(self.settings.get('publish_rate') or 0.0)
            return 1.0 / rate if rate else float(self.settings['step_size'])
        return float(np.median(np.diff(time))) if len(time) > 1 else 0.0

    def _bounds(self, names: tuple[str, ...], *, commanded: bool) -> dict[str, Array]:
        """Return the limits (2, n) of joints; infinite for those that the robot lacks.

        Efforts that are not as commanded have none.
        """
        bounds = {item: np.tile([[-np.inf], [np.inf]], len(names)) for item in JOINT_FIELDS}
        robot = self.robot
        if robot is not None:
            speed, effort = robot.velocity_limit, robot.effort_limit
            effort = effort if commanded else np.full_like(effort, np.inf)
            pairs = (robot.position_lower, robot.position_upper), (-speed, speed)
            known = {name: k for k, name in enumerate(robot.joint_names)}
            columns = [j for j, name in enumerate(names) if name in known]
            places = [known[names[j]] for j in columns]
            for item, pair in zip(JOINT_FIELDS, (*pairs, (-effort, effort)), strict=True):
                bounds[item][:, columns] = np.array(pair)[:, places]
        return bounds
