# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The format of a recording: the names and keys in an MCAP file, and errors about its content.

Everything here is written into files and changes only with FORMAT. The first record is the
metadata HEAD, then comes the attachment ROBOT, then the messages of the run in the order in which
the engine took and computed them, then the metadata END. See docs/reference/recording.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pfd_ros.text import cut, one_line

FORMAT = '3'
# Formats of the first edition, whose recordings can be read as any bag but not simulated.
FIRST_EDITION = ('1', '2')
# Metadata records: the first and the last of a file.
HEAD, END = 'pfd_ros', 'pfd_ros_end'
# Attachment: the complete robot.
ROBOT = 'robot.yaml'
# Names in MCAP for the profile, messages and definitions of ROS 2, and for QoS in rosbag2.
PROFILE, MESSAGE_ENCODING, SCHEMA_ENCODING = 'ros2', 'cdr', 'ros2msg'
QOS_KEY, TYPE_HASH_KEY = 'offered_qos_profiles', 'topic_type_hash'
# MCAP numbers messages in 32 bits; the number of a message is its cycle: 49 days at 1 kHz.
SEQUENCE_MASK = 0xFFFFFFFF


class HeadKey:
    """Keys of the record HEAD; each value except FORMAT is JSON."""

    FORMAT = 'format'
    SETTINGS = 'settings'
    TOPICS = 'topics'  # by role
    VERSIONS = 'versions'
    TIMES = 'times'  # log_time: wall or simulated


class EndKey:
    """Keys of the record END; each value is JSON."""

    TOTALS = 'totals'  # of the run, see recorder
    RECORDED = 'recorded'  # number of messages by role
    CRC = 'crc'  # CRC-32 of the bytes of all messages in their order


class LogError(ValueError):
    """The file is not a recording, or is damaged, or cannot be simulated."""


class OtherLogError(LogError):
    """The file may be a log, but it is not a recording of this edition."""


@contextmanager
def damage_named(path: Path | str) -> Iterator[None]:
    """Turn each exception that the content of a file causes into a LogError that names the file.

    A hostile file reaches the parsers of JSON and YAML, the model, the compiler and the
    arithmetic, and each raises different exceptions.
    """
    try:
        yield
    except (LogError, OSError, MemoryError):
        raise
    except Exception as error:
        kind = '' if isinstance(error, ValueError) else f'{type(error).__name__}: '
        raise LogError(one_line(f'{path}: {kind}{error}')) from error


def check_format(path: Path | str, head: Mapping[str, str] | None) -> None:
    """Raise OtherLogError unless a record HEAD is of this format; None is a file without one."""
    found = None if head is None else head.get(HeadKey.FORMAT, '')
    if found == FORMAT:
        return
    if found is None:
        why = 'is not a recording of pfd_ros: it has no settings'
    elif found in FIRST_EDITION:
        why = (
            f'was recorded by the first edition of pfd_ros (format {found}), which alone can '
            f'simulate it; this edition reads it like any bag (pfd info, read_log)'
        )
    else:
        why = f'has format {cut(found)!r}, expected {FORMAT!r}'
    raise OtherLogError(one_line(f'{path} {why}'))
