# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of a run that a replay changed: a file like the node's, at the recorded times."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping
import json
from pathlib import Path
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import CLOCK, NUMBERED_AS_STATES, STATES, TAKEN
from pfd_ros.arm.outputs import roles_of
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.qos import qos_text
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS, ROLE_OF_SOURCE, SOURCE_OF_ROLE, EndKey
from pfd_ros.recording.mcap_file import McapFile, TimeBase, Topic

# Bytes of messages that wait for a flush.
FLUSH_BYTES = 1 << 22
# Full names of topics, where no recording has resolved them.
ABSOLUTE = {'joint_commands', STATES, CLOCK}
OWN = {TAKEN: 'applied_commands'}


def free_path(source: Path) -> Path:
    """Return a path next to a log that does not exist: `log_what_if.mcap`, or with a number."""
    stem = source.name if source.is_dir() else source.stem
    for number in range(1, 10_000):
        tail = '' if number == 1 else f'_{number}'
        path = source.parent / f'{stem}_what_if{tail}.mcap'
        if not path.exists():
            return path
    raise FileExistsError(f'{path} exists and is not overwritten; name a file with --out')


class NewLog:
    """
    An open recording of a changed run.

    Parameters
    ----------
    path
        The file, which must not exist.
    settings, robot
        Of the run.
    topics
        Topic of each role that the source has.
    started_ns
        Log time of the start.
    program
        Digest of the compiled program.

    Raises
    ------
    OSError
        If the file exists or cannot be written.

    """

    def __init__(
        self,
        path: Path,
        settings: Settings,
        robot: pfd.Robot,
        topics: Mapping[str, str],
        started_ns: int,
        program: str,
    ) -> None:
        wanted = roles_of(settings) | {TAKEN, *ROLE_OF_SOURCE.values()}
        roles = [role for role in CHANNELS if role in wanted]
        names = {role: topics.get(role) or _own_name(role) for role in roles}
        base = TimeBase(started_ns, time.monotonic_ns())
        head = provenance.file_head(settings, robot, names, base, program)
        channels = [
            Topic(names[role], CHANNELS[role].type, qos_text(1), CHANNELS[role].vital)
            for role in roles
        ]
        self.path = path
        self._index = {role: k for k, role in enumerate(roles)}
        self._names = names
        self._file = McapFile(path, channels, head)
        self._last_ns = started_ns
        self._counts: Counter[str] = Counter()
        self._newest: Counter[str] = Counter()

    def add(self, role: str, log_ns: int, number: int, data: bytes) -> None:
        """Write a message; times that would decrease are those of the message before."""
        self._last_ns = max(self._last_ns, log_ns)
        self._file.add(self._index[role], self._last_ns, self._last_ns, number & 0xFFFFFFFF, data)
        self._counts[role] += 1
        self._newest[role] = max(self._newest[role], number)
        if self._file.waiting >= FLUSH_BYTES:
            self._file.flush()

    def finish(self, totals: Mapping[str, Any]) -> None:
        """Write the totals of the run, and close the file."""
        recorded = {name: self._counts[role] for role, name in self._names.items()}
        # Inputs that the source lost are lost here too; nothing else is.
        dropped = {
            name: self._newest[role] - self._counts[role] if role in SOURCE_OF_ROLE else 0
            for role, name in self._names.items()
        }
        states = sum(self._counts[role] for role in NUMBERED_AS_STATES)
        ending = {
            EndKey.TOTALS: {**totals, 'states': states},
            EndKey.RECORDED: recorded,
            EndKey.DROPPED: dropped,
        }
        self._file.finish({key: json.dumps(value) for key, value in ending.items()})
        self._file.sink.close()

    def discard(self) -> None:
        """Close and remove the file."""
        self._file.sink.discard()


def _own_name(role: str) -> str:
    return f'/{role}' if role in ABSOLUTE else f'/sim_arm/{OWN.get(role, role)}'


class LogTimes:
    """The log time of each cycle, ns: between those of recorded outputs in proportion."""

    def __init__(self, started_ns: int) -> None:
        self._cycles, self._times = [0], [started_ns]

    def add(self, cycle: int, log_ns: int) -> None:
        """Add the time of a later cycle."""
        if cycle > self._cycles[-1]:
            self._cycles.append(cycle)
            self._times.append(max(log_ns, self._times[-1]))

    def at(self, cycle: int) -> int:
        """Return the time of one cycle."""
        k = bisect_left(self._cycles, cycle)
        if k == len(self._cycles):
            return self._times[-1]
        if self._cycles[k] == cycle or k == 0:
            return self._times[k]
        (low, high), (begin, end) = self._cycles[k - 1 : k + 1], self._times[k - 1 : k + 1]
        return begin + (end - begin) * (cycle - low) // (high - low)

    def of(self, first: int, count: int) -> NDArray[np.int64]:
        """Return the times of some cycles, (count,), and forget those before."""
        base = self._times[0]
        after = [t - base for t in self._times]
        found = np.interp(np.arange(first, first + count), self._cycles, after)
        keep = max(0, int(np.searchsorted(self._cycles, first)) - 1)
        del self._cycles[:keep], self._times[:keep]
        times: NDArray[np.int64] = base + np.round(found).astype(np.int64)
        return times
