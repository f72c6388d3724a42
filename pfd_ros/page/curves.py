# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plots of a log: states, commands, energy, and numbers of its topics; and their encoding."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
import zlib

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.events import (
    ARRAY,
    ENERGY,
    MOVING,
    NAMED,
    PAYLOAD_IN_USE,
    REQUESTS,
    SET_STATE,
    TRAJECTORY,
)
from pfd_ros.arm.plant import INPUT, scene_of
from pfd_ros.arm.plant_settings import payload_from
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.trajectory import plan_of
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import FLOAT_ARRAY, JOINT_STATE
from pfd_ros.page.recorded import Array, Recorded
from pfd_ros.recording.format import HeadKey
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import cut, one_line

# Numbers of an array and points of a curve that are drawn at most.
MOST_COLUMNS, MOST_POINTS = 64, 20_000
# A commanded position without another one for so long is held [s].
HELD = 0.1
# Larger numbers are drawn there: float32 ends.
LARGEST = 3e38
DERIVATIVES = ('positions', 'velocities', 'accelerations')
ENERGIES = ('kinetic', 'potential', 'total')
# The numbers of a payload in a message.
PAYLOAD = ('m', 'com.x', 'com.y', 'com.z', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')


@dataclass(frozen=True, eq=False)
class Reference:
    """A motion that joints should follow: times (N,), positions (N, n), and its tolerance."""

    names: tuple[str, ...]
    time: Array
    position: Array
    within: float | None = None

    def at(self, joint: str, time: Array) -> Array:
        """Return the position that a joint should have at some times, NaN before and after it."""
        column = self.position[:, self.names.index(joint)]
        return np.interp(time, self.time, column, left=np.nan, right=np.nan)


class Plot(NamedTuple):
    """Curves over one axis of time."""

    title: str
    source: str  # the topic
    labels: tuple[str, ...]
    time: Array  # (N,)
    values: Array  # (N, k), a column for each label, then for each reference
    joints: bool = True  # labels are joints, which a page selects and colours alike
    bounds: Array | None = None  # limits (2, k), infinite without one
    breaks: Array = np.empty(0, int)  # places of samples before which some are missing
    stepped: bool = False  # a value acts until the next one
    # A label, and 'reference', 'low' or 'high'.
    references: Sequence[tuple[str, str]] = ()


def commanded_positions(run: Recorded) -> Iterator[Reference]:
    """Yield the reference of each joint whose positions are commanded, one after the other.

    It moves between positions that come within HELD of each other; others are held. An arm without
    servos ignores positions, and a controller may fill them with one number: no reference.
    """
    found, servos = run.of_role(NAMED), any(run.settings.get('servo_p') or ())
    planned = {reference.names[0]: reference for reference in _planned(run)}
    for j, name in enumerate(() if found is None else found.names):
        assert found is not None
        there = np.isfinite(found.position[:, j]) & run.accepted(NAMED)
        time, values = run.intended(found)[there], found.position[there, j]
        if len(time) and (servos or np.ptp(values) > 0.0):
            ends = np.append(time[1:], max(run.span[1], time[-1]))
            ends = np.where(ends - time > HELD, ends, time)
            steps = np.stack([time, ends], axis=1).ravel()
            reference = Reference((name,), steps, values.repeat(2)[:, np.newaxis])
            if name in planned:  # a trajectory ends what was commanded before
                grid = next(joints.time for joints in run.joints if name in joints.names)
                q = planned.pop(name).at(name, grid)
                moved = np.maximum.accumulate(np.where(np.isfinite(q), grid, -np.inf))
                newer = np.append(-np.inf, time)[np.searchsorted(time, grid, 'right')] > moved
                q = np.where(newer, reference.at(name, grid), q)
                reference = Reference((name,), grid, q[:, np.newaxis])
            yield reference
    yield from planned.values()


def _planned(run: Recorded) -> Iterator[Reference]:
    """Yield the reference of each joint that trajectories move, as the arm samples them."""
    found, robot = run.of_role(TRAJECTORY), run.robot
    if found is None or robot is None or 'points.positions' not in found.arrays:
        return
    begin, times, ends = _moves(run, found)
    kinds = dict(zip(robot.joint_names, robot.joint_types, strict=True))
    pieces: dict[str, list[Array]] = {}
    for i in np.flatnonzero(run.accepted(TRAJECTORY)):
        names, at = [x for x in found.joint_names[i] if x], times[i][np.isfinite(times[i])]
        every = {x: found.arrays[f'points.{x}'][i, : len(at), : len(names)] for x in DERIVATIVES}
        values = {x: y for x, y in every.items() if y.size and np.isfinite(y).all()}
        joints = next((x for x in run.joints if {*names} <= {*x.names}), None)
        if joints is None or 'positions' not in values:
            continue
        columns = np.array([joints.names.index(x) for x in names])
        row = max(int(np.searchsorted(joints.time, begin[i] + 1e-9, 'right')) - 1, 0)
        start = np.array([joints.values[x][row, columns] for x in JOINT_FIELDS])
        now, *ns = np.round(NANOSECONDS * np.append(begin[i], at)).astype(np.int64)
        endless = [kinds[x] == 'continuous' for x in names]
        plan = plan_of(columns, np.array(ns), values, now, start, endless)
        stop = min(ends[i], max(run.span[1], begin[i]))
        last = min(stop, at[-1])
        moved = joints.time[(joints.time >= begin[i]) & (joints.time < last)]
        grid = np.append(moved, [last, stop, stop])
        q = np.array([plan.at(round(NANOSECONDS * t))[1] for t in grid])
        q[-1] = np.nan  # until the next one
        for name, column in zip(names, q.T, strict=True):
            pieces.setdefault(name, []).append(np.stack([grid, column]))
    for name, parts in pieces.items():
        time, position = np.concatenate(parts, axis=1)
        yield Reference((name,), time, position[:, np.newaxis])


def _moves(run: Recorded, found: TopicArrays) -> tuple[Array, Array, Array]:
    """Return the starts of trajectories (N,), times of their points (N, k), their ends (N,)."""
    sec, nanosec = (found.arrays[f'points.time_from_start.{x}'] for x in ('sec', 'nanosec'))
    came, stamps = run.times(found), found.header.stamp
    stamp = stamps.sec + stamps.nanosec / NANOSECONDS
    now = came - run.settings['step_size']  # a message is logged with the state after its cycle
    start = np.where(stamp > 0.0, stamp - run.origin_ns / NANOSECONDS, now)
    stops = [run.accepted_times(role) for role in MOVING]
    # A pause shifts trajectories of an arm that follows another clock.
    clocked = run.settings.get('time_source') == 'clock'
    stops.append(run.accepted_times(REQUESTS, ('"reset"', '"deactivate"', *['"pause"'] * clocked)))
    stop = np.sort(np.concatenate([*stops, [np.inf]]))
    ends = stop[np.searchsorted(stop, came, 'right')]
    return now, start[:, np.newaxis] + sec + nanosec / NANOSECONDS, ends


def plots_of(run: Recorded, references: Sequence[Reference] = ()) -> Iterator[Plot]:
    """Yield the plots of a log in the order of a page."""
    for item in JOINT_FIELDS:
        for joints in run.joints:
            unit, values = run.states_unit(item, joints.names), joints.values[item]
            title = f'{item} [{unit}]'
            plot = Plot(title, run.topic, joints.names, joints.time, values, breaks=joints.gaps)
            plot = plot._replace(bounds=joints.bounds[item])
            if np.isfinite(values).any():
                yield _with_references(plot, references) if item == 'position' else plot
    found = *_energy(run), *_points(run), *_of_topics(run)
    others = [plot for plot in found if len(plot.time)]
    yield from sorted(others, key=lambda plot: not plot.title.startswith('commanded'))


def _with_references(plot: Plot, references: Sequence[Reference]) -> Plot:
    """Return a plot of positions with the references of its joints and their tolerances."""
    columns, kinds = [plot.values], list[tuple[str, str]]()
    for reference in references:
        for name in (name for name in reference.names if name in plot.labels):
            column, within = reference.at(name, plot.time), reference.within
            ends = () if within is None else (('low', -within), ('high', within))
            for kind, far in (('reference', 0.0), *ends):
                kinds.append((name, kind))
                columns.append((column + far)[:, np.newaxis])
    return plot._replace(values=np.concatenate(columns, axis=1), references=tuple(kinds))


def _points(run: Recorded) -> Iterator[Plot]:
    """Yield the points of trajectories, up to the input that ends each of them."""
    found = run.of_role(TRAJECTORY)
    if found is None or 'points.positions' not in found.arrays:
        return
    begin, time, ends = _moves(run, found)
    acts = (time >= begin[:, np.newaxis]) & (time < ends[:, np.newaxis])
    acts &= run.accepted(TRAJECTORY)[:, np.newaxis]
    names = found.joint_names
    labels = tuple(dict.fromkeys(x for x in names[run.accepted(TRAJECTORY)].ravel() if x))
    for item, field in zip(JOINT_FIELDS, ('positions', 'velocities', 'effort'), strict=True):
        points = found.arrays[f'points.{field}']
        if not points.size or not labels:
            continue
        columns = [np.where(names[:, np.newaxis] == x, points, -np.inf)[acts] for x in labels]
        values = np.stack([column.max(axis=1) for column in columns], axis=1)
        values[np.isinf(values)] = np.nan
        title = f'commanded points of {item} [{run.unit(item, labels)}]'
        yield Plot(title, run.log.topic_of(TRAJECTORY), labels, time[acts], values)


def _of_topics(run: Recorded) -> Iterator[Plot]:
    roles = run.log.roles
    for topic, found in run.log.of_type(JOINT_STATE).items():
        role = roles.get(topic, '')
        if topic == run.topic or role == SET_STATE:
            continue
        command = role == NAMED or 'command' in topic
        what = 'commanded ' if command else f'{topic.rpartition("/")[2]}: '
        rows = run.accepted(role) if role == NAMED else np.ones(len(found), bool)
        for item in JOINT_FIELDS:
            values = getattr(found, item)[rows]
            there = np.isfinite(values).any(axis=0)
            if there.any():
                names = tuple(np.array(found.names)[there].tolist())
                title = f'{what}{item} [{run.unit(item, names)}]'
                sampled = run.times(found)[rows], values[:, there]
                time, values = _held(run, *sampled) if role == NAMED else sampled
                yield Plot(title, topic, names, time, values, stepped=command)
    for topic, found in run.log.of_type(FLOAT_ARRAY).items():
        values, role = found.arrays['data'], roles.get(topic, '')
        width = values.shape[1] if values.ndim == 2 else 0
        if not 0 < width <= MOST_COLUMNS:
            run.notes[one_line(f'{cut(topic)} has {width} numbers a message: not drawn')] = None
            continue
        title, command = topic.rpartition('/')[2], role == ARRAY or 'command' in topic
        # Joints that are locked come after those that are commanded.
        names = run.names[:width] if role == ARRAY else run.names
        labels, joints = tuple(f'[{k}]' for k in range(width)), width == len(names)
        if role == ENERGY:
            values = np.column_stack([values[:, :2], values[:, :2].sum(axis=1)])
            title, labels, joints = 'energy [J]', ENERGIES, False
        elif command:
            title = f'commanded effort [{run.unit("effort", names)}]'
        labels, time = names if joints else labels, run.times(found)
        if role == ARRAY:
            rows = run.accepted(role)
            time, values = _held(run, time[rows], values[rows])
        yield Plot(title, topic, labels, time, values, joints, stepped=command)


def _held(run: Recorded, time: Array, values: Array) -> tuple[Array, Array]:
    """Return commands with the last one up to the end of the states, or to the watchdog."""
    if not len(time):
        return time, values
    until = min(run.span[1], time[-1] + (run.settings.get('command_timeout') or np.inf))
    return np.append(time, max(until, time[-1])), np.append(values, values[-1:], axis=0)


def _energy(run: Recorded) -> Iterator[Plot]:
    """Yield the energy of the recorded states, unless it is recorded or no robot is known."""
    robot, joints = run.robot, next(iter(run.joints), None)
    if robot is None or joints is None or run.of_role(ENERGY) is not None:
        return
    if not set(robot.joint_names) <= set(joints.names):
        return
    order, scene = [joints.names.index(name) for name in robot.joint_names], pfd.Scene()
    q, qd = (joints.values[item][:, order] for item in ('position', 'velocity'))
    good: Array = np.isfinite(np.hstack([q, qd])).all(axis=1)
    values = np.full((len(q), 3), np.nan)
    try:
        if run.settings:
            settings = Settings.from_json(run.log.head[HeadKey.SETTINGS])
            scene = scene_of(settings, np.argsort(order))
        used = run.of_role(PAYLOAD_IN_USE)
        if used is not None:
            scene = replace(scene, payload=INPUT)
        alone = replace(scene, brakes=False, external_wrench=False, gravity_compensation=False)
        kernel = pfd.compile_kernel(robot, scene=alone, quantity='energy')
        # The payload of a state is that of the last message before it.
        begins = np.empty(0) if used is None else run.times(used)
        places = np.searchsorted(begins, joints.time, side='right')
        loads, firsts = np.unique(places, return_index=True)
        for k, rows in zip(loads, np.split(np.arange(len(q)), firsts[1:]), strict=True):
            given: dict[str, Any] = {} if used is None else {'payload': _payload(used, k - 1)}
            rows = rows[good[rows]]
            if len(rows):
                values[rows, :2] = kernel(q[rows], qd[rows], **given)
    except (ValueError, RuntimeError) as error:
        run.notes[one_line(f'no energy: {error}')] = None
        return
    values[:, 2] = values[:, :2].sum(axis=1)
    source = 'computed from the recorded states'
    yield Plot('energy [J]', source, ENERGIES, joints.time, values, False, breaks=joints.gaps)


def _payload(found: TopicArrays, k: int) -> pfd.Payload | None:
    row = [float(found.arrays[f'inertia.{path}'][k]) for path in PAYLOAD] if k >= 0 else [0.0]
    return payload_from(row) if row[0] > 0.0 else None


def _packed(array: Array, kind: str) -> str:
    """Return numbers as base64 of deflated bytes, all first bytes before all second ones."""
    planes = np.ascontiguousarray(array, kind).view(np.uint8).reshape(-1, np.dtype(kind).itemsize)
    return base64.b64encode(zlib.compress(planes.T.tobytes(), 6)).decode()


def _thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """Return all samples, or the least and the largest of equal bins: no peak is lost."""
    stride = -(-2 * len(time) // MOST_POINTS)
    if len(time) <= MOST_POINTS:
        return time, values
    fill = -len(time) % stride
    parts = np.concatenate([values, np.repeat(values[-1:], fill, axis=0)])
    parts = parts.reshape(-1, stride, values.shape[1])
    low, high = (pick.reduce(parts, axis=1) for pick in (np.fmin, np.fmax))
    both = np.stack([low, high], axis=1).reshape(-1, values.shape[1])
    return np.repeat(time[::stride], 2), both


def encoded(plot: Plot) -> dict[str, Any]:
    """Return a plot as the script of a page decodes it."""
    # A line that crosses missing states would show what nobody saw.
    time = np.insert(plot.time, plot.breaks, plot.time[plot.breaks - 1])
    values = np.insert(np.asarray(plot.values, float), plot.breaks, np.nan, axis=0)
    time, values = _thinned(time, np.where(np.isfinite(values), values, np.nan))
    ticks = np.round((time - time[0]) * 1e6)
    bounds = [] if plot.bounds is None else plot.bounds.tolist()
    return {
        'title': plot.title,
        'source': plot.source,
        'labels': [one_line(x, 64) for x in plot.labels],
        'joints': plot.joints,
        'stepped': plot.stepped,
        'limits': [[x if np.isfinite(x) else None for x in side] for side in bounds],
        'references': plot.references,
        'start': float(time[0]),
        'time': _packed(np.diff(ticks, prepend=0.0).clip(0, 2**32 - 1), '<u4'),
        'values': _packed(values.clip(-LARGEST, LARGEST).T, '<f4'),
    }
