# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The format of a recording: names, roles, types, columns, bounds.

A role is the purpose of a topic for the node; topics may be remapped, roles are fixed. Everything
here is written into files and changes only with FORMAT. See docs/reference/recording.md.
"""

from __future__ import annotations

from collections.abc import Mapping
import struct
from typing import NamedTuple

from pfd_ros.arm.events import (
    ARM_STATE,
    CLOCK,
    DESCRIPTION,
    DROPPED_STATES,
    NUMBERED_AS_STATES,
    PAYLOAD_IN_USE,
    STATES,
    TAKEN,
    TF,
    TF_STATIC,
    Source,
)
from pfd_ros.arm.settings import OUTPUTS
from pfd_ros.messages import convert

FORMAT = '2'
# Metadata records: the first and the last of a file.
HEAD, END = 'pfd_ros', 'pfd_ros_end'
# Attachment: the complete robot.
ROBOT = 'robot.yaml'
# First and last bytes of an MCAP file.
MAGIC = b'\x89MCAP0\r\n'
# Names in MCAP for the profile, messages and definitions of ROS 2.
PROFILE, MESSAGE_ENCODING, SCHEMA_ENCODING = 'ros2', 'cdr', 'ros2msg'


class HeadKey:
    """Keys of the record HEAD; each value except FORMAT and DIGEST is JSON."""

    FORMAT = 'format'
    SETTINGS = 'settings'
    TOPICS = 'topics'  # by role
    VERSIONS = 'versions'
    CLOCK = 'clock'
    DIGESTS = 'digests'  # of the other values, the attachments and the channels, by name
    DIGEST = 'digest'  # of the text of DIGESTS
    PART = 'part'  # of a file that continues another one: Part by its fields


class EndKey:
    """Keys of the record END; each value except DIGEST is JSON.

    TOTALS and CONTINUES describe the run; the other values are by topic. RECORDED and DROPPED
    count messages since the start of the run, DIGESTS cover the messages in the file.
    """

    TOTALS = 'totals'
    RECORDED = 'recorded'
    DROPPED = 'dropped'
    DIGESTS = 'digests'
    DIGEST = 'digest'  # of the digest in HEAD and the other values
    CONTINUES = 'continues'  # true in place of TOTALS: another file follows


class Part(NamedTuple):
    """The place of a file in its run.

    Attributes
    ----------
    number
        Number of the file, from 1.
    first
        Digest in the head of the first file; '' in the first file.
    previous
        Digest of the end record of the previous file.
    recorded, dropped
        Numbers of messages in the previous files, without the messages that this file repeats;
        by topic in the file, by role once it is read.
    """

    number: int = 1
    first: str = ''
    previous: str = ''
    recorded: Mapping[str, int] = {}
    dropped: Mapping[str, int] = {}

    def before(self, role: str) -> int:
        """Return the number of messages of a role before this file."""
        return self.recorded.get(role, 0) + self.dropped.get(role, 0)

    def last_number(self, role: str) -> int:
        """Return the number of the last message of a role before this file."""
        roles = NUMBERED_AS_STATES if role in NUMBERED_AS_STATES else (role,)
        return sum(self.before(each) for each in roles)


class Channel(NamedTuple):
    """The common properties of all messages of a role.

    Attributes
    ----------
    type
        ROS type of the messages.
    topic
        As the node names it, before remapping; `~` is the node's name.
    vital
        Whether a replay needs every message: such messages are dropped last.
    always
        Whether each recording has the channel; others need no new FORMAT.
    latched
        Whether the last message reaches subscribers that come later.
    """

    type: str
    topic: str
    vital: bool = False
    always: bool = False
    latched: bool = False


NAMED_COMMANDS, ARRAY_COMMANDS = 'joint_commands', 'commands'
SET_STATE, REQUESTS, PARAMETERS = 'set_state', 'requests', 'parameters'
EXTERNAL_WRENCH, PAYLOAD, FOLLOWED = 'external_wrench', 'payload', 'followed_clock'
DIAGNOSTICS, TRANSITIONS = 'diagnostics', 'transition_event'
# In the order of the recorder's topics: the inputs come first, by Source.
CHANNELS = {
    NAMED_COMMANDS: Channel(convert.JOINT_STATE, 'joint_commands', vital=True, always=True),
    ARRAY_COMMANDS: Channel(convert.FLOAT_ARRAY, '~/commands', vital=True, always=True),
    SET_STATE: Channel(convert.JOINT_STATE, '~/set_state', vital=True),
    REQUESTS: Channel(convert.STRING, '~/requests', vital=True),
    PARAMETERS: Channel(convert.STRING, '~/parameter_changes', vital=True),
    EXTERNAL_WRENCH: Channel(convert.WRENCH, '~/external_wrench', vital=True),
    PAYLOAD: Channel(convert.INERTIA, '~/payload', vital=True, latched=True),
    FOLLOWED: Channel(convert.CLOCK, '/clock', vital=True),
    TAKEN: Channel(convert.INTEGER_ARRAY, '~/applied_commands', vital=True, always=True),
    PAYLOAD_IN_USE: Channel(convert.INERTIA, '~/payload_in_use', latched=True),
    STATES: Channel(convert.JOINT_STATE, 'joint_states', always=True),
    DROPPED_STATES: Channel(convert.JOINT_STATE, '~/dropped_states'),
    **{role: Channel(kind.type, f'~/{role}') for role, kind in OUTPUTS.items()},
    CLOCK: Channel(convert.CLOCK, '/clock'),
    TF: Channel(convert.TRANSFORMS, '/tf'),
    ARM_STATE: Channel(convert.BYTE_ARRAY, '~/arm_state'),
    DESCRIPTION: Channel(convert.STRING, 'robot_description', latched=True),
    TF_STATIC: Channel(convert.TRANSFORMS, '/tf_static', latched=True),
    DIAGNOSTICS: Channel(convert.DIAGNOSTICS, '/diagnostics'),
    TRANSITIONS: Channel(convert.TRANSITION, '~/transition_event'),
}
# Inputs that come from services, not from topics; their topics are in recordings only.
OF_SERVICES = frozenset({REQUESTS, PARAMETERS})
# Neither inputs nor outputs of a cycle: a replay does not simulate them.
ASIDE = frozenset({DESCRIPTION, TF_STATIC, DIAGNOSTICS, TRANSITIONS})
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


def channel_of_end(end: Source | str) -> Channel:
    """Return the channel of a source, or of an output by role."""
    return CHANNELS[ROLE_OF_SOURCE[end] if isinstance(end, Source) else end]


# MCAP counts messages in 32 bits: 49 days at 1 kHz.
SEQUENCE_MASK = 0xFFFFFFFF
# Before each message in the digest of its topic: sequence, log time, publish time and length.
DIGEST_PREFIX = struct.Struct('<IQQQ')
# Times have 64 bits in MCAP and 63 bits and a sign in ROS.
LAST_NS = (1 << 63) - 1

# The recorder observes these bounds, and the reader relies on them.
# Longer messages are dropped; messages of an arm are much shorter.
MESSAGE_BYTES = 1 << 24
# A chunk is closed at this size; only one long message makes it longer. Compressing it blocks the
# interpreter for one or two milliseconds at most.
CHUNK_BYTES = 1 << 18
# Bounds of the reader: a record or decompressed chunk, a metadata record, a schema or channel, and
# the header.
RECORD_BYTES = 1 << 25
TEXT_BYTES = 1 << 20
DEFINITION_BYTES = 1 << 16
NAME_BYTES = 1 << 12
# A robot of some thousand joints.
ROBOT_BYTES = 1 << 18
# The reader stores a name for each channel; the node has a few.
CHANNEL_LIMIT = 256
