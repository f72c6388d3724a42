# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in this process, in lockstep with a controller.

    arm = LockstepArm(robot='ur5', publish_rate=500)
    motion = arm.run(controller, 2.0)          controller(t, q, qd) -> tau
    motion = arm.spin(2.0, node)               nodes over topics

It is the arm of the node with validation, recording and outputs, but without ROS, clock and
threads. The same settings and controller give the same bits, here and over topics, in each run.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from itertools import chain
import os
from pathlib import Path
from typing import Any, TypeAlias
import warnings

import numpy as np
from numpy.typing import ArrayLike

import pfd_core as pfd
from pfd_ros.arm import events
from pfd_ros.arm.description import DescribedRobot, described_robot, with_start
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Message, Verdict
from pfd_ros.arm.other_inputs import encode_changes, encode_request
from pfd_ros.arm.plant import with_scene_text
from pfd_ros.arm.settings import FIELDS, Settings, split_joints, with_joint_numbers
from pfd_ros.arm.state import State
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import encode_joints
from pfd_ros.messages.types import WRENCH as WRENCH_STAMPED
from pfd_ros.messages.values import encode_numbers
from pfd_ros.motion.metrics import Array
from pfd_ros.recording.recorder import Recorder, topic_names
from pfd_ros.replay.inputs import Input, run_inputs
from pfd_ros.testing.loop import (
    ArmError,
    CallbackLink,
    Controller,
    checked_reasons,
    run,
    seconds_of,
)
from pfd_ros.testing.patience import PATIENCE_SECONDS, START_PATIENCE_SECONDS, Watch
from pfd_ros.testing.process import check_words, plain
from pfd_ros.testing.trajectory import Trajectory, checked_numbers
from pfd_ros.text import cut, did_you_mean

# Numbers in published order, or by joint name.
JointValues: TypeAlias = ArrayLike | Mapping[str, float]
# The settings that make a run the same each time: the loop holds the arm, not the engine.
FIXED: Mapping[str, Any] = {
    'lockstep': False,
    'real_time_factor': 0.0,
    'autostart': True,
    'time_source': 'own',
}
# Inputs that are kept to run again after a failure, some hundred bytes each.
MOST_INPUTS = 400_000


class RecordingError(Exception):
    """The recording is incomplete."""


class LockstepArm:
    """The simulated arm in lockstep with controllers.

    Parameters
    ----------
    robot
        As for the node: a name, a path, a URDF; or a pfd_core.Robot.
    ros_args
        Arguments of the node for `spin`, such as remappings, as on a command line; no settings.
    **settings
        Fields of pfd_ros.arm.settings.Settings; numbers of joints may also be a mapping,
        ``friction={'elbow_joint': 3.0}``, or given as ``**{'friction.elbow_joint': 3.0}``. A
        control period is the time from one state to the next: one step, or 1 / publish_rate. With
        `recording` the run is written to an MCAP file that `pfd replay --verify` checks.

    Attributes
    ----------
    robot, names
        Robot, and joints in published order, the order of all arrays.
    period
        The control period, s of simulated time.
    recording
        The file that it records, '' for none, whatever state it continues from.
    pushes
        Time [s], and force and torque (6,) of each push since the start or the restored state;
        () of a reset, which ends one.

    ValueError for a setting that is unknown, refused, or has another value in tests; OSError if
    the recording exists or cannot be written.
    """

    def __init__(
        self,
        robot: str | os.PathLike[str] | pfd.Robot,
        *,
        ros_args: Sequence[str] = (),
        **settings: Any,
    ) -> None:
        check_words('ros_args', ros_args)
        self._given, self._ros_args = (robot, settings), ros_args
        self._described = _described(robot, settings)
        self.robot, self.recording = self._described.robot, self._described.settings.recording
        self._log: Recorder | None = None
        # Nothing is encoded until anybody reads it.
        self.engine = self._new_engine(())
        self.names = self.engine.names
        self.period = self.settings.publish_every * self.settings.step_ns / NANOSECONDS
        # The state that the arm was restored to, None for the start; and the inputs since then:
        # the cycles before, role, bytes.
        self.start: State | None = None
        self._inputs: list[tuple[int, str, bytes]] = []
        self.pushes: list[tuple[float, Sequence[float]]] = []

    def _new_engine(self, roles: Collection[str]) -> Engine:
        """Return an engine at the start of the run; open the recording, if there is to be one."""
        settings = self._described.settings
        if not settings.recording:
            return Engine(settings, self.robot, roles)
        frames = self._described.recorded_frames(settings, warnings.warn)
        engine = Engine(settings, self.robot, events.ALL, frames)
        recorded = {*events.ALL - events.ASIDES, events.REJECTED_COUNTS}
        recorded |= {*frames.roles} if frames else set()
        self._log = Recorder(settings.recording, engine, topic_names(recorded), lambda line: None)
        return engine

    def __enter__(self) -> LockstepArm:
        """Return the arm."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the recording."""
        self.close()

    def close(self) -> None:
        """Close the recording, if any; RecordingError if the file does not hold everything."""
        log, self._log = self._log, None
        if log is not None:
            log.close()
            if log.error:
                raise RecordingError(log.error)

    @property
    def settings(self) -> Settings:
        """The settings now, with 'auto' resolved."""
        return self.engine.state.settings

    @property
    def time(self) -> float:
        """The stamp of the last state, s of simulated time."""
        return seconds_of(self.engine.stamp_ns)

    @property
    def q(self) -> Array:
        """Positions in the last state, (n,), rad or m; a copy."""
        return np.array(self.engine.measured()[0])

    @property
    def qd(self) -> Array:
        """Velocities in the last state, (n,), rad/s or m/s; a copy."""
        return np.array(self.engine.measured()[1])

    def run(
        self, controller: Controller, seconds: float, *, patience: float = PATIENCE_SECONDS
    ) -> Trajectory:
        """Run a controller for some simulated seconds; return the motion.

        Parameters
        ----------
        controller
            Called as controller(t, q, qd) at the start of each control period, with the stamp [s]
            and the values (n,) of the last state; returns efforts (n,) for the period.
        seconds
            Simulated time. Another run begins one control period after the last row of the motion.
        patience
            Longest wall time of one call, s; infinite for a debugger. It works in the main thread,
            and interrupts Python code that waits.

        ControllerError if the controller raises, blocks, or returns anything but a finite effort
        for each joint: the arm keeps the state passed to it. ArmError if the state does not stay
        finite.
        """
        with Watch(patience) as watch:
            return run(self, CallbackLink(controller, self.names, watch), seconds)

    def spin(
        self,
        seconds: float,
        *controllers: Any,
        controller_period: float | None = None,
        patience: float = PATIENCE_SECONDS,
        start_patience: float = START_PATIENCE_SECONDS,
        allow_rejected: Collection[str] = (),
    ) -> Trajectory:
        """Run controllers over topics for some simulated seconds; return the motion.

        The arm publishes a state, then its clock tick. After each message it waits until all nodes
        have finished what follows from it: their callbacks, and timers on the node's clock. rclpy
        must be initialised, as by the fixture `ros_domain`.

        Parameters
        ----------
        controllers
            rclpy nodes of this process, which are run meanwhile, and processes that the fixture
            `controller_process` started, whose end ends the run. Nodes elsewhere in the domain are
            found.
        controller_period
            Longest simulated time between commands that is accepted, s; None for any.
        patience
            Longest wall time that the nodes may need for a message, s; infinite for a debugger.
        start_patience
            Longest wait until a controller in another process has started, s of wall time.
        allow_rejected
            Reasons for which the arm may reject commands, of pfd_ros.testing.REASONS. 'all_nan'
            includes NaN by name for some joints, 'unknown_names' some unknown names.

        ControllerError if a node of this process raises or blocks; RejectedError if the arm
        rejects a command for another reason; NoAnswerError if nodes do not finish, command
        nothing, or end; ArmError if the state does not stay finite.
        """
        from pfd_ros.testing.nodes import node_link

        allowed = checked_reasons(allow_rejected)
        if controller_period is not None:
            name, text = 'controller_period', 'one number above 0'
            checked_numbers(name, controller_period, ((),), text, lambda x: x > 0.0)
        if not self.engine.roles:
            state, self.engine = self.engine.save(), self._new_engine(events.ALL)
            self.engine.restore(state)
        given = self._described, self.engine, self._ros_args, controllers, patience
        with node_link(*given) as link:
            link.begin(controller_period, start_patience, self.start is not None)
            motion = run(self, link, seconds, allowed)
            link.check_end(seconds)
            return motion

    def step(
        self, commands: Sequence[Any] = (), every: int = 1
    ) -> tuple[list[Message], list[Verdict]]:
        """Take commands, role and bytes, and run to the next cycle that `every` divides.

        Return the messages that anybody needs, and a verdict for each command. ArmError if the
        state does not stay finite.
        """
        engine, inputs = self.engine, self._inputs
        state = engine.state
        if len(inputs) < MOST_INPUTS:
            for role, data in commands:
                inputs.append((state.cycle, role, data))
        messages, verdicts = engine.step(commands)
        while state.cycle % every:
            messages += engine.step()[0]
        self._record(messages)
        if state.failure:
            raise ArmError(f't = {self.time:.6g} s: {state.failure}')
        return messages, verdicts

    def _record(self, messages: Sequence[Message]) -> None:
        if self._log is not None:
            self._log.put_slowly(messages, self.engine.stamp_ns)

    def _demand(self, role: str, data: bytes) -> None:
        """Send a message that the next cycle takes; ValueError if the arm does not accept it."""
        self._inputs.append((self.engine.state.cycle, role, data))
        messages, (verdict,) = self.engine.step([Message(role, data)], run=False)
        self._record(messages)
        if not verdict.accepted:
            raise ValueError(f'{verdict.label}: {verdict.detail}')
        for remark in verdict.remarks:
            warnings.warn(f'{role}: {remark.detail}', pfd.PhysicsWarning, stacklevel=3)

    def reset(self) -> None:
        """Restore the initial state, braked until the next command; simulated time continues."""
        self._demand(events.REQUESTS, encode_request('reset'))
        self.pushes.append((self.time, ()))
        self.step()

    def set_state(self, q: JointValues, qd: JointValues | None = None) -> None:
        """Set positions and velocities (n,), or by joint name; it takes one step.

        Joints without a position keep theirs, and joints without a velocity are at rest.
        ValueError if the state is invalid.
        """
        positions = _by_joint(self.names, 'q', q)
        velocities = _by_joint(self.names, 'qd', {} if qd is None else qd)
        self._demand(events.SET_STATE, encode_joints(self.names, positions, velocities))
        self.step()

    def push(self, force: Sequence[float], torque: Sequence[float], frame: str = '') -> None:
        """Apply a force and a torque to the last link until the next push or a reset.

        They are expressed in a frame on the last link, by default the link's frame, and act at its
        origin, N and N m. The arm needs the setting external_wrench=True; external_wrench_timeout
        ends them.
        """
        vectors = (('force', force), ('torque', torque))
        halves = [checked_numbers(name, x, ((3,),), '3 finite numbers') for name, x in vectors]
        wrench, frame = np.concatenate(halves).tolist(), frame or self.robot.tip
        self._demand(events.WRENCH, encode_numbers(WRENCH_STAMPED, 0, frame, wrench))
        self.pushes.append((self.time, wrench))

    def set(self, **values: Any) -> None:
        """Change dynamic settings from the next step on, also of single joints, as at the start.

        ValueError if one is invalid.
        """
        chosen, numbers = split_joints(plain(values))
        _check_names({**chosen, **numbers})
        settings = with_joint_numbers(self.settings, self.robot, numbers)
        chosen |= {field: getattr(settings, field) for field in numbers}
        self._demand(events.PARAMETERS, encode_changes(chosen))

    def save(self) -> State:
        """Return a copy of the state of the arm, from which `restore` continues with equal bits.

        It can be copied and pickled, within one version of this package.
        """
        return self.engine.save()

    def restore(self, state: State) -> None:
        """Continue from a saved state, of this arm or another one with the same settings.

        ValueError for a state of another robot or with other settings at its start, and in a
        recorded run, as a recording holds one run.
        """
        if self._log is not None:
            raise ValueError(
                f'this run is recorded in {self.recording!r}, and a recording holds one '
                'run from its start: restore a state in an arm without recording'
            )
        self.engine.restore(state)
        self.start = self.engine.save()
        self._inputs.clear()
        self.pushes.clear()

    def record_again(self, path: Path) -> str:
        """Run an unrecorded arm again with the same inputs, hence with the same bits, recorded.

        Return a line about what is wrong with the recording, or ''. ValueError if there were too
        many inputs to keep, OSError if the file exists or cannot be written.
        """
        if len(self._inputs) >= MOST_INPUTS:
            raise ValueError('the inputs of this run are too many: record it with recording=...')
        robot, settings = self._given
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # the first arm has warned
            again = LockstepArm(robot, **{**settings, 'recording': str(path)})
        with again:
            if self.start is not None:
                again.engine.restore(self.start)
            inputs = (Input(Message(role, data), at + 1) for at, role, data in self._inputs)
            every = chain(inputs, [Input(None, self.engine.state.cycle + 1)])
            run_inputs(every, again.engine, lambda messages, _: again._record(messages))
        if again.q.tobytes() != self.q.tobytes():
            return 'the arm was run again, and its last state differs'
        if self.start is not None:
            return 'the arm was restored from a saved state: the log begins there, not verifiable'
        return ''


def _described(robot: Any, given: Mapping[str, Any]) -> DescribedRobot:
    """Return robot and settings of an arm in tests: the first stamp is one step above zero."""
    chosen, numbers = split_joints(plain(given))
    _check_names({**chosen, **numbers})
    for name, value in FIXED.items():
        if chosen.get(name, value) != value:
            raise ValueError(f'{name} is {chosen[name]!r}, expected {value!r} in tests')
    name = robot.name if isinstance(robot, pfd.Robot) else os.fspath(robot)
    settings = Settings.from_values({**chosen, **FIXED, 'robot': name})
    if 'start_time' not in chosen:
        # Zero means 'no time' to ROS.
        settings = replace(settings, start_time=settings.step_size)
    settings = with_scene_text(settings)
    if not isinstance(robot, pfd.Robot):
        found = described_robot(settings, settings.robot)
    elif settings.base_link or settings.tip_link or settings.locked:
        raise ValueError(
            'base_link, tip_link and locked cannot be given with a pfd.Robot: name its file'
        )
    else:
        found = with_start(DescribedRobot(robot, settings))
    return replace(found, settings=with_joint_numbers(found.settings, found.robot, numbers))


def _check_names(names: Collection[str]) -> None:
    """Raise ValueError for the first unknown setting, with the most similar one."""
    known = [row.field for row in FIELDS]
    for name in names:
        if name not in known:
            # In the package, in a checkout next to it.
            package = Path(pfd.__file__).parent
            paths = (folder / 'config' / 'sim_arm.yaml' for folder in (package, package.parent))
            listed = next((path for path in paths if path.is_file()), 'sim_arm.yaml')
            hint = did_you_mean(name.replace('.', '_'), known, f'{listed} has them all')
            methods = (LockstepArm.run, LockstepArm.spin)
            owners = [m.__name__ for m in methods if name in signature(m).parameters]
            if owners:
                hint = f'it is an argument of {" and ".join(owners)}'
            raise ValueError(f'unknown setting {cut(name)!r}: {hint}')


def _by_joint(names: Sequence[str], label: str, values: JointValues) -> Array:
    """Return a number for each joint (n,), NaN for joints without one; ValueError for others."""
    if isinstance(values, Mapping):
        unknown = sorted(set(values) - set(names))
        if unknown:
            raise ValueError(f'{label} names {unknown}, expected joints of {list(names)}')
        values = [values.get(joint, np.nan) for joint in names]
    return checked_numbers(label, values, ((len(names),),), f'({len(names)},) numbers', np.isreal)
