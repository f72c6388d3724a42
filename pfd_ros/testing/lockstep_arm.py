# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in this process, with a controller that is called once a control period.

    arm = LockstepArm(robot='ur5', publish_rate=500)
    trajectory = arm.run(controller, 2.0)          controller(t, q, qd) -> tau

It is the arm of the node with validation, recording and outputs, but without ROS, clock and
threads. The same settings and controller give the same bits, here and over topics (`spin`), in
each run.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any
import warnings

import numpy as np

from pfd_ros.arm.changes import encode_changes
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Request, Source, Verdict
from pfd_ros.arm.joint_numbers import split_joints
from pfd_ros.arm.outputs import roles_of
from pfd_ros.arm.requests import encode_request
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import NANOSECONDS, WRENCH, encode_state
from pfd_ros.messages.stamped import stamped_encoder
from pfd_ros.motion.metrics import Array
from pfd_ros.testing.controller import Controller, asked, blocked, refusal
from pfd_ros.testing.engine_run import EngineRun
from pfd_ros.testing.exchange import Exchange
from pfd_ros.testing.journal import Journal
from pfd_ros.testing.lockstep_settings import (
    JointValues,
    RobotSource,
    by_joint,
    check_names,
    limits_of,
    loaded,
    lockstep_settings,
    period_of,
    plain_values,
    rows_of,
)
from pfd_ros.testing.patience import (
    PATIENCE_SECONDS,
    START_PATIENCE_SECONDS,
    BlockedError,
    Waits,
    Watch,
)
from pfd_ros.testing.received_log import write_received
from pfd_ros.testing.rejections import checked_reasons
from pfd_ros.testing.run_log import open_log
from pfd_ros.testing.topic_run import TopicRun
from pfd_ros.testing.trajectory import Trajectory


class LockstepArm:
    """The simulated arm in lockstep with a controller in this process.

    Parameters
    ----------
    robot
        As for the node: a name, a path, a URDF; or a pfd_core.Robot.
    ros_args
        Arguments of the node for `spin`, such as remappings, as on a command line.
    **settings
        Fields of pfd_ros.arm.settings.Settings; numbers of joints may also be a mapping,
        ``friction={'elbow_joint': 3.0}``, or given as ``**{'friction.elbow_joint': 3.0}``. A
        control period is the time from one state to the next: one step, or 1 / publish_rate. With
        `recording` the run is written to an MCAP file that `pfd replay --verify` checks.

    Attributes
    ----------
    settings, robot, names
        Settings, robot, and joints in published order, the order of all arrays.

    Raises
    ------
    ValueError
        If a setting is invalid.
    OSError
        If the recording exists or cannot be written.
    """

    def __init__(
        self,
        robot: RobotSource,
        *,
        ros_args: Sequence[str] = (),
        **settings: Any,
    ) -> None:
        plain, numbers = split_joints(settings)
        found = loaded(robot, lockstep_settings(robot, plain), numbers)
        self.robot, chosen = found.robot, found.settings
        frames = found.recorded_frames(chosen, partial(warnings.warn, stacklevel=3))
        self.engine = Engine(chosen, self.robot, rows=bool(chosen.recording), frames=frames)
        self.settings = self.engine.settings
        self.names = self.engine.arm.names
        self._limits = limits_of(self.robot, self.engine.arm.order)
        self._run = EngineRun(self.engine, open_log(self.engine))
        self._given = robot, settings
        self._topics = found.control.topics
        self._ros_args = tuple(ros_args)
        if self.settings.command_topic:
            self._ros_args += ('-r', f'~/commands:={self.settings.command_topic}')
        self._exchange: Exchange | None = None

    def __enter__(self) -> LockstepArm:
        """Return the arm."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the arm."""
        self.close()

    def close(self) -> None:
        """Close the recording and the node, if there are any.

        Raises
        ------
        pfd_ros.testing.run_log.RecordingError
            If the recording is incomplete.
        """
        exchange, self._exchange = self._exchange, None
        if exchange is not None:
            exchange.close()
        self._run.close()

    @property
    def time(self) -> float:
        """The stamp of the last state, s of simulated time; the first is `start_time`, 1 ms."""
        return self._run.time

    @property
    def period(self) -> float:
        """The control period, s: from one state to the next."""
        return period_of(self.settings)

    @property
    def q(self) -> Array:
        """Positions in the last state, (n,), rad or m; a copy."""
        return np.array(self._run.measured()[0])

    @property
    def qd(self) -> Array:
        """Velocities in the last state, (n,), rad/s or m/s; a copy."""
        return np.array(self._run.measured()[1])

    def run(
        self, controller: Controller, seconds: float, *, patience: float = PATIENCE_SECONDS
    ) -> Trajectory:
        """Run a controller for some simulated seconds; return the motion.

        Parameters
        ----------
        controller
            Called as controller(t, q, qd) at the start of each control period, with the stamp [s]
            and the values (n,) of the last state; returns efforts (n,), constant over the
            period.
        seconds
            Simulated time. The last row of the motion is one control period before its end, where
            another run begins.
        patience
            Longest wall time of one call, s; infinite for a debugger. It works in the main thread,
            and interrupts Python code that waits.

        Raises
        ------
        ControllerError
            If the controller raises, blocks, or returns anything but a finite effort for each
            joint. The arm keeps the state passed to the controller.
        ArmError
            If the state does not stay finite.
        ValueError
            If `seconds` is not above zero and finite.
        """
        rows = rows_of(self.settings, seconds, len(self.names))
        names = self.names
        if self._run.journal is not None:
            self._run.journal.add_run(self.engine.cycles, rows, callback=True)
        command, measured, arm = self._run.command, self._run.measured, self.engine.arm
        with Watch(patience) as watch:
            for k in range(len(rows.time)):
                t = rows.time[k] = arm.stamp_ns / NANOSECONDS
                q, qd, _ = measured()
                rows.q[k], rows.qd[k] = q, qd
                begun = watch.since = perf_counter()
                try:
                    efforts = asked(controller, names, t, q.copy(), qd.copy())
                    watch.since = 0.0
                except BlockedError:
                    raise blocked(watch, patience, t, k) from None
                rows.compute_time[k] = perf_counter() - begun
                rows.tau[k] = efforts
                rows.count = k + 1
                validation = command(efforts)
                if validation.verdict is not Verdict.ACCEPTED:
                    raise refusal(efforts, names, t, validation.detail)
        return rows.trajectory(names, self._limits)

    def spin(
        self,
        seconds: float,
        *controllers: Any,
        patience: float = PATIENCE_SECONDS,
        start_patience: float = START_PATIENCE_SECONDS,
        allow_rejected: Collection[str] = (),
    ) -> Trajectory:
        """Run a controller over topics for some simulated seconds; return the motion.

        The arm publishes a state and its clock tick, and continues when it receives a command with
        the stamp of the state or without a stamp. rclpy must be initialised, as by the fixture
        `ros_domain`.

        Parameters
        ----------
        seconds
            As for `run`.
        controllers
            rclpy nodes of this process whose callbacks are to run meanwhile, and controllers that
            the fixture `controller_process` started, whose end ends the run. Nodes elsewhere in
            the domain are found.
        patience
            Longest wait for an answer, s of wall time.
        start_patience
            Longest wait until a controller in another process has started, s of wall time.
        allow_rejected
            Reasons for which the arm may reject commands, of pfd_ros.testing.rejections.REASONS.
            'all_nan' includes NaN by name for some joints, 'unknown_names' some unknown names.

        Raises
        ------
        ControllerError
            If the arm rejects a command for another reason, or a node of this process blocks.
        pfd_ros.testing.controllers.NoAnswerError
            If a state has no answer, or a process ended.
        ArmError
            If the state does not stay finite.
        """
        rows = rows_of(self.settings, seconds, len(self.names))
        run = TopicRun(self._run, rows, checked_reasons(allow_rejected))
        if self._run.journal is not None:
            self._run.journal.add_run(self.engine.cycles, rows, callback=False)
        if self._exchange is None:
            self._exchange = Exchange(roles_of(self.settings), self._ros_args, self._topics)
        self._exchange.run(run, controllers, Waits(patience, start_patience))
        return run.rows.trajectory(self.names, self._limits)

    def reset(self) -> None:
        """Restore the initial state, braked until the next command; simulated time continues."""
        self._jump(Source.REQUEST, encode_request(Request('reset')))

    def set_state(self, q: JointValues, qd: JointValues | None = None) -> None:
        """Set the state; it takes one step.

        Parameters
        ----------
        q, qd
            Positions and velocities (n,), or by joint name; joints without a position keep
            theirs, and joints without a velocity are at rest.

        Raises
        ------
        ValueError
            If the state is invalid.
        """
        positions = by_joint(self.names, 'q', q)
        velocities = by_joint(self.names, 'qd', {} if qd is None else qd)
        self._jump(Source.SET_STATE, encode_state(self.names, positions, velocities))

    def save(self) -> ArmState:
        """Return a copy of the state of the arm, from which `restore` continues with equal bits.

        It can be copied, compared and pickled; `to_bytes` and `ArmState.from_bytes` write it.
        """
        return self.engine.save()

    def restore(self, state: ArmState) -> None:
        """Continue from a saved state, of this arm or another one with the same settings.

        Raises
        ------
        ValueError
            If the state is of another robot, or of an arm with other settings at its start; or if
            the run is recorded, as a recording holds one run.
        """
        self._run.restore(state)
        self.settings = self.engine.settings

    def keep_inputs(self) -> None:
        """Keep the inputs of an arm that has had none, for `record_again`, up to 64 MB of them."""
        if self._run.log is None:
            self._run.journal = Journal()

    def record_again(self, path: Path) -> str:
        """Run an unrecorded arm again with the same inputs, hence with the same bits, recorded.

        A recording holds one run from its start: of an arm that was restored, only the states of
        its runs since then are written. Return a line about missing data, or ''.

        Raises
        ------
        ValueError
            If its inputs were not kept.
        OSError
            If the file exists or cannot be written.
        """
        journal = self._run.journal
        if journal is None or not journal.complete:
            reason = 'were not kept' if journal is None else 'are too many to be kept'
            raise ValueError(f'the inputs of this run {reason}: record it with recording=...')
        if journal.start is not None:
            write_received(self.names, journal.runs, path)
            return 'the arm was restored from a saved state: the log has its states since then'
        robot, settings = self._given
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # the first arm has warned
            one_file = {'recording_max_size': 0, 'recording_max_duration': 0.0}
            again = LockstepArm(robot, **{**settings, **one_file, 'recording': str(path)})
        with again:
            again._run.repeat(journal.entries, self.engine.cycles)
        same = again.q.tobytes() == self.q.tobytes()
        return '' if same else 'the arm was run again, and its last state differs'

    def push(self, force: Sequence[float], torque: Sequence[float], frame: str = '') -> None:
        """Apply a force and a torque to the last link until the next push or a reset.

        They are expressed in a frame on the last link, by default the link's frame, and act at its
        origin, N and N m. The arm needs the setting external_wrench=True; external_wrench_timeout
        ends them.
        """
        wrench = np.array([force, torque], np.float64).ravel()
        encoder = stamped_encoder(WRENCH, frame or self.robot.tip)
        self._run.demand(Source.WRENCH, encoder.encode(0, wrench))

    def set(self, **values: Any) -> None:
        """Change dynamic settings from the next step on; ValueError if one is invalid."""
        check_names(values)
        self._run.demand(Source.PARAMETERS, encode_changes(plain_values(values)))
        self.settings = self.engine.settings

    def _jump(self, source: Source, data: bytes) -> None:
        self._run.demand(source, data)
        self._run.step()
