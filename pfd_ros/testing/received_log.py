# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The states that a test received from an arm in another process, as a bag with one topic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pfd_ros.messages.convert import JOINT_STATE, NANOSECONDS, JointStateEncoder
from pfd_ros.messages.definitions import full_text
from pfd_ros.recording.block_writer import BlockWriter
from pfd_ros.recording.format import MESSAGE_ENCODING, PROFILE, SCHEMA_ENCODING
from pfd_ros.files import new_file
from pfd_ros.testing.trajectory import Rows

TOPIC = '/joint_states'


def write_received(names: Sequence[str], runs: Sequence[Rows], path: Path) -> None:
    """Write the rows of some runs as states, at simulated times; OSError if the file exists."""
    encoder = JointStateEncoder(names)
    with new_file(path) as stream:
        writer = BlockWriter(stream)
        writer.start(PROFILE, 'pfd_ros')
        schema = writer.register_schema(
            JOINT_STATE, SCHEMA_ENCODING, full_text(JOINT_STATE).encode()
        )
        channel = writer.register_channel(TOPIC, MESSAGE_ENCODING, schema, {})
        last, number = -1, 0
        for rows in runs:
            for k in range(rows.count):
                stamp = round(rows.time[k] * NANOSECONDS)
                # The first state of a run may be the last one of the run before.
                if stamp > last:
                    last, number = stamp, number + 1
                    data = encoder.encode(stamp, rows.q[k], rows.qd[k], rows.tau[k])
                    writer.add_messages([(channel, stamp, stamp, number, data)])
        writer.finish()
