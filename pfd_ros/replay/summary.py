# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The summary of a recording, for people."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from pfd_ros.arm.events import STATES, Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.recording.run_parts import parts_after, parts_between
from pfd_ros.text import one_line

# Gaps that a summary names.
_SHOWN = 3


@dataclass
class Summary:
    """Counts, times and the failure of a recorded run, if any; verified by a replay or not."""

    path: Path
    settings: Settings
    complete: bool = False
    # Whether the file has the node's end record, with the counts and digests of all messages.
    ended: bool = False
    versions: dict[str, str] = field(default_factory=dict)
    # Up to the last recorded state. A failed arm did not move after step `stopped_at`.
    steps: int = 0
    states: int = 0
    # Recorded states that the sensors dropped.
    unpublished: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    # Messages that were never written; the lost end of a cut-off file does not count.
    dropped: int = 0
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    waiting: int = 0
    first_ns: int = 0
    last_ns: int = 0
    stopped_at: int | None = None
    failure: str = ''
    obstacle: str = ''
    # Steps whose inputs are missing: the first one, and the one after which a recorded state of
    # the whole arm allows the replay to continue.
    gaps: list[tuple[int, int]] = field(default_factory=list)
    # False if a closed file lacks its beginning.
    beginning: bool = True
    # States within gaps, which a replay did not compare.
    uncompared: int = 0
    # Number of the file in its run, the step before its first step, and whether a file follows.
    part: int = 1
    start: int = 0
    continues: bool = False

    @property
    def missing(self) -> int:
        """States that were published but not recorded."""
        return self.lost.get(STATES, 0)

    @property
    def absent(self) -> list[str]:
        """Everything that a complete recording has and this one lacks."""
        return RunSummary([self]).absent

    @property
    def lacking(self) -> list[str]:
        """Everything that this file should have and lacks."""
        found = []
        if not self.complete:
            found.append('the end of the file, which was not closed')
        elif not self.ended:
            found.append(
                'the end record of the node, without which messages at the end may be missing'
            )
        if not self.beginning:
            found.append('the beginning of the log')
        found += [f'inputs of steps {first} to {last}' for first, last in self.gaps[:_SHOWN]]
        lost = max(self.dropped, sum(self.lost.values()))
        if lost:
            found.append(f'{lost} messages that were not recorded')
        return found

    @property
    def simulated(self) -> int:
        """Steps in the file until the arm stopped, or to the last one."""
        return max(0, (self.steps if self.stopped_at is None else self.stopped_at) - self.start)

    @property
    def seconds(self) -> float:
        """Wall time from the first recorded state to the last, s."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def rate(self) -> float:
        """Recorded states per second of wall time, Hz; 0 with fewer than two states."""
        published = self.states + self.missing
        return (published - 1) / self.seconds if published > 1 and self.seconds > 0 else 0.0


@dataclass
class RunSummary:
    """The files of one run, in their order."""

    parts: list[Summary]

    @property
    def compared(self) -> int:
        """States that a replay compared."""
        return sum(part.states - part.uncompared for part in self.parts)

    @property
    def merged(self) -> Summary:
        """The run as one file: its counts are sums."""
        first, last = self.parts[0], self.parts[-1]
        lost: Counter[str] = Counter()
        for part in self.parts:
            lost.update(part.lost)
        return replace(
            last,
            path=first.path,
            complete=all(part.complete for part in self.parts),
            ended=all(part.ended for part in self.parts),
            states=sum(part.states for part in self.parts),
            unpublished=sum(part.unpublished for part in self.parts),
            lost=dict(lost),
            dropped=sum(part.dropped for part in self.parts),
            verdicts=sum((part.verdicts for part in self.parts), Counter[Verdict]()),
            first_ns=next((part.first_ns for part in self.parts if part.first_ns), 0),
            last_ns=max(part.last_ns for part in self.parts),
            obstacle=next((part.obstacle for part in self.parts if part.obstacle), ''),
            gaps=[gap for part in self.parts for gap in part.gaps],
            beginning=all(part.beginning for part in self.parts),
            uncompared=sum(part.uncompared for part in self.parts),
            part=first.part,
            start=first.start,
        )

    @property
    def absent(self) -> list[str]:
        """Everything that a complete recording has and this one lacks."""
        found, number = [], 0
        for part in self.parts:
            found += parts_between(number, part.part)
            place = f' ({one_line(part.path.name)})' if len(self.parts) > 1 else ''
            found += [f'{lacking}{place}' for lacking in part.lacking]
            number = part.part
        if self.parts[-1].continues:
            found.append(parts_after(number))
        return found
