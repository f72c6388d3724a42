# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm as a separate process, in lockstep with controllers over topics.

The process is the node of users, with its topics and threads; this process only reads its states.
The arm waits for an answer to each state, so the motion has the bits of a run in one process.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
import time
from typing import Any, NoReturn

import numpy as np

from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.events import COMMANDS, STATES, Source
from pfd_ros.arm.joint_numbers import GROUPS, split_joints
from pfd_ros.messages.convert import NANOSECONDS, JointMessage, decode_joint_state, encode_state
from pfd_ros.messages.stamped import effort_encoder
from pfd_ros.messages.topics import remapped, topic_of
from pfd_ros.motion.metrics import Array
from pfd_ros.recording.format import ARRAY_COMMANDS, CHANNELS, NAMED_COMMANDS, ROLE_OF_SOURCE
from pfd_ros.testing.controller import Controller, ControllerError, asked, blocked, raised, refusal
from pfd_ros.testing.controllers import Controllers, NoAnswerError, split
from pfd_ros.testing.exchange import LOOK_SECONDS, bare_node, require_rclpy
from pfd_ros.testing.journal import MOST_BYTES
from pfd_ros.testing.lockstep_settings import (
    JointValues,
    RobotSource,
    by_joint,
    limits_of,
    loaded,
    lockstep_settings,
    rows_of,
)
from pfd_ros.testing.node_process import NodeProcess, NodeProcessError, parameters_of
from pfd_ros.testing.patience import (
    PATIENCE_SECONDS,
    START_PATIENCE_SECONDS,
    BlockedError,
    Waits,
    Watch,
)
from pfd_ros.testing.received_log import write_received
from pfd_ros.testing.rejections import REASONS, STALE, checked_reasons
from pfd_ros.testing.session import executor_with, spin, take_down
from pfd_ros.testing.trajectory import Rows, Trajectory

# For the first state: the process starts, compiles the robot, and is discovered.
START_SECONDS = 60.0
# For an answer to a request, s.
REQUEST_SECONDS = 10.0
# Of the diagnostics of the node, which come once a second; a busy machine may be late.
DIAGNOSTICS_SECONDS = 10.0
STATE_DEPTH, COMMAND_DEPTH = 100, 10


class ProcessArm:
    """The node as a process, and the topics of a test.

    Parameters
    ----------
    robot, ros_args, **settings
        As for LockstepArm; `robot` must be loadable by the process: a name, a path, or a URDF.

    Attributes
    ----------
    settings, robot, names
        Settings, robot, and joints in published order, the order of all arrays.
    process
        The process.

    Raises
    ------
    ValueError
        If a setting is invalid.
    RuntimeError
        If rclpy is not initialised.
    """

    def __init__(
        self, robot: RobotSource, *, ros_args: Sequence[str] = (), **settings: Any
    ) -> None:
        require_rclpy()
        plain, numbers = split_joints(settings)
        given = lockstep_settings(robot, plain)
        found = loaded(robot, given, numbers)
        self.robot, self.settings = found.robot, found.settings
        order = joint_order(self.settings.joints, self.robot)
        self.names = tuple(self.robot.joint_names[i] for i in order)
        self._limits = limits_of(self.robot, order)
        self._encoder = effort_encoder(self.names)
        self._state: JointMessage | None = None
        self._answer = b''
        self._received: list[Rows] = []
        self._on_new: Callable[[JointMessage], None] | None = None
        # Rejections that the node has counted, the simulated time of these counts, and the counts
        # that spin has checked.
        self._counted: Counter[str] = Counter()
        self._counted_at = 0.0
        self._validated: Counter[str] = Counter()
        self._create_node(ros_args, found.control.topics)
        # The node reads the description itself.
        parameters = parameters_of(given, self.names)
        for group, field in GROUPS.items():
            single = numbers.get(field.name, {})
            parameters |= {f'{group}.{joint}': number for joint, number in single.items()}
        self.process = NodeProcess(parameters, ros_args)

    def _create_node(self, ros_args: Sequence[str], topics: Mapping[Source | str, str]) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.experimental.events_executor import EventsExecutor
        from sensor_msgs.msg import JointState
        from std_srvs.srv import Trigger

        self.node = node = bare_node('sim_arm_watch', ros_args)
        states = topic_of(node, CHANNELS[STATES].topic, topics.get(STATES, ''))
        named = CHANNELS[NAMED_COMMANDS].topic
        commands = topic_of(node, named, topics.get(Source.NAMED, ''))
        # Remappings of the arm's private name hold for this node's private name.
        array = remapped(node, CHANNELS[ARRAY_COMMANDS].topic) or topics.get(Source.ARRAY, '')
        array = array or self.settings.command_topic or 'sim_arm/commands'
        self._topics = [node.resolve_topic_name(name) for name in (states, commands, array)]
        # A separate executor: the controllers do not run while it waits.
        self._reader = bare_node('sim_arm_reader', ros_args)
        self._reader.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._readers_executor = EventsExecutor()
        self._readers_executor.add_node(self._reader)
        node.create_subscription(JointState, states, self._on_state, STATE_DEPTH, raw=True)
        self._commands = node.create_publisher(JointState, commands, COMMAND_DEPTH)
        self._jumps = node.create_publisher(JointState, 'sim_arm/set_state', 1)
        self._resets = node.create_client(Trigger, 'sim_arm/reset')

    def __enter__(self) -> ProcessArm:
        """Return the arm."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """End the process; its errors do not hide an error of the test."""
        with suppress(*([NodeProcessError] if kind is not None else [])):
            self.close()

    def close(self) -> None:
        """End the process and the node of the test.

        Raises
        ------
        pfd_ros.testing.node_process.NodeProcessError
            If the process failed.
        """
        try:
            self.process.close()
        finally:
            self._readers_executor.shutdown()
            take_down(self._reader)
            take_down(self.node)

    @property
    def time(self) -> float:
        """The stamp of the last state, s of simulated time."""
        return self._last_state().stamp_ns / NANOSECONDS

    @property
    def q(self) -> Array:
        """Positions of the last state (n,), rad or m; a copy."""
        return np.array(self._last_state().position)

    @property
    def qd(self) -> Array:
        """Velocities of the last state (n,), rad/s or m/s; a copy."""
        return np.array(self._last_state().velocity)

    def _last_state(self) -> JointMessage:
        if self._state is None:
            self._wait(lambda: self._state is not None, START_SECONDS, 'the first state')
        assert self._state is not None
        return self._state

    @property
    def received_time(self) -> float:
        """The stamp of the last state that came, s of simulated time; 0 before the first."""
        return 0.0 if self._state is None else self._state.stamp_ns / NANOSECONDS

    def write_received(self, path: Path) -> None:
        """Write the states of the runs so far; OSError if the file exists."""
        write_received(self.names, self._received, path)

    def run(
        self, controller: Controller, seconds: float, *, patience: float = PATIENCE_SECONDS
    ) -> Trajectory:
        """Run a controller of this process; see LockstepArm.run."""
        rows = rows_of(self.settings, seconds, len(self.names))

        def answer(state: JointMessage) -> bool:
            if rows.count == len(rows.time):
                return True
            k, t, begun = rows.count, state.stamp_ns / NANOSECONDS, time.perf_counter()
            rows.time[k], rows.q[k], rows.qd[k] = t, state.position, state.velocity
            q, qd = np.array(state.position), np.array(state.velocity)
            efforts = rows.tau[k] = asked(controller, self.names, t, q, qd)
            rows.compute_time[k] = time.perf_counter() - begun
            if not np.isfinite(efforts).all():
                raise refusal(efforts, self.names, t, '')
            rows.count += 1
            self._answer = self._encoder.encode(state.stamp_ns, efforts)
            self._commands.publish(self._answer)
            return False

        self._follow(answer, rows, (), Waits(patience))
        return rows.trajectory(self.names, self._limits)

    def spin(
        self,
        seconds: float,
        *controllers: Any,
        patience: float = PATIENCE_SECONDS,
        start_patience: float = START_PATIENCE_SECONDS,
        allow_rejected: Collection[str] = (),
    ) -> Trajectory:
        """Run controllers in ROS nodes of this process or others; see LockstepArm.spin.

        With nodes of other processes the arm does not wait for the next call. Rejected commands
        are read from its diagnostics, once a second: the end of the run waits for them.
        """
        rows, allowed = (
            rows_of(self.settings, seconds, len(self.names)),
            checked_reasons(allow_rejected),
        )
        self._answer = b''
        came = 0.0

        def watch(state: JointMessage) -> bool:
            nonlocal came
            k, before, came = rows.count, came, time.perf_counter()
            if k:
                rows.tau[k - 1], rows.compute_time[k - 1] = state.effort, came - before
            if k == len(rows.time):
                return True
            rows.time[k], rows.q[k], rows.qd[k] = (
                state.stamp_ns / NANOSECONDS,
                state.position,
                state.velocity,
            )
            rows.count += 1
            return False

        self._follow(watch, rows, controllers, Waits(patience, start_patience), allowed)
        self._read_counts(DIAGNOSTICS_SECONDS)
        self._validate_counts(rows.count, allowed)
        return rows.trajectory(self.names, self._limits)

    def reset(self) -> None:
        """Restore the initial state, braked until the next command; simulated time continues."""
        from std_srvs.srv import Trigger

        before = self._last_state().stamp_ns
        self._wait(self._resets.service_is_ready, REQUEST_SECONDS, 'the service reset')
        self._resets.call_async(Trigger.Request())
        self._wait_for_jump(before)

    def set_state(self, q: JointValues, qd: JointValues | None = None) -> None:
        """Set the state; see LockstepArm.set_state."""
        before = self._last_state().stamp_ns
        positions = by_joint(self.names, 'q', q)
        velocities = by_joint(self.names, 'qd', {} if qd is None else qd)
        self._wait(self._jumps.get_subscription_count, REQUEST_SECONDS, 'a reader of set_state')
        self._jumps.publish(encode_state(self.names, positions, velocities))
        self._wait_for_jump(before)

    def save(self) -> NoReturn:
        """Raise ValueError: the state of an arm in another process is not on its topics."""
        raise ValueError(
            'the state of an arm in another process cannot be saved or restored: '
            'use sim_arm without process=True'
        )

    def restore(self, state: object) -> NoReturn:
        """Raise ValueError, as `save`."""
        self.save()

    def _wait_for_jump(self, before_ns: int) -> None:
        self._answer = b''
        self._wait(lambda: self._last_state().stamp_ns > before_ns, REQUEST_SECONDS, 'a state')

    def _on_state(self, data: bytes) -> None:
        whole, n = decode_joint_state(data), len(self.names)
        # Locked joints come after the moving ones.
        state = replace(
            whole,
            names=whole.names[:n],
            position=whole.position[:n],
            velocity=whole.velocity[:n],
            effort=whole.effort[:n],
        )
        last, self._state = self._state, state
        if last is not None and state.stamp_ns <= last.stamp_ns:
            # Sent again, because its answer was published before the two had found each other.
            self._state = last
            if self._answer:
                self._commands.publish(self._answer)
        elif self._on_new is not None:
            self._on_new(state)

    def _on_diagnostics(self, message: Any) -> None:
        name = f'{self.node.get_namespace().rstrip("/")}/sim_arm'.lstrip('/')
        found = {
            status.name: {pair.key: pair.value for pair in status.values}
            for status in message.status
        }
        stepping, commands = (found.get(f'{name}: {task}') for task in ('stepping', 'commands'))
        if stepping is None or commands is None:
            return
        counts = Counter({'unknown_names': int(commands['unknown_names'])})
        for role in (ROLE_OF_SOURCE[source] for source in COMMANDS):
            for reason in REASONS:
                counts[reason] += int(commands.get(f'{role}.{reason}', 0))
        # The second answer to a repeated state is stale, which is not an error.
        counts[STALE] = max(0, counts[STALE] - int(stepping['states_sent_again']))
        self._counted, self._counted_at = counts, float(stepping['simulated_time_s'])

    def _read_counts(self, seconds: float) -> None:
        """Read the diagnostics up to the last state; NoAnswerError if they take longer."""
        end, deadline = self.time, time.monotonic() + seconds
        while self._counted_at < end:
            self.process.check()
            if time.monotonic() > deadline:
                raise NoAnswerError(f'waited {seconds:g} s for the diagnostics of the node')
            self._readers_executor.spin_once(timeout_sec=LOOK_SECONDS)

    def _validate_counts(self, answers: int, allowed: Collection[str]) -> None:
        """Raise ControllerError if the node has counted rejections that are not allowed."""
        new, self._validated = self._counted - self._validated, self._counted
        counts = ', '.join(
            f'{reason} ({n} times)' for reason, n in new.items() if reason not in allowed
        )
        if counts:
            raise ControllerError(
                f'the arm rejected commands until t = {self._counted_at:.6g} s, after {answers} '
                f'answers: {counts}; the log of the node has the numbers'
            )

    def _follow(
        self,
        take: Callable[[JointMessage], bool],
        rows: Rows,
        controllers: Sequence[Any],
        waits: Waits,
        allowed: Collection[str] | None = None,
    ) -> None:
        """Pass each new state to `take`, from the last one on, until it returns True.

        Where reasons are `allowed`, nodes command the arm.
        """
        from rclpy.task import Future

        nodes, processes = split(controllers)
        self._received.append(rows)
        while len(self._received) > 1 and sum(one.size for one in self._received) > MOST_BYTES:
            del self._received[0]
        first, ended, heard = self._last_state(), Future(), time.perf_counter()
        executor = executor_with([self.node, *nodes])
        own = {self.node.get_fully_qualified_name()}
        states, *topics = self._topics
        found = Controllers(self.node, states, topics, nodes, processes, own)

        def spin_once(seconds: float) -> None:
            watch.since = time.perf_counter()
            try:
                spin(executor, seconds, ended)
            except ControllerError:
                raise
            except Exception as error:
                raise raised(error, self.time, answers()) from error
            watch.since = 0.0
            self.process.check()

        def on_new(state: JointMessage) -> None:
            nonlocal heard
            heard = watch.since = time.perf_counter()
            if not ended.done() and take(state):
                ended.set_result(None)

        def answers() -> int:
            return rows.count if allowed is None else rows.count - 1

        self._on_new = on_new
        try:
            with Watch(waits.patience) as watch:
                on_new(first)
                start, begun = waits.start_of(nodes, processes), time.perf_counter()
                while not ended.done():
                    if allowed is not None and not answers():
                        there = found.readers() and found.found()
                        if not there:
                            heard = time.perf_counter()
                            if heard - begun > start:
                                raise found.absence(start)
                    spin_once(LOOK_SECONDS)
                    if ended.done():
                        break
                    if allowed is not None:
                        self._readers_executor.spin_once(timeout_sec=0.0)
                        self._validate_counts(answers(), allowed)
                    found.check(self.time, answers())
                    waited = time.perf_counter() - heard
                    if waited > waits.patience:
                        raise found.silence(self.time, answers(), waited)
        except BlockedError:
            raise blocked(watch, waits.patience, self.time, answers()) from None
        finally:
            self._on_new = None

    def _wait(self, done: Callable[[], Any], seconds: float, what: str) -> None:
        deadline = time.monotonic() + seconds
        executor = executor_with([self.node])
        while not done():
            self.process.check()
            if time.monotonic() > deadline:
                raise NoAnswerError(f'waited {seconds:g} s for {what}')
            spin(executor, LOOK_SECONDS / 10)
