# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The format of a recording, the only place of it: names, roles, types, columns, bounds.

A role says what a topic is to the node; topics may be remapped, roles are not. Everything here is
written into files and stays as it is as long as FORMAT does.
See docs/decisions/0004-recording-layout.md.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from pfd_ros.arm.events import CLOCK, DROPPED_STATES, PAYLOAD_IN_USE, STATES, TAKEN, Source
from pfd_ros.arm.output_settings import OUTPUTS
from pfd_ros.messages import convert

FORMAT = '1'
# Metadata records: the first and the last of a file.
HEAD, END = 'pfd_ros', 'pfd_ros_end'
# Attachment: the robot, whole.
ROBOT = 'robot.yaml'
# As MCAP names the profile of ROS 2, its messages and their definitions.
PROFILE, MESSAGE_ENCODING, SCHEMA_ENCODING = 'ros2', 'cdr', 'ros2msg'


class HeadKey:
    """Keys of the record HEAD; each value is JSON, but for FORMAT itself."""

    FORMAT = 'format'
    SETTINGS = 'settings'
    TOPICS = 'topics'  # by role
    VERSIONS = 'versions'
    CLOCK = 'clock'


class EndKey:
    """Keys of the record END; each value is JSON, and all but TOTALS are by topic."""

    TOTALS = 'totals'
    RECORDED = 'recorded'
    DROPPED = 'dropped'
    DIGESTS = 'digests'


class Channel(NamedTuple):
    """The properties that all messages of a role share.

    Attributes
    ----------
    type
        ROS type of the messages.
    vital
        Whether a replay cannot do without a single one: such messages are dropped last.
    always
        Whether each recording has the channel; others may be added without a new FORMAT.
    """

    type: str
    vital: bool = False
    always: bool = True


NAMED_COMMANDS, ARRAY_COMMANDS = 'joint_commands', 'commands'
SET_STATE, REQUESTS, PARAMETERS = 'set_state', 'requests', 'parameters'
EXTERNAL_WRENCH, PAYLOAD, FOLLOWED = 'external_wrench', 'payload', 'followed_clock'
# In the order of the recorder's topics: the inputs come first, by Source.
CHANNELS = {
    NAMED_COMMANDS: Channel(convert.JOINT_STATE, vital=True),
    ARRAY_COMMANDS: Channel(convert.FLOAT_ARRAY, vital=True),
    SET_STATE: Channel(convert.JOINT_STATE, vital=True, always=False),
    REQUESTS: Channel(convert.STRING, vital=True, always=False),
    PARAMETERS: Channel(convert.STRING, vital=True, always=False),
    EXTERNAL_WRENCH: Channel(convert.WRENCH, vital=True, always=False),
    PAYLOAD: Channel(convert.INERTIA, vital=True, always=False),
    FOLLOWED: Channel(convert.CLOCK, vital=True, always=False),
    TAKEN: Channel(convert.INTEGER_ARRAY, vital=True),
    PAYLOAD_IN_USE: Channel(convert.INERTIA, always=False),
    STATES: Channel(convert.JOINT_STATE),
    DROPPED_STATES: Channel(convert.JOINT_STATE, always=False),
    **{role: Channel(kind, always=False) for role, kind in OUTPUTS.items()},
    CLOCK: Channel(convert.CLOCK, always=False),
}
ROLE_OF_SOURCE = {
    Source.NAMED: NAMED_COMMANDS,
    Source.ARRAY: ARRAY_COMMANDS,
    Source.SET_STATE: SET_STATE,
    Source.REQUEST: REQUESTS,
    Source.PARAMETERS: PARAMETERS,
    Source.WRENCH: EXTERNAL_WRENCH,
    Source.PAYLOAD: PAYLOAD,
    Source.TICK: FOLLOWED,
}
SOURCE_OF_ROLE = {role: source for source, role in ROLE_OF_SOURCE.items()}

# MCAP counts messages in 32 bits: 49 days at 1 kHz.
SEQUENCE_MASK = 0xFFFFFFFF
# Before each message in the digest of its topic: sequence and length.
DIGEST_PREFIX = struct.Struct('<IQ')
# MCAP holds 64 bits of a time, ROS keeps one of them for the sign.
LAST_NS = (1 << 63) - 1

# The recorder keeps to these bounds, and the reader relies on them.
# No message of an arm comes near; longer ones are dropped.
MESSAGE_BYTES = 1 << 24
# A chunk is closed at this size, so only one long message makes it longer. Compressing it holds
# the interpreter for well under a millisecond or two.
CHUNK_BYTES = 1 << 18
# Bounds of the reader alone: of a record or an unpacked chunk, of a record of metadata, of a
# schema or channel, and of the header.
RECORD_BYTES = 1 << 25
TEXT_BYTES = 1 << 20
DEFINITION_BYTES = 1 << 16
NAME_BYTES = 1 << 12
# A robot of some thousand joints.
ROBOT_BYTES = 1 << 18
# The reader keeps a name for each channel; the node has a handful.
CHANNEL_LIMIT = 256
