# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of runs without ROS, and the same with something changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import contextmanager
import json
from pathlib import Path
import resource
from typing import Any
import zlib

from arm_messages import INF, NAN, efforts, named
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import Writer

from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.values import encode_string
from pfd_ros.recording.format import END as END_RECORD
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.recording.mcap_records import records as mcap_records
from pfd_ros.recording.recorder import Recorder as LogRecorder
from pfd_ros.recording.recorder import topic_names

# What every run has; a test adds others.
ROLES = (
    *('joint_commands', 'commands', 'joint_trajectory', 'set_state', 'requests', 'parameters'),
    *('rejected', 'joint_states', 'clock', 'rejected_counts', 'diagnostics'),
)
NAMES = ('shoulder', 'elbow')
# A change of a recorded message: role and message -> the message, another one, several or none.
Change = Callable[[str, Message], 'Message | Sequence[Message] | None']


def aside(text: str = 'all is well') -> ArmMessage:
    return ArmMessage('diagnostics', encode_string(text))


class Run:
    """An engine and its recorder.

    Parameters
    ----------
    path
        The recording.
    roles
        Further roles, inputs or outputs.
    topics
        Other names of topics, by role.
    settings
        Of the arm; planar2 unless they say otherwise.
    """

    def __init__(
        self,
        path: Path,
        roles: Iterable[str] = (),
        topics: Mapping[str, str] | None = None,
        **settings: Any,
    ) -> None:
        chosen = Settings(**{'robot': 'planar2', 'recording': str(path), **settings})
        self.topics = topic_names({*ROLES, *roles}) | (topics or {})
        self.engine = Engine(chosen, load_arm_robot(chosen, chosen.robot), self.topics)
        self.reports: list[str] = []
        self.recorder = LogRecorder(path, self.engine, self.topics, self.reports.append)
        self.messages: list[ArmMessage] = []
        self.verdicts: list[str] = []
        # Roles of accepted inputs.
        self.accepted: set[str] = set()

    def step(self, *events: ArmMessage, times: int = 1) -> None:
        """Take events and do a cycle, and further cycles without events."""
        for k in range(times):
            messages, verdicts = self.engine.step(events if k == 0 else ())
            self.record(messages)
            self.verdicts += [verdict.label for verdict in verdicts]
            took = zip(events if k == 0 else (), verdicts, strict=True)
            self.accepted |= {message.role for message, verdict in took if verdict.accepted}

    def record(self, messages: Sequence[ArmMessage]) -> None:
        self.recorder.put(messages, self.engine.stamp_ns)
        self.messages += messages

    def close(self) -> None:
        self.record(self.engine.counts())
        self.recorder.close()


def simulate(
    path: Path,
    cycles: int,
    events: Mapping[int, Sequence[ArmMessage]] | None = None,
    roles: Iterable[str] = (),
    **settings: Any,
) -> Run:
    """Record a run of so many cycles, with events by the cycle that takes them."""
    run = Run(path, roles, **settings)
    for cycle in range(1, cycles + 1):
        run.step(*(events or {}).get(cycle, ()))
    run.close()
    assert not run.reports
    return run


def busy(path: Path, cycles: int = 60, **settings: Any) -> Run:
    """Record a run with a command in each cycle, and some that are refused."""
    events = {k: [efforts(3.0 - 0.1 * k, 0.05 * k)] for k in range(1, cycles + 1)}
    events[7].append(efforts(1.0))
    events[9].insert(0, named(NAMES, (1.0, INF)))
    events[20] = [named(NAMES, (2.0, NAN)), named(NAMES[1:], (0.5,))]
    return simulate(path, cycles, events, **settings)


def rewritten(
    source: Path,
    target: Path,
    change: Change = lambda role, message: message,
    metadata: Callable[[str, dict[str, str]], dict[str, str] | None] = lambda name, found: found,
    *,
    counted: bool = False,
    chunk: int = 1 << 20,
) -> Path:
    """Write a recording anew, a valid file, with changes.

    Parameters
    ----------
    change
        Of messages.
    metadata
        Of metadata records; None leaves one out.
    counted
        Whether the end counts the changed messages, as if they were recorded so.
    chunk
        Size of a chunk, bytes.
    """
    roles = {topic: role for role, topic in RecordedLog(source).topics.items()}
    channels: dict[int, tuple[str, int]] = {}
    schemas: dict[int, int] = {}
    counts: dict[str, int] = {}
    crc = 0
    with target.open('wb') as stream:
        writer = Writer(stream, chunk, enable_data_crcs=True)
        for record in mcap_records(source):
            if isinstance(record, Header):
                writer.start(record.profile, 'rewritten')
            elif isinstance(record, Metadata):
                writer.flush()
                values = dict(record.metadata)
                if counted and record.name == END_RECORD:
                    values |= {'recorded': json.dumps(counts), 'crc': json.dumps(crc)}
                values = metadata(record.name, values)
                if values is not None:
                    writer.add_metadata(record.name, values)
            elif isinstance(record, Attachment):
                writer.add_attachment(0, 0, record.name, record.media_type, record.data)
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, Channel) and record.id not in channels:
                number = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    schemas[record.schema_id],
                    record.metadata,
                )
                channels[record.id] = roles[record.topic], number
            elif isinstance(record, Message):
                role, number = channels[record.channel_id]
                found = change(role, record)
                for each in [found] if isinstance(found, Message) else found or ():
                    writer.add_message(
                        number, each.log_time, each.data, each.publish_time, each.sequence
                    )
                    counts[role] = counts.get(role, 0) + 1
                    crc = zlib.crc32(each.data, crc)
        writer.finish()
    return target


@contextmanager
def largest_file(size: int):
    """Let the kernel write files up to a size and then refuse, as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
