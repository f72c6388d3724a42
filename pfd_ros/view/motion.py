# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion of an arm in a log: joint states over time, and the model that the log contains."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION, STATES
from pfd_ros.arm.link_frames import parsed_urdf
from pfd_ros.messages.convert import INERTIA, JOINT_STATE, NANOSECONDS, STRING, WRENCH
from pfd_ros.recording.arrays import LogArrays, TopicArrays, read_log
from pfd_ros.text import listed

# The types that a view reads; all others stay in the file.
TYPES = (JOINT_STATE, STRING, WRENCH, INERTIA)
# Positions beyond this [rad, m] are not drawn.
LARGEST_POSITION = 1e6
NO_MODEL = (
    'has no robot_description: name the robot with --robot (a URDF, or a name that '
    '`pfd robots` lists)'
)
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """
    Joint states at N times.

    Attributes
    ----------
    time : ndarray, (N,)
        From the first state [s], not decreasing.
    start_ns : int
        Time of the first state, as the log has it [ns].
    joints : tuple of str
        Joints of the model that the log names.
    position, effort : ndarray, (N, joints)
        [rad, m], [N m, N]. A value that the log lacks is the one before, or 0; efforts without
        any value are NaN.
    log_ns : ndarray of int64, (N,)
        Log times [ns].
    stamped : bool
        Whether times are stamps; log times otherwise.

    """

    time: Array
    start_ns: int
    joints: tuple[str, ...]
    position: Array
    effort: Array
    log_ns: NDArray[np.int64]
    stamped: bool = False

    @property
    def start(self) -> float:
        """Time of the first state, as the log has it [s]."""
        return self.start_ns / NANOSECONDS

    @property
    def duration(self) -> float:
        """Time of the last state [s]."""
        return float(self.time[-1])

    def at(self, time: float) -> int:
        """Return the place of the last state at or before a time [s], 0 before the first."""
        return max(int(np.searchsorted(self.time, time, side='right')) - 1, 0)


# Of a log without states: one state, without joints.
NO_MOTION = Motion(np.zeros(1), 0, (), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1, np.int64))


@dataclass(frozen=True)
class Seen:
    """A log to be shown: its model, its motion, and lines on what it lacks."""

    urdf: pfd.Urdf
    motion: Motion
    problems: tuple[str, ...]
    log: LogArrays
    folder: Path | None


def read(path: Path, robot: str | None, topic: str | None, other: pfd.Urdf | None = None) -> Seen:
    """
    Return what a log shows.

    Parameters
    ----------
    path : Path
        The log, as `read_log` takes it.
    robot : str or None
        The model, as `load_robot` takes it, in place of the one in the log.
    topic : str or None
        The topic of joint states; default: joint_states, or else the one with most joints of
        the model.
    other : Urdf, optional
        The model of a log that has none.

    Raises
    ------
    ValueError
        If the log cannot be read, or there is no model.
    OSError
        If a file cannot be read.

    """
    log = read_log(path, types=TYPES)
    urdf = model_of(log, robot, other)
    problems = []
    if not log.complete:
        problems.append(f'{path} was cut off or not closed: it is shown up to the cut')
    chosen = _topic(log, topic, urdf)
    if chosen is None:
        problems.append(f'{path} has no {JOINT_STATE}: the arm is shown at zero')
        motion = NO_MOTION
    else:
        motion, more = motion_of(log[chosen], urdf)
        problems += [f'{chosen}: {line}' for line in more]
    return Seen(urdf, motion, tuple(problems), log, folder_of(log, robot))


def model_of(log: LogArrays, robot: str | None, other: pfd.Urdf | None) -> pfd.Urdf:
    """Return the model to draw: the one named, or the URDF or the robot that a log contains."""
    if robot is not None:
        return named_model(robot)
    for topic in (name for name in log if name.rpartition('/')[2] == DESCRIPTION):
        if log.topics[topic] == STRING and len(log[topic]):
            return parsed_urdf(str(log[topic].data[-1]), f'{topic} of {log.path}')
    if log.robot is None and other is not None:
        return other
    if log.robot is None:
        raise ValueError(f'{log.path} {NO_MODEL}')
    return parsed_urdf(pfd.robot_to_urdf(log.robot), f'the robot in {log.path}')


def named_model(robot: str) -> pfd.Urdf:
    """Return the model of a robot, as `load_robot` takes it."""
    return pfd.read_urdf(robot) or parsed_urdf(pfd.urdf_of(robot), robot)


def folder_of(log: LogArrays | None, robot: str | None) -> Path | None:
    """Return the folder of the file that a model comes from, None if it is unknown."""
    source = robot or str(((log and log.settings) or {}).get('robot', ''))
    try:
        path = Path(source)
        return path.absolute().parent if source and path.is_file() else None
    except (OSError, ValueError):  # a text that is no path
        return None


def _topic(log: LogArrays, topic: str | None, urdf: pfd.Urdf) -> str | None:
    states = [name for name in log if log.topics[name] == JOINT_STATE]
    if topic is not None:
        if topic not in states:
            raise ValueError(
                f'{log.path} has no topic {topic!r} of {JOINT_STATE}; it has {listed(states)}'
            )
        return topic
    known = {name: len(set(log[name].names) & urdf.joints.keys()) for name in states}
    filled = [name for name in states if known[name] and _has_positions(log[name])]
    named = [name for name in filled if name.rpartition('/')[2] == STATES]
    return max(named or filled or states, key=lambda name: known[name], default=None)


def _has_positions(states: TopicArrays) -> bool:
    return bool(np.isfinite(states.position).any())


def motion_of(states: TopicArrays, urdf: pfd.Urdf) -> tuple[Motion, list[str]]:
    """Return the motion of a topic's joint states, and lines on what cannot be shown of it."""
    problems = []
    joints = tuple(name for name in states.names if name in urdf.joints)
    unknown = [name for name in states.names if name not in urdf.joints]
    if unknown:
        problems.append(f'{len(unknown)} joints are not in the model: {listed(unknown)}')
    if not len(states):
        problems.append('no readable message: the arm is shown at zero')
        return NO_MOTION, problems
    if not joints:
        problems.append('no joint of the model: the arm is shown at zero')
    elif not _has_positions(states):
        problems.append('no positions: the arm is shown at zero')
    times = states.stamp_ns
    order = np.arange(len(states))
    stamped = times is not None and (
        len(times) == 1 or bool(np.all(np.diff(times) >= 0) and times[-1] > times[0])
    )
    if times is None or not stamped:
        times = states.log_ns
        order = np.argsort(times, kind='stable')
        if states.stamp_ns is not None and len(states) > 1:
            problems.append('the stamps do not increase: times are log times')
    sorted_ns = times[order]
    columns = [states.names.index(name) for name in joints]
    values = [
        _filled(np.asarray(item, float)[order][:, columns])
        for item in (states.position, states.effort)
    ]
    position = np.nan_to_num(values[0])
    seconds = (sorted_ns - sorted_ns[0]) / NANOSECONDS
    start_ns, log_ns = int(sorted_ns[0]), states.log_ns[order]
    return Motion(seconds, start_ns, joints, position, values[1], log_ns, stamped), problems


def _filled(values: Array) -> Array:
    """Return values (N, k) with each gap filled by the value before it; NaN before the first."""
    there = np.abs(values) <= LARGEST_POSITION
    rows = np.where(there, np.arange(len(values))[:, None], 0)
    last = np.maximum.accumulate(rows, axis=0)
    found = np.take_along_axis(values, last, axis=0)
    found[~np.take_along_axis(there, last, axis=0)] = np.nan
    return found
