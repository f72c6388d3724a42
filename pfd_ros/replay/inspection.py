# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check that a recording is complete, without simulating it.

The end record of a closed file has the numbers of recorded and dropped messages of each channel,
and their digests; a difference is damage. In a file that was cut off, missing messages are found
by the numbers of the messages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import hashlib

from pfd_ros.arm.events import (
    ARM_STATE,
    CLOCK,
    DESCRIPTION,
    DROPPED_STATES,
    NUMBERED_AS_STATES,
    STATES,
    TAKEN,
    TF,
    TF_STATIC,
    Verdict,
)
from pfd_ros.arm.settings import OUTPUTS, Settings
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import decode_bytes, decode_clock
from pfd_ros.recording.format import (
    ASIDE,
    DIGEST_PREFIX,
    ROLE_OF_SOURCE,
    SEQUENCE_MASK,
    SOURCE_OF_ROLE,
    Part,
)
from pfd_ros.recording.head import Ending, Totals
from pfd_ros.recording.reader import Log
from pfd_ros.replay.ordering import Block, PlacedMessage, messages_of
from pfd_ros.replay.playback import follow
from pfd_ros.replay.summary import Summary

# Most events that wait for their row. The node queues 1000 and 32 MB of them for a cycle; events
# that overflow the queue are recorded long before their rows.
WAITING_LIMIT = 1 << 16
WAITING_BYTES = 1 << 26
# Messages that are computed from the URDF.
FRAMES = frozenset({TF, TF_STATIC})


@dataclass
class _ChannelCount:
    """The count, the gaps and the digest of one channel's messages."""

    found: int = 0
    last: int = 0
    lost: int = 0
    gap: str = ''
    # Lost before the first message.
    front: int = 0
    data: bytes = b''
    digest: hashlib._Hash = field(default_factory=hashlib.sha256)

    def add(self, messages: Sequence[PlacedMessage]) -> None:
        self.front = self.front if self.found else messages[0].lost
        for message in messages:
            if message.lost:
                self.lost += message.lost
                self.gap = self.gap or f'{message.number - message.lost} to {message.number - 1}'
        self.found += len(messages)
        self.last, self.data = messages[-1].number, messages[-1].data
        pack, mask = DIGEST_PREFIX.pack, SEQUENCE_MASK
        for _, number, _, _, log_ns, data, _, published_ns, _ in messages:
            self.digest.update(pack(number & mask, log_ns, published_ns, len(data)) + data)


@dataclass
class Inspection:
    """The result of an inspection.

    Attributes
    ----------
    summary
        The result for people.
    ending
        The node's end record, None in a file that was cut off.
    altered
        Which digest of messages differs, or ''. A replay finds the place of the difference, so it
        runs before this is reported.
    state
        Bytes of the last state, published or dropped by the sensors.
    description
        Bytes of the message with the URDF, b'' without one.
    blocked
        First step whose inputs are missing after the last recorded state of the whole arm, or 0.
    """

    summary: Summary
    ending: Ending | None = None
    altered: str = ''
    state: bytes = b''
    description: bytes = b''
    blocked: int = 0


def inspect(log: Log, progress: Callable[[float], None] | None = None) -> Inspection:
    """Inspect a recording.

    Raises
    ------
    ValueError
        If it is damaged, or a closed file lacks messages; with the place.
    OSError
        If it cannot be read.
    """
    log.read_head()
    part = log.part
    counts = _Counts(_WaitingEvents(part))
    follow(log, counts.follow, progress)
    log.check_digests()
    waiting = counts.waiting
    channels = counts.channels
    settings = log.settings
    for role in log.roles.values():
        channels.setdefault(role, _ChannelCount(last=part.last_number(role)))
    states, unpublished = channels[STATES], channels.get(DROPPED_STATES, _ChannelCount())
    newest = max(states, unpublished, key=lambda channel: channel.last)
    # A missing state may have been of either kind; it counts once.
    states.lost, unpublished.lost = states.lost + unpublished.lost, 0
    found = Inspection(
        Summary(
            path=log.path,
            settings=settings,
            complete=log.complete,
            ended=log.ending is not None,
            versions=log.versions,
            steps=newest.last * settings.publish_every,
            states=states.found,
            unpublished=unpublished.found,
            lost={role: channel.lost for role, channel in channels.items() if channel.lost},
            dropped=sum(channel.lost for channel in channels.values()),
            verdicts=counts.verdicts,
            waiting=len(waiting),
            first_ns=counts.first_ns,
            last_ns=counts.last_ns,
            obstacle=waiting.obstacle,
            gaps=waiting.gaps,
            part=part.number,
            start=waiting.start,
        ),
        # In a cut-off file the end record may come before a missing chunk.
        log.ending if log.complete else None,
        state=newest.data,
        description=channels.get(DESCRIPTION, _ChannelCount()).data,
        blocked=waiting.blocked,
    )
    if found.ending is not None:
        found.summary.continues = found.ending.totals is None
    if not found.description and any(channels[role].found for role in channels.keys() & FRAMES):
        found.summary.lost[DESCRIPTION] = 1
    _add_failure(found)
    _check_complete(log, found, channels)
    return found


class _Counts:
    """Counts of the messages of a recording, by channel and verdict."""

    def __init__(self, waiting: _WaitingEvents) -> None:
        self.channels: dict[str, _ChannelCount] = {}
        self.verdicts: Counter[Verdict] = Counter()
        self.waiting = waiting
        self.first_ns = self.last_ns = 0

    def follow(self, block: Block) -> None:
        by_role: dict[str, list[PlacedMessage]] = {}
        for message in messages_of(block):
            role = message.role
            by_role.setdefault(role, []).append(message)
            if role in SOURCE_OF_ROLE:
                self.waiting.put(message)
            elif role == TAKEN:
                self.waiting.take(message)
            elif role == ARM_STATE:
                self.waiting.resume(message)
            elif role not in ASIDE:
                self.waiting.pass_by(message)
        for role, some in by_role.items():
            self.channels.setdefault(role, _ChannelCount()).add(some)
        for message in by_role.get(TAKEN, ()):
            self.verdicts.update([row.verdict for row in message.rows])
        if STATES in by_role:
            self.first_ns = self.first_ns or by_role[STATES][0].wall_ns
            self.last_ns = by_role[STATES][-1].wall_ns


class _WaitingEvents:
    """Sizes of the events that wait for their row, and the steps whose events are missing.

    Attributes
    ----------
    obstacle
        The first missing input, as the end of a sentence, or ''.
    blocked
        First step that cannot be replayed, 0 if the newest step can.
    gaps, start
        As in Summary.
    """

    def __init__(self, part: Part) -> None:
        self.obstacle = ''
        self.blocked = self.start = 0
        # A later file of a run begins with a state of the whole arm; True until it is read.
        self._opening = part.number > 1
        self.gaps: list[tuple[int, int]] = []
        self._sizes: dict[tuple[int, int], int] = {}
        self._bytes = 0
        # Number and step of the last message of rows.
        self._rows, self._last = part.last_number(TAKEN), 0

    def __len__(self) -> int:
        return len(self._sizes)

    def put(self, message: PlacedMessage) -> None:
        self._sizes[SOURCE_OF_ROLE[message.role], message.number] = len(message.data)
        self._bytes += len(message.data)
        if len(self._sizes) > WAITING_LIMIT or self._bytes > WAITING_BYTES:
            if not self.obstacle:
                raise ValueError(
                    f'{len(self._sizes)} commands of {self._bytes} bytes were never taken, '
                    f'expected at most {WAITING_LIMIT} of {WAITING_BYTES} bytes'
                )
            # Their rows are missing.
            self._sizes.clear()
            self._bytes = 0

    def pass_by(self, message: PlacedMessage) -> None:
        """Note an output; in a later file of a run the state of the whole arm comes before it."""
        if self._opening:
            self._opening = False
            self._block(message.cycle, 'lacks the arm state at its beginning')

    def take(self, message: PlacedMessage) -> None:
        self.pass_by(message)
        lost = message.number - self._rows - 1
        if lost:
            # They may belong to any step since the previous rows.
            self._block(
                self._last,
                f'lacks {lost} records of commands taken before step {message.cycle}: '
                'the disk was too slow, or the beginning of the log is missing',
            )
        self._rows, self._last = message.number, message.cycle
        for row in message.rows:
            size = self._sizes.pop((row.source, row.sequence), None)
            # An event that overflowed had no effect: its payload is not needed.
            if size is None and row.verdict is not Verdict.OVERFLOWED:
                self._block(
                    message.cycle,
                    f'lacks command {row.sequence} of {ROLE_OF_SOURCE[row.source]}, '
                    f'taken before step {message.cycle}',
                )
            self._bytes -= size or 0

    def resume(self, message: PlacedMessage) -> None:
        """End a gap at a recorded state of the whole arm."""
        if self._opening:
            self._opening, self.start = False, message.cycle
        saved = ArmState.from_bytes(decode_bytes(message.data))
        if saved.cycle != message.cycle:
            raise ValueError(
                f'{message.role} {message.number} belongs to step {saved.cycle}, '
                f'expected step {message.cycle}'
            )
        if saved.row_messages < self._rows:
            raise ValueError(
                f'{message.role} {message.number} counts {saved.row_messages} records of commands '
                f'before it, the file has {self._rows}'
            )
        if saved.row_messages > self._rows:
            self._block(
                self._last,
                f'lacks {saved.row_messages - self._rows} records of commands taken before step '
                f'{message.cycle}: the beginning of the log is missing',
            )
            self._rows = saved.row_messages
        if self.blocked:
            self.gaps.append((self.blocked, message.cycle))
            self.blocked = 0

    def _block(self, cycle: int, reason: str) -> None:
        self.obstacle = (
            self.obstacle
            or f'{reason}; the messages until the next recorded arm state cannot be replayed'
        )
        self.blocked = self.blocked or max(1, cycle)


def _add_failure(found: Inspection) -> None:
    """Add the step after which the simulation failed, from the end record or the last stamp."""
    summary, ending = found.summary, found.ending
    if ending is not None and ending.totals is not None:
        if ending.totals.failure:
            summary.stopped_at, summary.failure = ending.totals.steps, ending.totals.failure
        return
    try:
        stamp = decode_clock(found.state)
    except ValueError:
        return
    done = (stamp - summary.settings.start_ns) // summary.settings.step_ns
    if 0 <= done < summary.steps:
        summary.stopped_at = done


def _check_complete(log: Log, found: Inspection, channels: dict[str, _ChannelCount]) -> None:
    """Compare the messages of a file with its end record."""
    ending = found.ending
    if ending is None:
        _add_lost_ends(found.summary, channels)
        return
    part = log.part
    if _lacks_beginning_alone(ending, channels, found.summary.settings, part):
        found.summary.beginning = False
        return
    found.summary.dropped = sum(ending.dropped.values())
    published = {
        role: part.before(role) + n + ending.dropped[role] for role, n in ending.recorded.items()
    }
    states = _count_states(published)
    for role, channel in channels.items():
        recorded, dropped = ending.recorded[role], ending.dropped[role]
        if channel.found != recorded:
            where = (
                f'{channel.gap} are missing' if channel.gap else f'the last one is {channel.last}'
            )
            raise ValueError(f'it holds {channel.found} of {recorded} messages {role}: {where}')
        last = states if role in NUMBERED_AS_STATES else published[role]
        if channel.last > last:
            raise ValueError(f'it holds {role} {channel.last}, its end record counts {last}')
        if dropped:
            found.summary.lost[role] = dropped
        if channel.digest.hexdigest() != ending.digests[role]:
            found.altered = found.altered or f'the messages {role} are not the recorded ones'
    if ending.totals is not None:
        _check_totals(found, ending.totals, published)
        accepted = found.summary.verdicts[Verdict.ACCEPTED]
        # The end record counts the commands of all files of the run.
        if part.number == 1 and not ending.dropped[TAKEN] and ending.totals.accepted != accepted:
            raise ValueError(
                f'its end record counts {ending.totals.accepted} commands accepted, '
                f'it holds {accepted}'
            )


def _lacks_beginning_alone(
    ending: Ending, channels: Mapping[str, _ChannelCount], settings: Settings, part: Part
) -> bool:
    """Return whether a file lacks only its beginning, as after a filter by time."""
    # Steps of the last missing state and of the next state.
    start = (part.last_number(STATES) + channels[STATES].front) * settings.publish_every
    end = start + settings.publish_every
    rates = {CLOCK: settings.clock_every, TF: settings.tf_every}
    for role in channels.keys() & {*rates, *OUTPUTS}:
        front = part.last_number(role) + channels[role].front
        every = rates.get(role, settings.publish_every)
        if not front * every <= end or not start <= (front + 1) * every:
            return False
    missing = {role: n - channels[role].found for role, n in ending.recorded.items()}
    states = sum(missing.get(role, 0) for role in NUMBERED_AS_STATES)
    front = sum(channels[role].lost for role in NUMBERED_AS_STATES & channels.keys())
    return (
        not any(ending.dropped.values())
        and 0 < states == front == channels[STATES].front
        and all(
            missing[role] == channel.front == channel.lost or not channel.found
            for role, channel in channels.items()
            if role not in NUMBERED_AS_STATES
        )
    )


def _count_states(published: Mapping[str, int]) -> int:
    """Return the number of states, published or dropped by sensors, from counts by role."""
    return sum(published.get(role, 0) for role in NUMBERED_AS_STATES)


def _add_lost_ends(summary: Summary, channels: Mapping[str, _ChannelCount]) -> None:
    """Count the messages that the end of a cut-off file lacks."""
    settings = summary.settings
    rates = {CLOCK: settings.clock_every, TF: settings.tf_every}
    for role in channels.keys() & {*rates, *OUTPUTS}:
        every = rates.get(role, settings.publish_every)
        # The other outputs of the last state may have been cut off.
        late = max(0, summary.steps - 1) // every - channels[role].last
        if late > 0:
            summary.lost[role] = channels[role].lost + late


def _check_totals(found: Inspection, ending: Totals, published: Mapping[str, int]) -> None:
    """Check the totals of an end record against each other and against the counts by role."""
    settings = found.summary.settings
    states, every = _count_states(published), settings.publish_every
    # A failed arm keeps its state and continues to publish.
    last = (states + 1) * every - 1 if ending.failure else ending.steps
    if ending.states != states or last // every != states or ending.steps > last:
        raise ValueError(
            f'its end record counts {ending.steps} steps and {ending.states} states, but '
            f'{states} were recorded or dropped, at one state in {every} steps'
        )
    rates = {CLOCK: ('clock ticks', settings.clock_every), TF: ('frames', settings.tf_every)}
    for role, (noun, each) in rates.items():
        if role not in published:
            continue
        first = states * every if ending.failure else last
        # A node that fails to publish a state ends before the tick of that state.
        if not first // each - 1 <= published[role] <= last // each:
            raise ValueError(
                f'its end record counts {published[role]} {noun}, one in {each} of {last} steps'
            )
    for role in published.keys() & OUTPUTS.keys():
        # A node may end between a state and its other outputs.
        if not states - 1 <= published[role] <= states:
            raise ValueError(
                f'its end record counts {states} states and {published[role]} messages {role}'
            )
