# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rclpy node `sim_arm` and its lifecycle.

    unconfigured    parameters and transitions, nothing else
    inactive        robot loaded, recording open, topics and services created; all joints are
                    braked and simulated time is stopped; commands are rejected and counted
    active          the arm steps
    finalized       shut down; the process ends

`configure` creates the arm. A model that does not load, or a recording that exists, is logged in
one line and fails the transition. `activate` and `deactivate` are requests to the arm, which are
recorded. `cleanup` closes the recording and deletes the arm; simulated time of the next one
continues from its last value, so that /clock never goes back. `shutdown` ends the process. After
an unexpected error the arm is cleaned up: unconfigured, exit status 1.

With `autostart` (the default) the node configures and activates itself before it processes any
message, a model that does not load ends the process with status 1, and parameters of the arm are
read-only. Without it they may change before configure and after cleanup.

The exit status is 0 if every configured arm and its recording worked to the end, and each
transition that failed was repeated with success. A signal during a transition waits for it, ten
seconds at most, and then closes the recording. Transitions run on the executor's thread, one at a
time; they raise no exceptions there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
import gc
import threading
import time
from typing import Any
import warnings

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from pfd_ros.arm.events import DIAGNOSTICS, ROLES, TRANSITIONS
from pfd_ros.messages.matching import OVERRIDABLE
from pfd_ros.node import parameters
from pfd_ros.node.diagnostics import ERROR, message, status
from pfd_ros.node.report import Report, introduce, report_arm, summary
from pfd_ros.node.sim_arm import SimArm
from pfd_ros.node.threads import END_SECONDS, MISTAKES, Threads, described, reason
from pfd_ros.text import cut, one_line

NAME = 'sim_arm'
UNCONFIGURED, INACTIVE, ACTIVE = (
    State(id=State.PRIMARY_STATE_UNCONFIGURED, label='unconfigured'),
    State(id=State.PRIMARY_STATE_INACTIVE, label='inactive'),
    State(id=State.PRIMARY_STATE_ACTIVE, label='active'),
)
# Number, start and goal of each transition after which there is an arm: these are recorded.
TRANSITIONS_OF_ARM = {
    'configure': (Transition.TRANSITION_CONFIGURE, UNCONFIGURED, INACTIVE),
    'activate': (Transition.TRANSITION_ACTIVATE, INACTIVE, ACTIVE),
    'deactivate': (Transition.TRANSITION_DEACTIVATE, ACTIVE, INACTIVE),
}
# Lines about what callers of services did, by the key of its count.
CALLS = {
    'callbacks': '# callbacks failed, most recently by ',
    'transitions': '# transitions refused, most recently ',
}


class SimArmNode(LifecycleNode):
    """The node: parameters, transitions, and the arm from configure to cleanup.

    `hung` is whether a thread of an arm did not end, and may still use ROS.
    """

    def __init__(self, threads: Threads, args: Sequence[str]) -> None:
        super().__init__(NAME)
        self.arm: SimArm | None = None
        self.hung = False
        self._threads = threads
        # Locked by transitions, and by the main thread while it reports or closes.
        self._lock = threading.Lock()
        self._closed = False
        # Simulated time reached by earlier arms.
        self._reached_ns = 0
        self._error: Exception | None = None
        self._problems: list[str] = []
        # By transition, until it succeeds.
        self._failed: dict[str, str] = {}
        self._report = Report(self.get_logger())
        for line in parameters.files_of_others(self, args):
            self._report.log(line)
        self._diagnostics = self.create_publisher(
            DiagnosticArray,
            ROLES[DIAGNOSTICS].topic,
            QoSProfile(depth=1),
            qos_overriding_options=OVERRIDABLE,
        )
        self._autostart = self._starting = parameters.declare(self)
        for service in self.services:
            service.callback = partial(self._answer, service.callback)

    def start(self) -> None:
        """Configure and activate the arm with `autostart`; raise the error of a transition."""
        if not self._autostart:
            text = 'unconfigured: autostart is false, waiting for lifecycle transitions'
            self.get_logger().info(text)
            return
        self.trigger_configure()
        if self._error is None:
            self.trigger_activate()
        self._starting = False
        if self._error is not None:
            raise self._error

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create the arm."""
        return self._transition('configure')

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the steps of the arm."""
        return self._transition('activate')

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake all joints and stop simulated time."""
        return self._transition('deactivate')

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the recording and delete the arm."""
        return self._transition('cleanup')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process; its main thread closes the recording."""
        self._threads.stop.set()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up after a fault; the process ends if that fails too."""
        result = self._transition('cleanup')
        if result != TransitionCallbackReturn.SUCCESS:
            self._threads.stop.set()
        return result

    def _transition(self, name: str) -> TransitionCallbackReturn:
        """Run a transition; log its error instead of raising it."""
        work = {'configure': self._configure, 'cleanup': self._clean_up}
        with self._lock:
            # The steps end at once with a signal: a request that would wait for them is not begun.
            ending = self._threads.stop.is_set() and not self._starting
            if self._closed or ending:
                return TransitionCallbackReturn.FAILURE
            try:
                work.get(name, partial(self._request, name))()
            except MISTAKES as error:
                self._error = error
                if not self._starting and not self._threads.stop.is_set():
                    self._failed[name] = f'{name} failed: {reason(error)}'
                    self._report.log(self._failed[name], error=True)
                return TransitionCallbackReturn.FAILURE
            except Exception as error:
                self._error = error
                self._problems.append(f'{name} failed: {described(error)}')
                return TransitionCallbackReturn.ERROR
            self._failed.pop(name, None)
            if self.arm is not None:
                number, start, goal = TRANSITIONS_OF_ARM[name]
                event = TransitionEvent(
                    timestamp=time.time_ns(),
                    transition=Transition(id=number, label=name),
                    start_state=start,
                    goal_state=goal,
                )
                self.arm.record(TRANSITIONS, bytes(serialize_message(event)))
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        settings = replace(parameters.read(self), autostart=self._starting)
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter('always')
            try:
                self.arm = SimArm(self, settings, self._threads, self._reached_ns)
            finally:
                for text in dict.fromkeys(str(warning.message) for warning in found):
                    self._report.log(text)
        try:
            # Objects of the start are excluded from later garbage collections.
            gc.unfreeze()
            gc.collect()
            gc.freeze()
            introduce(self.arm.engine, self.arm.endpoints, self.get_logger().info)
            self.arm.start()
        except BaseException:
            # Unconfigured, the node has no arm: the next one would have the same topics.
            self._clean_up()
            raise

    def _request(self, name: str) -> None:
        # An arm that starts with the node is active from its first step on.
        if self.arm is not None and not self._starting:
            self.arm.request(name)

    def _clean_up(self) -> None:
        arm, self.arm = self.arm, None
        if arm is not None:
            self._end(arm)
            if not self.hung:
                arm.destroy_endpoints()

    def _end(self, arm: SimArm) -> None:
        """Stop an arm, close its recording and keep its problems."""
        ended = arm.stop()
        self._reached_ns = max(self._reached_ns, arm.engine.stamp_ns)
        self._threads.guard('closing the recording', arm.close_recording, lambda: True)
        arm.report.closing = True
        report = partial(report_arm, arm.report, arm.stepper, arm.endpoints)
        self._threads.guard('reporting', report, lambda: True)
        self._problems += arm.problems()
        self.get_logger().info(one_line(summary(arm.report, arm.stepper)))
        if not ended:
            # The thread may still use the entities.
            self.hung = True
            self._threads.stop.set()

    def _answer(self, callback: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Answer a request even if its callback raises, as some callbacks of rclpy do."""
        try:
            return callback(request, response)
        except Exception as error:
            if isinstance(request, ChangeState.Request):
                # The arm has no such transition in this state: its own transitions raise nothing.
                wanted, (_, state) = request.transition, self._state_machine.current_state
                name = cut(wanted.label) or wanted.id
                self._report.add('transitions', f'{name!r} from the state {state}')
            else:
                self.callback_failed(error)
            return response

    def callback_failed(self, error: Exception) -> None:
        """Count a callback that raised; the executor continues."""
        self._report.add('callbacks', f'{type(error).__name__}: {error}')

    def report(self) -> None:
        """Log the problems since the last call, unless a transition is running."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            # The public API calls a service of this node.
            _, label = self._state_machine.current_state
            values, trouble = {'problems': len(self._problems)}, (ERROR, self._problems, label)
            tasks = [status('lifecycle', values, label, trouble)]
            if self.arm is not None:
                report_arm(self.arm.report, self.arm.stepper, self.arm.endpoints)
                self.arm.graph.check()
                tasks += self.arm.diagnostics.tasks()
            self._report_calls()
            data = message(self.get_fully_qualified_name().lstrip('/'), tasks)
            self._diagnostics.publish(data)
            if self.arm is not None:
                self.arm.record(DIAGNOSTICS, data)
        finally:
            self._lock.release()

    def _report_calls(self) -> None:
        counts = self._report.counts()
        for key in CALLS.keys() & counts.keys():
            count, detail = counts[key]
            self._report.line(key, count, f'{CALLS[key]}{detail}', error=key == 'callbacks')

    def close(self) -> None:
        """End the arm, after the transition that may be on its way; none follows."""
        if not self._lock.acquire(timeout=END_SECONDS):
            self._problems.append(f'a transition did not end within {END_SECONDS} s')
            self.hung = True
            return
        try:
            self._closed = True
            if self.arm is not None:
                self._end(self.arm)
            self._report.closing = True
            self._report_calls()
        finally:
            self._lock.release()

    def problems(self) -> list[str]:
        """Return why the run failed."""
        return [*self._threads.failures, *self._problems, *self._failed.values()]
