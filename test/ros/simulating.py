# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of the node's own cycle, without ROS, a disk or time: small, exact and at will."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
from typing import Any

import numpy as np
from rewriting import ARRAY, CLOCK, NAMED, STATES, TAKEN, Recording, Sent, Type

from pfd_ros.arm.commands import Verdict
from pfd_ros.arm.plant import Plant, Source, load_robot
from pfd_ros.arm.settings import Settings
from pfd_ros.messages import cdr, convert
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS, END, TAKEN_COLUMNS
from pfd_ros.recording.mcap_file import TimeBase

ROLES = {
    'joint_commands': NAMED,
    'commands': ARRAY,
    'taken': TAKEN,
    'joint_states': STATES,
    'clock': CLOCK,
}
START_NS = 1_700_000_000_000_000_000


def efforts(*values: float) -> bytes:
    """Return a command without names."""
    writer = cdr.CdrWriter()
    writer.uint32(0)
    writer.uint32(0)
    writer.numbers(np.array(values))
    return bytes(writer.data)


def simulate(
    steps: int, commands: Mapping[int, Sequence[bytes]] | None = None, **settings: Any
) -> Recording:
    """Return the recording of a run of so many steps.

    Parameters
    ----------
    steps
        Cycles of the node.
    commands
        Commands without names that are taken before a step.
    settings
        Of the node; planar2 unless they say otherwise.
    """
    chosen = Settings(**{'robot': 'planar2', **settings})
    robot = load_robot(chosen)
    plant = Plant(chosen, robot)
    roles = {k: v for k, v in ROLES.items() if k != 'clock' or chosen.publish_clock}
    head = provenance.file_head(chosen, robot, roles, TimeBase(START_NS, 0))
    made = Recording(
        metadata=[(name, dict(values)) for name, values in head.metadata.items()],
        attachments=[(name, text.encode()) for name, text in head.attachments.items()],
        channels=[
            Type(topic, 'cdr', CHANNELS[role].type, 'ros2msg') for role, topic in roles.items()
        ],
    )
    counts = dict.fromkeys(ROLES.values(), 0)
    accepted = 0

    def record(topic: str, step: int, data: bytes) -> int:
        counts[topic] += 1
        made.messages.append(Sent(topic, counts[topic], START_NS + step * chosen.step_ns, data))
        return counts[topic]

    for step in range(1, steps + 1):
        rows = []
        for data in (commands or {}).get(step, ()):
            number = record(ARRAY, step, data)
            verdict = plant.receive(Source.ARRAY, data).verdict
            accepted += verdict is Verdict.ACCEPTED
            rows.append((step, Source.ARRAY, number, verdict))
        if rows:
            record(TAKEN, step, convert.encode_rows(rows, TAKEN_COLUMNS))
        plant.advance()
        if step % chosen.publish_every == 0:
            record(STATES, step, plant.state())
        if chosen.publish_clock and step % chosen.clock_every == 0:
            record(CLOCK, step, plant.clock())
    totals = {
        'steps': plant.step,
        'states': counts[STATES],
        'commands_accepted': accepted,
        'failure': plant.failure,
    }
    zeros = dict.fromkeys(roles.values(), 0)
    told = {'totals': totals, 'recorded': zeros, 'dropped': zeros}
    made.metadata.append((END, {name: json.dumps(value) for name, value in told.items()}))
    made.recount(digests=True)
    return made
