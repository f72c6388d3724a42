# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of what other threads see, and the log lines about them, once a second.

One table: key -> how often, the newest detail, how much of it has been logged. While a problem
lasts its line is repeated at growing intervals, with complete counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass
import threading
import time
from typing import Any

from pfd_ros.arm import events
from pfd_ros.arm.actuators import timeout_text
from pfd_ros.arm.advice import Speeding, speeding, stated
from pfd_ros.arm.engine import NO_CLOCK, Engine
from pfd_ros.arm.events import Verdict
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.node.stepping import RESEND_SECONDS, Stepper
from pfd_ros.text import cut, listed, one_line

# Time between two lines of one key, s: doubled with every line, reset after a quiet interval.
SHORTEST, LONGEST = 1.0, 60.0
# Most keys that are logged once; nodes of other people are among them.
MOST_FINDINGS = 64
# A followed clock may be slow, and discovery takes up to three seconds.
LOST_CLOCK_SECONDS = 5
# No command, no error: a driver sends NaN until a controller has claimed the joint.
QUIET = frozenset({events.ACCEPTED.label, events.UNCLAIMED.label})
# What a controller must never send.
ERRORS = frozenset({'infinite', 'not_finite'})
# End of the labels of remarks about accepted inputs.
REMARK = '_of_accepted'


def is_rejection(label: str) -> bool:
    """Return whether inputs with a label are reported as rejected."""
    return label not in QUIET and not label.endswith(REMARK)


@dataclass
class _Entry:
    count: int = 0
    detail: str = ''
    logged: int = 0
    interval: float = SHORTEST
    due: float = 0.0


class Report:
    """The table of counts; any thread adds, one thread logs.

    `newest` has the steady time of the newest accepted input of each role, s. While `closing` is
    set, lines are not delayed.
    """

    def __init__(self, logger: Any) -> None:
        self.newest: dict[str, float] = {}
        self.closing = False
        self._logger = logger
        self._lock = threading.Lock()
        self._table: dict[Hashable, _Entry] = {}
        self._findings = 0

    def add(self, key: Hashable, detail: str = '') -> None:
        """Count an event. The set of keys must be bounded."""
        with self._lock:
            entry = self._table.setdefault(key, _Entry())
            entry.count, entry.detail = entry.count + 1, detail

    def count(self, role: str, verdict: Verdict) -> None:
        """Count the verdict about an input, and its remarks."""
        self.add((role, verdict.label), verdict.detail)
        for remark in verdict.remarks:
            self.add((role, f'{remark.label}{REMARK}'), remark.detail)
        if verdict.accepted:
            self.newest[role] = time.monotonic()

    def inputs(self) -> dict[tuple[str, str], tuple[int, str]]:
        """Return the counts of inputs, by role and label."""
        return {key: value for key, value in self.counts().items() if key[0] in events.INPUTS}

    def accepted(self, roles: Collection[str]) -> int:
        """Return how many inputs of some roles were accepted."""
        counts = self.counts()
        return sum(counts.get((role, events.ACCEPTED.label), (0,))[0] for role in roles)

    def rejected(self) -> int:
        """Return how many inputs were rejected."""
        return sum(n for (_, label), (n, _) in self.inputs().items() if is_rejection(label))

    def counts(self) -> dict[Any, tuple[int, str]]:
        """Return the count and the newest detail of each key."""
        with self._lock:
            return {key: (entry.count, entry.detail) for key, entry in self._table.items()}

    def grown(self, key: Hashable, count: int) -> int:
        """Return the increase of a count since its last line; 0 if no line is due."""
        with self._lock:
            entry = self._table.setdefault(key, _Entry())
        new, now = count - entry.logged, time.monotonic()
        if new <= 0 or (now < entry.due and not self.closing):
            return 0
        quiet = now - entry.due > entry.interval
        entry.interval = SHORTEST if quiet else min(2 * entry.interval, LONGEST)
        entry.due, entry.logged = now + entry.interval, count
        return new

    def line(self, key: Hashable, count: int, text: str, *, error: bool = False) -> None:
        """Log a text when a count has grown, with the increase for a leading # or at its end."""
        new = self.grown(key, count)
        if new and text.startswith('#'):
            self.log(f'{new}{text[1:]}', error=error)
        elif new:
            self.log(text if new == 1 else f'{text} ({new} times)', error=error)

    def lasting(self, key: Hashable, text: str) -> None:
        """Log a text, at growing intervals while this is called."""
        self.add(key)
        if self.grown(key, self.counts()[key][0]):
            self.log(text)

    def once(self, key: Hashable, text: str) -> None:
        """Log a finding once."""
        if self._findings <= MOST_FINDINGS and self.grown(('once', key), 1):
            self._findings += 1
            self.log(text)
            if self._findings > MOST_FINDINGS:
                self.log('further warnings of this kind are not logged')

    def log(self, text: str, *, error: bool = False) -> None:
        """Log one line."""
        # Two statements, since rclpy requires one severity per line of code.
        if error:
            self._logger.error(one_line(text))
        else:
            self._logger.warning(one_line(text))


def introduce(engine: Engine, endpoints: Endpoints, log: Callable[[str], object]) -> None:
    """Log the topics of an arm, the robot, and what its model has that is off."""
    named, plain = (
        f'{endpoints.topic(role)} ({events.ROLES[role].type}'
        for role in (events.NAMED, events.ARRAY)
    )
    order = ', '.join(cut(name) for name in engine.names)
    kinds = 'effort, position, velocity' if engine.actuators.servo else 'effort'
    log(f'subscribed to {named}: name and {kinds}) and {plain}: efforts in the order {order})')
    outputs = [
        f'{endpoints.topic(role)} ({events.ROLES[role].type})' for role in endpoints.publishers
    ]
    log(f'publishing {" and ".join(outputs)}')
    log(
        f'{cut(engine.state.settings.robot)}: each of the {len(engine.names)} joints is braked '
        'until its first command; simulated time starts at '
        f'{engine.stamp_ns / NANOSECONDS:g} s'
    )
    scene, settings = engine.plant.scene, engine.state.settings
    has = {name for name, there in stated(engine.robot).items() if there}
    off = [x for x in sorted(has) if getattr(scene, x) is None and not getattr(settings, x)]
    if off:
        log(f'off: {", ".join(off)} of the model; {off[-1]}:=true and the like switch them on')


def speed_of(engine: Engine) -> Speeding | None:
    """Return the joint that was farthest beyond its velocity limit so far, if one was."""
    state, peaks = engine.state, engine.state.motors.peaks.tolist()
    given, from_file = (engine.robot, engine.plant.scene, peaks), bool(state.settings.scene)
    return speeding(*given, commands=state.sent, from_file=from_file)


def report_arm(report: Report, stepper: Stepper, endpoints: Endpoints) -> None:
    """Log what is new about an arm since the last call."""
    engine, state = stepper.engine, stepper.engine.state
    _report_inputs(report, engine, endpoints)
    cure = 'lower real_time_factor or publish_rate, or raise step_size'
    report.line('missed', stepper.missed, f'# {events.BUSY}: {cure}')
    report.line('timeouts', state.timeouts, timeout_text(state.settings))
    text = f'protective stop, all joints braked: {state.tripped}; call ~/reset to end it'
    report.line('reflex', state.trips, text, error=True)
    reason = f': {state.failure}' if state.failure else ''
    text = f'simulation stopped{reason}; call ~/reset to restart'
    report.line('failure', state.failures, text, error=True)
    text = (
        '# s of waiting for commands in lockstep, now for the state at t = '
        f'{engine.stamp_ns / NANOSECONDS:.9g} s; check that the controller answers each state '
        'and uses this /clock'
    )
    report.line('lockstep', int(stepper.resent * RESEND_SECONDS), text)
    text = (
        '# commands taken late in lockstep: they had the stamp of an earlier '
        'state, so the clock of their sender lags, as that of hardware of ros2_control may'
    )
    report.line('lagging', stepper.lagging, text)
    since = max(stepper.started, report.newest.get(events.CLOCK_TICKS, 0.0))
    silent = int(time.monotonic() - since) if engine.awaited == NO_CLOCK else 0
    if silent >= LOST_CLOCK_SECONDS and not report.closing:
        topic = endpoints.topic(events.CLOCK_TICKS)
        text = f'no new time on {topic} for {silent} s: simulation paused until one is received'
        report.lasting('lost clock', text)
    speed = speed_of(engine)
    if speed is not None:
        report.once(('speed', speed.runaway), speed.text)


def _report_inputs(report: Report, engine: Engine, endpoints: Endpoints) -> None:
    for (role, label), (count, detail) in report.inputs().items():
        topic, key = endpoints.topic(role), (role, label)
        if label == f'unknown_names{REMARK}':
            names = detail.removeprefix('unknown joints ')
            text = f'unknown joints in messages ignored on {topic}: {names}'
            report.line(key, count, f'{text}; known joints: {listed(engine.names)}')
        elif label == f'{events.LOCKED_JOINTS}{REMARK}':
            names = detail.removeprefix('locked: ')
            report.once(key, f'commands for locked joints have no effect: {names}')
        elif label == f'{events.SOME_NAN}{REMARK}':
            report.line(key, count, f'commands on {topic} have {detail}')
        elif label == f'{events.OUTSIDE_STOPS}{REMARK}':
            report.line(key, count, f'state set on {topic}: {detail}')
        elif label == f'future{REMARK}':
            report.once(key, f'commands on {topic} have stamps of another clock: {detail}')
        elif is_rejection(label):
            text = f'# messages on {topic} rejected: {label} ({detail})'
            report.line(key, count, text, error=label in ERRORS)


def summary(report: Report, stepper: Stepper) -> str:
    """Return the totals of a run as a sentence."""
    state, accepted = stepper.engine.state, report.accepted(events.INPUTS)
    failure = f'; failure: {state.failure}' if state.failure else ''
    return (
        f'stopped after {state.step * state.settings.step_ns / NANOSECONDS:.9g} s of simulated '
        f'time: {stepper.states} states published, {accepted} messages accepted, '
        f'{report.rejected()} rejected, {stepper.late} of {state.step} steps late, '
        f'{stepper.missed} periods missed{failure}'
    )
