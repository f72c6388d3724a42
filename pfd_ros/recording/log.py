# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording of this package, read from front to back.

Other files and older recordings are read by `bags` and `arrays`.
"""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Footer, Metadata
from mcap.records import Message as Record

import pfd_core as pfd
from pfd_ros.arm.events import ASIDES, DESCRIPTION, ROLES, Message
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.text_and_arrays import decode_string
from pfd_ros.recording.format import (
    END,
    HEAD,
    ROBOT,
    SEQUENCE_MASK,
    EndKey,
    HeadKey,
    LogError,
    check_format,
    damage_named,
)
from pfd_ros.recording.mcap_records import EXPANSION, records

# Far more than a hundred joints need; YAML takes seconds a megabyte.
ROBOT_BYTES = 1 << 20


class Log:
    """The head of a recording, and its messages.

    Parameters
    ----------
    path
        The file.
    expansion
        Bound on what it unpacks to, in its sizes.

    Attributes
    ----------
    settings
        At the start of the run.
    robot
        The robot.
    head
        The texts of the record HEAD, see HeadKey.
    topics
        Topic of each recorded role.
    description
        The URDF of the arm, '' without one; it comes before all that is simulated.
    end
        The values of the record END, see EndKey; {} until `messages` has reached it, and in a
        file that was cut off.

    Raises
    ------
    LogError
        If the file is no recording of this edition, or is damaged.
    OSError
        If it cannot be read.
    """

    def __init__(self, path: Path | str, expansion: float = EXPANSION) -> None:
        self.path, self._expansion = Path(path), expansion
        self.head: dict[str, str] = {}
        self.end: dict[str, Any] = {}
        self._closed = False
        robot = b''
        with damage_named(self.path):
            found = None
            for record in records(self.path, expansion=expansion):
                if isinstance(record, Metadata) and record.name == HEAD:
                    found = record.metadata
                elif isinstance(record, Attachment) and record.name == ROBOT:
                    robot = record.data
                if isinstance(record, Record) or (found and robot):
                    break
            check_format(self.path, found)
            self.head = found or {}
            self.settings = Settings.from_json(self.head[HeadKey.SETTINGS])
            self.topics: dict[str, str] = json.loads(self.head[HeadKey.TOPICS])
            self.versions: dict[str, str] = json.loads(self.head[HeadKey.VERSIONS])
            if not robot:
                raise LogError(f'{path} is a recording without its robot: it ends in its head')
            self.robot = robot_of(robot)
        self.description = ''
        for message in self.messages():
            if message.role == DESCRIPTION:
                self.description = decode_string(message.data)
            if message.role not in ASIDES:
                break

    @property
    def complete(self) -> bool:
        """Whether the file was closed after a run; known once `messages` has ended."""
        return self._closed and bool(self.end)

    def messages(self) -> Iterator[Message]:
        """Yield the messages in their order; of a file that was cut off, up to the cut."""
        for message, _, _ in self.timed():
            yield message

    def timed(self) -> Iterator[tuple[Message, int, int]]:
        """Yield the messages with their log times and publish times [ns], as `messages`."""
        roles = {topic: role for role, topic in self.topics.items() if role in ROLES}
        channels: dict[int, str | None] = {}
        self.end, self._closed, last = {}, False, 0
        with damage_named(self.path):
            for record in records(self.path, expansion=self._expansion):
                if isinstance(record, Record):
                    role = channels.get(record.channel_id)
                    if role is None:
                        continue
                    cycle = 0
                    if role not in ASIDES:
                        # 32 bits of the cycle, which never decreases.
                        last += (record.sequence - last) & SEQUENCE_MASK
                        cycle = last
                    message = Message(role, record.data, cycle)
                    yield message, record.log_time, record.publish_time
                elif isinstance(record, Channel):
                    channels[record.id] = roles.get(record.topic)
                elif isinstance(record, Metadata) and record.name == END:
                    self.end = {key: json.loads(text) for key, text in record.metadata.items()}
                    missing = {EndKey.TOTALS, EndKey.RECORDED, EndKey.CRC} - self.end.keys()
                    if missing:
                        raise LogError(f'{self.path}: its end lacks {sorted(missing)}')
                elif isinstance(record, Footer):
                    self._closed = True


def robot_of(data: bytes) -> pfd.Robot:
    """Return the robot of the attachment ROBOT; ValueError if it is none."""
    text = data.decode()
    # A single line would be the name of a file, and `<` begins URDF.
    if '\n' not in text or text.lstrip().startswith('<') or len(data) > ROBOT_BYTES:
        raise ValueError(f'{ROBOT} of {len(data)} bytes is no robot of at most {ROBOT_BYTES}')
    return pfd.load_robot(text)
