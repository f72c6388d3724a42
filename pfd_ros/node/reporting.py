# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The main thread: log lines about topics and, once a second, troubles; totals and problems."""

from __future__ import annotations

from dataclasses import dataclass, field
import time
from typing import Any

from pfd_ros.arm.command_link import TIMEOUT_TEXT
from pfd_ros.arm.commands import ERRORS, QUIET
from pfd_ros.arm.events import Source, Verdict
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.node.endpoints import Endpoints, type_name
from pfd_ros.node.graph_check import GraphCheck
from pfd_ros.node.stepping import RESEND_SECONDS, Stepper
from pfd_ros.node.throttled_log import ThrottledLog
from pfd_ros.recording.format import ROLE_OF_SOURCE
from pfd_ros.text import cut, listed

# Behind a number of seconds.
WAITS_TEXT = (
    's in lockstep without a command that has the stamp of the last state, a later one or none; '
    'does the controller run at publish_rate, and by a clock of that clock_rate?'
)
# A clock may be slow, and discovery takes up to three seconds.
LOST_CLOCK_SECONDS = 5


@dataclass
class Reporter:
    """Logs the counts of the other parts, which other threads write and only this one reads."""

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
            f'takes commands on {named.topic_name} ({type_name(named)}: name and {kinds}) and '
            f'{plain.topic_name} ({type_name(plain)}: efforts in this order: {order})'
        )
        self.log.info(f'publishes {published}')
        self.log.info(f'{cut(engine.settings.robot)}: {len(engine.arm.names)} joints, held')

    def report(self, *, last: bool = False) -> None:
        """Log the troubles since the last call, and look at the other nodes unless it ends."""
        tell = self.log.count
        self._report_commands(last)
        missed = self.stepper.timer.missed
        tell('missed', missed, 'periods missed: this machine is too slow', last=last)
        for publisher in self.stepper.publishers.values():
            text = (
                f'messages not published on {publisher.topic}, '
                f'a reader takes none: {publisher.detail}'
            )
            tell(publisher.topic, publisher.refused, text, last=last)
        text = 'messages not recorded: the disk is too slow'
        tell('recorder', self.stepper.session.dropped, text, last=last)
        link, actuators = self.stepper.engine.link, self.stepper.engine.actuators
        tell('timeouts', link.timeouts, TIMEOUT_TEXT, last=last)
        text = f'times a reflex braked all joints: {actuators.reflex}'
        tell('reflex', actuators.trips, text, error=True, last=last)
        waited = int(self.stepper.resent * RESEND_SECONDS)
        tell('lockstep', waited, WAITS_TEXT, last=last)
        arm = self.stepper.engine.arm
        text = f'failure, simulation stopped: {arm.failure or "until a reset"}'
        tell('failure', arm.failures, text, error=True, last=last)
        if not last:
            self._report_lost_clock()
            self.graph.check()

    def _report_lost_clock(self) -> None:
        """Log that the clock the arm follows has come to an end, as long as it lasts."""
        if self.stepper.engine.pace.clock is None:
            return
        ticks, _ = self.stepper.receiver.counts.verdicts().get(
            (Source.TICK, Verdict.ACCEPTED), (0, '')
        )
        if ticks != self._ticks:
            self._ticks, self._ticked = ticks, time.monotonic()
        silent = int(time.monotonic() - self._ticked)
        topic = self.endpoints.subscriptions[Source.TICK].topic_name
        text = f's after the last tick on {topic}: simulated time stands'
        if silent >= LOST_CLOCK_SECONDS:
            self._silent += 1
            self.log.count('clock', self._silent, f'looks in vain, {silent} {text}')

    def _report_commands(self, last: bool) -> None:
        for (source, verdict), (count, detail) in self.stepper.receiver.counts.verdicts().items():
            if verdict not in QUIET:
                text = (
                    f'messages on {ROLE_OF_SOURCE[source]} dropped: '
                    f'{verdict.name.lower()} ({detail})'
                )
                self.log.count((source, verdict), count, text, error=verdict in ERRORS, last=last)
        locked = self.stepper.receiver.counts.locked()
        if locked:
            text = f'commands name joints that are locked and do not move: {listed(locked)}'
            self.log.once('locked', text)
        count, names = self.stepper.receiver.counts.unknown()
        self.log.count('unknown', count, f'unknown joint names: {listed(names)}', last=last)

    def problems(self) -> list[str]:
        """Return why the run was no success, though it came to its end."""
        failed = bool(self.stepper.engine.arm.failure)
        found = ['the simulation did not go on to the end'] if failed else []
        return found + self.stepper.session.problems()

    def totals(self) -> dict[str, Any]:
        """Return the totals of the run, for the log and for the recording's last record."""
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
