# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The format of a recording: names of its records, roles, types and columns of its channels.

A role says what a topic is to the node; topics may be remapped, roles are not. Everything here is
written into files and stays as it is as long as FORMAT does.
See docs/decisions/0004-recording-layout.md.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from pfd_ros.arm.events import Source
from pfd_ros.messages import convert

FORMAT = '1'
# Metadata records: the first and the last of a file.
HEAD, END = 'pfd_ros', 'pfd_ros_end'
# Attachment: the robot, whole.
ROBOT = 'robot.yaml'
# MCAP counts messages in 32 bits: 49 days at 1 kHz.
SEQUENCE_MASK = 0xFFFFFFFF
# Before each message in the digest of its topic: sequence and length.
DIGEST_PREFIX = struct.Struct('<IQ')


class Channel(NamedTuple):
    """What every message of a role has in common.

    Attributes
    ----------
    type
        ROS type of the messages.
    vital
        Whether a replay cannot do without a single one: such messages are dropped last.
    always
        Whether each recording has the channel.
    """

    type: str
    vital: bool = False
    always: bool = True


# In the order of the recorder's topics: the commands come first, by Source.
CHANNELS = {
    'joint_commands': Channel(convert.JOINT_STATE, vital=True),
    'commands': Channel(convert.FLOAT_ARRAY, vital=True),
    'taken': Channel(convert.INTEGER_ARRAY, vital=True),
    'joint_states': Channel(convert.JOINT_STATE),
    'clock': Channel(convert.CLOCK, always=False),
}
ROLES = tuple(CHANNELS)
ROLE_OF_SOURCE = {Source.NAMED: 'joint_commands', Source.ARRAY: 'commands'}
SOURCE_OF_ROLE = {role: source for source, role in ROLE_OF_SOURCE.items()}
