# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording of this package, read from front to back.

Any log, of ours or not, is read as arrays by `arrays`, and other files by `bags`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import takewhile
import json
from pathlib import Path
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.events import ASIDES, DESCRIPTION, ROLES, Message
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.values import decode_string
from pfd_ros.recording import format as names
from pfd_ros.recording.bags import Bag
from pfd_ros.recording.format import HeadKey, LogError, OtherLogError, damage_named
from pfd_ros.text import cut

# Far more than a hundred joints need; YAML takes seconds a megabyte.
ROBOT_BYTES = 1 << 20


class Log:
    """The head of a recording, and its messages.

    `settings` are those at the start of the run, `topics` has the topic of each recorded role and
    `description` the URDF of the arm, '' without one. Once `messages` has ended, `end` has the
    values of the record END, {} in a file that was cut off, and `complete` says whether the file
    was closed after a run.

    LogError if the file is no recording of this edition, or is damaged; OSError if it cannot be
    read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.end: dict[str, Any] = {}
        self.complete = False
        if self.path.is_dir():
            raise OtherLogError(f'{path} is a folder, expected the file of a recording')
        bag = Bag(self.path)
        next(bag.messages(), None)
        names.check_format(self.path, bag.head or None)
        if not bag.robot:
            raise LogError(f'{path} is a recording without its robot: it ends in its head')
        with damage_named(self.path):
            self.settings = Settings.from_json(bag.head[HeadKey.SETTINGS])
            topics = table(bag.head, HeadKey.TOPICS)
            self.topics = {role: str(topic) for role, topic in topics.items()}
            self._roles = {topic: role for role, topic in self.topics.items() if role in ROLES}
            self.versions: dict[str, str] = table(bag.head, HeadKey.VERSIONS)
            self.robot = robot_of(bag.robot)
            self.description = ''
            for message in takewhile(lambda message: message.role in ASIDES, self.messages()):
                if message.role == DESCRIPTION:
                    self.description = decode_string(message.data)

    def messages(self) -> Iterator[Message]:
        """Yield the messages in their order; of a file that was cut off, up to the cut."""
        bag, last = Bag(self.path), 0
        for topic, _, _, data, number in bag.messages():
            role = self._roles.get(topic)
            if role in ASIDES:
                yield Message(role, data)
            elif role is not None:
                # 32 bits of the cycle, which never decreases.
                last += (number - last) & names.SEQUENCE_MASK
                yield Message(role, data, last)
        with damage_named(self.path):
            self.end = {key: json.loads(text) for key, text in bag.end.items()}
        self.complete = bag.complete and bool(self.end)


def table(head: Mapping[str, str], key: str) -> dict[str, Any]:
    """Return a value of a head that is a table, {} without it; ValueError for another one."""
    found = json.loads(head.get(key, '{}'))
    if not isinstance(found, dict):
        raise ValueError(f'{key} in its head is {cut(repr(found))}, expected a table')
    return found


def robot_of(data: bytes) -> pfd.Robot:
    """Return the robot of the attachment ROBOT; ValueError if it is none."""
    text = data.decode()
    # A single line would be the name of a file, and `<` begins URDF.
    if '\n' not in text.strip() or text.lstrip().startswith('<') or len(data) > ROBOT_BYTES:
        raise ValueError(f'{names.ROBOT} of {len(data)} bytes is no robot, or above {ROBOT_BYTES}')
    return pfd.load_robot(text)
