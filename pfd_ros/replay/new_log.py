# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of a changed run: a file as the node writes it, at the recorded times."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import NUMBERED_AS_STATES
from pfd_ros.arm.settings import SIMULATED
from pfd_ros.recording import provenance
from pfd_ros.recording.block_writer import NewMessage
from pfd_ros.recording.engine_log import channels_without_node
from pfd_ros.recording.format import SEQUENCE_MASK, SOURCE_OF_ROLE, EndKey
from pfd_ros.recording.mcap_file import McapFile, TimeBase, channel_table

# Times of cycles in memory.
MOST_TIMES = 4096
# Messages that are written at a time, and bytes of messages that wait for a flush.
BLOCK_MESSAGES = 256
FLUSH_BYTES = 1 << 22


def free_path(source: Path) -> Path:
    """Return an unused path next to a log: `log_what_if.mcap`, or with a number."""
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
    engine
        Of the run, before its first cycle.
    topics
        Topic of each role that the source has.
    started_ns
        Time of day of the start.

    Raises
    ------
    OSError
        If the file exists or cannot be written.

    """

    def __init__(
        self,
        path: Path,
        engine: Engine,
        topics: Mapping[str, str],
        started_ns: int,
    ) -> None:
        settings, frames = engine.settings, engine.frames
        channels = channels_without_node(engine, topics)
        names = {role: channel.name for role, channel in channels.items()}
        self._simulated = settings.log_time == SIMULATED
        base = TimeBase(started_ns, simulated=self._simulated, start_ns=settings.start_ns)
        head = provenance.file_head(settings, engine.arm.robot, names, base, engine.arm.program)
        self.path = path
        self._index = {role: k for k, role in enumerate(channels)}
        self._names = names
        self._file = McapFile(path, channel_table([*channels.values()]), head)
        self._block: list[NewMessage] = []
        self._last_ns = settings.start_ns if self._simulated else started_ns
        self._newest: Counter[str] = Counter()
        if frames is not None:
            for output in frames.opening(settings.start_ns):
                self.add(output.role, started_ns, output.number, output.data, settings.start_ns)

    def add(self, role: str, wall_ns: int, number: int, data: bytes, stamp_ns: int) -> None:
        """Write a message with its time of day and its simulated time.

        A log time that would decrease is replaced by the previous one.
        """
        log_ns, published_ns = (stamp_ns, wall_ns) if self._simulated else (wall_ns, stamp_ns)
        if log_ns > self._last_ns:
            self._last_ns = log_ns
        number_there = number & SEQUENCE_MASK
        self._block.append((self._index[role], self._last_ns, published_ns, number_there, data))
        if number > self._newest[role]:
            self._newest[role] = number
        if len(self._block) >= BLOCK_MESSAGES:
            self._write_block()

    def _write_block(self) -> None:
        self._file.add_all(self._block)
        self._block.clear()
        if self._file.waiting >= FLUSH_BYTES:
            self._file.flush()

    def finish(self, totals: Mapping[str, Any]) -> None:
        """Write the totals of the run, and close the file."""
        self._write_block()
        counts = {role: self._file.counts[place] for role, place in self._index.items()}
        recorded = {name: counts[role] for role, name in self._names.items()}
        # Only inputs that the source lost are missing here.
        dropped = {
            name: self._newest[role] - counts[role] if role in SOURCE_OF_ROLE else 0
            for role, name in self._names.items()
        }
        states = sum(counts.get(role, 0) for role in NUMBERED_AS_STATES)
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


class LogTimes:
    """The time of day of each cycle, ns, interpolated between recorded outputs."""

    def __init__(self, started_ns: int) -> None:
        self._cycles, self._times = [0], [started_ns]

    def add(self, cycle: int, log_ns: int) -> None:
        """Add the time of a later cycle."""
        if cycle > self._cycles[-1]:
            self._cycles.append(cycle)
            self._times.append(max(log_ns, self._times[-1]))

    def add_all(self, cycles: NDArray[Any], log_ns: NDArray[Any]) -> None:
        """Add the times of cycles, as `add` does one by one."""
        reached = np.maximum.accumulate(np.append(self._cycles[-1], cycles))
        later = np.diff(reached) > 0
        times = np.maximum.accumulate(np.append(self._times[-1], log_ns[later]))
        self._cycles += reached[1:][later].tolist()
        self._times += times[1:].tolist()

    def at(self, cycle: int) -> int:
        """Return the time of one cycle; later calls ask for no earlier cycle."""
        k = bisect_left(self._cycles, cycle)
        if k > MOST_TIMES:
            del self._cycles[: k - 1], self._times[: k - 1]
            k = 1
        if k == len(self._cycles):
            return self._times[-1]
        if self._cycles[k] == cycle or k == 0:
            return self._times[k]
        (low, high), (begin, end) = self._cycles[k - 1 : k + 1], self._times[k - 1 : k + 1]
        return begin + (end - begin) * (cycle - low) // (high - low)

    def of(self, first: int, count: int) -> NDArray[np.int64]:
        """Return the times of successive cycles, (count,), as `at`."""
        base = self._times[0]
        after = [t - base for t in self._times]
        found = np.interp(np.arange(first, first + count), self._cycles, after)
        keep = max(0, int(np.searchsorted(self._cycles, first)) - 1)
        del self._cycles[:keep], self._times[:keep]
        times: NDArray[np.int64] = base + np.round(found).astype(np.int64)
        return times
