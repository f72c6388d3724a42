# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What went wrong in a run, and when: limits reached, rejected commands, gaps, reflexes, failures.

A finding covers all events of one kind at one joint: the first time, a text about it, the count,
and the first spans of time, up to a bound.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pfd_ros.arm.events import Source, ValidationRow, Verdict
from pfd_ros.page.curves import Array
from pfd_ros.recording.format import ROLE_OF_SOURCE

BAD, WARNING, NOTE = 'bad', 'warning', 'note'
# Of a finding; neighbours are joined beyond it. And findings of a page.
MOST_SPANS = 400
MOST_FINDINGS = 200
# Newer commands replace older ones; a driver sends NaN until a controller has claimed the joint.
EXPECTED = frozenset({Verdict.ACCEPTED, Verdict.OVERFLOWED, Verdict.ALL_NAN})
REASONS = {
    Verdict.MALFORMED: 'bytes are not a message of this type',
    Verdict.NO_NAMES: 'no joint names',
    Verdict.RAGGED: 'names and numbers differ in length',
    Verdict.INFINITE: 'an infinite number',
    Verdict.STALE: 'its stamp is older than the state to answer, a reset or a jump',
    Verdict.DUPLICATE_NAMES: 'a joint is named twice',
    Verdict.NO_EFFORT: 'no effort',
    Verdict.UNKNOWN_NAMES: 'no joint of this arm',
    Verdict.ALL_NAN: 'NaN only',
    Verdict.WRONG_SIZE: 'not one number for each joint',
    Verdict.NOT_FINITE: 'NaN or infinity',
    Verdict.OVERFLOWED: 'replaced by a newer message before the next step',
    Verdict.REFUSED: 'the arm is inactive or braked by a reflex, or the request is not possible',
}


@dataclass
class Finding:
    """Everything of one kind at one joint, times in s."""

    kind: str
    severity: str
    text: str
    time: float
    joint: str = ''
    count: int = 0
    spans: list[tuple[float, float]] = field(default_factory=list)

    def add(self, start: float, end: float) -> None:
        """Add a span, after the last one."""
        self.count += 1
        self.spans.append((start, end))
        if len(self.spans) > MOST_SPANS:
            pairs = zip(self.spans[::2], self.spans[1::2], strict=False)
            self.spans = [(first[0], second[1]) for first, second in pairs]


class Findings:
    """The findings of a run, by kind and joint."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str, str], Finding] = {}
        self.left_out = 0

    def add(
        self,
        kind: str,
        severity: str,
        text: str,
        span: tuple[float, float],
        joint: str = '',
        key: str = '',
    ) -> None:
        """Add one occurrence; the first with this kind, joint and key is described by `text`."""
        place = kind, joint, key
        if place not in self._found:
            if len(self._found) >= MOST_FINDINGS:
                self.left_out += 1
                return
            self._found[place] = Finding(kind, severity, text, span[0], joint)
        self._found[place].add(*span)

    def extend(self, kind: str, joint: str, end: float) -> None:
        """Move the end of the last span: the occurrence lasts."""
        found = self._found.get((kind, joint, ''))
        if found is not None:
            found.spans[-1] = (found.spans[-1][0], end)

    def sorted(self) -> list[Finding]:
        """Return all findings in the order of time; at one time the worst first."""
        rank = (BAD, WARNING, NOTE).index
        return sorted(self._found.values(), key=lambda f: (f.time, rank(f.severity)))

    def first(self) -> Finding | None:
        """Return the first finding that is more than a note, or None."""
        return next((found for found in self.sorted() if found.severity != NOTE), None)


@dataclass
class LimitCheck:
    """Looks for samples of a joint at or beyond a limit, part by part."""

    joint: str
    kind: str
    unit: str
    lower: float
    upper: float
    _outside: bool = False

    def feed(self, time: Array, values: Array, findings: Findings) -> None:
        """Look at samples (N,), after those before."""
        outside = ~((values > self.lower) & (values < self.upper)) & np.isfinite(values)
        kind = f'{self.kind} limit'
        changes = np.flatnonzero(np.diff(outside, prepend=self._outside))
        ends = [*changes[1:], len(time)]
        for start, end in zip(changes, ends, strict=False):
            if not outside[start]:
                continue
            last = float(time[end - 1])
            bound = self.lower if values[start] <= self.lower else self.upper
            findings.add(
                kind,
                # Motors saturate in good runs, too.
                WARNING if self.kind == 'effort' else BAD,
                f'{self.kind} {values[start]:.4g} {self.unit}, at or beyond its limit {bound:.4g}',
                (float(time[start]), last),
                self.joint,
            )
        if self._outside and len(time) and outside[0]:
            stop = int(changes[0]) if len(changes) else len(time)
            findings.extend(kind, self.joint, float(time[stop - 1]))
        if len(outside):
            self._outside = bool(outside[-1])


@dataclass
class GapCheck:
    """Looks for states that are missing: intervals much longer than the period [s]."""

    topic: str
    period: float = 0.0
    # A note, if the settings let the sensors drop states.
    severity: str = WARNING
    _last: float | None = None

    def feed(self, time: Array, findings: Findings) -> Array:
        """Look at times (N,), after those before; return the places before which states miss."""
        before = [] if self._last is None else [self._last]
        intervals = np.diff(np.concatenate([before, time]))
        if len(time):
            self._last = float(time[-1])
        if not self.period and len(intervals):
            self.period = float(np.median(intervals))
        if not self.period > 0.0:
            return np.empty(0, np.intp)
        late = np.flatnonzero(intervals > 1.5 * self.period)
        places: Array = late + (1 - len(before))
        for place, k in zip(places, late, strict=True):
            end, length = float(time[place]), float(intervals[k])
            findings.add(
                'gap',
                self.severity,
                f'no state on {self.topic} for {1e3 * length:.4g} ms '
                f'(period {1e3 * self.period:.4g} ms)',
                (end - length, end),
            )
        return places


@dataclass
class InputCheck:
    """Reads validation rows: rejected inputs, and the watchdog.

    Parameters
    ----------
    timeout
        Longest time without an accepted command [s], 0 for no limit.
    on_timeout
        Reaction of the arm to a timeout.
    reflex_rate
        Rate of an effort beyond which the reflex acts, N m/s or N/s, 0 for no reflex.
    """

    timeout: float = 0.0
    on_timeout: str = ''
    reflex_rate: float = 0.0
    accepted: int = 0
    rejected: int = 0
    last_accepted: float | None = None

    def feed(self, time: float, row: ValidationRow, detail: str, findings: Findings) -> None:
        """Take one row; `detail` names the wrong number, if it is known."""
        command = row.source in (Source.NAMED, Source.ARRAY)
        name = ROLE_OF_SOURCE[row.source]
        if row.verdict is Verdict.ACCEPTED:
            self.accepted += 1
            if command:
                self.check_timeout(time, findings)
                self.last_accepted = time
            return
        self.rejected += 1
        reason = row.verdict.label
        if row.verdict is Verdict.REFUSED and command and self.reflex_rate:
            findings.add(
                'reflex',
                BAD,
                'the reflex braked all joints: an effort changed faster than reflex_effort_rate '
                f'{self.reflex_rate:g} per second; commands are refused until ~/reset',
                (time, time),
            )
            return
        severity = NOTE if row.verdict in EXPECTED else BAD
        why = detail or REASONS.get(row.verdict, '')
        text = f'{name} {row.sequence} rejected as {reason}: {why}'
        findings.add('rejected input', severity, text, (time, time), key=f'{name} {reason}')

    def check_timeout(self, time: float, findings: Findings) -> None:
        """Note the watchdog if it acted before this time."""
        last = self.last_accepted
        if not self.timeout or last is None or time - last <= self.timeout:
            return
        findings.add(
            'watchdog',
            BAD,
            f'no command for command_timeout {self.timeout:g} s: {self.on_timeout}',
            (last + self.timeout, time),
        )
