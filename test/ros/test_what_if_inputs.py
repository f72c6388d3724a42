# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A what-if follows inputs of every kind: equal bits without a change, verified logs with one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge import (
    WRENCH_TYPE,
    InertiaMessage,
    Request,
    Source,
    encode_changes,
    encode_clock,
    encode_inertia,
    encode_request,
    pfd_main,
    stamped_encoder,
    what_if,
)
import numpy as np
from plant_messages import efforts, joint_state
import pytest
from rewriting import Sent, load
from simulating import simulate

Inputs = dict[int, list[Any]]
PUSH = stamped_encoder(WRENCH_TYPE, 'tip_link').encode(0, np.array([1.0, 2.0, 3.0, 0.0, 0.0, 1.0]))
BODY = encode_inertia(InertiaMessage(0, 'tip_link', 1.0, (0.1, 0.0, 0.0), (0.0,) * 6))


def request(name: str) -> tuple[Source, bytes]:
    return Source.REQUEST, encode_request(Request(name))


def change(**values: Any) -> tuple[Source, bytes]:
    return Source.PARAMETERS, encode_changes(values)


def tick(seconds: int) -> tuple[Source, bytes]:
    return Source.TICK, encode_clock(seconds * 10**9)


def target(k: int) -> tuple[Source, bytes]:
    return Source.NAMED, joint_state(['elbow', 'shoulder'], [0.01 * k, -0.01 * k], [], [1, 1])


SERVO = {
    'servo_p': (50.0, 40.0),
    'servo_d': (5.0, 4.0),
    'command_timeout': 0.05,
    'on_timeout': 'hold',
    'delay_commands': 0.003,
    'drop_commands': 0.3,
}
WRENCHES = {
    'external_wrench': True,
    'external_wrench_timeout': 0.02,
    'outputs': ('external_torques', 'tip_pose'),
}
CASES: dict[str, tuple[dict[str, Any], Inputs]] = {
    'followed clock': (
        {'time_source': 'clock', 'publish_clock': False},
        {3: [tick(5), efforts(1, 2)], 20: [tick(6)]},
    ),
    'servos, late and lost commands, a watchdog': (
        SERVO,
        {k: [target(k)] for k in range(2, 100, 7)},
    ),
    'wrenches': (
        WRENCHES,
        {
            2: [efforts(1, 2)],
            10: [(Source.WRENCH, PUSH)],
            50: [request('clear_wrench')],
            60: [(Source.WRENCH, PUSH)],
        },
    ),
    'requests': (
        {'autostart': False},
        {
            2: [efforts(1, 2)],
            4: [request('activate')],
            6: [efforts(1, 2)],
            30: [request('pause')],
            40: [request('step')],
            50: [request('resume')],
            70: [request('reset')],
            80: [efforts(2, 1)],
            90: [request('deactivate')],
        },
    ),
    'payloads and parameters': (
        {'payload_mass': 0.2},
        {
            2: [efforts(1, 2)],
            30: [(Source.PAYLOAD, BODY)],
            60: [change(payload_mass=0.5, gravity_compensation=True)],
            70: [change(servo_p=[1.0, 1.0], command_timeout=0.01)],
        },
    ),
    'a reflex': (
        {'reflex_effort_rate': 100.0},
        {k: [efforts(0.01 * k, 1)] for k in range(2, 100)}
        | {100: [efforts(5, 9)], 150: [efforts(1, 2)]}
        | {170: [request('reset')], 180: [efforts(1, 1)]},
    ),
    'many commands of a cycle': ({}, {2: [efforts(1, 2)] * 5, 9: [efforts(1), target(3)]}),
}


def by_topic(messages: list[Sent]) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    for message in messages:
        found.setdefault(message.topic, []).append((message.sequence, message.data))
    return found


@pytest.mark.parametrize('case', CASES)
def test_inputs_of_every_kind_act_again(case: str, tmp_path: Path) -> None:
    settings, inputs = CASES[case]
    run = simulate(250, inputs, **settings)
    log = run.save(tmp_path / 'a.mcap')
    found = what_if(log)
    assert by_topic(load(found.log).messages) == by_topic(run.messages)
    assert found.states == 250
    for words in (['step_size=0.0005'], ['payload.mass=0.3', 'seed=4']):
        changed = what_if(log, words)
        assert not changed.rejected
        assert changed.states == 250
        assert pfd_main(['replay', str(changed.log), '--verify']) == 0
