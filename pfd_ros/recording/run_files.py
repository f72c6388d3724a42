# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one recording: one, or several of limited size, each readable alone.

A new file begins with the message of the whole arm's state at which the limit is reached. Before
that message come the first messages of the run (the robot's URDF and the frames that never move)
and the inputs that no cycle has taken yet; both are repeated, with their numbers. The file before
ends with its end record, whose digest the head of the new file has.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import glob
import json
from pathlib import Path
from typing import NamedTuple

from pfd_ros.arm.events import TAKEN_COLUMNS
from pfd_ros.messages.convert import rows_as_written
from pfd_ros.recording.block_writer import NewMessage
from pfd_ros.recording.format import SEQUENCE_MASK, EndKey, HeadKey, Part
from pfd_ros.recording.mcap_file import FileHead, McapFile, Topic, channel_table
from pfd_ros.recording.sink import Sink

# Numbers of files have six digits, so that names in order are files in order.
MOST_FILES = 999_999
# Inputs that are repeated: more than the node keeps for a cycle.
MOST_WAITING = 1024
MOST_WAITING_BYTES = 1 << 25


@dataclass(frozen=True)
class Limits:
    """When a new file begins, and what a run needs to continue in it; topics by index.

    Attributes
    ----------
    size
        Bytes of a file, 0 without a limit.
    states
        Messages of `state` in a file, 0 without a limit.
    state, rows
        The state of the whole arm, with which a file begins, and the validation rows.
    inputs
        Inputs by their source in the rows.
    """

    size: int
    states: int
    state: int
    rows: int
    inputs: Mapping[int, int]


class Timed(NamedTuple):
    """A message with its times, ns."""

    topic: int
    log_ns: int
    published_ns: int
    sequence: int
    data: bytes


def part_path(path: Path, number: int) -> Path:
    """Return the path of a file of a recording: run_000001.mcap is the first of run.mcap."""
    return path.with_name(f'{path.stem}_{number:06d}{path.suffix}')


class RunFiles:
    """The files of a recording, written by one thread.

    Parameters
    ----------
    path
        The file, which must not exist; with limits the name of which `part_path` numbers.
    topics
        The channels.
    head
        Written and flushed at once.
    opening
        The first messages, flushed with the head and repeated in each file.
    limits
        None for one file.

    Raises
    ------
    OSError
        If a file exists or cannot be written.
    ValueError
        As McapFile; also if the limit of the size is below the size of the head.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[Topic],
        head: FileHead,
        opening: Sequence[Timed] = (),
        limits: Limits | None = None,
    ) -> None:
        self._path, self._topics, self._head, self._opening = path, topics, head, opening
        self._channels = channel_table(topics)
        self._limits = limits
        self._part = Part()
        if limits is not None:
            _check_free(path)
            self._waiting_inputs = _WaitingInputs(limits)
        self._file = self._new_file(head, opening)
        # Messages of the run before the first one of this file.
        self._before = [0] * len(topics)
        # Number of the state with which the file begins, and bytes at the last one.
        self._first_state = 0
        self._size = size = self._bytes()
        if limits is not None and 0 < limits.size <= size:
            self._file.sink.discard()
            raise ValueError(
                f'recording_max_size is {limits.size} bytes, expected more than {size}: '
                'the head and the index of each file take so many'
            )

    @property
    def counts(self) -> list[int]:
        """Number of added messages, by index in `topics`, without repeated ones."""
        return [*map(sum, zip(self._before, self._file.counts, strict=True))]

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._path if self._limits is None else part_path(self._path, self._part.number)

    @property
    def sink(self) -> Sink:
        """The file on the disk that is being written."""
        return self._file.sink

    @property
    def waiting(self) -> int:
        """Bytes of messages added since the last flush."""
        return self._file.waiting

    def add_all(self, messages: Iterable[NewMessage]) -> None:
        """Add messages to the next flush, each with the index of its topic as its channel."""
        if self._limits is not None:
            messages = self._waiting_inputs.follow(messages)
        self._file.add_all(messages)

    def flush(self) -> None:
        """Write all messages to the operating system."""
        self._file.flush()

    def begin_state(self, message: Timed, dropped: Sequence[int]) -> None:
        """Begin a new file before a message of the whole arm's state, if a limit is reached.

        Parameters
        ----------
        message
            To be added next; all messages before it are flushed.
        dropped
            Messages that were dropped before it, by index in the topics.
        """
        assert self._limits is not None
        size = self._bytes()
        # Until the next state the file will grow about as much as since the last one.
        grown, self._size = size - self._size, size
        states = (message.sequence - self._first_state) & SEQUENCE_MASK
        full = 0 < self._limits.size < size + grown
        long = 0 < self._limits.states <= states
        if (full or long) and self._part.number < MOST_FILES:
            self._continue(message, dropped)
            self._first_state = message.sequence
            self._size = self._bytes()

    def finish(self, ending: Mapping[str, str]) -> None:
        """Write the last metadata record and the index, and sync the file."""
        self._file.finish(ending)

    def _continue(self, state: Timed, dropped: Sequence[int]) -> None:
        """End the file, and begin the next one with what is repeated."""
        old, counts = self._file, self.counts
        try:
            ending = {
                EndKey.RECORDED: json.dumps(self._by_name(counts)),
                EndKey.DROPPED: json.dumps(self._by_name(dropped)),
                EndKey.CONTINUES: 'true',
            }
            previous = old.end(ending)
            inputs = self._waiting_inputs.messages()
            first_ns = inputs[0].log_ns if inputs else state.log_ns
            opening = [
                message._replace(log_ns=first_ns, published_ns=state.published_ns)
                for message in self._opening
            ]
            repeated = [*opening, *inputs]
            self._part = Part(
                self._part.number + 1,
                self._part.first or old.head_digest,
                previous,
                *self._counts_before(repeated, dropped),
            )
            values = {**self._head.values, HeadKey.PART: json.dumps(self._part._asdict())}
            self._file = self._new_file(replace(self._head, values=values), repeated)
            pairs = zip(counts, self._file.counts, strict=True)
            self._before = [count - own for count, own in pairs]
            # Meanwhile the messages wait in the queue only.
            old.sink.sync()
        finally:
            old.sink.close()

    def _new_file(self, head: FileHead, messages: Sequence[Timed]) -> McapFile:
        file = McapFile(self.path, self._channels, head)
        try:
            if messages:
                file.add_all(messages)
            file.flush()
        except BaseException:
            file.sink.discard()
            raise
        return file

    def _bytes(self) -> int:
        """Return about how many bytes the file would have if it ended now."""
        return self._file.sink.tell() + self._file.index_bytes

    def _by_name(self, counts: Sequence[int]) -> dict[str, int]:
        return {topic.name: count for topic, count in zip(self._topics, counts, strict=True)}

    def _counts_before(
        self, repeated: Sequence[Timed], dropped: Sequence[int]
    ) -> tuple[dict[str, int], dict[str, int]]:
        """Return the messages recorded and dropped before the first repeated one, by name."""
        recorded, lost = list(self.counts), list(dropped)
        first: dict[int, int] = {}
        for message in repeated:
            recorded[message.topic] -= 1
            first.setdefault(message.topic, message.sequence)
        for topic, sequence in first.items():
            last = self.counts[topic] + dropped[topic]
            lost[topic] = last - ((last - sequence) & SEQUENCE_MASK) - 1 - recorded[topic]
        return self._by_name(recorded), self._by_name(lost)


@dataclass
class _WaitingInputs:
    """The inputs that no validation row has named yet."""

    limits: Limits
    _bytes: int = 0
    _messages: dict[int, deque[Timed]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Keep none."""
        self._messages = {topic: deque() for topic in self.limits.inputs.values()}

    def follow(self, messages: Iterable[NewMessage]) -> Iterator[NewMessage]:
        """Yield messages; keep inputs, and forget those that rows name and all before them."""
        for message in messages:
            topic, data = message[0], message[-1]
            if topic == self.limits.rows:
                for _, source, sequence, _, _ in rows_as_written(data, TAKEN_COLUMNS) or ():
                    taken = self.limits.inputs.get(source)
                    if taken is not None:
                        self._forget(self._messages[taken], sequence)
            elif topic in self._messages:
                waiting = self._messages[topic]
                waiting.append(Timed(*message))
                self._bytes += len(data)
                # The node has dropped these, which have no effect then.
                while waiting and (
                    len(waiting) > MOST_WAITING or self._bytes > MOST_WAITING_BYTES
                ):
                    self._bytes -= len(waiting.popleft().data)
            yield message

    def _forget(self, messages: deque[Timed], sequence: int) -> None:
        while messages and (sequence - messages[0].sequence) & SEQUENCE_MASK <= SEQUENCE_MASK >> 1:
            self._bytes -= len(messages.popleft().data)

    def messages(self) -> list[Timed]:
        """Return them in the order of their times."""
        found = [message for messages in self._messages.values() for message in messages]
        return sorted(found, key=lambda message: message.log_ns)


def part_paths(path: Path) -> list[Path]:
    """Return the files of a recording that exist under the names of `part_path`, in order."""
    pattern = f'{glob.escape(path.stem)}_{"[0-9]" * 6}{glob.escape(path.suffix)}'
    return sorted(path.parent.glob(pattern)) if path.parent.is_dir() else []


def _check_free(path: Path) -> None:
    """Raise FileExistsError if a recording of this name has left a file."""
    found = next(iter(part_paths(path)), None)
    if found is not None:
        raise FileExistsError(
            f'{found} exists, of another recording, and is not overwritten; choose another name '
            f'than {path.name}'
        )
