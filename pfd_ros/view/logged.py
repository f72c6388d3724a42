# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A log in a page: its model, joint states, the path of its tip, and what acts on its last link.

A recording of the node holds the wrench on its tip and its payload as outputs. Other logs are
searched for topics with their names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.description import parsed_urdf
from pfd_ros.arm.events import STATES
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.types import JOINT_STATE, STRING
from pfd_ros.recording.arrays import LogArrays, read_log, renamed
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import cut, listed, one_line
from pfd_ros.view.arm import Stage
from pfd_ros.view.forms import draw
from pfd_ros.view.links import Array, LinkPoses, folder_of, named_model, with_meshes
from pfd_ros.view.loads import PAYLOADS, WRENCHES, Load, Source
from pfd_ros.view.meshes import Meshes

# Positions beyond this [rad, m] are not drawn.
LARGEST_POSITION = 1e6
# States of which the bounds of the motion are taken, and points of the path of the tip.
SAMPLES, POINTS = 50, 2000


class ShownLog:
    """The motion of an arm in a log, with N states, of the joints that log and model have.

    Parameters
    ----------
    path
        The log.
    robot
        The model, as `load_robot` takes it, in place of the one in the log.
    topic
        The topic of joint states; default: joint_states, or else the one with most joints of the
        model.
    packages, rename
        As `Meshes` and `renamed` take them.
    wrench_topic
        A topic of wrenches, in place of the one by its role or name.
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

    def __init__(
        self,
        path: Path,
        robot: str | None = None,
        topic: str | None = None,
        packages: tuple[Path, ...] = (),
        rename: Mapping[str, str] | None = None,
        wrench_topic: str | None = None,
        other: pfd.Urdf | None = None,
    ) -> None:
        types = JOINT_STATE, STRING, WRENCHES.type, PAYLOADS.type
        log = renamed(read_log(path, types=types, unreadable='count'), rename or {})
        problems: dict[str, None] = {}
        if not log.complete:
            problems[f'{path} was cut off: it is shown up to the cut'] = None
        self.urdf, folder = _model(log, robot, other, problems)
        # Lines on what of the shown topics cannot be read.
        self.unreadable: list[str] = []
        states = self._states(log, topic, problems)
        self.joints = tuple(name for name in states.names if name in self.urdf.joints)
        unknown = [name for name in states.names if name not in self.urdf.joints]
        if unknown:
            text = f'{len(unknown)} joints of the log are not in the model: {listed(unknown)}'
            problems[text] = None
        ns, order = states.log_ns, np.arange(len(states))
        stamps = states.stamp_ns
        if stamps is not None and (len(stamps) == 1 or np.ptp(stamps) > 0):
            order = np.argsort(stamps, kind='stable')
            ns = stamps[order]
        else:
            problems['the stamps do not increase: times are log times'] = None
        # From the first state [s], (N,), not decreasing; and its time, as the log has it.
        self.time, self.start = (ns - ns[0]) / NANOSECONDS, float(ns[0] / NANOSECONDS)
        columns = [states.names.index(name) for name in self.joints]
        # (N, joints) [rad, m], [N m, N]; efforts without any value are NaN.
        position, self.effort = (
            _filled(getattr(states, item)[order][:, columns]) for item in ('position', 'effort')
        )
        if not np.isfinite(position).any():
            problems['no positions: the arm is shown at zero'] = None
        self.position = np.nan_to_num(position)
        self.poses = LinkPoses(self.urdf, self.joints)
        recorded = None if log.robot is None else log.robot.tip
        self.tip = recorded if recorded in self.poses.links else self.poses.tip
        self.wrench, self.payload = (
            self._acting(log, source, wanted, (ns, states.log_ns[order]), problems)
            for source, wanted in ((WRENCHES, wrench_topic), (PAYLOADS, None))
        )
        self.drawing = draw(self.urdf, Meshes(folder, packages))
        self.problems = (*map(one_line, problems), *self.drawing.problems)

    def fill(self, server: Any, ghost: ShownLog | None = None) -> Callable[[float], None]:
        """Draw the log in an empty page; return a function that shows a time [s]."""
        largest = np.max(np.abs(np.nan_to_num(self.effort)), axis=0, initial=0.0)
        stage = Stage(server, self.urdf, self.drawing, self.joints, largest)
        move = None if ghost is None else stage.ghost(ghost.drawing, ghost.poses)
        offset = 0.0 if ghost is None else self.offset(ghost) or 0.0
        tip = self.poses.links.index(self.tip)
        rows = np.unique(np.linspace(0, len(self.time) - 1, POINTS).astype(int))
        stage.path(np.array([self.poses.at(q)[tip, :3, 3] for q in self.position[rows]]))
        stage.look(self.position[rows[:: max(len(rows) // SAMPLES, 1)]])

        def show(time: float) -> None:
            with server.atomic():
                k = self._row(time)
                stage.show(self.position[k], self.effort[k], self.wrench[k], self.payload[k])
                if ghost is not None and move is not None:
                    move(ghost.poses.at(ghost.position[ghost._row(time - offset)]))

        return show

    def offset(self, ghost: ShownLog) -> float | None:
        """Return the time [s] at which a ghost starts, None if both have no time in common."""
        offset = ghost.start - self.start
        return offset if -ghost.time[-1] <= offset <= self.time[-1] else None

    def _states(self, log: LogArrays, topic: str | None, problems: dict[str, None]) -> TopicArrays:
        """Return the joint states to show."""
        known = {t: x.names for t, x in log.of_type(JOINT_STATE).items()}
        if topic is None and not known:
            raise ValueError(
                '; '.join(log.lost(log)) or f'{log.path} has no messages of {JOINT_STATE}'
            )
        joints = self.urdf.joints
        named = [t for t in known if t.rpartition('/')[2] == STATES] or [*known]
        chosen = topic or max(named, key=lambda t: len({*known[t]} & joints.keys()))
        if topic is None and len(named) > 1:
            line = f'several topics of joint states, {listed(named)}: shown is {cut(chosen)}'
            problems[f'{line}; --topic names another'] = None
        self.unreadable += log.lost([chosen])
        found = log.required(chosen, JOINT_STATE)
        if joints.keys().isdisjoint(found.names):
            raise ValueError(
                f'no joint of {cut(chosen)} in {log.path} is one of the model: it has '
                f'{listed(found.names)}, the model {listed(list(joints))}; --robot names another '
                'model, --rename OLD=NEW other beginnings of names'
            )
        return found

    def _acting(
        self,
        log: LogArrays,
        source: Source,
        topic: str | None,
        times_ns: tuple[NDArray[np.int64], NDArray[np.int64]],
        problems: dict[str, None],
    ) -> list[Load | None]:
        """Return a load in each of the states, by their times and their log times."""
        if topic is not None:
            log.required(topic, source.type)
        elif log.roles:
            topic = log.topic_of(source.role)
        else:
            there = [t for t in sorted(log) if log.topics[t] == source.type]
            there = [t for t in there if len(log.received_ns[t])]
            named = (t for name in source.names for t in there if t.rpartition('/')[2] == name)
            topic = next(named, '')
        self.unreadable += log.lost([topic])
        if topic not in log.of_type(source.type):
            return [None] * len(times_ns[0])
        found = log[topic]
        numbers = np.stack([found.arrays[path] for path in source.paths], axis=1).tolist()
        loads = [
            source.load(
                frame, tuple(row), self.poses.links, lambda line: problems.setdefault(line)
            )
            for frame, row in zip(found.arrays['header.frame_id'], numbers, strict=True)
        ]
        ours = found.simulated_ns
        # Elsewhere it acts from the first state on that was logged with it or after it.
        begins, times = (found.log_ns, times_ns[1]) if ours is None else (ours, times_ns[0])
        # The last place is of the states before the first message.
        loads.append(None)
        return [loads[k] for k in np.searchsorted(begins, times, side='right') - 1]

    def _row(self, time: float) -> int:
        """Return the row of the last state at or before a time [s], 0 before the first."""
        return max(int(np.searchsorted(self.time, time, side='right')) - 1, 0)


def _model(
    log: LogArrays, robot: str | None, other: pfd.Urdf | None, problems: dict[str, None]
) -> tuple[pfd.Urdf, Path | None]:
    """Return the model that is named, or the first URDF or the robot in a log, and its folder."""
    if robot is not None:
        return named_model(robot)
    folder = folder_of(str((log.settings or {}).get('robot', '')))
    if found := log.descriptions():
        topic, topics = next(iter(found.values())), [*dict.fromkeys(found.values())]
        if len(found) > 1:
            line = f'several robots on {listed(topics)}: shown is the last of {cut(topic)}'
            problems[f'{line}; --robot names another'] = None
        text = str(log[topic].data[-1])
        return with_meshes(parsed_urdf(text, f'{topic} of {log.path}'), folder)
    if log.robot is not None:
        text = pfd.robot_to_urdf(log.robot)
        return with_meshes(parsed_urdf(text, f'the robot in {log.path}'), folder)
    if other is not None:
        return other, folder
    raise ValueError(
        f'{log.path} has no robot_description: name the robot with --robot (a URDF, or a name '
        'that `pfd robots` lists)'
    )


def _filled(values: Array) -> Array:
    """Return values (N, k) with each gap filled by the value before it; NaN before the first."""
    there = np.abs(values) <= LARGEST_POSITION
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], 0), axis=0)
    return np.take_along_axis(np.where(there, values, np.nan), last, axis=0)
