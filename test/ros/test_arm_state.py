# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The state of an arm as one record: saved, copied, compared, written as bytes, and restored."""

from __future__ import annotations

from copy import deepcopy
import hashlib
import pickle
from typing import Any

import numpy as np
from plant_messages import (
    UNLIMITED,
    change,
    efforts,
    failed,
    made,
    payload,
    request,
    validated,
    wrench,
)
import pytest

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Arrival, Output, Source, Verdict
from pfd_ros.arm.state import MAGIC, ArmState
from pfd_ros.messages.convert import JointStateEncoder
from pfd_ros.testing.lockstep_arm import LockstepArm

NAMES = ('shoulder', 'elbow')
TIP = 'tip_link'
# Delay, drop-out and noise both ways, servos, watchdog, reflex, wrench, stops, friction, lag.
RICH: dict[str, Any] = {
    'joints': NAMES[::-1],
    'delay_commands': 0.004,
    'drop_commands': 0.2,
    'command_timeout': 0.03,
    'on_timeout': 'hold',
    'servo_p': (50.0, 80.0),
    'servo_d': (4.0, 5.0),
    'reflex_effort_rate': 1e5,
    'delay_state': 0.003,
    'drop_state': 0.1,
    'noise_position': 1e-4,
    'noise_velocity': 1e-3,
    'quantization_effort': 0.01,
    'bias_position': (0.01, -0.02),
    'external_wrench': True,
    'external_wrench_timeout': 0.05,
    'joint_friction': (0.2, 0.1),
    'motor_lag': (0.01, 0.0),
    'outputs': ('true_states', 'acceleration', 'energy', 'tip_wrench'),
    'publish_rate': 500.0,
    'seed': 7,
}
CYCLES = 500
EVERY = 50


def target(place: float) -> tuple[Source, bytes]:
    q = np.array([place, -place])
    return Source.NAMED, JointStateEncoder(NAMES).encode(0, q, 0.5 * q, q)


def events(cycle: int) -> list[Arrival]:
    """Return the events before a cycle: commands with gaps, and every other kind now and then."""
    found = []
    if cycle % 60 < 25:
        wave = np.sin(0.1 * cycle)
        torques = Source.ARRAY, efforts(8.0 * wave, 3.0 * wave)
        found.append(torques if cycle % 3 else target(wave))
    if cycle == 70:
        found.append(wrench(TIP, (0.0, 3.0, 0.0)))
    if cycle == 130:
        found.append(change(payload_mass=0.7, payload_center=[0.1, 0.0, 0.0]))
    if cycle == 180:
        found.append(change(noise_velocity=0.0, servo_p=[60.0, 60.0]))
    if cycle == 230:
        found.append(payload(TIP, 0.3))
    if cycle == 305:
        found.append((Source.REQUEST, b'not a request'))
    if cycle == 320:
        found.append(request('pause'))
    return [Arrival(source, cycle, data) for source, data in found]


def outputs(engine: Engine, cycles: int) -> list[Output]:
    found: list[Output] = []
    for _ in range(cycles):
        found += engine.run_cycle(events(engine.cycles + 1)).outputs
    return found


@pytest.fixture(scope='module')
def whole() -> tuple[list[list[Output]], list[ArmState]]:
    """Return the outputs and the states of a run, by stretches of EVERY cycles."""
    engine = made(**RICH)
    states, found = [engine.save()], []
    for _ in range(CYCLES // EVERY):
        found.append(outputs(engine, EVERY))
        states.append(engine.save())
    assert engine.state.link.timeouts > 2
    assert engine.state.link.lost > 10
    return found, states


@pytest.mark.parametrize('start', range(0, CYCLES // EVERY))
def test_a_fresh_arm_continues_a_saved_run_with_the_same_bits(whole, start: int) -> None:
    found, states = whole
    engine = made(**RICH)
    engine.restore(states[start])
    assert engine.state == states[start]
    # On to the end by induction: the other starts have the states after this one.
    for k in range(start, min(start + 2, CYCLES // EVERY)):
        assert outputs(engine, EVERY) == found[k]
        assert engine.state == states[k + 1]


def test_the_bytes_of_a_state_restore_it(whole) -> None:
    found, states = whole
    engine = made(**RICH)
    data = states[5].to_bytes()
    engine.restore(ArmState.from_bytes(data))
    assert engine.save().to_bytes() == data
    assert outputs(engine, EVERY) == found[5]


def test_a_state_can_be_copied_pickled_and_compared(whole) -> None:
    _, states = whole
    for twin in (states[3].copy(), deepcopy(states[3]), pickle.loads(pickle.dumps(states[3]))):
        assert twin == states[3]
        assert twin != states[4]
        twin.simulation.arrays['q'][0] = np.nextafter(twin.simulation.arrays['q'][0], 9.0)
        assert twin != states[3]


def test_a_saved_state_stays_as_it_is_while_the_arm_runs() -> None:
    engine = made(**RICH)
    outputs(engine, 20)
    saved = engine.save()
    before = saved.to_bytes()
    outputs(engine, 20)
    assert saved.to_bytes() == before
    engine.restore(saved)
    outputs(engine, 20)
    assert saved.to_bytes() == before


@pytest.mark.parametrize(
    ('other', 'reason'),
    [
        ({'robot': 'ur5'}, 'is of a robot with the digest'),
        ({'seed': 8}, 'seed=8, expected 0'),
        ({'step_size': 0.002}, r'step_size=0\.002, expected 0\.001'),
        ({'payload_mass': 0.123}, r'payload_mass=0\.123, expected 0\.0'),
    ],
)
def test_a_state_of_another_arm_is_refused(other: dict[str, Any], reason: str) -> None:
    engine = made()
    before = engine.save()
    with pytest.raises(ValueError, match=reason):
        engine.restore(made(**other).save())
    assert engine.state == before


@pytest.mark.parametrize(
    'damage', [lambda d: b'', lambda d: d[:-1], lambda d: d[:60] + b'0' + d[61:]]
)
def test_damaged_bytes_are_refused(damage) -> None:
    with pytest.raises(ValueError, match='expected the bytes of an arm state'):
        ArmState.from_bytes(damage(made().save().to_bytes()))


@pytest.mark.parametrize(
    'tree',
    [
        '{"ArmState": []}',
        '{"x": 1}',
        '[]',
        '{"ArmState": {"q": 1}}',
        100_000 * '[',
        f'{{"array": ["<f8", [{2**70}], ""]}}',
    ],
)
def test_other_values_under_a_valid_digest_are_refused(tree: str) -> None:
    data = MAGIC + hashlib.sha256(tree.encode()).digest() + tree.encode()
    with pytest.raises(ValueError, match=r'expected .*an? arm state'):
        ArmState.from_bytes(data)


def test_an_arm_that_failed_is_restored_as_it_was() -> None:
    engine = failed()
    fresh = made(**UNLIMITED)
    fresh.restore(engine.save())
    for one in (fresh, engine):
        assert validated(one, request('reset')).verdict is Verdict.ACCEPTED
    assert outputs(fresh, 5) == outputs(engine, 5)
    assert fresh.state == engine.state
    assert not fresh.state.failure


def pd(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return 40.0 * (0.5 - q) - 4.0 * qd


def test_a_test_starts_from_a_warmed_up_arm() -> None:
    with LockstepArm('planar2', noise_position=1e-4) as arm:
        arm.run(pd, 0.5)
        warm = arm.save()
        first = arm.run(pd, 0.2)
        arm.set(noise_position=0.0)
        arm.restore(warm)
        assert arm.settings.noise_position == 1e-4
        again = arm.run(pd, 0.2)
    with LockstepArm('planar2', noise_position=1e-4) as other:
        other.restore(warm)
        fresh = other.run(pd, 0.2)
    for run in (again, fresh):
        for name in ('time', 'q', 'qd', 'tau'):
            assert getattr(run, name).tobytes() == getattr(first, name).tobytes()


def test_a_recorded_run_refuses_a_state(tmp_path) -> None:
    with LockstepArm('planar2', recording=tmp_path / 'a.mcap') as arm:
        arm.run(pd, 0.01)
        with pytest.raises(ValueError, match=r'recorded in .* restore a state in an arm without'):
            arm.restore(arm.save())
