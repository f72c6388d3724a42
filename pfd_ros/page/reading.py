# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A log of any length read once, into the contents of a page.

Times of a page are simulated time for a recording of the node. For other bags they are seconds
after the first message, by the stamps of a topic where those follow the clock of the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.events import (
    ARM_STATE,
    CLOCK,
    DESCRIPTION,
    PAYLOAD_IN_USE,
    STATES,
    TAKEN,
    TAKEN_COLUMNS,
    Source,
    ValidationRow,
    Verdict,
)
from pfd_ros.arm.settings import Settings, from_recorded, to_recorded
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import (
    DIAGNOSTICS,
    FLOAT_ARRAY,
    JOINT_FIELDS,
    JOINT_STATE,
    JOINT_UNITS,
    NANOSECONDS,
    STRING,
    TRANSITION,
    decode_bytes,
    decode_rows,
)
from pfd_ros.messages.stamped import decode_inertia
from pfd_ros.motion.symptoms import symptoms
from pfd_ros.page.contents import Contents, Mark, Plot
from pfd_ros.page.curves import Array, Curve
from pfd_ros.page.findings import (
    BAD,
    NOTE,
    WARNING,
    Findings,
    GapCheck,
    InputCheck,
    LimitCheck,
)
from pfd_ros.page.intervals import Intervals
from pfd_ros.page.model_curves import ModelCurves, checked_payload, model_curves
from pfd_ros.recording.bags import bag_of
from pfd_ros.recording.format import (
    ARRAY_COMMANDS,
    NAMED_COMMANDS,
    PARAMETERS,
    REQUESTS,
    SET_STATE,
    SOURCE_OF_ROLE,
    HeadKey,
    Part,
)
from pfd_ros.recording.head import Ending, read_ending, read_part, strict_json
from pfd_ros.recording.arrays import LogArrays, TopicArrays, read_parts
from pfd_ros.recording.reader import LogError, damage_named
from pfd_ros.text import cut, one_line

# Of one page.
MOST_TOPICS = 12
MOST_COLUMNS = 64
# Stamps within so much of the log's times are of its clock.
SAME_CLOCK_SECONDS = 10.0
# A smaller simulated time is shown as it is, a later one is a time of day.
LATEST_START = 1e6
# A longer time without commands at the end of a log is a note on the page, s.
SILENCE_SECONDS = 0.1
# Around the first finding, for the diagnosis of each joint.
BEFORE, AFTER = 20.0, 5.0
MOST_DIAGNOSED = 1 << 16
TEXT_LENGTH, MARK_LENGTH = 200, 100
ENERGIES = ('kinetic', 'potential', 'total')
# Numbers of the node's diagnostics: title, unit, the task and its keys.
DIAGNOSTIC_PLOTS = (
    ('time of a step', 'us', 'stepping', ('step_p50_us', 'step_p99_us', 'step_max_us')),
    ('real-time factor', '1', 'stepping', ('real_time_factor',)),
    ('share of the recording queue', '1', 'recording', ('waiting_share',)),
)


@dataclass
class _Model:
    """The arm of a log: robot, settings, and roles of topics."""

    robot: pfd.Robot | None = None
    settings: Settings | None = None
    roles: Mapping[str, str] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    order: tuple[int, ...] = ()
    kernels: ModelCurves | None = None

    def unit(self, item: str, names: Sequence[str]) -> str:
        revolute, prismatic = JOINT_UNITS[item]
        types = (
            dict(zip(self.robot.joint_names, self.robot.joint_types, strict=True))
            if self.robot
            else {}
        )
        kinds = {types.get(name, '') == 'prismatic' for name in names if name in types}
        if kinds == {False}:
            return revolute
        return prismatic if kinds == {True} else f'{revolute} or {prismatic}'

    def bounds(self, item: str) -> dict[str, tuple[float, float]]:
        """Return the limits of each joint, infinite where the model states none."""
        if self.robot is None:
            return {}
        robot = self.robot
        if item == 'position':
            pairs = zip(robot.position_lower.tolist(), robot.position_upper.tolist(), strict=True)
        else:
            limit = robot.velocity_limit if item == 'velocity' else robot.effort_limit
            # Many models hold 0 for a limit that nobody knew.
            known = np.where(limit > 0.0, limit, np.inf).tolist()
            pairs = zip((-x for x in known), known, strict=True)
        return dict(zip(robot.joint_names, pairs, strict=True))


class LogReading:
    """
    The reading of one log.

    Parameters
    ----------
    paths
        An MCAP or SQLite file, a folder of rosbag2, or the files of one run or their folder.
    robot
        The robot of a log that holds none, for its limits; None for none.
    marks
        Moments to mark, in the time of the page.
    """

    def __init__(
        self, paths: Sequence[Path], robot: pfd.Robot | None = None, marks: Sequence[Mark] = ()
    ) -> None:
        self.bag = bag_of(paths)
        self.path, self.marks = self.bag.path, tuple(marks)
        self.model = _Model(robot=robot)
        self.findings = Findings()
        self.inputs = InputCheck()
        self.plots: dict[tuple[str, str], Plot] = {}
        self.notes: dict[str, None] = {}
        self.counts: Counter[str] = Counter()
        self.origin_ns: int | None = None
        self.own = False
        self.span = [np.inf, -np.inf]
        self.states_topic = ''
        self._limits: list[tuple[int, str, LimitCheck]] = []
        self._limit_names: tuple[str, ...] = ()
        self._gaps: GapCheck | None = None
        self.walls = Intervals()
        self._by_stamp: dict[str, bool] = {}
        self._commands_before: Counter[str] = Counter()
        self._trips = 0
        # Simulated times from which on the arm carries a payload, ns, and the payloads.
        self._payloads: list[tuple[int, tuple[float, ...]]] = []
        self._continued = False
        self._window: list[tuple[Array, ...]] = []
        self._window_names: tuple[str, ...] = ()

    def read(self, progress: Callable[[float], None] | None = None) -> Contents:
        """Read the log; what lies before damage is shown, and the damage is a note."""
        shown: LogArrays | None = None
        try:
            for part in read_parts(self.bag):
                if shown is None:
                    self._begin(part)
                shown = part
                self._feed(part)
                if progress is not None:
                    progress(self.bag.progress)
        except (LogError, OSError) as error:
            if shown is None or not any(self.counts.values()):
                raise
            self.notes[one_line(error)] = None
        if not self.counts:
            raise LogError(f'{self.path} holds no messages')
        return self._contents()

    # The beginning: settings, robot, topics.

    def _begin(self, part: LogArrays) -> None:
        model, bag = self.model, self.bag
        if part.settings is not None:
            self.own = True
            with suppress(ValueError):
                model.roles = bag.roles
            try:
                model.settings = from_recorded(dict(part.settings))
            except ValueError as error:
                self.notes[one_line(f'the settings cannot be read: {error}')] = None
        if part.robot is not None:
            model.robot = part.robot
        if model.robot is not None:
            wanted = model.settings.joints if model.settings else ()
            try:
                model.order = joint_order(wanted, model.robot)
                model.names = tuple(model.robot.joint_names[i] for i in model.order)
            except ValueError as error:
                self.notes[one_line(error)] = None
        settings = model.settings
        if settings is not None:
            self.inputs = InputCheck(
                settings.command_timeout, settings.on_timeout, settings.reflex_effort_rate
            )
            if model.robot is not None:
                try:
                    model.kernels = model_curves(model.robot, settings)
                except (ValueError, RuntimeError) as error:
                    self.notes[one_line(f'no energy and error estimate: {error}')] = None

    def _role(self, topic: str) -> str:
        return self.model.roles.get(topic, '')

    def _main_topic(self, part: LogArrays) -> str:
        """Return the topic of the states, '' if none was found so far."""
        kinds = [t for t, kind in self.bag_types().items() if kind == JOINT_STATE]
        for topic in kinds:
            if self._role(topic) == STATES:
                return topic
        if self.own:
            return ''
        named = [t for t in kinds if t.rsplit('/', 1)[-1] == 'joint_states']
        return (
            min(named, key=len) if named else max(kinds, key=self.counts.__getitem__, default='')
        )

    def bag_types(self) -> dict[str, str]:
        """Return the type of each topic so far."""
        return {name: topic.type for name, topic in self.bag.topics.items()}

    # Times.

    def _times(self, topic: str, found: TopicArrays) -> Array:
        ns = found.simulated_ns
        if ns is None or not self.own:
            if topic not in self._by_stamp:
                stamps = found.stamp_ns
                near = (
                    stamps is not None
                    and len(stamps) > 0
                    and (
                        abs(float(np.median((stamps - found.log_ns) / NANOSECONDS)))
                        < SAME_CLOCK_SECONDS
                    )
                )
                self._by_stamp[topic] = near
            ns = found.stamp_ns if self._by_stamp[topic] else found.log_ns
        assert ns is not None
        if self.origin_ns is None:
            first = int(ns[0] if self.own else found.log_ns[0])
            self.origin_ns = 0 if first < LATEST_START * NANOSECONDS else first
        times: Array = (ns - self.origin_ns) / NANOSECONDS
        back = int(np.count_nonzero(np.diff(times) < 0.0))
        if back:
            self.notes[
                one_line(
                    f'{cut(topic)}: {back} times of messages before the message before; such a '
                    'message is drawn at the latest time so far'
                )
            ] = None
            times = np.maximum.accumulate(times)
        self.span = [min(self.span[0], float(times[0])), max(self.span[1], float(times[-1]))]
        return times

    # One part of the log.

    def _feed(self, part: LogArrays) -> None:
        counted = {topic: len(part.messages(topic)) for topic in part}
        for topic, count in counted.items():
            self.counts[topic] += count
        if not self.states_topic:
            self.states_topic = self._main_topic(part)
        topics = [t for t in part if counted[t]]
        # Of all states in this part, those before the change of a payload too.
        del self._payloads[:-1]
        for topic in topics:
            with self._named(topic):
                self._find_payloads(topic, part)
        # Events, which have no span yet, come after the states that set the axis of time.
        for topic in sorted(topics, key=lambda t: t != self.states_topic):
            with self._named(topic):
                self._feed_topic(topic, part)
        for topic in topics:
            self._commands_before[topic] += counted[topic]
        self._trim_window()

    @contextmanager
    def _named(self, topic: str) -> Iterator[None]:
        """Note a topic that is not shown; whatever a hostile message causes is a LogError."""
        try:
            with damage_named(self.path):
                yield
        except LogError as error:
            self.notes[one_line(f'topic {cut(topic)!r} is not shown: {error}')] = None

    def _find_payloads(self, topic: str, part: LogArrays) -> None:
        """Note the payloads of the arm, before the states that they are for."""
        role, data = self._role(topic), part.messages(topic)
        if role == PAYLOAD_IN_USE:
            for message in map(decode_inertia, data):
                self._payloads.append((message.stamp_ns, checked_payload(message.numbers)))
        elif role == ARM_STATE and not self._continued and HeadKey.PART in self.bag.head:
            # The log begins with this state; the payload was set in a file before it.
            self._continued = True
            saved = ArmState.from_bytes(decode_bytes(data[0]))
            self._payloads.append((0, checked_payload(saved.payload)))
        self._payloads.sort(key=itemgetter(0))

    def _feed_topic(self, topic: str, part: LogArrays) -> None:
        role, kind = self._role(topic), part.topics[topic]
        if role in (CLOCK, DESCRIPTION) or (role == '' and self.own):
            return
        if role == TAKEN:
            self._feed_rows(topic, part)
        elif role == ARM_STATE:
            self._feed_arm_states(topic, part)
        elif role in (REQUESTS, PARAMETERS):
            self._feed_texts(role, topic, part)
        elif kind == JOINT_STATE:
            self._feed_joints(topic, role, part[topic])
        elif kind == FLOAT_ARRAY:
            self._feed_numbers(topic, role, part[topic])
        elif kind == DIAGNOSTICS:
            self._feed_diagnostics(topic, part[topic])
        elif kind == TRANSITION:
            self._feed_transitions(topic, part[topic])

    def _feed_joints(self, topic: str, role: str, found: TopicArrays) -> None:
        if not len(found) or not found.names:
            return
        main = topic == self.states_topic
        time = self._times(topic, found)
        if role == SET_STATE:
            self.findings.add(
                'event', NOTE, 'set_state: the state is set', (float(time[0]),) * 2, key=topic
            )
            return
        names = found.names
        if main:
            if not self._window_names:
                self._window_names = names
            self._check_states(time, found)
        places: Array = np.empty(0, np.intp)
        if main:
            dropped = self.model.settings is not None and self.model.settings.drop_state
            severity = NOTE if dropped else WARNING
            self._gaps = self._gaps or GapCheck(topic, self._period(), severity)
            places = self._gaps.feed(time, self.findings)
        for item in JOINT_FIELDS:
            values = getattr(found, item)
            if not np.isfinite(values).any() and (topic, item) not in self.plots:
                continue
            command = role in (NAMED_COMMANDS,) or (not main and 'command' in topic)
            name = 'commanded ' + item if command else item
            title = name if main or command else f'{item} of {topic.rsplit("/", 1)[-1]}'
            plot = self._plot(
                (topic, item),
                title,
                self.model.unit(item, names),
                topic,
                names,
                joints=True,
                stepped=command,
                bounds=self.model.bounds(item) if main else {},
            )
            if plot is None:
                continue
            at, drawn = _with_breaks(time, _columns(values, names, plot.labels), places)
            plot.curve.add(at, drawn)
        if main:
            self._feed_wall(time, found)

    def _period(self) -> float:
        settings = self.model.settings
        return 0.0 if settings is None else settings.publish_every * settings.step_ns / NANOSECONDS

    def _check_states(self, time: Array, found: TopicArrays) -> None:
        names = found.names
        if names != self._limit_names:
            self._limit_names = names
            self._limits = [
                (column, item, LimitCheck(name, item, self.model.unit(item, [name]), *bound))
                for item in JOINT_FIELDS
                for column, name in enumerate(names)
                if np.isfinite(bound := self.model.bounds(item).get(name, (-np.inf, np.inf))).any()
            ]
        for column, item, check in self._limits:
            check.feed(time, getattr(found, item)[:, column], self.findings)
        for item in JOINT_FIELDS:
            values = getattr(found, item)
            for column in np.flatnonzero(np.isinf(values).any(axis=0)).tolist():
                k = int(np.argmax(np.isinf(values[:, column])))
                self.findings.add(
                    'not finite',
                    BAD,
                    f'{item} of the state is {values[k, column]}',
                    (float(time[k]),) * 2,
                    names[column],
                    item,
                )
        kernels, n = self.model.kernels, len(self.model.names)
        if names[:n] == self._window_names[:n]:
            self._window.append((time, *(getattr(found, item) for item in JOINT_FIELDS)))
        if kernels is not None and names[:n] == self.model.names:
            q, qd, tau = (getattr(found, item)[:, :n] for item in JOINT_FIELDS)
            good = np.isfinite(q).all(axis=1) & np.isfinite(qd).all(axis=1)
            arrays = time[good], q[good], qd[good], np.nan_to_num(tau[good])
            stamps_ns = found.stamp_ns
            assert stamps_ns is not None  # a JointState has one
            for payload, some in self._by_payload(stamps_ns[good], kernels.first):
                self._feed_model(kernels, payload, *(values[some] for values in arrays))

    def _by_payload(
        self, stamps_ns: Array, first: tuple[float, ...]
    ) -> Iterator[tuple[tuple[float, ...], slice]]:
        """Yield payloads and the states with each, with the first one up to the first change."""
        begins = [begin for begin, _ in self._payloads]
        places = np.searchsorted(begins, stamps_ns, side='right') - 1
        ends = [*(np.flatnonzero(np.diff(places)) + 1).tolist(), len(places)]
        begin = 0
        for end in ends:
            if end > begin:
                place = int(places[begin])
                yield self._payloads[place][1] if place >= 0 else first, slice(begin, end)
            begin = end

    def _feed_model(
        self,
        kernels: ModelCurves,
        payload: tuple[float, ...],
        at: Array,
        q: Array,
        qd: Array,
        tau: Array,
    ) -> None:
        computed = 'computed from the recorded states'
        if 'energy' not in self.model.roles.values():
            plot = self._plot(('computed', 'energy'), 'energy', 'J', computed, ENERGIES)
            if plot is not None:
                plot.curve.add(at, kernels.energy(q, qd, payload))
        labels = ('relative error of accelerations',)
        plot = self._plot(('computed', 'error'), 'error estimate', '1', computed, labels)
        if plot is not None:
            plot.curve.add(*kernels.error(at, q, qd, tau, payload))

    def _feed_wall(self, time: Array, found: TopicArrays) -> None:
        """Add the intervals between states on the wall clock."""
        wall = found.log_ns
        if self.own and self.model.settings is not None:
            wall = found.published_ns if self.model.settings.log_time == 'simulated' else wall
        intervals = self.walls.feed(wall)
        if not len(intervals):
            return
        topic = self.states_topic
        source = f'wall-clock time between states of {topic}'
        plot = self._plot(('wall', topic), 'period', 'ms', source, ('period',))
        if plot is not None:
            plot.curve.add(time[len(time) - len(intervals) :], 1e-6 * intervals[:, np.newaxis])

    def _feed_numbers(self, topic: str, role: str, found: TopicArrays) -> None:
        values = found.arrays.get('data')
        if values is None or values.ndim != 2 or not len(values) or not values.shape[1]:
            return
        width = values.shape[1]
        if width > min(MOST_COLUMNS, max(16, 2 * len(self.model.names))):
            self.notes[one_line(f'{cut(topic)} has {width} numbers a message: not drawn')] = None
            return
        time = self._times(topic, found)
        command = role == ARRAY_COMMANDS or (not self.own and 'command' in topic)
        n, names = len(self.model.names), self.model.names or self._window_names
        joints = width == len(names)
        labels = names if joints else tuple(f'[{k}]' for k in range(width))
        title, unit = topic.rsplit('/', 1)[-1], ''
        if command:
            title, unit = 'commanded effort', self.model.unit('effort', names[:n])
            if not joints and names and (topic, 'data') not in self.plots:
                # Commands of a wrong size are drawn with the columns of the arm.
                joints, labels = True, names
        if role == 'energy':
            title, unit, labels, joints = 'energy', 'J', ENERGIES, False
            total = values[:, :1] + values[:, 1:2]
            values = np.concatenate([values[:, :2], total], axis=1)
        plot = self._plot(
            (topic, 'data'),
            title,
            unit,
            topic,
            labels,
            joints=joints,
            stepped=command,
            bounds=self.model.bounds('effort') if command else {},
        )
        if plot is not None:
            plot.curve.add(time, _fitted(values, len(plot.labels)))

    def _feed_rows(self, topic: str, part: LogArrays) -> None:
        raw = part.messages(topic)
        found = part[topic]
        if not len(found):
            return
        times = self._times(topic, found)
        width = len(TAKEN_COLUMNS)
        for time, place in zip(times.tolist(), found.places.tolist(), strict=True):
            for numbers in decode_rows(raw[place], width):
                cycle, source, number, verdict, crc = numbers
                row = ValidationRow(cycle, Source(source), number, Verdict(verdict), crc)
                wrong = row.verdict is Verdict.NOT_FINITE and row.source is Source.ARRAY
                detail = self._wrong_numbers(part, row) if wrong else ''
                self.inputs.feed(time, row, detail, self.findings)

    def _wrong_numbers(self, part: LogArrays, row: ValidationRow) -> str:
        """Return which numbers of a command are not finite, '' if it is in another part."""
        topics = [t for t in part if SOURCE_OF_ROLE.get(self._role(t)) is row.source]
        for topic in topics:
            found = part[topic]
            place = row.sequence - 1 - self._commands_before[topic]
            (rows,) = np.nonzero(found.places == place)
            if len(rows):
                values = found.arrays['data'][rows[0]]
                wrong = [
                    f'effort of {name!r} is {value}'
                    for name, value in zip(self.model.names, values.tolist(), strict=False)
                    if not np.isfinite(value)
                ]
                return one_line(', '.join(wrong[:3]))
        return ''

    def _feed_arm_states(self, topic: str, part: LogArrays) -> None:
        found = part[topic]
        if not len(found):
            return
        times = self._times(topic, found)
        for time, place in zip(times.tolist(), found.places.tolist(), strict=True):
            saved = ArmState.from_bytes(decode_bytes(part.messages(topic)[place]))
            actuators = saved.actuators
            if actuators.trips > self._trips:
                self._trips = actuators.trips
                text = one_line(f'the reflex braked all joints: {actuators.reflex}', TEXT_LENGTH)
                self.findings.add('reflex', BAD, text, (time, time), key='text')
            if saved.failure:
                self.findings.add(
                    'failure', BAD, one_line(saved.failure, TEXT_LENGTH), (time, time)
                )

    def _feed_texts(self, role: str, topic: str, part: LogArrays) -> None:
        found = part[topic]
        if not len(found) or part.topics[topic] != STRING:
            return
        what = 'request' if role == REQUESTS else 'parameters'
        for time, text in zip(self._times(topic, found).tolist(), found.data, strict=True):
            line = one_line(f'{what}: {text}', TEXT_LENGTH)
            self.findings.add('event', NOTE, line, (time, time), key=line)

    def _feed_transitions(self, topic: str, found: TopicArrays) -> None:
        for time, start, goal in zip(
            self._times(topic, found).tolist(),
            found['start_state.label'],
            found['goal_state.label'],
            strict=True,
        ):
            line = one_line(f'lifecycle: {start} to {goal}', TEXT_LENGTH)
            self.findings.add('event', NOTE, line, (time, time), key=line)

    def _feed_diagnostics(self, topic: str, found: TopicArrays) -> None:
        arrays = found.arrays
        level, name, message = (
            arrays.get(f'status.{key}') for key in ('level', 'name', 'message')
        )
        if not len(found) or level is None or name is None or message is None or name.ndim != 2:
            return
        times = self._times(topic, found)
        for k, j in np.argwhere(np.nan_to_num(level.astype(float)) >= 1):
            severity = BAD if level[k, j] >= 2 else WARNING
            text = one_line(f'{name[k, j]}: {message[k, j]}', TEXT_LENGTH)
            time = float(times[k])
            self.findings.add('diagnostics', severity, text, (time, time), key=text)
        keys, values = arrays.get('status.values.key'), arrays.get('status.values.value')
        if keys is None or values is None or keys.ndim != 3 or not self.own:
            return
        for title, unit, task, wanted in DIAGNOSTIC_PLOTS:
            shown = np.full((len(found), len(wanted)), np.nan)
            for k, j in np.argwhere(np.char.endswith(name.astype(str), f': {task}')):
                row = dict(zip(keys[k, j].tolist(), values[k, j].tolist(), strict=True))
                for column, key in enumerate(wanted):
                    with suppress(ValueError, KeyError):
                        shown[k, column] = float(row[key])
            plot = self._plot((topic, title), title, unit, topic, wanted)
            if plot is not None:
                plot.curve.add(times, shown)

    def _plot(
        self,
        key: tuple[str, str],
        title: str,
        unit: str,
        source: str,
        labels: tuple[str, ...],
        *,
        joints: bool = False,
        stepped: bool = False,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> Plot | None:
        """Return a plot, a new one at its first values; None if the page has enough."""
        if key not in self.plots:
            topics = {topic for topic, _ in self.plots}
            if len(topics) >= MOST_TOPICS and key[0] not in topics:
                self.notes[one_line(f'{cut(key[0])} is not drawn: more than {MOST_TOPICS}')] = None
                return None
            shown = labels[:MOST_COLUMNS]
            if len(labels) > MOST_COLUMNS:
                text = f'{cut(key[0])}: the first {MOST_COLUMNS} of {len(labels)} are drawn'
                self.notes[one_line(text)] = None
            self.plots[key] = Plot(
                one_line(title, 80),
                unit,
                one_line(source, 120),
                tuple(one_line(label, 64) for label in shown),
                Curve(len(shown)),
                joints,
                stepped,
                {one_line(name, 64): pair for name, pair in (bounds or {}).items()},
                key[0] == 'wall' or key[1] == 'error',
            )
        return self.plots[key]

    # The diagnosis of each joint, around what went wrong first.

    def _trim_window(self) -> None:
        first = self.findings.first()
        end = np.inf if first is None else first.time + AFTER
        while len(self._window) > 1:
            oldest = self._window[0][0]
            spare = sum(len(part[0]) for part in self._window) - len(oldest)
            early = oldest[-1] < min(end - AFTER - BEFORE, self._window[-1][0][-1] - BEFORE)
            if spare < MOST_DIAGNOSED and not (early and first is not None):
                break
            if self._window[-1][0][0] > end:
                del self._window[-1]
            else:
                del self._window[0]

    def _diagnosis(self) -> tuple[list[str], str]:
        if not self._window:
            return [], ''
        time, q, qd, tau = (np.concatenate(parts) for parts in zip(*self._window, strict=True))
        first = self.findings.first()
        if first is not None:
            near = (time >= first.time - BEFORE) & (time <= first.time + AFTER)
            time, q, qd, tau = time[near], q[near], qd[near], tau[near]
        time, q, qd, tau = (values[-MOST_DIAGNOSED:] for values in (time, q, qd, tau))
        period = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        lines = []
        limits = {item: self.model.bounds(item) for item in JOINT_FIELDS}
        for j, name in enumerate(self._window_names):
            arrays = q[:, j], qd[:, j], tau[:, j]
            good = np.isfinite(arrays[0]) & np.isfinite(arrays[1])
            good[1:] &= np.diff(time) > 0.0
            columns = [np.nan_to_num(values[good]) for values in arrays]
            if len(columns[0]) < 3 or not period > 0.0:
                continue
            bounds = [
                (item, column, *limits[item].get(name, (-np.inf, np.inf)))
                for item, column in zip(JOINT_FIELDS, columns, strict=True)
            ]
            with np.errstate(all='ignore'):
                text = symptoms(time[good], *columns, target=None, limits=bounds, period=period)
            if not self._limits:
                text = text.removesuffix(', no limit reached')
            lines.append(one_line(f'{name}: {text}', 300))
        return lines, f't = {time[0]:.3f} s to {time[-1]:.3f} s' if len(time) else ''

    # The end.

    def _ending(self) -> Ending | None:
        """Return the end record of the last file; its counts begin with the first file."""
        if not self.bag.end or not self.model.roles:
            return None
        try:
            ending = read_ending(self.bag.end, self.model.roles, self._part())
        except ValueError as error:
            self.notes[one_line(f'the end record cannot be read: {error}')] = None
            return None
        if ending.totals is None:
            self.notes['the run continues in another file'] = None
        return ending

    def _part(self) -> Part:
        """Return the place of the first file in its run."""
        text = self.bag.head.get(HeadKey.PART)
        if text is None:
            return Part()
        part = read_part(strict_json(text), self.model.roles)
        self.notes[f'the run begins in another file: this is file {part.number}'] = None
        return part

    def _contents(self) -> Contents:
        settings, ending = self.model.settings, self._ending()
        if settings is not None and np.isfinite(self.span[1]):
            self.inputs.check_timeout(self.span[1], self.findings)
            last = self.inputs.last_accepted
            if last is not None and self.span[1] - last > SILENCE_SECONDS:
                rest = self.span[1] - last
                text = f'the last command: none in the {rest:.3g} s that follow'
                self.findings.add('event', NOTE, text, (last, last), key=text)
        totals = None if ending is None else ending.totals
        if totals is not None and totals.failure and settings is not None:
            stopped = settings.start_ns + totals.steps * settings.step_ns - (self.origin_ns or 0)
            time = stopped / NANOSECONDS
            text = one_line(f'the simulation stopped: {totals.failure}', TEXT_LENGTH)
            self.findings.add('failure', BAD, text, (time, max(time, self.span[1])), key='end')
        for mark in self.marks:
            text = one_line(mark.text.partition('\n')[0], MARK_LENGTH)
            self.findings.add(mark.label, BAD, text, (mark.time,) * 2, key=mark.text)
        missing = self._missing(ending)
        found = self.findings.sorted()
        if self.findings.left_out:
            self.notes[f'{self.findings.left_out} more findings are not shown'] = None
        diagnosis, of = self._diagnosis()
        checked, unchecked = self._checks()
        span = tuple(self.span) if np.isfinite(self.span).all() else (0.0, 0.0)
        if not self.states_topic:
            self.notes['the log has no joint states'] = None
        return Contents(
            title=self.path.name,
            facts=self._facts(ending, missing),
            settings=self._settings(),
            findings=found,
            first=self.findings.first(),
            checked=checked,
            unchecked=unchecked,
            diagnosis=diagnosis,
            diagnosis_of=of,
            plots=[plot for plot in self._ordered() if plot.curve.samples],
            notes=[*missing, *self.notes],
            marks=self.marks,
            origin=self._origin(),
            span=(span[0], span[1]),
        )

    def _missing(self, ending: Ending | None) -> list[str]:
        lines = [f'missing: {absent}' for absent in self.bag.absent]
        if not self.bag.complete:
            lines.append('the file is cut off: it was not closed, and the page is up to the cut')
        elif self.own and ending is None:
            lines.append('the file lacks the end record of the node')
        if ending is not None:
            topics = {role: topic for topic, role in self.model.roles.items()}
            for role, count in ending.dropped.items():
                lost = count + ending.recorded[role] - self.counts[topics[role]]
                if lost > 0:
                    lines.append(one_line(f'{lost} messages {role} are not in the file'))
        return lines

    def _ordered(self) -> list[Plot]:
        """Return the plots in the order of a page."""
        main = [(self.states_topic, item) for item in JOINT_FIELDS]
        commands = [key for key, plot in self.plots.items() if plot.title.startswith('commanded')]
        last = [('computed', 'energy'), ('computed', 'error')]
        energies = [key for key, plot in self.plots.items() if plot.title == 'energy']
        wall = [key for key in self.plots if key[0] == 'wall']
        ordered = [*main, *commands, *energies, *last, *wall, *self.plots]
        return [self.plots[key] for key in dict.fromkeys(ordered) if key in self.plots]

    def _origin(self) -> str:
        if not self.origin_ns:
            return 'simulated time'
        with suppress(ValueError, OverflowError, OSError):
            day = datetime.fromtimestamp(self.origin_ns // NANOSECONDS, timezone.utc)
            return f't = 0 is {day:%Y-%m-%d %H:%M:%S} UTC'
        return f't = 0 is {self.origin_ns} ns'

    def _facts(self, ending: Ending | None, missing: Sequence[str]) -> list[tuple[str, str]]:
        robot, settings, span = self.model.robot, self.model.settings, self.span
        facts = [('log', str(self.path))]
        if robot is not None:
            facts.append(('robot', f'{robot.name}, {robot.n} joints'))
        if np.isfinite(span).all():
            facts.append(('time', f'{span[0]:.3f} s to {span[1]:.3f} s ({self._origin()})'))
        states = self.counts[self.states_topic] if self.states_topic else 0
        if states and self._gaps is not None and self._gaps.period:
            facts.append(('states', f'{states}, every {1e3 * self._gaps.period:.4g} ms'))
        if self.walls.count:
            facts.append((self._wall_name(), self.walls.text()))
        if self.own:
            facts.append(
                ('inputs', f'{self.inputs.accepted} accepted, {self.inputs.rejected} rejected')
            )
        if settings is not None:
            model = f'{settings.integrator}, {settings.method}, step {settings.step_size:g} s'
            facts.append(('simulation', model))
        versions = {}
        with suppress(ValueError):
            versions = strict_json(self.bag.head.get(HeadKey.VERSIONS, '{}'))
        if isinstance(versions, dict) and versions.get('pfd'):
            facts.append(('recorded by', f'pfd {versions["pfd"]}'))
        facts.append(('whole', 'no' if missing else 'yes'))
        return [(name, one_line(value, TEXT_LENGTH)) for name, value in facts]

    def _wall_name(self) -> str:
        settings = self.model.settings
        paced = settings is None or (settings.real_time_factor > 0 and not settings.lockstep)
        return 'period' if paced else 'wall time a state'

    def _settings(self) -> list[tuple[str, str, bool]]:
        settings = self.model.settings
        if settings is None:
            return []
        defaults = to_recorded(Settings())
        rows = [
            (name, one_line(_value(value), 2000), value != defaults.get(name))
            for name, value in to_recorded(settings).items()
        ]
        return sorted(rows, key=lambda row: not row[2])

    def _checks(self) -> tuple[list[str], list[str]]:
        """Return the checks that were made on this log, and the impossible ones."""
        checked, unchecked = [], []
        if self._limits:
            checked.append('limits of position, velocity and effort')
        else:
            reason = 'the log names no robot' if self.model.robot is None else 'it states none'
            unchecked.append(f'limits ({reason}; --robot adds one)')
        if TAKEN in self.model.roles.values():
            checked += ['rejected inputs', 'watchdog', 'reflexes']
        else:
            unchecked.append('rejected inputs, watchdog, reflexes (not a recording of pfd)')
        if self._gaps is not None:
            checked.append('missing states')
        if self.bag.end:
            checked.append('failure of the simulation')
        if any(self.counts[t] for t, kind in self.bag_types().items() if kind == DIAGNOSTICS):
            checked.append('diagnostics')
        else:
            unchecked.append('diagnostics (none recorded)')
        return checked, unchecked


def _value(value: Any) -> str:
    return ', '.join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _columns(values: Array, names: Sequence[str], labels: Sequence[str]) -> Array:
    """Return the columns of the labelled joints, NaN for joints that this part lacks."""
    places = {one_line(name, 64): k for k, name in enumerate(names)}
    if [places.get(label) for label in labels] == list(range(values.shape[1])):
        return values
    found = np.full((len(values), len(labels)), np.nan)
    for column, label in enumerate(labels):
        if label in places:
            found[:, column] = values[:, places[label]]
    return found


def _fitted(values: Array, width: int) -> Array:
    """Return the first `width` columns of rows, filled with NaN."""
    found = np.full((len(values), width), np.nan)
    common = min(width, values.shape[1])
    found[:, :common] = values[:, :common]
    return found


def _with_breaks(time: Array, values: Array, places: Array) -> tuple[Array, Array]:
    """Return samples with a gap before some places, so that no line crosses missing states."""
    if not len(places):
        return time, values
    inner = places[places > 0]
    return (
        np.insert(time, inner, time[inner - 1]),
        np.insert(np.asarray(values, np.float64), inner, np.nan, axis=0),
    )


def read_contents(
    path: Path | Sequence[Path],
    *,
    robot: pfd.Robot | None = None,
    marks: Sequence[Mark] = (),
    progress: Callable[[float], None] | None = None,
) -> Contents:
    """
    Read a log, one file or several of one run, into the contents of a page.

    Raises
    ------
    LogError
        If the file is not a log, or has nothing to show.
    OSError
        If it cannot be read.

    """
    paths = [path] if isinstance(path, Path) else path
    return LogReading(paths, robot, marks).read(progress)
