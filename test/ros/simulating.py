# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of the node's own cycle, without ROS, a disk or time: small, exact and at will."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from bridge import (
    END_RECORD,
    HEAD_RECORD,
    NUMBERED_AS_STATES,
    PAYLOAD_IN_USE,
    RECORDING_CHANNELS,
    ROLE_OF_SOURCE,
    WALL_TIME,
    Arrival,
    Engine,
    JointMessage,
    RecordedLog,
    Settings,
    Source,
    ValidationRow,
    Verdict,
    decode_joint_state,
    file_head,
    load_arm_robot,
    messages_of,
    placed_blocks,
    roles_of,
    time_base,
)
from rewriting import ARRAY, CLOCK, NAMED, STATES, TAKEN, File, Recording, Sent, Type

ROLES = {
    'joint_commands': NAMED,
    'commands': ARRAY,
    'taken': TAKEN,
    'joint_states': STATES,
    'clock': CLOCK,
}
START_NS = 1_700_000_000_000_000_000


def rows_of(path: Path) -> list[ValidationRow]:
    """Return the validation rows of a recording, in their order."""
    messages = (m for block in placed_blocks(RecordedLog(path)) for m in messages_of(block))
    return [row for message in messages for row in message.rows]


def states_of(path: Path) -> list[JointMessage]:
    """Return the published states of a recording."""
    return [
        decode_joint_state(e.data) for e in RecordedLog(path).entries() if e.role == 'joint_states'
    ]


def simulate(
    steps: int,
    commands: Mapping[int, Sequence[bytes | tuple[Source, bytes]]] | None = None,
    **settings: Any,
) -> Recording:
    """Return the recording of a run of so many steps.

    Parameters
    ----------
    steps
        Cycles of the node.
    commands
        Messages that are taken before a step: commands without names, or those of any source.
    settings
        Of the node; planar2 unless they say otherwise.
    """
    chosen = Settings(**{'robot': 'planar2', **settings})
    robot = load_arm_robot(chosen)
    engine = Engine(chosen, robot)
    first = engine.settings
    roles = {
        role: ROLES.get(role, f'/sim_arm/{role}')
        for role in RECORDING_CHANNELS
        if role in ('joint_commands', 'commands', 'taken')
        or role in roles_of(chosen) - {PAYLOAD_IN_USE}
    }
    made = Recording()
    counts: Counter[str] = Counter()
    accepted = 0

    def record(role: str, step: int, data: bytes) -> int:
        topic = roles.setdefault(role, f'/sim_arm/{role}')
        counts[role] += 1
        number = counts[role]
        if role in NUMBERED_AS_STATES:
            number = sum(counts[each] for each in NUMBERED_AS_STATES)
        wall_ns = START_NS + step * chosen.step_ns
        # Of the state before an input, or of this step.
        simulated_ns = engine.arm.stamp_ns
        times = (wall_ns, simulated_ns)
        log_ns, published_ns = times if first.log_time == WALL_TIME else times[::-1]
        made.messages.append(Sent(topic, number, log_ns, data, published_ns))
        return number

    for step in range(1, steps + 1):
        events = []
        for sent in (commands or {}).get(step, ()):
            source, data = (Source.ARRAY, sent) if isinstance(sent, bytes) else sent
            number = record(ROLE_OF_SOURCE[source], step, data)
            events.append(Arrival(source, number, data))
        result = engine.run_cycle(events)
        accepted += sum(found.verdict is Verdict.ACCEPTED for _, found, _ in result.validations)
        for role, number, data in result.outputs:
            assert number == record(role, step, data)
    base = replace(time_base(first), wall_ns=START_NS, steady_ns=0)
    head = file_head(first, robot, roles, base, engine.arm.program)
    made.metadata.append((HEAD_RECORD, dict(head.values)))
    made.attachments += [File(record.name, record.data) for record in head.attachments]
    made.channels += [
        Type(topic, 'cdr', RECORDING_CHANNELS[role].type, 'ros2msg')
        for role, topic in roles.items()
    ]
    totals = {
        'steps': engine.arm.step,
        'states': sum(counts[role] for role in NUMBERED_AS_STATES),
        'commands_accepted': accepted,
        'failure': engine.arm.failure,
    }
    zeros = dict.fromkeys(roles.values(), 0)
    told = {'totals': totals, 'recorded': zeros, 'dropped': zeros}
    made.metadata.append((END_RECORD, {name: json.dumps(value) for name, value in told.items()}))
    made.recount()
    return made
