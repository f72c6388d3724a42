# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Watchdog, delay and drop-out of commands, reflexes: they follow from cycles, and so replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge import (
    Arrival,
    Engine,
    JointMessage,
    NoiseChannel,
    Request,
    Settings,
    Source,
    Verdict,
    encode_changes,
    encode_request,
    noise_uniform,
    read_recording,
    timeout_text,
)
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from plant_messages import efforts, joint_state, made
import pytest
from simulating import rows_of, simulate, states_of

NAMES = ('shoulder', 'elbow')
NAN = float('nan')
SERVO: dict[str, Any] = {'servo_p': (400.0, 200.0), 'servo_d': (40.0, 10.0)}
RESET = encode_request(Request('reset'))


def send(engine: Engine, data: bytes, source: Source = Source.ARRAY, sequence: int = 1) -> Verdict:
    ((_, validation, _),) = engine.take([Arrival(source, sequence, data)]).validations
    return validation.verdict


def taus(engine: Engine, cycles: int) -> list[list[float]]:
    found = []
    for _ in range(cycles):
        engine.step()
        found.append(engine.arm.tau.tolist())
    return found


def verified(path: Path) -> list[JointMessage]:
    """Return the states of a recording that verifies."""
    assert read_recording(path, verify=True).complete
    return states_of(path)


def test_a_watchdog_waits_for_the_first_command_and_acts_once_after_the_last() -> None:
    engine = made(command_timeout=0.005)
    assert not any(map(any, taus(engine, 20)))
    assert engine.state.link.timeouts == 0
    send(engine, efforts(1.0, 0.5))
    assert taus(engine, 3) == [[1.0, 0.5]] * 3
    send(engine, efforts(2.0, 0.5))
    assert taus(engine, 8) == [[2.0, 0.5]] * 5 + [[0.0, 0.0]] * 3
    assert (engine.state.link.timeouts, engine.state.link.timed_out) == (1, True)
    # Braked: the arm stands from the next state on.
    q = engine.arm.q
    assert not engine.arm.qd.any()
    taus(engine, 50)
    assert engine.arm.q.tobytes() == q.tobytes()
    assert engine.state.link.timeouts == 1
    send(engine, efforts(3.0, 0.5))
    assert not engine.state.link.timed_out
    assert taus(engine, 7) == [[3.0, 0.5]] * 5 + [[0.0, 0.0]] * 2
    assert engine.state.link.timeouts == 2


def test_messages_that_are_refused_or_nan_do_not_feed_the_watchdog() -> None:
    engine = made(command_timeout=0.005)
    send(engine, efforts(1.0, 0.5))
    for _ in range(4):
        taus(engine, 1)
        assert send(engine, efforts(1.0)) is Verdict.WRONG_SIZE
        nothing = joint_state(NAMES, effort=[NAN, NAN])
        assert send(engine, nothing, Source.NAMED) is Verdict.ALL_NAN
    taus(engine, 2)
    assert engine.state.link.timed_out


def test_a_pause_is_no_silence() -> None:
    engine = made(command_timeout=0.005)
    send(engine, efforts(1.0, 0.5))
    engine.take([Arrival(Source.REQUEST, 1, encode_request(Request('pause')))])
    assert engine.waiting
    assert taus(engine, 5) == [[1.0, 0.5]] * 5


def test_on_timeout_zero_commands_zero_effort_and_leaves_brakes_on() -> None:
    engine = made(command_timeout=0.005, on_timeout='zero', gravity=(0.0, 0.0, 0.0))
    send(engine, joint_state(['shoulder'], effort=[2.0]), Source.NAMED)
    assert taus(engine, 7) == [[2.0, 0.0]] * 5 + [[0.0, 0.0]] * 2
    taus(engine, 20)
    # Stretched, a rod of 2 kg and 1 m about its end; without gravity its speed stays.
    assert engine.arm.qd[0] == pytest.approx(5e-3 * 2.0 / (2.0 / 3.0), rel=1e-6)
    assert engine.arm.qd[1] == 0.0


def test_on_timeout_hold_keeps_the_position_at_the_timeout_by_the_servo() -> None:
    engine = made(command_timeout=0.005, on_timeout='hold', gravity=(0.0, 0.0, 0.0), **SERVO)
    send(engine, efforts(1.0, -0.5))
    taus(engine, 5)
    q, qd = engine.arm.q, engine.arm.qd
    (first,) = taus(engine, 1)
    assert first == (-np.array(SERVO['servo_d']) * qd).tolist()
    taus(engine, 4000)
    np.testing.assert_allclose(engine.arm.q, q, atol=1e-9)
    # A torque command ends it.
    send(engine, efforts(1.0, 0.5))
    assert taus(engine, 1) == [[1.0, 0.5]]


@pytest.mark.parametrize('gains', [{}, {'servo_p': (1.0, 0.0)}, {'servo_d': (1.0, 1.0)}], ids=str)
def test_holding_without_a_servo_is_refused(gains: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="on_timeout is 'hold', expected servo_p above 0"):
        made(on_timeout='hold', **gains)


def test_a_change_that_takes_the_servo_of_a_hold_away_is_refused() -> None:
    engine = made(on_timeout='hold', **SERVO)
    changes = encode_changes({'servo_p': [1.0, 0.0]})
    assert send(engine, changes, Source.PARAMETERS) is Verdict.REFUSED
    assert send(engine, encode_changes({'servo_p': [1.0, 2.0]}), Source.PARAMETERS) is (
        Verdict.ACCEPTED
    )


@pytest.mark.parametrize('on_timeout', ['brake', 'zero', 'hold'])
def test_a_recording_with_timeouts_of_the_watchdog_verifies(
    tmp_path: Path, on_timeout: str
) -> None:
    commands: dict[int, list[Any]] = {
        3: [efforts(2.0, -1.0)],
        8: [efforts(1.0, 1.0)],
        60: [(Source.NAMED, joint_state(NAMES, [0.1, NAN], effort=[0.5, 0.0]))],
        90: [(Source.PARAMETERS, encode_changes({'command_timeout': 0.02, 'servo_p': [9, 8]}))],
        91: [efforts(3.0, 1.0)],
        130: [(Source.REQUEST, RESET), efforts(2.0, 2.0)],
    }
    recording = simulate(200, commands, command_timeout=0.01, on_timeout=on_timeout, **SERVO)
    states = verified(recording.save(tmp_path / 'a.mcap'))
    tau = np.array([state.effort for state in states])
    assert tau[16].tolist() == [1.0, 1.0]
    assert tau[17].tolist() != [1.0, 1.0]
    assert tau[109].tolist() == [3.0, 1.0]
    assert tau[110].tolist() != [3.0, 1.0]


def test_a_delayed_command_acts_some_cycles_later_and_is_validated_at_once() -> None:
    engine = made(delay_commands=0.003)
    assert send(engine, efforts(1.0, 0.5)) is Verdict.ACCEPTED
    assert taus(engine, 1) == [[0.0, 0.0]]
    send(engine, joint_state(['elbow'], effort=[9.0]), Source.NAMED)
    send(engine, joint_state(['shoulder'], effort=[7.0]), Source.NAMED)
    assert taus(engine, 4) == [[0.0, 0.0]] * 2 + [[1.0, 0.5], [7.0, 9.0]]


def test_a_delay_acts_on_targets_and_not_on_the_torques_of_a_servo() -> None:
    late, prompt = made(delay_commands=0.004, **SERVO), made(**SERVO)
    target = joint_state(NAMES, [0.1, -0.1])
    send(late, target, Source.NAMED)
    taus(late, 4)
    send(prompt, target, Source.NAMED)
    assert taus(late, 100) == taus(prompt, 100)


def test_a_reset_and_a_jump_discard_delayed_commands() -> None:
    for source, data in (
        (Source.REQUEST, RESET),
        (Source.SET_STATE, joint_state(NAMES, [0.3, 0.3])),
    ):
        engine = made(delay_commands=0.003, command_timeout=0.004)
        send(engine, efforts(1.0, 0.5))
        taus(engine, 2)
        send(engine, data, source)
        assert not any(map(any, taus(engine, 30)))
        assert engine.state.link.timeouts == 0


def test_the_watchdog_counts_from_where_the_delay_ends() -> None:
    engine = made(delay_commands=0.003, command_timeout=0.002)
    send(engine, efforts(1.0, 0.5))
    assert taus(engine, 7) == [[0.0, 0.0]] * 3 + [[1.0, 0.5]] * 2 + [[0.0, 0.0]] * 2
    assert engine.state.link.timeouts == 1


def test_a_delay_is_a_whole_number_of_steps() -> None:
    with pytest.raises(ValueError, match=r'delay.commands is 0\.0015 s, which is 1\.5 steps'):
        Settings(delay_commands=0.0015)


def test_a_share_of_the_commands_is_lost_by_the_seed() -> None:
    engine = made(drop_commands=0.25, seed=7)
    for k in range(1, 2001):
        assert send(engine, efforts(float(k % 9), 0.0), sequence=k) is Verdict.ACCEPTED
    assert engine.state.link.lost == sum(
        noise_uniform(7, NoiseChannel.COMMAND_DROP, k, 1)[0] < 0.25 for k in range(1, 2001)
    )
    # Four standard deviations of a binomial distribution.
    assert abs(engine.state.link.lost - 500) < 4 * np.sqrt(2000 * 0.25 * 0.75)


def test_a_lost_command_changes_nothing_and_answers_in_lockstep() -> None:
    engine = made(drop_commands=1.0, command_timeout=0.002, lockstep=True)
    send(engine, efforts(1.0, 0.5))
    assert not any(map(any, taus(engine, 1)))
    assert engine.waiting
    assert send(engine, efforts(1.0, 0.5)) is Verdict.ACCEPTED
    assert not engine.waiting
    assert (engine.state.link.lost, engine.state.link.timeouts) == (2, 0)


def test_a_recording_with_late_and_lost_commands_verifies(tmp_path: Path) -> None:
    commands = {k: [efforts(k % 5, -(k % 3))] for k in range(3, 300)}
    settings = {'delay_commands': 0.004, 'drop_commands': 0.3, 'seed': 3}
    states = verified(simulate(300, commands, **settings).save(tmp_path / 'a.mcap'))
    told = [state.effort[0] for state in states]
    lost = [noise_uniform(3, NoiseChannel.COMMAND_DROP, k, 1)[0] < 0.3 for k in range(1, 298)]
    wanted, last = [0.0] * 6, 0.0
    for k in range(3, 297):
        last = last if lost[k - 3] else float(k % 5)
        wanted.append(last)
    assert told == wanted


# 2000 N m/s are 2 N m in a cycle of a millisecond.
REFLEX: dict[str, Any] = {'reflex_effort_rate': 2000.0}


def test_a_jump_of_an_effort_closes_the_brakes_until_a_reset() -> None:
    engine = made(**REFLEX)
    # The first effort of a joint on its brake may be any.
    send(engine, efforts(9.0, 5.0))
    assert taus(engine, 2) == [[9.0, 5.0]] * 2
    send(engine, efforts(11.0, 3.0))
    assert taus(engine, 2) == [[11.0, 3.0]] * 2
    assert not engine.state.actuators.tripped
    send(engine, efforts(11.0, 5.001))
    assert taus(engine, 3) == [[0.0, 0.0]] * 3
    assert not engine.arm.qd.any()
    assert (engine.state.actuators.tripped, engine.state.actuators.trips) == (True, 1)
    assert engine.state.actuators.reflex == (
        "the effort of 'elbow' changed by 2.001 in one step, limit 2"
    )
    assert send(engine, efforts(1.0, 1.0)) is Verdict.REFUSED
    assert not any(map(any, taus(engine, 5)))
    send(engine, RESET, Source.REQUEST)
    engine.step()
    assert send(engine, efforts(1.0, 1.0)) is Verdict.ACCEPTED
    assert taus(engine, 2) == [[1.0, 1.0]] * 2
    assert engine.state.actuators.trips == 1


def test_a_reflex_sees_the_effort_of_a_servo() -> None:
    engine = made(**REFLEX, **SERVO)
    send(engine, joint_state(NAMES, [0.0, 0.0]), Source.NAMED)
    taus(engine, 5)
    send(engine, joint_state(NAMES, [0.004, 0.0]), Source.NAMED)
    taus(engine, 1)
    assert not engine.state.actuators.tripped
    send(engine, joint_state(NAMES, [0.1, 0.0]), Source.NAMED)
    taus(engine, 1)
    assert engine.state.actuators.tripped


def test_a_jump_of_any_size_causes_a_reflex() -> None:
    engine = made(**REFLEX)
    for effort in (1e308, -1e308):
        send(engine, efforts(effort, 0.0))
        taus(engine, 1)
    assert engine.state.actuators.tripped


def test_a_reflex_does_not_see_the_jump_of_the_watchdog() -> None:
    engine = made(**REFLEX, command_timeout=0.005, on_timeout='zero')
    send(engine, efforts(9.0, -5.0))
    assert taus(engine, 8) == [[9.0, -5.0]] * 5 + [[0.0, 0.0]] * 3
    assert (engine.state.link.timeouts, engine.state.actuators.tripped) == (1, False)


def test_in_lockstep_an_arm_that_a_reflex_braked_continues() -> None:
    engine = made(lockstep=True, **REFLEX)
    for effort in (1.0, 9.0):
        send(engine, efforts(effort, 0.0))
        engine.step()
    assert engine.waiting
    assert send(engine, efforts(1.0, 0.0)) is Verdict.REFUSED
    assert not engine.waiting


def test_a_recording_with_a_reflex_verifies_with_its_validation_rows(tmp_path: Path) -> None:
    commands: dict[int, list[Any]] = {
        3: [efforts(1.0, 1.0)],
        9: [efforts(9.0, 1.0)],
        20: [efforts(0.0, 0.0), (Source.REQUEST, RESET)],
        30: [efforts(5.0, 0.0)],
        40: [(Source.PARAMETERS, encode_changes({'reflex_effort_rate': 0.0}))],
        41: [efforts(0.0, 9.0)],
        50: [(Source.PARAMETERS, encode_changes(REFLEX))],
        60: [efforts(9.0, 0.0)],
        70: [efforts(1.0, 0.0), (Source.SET_STATE, joint_state(NAMES, [0.5, 0.5]))],
        80: [efforts(1.0, 0.0)],
    }
    path = simulate(100, commands, **REFLEX).save(tmp_path / 'a.mcap')
    states = verified(path)
    refused = [row.cycle for row in rows_of(path) if row.verdict is Verdict.REFUSED]
    assert refused == [20, 70]
    assert [states[k - 1].effort.tolist() for k in (8, 9, 35, 45, 60, 80)] == [
        [1.0, 1.0],
        [0.0, 0.0],
        [5.0, 0.0],
        [0.0, 9.0],
        [0.0, 0.0],
        [1.0, 0.0],
    ]


NUMBERS = (0.0, -0.0, 1.0, -3.0, 0.4, 50.0, 1e6, -1e300, NAN, float('inf'))


PAIR = st.lists(st.sampled_from(NUMBERS[:8]), min_size=2, max_size=2)
# Mostly small numbers and NaN.
NUMBER = st.sampled_from((*NUMBERS[:6] * 5, *NUMBERS, *[NAN] * 8))
CHANGES: dict[str, st.SearchStrategy[Any]] = {
    'servo_p': st.lists(st.sampled_from((0.0, 9.0, 1e9)), min_size=2, max_size=2),
    'servo_d': st.lists(st.sampled_from((0.0, 2.0, 1e9)), min_size=2, max_size=2),
    'command_timeout': st.sampled_from((0.0, 0.004)),
    'on_timeout': st.sampled_from(('brake', 'zero', 'hold')),
    'drop_commands': st.sampled_from((0.0, 0.5)),
    'reflex_effort_rate': st.sampled_from((0.0, 0.0, 1e4)),
    'effort_limits': st.just(True),
}
GIVEN = st.fixed_dictionaries(
    {
        'servo_p': st.sampled_from(((80.0, 0.0), (80.0, 40.0))),
        'servo_d': st.just((8.0, 4.0)),
        'delay_commands': st.sampled_from((0.0, 0.002)),
        'convention': st.sampled_from(('plain', 'franka')),
        'joints': st.sampled_from((NAMES, NAMES[::-1])),
    }
)


@st.composite
def named_commands(draw: st.DrawFn) -> tuple[Source, bytes]:
    names = draw(st.lists(st.sampled_from((*NAMES, 'nobody')), min_size=1, unique=True))
    whole = st.lists(NUMBER, min_size=len(names), max_size=len(names))
    return Source.NAMED, joint_state(names, *(draw(whole | st.just([])) for _ in range(3)))


ANYTHING = st.one_of(
    PAIR.map(lambda values: efforts(*values)),
    st.just(efforts(1.0, 2.0, 3.0)),
    named_commands(),
    named_commands(),
    st.just((Source.REQUEST, RESET)),
    PAIR.map(lambda values: (Source.SET_STATE, joint_state(NAMES, values))),
    st.sampled_from(sorted(CHANGES))
    .flatmap(lambda name: st.fixed_dictionaries({name: CHANGES[name]}))
    .map(lambda values: (Source.PARAMETERS, encode_changes(values))),
)


@pytest.fixture(scope='module')
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the recording that is written anew for each example."""
    return tmp_path_factory.mktemp('any')


# An example is a whole run, and its recording.
@settings(max_examples=settings().max_examples // 2)
@given(
    st.dictionaries(st.integers(2, 80), st.lists(ANYTHING, min_size=1, max_size=2), min_size=5),
    GIVEN,
)
def test_any_messages_leave_a_finite_arm_and_a_recording_that_verifies(
    written: Path, commands: dict[int, list[Any]], chosen: dict[str, Any]
) -> None:
    states = verified(simulate(100, commands, **chosen).save(written / 'a.mcap'))
    assert len(states) == 100
    # In the published order: 20 N m for the shoulder, 10 for the elbow.
    limits = [{'shoulder': 20.0, 'elbow': 10.0}[name] for name in chosen['joints']]
    for state in states:
        assert np.isfinite([state.position, state.velocity]).all()
        assert (np.abs(state.effort) <= limits).all()


@pytest.mark.parametrize(
    ('action', 'end'),
    [('brake', 'brakes on'), ('zero', 'zero efforts'), ('hold', 'servos hold the position')],
)
def test_the_log_line_of_the_watchdog_states_its_action(action: str, end: str) -> None:
    gains = (1.0,) * 6 if action == 'hold' else ()
    settings = Settings(command_timeout=0.5, on_timeout=action, servo_p=gains)
    line = timeout_text(settings)
    assert line.startswith(f'no command for 0.5 s (command_timeout): {end}; a topic-based')
