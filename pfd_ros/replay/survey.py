# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Looks through a recording without simulating, for whether all that was recorded is there.

A closed file says how many messages were recorded and dropped on every channel, and all but the
oldest also say their digests; a difference is damage. A file that was cut off is as good as its
numbers: what is missing is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
import hashlib
from pathlib import Path

from pfd_ros.arm.commands import Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import decode_clock
from pfd_ros.recording.format import DIGEST_PREFIX, ROLE_OF_SOURCE, SEQUENCE_MASK, SOURCE_OF_ROLE
from pfd_ros.recording.head import Ending
from pfd_ros.recording.reader import Log
from pfd_ros.replay.events import Event, events

# Commands that may wait to be taken. The node keeps 1000 and 32 MB of them for a step; those that
# it drops in a flood wait in the file for the row that says so.
WAITING_LIMIT = 1 << 16
WAITING_BYTES = 1 << 26


@dataclass
class Summary:
    """What a file holds, and what the replay made of it."""

    path: Path
    settings: Settings
    complete: bool = False
    versions: dict[str, str] = field(default_factory=dict)
    # Up to the last recorded state; the arm itself stood still from `stopped_at` on, if it failed.
    steps: int = 0
    states: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    waiting: int = 0
    first_ns: int = 0
    last_ns: int = 0
    stopped_at: int | None = None
    failure: str = ''
    obstacle: str = ''

    @property
    def missing(self) -> int:
        """States that were published but not recorded."""
        return self.lost.get('joint_states', 0)

    @property
    def simulated(self) -> int:
        """Steps until the arm stopped, or else `steps`."""
        return self.steps if self.stopped_at is None else self.stopped_at

    @property
    def seconds(self) -> float:
        """Wall time from the first recorded state to the last, s."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def rate(self) -> float:
        """Recorded states per second of wall time, Hz; 0 if there are too few to say."""
        published = self.states + self.missing
        return (published - 1) / self.seconds if published > 1 and self.seconds > 0 else 0.0


@dataclass
class _Tally:
    """What one channel holds."""

    found: int = 0
    last: int = 0
    lost: int = 0
    gap: str = ''
    data: bytes = b''
    digest: hashlib._Hash = field(default_factory=hashlib.sha256)

    def add(self, event: Event) -> None:
        self.found += 1
        self.last = event.number
        if event.lost:
            self.lost += event.lost
            self.gap = self.gap or f'{event.number - event.lost} to {event.number - 1}'
        self.data = event.data
        self.digest.update(DIGEST_PREFIX.pack(event.number & SEQUENCE_MASK, len(event.data)))
        self.digest.update(event.data)


@dataclass
class Survey:
    """A recording that has been looked through.

    Attributes
    ----------
    summary
        For people.
    ending
        What the node said when it closed the file, if it did.
    altered
        Why the file is not the one that was closed, or ''; found by a digest, which cannot say
        where, so a replay should look first.
    state
        The last state, as it was recorded.
    """

    summary: Summary
    ending: Ending | None = None
    altered: str = ''
    state: bytes = b''


def survey(log: Log, progress: Callable[[float], None] | None = None) -> Survey:
    """Look through a recording.

    Raises
    ------
    ValueError
        If it is damaged, or a closed file lacks messages; the text says where.
    OSError
        If it cannot be read.
    """
    tallies: dict[str, _Tally] = {}
    verdicts: Counter[Verdict] = Counter()
    inbox = _Inbox()
    span = [0, 0]
    for count, event in enumerate(events(log)):
        tally = tallies.setdefault(event.role, _Tally())
        tally.add(event)
        if event.role in SOURCE_OF_ROLE:
            inbox.put(event)
        elif event.role == 'taken':
            inbox.take(event, tally.found)
            verdicts.update(row.verdict for row in event.rows)
        elif event.role == 'joint_states':
            span = [span[0] or event.log_ns, event.log_ns]
        if progress is not None and count % 1000 == 0:
            progress(log.position / log.size)
    settings = log.settings
    for role in log.roles.values():
        tallies.setdefault(role, _Tally())
    states = tallies['joint_states']
    found = Survey(
        Summary(
            path=log.path,
            settings=settings,
            complete=log.complete,
            versions=log.versions,
            steps=states.last * settings.publish_every,
            states=states.found,
            lost={role: tally.lost for role, tally in tallies.items() if tally.lost},
            verdicts=verdicts,
            waiting=inbox.waiting,
            first_ns=span[0],
            last_ns=span[1],
            obstacle=inbox.obstacle,
        ),
        # It may lie before the last chunk, which a cut-off file lacks.
        log.ending if log.complete else None,
        state=states.data,
    )
    _add_stop(found)
    _check_complete(log, found, tallies)
    return found


class _Inbox:
    """Sizes of the commands that have not been taken."""

    def __init__(self) -> None:
        self.obstacle = ''
        self._sizes: dict[tuple[int, int], int] = {}
        self._bytes = 0

    @property
    def waiting(self) -> int:
        return len(self._sizes)

    def put(self, event: Event) -> None:
        if self.obstacle:
            return
        self._sizes[SOURCE_OF_ROLE[event.role], event.number & SEQUENCE_MASK] = len(event.data)
        self._bytes += len(event.data)
        if len(self._sizes) > WAITING_LIMIT or self._bytes > WAITING_BYTES:
            raise ValueError(
                f'{len(self._sizes)} commands of {self._bytes} bytes were never taken, '
                f'expected at most {WAITING_LIMIT} of {WAITING_BYTES} bytes'
            )

    def take(self, event: Event, found: int) -> None:
        if event.lost and not self.obstacle:
            self._block(
                f'lacks {event.lost} records of commands taken before step {event.step}: '
                'the disk was too slow'
            )
        for row in event.rows:
            size = self._sizes.pop((row.source, row.number), None)
            # One that overflowed did nothing, whatever it was.
            if size is None and not self.obstacle and row.verdict is not Verdict.OVERFLOWED:
                self._block(
                    f'lacks command {row.number} of {ROLE_OF_SOURCE[row.source]}, '
                    f'taken before step {event.step}'
                )
            self._bytes -= size or 0

    def _block(self, reason: str) -> None:
        self.obstacle = f'{reason}, and what follows cannot be replayed'
        self._sizes.clear()
        self._bytes = 0


def _add_stop(found: Survey) -> None:
    """Note whether and where the arm stopped: by the file's end, or its last stamp."""
    summary, ending = found.summary, found.ending
    if ending is not None:
        if ending.failure:
            summary.stopped_at, summary.failure = ending.steps, ending.failure
        return
    try:
        stamp = decode_clock(found.state)
    except ValueError:
        return
    done = (stamp - summary.settings.start_ns) // summary.settings.step_ns
    if 0 <= done < summary.steps:
        summary.stopped_at = done


def _check_complete(log: Log, found: Survey, tallies: dict[str, _Tally]) -> None:
    """Compare a file with what its end record says."""
    ending = found.ending
    if ending is None:
        if log.complete:
            raise ValueError('it was closed without the end record of the node')
        ticks, summary = tallies.get('clock'), found.summary
        if ticks is not None:
            # The last state may have been cut off from its tick.
            expected = max(0, summary.steps - 1) // summary.settings.clock_every
            late = max(0, expected - ticks.last)
            if late:
                summary.lost['clock'] = ticks.lost + late
        return
    for role, tally in tallies.items():
        recorded, dropped = ending.recorded[role], ending.dropped[role]
        if tally.found != recorded:
            where = f'{tally.gap} are missing' if tally.gap else f'the last one is {tally.last}'
            raise ValueError(f'it holds {tally.found} of {recorded} messages {role}: {where}')
        if tally.last > recorded + dropped:
            raise ValueError(
                f'it holds {role} {tally.last}, its end record counts {recorded + dropped}'
            )
        if dropped:
            found.summary.lost[role] = dropped
        if ending.digests and tally.digest.hexdigest() != ending.digests[role]:
            found.altered = found.altered or f'the messages {role} are not the recorded ones'
    _check_totals(found, ending)


def _check_totals(found: Survey, ending: Ending) -> None:
    """Compare the totals of an end record with one another."""
    settings = found.summary.settings
    published = {role: n + ending.dropped[role] for role, n in ending.recorded.items()}
    states, every = published['joint_states'], settings.publish_every
    # A failed arm stands still, and goes on publishing.
    last = (states + 1) * every - 1 if ending.failure else ending.steps
    if ending.states != states or last // every != states or ending.steps > last:
        raise ValueError(
            f'its end record counts {ending.steps} steps and {ending.states} states, '
            f'of which {states} were recorded or dropped, one in {every} steps'
        )
    if 'clock' in published:
        first = states * every if ending.failure else last
        ticks, each = published['clock'], settings.clock_every
        # A node that ends when it cannot publish a state has not come to its tick.
        if not first // each - 1 <= ticks <= last // each:
            raise ValueError(
                f'its end record counts {ticks} clock ticks, one in {each} of {last} steps'
            )
    accepted = found.summary.verdicts[Verdict.ACCEPTED]
    if not ending.dropped['taken'] and ending.accepted != accepted:
        raise ValueError(
            f'its end record counts {ending.accepted} commands accepted, it holds {accepted}'
        )
