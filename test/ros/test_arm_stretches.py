# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stretches of cycles with nothing but commands: one native call has the bits of single cycles."""

from __future__ import annotations

from typing import Any

import numpy as np
from plant_messages import UNLIMITED, change, efforts, made, request, validated, wrench
import pytest

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Arrival, Source, Verdict

NAMES = ('shoulder', 'elbow')
TIP = 'tip_link'
SCENES: list[dict[str, Any]] = [
    {},
    {'joints': NAMES[::-1], 'lockstep': True},
    {'lockstep': True, 'publish_rate': 250.0},
    {'joint_friction': (0.3, 0.1), 'joint_limits': True, 'motor_lag': (0.01, 0.0)},
    {'torque_speed': False, 'integrator': 'velocity_verlet', 'position_sums': 'compensated'},
    {'external_wrench': True, 'payload_mass': 0.4, 'command_timeout': 0.008},
    {**UNLIMITED, 'servo_p': (5.0, 5.0)},
    {'reflex_effort_rate': 1e6},
]


def commands(cycles: int, every: int, size: float = 30.0) -> np.ndarray:
    """Return efforts beyond the limits now and then, the same for `every` cycles, (cycles, 2)."""
    own = np.random.default_rng(1).normal(size=(cycles // every, 2)) * (size, 0.5 * size)
    return np.repeat(own, every, axis=0)


def begun(**settings: Any) -> Engine:
    engine = made(**settings)
    engine.run_cycle([Arrival(Source.ARRAY, 1, efforts(3.0, 1.0))])
    while engine.cycles % engine.publish_every:
        engine.advance()
    return engine


def single(engine: Engine, rows: np.ndarray, every: int) -> np.ndarray:
    """Run cycle by cycle; return q, qd and tau after each."""
    found = []
    for k, row in enumerate(rows):
        if k % every == 0:
            engine.command(row)
        engine.advance()
        found.append((engine.arm.q, engine.arm.qd, engine.arm.tau))
        if engine.state.failure:
            break
    return np.array(found)


# In lockstep each published state waits for a command.
CASES = [
    pytest.param(settings, every, id=f'{" ".join(settings) or "plain"} {every}')
    for settings in SCENES
    for every in (1, 4)
    if every == 1 or 'lockstep' not in settings or 'publish_rate' in settings
]


@pytest.mark.parametrize(('settings', 'every'), CASES)
def test_a_stretch_has_the_bits_and_the_state_of_single_cycles(settings, every: int) -> None:
    one, other = begun(**settings), begun(**settings)
    if 'external_wrench' in settings:
        for engine in (one, other):
            engine.take([Arrival(*((w := wrench(TIP, (0.0, 2.0, 0.0)))[0], 5, w[1]))])
    rows = commands(400, max(every, one.publish_every if one.pace.lockstep else 1))
    step = max(every, one.publish_every if one.pace.lockstep else 1)
    wanted = single(one, rows, step)
    found = other.stretch(rows, range(0, len(rows), step))
    assert found is not None
    assert found.tobytes() == wanted.tobytes()
    assert other.state == one.state
    assert other.state.actuators.saturated > 10 or settings.get('effort_limits') is False
    # Both continue with the same bits.
    single(one, rows[:20], step)
    single(other, rows[:20], step)
    assert other.state == one.state


def test_a_stretch_that_fails_ends_where_single_cycles_do() -> None:
    one, other = begun(**UNLIMITED), begun(**UNLIMITED)
    rows = commands(50, 1)
    rows[30:] = 1e300
    wanted = single(one, rows, 1)
    found = other.stretch(rows, range(len(rows)))
    assert found is not None
    assert 30 <= len(found) < 50
    assert len(found) == len(wanted)
    assert found[:-1].tobytes() == wanted[:-1].tobytes()
    assert other.state.failure == one.state.failure != ''
    assert other.state == one.state


def test_a_reflex_in_a_stretch_brakes_as_in_single_cycles() -> None:
    one, other = begun(reflex_effort_rate=1e5), begun(reflex_effort_rate=1e5)
    rows = commands(60, 1, size=5.0)
    rows[40] = 150.0
    wanted = single(one, rows, 1)
    found = other.stretch(rows, range(len(rows)))
    assert found is not None
    assert len(found) == 41
    assert found.tobytes() == wanted[:41].tobytes()
    single(other, rows[41:], 1)
    assert other.state.actuators.trips == 1
    assert 'changed by' in other.state.actuators.reflex
    assert other.state == one.state


@pytest.mark.parametrize(
    'settings',
    [
        {'delay_commands': 0.002},
        {'drop_commands': 0.5},
        {'noise_position': 1e-3},
        {'delay_state': 0.001},
        {'time_source': 'clock', 'publish_clock': False},
        {'command_timeout': 0.002},
        {'external_wrench': True, 'external_wrench_timeout': 0.02},
        {'autostart': False},
    ],
    ids=lambda s: next(iter(s)),
)
def test_an_arm_on_which_more_than_commands_acts_runs_cycle_by_cycle(settings) -> None:
    engine = made(**settings)
    if 'external_wrench' in settings:
        source, data = wrench(TIP, (0.0, 2.0, 0.0))
        engine.take([Arrival(source, 1, data)])
    before = engine.save()
    assert engine.stretch(commands(8, 4), range(0, 8, 4)) is None
    assert engine.state == before


@pytest.mark.parametrize(
    'event',
    [
        request('reset'),
        change(noise_velocity=1e-3),
        change(reflex_effort_rate=10.0),
    ],
)
def test_events_between_two_stretches_act(event: tuple[Source, bytes]) -> None:
    one, other = begun(), begun()
    rows = commands(20, 1)
    for _ in range(3):
        single(one, rows, 1)
        found = other.stretch(rows, range(20))
        single(other, rows[0 if found is None else len(found) :], 1)
        for engine in (one, other):
            assert validated(engine, event).verdict is Verdict.ACCEPTED
        assert other.state == one.state


def test_efforts_that_are_not_finite_are_left_to_the_rules() -> None:
    engine = begun()
    rows = commands(10, 1)
    rows[7, 1] = np.nan
    before = engine.save()
    assert engine.stretch(rows, range(10)) is None
    assert not engine.answer(rows[7])
    assert engine.state == before
