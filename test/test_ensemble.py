# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of arms that move as alone, with feedback and own parameters; cycles of motors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from zoo import one_fast, random_chain, random_state, without_mass

import pfd_core as pfd

STEPS = 7


def sequences(
    n: int, size: int, dtype: str = 'float64', steps: int = STEPS
) -> tuple[np.ndarray, ...]:
    """Return positions and velocities, (size, n), and torques, (size, steps, n)."""
    rng = np.random.default_rng(81)
    rows = [random_state(rng, n) for _ in range(size)]
    q, qd = (np.array([row[k] for row in rows], dtype) for k in range(2))
    return q, qd, rng.uniform(-5, 5, (size, steps, n)).astype(dtype)


def assert_same(runs: pfd.Trajectory, b: int, alone: pfd.Trajectory) -> None:
    for name in ('q', 'qd', 'qdd'):
        np.testing.assert_array_equal(getattr(runs, name)[b], getattr(alone, name))
    np.testing.assert_array_equal(runs.time, alone.time)


SCENES = {
    'smooth': pfd.Scene(damping=[20.0, 10.0], external_wrench=True, brakes=True),
    'events': pfd.Scene(
        friction=[1.0, 0.5],
        static_friction=[4.0, 4.0],
        stribeck_velocity=[0.1, 0.1],
        load_friction=[0.05, 0.1],
        joint_limits=[[-1.0, 1.0]] * 2,
        restitution=0.5,
        damping=[0.05, 0.05],
        armature=[0.1, 0.1],
        motor_lag=[0.01, 0.0],
        external_wrench=True,
        brakes=True,
    ),
}


@pytest.mark.usefixtures('small_blocks')
@pytest.mark.sweep
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('integrator', pfd.INTEGRATORS)
@pytest.mark.parametrize('size', [1, 19])
@pytest.mark.parametrize('scene', SCENES)
def test_every_arm_moves_by_the_bits_of_one_alone_in_a_rollout_or_step_by_step(
    scene: str, size: int, integrator: str, dtype: str
) -> None:
    robot, steps = pfd.load_robot('planar2'), 60
    options: dict[str, Any] = {'integrator': integrator, 'dtype': dtype, 'substeps': 3}
    options |= {'scene': SCENES[scene], 'step_size': 4e-3}
    many, one = pfd.Ensemble(robot, size, **options), pfd.Simulator(robot, **options)
    q, qd, taus = sequences(2, size, dtype, steps)
    q = q / 4  # within the stops
    rng = np.random.default_rng(82)
    wrench, brakes = rng.normal(size=(size, 6)).astype(dtype), rng.random((size, 2)) < 0.4
    many.reset(q, qd, time=1.5)
    runs = many.rollout(taus, wrench=wrench, brakes=brakes, threads=3)
    assert runs.status == 'ok'
    np.testing.assert_array_equal(runs.finite_steps, steps)
    moving = ~brakes & (runs.qd == 0).any(axis=1)
    assert moving.any() == (scene == 'events' and size > 1)
    for b in range(size):
        one.reset(q[b], qd[b], time=1.5)
        alone = one.rollout(taus[b], wrench[b], brakes=brakes[b])
        assert_same(runs, b, alone)
    for name in ('q', 'qd', 'qdd'):
        np.testing.assert_array_equal(getattr(many, name), getattr(runs, name)[:, -1])
    # Time is no sum, which would drift.
    assert many.time == one.time == 1.5 + steps * one.step_size
    one.reset(q[-1], qd[-1], time=1.5)
    for k, tau in enumerate(taus[-1]):
        one.step(tau, wrench[-1], brakes=brakes[-1])
        for name in ('q', 'qd', 'qdd', 'time'):
            np.testing.assert_array_equal(getattr(one, name), getattr(alone, name)[k])
    # Inputs that all arms share are broadcast.
    many.reset(q[-1], qd[-1], time=1.5)
    runs = many.rollout(taus[-1], wrench=wrench[-1], brakes=brakes[-1])
    for b in range(size):
        assert_same(runs, b, alone)
    one.reset(q[0], time=2.0)
    assert (one.q.tolist(), one.qd.any(), one.time) == (q[0].tolist(), False, 2.0)


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
@pytest.mark.parametrize(
    'shape', ['per joint', 'one', 'per step', 'per arm and step', 'reversed', 'scalar']
)
def test_a_law_of_feedback_equals_a_loop_in_python(shape: str, dtype: str) -> None:
    rng = np.random.default_rng(84)
    robot = random_chain(rng, 3)
    q, qd, taus = sequences(3, 21, dtype)
    kp, kd = rng.uniform(1, 10, (21, 3)).astype(dtype), rng.uniform(0, 1, 3).astype(dtype)
    gains = {
        'per joint': np.array([[np.hstack([np.diag(row), np.diag(kd)])] for row in kp]),
        'one': rng.uniform(-5, 5, (3, 6)),
        'per step': rng.uniform(-5, 5, (STEPS, 3, 6)),
        'per arm and step': rng.uniform(-5, 5, (21, STEPS, 3, 6)),
        'reversed': rng.uniform(-5, 5, (6, 3)).T[:, ::-1],
        'scalar': np.array(0.5),
    }
    gain = gains[shape].astype(dtype)
    wanted, rate = rng.uniform(-1, 1, (2, 21, STEPS, 3)).astype(dtype)
    law: Any = pfd.StateFeedback(gain, wanted, rate)
    if shape == 'per joint':
        law = pfd.Feedback(kp, kd, wanted, rate)
    many, one = pfd.Ensemble(robot, 21, dtype=dtype), pfd.Simulator(robot, dtype=dtype)
    many.reset(q, qd)
    runs = many.rollout(taus, feedback=law)
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
            np.testing.assert_array_equal(runs.qdd[b, t], one.qdd)


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


MANY_STEPS = 60
# A register of arms and a tail, and an arm of the tail, which is in the register in reverse order.
SIZE, ONE = 11, 10
# Numbers that are known are folded with others before they are rounded, and a link's grouped
# numbers are sums in another order: a few roundings a step, amplified by the motion.
ROUNDING = 1e-12
Array = np.ndarray[Any, Any]


def drawn(low: float, high: float, *shape: int) -> Array:
    return np.random.default_rng(31).uniform(low, high, (SIZE, *shape))


def motion(n: int, size: int = SIZE) -> tuple[Array, Array, Array]:
    """Return positions and velocities, (size, n), and torques, (size, MANY_STEPS, n)."""
    rng = np.random.default_rng(32)
    return (
        rng.uniform(-0.3, 0.3, (size, n)),
        rng.uniform(-1, 1, (size, n)),
        rng.uniform(-4, 4, (size, MANY_STEPS, n)),
    )


def moved(simulation: Any, q: Array, qd: Array, taus: Array, **given: Any) -> Array:
    """Return q, qd and qdd of a rollout."""
    simulation.reset(q, qd)
    run = simulation.rollout(taus, **given)
    assert run.status == 'ok'
    return np.array([run.q, run.qd, run.qdd])


SCENE_NUMBERS = {
    'damping': drawn(0.5, 2.0, 2),
    'armature': drawn(0.05, 0.5, 2),
    'friction': drawn(0.2, 0.5, 2),
    'static_friction': drawn(0.6, 1.0, 2),
    'stribeck_velocity': drawn(0.1, 0.3, 2),
    'restitution': drawn(0.1, 0.9, 2),
    'stiffness': drawn(1.0, 5.0, 2),
    'rest_position': drawn(-1.0, 1.0, 2),
}
STOPS = {'joint_limits': [[-0.35, 0.4]] * 2}


# Arms whose second joints are equal.
FIRST_JOINT = {name: np.where([True, False], x, 0.75) for name, x in SCENE_NUMBERS.items()}


@pytest.mark.parametrize('integrator', one_fast(['rk4', 'velocity_verlet', 'imex2'], 'imex2'))
@pytest.mark.parametrize(
    ('numbers', 'names', 'effects'),
    [
        pytest.param(SCENE_NUMBERS, ['damping', 'armature'], {}, id='smooth'),
        pytest.param(
            SCENE_NUMBERS,
            ['damping', 'friction'],
            {'motor_lag': [0.01, 0.0], 'brakes': True},
            id='friction',
        ),
        pytest.param(FIRST_JOINT, ['damping', 'friction'], {}, id='friction of the first joint'),
        pytest.param(SCENE_NUMBERS, list(SCENE_NUMBERS), STOPS, id='everything'),
    ],
)
def test_each_arm_has_the_bits_of_a_simulator_with_its_numbers(
    numbers: dict[str, Array], names: list[str], effects: dict[str, Any], integrator: str
) -> None:
    robot = pfd.load_robot('planar2')
    given = {name: numbers[name] for name in names}
    scene = pfd.Scene(**effects, **{name: x[ONE] for name, x in given.items()})
    one = pfd.Simulator(robot, scene, integrator=integrator)
    states = motion(2)
    alone = moved(one, *(x[ONE] for x in states))
    for order in (1, -1):
        parameters = {name: x[::order] for name, x in given.items()}
        many = pfd.Ensemble(
            robot, SIZE, pfd.Scene(**effects), parameters=parameters, integrator=integrator
        )
        found = moved(many, *(x[::order] for x in states))[:, ::order]
        np.testing.assert_array_equal(found[:, ONE], alone)


def scaled(values: Array, low: float = 0.7, high: float = 1.4) -> Array:
    """Return numbers of arms, each link's and arm's scaled by another factor."""
    extra = (1,) * (values.ndim - 1)
    return values * drawn(low, high, len(values)).reshape(SIZE, len(values), *extra)


# With as many joints as gravity has components.
CHAIN = random_chain(
    np.random.default_rng(33), 3, joint_types=['revolute', 'prismatic', 'continuous']
)
BODIES = {
    'gravity': drawn(-9.0, 9.0, 3),
    'links.mass': scaled(CHAIN.masses),
    'links.center': scaled(CHAIN.centers),
    'links.inertia': scaled(CHAIN.inertias),
    'payload.mass': drawn(0.5, 2.0),
    'payload.center': drawn(-0.1, 0.1, 3),
    'payload.inertia': drawn(0.01, 0.02)[:, np.newaxis, np.newaxis] * np.eye(3),
}
FIELDS = {'links.mass': 'masses', 'links.center': 'centers', 'links.inertia': 'inertias'}


def arm_of(robot: pfd.Robot, given: dict[str, Array], b: int) -> tuple[pfd.Robot, Any]:
    """Return robot and payload of one arm."""
    bodies: dict[str, Any] = {FIELDS[k]: x[b] for k, x in given.items() if k in FIELDS}
    held = {k.partition('.')[2]: x[b] for k, x in given.items() if k.startswith('payload')}
    return replace(robot, **bodies), pfd.Payload(**held) if held else None


@pytest.mark.parametrize('refine', one_fast([0, 1], 1))
@pytest.mark.parametrize(
    'names',
    [
        pytest.param(
            ['payload.mass', 'payload.center', 'payload.inertia'],
            id='payload',
            marks=pytest.mark.long,
        ),
        pytest.param(list(FIELDS), id='links', marks=pytest.mark.long),
        pytest.param(list(BODIES), id='everything'),
    ],
)
def test_each_arm_moves_as_a_simulator_with_its_bodies(names: list[str], refine: int) -> None:
    given = {name: BODIES[name] for name in names}
    scene = pfd.Scene(damping=[1.0] * 3, joint_limits=[[-0.4, 0.4]] * 3, restitution=0.5)
    many = pfd.Ensemble(CHAIN, SIZE, scene, parameters=given, integrator='rk4', refine=refine)
    q, qd, taus = motion(3)
    found = moved(many, q, qd, taus)
    robot, payload = arm_of(CHAIN, given, ONE)
    own = replace(scene, payload=payload)
    if 'gravity' in given:
        own = replace(own, gravity=given['gravity'][ONE])
    one = pfd.Simulator(robot, own, integrator='rk4', refine=refine)
    wanted = moved(one, q[ONE], qd[ONE], taus[ONE])
    for row, right in zip(found[:, ONE], wanted, strict=True):
        np.testing.assert_allclose(row, right, rtol=0, atol=ROUNDING * np.abs(right).max())


@pytest.mark.usefixtures('folder')
def test_256_arms_that_all_differ_need_one_compilation_and_other_values_none(
    emitted: list[str],
) -> None:
    robot, size = pfd.load_robot('planar2'), 256
    rng = np.random.default_rng(34)

    def given() -> dict[str, Array]:
        return {
            'friction': rng.uniform(0.1, 2.0, (size, 2)),
            'payload.mass': rng.uniform(0.5, 3.0, size),
            'links.mass': robot.masses * rng.uniform(0.8, 1.2, (size, 2)),
        }

    first, second = given(), given()
    many, others = (pfd.Ensemble(robot, size, parameters=each) for each in (first, second))
    assert len(emitted) == 1
    q, qd, taus = motion(2, size)
    one, other = (moved(each, q, qd, taus) for each in (many, others))
    assert (one != other).any(axis=(0, 2, 3)).all()
    arm, payload = arm_of(robot, second, 255)
    alone = pfd.Simulator(arm, pfd.Scene(payload=payload, friction=second['friction'][255]))
    for row, right in zip(other[:, 255], moved(alone, q[255], qd[255], taus[255]), strict=True):
        np.testing.assert_allclose(row, right, rtol=0, atol=ROUNDING * np.abs(right).max())


def test_the_stiffest_arm_decides_on_the_integrator() -> None:
    robot = pfd.load_robot('planar2')
    damping = np.full((SIZE, 2), 1e-3)
    assert pfd.Ensemble(robot, SIZE, parameters={'damping': damping}).integrator == 'rk4'
    damping[7] = 1e4
    assert pfd.Ensemble(robot, SIZE, parameters={'damping': damping}).integrator == 'imex2'


def per_arm(shape: tuple[int, ...], *place: int, value: float, other: float = 1.0) -> Array:
    array = np.full((3, *shape), other)
    array[place] = value
    return array


@pytest.mark.parametrize(
    ('parameters', 'message'),
    [
        ({'frction': 1.0}, "parameters: 'frction' is unknown, only gravity, damping"),
        ({'motor_lag': [0.1, 0.1]}, "parameters: 'motor_lag' cannot differ among arms, only"),
        (
            {'links.center': np.ones((3, 2))},
            r"parameters\['links.center'\] must have shape \(3, 2, 3\) or .* got \(3, 2\)",
        ),
        (
            {'damping': per_arm((2,), 1, 0, value=np.nan)},
            r"parameters\['damping'\] must be .* got nan at index \[1, 0\], joint 'shoulder'",
        ),
        (
            {'damping': per_arm((2,), 2, 1, value=-1.0)},
            r"parameters, arm 2: damping of joint 'elbow' must not be negative, got -1.0",
        ),
        (
            {'friction': np.ones(2), 'static_friction': per_arm((2,), 1, 1, value=0.5)},
            "static_friction of joint 'elbow' of arm 1 must be at least its friction 1.0, got",
        ),
        ({'static_friction': np.ones(2)}, 'static_friction was given without friction, which the'),
        ({'payload.center': np.ones(3)}, 'payload.center was given without payload.mass, which'),
        (
            {'payload.mass': 1.0, 'payload.inertia': per_arm((3, 3), 2, 0, 1, value=1, other=0)},
            'parameters, arm 2: payload inertia must be symmetric',
        ),
        (
            {'links.inertia': per_arm((2, 3, 3), 2, 1, 2, 2, value=-1.0, other=0.0)},
            "parameters, arm 2: inertia of link 2 of 'planar2' .* must not be negative",
        ),
        (
            {'stiffness': per_arm((2,), 1, 0, value=1e6)},
            'parameters, arm 1: stiffness of the scene swings at',
        ),
    ],
)
def test_bad_parameters_are_named_with_arm_and_joint(parameters: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.Ensemble(pfd.load_robot('planar2'), 3, parameters=parameters)


def test_an_arm_without_inertia_is_named() -> None:
    light = without_mass(pfd.load_robot('planar2'), [1])
    given = {'payload.mass': [1.0, 0.0], 'payload.center': [0.1, 0.0, 0.0]}
    with pytest.raises(ValueError, match=r'parameters, arm 1: link 2 .* has no inertia'):
        pfd.Ensemble(light, 2, parameters=given)
    # All arms lack it, whatever their friction.
    with pytest.raises(ValueError, match=r'^link 2 .* has no inertia'):
        pfd.Ensemble(light, 2, parameters={'friction': [[1.0, 1.0], [2.0, 2.0]]})


def test_what_takes_no_parameters_says_so() -> None:
    robot = pfd.load_robot('planar2')
    given = {'damping': [[1, 1], [2, 2]]}
    with pytest.raises(ValueError, match='linearize takes no Ensemble with parameters'):
        pfd.Ensemble(robot, 2, parameters=given).linearize(*np.zeros((3, 2, 2)))
    message = "an ensemble with parameters, needs one of the methods .* got 'pcrbm'"
    with pytest.raises(ValueError, match=message):
        pfd.Ensemble(robot, 2, method='pcrbm', parameters=given)


# ---- control cycles of motors: MotorSimulator ----


ROBOT = pfd.load_robot('planar2')


ZEROS, INF = np.zeros(2), np.full(2, np.inf)


# Largest effort, the torque-speed line, its speed; no servo, and any change of an effort.
LIMITS = np.array([[20.0, 10.0], [20.0, 10.0], [3.0, 2.0], [3.0, 2.0], ZEROS, ZEROS, INF])


ENDLESS = np.array([INF, INF, INF, INF, ZEROS, ZEROS, INF])


def efforts(steps: int, size: float = 30.0) -> np.ndarray:
    return np.random.default_rng(3).normal(scale=size, size=(steps, 2))


@pytest.mark.parametrize(
    'scene', [pfd.Scene(), pfd.Scene(friction=(0.3, 0.1), armature=(0.1, 0.1))]
)
def test_without_limits_the_steps_equal_those_of_a_simulator(scene: pfd.Scene) -> None:
    motor, plain = pfd.MotorSimulator(ROBOT, scene), pfd.Simulator(ROBOT, scene)
    state, counters = motor.new_state(), pfd.MotorState(np.zeros(2))
    rows, out = efforts(200), np.empty((200, 3, 2))
    assert motor.bind(state, counters, ENDLESS).run(rows, out) == 200
    wanted = plain.rollout(rows)
    for k, name in enumerate(('q', 'qd')):
        assert out[:, k].tobytes() == getattr(wanted, name).tobytes()
    assert out[:, 2].tobytes() == rows.tobytes()
    assert motor.accelerations(state).tobytes() == plain.qdd.tobytes()
    assert not counters.counts.any()


def test_a_state_continues_in_another_scene_with_all_digits_of_its_positions() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    same = pfd.MotorSimulator(ROBOT, pfd.Scene(friction=(0.0, 0.0), brakes=True))
    state, out = motor.new_state((0.3, -0.2)), np.empty((2, 40, 3, 2))
    rows, counters = efforts(80).reshape(2, 40, 2), pfd.MotorState(np.zeros(2))
    motor.bind(state, counters, LIMITS).run(rows[0], out[0])
    assert state.arrays['q_low'].any()
    other = same.converted(state)
    assert (other.start, other.steps) == (0.0, 0)
    same.set_inputs(other)
    for one, its in ((motor, state), (same, other)):
        run = np.empty((40, 3, 2))
        one.bind(its, pfd.MotorState(np.zeros(2)), LIMITS).run(rows[1], run)
        out = np.concatenate([out, run[np.newaxis]])
    assert out[-1].tobytes() == out[-2].tobytes()


def test_arrays_of_another_shape_or_order_are_refused() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    bound = motor.bind(motor.new_state(), pfd.MotorState(np.zeros(2)), ENDLESS)
    with pytest.raises(ValueError, match=r'out must be \(3, 3, 2\) of float64, got \(3, 2\)'):
        bound.run(efforts(3), np.empty((3, 2)))
    with pytest.raises(ValueError, match='efforts must be C-ordered'):
        bound.run(np.asfortranarray(efforts(3)), np.empty((3, 3, 2)))
    with pytest.raises(ValueError, match='limits'):
        motor.bind(motor.new_state(), pfd.MotorState(np.zeros(2)), np.zeros((3, 2)))


def test_a_run_ends_before_the_step_whose_effort_jumps_and_has_its_own_status() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state()
    limits = np.array([INF, INF, INF, INF, ZEROS, ZEROS, (5.0, 5.0)])
    rows, out = np.cumsum(np.full((30, 2), 4.0), axis=0), np.zeros((30, 3, 2))
    rows[20:] += 2.0
    bound = motor.bind(state, counters, limits)
    assert bound.run(rows, out) == 20
    assert (counters.jumped, state.steps, state.status) == (True, 20, 'ok')
    assert out[20, 2].tolist() == rows[20].tolist()
    assert counters.before.tolist() == rows[19].tolist()
    # Without an effort before, any is allowed.
    counters.before[:] = np.nan
    assert bound.run(rows[20:], out[20:]) == 10
    assert not counters.jumped
    counters.before[:] = np.nan
    assert bound.run(np.array([(1e300, 0.0)]), out[:1]) == 0
    assert (counters.jumped, state.status) == (False, 'not_finite')


def test_a_braked_joint_neither_ends_a_run_nor_keeps_an_effort_for_the_next_cycle() -> None:
    motor = pfd.MotorSimulator(ROBOT, pfd.Scene(brakes=True))
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state()
    limits = np.array([INF, INF, INF, INF, ZEROS, ZEROS, (5.0, 5.0)])
    rows, out = np.array([(0.0, 0.0), (9.0, 1.0), (-9.0, 2.0)]), np.zeros((3, 3, 2))
    motor.set_inputs(state, brakes=[True, False])
    assert motor.bind(state, counters, limits).run(rows, out) == 3
    assert out[:, 2].tobytes() == rows.tobytes()
    assert np.isnan(counters.before[0])
    assert counters.before[1] == 2.0
    assert not state.arrays['qd'][0]
    # Off its brake, its first effort may be any; the next one is compared with it.
    motor.set_inputs(state, brakes=[False, False])
    rows = np.array([(100.0, 2.0), (106.0, 2.0)])
    assert motor.bind(state, counters, limits).run(rows, out[:2]) == 1
    assert counters.jumped
