# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log lines of the main thread: topics, problems once a second, totals at the end."""

from __future__ import annotations

from dataclasses import dataclass, field
import time
from typing import Any

from pfd_ros.arm.command_link import timeout_text
from pfd_ros.arm.commands import ERRORS, QUIET
from pfd_ros.arm.events import Source, Verdict
from pfd_ros.arm.speeding import speeding
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.node.endpoints import Endpoints, type_name
from pfd_ros.node.graph_check import GraphCheck
from pfd_ros.node.stepping import RESEND_SECONDS, Stepper
from pfd_ros.node.throttled_log import ThrottledLog
from pfd_ros.recording.format import ROLE_OF_SOURCE
from pfd_ros.text import cut, listed

# A followed clock may be slow, and discovery takes up to three seconds.
LOST_CLOCK_SECONDS = 5


@dataclass
class Reporter:
    """Logs counters that other threads write and only this thread reads."""

    log: ThrottledLog
    endpoints: Endpoints
    stepper: Stepper
    graph: GraphCheck
    _ticks: int = 0
    _silent: int = 0
    _ticked: float = field(default_factory=time.monotonic)

    def introduce(self) -> None:
        """Log the topics of the node by their resolved names, and the robot."""
        engine = self.stepper.engine
        named, plain = (self.endpoints.subscriptions[s] for s in (Source.NAMED, Source.ARRAY))
        order = ', '.join(cut(name) for name in engine.arm.names)
        kinds = 'effort' if engine.actuators.gains is None else 'effort, position, velocity'
        published = ' and '.join(
            f'{publisher.topic_name} ({type_name(publisher)})'
            for publisher in self.endpoints.publishers.values()
        )
        self.log.info(
            f'subscribed to {named.topic_name} ({type_name(named)}: name and {kinds}) and '
            f'{plain.topic_name} ({type_name(plain)}: efforts in the order {order})'
        )
        self.log.info(f'publishing {published}')
        self.log.info(
            f'{cut(engine.settings.robot)}: each of the {len(engine.arm.names)} joints is braked '
            'until its first command; simulated time starts at '
            f'{engine.arm.stamp_ns / NANOSECONDS:g} s'
        )

    def report(self, *, last: bool = False) -> None:
        """Log the problems since the last call, and check the ROS graph unless the node ends."""
        count, event = self.log.count, self.log.event
        self._report_commands(last)
        text = (
            'periods missed (busy machine or blocked subscriber): lower real_time_factor or '
            'publish_rate'
        )
        count('missed', self.stepper.timer.missed, text, last=last)
        for publisher in self.stepper.publishers.values():
            text = (
                f'messages not published on {publisher.topic}: a keep_all subscriber does not '
                f'read them ({publisher.detail})'
            )
            count(publisher.topic, publisher.refused, text, last=last)
        text = 'messages not recorded (slow disk): use a faster disk or fewer outputs'
        count('recorder', self.stepper.session.dropped, text, last=last)
        engine = self.stepper.engine
        state, arm = engine.state, engine.arm
        link, actuators = state.link, state.actuators
        event('timeouts', link.timeouts, timeout_text(engine.settings), last=last)
        text = f'protective stop, all joints braked: {actuators.reflex}; call ~/reset to end it'
        event('reflex', actuators.trips, text, error=True, last=last)
        reason = f': {arm.failure}' if arm.failure else ''
        text = f'simulation stopped{reason}; call ~/reset to restart'
        event('failure', state.failures, text, error=True, last=last)
        self._report_lockstep(last)
        speed = speeding(arm)
        if speed is not None:
            self.log.once(('speed', speed.runaway), speed.text)
        if not last:
            self._report_lost_clock()
            self.graph.check()

    def _report_lockstep(self, last: bool) -> None:
        """Log how long the arm has waited for a command in lockstep."""
        engine = self.stepper.engine
        waited = int(self.stepper.resent * RESEND_SECONDS)
        stamp_ns = engine.state.newest_ns
        newest = 'none' if stamp_ns is None else f't = {stamp_ns / NANOSECONDS:.9g} s'
        text = (
            f's of waiting for commands in lockstep, now for the state at t = '
            f'{engine.arm.stamp_ns / NANOSECONDS:.9g} s (last stamp: {newest}); check that the '
            'controller answers each state and uses this /clock'
        )
        self.log.count('lockstep', waited, text, last=last)

    def _report_lost_clock(self) -> None:
        """Log while no tick of the followed clock is received."""
        if not self.stepper.engine.pace.follows_clock:
            return
        ticks, _ = self.stepper.receiver.counts.verdicts().get(
            (Source.TICK, Verdict.ACCEPTED), (0, '')
        )
        if ticks != self._ticks:
            self._ticks, self._ticked = ticks, time.monotonic()
        silent = int(time.monotonic() - self._ticked)
        topic = self.endpoints.subscriptions[Source.TICK].topic_name
        if silent >= LOST_CLOCK_SECONDS:
            self._silent += 1
            text = f'no {topic} for {silent} s: simulation paused until it is received again'
            # Each check is counted, so the line is repeated at growing intervals.
            self.log.repeated('clock', self._silent, text)

    def _report_commands(self, last: bool) -> None:
        for (source, verdict), (count, detail) in self.stepper.receiver.counts.verdicts().items():
            if verdict not in QUIET:
                end = self.endpoints.subscriptions.get(source)
                where = ROLE_OF_SOURCE[source] if end is None else end.topic_name
                text = f'messages on {where} rejected: {verdict.label} ({detail})'
                self.log.count((source, verdict), count, text, error=verdict in ERRORS, last=last)
        locked = self.stepper.receiver.counts.locked()
        if locked:
            text = f'commands for locked joints have no effect: {listed(locked)}'
            self.log.once('locked', text)
        count, names = self.stepper.receiver.counts.unknown()
        if names:
            known = listed(self.stepper.engine.arm.names)
            text = f'unknown joints in messages ignored: {listed(names)}; known joints: {known}'
            self.log.count('unknown', count, text, last=last)

    def problems(self) -> list[str]:
        """Return the problems of a run that ended normally."""
        failed = bool(self.stepper.engine.arm.failure)
        found = ['the simulation failed before the end'] if failed else []
        return found + self.stepper.session.problems()

    def totals(self) -> dict[str, Any]:
        """Return the totals of the run for the log and the recording's last record."""
        engine, timer = self.stepper.engine, self.stepper.timer
        verdicts = self.stepper.receiver.counts.verdicts()
        accepted = sum(n for (_, v), (n, _) in verdicts.items() if v is Verdict.ACCEPTED)
        return {
            'steps': engine.arm.step,
            'simulated_seconds': engine.arm.step * engine.settings.step_ns / NANOSECONDS,
            'states': self.stepper.states,
            'not_published': sum(p.refused for p in self.stepper.publishers.values()),
            'commands_accepted': accepted,
            'commands_dropped': sum(n for n, _ in verdicts.values()) - accepted,
            'late_steps': timer.late,
            'missed_periods': timer.missed,
            'failure': engine.arm.failure,
        }

    def summary(self) -> str:
        """Return the totals of the run as a sentence."""
        found = self.totals()
        failure = f'; failure: {found["failure"]}' if found['failure'] else ''
        return (
            f'stopped after {found["simulated_seconds"]:.9g} s of simulated time: '
            f'{found["states"]} states published, {found["not_published"]} messages not '
            f'published, {found["commands_accepted"]} messages accepted, '
            f'{found["commands_dropped"]} rejected, '
            f'{found["late_steps"]} of {found["steps"]} steps late{failure}'
        )
