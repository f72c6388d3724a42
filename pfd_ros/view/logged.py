# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a log shows: the model that it contains, joint states, and what acts on the last link.

A recording of the node holds the wrench on its tip and its payload as outputs. Other logs are
searched for topics with their names.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION, PAYLOAD_IN_USE, STATES, TIP_WRENCH
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.types import INERTIA, JOINT_STATE, STRING, WRENCH
from pfd_ros.recording.arrays import LogArrays, read_log, renamed
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import cut, listed, one_line
from pfd_ros.view.arm import LinkPoses
from pfd_ros.view.forms import named_model, parsed_urdf
from pfd_ros.view.loads import Payload, Wrench

# Positions beyond this [rad, m] are not drawn.
LARGEST_POSITION = 1e6
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Logged:
    """The motion of an arm in a log, with N states.

    Attributes
    ----------
    urdf, folder
        The model, and the folder of its file, None if it has none.
    joints
        Joints of the model that the log names.
    time
        From the first state [s], (N,), not decreasing.
    start
        Time of the first state, as the log has it [s].
    position, effort
        (N, joints) [rad, m], [N m, N]. A value that a message lacks is the one before, or 0;
        efforts without any value are NaN.
    wrench, payload
        What acts on the last link in each state, (N,), None for nothing.
    tip
        The link whose path is drawn.
    problems
        What the log lacks, a line each.
    unreadable
        Number of joint states that cannot be decoded.
    """

    urdf: pfd.Urdf
    folder: Path | None
    joints: tuple[str, ...]
    time: Array
    start: float
    position: Array
    effort: Array
    wrench: list[Wrench | None]
    payload: list[Payload | None]
    tip: str
    problems: tuple[str, ...]
    unreadable: int = 0


def logged(
    path: Path,
    *,
    robot: str | None = None,
    topic: str | None = None,
    wrench_topic: str | None = None,
    rename: Mapping[str, str] | None = None,
    start: float | None = None,
    end: float | None = None,
    other: pfd.Urdf | None = None,
) -> Logged:
    """
    Return what a log shows.

    Parameters
    ----------
    path, start, end
        The log and a window of it, as `read_log` takes them.
    robot
        The model, as `load_robot` takes it, in place of the one in the log.
    topic
        The topic of joint states; default: joint_states, or else the one with most joints of the
        model.
    wrench_topic
        A topic of wrenches, in place of the one by its role or name.
    rename
        As `renamed` takes it.
    other
        The model of a log that has none.

    Raises
    ------
    ValueError
        If the log cannot be read, has no joint states or none of the model's joints, there is no
        model, or no such topic.
    OSError
        If a file cannot be read.
    """
    types = JOINT_STATE, STRING, WRENCH, INERTIA
    log = read_log(path, types=types, start=start, end=end, unreadable='count')
    log = renamed(log, rename or {})
    problems: dict[str, None] = {}
    if not log.complete:
        problems[f'{path} was cut off: it is shown up to the cut'] = None
    urdf, folder = _model(log, robot, other)
    states, joints = _states(log, topic, urdf, problems)
    ns, order = _times(states, problems)
    columns = [states.names.index(name) for name in joints]
    position, effort = (
        _filled(getattr(states, item)[order][:, columns]) for item in ('position', 'effort')
    )
    if not np.isfinite(position).any():
        problems['no positions: the arm is shown at zero'] = None
    poses = LinkPoses(urdf, joints)
    tip = '' if log.robot is None else log.robot.tip
    wrench, payload = (
        _acting(log, load, wanted, ns, states.log_ns[order], poses.links, problems)
        for load, wanted in ((_WRENCH, wrench_topic), (_PAYLOAD, None))
    )
    return Logged(
        urdf,
        folder,
        joints,
        (ns - ns[0]) / NANOSECONDS,
        float(ns[0] / NANOSECONDS),
        np.nan_to_num(position),
        effort,
        wrench,
        payload,
        tip if tip in poses.links else poses.tip,
        tuple(map(one_line, problems)),
        states.unreadable,
    )


def _model(
    log: LogArrays, robot: str | None, other: pfd.Urdf | None
) -> tuple[pfd.Urdf, Path | None]:
    """Return the model that is named, or the URDF or the robot in a log, and its folder."""
    source = str((log.settings or {}).get('robot', ''))
    # os.path.isfile is False for a text that is no path.
    folder = Path(source).absolute().parent if os.path.isfile(source) else None
    if robot is not None:
        return named_model(robot)
    for topic in (name for name in log if name.rpartition('/')[2] == DESCRIPTION):
        if log.topics[topic] == STRING and not log.obstacle(topic) and len(log[topic]):
            return parsed_urdf(str(log[topic].data[-1]), f'{topic} of {log.path}'), folder
    if log.robot is not None:
        return parsed_urdf(pfd.robot_to_urdf(log.robot), f'the robot in {log.path}'), folder
    if other is not None:
        return other, folder
    raise ValueError(
        f'{log.path} has no robot_description: name the robot with --robot (a URDF, or a name '
        'that `pfd robots` lists)'
    )


def _states(
    log: LogArrays, topic: str | None, urdf: pfd.Urdf, problems: dict[str, None]
) -> tuple[TopicArrays, tuple[str, ...]]:
    """Return the joint states to show, and the joints of the model among theirs."""
    known = {
        t: set(log[t].names) & urdf.joints.keys() for t in log if _readable(log, t, JOINT_STATE)
    }
    named = [t for t in known if t.rpartition('/')[2] == STATES]
    if topic is None and not known:
        why = [why for t in log if (why := log.obstacle(t))]
        raise ValueError('; '.join(why) or f'{log.path} has no messages of {JOINT_STATE}')
    chosen = topic or max(named or known, key=lambda t: len(known[t]))
    if chosen not in known:
        raise ValueError(
            f'{log.path} has no topic {chosen!r} of {JOINT_STATE}; it has {listed(list(known))}'
        )
    states = log[chosen]
    joints = tuple(name for name in states.names if name in urdf.joints)
    unknown = [name for name in states.names if name not in urdf.joints]
    if not joints:
        raise ValueError(
            f'no joint of {cut(chosen)} in {log.path} is one of the model: it has '
            f'{listed(unknown)}, the model {listed(list(urdf.joints))}; --robot names another '
            'model, --rename OLD=NEW other beginnings of names'
        )
    if unknown:
        problems[f'{chosen}: {len(unknown)} joints are not in the model: {listed(unknown)}'] = None
    if states.unreadable:
        problems[f'{chosen}: {states.unreadable} messages cannot be read'] = None
    return states, joints


def _readable(log: LogArrays, topic: str, kind: str) -> bool:
    return log.topics[topic] == kind and not log.obstacle(topic) and len(log[topic]) > 0


def _times(
    states: TopicArrays, problems: dict[str, None]
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return times of states, not decreasing [ns], and their order: of stamps, or of the log."""
    stamps = states.stamp_ns
    if stamps is not None and (len(stamps) == 1 or stamps.max() > stamps.min()):
        order = np.argsort(stamps, kind='stable')
        return stamps[order], order
    problems['the stamps do not increase: times are log times'] = None
    return states.log_ns, np.arange(len(states))


def _filled(values: Array) -> Array:
    """Return values (N, k) with each gap filled by the value before it; NaN before the first."""
    there = np.abs(values) <= LARGEST_POSITION
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], 0), axis=0)
    found = np.take_along_axis(values, last, axis=0)
    found[~np.take_along_axis(there, last, axis=0)] = np.nan
    return found


class _Load(NamedTuple):
    """Messages about a load: their type, their role, the last names of their topic in other logs.

    `paths` are the fields with their numbers, of which `make` makes a value, None for no load.
    """

    kind: str
    role: str
    names: tuple[str, ...]
    paths: tuple[str, ...]
    make: Callable[[str, list[float]], Any]


_WRENCH = _Load(
    WRENCH,
    TIP_WRENCH,
    ('external_wrench', 'tip_wrench'),
    tuple(f'wrench.{part}.{axis}' for part in ('force', 'torque') for axis in 'xyz'),
    lambda frame, x: Wrench(frame, tuple(x[:3]), tuple(x[3:])) if any(x) else None,
)
_PAYLOAD = _Load(
    INERTIA,
    PAYLOAD_IN_USE,
    ('payload_in_use', 'payload'),
    tuple(
        f'inertia.{field}'
        for field in ('m', 'com.x', 'com.y', 'com.z', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
    ),
    lambda frame, x: Payload(frame, x[0], tuple(x[1:4]), tuple(x[4:])) if x[0] > 0.0 else None,
)


def _acting(
    log: LogArrays,
    load: _Load,
    topic: str | None,
    ns: NDArray[np.int64],
    logged_ns: NDArray[np.int64],
    links: Container[str],
    problems: dict[str, None],
) -> list[Any]:
    """Return a load in each of the states of times `ns` that were logged at `logged_ns`."""
    filled = [name for name in sorted(log) if _readable(log, name, load.kind)]
    if topic is not None and topic not in filled:
        raise ValueError(
            f'{log.path} has no topic {topic!r} of {load.kind}; it has {listed(filled)}'
        )
    if topic is None and log.roles:
        topic = next((name for name in filled if log.roles.get(name) == load.role), None)
    elif topic is None:
        named = (t for name in load.names for t in filled if t.rpartition('/')[2] == name)
        topic = next(named, None)
    if topic is None:
        return [None] * len(ns)
    found, values = log[topic], list[Any]()
    numbers = np.stack([found.arrays[path] for path in load.paths], axis=1)
    for frame, row in zip(found.arrays['header.frame_id'], numbers.tolist(), strict=True):
        value = load.make(frame, row) if np.isfinite(row).all() else None
        if value is not None and frame not in links:
            problem = f'{topic} is not shown: its frame {cut(frame)!r} is no link of the model'
            problems[problem] = value = None
        values.append(value)
    ours = found.simulated_ns
    # Elsewhere it acts from the first state on that was logged with it or after it.
    begins, times = (found.log_ns, logged_ns) if ours is None else (ours, ns)
    # The last place is of the states before the first message.
    values.append(None)
    return [values[k] for k in np.searchsorted(begins, times, side='right') - 1]
