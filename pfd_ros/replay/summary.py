# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary of a recording, without a simulation: what happened, by counts and times."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from pfd_ros.arm.events import INPUTS, REJECTED, REJECTED_COUNTS, STATES
from pfd_ros.messages.text_and_arrays import decode_string
from pfd_ros.recording.format import EndKey, damage_named
from pfd_ros.recording.log import Log
from pfd_ros.recording.provenance import DECISIVE, versions
from pfd_ros.text import one_line


class Summary(NamedTuple):
    """A recorded run: messages by role, and refused inputs by role and rule.

    `rejected` includes those of a flood that were only counted; `cycles` is the last cycle,
    `seconds` the wall time from the first message to the last. `totals` are those of the end.
    """

    log: Log
    counts: Counter[str]
    rejected: Counter[str]
    cycles: int
    seconds: float
    totals: dict[str, Any]


def summarize(path: Path | str) -> Summary:
    """Read a recording to its end.

    LogError if the file is no recording of this edition, or is damaged; OSError if it cannot be
    read.
    """
    log = Log(path)
    counts, rejected, walls, cycles = Counter[str](), Counter[str](), list[int](), 0
    simulated = log.settings.log_time == 'simulated'
    with damage_named(log.path):
        for (role, data, cycle), log_ns, publish_ns in log.timed():
            counts[role] += 1
            cycles = max(cycles, cycle)
            walls[1:] = [publish_ns if simulated else log_ns]
            if role in (REJECTED, REJECTED_COUNTS):
                kind, _, rest = decode_string(data).partition('\n')
                rejected[kind] += int(rest.split()[0]) if role == REJECTED_COUNTS else 1
        totals = log.end.get(EndKey.TOTALS, {})
        cycles = totals.get('cycles', cycles)
    seconds = (walls[-1] - walls[0]) / 1e9 if walls else 0.0
    return Summary(log, counts, rejected, cycles, seconds, totals)


def lines(found: Summary) -> list[str]:
    """Return the lines that describe a recorded run."""
    log, totals, settings = found.log, found.totals, found.log.settings
    states = found.counts[STATES]
    inputs = ', '.join(f'{found.counts[role]} {role}' for role in INPUTS if found.counts[role])
    rate = f', {(states - 1) / found.seconds:.2f} Hz' if states > 1 and found.seconds > 0 else ''
    text = [
        f'{log.path}: {settings.robot}',
        f'duration   {found.cycles * settings.step_size:.3f} s simulated, '
        f'{found.seconds:.3f} s on the clock',
        f'cycles     {found.cycles} of {settings.step_size:g} s',
        f'states     {states}{rate}',
        f'inputs     {inputs or "none"}',
    ]
    text += [f'rejected   {count} {kind}' for kind, count in sorted(found.rejected.items())]
    if why := totals.get('failure'):
        text.append(f'FAILED     the simulation stopped: {why}')
    elif count := totals.get('failures'):
        text.append(f'failed     the simulation stopped {count} times, and a reset cleared it')
    if not log.complete:
        text.append('cut off    the file was not closed; the summary is up to the cut')
    here = versions()
    text += [
        f'note       recorded with {name} {log.versions[name]}, this is {here[name]}'
        for name in DECISIVE
        if log.versions.get(name, here[name]) != here[name]
    ]
    return [one_line(line) for line in text]
