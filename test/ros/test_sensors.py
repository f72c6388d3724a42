# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors: from the true state to joint_states, in the engine and in recordings, without ROS."""

from __future__ import annotations

import functools
from pathlib import Path

from bridge import (
    DROPPED_STATES,
    STATES_OUTPUT,
    ArmOutput,
    Arrival,
    DifferenceError,
    Engine,
    JointMessage,
    JointStateEncoder,
    Request,
    Settings,
    Source,
    decode_joint_state,
    encode_request,
    quantized_values,
    read_motion,
    read_recording,
)
import numpy as np
import plant_messages
from plant_messages import UNLIMITED, change, efforts
import pytest
from rewriting import STATES as STATES_TOPIC
from rewriting import Recording
from simulating import simulate

PUSH = Arrival(Source.ARRAY, 1, efforts(1.0, -0.5))
RESET = Arrival(Source.REQUEST, 1, encode_request(Request('reset')))
DROPPED_TOPIC = '/sim_arm/dropped_states'
ALL = {
    'noise_position': 1e-4,
    'noise_velocity': 1e-2,
    'noise_effort': 0.1,
    'bias_position': (0.01, -0.02),
    'quantization_position': 1e-3,
    'delay_state': 0.003,
    'drop_state': 0.25,
    'seed': 5,
}


made = functools.partial(plant_messages.made, initial_positions=(0.3, -0.2))


def outputs(engine: Engine, cycles: int, *events: Arrival) -> list[ArmOutput]:
    engine.take(events)
    return [output for _ in range(cycles) for output in engine.step()]


def states(engine: Engine, cycles: int, *events: Arrival) -> list[JointMessage]:
    found = outputs(engine, cycles, *events)
    return [decode_joint_state(output.data) for output in found if output.role == STATES_OUTPUT]


def table(messages: list[JointMessage], kind: str) -> np.ndarray:
    return np.array([getattr(message, kind) for message in messages])


def test_without_settings_for_them_there_are_no_sensors() -> None:
    engine = made()
    assert engine.sensors is None
    measured = engine.measured()
    assert measured[0] is engine.arm.q
    assert measured[1] is engine.arm.qd
    assert measured[2] is engine.arm.tau


@pytest.mark.parametrize('kind', ['position', 'velocity', 'effort'])
def test_noise_has_its_standard_deviation_and_leaves_the_true_motion_alone(kind: str) -> None:
    exact, noisy = made(), made(**{f'noise_{kind}': 0.5})
    true, measured = states(exact, 2000, PUSH), states(noisy, 2000, PUSH)
    assert exact.arm.q.tolist() == noisy.arm.q.tolist()
    errors = table(measured, kind) - table(true, kind)
    # Not in every worker that collects this file: it takes 0.7 s.
    from scipy.stats import kstest

    # A fixed seed: no game of chance.
    assert kstest(errors.ravel() / 0.5, 'norm').pvalue > 1e-3
    for other in {'position', 'velocity', 'effort'} - {kind}:
        assert (table(measured, other) == table(true, other)).all()


def test_another_seed_is_other_noise_and_the_same_seed_the_same() -> None:
    runs = [table(states(made(noise_position=1.0, seed=s), 50), 'position') for s in (1, 1, 2)]
    assert (runs[0] == runs[1]).all()
    assert not (runs[0] == runs[2]).any()


@pytest.mark.parametrize('kind', ['position', 'velocity', 'effort'])
def test_a_bias_is_added_in_the_order_in_which_joints_are_published(kind: str) -> None:
    order = {'joints': ('elbow', 'shoulder'), 'initial_positions': (-0.2, 0.3)}
    true = states(made(**order), 3, PUSH)
    biased = states(made(**order, **{f'bias_{kind}': (0.25, 0.0)}), 3, PUSH)
    assert biased[0].names == ('elbow', 'shoulder')
    assert (table(biased, kind) == table(true, kind) + np.array([0.25, 0.0])).all()


def test_a_bias_needs_a_number_for_each_joint() -> None:
    with pytest.raises(ValueError, match=r'bias\.effort holds 1 numbers, expected 2'):
        made(bias_effort=(1.0,))


def test_measured_numbers_are_the_nearest_steps_of_the_encoder() -> None:
    step = 2 * np.pi / 4096
    true, measured = states(made(), 50, PUSH), states(made(quantization_position=step), 50, PUSH)
    counts = table(measured, 'position') / step
    assert np.allclose(counts, np.rint(counts), rtol=0, atol=1e-9)
    error = np.abs(table(measured, 'position') - table(true, 'position'))
    assert 0 < error.max() <= step / 2 * (1 + 1e-12)


def test_quantizing_is_finite_and_keeps_numbers_that_are_coarser_than_the_step() -> None:
    value = np.array([1e300, -1e300, 1.7e308, 0.26, -0.26, 0.0])
    assert quantized_values(value, 1e-9)[:3].tolist() == value[:3].tolist()
    assert quantized_values(value, 0.5)[3:].tolist() == [0.5, -0.5, 0.0]


def test_a_delayed_state_is_the_one_of_earlier_under_the_stamp_of_now() -> None:
    true, late = states(made(), 20, PUSH), states(made(delay_state=0.003), 20, PUSH)
    assert [m.stamp_ns for m in late] == [m.stamp_ns for m in true]
    for kind in ('position', 'velocity', 'effort'):
        assert (table(late, kind)[3:] == table(true, kind)[:-3]).all()
    assert late[0].position.tolist() == [0.3, -0.2]
    assert not late[2].effort.any()


def test_a_delay_counts_steps_whatever_is_published() -> None:
    true = states(made(), 20, PUSH)
    late = states(made(delay_state=0.003, publish_rate=200.0), 20, PUSH)
    assert table(late, 'position').tolist() == table(true, 'position')[1:18:5].tolist()


def test_a_reset_shows_in_the_measured_state_at_once() -> None:
    engine = made(delay_state=0.005)
    moving = states(engine, 30, PUSH)
    assert moving[-1].velocity.all()
    after = states(engine, 8, RESET)
    assert table(after, 'position').tolist() == [[0.3, -0.2]] * 8


def test_an_episode_after_a_reset_is_that_after_the_start_noise_and_losses_included() -> None:
    engine = made(**{**ALL, 'delay_state': 0.0}, drop_commands=0.5)

    def episode() -> list[tuple[str, list[float], list[float]]]:
        found = []
        for k in range(300):
            for role, _, data in outputs(
                engine, 1, Arrival(Source.ARRAY, 1, efforts(0.01 * k, 0))
            ):
                if role in (STATES_OUTPUT, DROPPED_STATES):
                    state = decode_joint_state(data)
                    found.append((role, state.position.tolist(), state.velocity.tolist()))
        return found

    first, lost = episode(), engine.state.link.lost
    assert 100 < lost < 200
    outputs(engine, 1, RESET)
    assert episode() == first
    assert engine.state.link.lost == 2 * lost
    # A jump is no reset: its noise continues.
    place = np.array([0.3, -0.2])
    jump = JointStateEncoder(engine.arm.names).encode(0, place, 0 * place, 0 * place)
    outputs(engine, 1, Arrival(Source.SET_STATE, 1, jump))
    assert episode() != first


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'delay_state': 0.0015}, r'delay.state is 0.0015 s, which is 1.5 steps'),
        ({'delay_state': 1.001}, 'delay.state is 1.001, expected 0.0 to 1.0'),
        ({'drop_state': 1.0}, 'drop.state is 1.0, expected 0.0 to 0.99'),
        ({'noise_effort': -1.0}, 'noise.effort is -1.0'),
        ({'bias_position': (float('nan'), 0.0)}, 'bias.position holds nan'),
        ({'seed': -1}, 'seed is -1'),
        ({'seed': 1 << 63}, 'seed is 9223372036854775808'),
    ],
)
def test_settings_of_sensors_that_make_no_sense_are_refused(wrong: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Settings(**wrong)


def test_dropped_states_keep_their_numbers_and_have_a_separate_role() -> None:
    found = [o for o in outputs(made(drop_state=0.25), 4000) if o.role != 'clock']
    assert [output.number for output in found] == list(range(1, 4001))
    dropped = sum(output.role == DROPPED_STATES for output in found)
    assert abs(dropped - 1000) < 4 * np.sqrt(4000 * 0.25 * 0.75)


def test_lockstep_does_not_wait_for_an_answer_to_a_dropped_state() -> None:
    engine = made(drop_state=0.5, lockstep=True)
    engine.take([PUSH])
    waits = []
    for _ in range(100):
        engine.take([PUSH])
        roles = {output.role for output in engine.step()}
        waits.append((STATES_OUTPUT in roles, engine.waiting))
    assert set(waits) == {(True, True), (False, False)}


def test_a_state_that_is_sent_again_is_the_same_message() -> None:
    engine = made(**{**ALL, 'drop_state': 0.0})
    (published,) = (o.data for o in outputs(engine, 1, PUSH) if o.role == STATES_OUTPUT)
    assert engine.present()[0].data == published


def test_other_noise_while_the_arm_runs_keeps_the_states_under_way() -> None:
    engine, steady = made(**ALL), made(**{**ALL, 'noise_velocity': 0.0})
    states(engine, 30, PUSH)
    states(steady, 30, PUSH)
    source, data = change(noise_velocity=0.0)
    engine.take([Arrival(source, 2, data)])
    for one, other in zip(engine.measured(), steady.measured(), strict=True):
        assert one.tolist() == other.tolist()


# In recordings.


def recorded(steps: int = 200, **chosen) -> Recording:
    return simulate(steps, {5: [efforts(1.0, -0.5)]}, **{**ALL, **chosen})


@pytest.mark.parametrize('closed', [True, False], ids=['closed', 'cut-off'])
def test_a_recording_with_every_error_of_the_sensors_verifies(
    tmp_path: Path, closed: bool
) -> None:
    made = recorded(publish_rate=500.0)
    summary = read_recording(made.save(tmp_path / 'log.mcap', closed=closed), verify=True)
    assert summary.unpublished == len(made.on(DROPPED_TOPIC)) > 0
    assert summary.states == len(made.on(STATES_TOPIC))
    assert summary.states + summary.unpublished == 100
    assert summary.steps == 200
    assert not summary.lost


def test_a_dropped_state_among_the_published_ones_is_a_difference(tmp_path: Path) -> None:
    made = recorded()
    dropped = made.on(DROPPED_TOPIC)[3]
    dropped.topic = STATES_TOPIC
    made.recount()
    text = f'recorded joint_states {dropped.sequence}, replayed dropped_states and clock'
    with pytest.raises(DifferenceError, match=text):
        read_recording(made.save(tmp_path / 'log.mcap'), verify=True)


def test_a_failed_arm_with_sensors_verifies_through_its_gap(tmp_path: Path) -> None:
    made = simulate(60, {5: [efforts(1e300, 0.0)]}, **{**ALL, 'drop_state': 0.0, **UNLIMITED})
    assert read_recording(made.save(tmp_path / 'log.mcap'), verify=True).stopped_at is not None
    gone = {message.sequence for message in made.on(STATES_TOPIC)[20:40]}
    made.keep(lambda m: m.topic not in (STATES_TOPIC, '/clock') or m.sequence not in gone)
    cut = read_recording(made.save(tmp_path / 'cut.mcap', closed=False), verify=True)
    assert cut.lost['joint_states'] == 20


def test_the_motion_of_a_recording_has_the_true_states(tmp_path: Path) -> None:
    motions = []
    for name, sensors in (('exact', {}), ('measured', {**ALL, 'drop_state': 0.0})):
        made = simulate(50, {1: [efforts(1.0, -0.5)]}, **sensors)
        motions.append(read_motion(made.save(tmp_path / f'{name}.mcap')).motion)
    assert motions[0].q.tolist() == motions[1].q.tolist()
    assert motions[0].qd.tolist() == motions[1].qd.tolist()
