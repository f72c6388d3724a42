# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary of a recording, without a simulation: what happened, by counts and times."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

from pfd_ros.arm.events import INPUTS, REJECTED, REJECTED_COUNTS, STATES
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.text_and_arrays import decode_string
from pfd_ros.recording.format import EndKey, damage_named
from pfd_ros.recording.log import Log
from pfd_ros.recording.provenance import versions
from pfd_ros.text import one_line

# Software whose versions may change the bits.
DECISIVE = ('pfd', 'numpy', 'llvmlite')


class Summary(NamedTuple):
    """A recorded run.

    Attributes
    ----------
    counts
        Messages by role.
    rejected
        Refused inputs by role and rule, such as 'commands wrong_size', with those of a flood that
        were only counted.
    cycles
        The last cycle.
    seconds
        Wall time from the first message to the last, s.
    failure
        Why the simulation stopped, or ''.
    """

    path: Path
    settings: Settings
    versions: dict[str, str]
    counts: Counter[str]
    rejected: Counter[str]
    cycles: int
    seconds: float
    failure: str
    complete: bool


def summarize(path: Path | str) -> Summary:
    """Read a recording to its end.

    Raises
    ------
    LogError
        If the file is no recording of this edition, or is damaged.
    OSError
        If it cannot be read.
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
    return Summary(
        log.path,
        log.settings,
        log.versions,
        counts,
        rejected,
        totals.get('cycles', cycles),
        (walls[-1] - walls[0]) / 1e9 if walls else 0.0,
        totals.get('failure', ''),
        log.complete,
    )


def lines(found: Summary) -> list[str]:
    """Return the lines that describe a recorded run."""
    settings, states = found.settings, found.counts[STATES]
    inputs = ', '.join(f'{found.counts[role]} {role}' for role in INPUTS if found.counts[role])
    rate = f', {(states - 1) / found.seconds:.2f} Hz' if states > 1 and found.seconds > 0 else ''
    text = [
        f'{found.path}: {settings.robot}',
        f'duration   {found.cycles * settings.step_size:.3f} s simulated, '
        f'{found.seconds:.3f} s on the clock',
        f'cycles     {found.cycles} of {settings.step_size:g} s',
        f'states     {states}{rate}',
        f'inputs     {inputs or "none"}',
    ]
    text += [f'rejected   {count} {kind}' for kind, count in sorted(found.rejected.items())]
    if found.failure:
        text.append(f'FAILED     the simulation stopped: {found.failure}')
    if not found.complete:
        text.append('cut off    the file was not closed; the summary is up to the cut')
    here = versions()
    text += [
        f'note       recorded with {name} {found.versions[name]}, this is {here[name]}'
        for name in DECISIVE
        if name in found.versions and found.versions[name] != here[name]
    ]
    return [one_line(line) for line in text]
