# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles: every arm has the bits of a single simulator, with any feedback."""

from __future__ import annotations

from collections.abc import Callable
import itertools
from itertools import product
from typing import Any

import bridge
import numpy as np
import pytest
from sampling import one_fast
from zoo import random_chain, random_state, slider

import pfd_core as pfd

STEPS = 7
# A law sampled every millisecond against its own steady state after twenty time constants.
SETTLED = 1e-8
# Roundings of 2000 sums.
SUMMED = 1e-12


def sequences(n: int, size: int, dtype: str = 'float64') -> tuple[np.ndarray, ...]:
    """Return positions and velocities, (size, n), and torques, (size, STEPS, n)."""
    rng = np.random.default_rng(81)
    rows = [random_state(rng, n) for _ in range(size)]
    q, qd = (np.array([row[k] for row in rows], dtype) for k in range(2))
    return q, qd, rng.uniform(-5, 5, (size, STEPS, n)).astype(dtype)


def assert_same(runs: pfd.Trajectory, b: int, alone: pfd.Trajectory) -> None:
    for name in ('q', 'qd', 'qdd'):
        np.testing.assert_array_equal(getattr(runs, name)[b], getattr(alone, name))
    np.testing.assert_array_equal(runs.time, alone.time)


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
@pytest.mark.parametrize('integrator', pfd.INTEGRATORS)
@pytest.mark.parametrize('size', one_fast([1, 19], 19))
def test_every_arm_moves_as_it_would_alone(size: int, integrator: str, dtype: str) -> None:
    robot = pfd.load_robot('planar2')
    options = {'integrator': integrator, 'dtype': dtype, 'substeps': 3}
    options['scene'] = pfd.Scene(damping=[20.0, 10.0])
    many, one = pfd.Ensemble(robot, size, **options), pfd.Simulator(robot, **options)
    q, qd, taus = sequences(2, size, dtype)
    many.reset(q, qd, time=1.5)
    runs = many.rollout(taus)
    assert runs.status == 'ok'
    np.testing.assert_array_equal(runs.finite_steps, STEPS)
    for b in range(size):
        one.reset(q[b], qd[b], time=1.5)
        assert_same(runs, b, one.rollout(taus[b]))
    for name in ('q', 'qd', 'qdd'):
        np.testing.assert_array_equal(getattr(many, name), getattr(runs, name)[:, -1])
    assert many.time == one.time


def test_wrench_brakes_and_sliding_joints_act_on_each_arm_separately() -> None:
    rng = np.random.default_rng(82)
    robot = random_chain(rng, 4, joint_types=['revolute', 'prismatic', 'continuous', 'revolute'])
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    many, one = pfd.Ensemble(robot, 11, scene), pfd.Simulator(robot, scene)
    q, qd, taus = sequences(4, 11)
    wrench, brakes = rng.normal(size=(11, 6)), rng.random((11, 4)) < 0.4
    many.reset(q, qd)
    runs = many.rollout(taus, wrench=wrench, brakes=brakes)
    for b in range(11):
        one.reset(q[b], qd[b])
        assert_same(runs, b, one.rollout(taus[b], wrench[b], brakes=brakes[b]))
    # Inputs that all arms share are broadcast.
    many.reset(q[3], qd[3])
    runs = many.rollout(taus[3], wrench=wrench[3], brakes=brakes[3])
    one.reset(q[3], qd[3])
    alone = one.rollout(taus[3], wrench[3], brakes=brakes[3])
    for b in range(11):
        assert_same(runs, b, alone)


def test_a_second_rollout_continues_where_the_first_ended() -> None:
    robot = pfd.load_robot('planar2')
    q, qd, taus = sequences(2, 9)
    many = pfd.Ensemble(robot, 9)
    many.reset(q, qd)
    whole = many.rollout(taus)
    many.reset(q, qd)
    parts = [many.rollout(taus[:, :3]), many.rollout(taus[:, 3:])]
    for name in ('q', 'qd', 'qdd'):
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_the_feedback_law_equals_a_loop_in_python() -> None:
    rng = np.random.default_rng(83)
    robot = random_chain(rng, 3)
    q, qd, taus = sequences(3, 10)
    kp, kd = rng.uniform(1, 10, (10, 3)), rng.uniform(0, 1, 3)
    wanted, rate = rng.uniform(-1, 1, (10, STEPS, 3)), rng.uniform(-1, 1, (STEPS, 3))
    many, one = pfd.Ensemble(robot, 10), pfd.Simulator(robot)
    many.reset(q, qd)
    runs = many.rollout(taus, feedback=pfd.Feedback(kp, kd, wanted, rate))
    assert runs.status == 'ok'
    for b in range(10):
        one.reset(q[b], qd[b])
        for t in range(STEPS):
            pull = kp[b] * (wanted[b, t] - one.q)
            one.step(taus[b, t] + pull + kd * (rate[t] - one.qd))
            np.testing.assert_array_equal(runs.q[b, t], one.q)
            np.testing.assert_array_equal(runs.qdd[b, t], one.qdd)


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
@pytest.mark.parametrize('shape', ['one', 'per step', 'per arm and step', 'reversed', 'scalar'])
def test_a_matrix_of_gains_acts_on_the_whole_state(shape: str, dtype: str) -> None:
    rng = np.random.default_rng(84)
    robot = random_chain(rng, 3)
    q, qd, taus = sequences(3, 21, dtype)
    gains = {
        'one': rng.uniform(-5, 5, (3, 6)),
        'per step': rng.uniform(-5, 5, (STEPS, 3, 6)),
        'per arm and step': rng.uniform(-5, 5, (21, STEPS, 3, 6)),
        'reversed': rng.uniform(-5, 5, (6, 3)).T[:, ::-1],
        'scalar': np.array(0.5),
    }
    gain = gains[shape].astype(dtype)
    wanted, rate = rng.uniform(-1, 1, (2, 21, STEPS, 3)).astype(dtype)
    many, one = pfd.Ensemble(robot, 21, dtype=dtype), pfd.Simulator(robot, dtype=dtype)
    many.reset(q, qd)
    runs = many.rollout(taus, feedback=pfd.StateFeedback(gain, wanted, rate))
    assert runs.status == 'ok'
    every = np.broadcast_to(gain, (21, STEPS, 3, 6))
    for b in range(21):
        one.reset(q[b], qd[b])
        for t in range(STEPS):
            tau = taus[b, t].copy()
            for j, e in enumerate([*(wanted[b, t] - one.q), *(rate[b, t] - one.qd)]):
                tau += every[b, t, :, j] * e
            one.step(tau)
            np.testing.assert_array_equal(runs.q[b, t], one.q)


@pytest.mark.parametrize(
    'scene',
    [
        pfd.Scene(),
        pfd.Scene(
            friction=[0.3, 0.2],
            joint_limits=[[-1, 1], [-1, 1]],
            motor_lag=[0.02, 0.0],
            external_wrench=True,
            brakes=True,
        ),
    ],
    ids=['smooth', 'rough'],
)
def test_one_arm_alone_moves_by_the_bits_of_an_arm_among_others(scene: pfd.Scene) -> None:
    rng = np.random.default_rng(86)
    robot = pfd.load_robot('planar2')
    q, qd, taus = sequences(2, 3)
    given = {'wrench': rng.uniform(-1, 1, 6)} if scene.external_wrench else {}
    given |= {'brakes': [True, False]} if scene.brakes else {}
    q = np.clip(q, -0.9, 0.9)
    alone, many = pfd.Ensemble(robot, 1, scene), pfd.Ensemble(robot, 3, scene)
    for law in (
        None,
        pfd.StateFeedback(rng.uniform(-1, 1, (2, 4)), 0.2, 0.1),
    ):
        alone.reset(q[1:2], qd[1:2])
        many.reset(q, qd)
        one = alone.rollout(taus[1:2], feedback=law, **given)
        all_three = many.rollout(taus, feedback=law, **given)
        for name in ('q', 'qd', 'qdd'):
            np.testing.assert_array_equal(getattr(one, name)[0], getattr(all_three, name)[1])


def test_a_law_of_a_subclass_acts_as_the_law_that_it_derives_from() -> None:
    class Stiff(pfd.Feedback):
        pass

    robot = pfd.load_robot('planar2')
    found = []
    for law in (pfd.Feedback, Stiff):
        many = pfd.Ensemble(robot, 3)
        found.append(many.rollout(steps=20, feedback=law(5.0, 1.0, 0.2)).q)
    np.testing.assert_array_equal(*found)
    assert np.ptp(found[0][0, :, 0]) > 0


def test_a_slide_of_unit_mass_whose_program_has_no_operations_is_simulated() -> None:
    robot = slider(1, 0)
    scene = pfd.Scene(gravity=None)
    assert not sum(pfd.compile_kernel(robot, scene=scene).operations['compiled'].values())
    taus = np.full((1000, 1), 3.0)
    one = pfd.Simulator(robot, scene).rollout(taus)
    many = pfd.Ensemble(robot, 4, scene).rollout(taus)
    wanted = 1.5 * one.time[:, np.newaxis] ** 2
    np.testing.assert_allclose(one.q, wanted, rtol=SUMMED, atol=0)
    for b in range(4):
        assert_same(many, b, one)


def test_a_lifted_mass_comes_to_rest_where_the_law_carries_its_weight() -> None:
    robot = slider(0, 1, mass=2.0)
    # Critically damped: the slowest time constant is 2 m/kd = 0.05 s; twenty of them.
    kp, kd = np.array([[800.0], [3200.0]]), np.array([[80.0], [160.0]])
    many = pfd.Ensemble(robot, 2)
    runs = many.rollout(steps=2000, feedback=pfd.Feedback(kp, kd, [0.3]), every=2000)
    np.testing.assert_allclose(runs.q[:, 0], 0.3 - 2.0 * 9.81 / kp, rtol=0, atol=SETTLED)
    np.testing.assert_allclose(runs.qdd[:, 0], 0.0, rtol=0, atol=SETTLED)


def test_the_bits_do_not_depend_on_the_threads() -> None:
    # So many arms that their work is shared among threads.
    q, qd, taus = sequences(2, 5000)
    many = pfd.Ensemble(pfd.load_robot('planar2'), 5000)
    many.reset(q, qd)
    wanted = many.rollout(taus)
    for count in (0, 1, 2, 5):
        many.reset(q, qd)
        runs = many.rollout(taus, threads=count)
        for name in ('q', 'qd', 'qdd', 'finite_steps'):
            np.testing.assert_array_equal(getattr(runs, name), getattr(wanted, name))


def test_only_each_requested_state_is_returned() -> None:
    q, qd, taus = sequences(2, 10)
    many = pfd.Ensemble(pfd.load_robot('planar2'), 10)
    many.reset(q, qd)
    whole = many.rollout(taus)
    for every in (2, 3, 7, 8):
        many.reset(q, qd)
        runs = many.rollout(taus, every=every)
        rows = slice(every - 1, None, every)
        np.testing.assert_array_equal(runs.q, whole.q[:, rows])
        np.testing.assert_array_equal(runs.qdd, whole.qdd[:, rows])
        np.testing.assert_allclose(runs.time, whole.time[rows], rtol=1e-15)
        np.testing.assert_array_equal(many.q, whole.q[:, -1])


def test_an_arm_that_overflows_is_reported_and_does_not_affect_the_others() -> None:
    q, qd, taus = sequences(2, 10)
    many = pfd.Ensemble(pfd.load_robot('planar2'), 10)
    many.reset(q, qd)
    whole = many.rollout(taus)
    taus[6, 3] = 1e308
    many.reset(q, qd)
    runs = many.rollout(taus)
    assert runs.status == many.status == 'not_finite'
    assert runs.finite_steps.tolist() == [STEPS] * 6 + [3] + [STEPS] * 3
    others = np.arange(10) != 6
    np.testing.assert_array_equal(runs.q[others], whole.q[others])
    many.reset()
    assert many.status == 'ok'


def test_no_steps_give_no_states() -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 3)
    for runs in (many.rollout(steps=0), many.rollout(np.zeros((0, 2)))):
        assert runs.q.shape == (3, 0, 2)
        assert runs.status == 'ok'
    assert many.time == 0.0


ZEROS = np.zeros((5, 2))


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({}, 'steps is required without taus of several steps'),
        ({'steps': -1}, 'steps must be an integer of at least 0, got -1'),
        ({'taus': ZEROS, 'steps': 4}, 'taus has 5 steps, but steps=4'),
        ({'taus': np.zeros(2)}, r'taus must have shape \(steps, 2\) or \(3, steps, 2\), got \(2,'),
        ({'taus': np.zeros((4, 5, 2))}, r'taus must have shape \(3, 5, 2\) or .* got \(4, 5, 2\)'),
        ({'taus': ZEROS * np.nan}, 'taus must be finite'),
        ({'taus': ZEROS, 'every': 0}, 'every must be an integer of at least 1, got 0'),
        ({'taus': ZEROS, 'threads': -2}, 'threads must be an integer of at least 0'),
        (
            {'taus': ZEROS, 'feedback': (1, 2)},
            'feedback must be a Feedback or a StateFeedback, got tuple',
        ),
        (
            {'taus': ZEROS, 'feedback': pfd.Feedback(np.zeros(3), 0.0, 0.0)},
            r'feedback.kp must have shape \(3, 2\) or \(2,\), got \(3,\)',
        ),
        (
            {'taus': ZEROS, 'feedback': pfd.StateFeedback(np.zeros((2, 2)), 0.0)},
            r'feedback.gain must have shape .* or \(2, 4\) or \(4,\), got \(2, 2\)',
        ),
        (
            {'taus': ZEROS, 'feedback': pfd.StateFeedback(np.nan, 0.0)},
            'feedback.gain must be finite',
        ),
        (
            {'taus': ZEROS, 'wrench': np.zeros(6)},
            'wrench was given, but the scene has external_wrench=False',
        ),
        ({'taus': ZEROS, 'brakes': [True, False]}, 'brakes were given, but the scene has none'),
        ({'steps': 2**64 + 2}, 'steps must be an integer from 0 to 1000000000000, got 1844674407'),
        ({'steps': 10**12}, '3 arms at 1000000000000 times take 144000 GB, but this machine has'),
        ({'steps': 1, 'every': 2**64}, 'every must be an integer from 1 to 9223372036854775807'),
        ({'taus': [['a', 'b']]}, 'taus must be an array of numbers'),
    ],
)
def test_bad_arguments_are_named(options, message: str) -> None:  # type: ignore[no-untyped-def]
    many = pfd.Ensemble(pfd.load_robot('planar2'), 3)
    with pytest.raises(ValueError, match=message):
        many.rollout(**options)


@pytest.mark.parametrize(
    ('size', 'message'),
    [
        (0, 'size must be an integer of at least 1, got 0'),
        (2**40, 'size=1099511627776 arms take 140737 GB, but this machine has'),
    ],
)
def test_a_wrong_number_of_arms_is_named(size: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.Ensemble(pfd.load_robot('planar2'), size)


def test_a_state_that_does_not_fit_is_refused() -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 3)
    with pytest.raises(ValueError, match=r'q must have shape \(3, 2\) or \(2,\)'):
        many.reset(np.zeros((2, 2)))
    with pytest.raises(ValueError, match='qd must be finite'):
        many.reset(None, [np.inf, 0.0])


def pieces_of(size: int) -> Callable[[int, int], Any]:
    """Return a function that cuts a rollout into pieces of so many steps."""
    return lambda steps, _: ((k, min(k + size, steps)) for k in range(0, steps, size))


def test_pieces_cover_a_rollout_and_grow_no_faster_than_twofold() -> None:
    for steps, first in product((0, 1, 2, 7, 100), (0, 1, 3, 1000)):
        pieces = list(bridge.rollout_pieces(steps, first))
        ends = [0, *(until for _, until in pieces)]
        assert [begin for begin, _ in pieces] == ends[:-1]
        assert ends[-1] == steps
        counts = [until - begin for begin, until in pieces]
        assert all(1 <= two <= 2 * one for one, two in itertools.pairwise(counts))
        assert not counts or counts[0] <= max(first, 1)


@pytest.mark.parametrize('every', one_fast([1, 3, 5, 7, 8], 3))
@pytest.mark.parametrize('integrator', pfd.INTEGRATORS)
def test_the_bits_do_not_depend_on_the_pieces(
    integrator: str, every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 19, integrator=integrator)
    q, qd, taus = sequences(2, 19)
    taus[6, 4] = 1e308
    law = pfd.StateFeedback(np.ones((2, 4)), taus / 10)
    found = []
    for size in (len(taus[0]), 1, 2, 3, 4, 7):
        monkeypatch.setattr(*bridge.target('rollout_pieces'), pieces_of(size))
        many.reset(q, qd)
        runs = many.rollout(taus, feedback=law, every=every)
        found.append([runs.time, runs.q, runs.qd, runs.qdd, runs.finite_steps, many.q, many.qdd])
        assert runs.finite_steps.tolist() == [STEPS] * 6 + [4] + [STEPS] * 12
    whole, *others = found
    for other in others:
        for one, two in zip(whole, other, strict=True):
            np.testing.assert_array_equal(two, one)


def test_an_interrupted_rollout_leaves_time_and_states_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 40)
    _, _, taus = sequences(2, 40)
    whole = many.rollout(taus)
    run = bridge.run_blocks
    monkeypatch.setattr(*bridge.target('rollout_pieces'), pieces_of(2))
    # Blocks of one vector.
    monkeypatch.setattr(*bridge.target('MAX_BLOCK_WORK'), 1)
    runs, done = itertools.count(), []

    def interrupted(work: Callable[[int, int], int], *arguments: Any) -> int:
        # In the second piece, after its first block.
        if next(runs) != 1:
            return run(work, *arguments)

        def work_or_stop(first: int, size: int) -> int:
            if done:
                raise KeyboardInterrupt
            done.append(first)
            return work(first, size)

        return run(work_or_stop, *arguments)

    monkeypatch.setattr(*bridge.target('rollout_run_blocks'), interrupted)
    many.reset()
    with pytest.raises(KeyboardInterrupt):
        many.rollout(taus)
    assert done
    assert many.time == whole.time[1]
    np.testing.assert_array_equal(many.q, whole.q[:, 1])
    np.testing.assert_array_equal(many.qd, whole.qd[:, 1])
    np.testing.assert_array_equal(many.rollout(taus[:, 2:]).q, whole.q[:, 2:])
