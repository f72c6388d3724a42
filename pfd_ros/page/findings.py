# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What went wrong in a log, and when: one finding a kind and joint, with its spans of time.

A check is a function of a `Recorded` that yields findings, and a function that returns why it
cannot be made, '' if it can. CHECKS names all, for a page says what was checked. A new check is a
function, its row in CHECKS, and its kinds in KINDS.

When a controller ends, a watchdog stops the arm: what happens after the last command is a note.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, field, replace
import re
from typing import Any, TypeVar

import numpy as np

from pfd_ros.arm.actuators import has_reflex
from pfd_ros.arm.events import (
    BUSY,
    COMMANDS,
    INACTIVE,
    PARAMETERS,
    REJECTED,
    REQUESTS,
    SET_STATE,
    TRAJECTORY,
    TRANSITION,
)
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import DIAGNOSTICS
from pfd_ros.page.recorded import Array, Recorded
from pfd_ros.text import cut, one_line

T = TypeVar('T', bound=Hashable)
KINDS = (
    *(*(f'{item} limit' for item in JOINT_FIELDS), 'not finite', 'gap', 'rejected input'),
    *('reflex', 'watchdog', 'failure', 'diagnostics', 'event'),
)
BAD, WARNING, NOTE = 'bad', 'warning', 'note'
# A shorter time without commands at the end of a log is no end of the controller [s].
SILENCE = 0.1
# What ends so long after the last state is behind the window of a log [s].
LATE = 1.0
TEXT_LENGTH = 200
# A number that is no part of a name.
NUMBER = re.compile(r'(?<![\w.:=/])-?\d[\d.]*(?:e[-+]?\d+)?(?![\w/])')


@dataclass(frozen=True, eq=False)
class Finding:
    """Everything of one kind at one joint; `spans` (k, 2) are first and last times [s]."""

    kind: str
    severity: str
    joint: str
    text: str
    spans: Array = field(repr=False)

    @property
    def time(self) -> float:
        """When it began."""
        return float(self.spans[0, 0])


def _finding(kind: str, severity: str, text: object, *times: float) -> Finding:
    """Return a finding of no joint, at single times."""
    spans = np.stack([times, times], axis=1)
    return Finding(kind, severity, '', one_line(text, TEXT_LENGTH), spans)


def _grouped(rows: Iterable[tuple[T, float]]) -> dict[T, list[float]]:
    """Return the times of each of some things, in their first order."""
    groups: dict[T, list[float]] = {}
    for what, time in rows:
        groups.setdefault(what, []).append(time)
    return groups


def _spans(time: Array, holds: Array) -> Array:
    """Return first and last times (k, 2) of the runs in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    return np.stack([time[edges[::2]], time[edges[1::2] - 1]], axis=1)


def _limits(run: Recorded) -> Iterator[Finding]:
    for joints in (*run.joints, *run.drives):
        unit_of = run.unit if joints in run.drives else run.states_unit
        for item, (low, high) in joints.bounds.items():
            values = joints.values[item]
            out = np.isfinite(values) & ~((values > low) & (values < high))
            if item == 'position':  # a joint that begins at a limit has not reached it yet
                start = values[:1]
                began = np.logical_and.accumulate(values == start)
                out &= ~(began & ((start == low) | (start == high)))
            for j in np.flatnonzero(out.any(axis=0)):
                first = values[int(np.argmax(out[:, j])), j]
                bound = low[j] if first <= low[j] else high[j]
                unit = unit_of(item, joints.names[j : j + 1])
                text = f'{item} {first:.4g} {unit}, at or beyond its limit {bound:.4g}'
                # Motors saturate in good runs, too.
                severity = WARNING if item == 'effort' else BAD
                spans = _spans(joints.time, out[:, j])
                yield Finding(f'{item} limit', severity, joints.names[j], text, spans)


def _without_limits(run: Recorded) -> str:
    if run.robot is None:
        return 'the log names no robot; --robot adds one'
    if not set(run.names) & set(run.robot.joint_names):
        return f'no joint of the log is one of {cut(run.robot.name)}'
    bounds = [x for joints in run.joints for x in joints.bounds.values()]
    return '' if any(np.isfinite(x).any() for x in bounds) else 'the robot has none'


def _not_finite(run: Recorded) -> Iterator[Finding]:
    for joints in run.joints:
        for item, values in joints.values.items():
            # Drivers leave out what they do not measure.
            wrong = ~np.isfinite(values) & ~np.isnan(values).all(axis=0)
            for j in np.flatnonzero(wrong.any(axis=0)):
                text = f'{item} is {values[int(np.argmax(wrong[:, j])), j]}'
                spans = _spans(joints.time, wrong[:, j])
                yield Finding('not finite', BAD, joints.names[j], text, spans)


def _gaps(run: Recorded) -> Iterator[Finding]:
    severity = NOTE if run.settings.get('drop_state') else WARNING
    for joints in run.joints:
        if len(joints.gaps):
            spans = np.stack([joints.time[joints.gaps - 1], joints.time[joints.gaps]], axis=1)
            length, of = 1e3 * (spans[0, 1] - spans[0, 0]), 1e3 * joints.period
            named = f' of {joints.names[0]}' if len(run.joints) > 1 else ''
            text = f'no state{named} on {run.topic} for {length:.4g} ms (period {of:.4g} ms)'
            yield Finding('gap', severity, '', one_line(text), spans)


def _rejected(run: Recorded) -> Iterator[Finding]:
    """Yield rejected inputs by role and label; those that a reflex refused are the reflex."""
    found = run.of_role(REJECTED)
    if found is None:
        return
    texts = [str(text).partition('\n')[::2] for text in found.data]
    details = dict(reversed(texts))
    kinds = [kind for kind, _ in texts]
    for kind, times in _grouped(zip(kinds, run.times(found), strict=True)).items():
        role, _, label = kind.partition(' ')
        reflex = has_reflex(run.settings) and details[kind] != INACTIVE.detail
        if label == 'refused' and role in COMMANDS and reflex:
            text = f'all joints braked: {details[kind]}; commands are refused until ~/reset'
            yield _finding('reflex', BAD, text, *times)
        else:
            yield _finding('rejected input', BAD, f'{role} {label}: {details[kind]}', *times)


def _commands(run: Recorded, *, accepted: bool) -> Array:
    """Return the times of commands [s], sorted: of all, or of those that were accepted."""
    if accepted:
        return np.sort(np.concatenate([run.accepted_times(role) for role in COMMANDS]))
    there = [found for role in COMMANDS if (found := run.of_role(role)) is not None]
    return np.sort(np.concatenate([np.empty(0), *map(run.times, there)]))


def _planned(run: Recorded) -> Array:
    """Return the times of trajectories [s]: the arm commands itself after one."""
    found = run.of_role(TRAJECTORY)
    return np.empty(0) if found is None else run.times(found)


def _last_command(run: Recorded) -> float | None:
    """Return when the commands ended [s], None if they come up to the end of the log."""
    times = _commands(run, accepted=False)
    usual = 3.0 * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    ended = len(times) and run.span[1] - times[-1] > max(SILENCE, usual)
    ended = ended and times[-1] not in _planned(run)
    return float(times[-1]) if ended else None


def commands_end(run: Recorded) -> float | None:
    """Return when the controller of an arm with a watchdog ended [s], None if it did not."""
    return _last_command(run) if run.settings.get('command_timeout') else None


def _watchdog(run: Recorded) -> Iterator[Finding]:
    limit = float(run.settings['command_timeout'])
    sent = np.append(_commands(run, accepted=True), run.span[1])
    late = np.flatnonzero((np.diff(sent) > limit) & ~np.isin(sent[:-1], _planned(run)))
    if len(late):
        text = f'no command for command_timeout {limit:g} s: {run.settings.get("on_timeout", "")}'
        spans = np.stack([sent[late] + limit, sent[late + 1]], axis=1)
        yield Finding('watchdog', BAD, '', text, spans)


def _totals(run: Recorded) -> dict[str, Any]:
    totals = run.log.end.get('totals', {})
    return dict(totals) if isinstance(totals, dict) else {}


def _failure(run: Recorded) -> Iterator[Finding]:
    """Yield from the end record why the simulation stopped, and a reflex that refused nothing."""
    totals = _totals(run)
    start, step = (float(run.settings.get(x) or 0.0) for x in ('start_time', 'step_size'))
    end = start - run.origin_ns / NANOSECONDS + step * float(totals.get('steps', 0))
    if end > run.span[1] + LATE:
        return
    if totals.get('failure'):
        yield _finding('failure', BAD, f'the simulation stopped: {totals["failure"]}', end)
    if totals.get('reflex') and all(x.kind != 'reflex' for x in _rejected(run)):
        yield _finding('reflex', BAD, f'all joints braked at the end: {totals["reflex"]}', end)


def _diagnostics(run: Recorded) -> Iterator[Finding]:
    """Yield what warnings and errors say, once for texts that differ in their numbers alone."""
    rows: list[tuple[tuple[str, str], float]] = []
    first: dict[str, str] = {}
    for found in run.log.of_type(DIAGNOSTICS).values():
        level, name, text = (found.arrays[f'status.{x}'] for x in ('level', 'name', 'message'))
        times = run.times(found)
        for k, j in np.argwhere(np.nan_to_num(level.astype(float)) >= 1):
            severity = BAD if level[k, j] >= 2 else NOTE if text[k, j] == BUSY else WARNING
            line = f'{name[k, j]}: {text[k, j]}'
            line = first.setdefault(NUMBER.sub('#', line), line)
            rows.append(((severity, line), times[k]))
    for (severity, line), found_at in _grouped(rows).items():
        yield _finding('diagnostics', severity, line, *found_at)


def _events(run: Recorded) -> Iterator[Finding]:
    """Requests, states that were set, changes of parameters, and transitions: no faults."""
    rows: list[tuple[str, float]] = []
    for role, what in ((REQUESTS, 'request'), (PARAMETERS, 'parameters'), (SET_STATE, SET_STATE)):
        found = run.of_role(role)
        if found is not None:
            texts = [''] * len(found) if role == SET_STATE else found.data
            rows += [(f'{what} {x}', t) for x, t in zip(texts, run.times(found), strict=True)]
    for found in run.log.of_type(TRANSITION).values():
        states = zip(found['start_state.label'], found['goal_state.label'], strict=True)
        texts = [f'lifecycle: {start} to {goal}' for start, goal in states]
        rows += zip(texts, run.times(found), strict=True)
    last = _last_command(run)
    if last is not None:
        rows.append(
            (f'the last command: none in the {run.span[1] - last:.3g} s that follow', last)
        )
    for text, times in _grouped(rows).items():
        yield _finding('event', NOTE, text, *times)


def _without_states(run: Recorded) -> str:
    return '' if run.joints else 'no joint states'


Check = Callable[[Recorded], Iterator[Finding]]
# Name -> check, and why it cannot be made.
CHECKS: dict[str, tuple[Check, Callable[[Recorded], str]]] = {
    'limits': (_limits, _without_limits),
    'finite numbers': (_not_finite, _without_states),
    'missing states': (_gaps, _without_states),
    'rejected inputs and reflexes': (
        _rejected,
        lambda run: '' if run.settings else 'not a recording of pfd',
    ),
    'watchdog': (
        _watchdog,
        lambda run: '' if run.settings.get('command_timeout') else 'no command_timeout',
    ),
    'failure of the simulation': (_failure, lambda run: '' if _totals(run) else 'no end record'),
    'diagnostics': (
        _diagnostics,
        lambda run: '' if run.log.of_type(DIAGNOSTICS) else 'none recorded',
    ),
    'events': (_events, lambda run: ''),
}


def find(run: Recorded) -> tuple[list[Finding], list[str], dict[str, str]]:
    """Return findings in the order of time, checks that were made, and why others were not."""
    lacking = {name: why for name, (_, impossible) in CHECKS.items() if (why := impossible(run))}
    made = [name for name in CHECKS if name not in lacking]
    found = [each for name in made for each in CHECKS[name][0](run)]
    end = commands_end(run)
    if end is not None:
        late = [x.time > end and x.kind not in ('failure', 'reflex') for x in found]
        found = [
            replace(x, severity=NOTE) if after else x for x, after in zip(found, late, strict=True)
        ]
    rank = (BAD, WARNING, NOTE).index
    return sorted(found, key=lambda x: (x.time, rank(x.severity))), made, lacking
