# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time: the same bits in steps and rollouts, energy, order, motors that lag or saturate."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import partial
from itertools import pairwise
import math
from typing import Any

from bridge import TABLEAUX
import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
from zoo import WHEEL, to_pinocchio

import pfd_core as pfd

INTEGRATORS = tuple(TABLEAUX)


# The unforced two-link arm: a swing of 0.5 rad, and a whirl, 20 times faster, from above the
# horizontal.
SWING, WHIRL = [-np.pi / 2 + 0.5, 0.2], [0.5, 0.2]
# Change of its energy at steps of 1 ms over a number of seconds, over the peak kinetic energy.
# Seen: 1e-10, 9e-6 and 7e-8.
ENERGY_DRIFT = [
    ('rk4', SWING, 60, 1e-9),
    ('velocity_verlet', SWING, 60, 2e-5),
    ('rk4', WHIRL, 10, 1e-7),
]


def energies(robot: pfd.Robot, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return kinetic and potential energy of each row [J], by Pinocchio."""
    model = to_pinocchio(robot)
    data = model.createData()
    kinetic = [pin.computeKineticEnergy(model, data, *row) for row in zip(q, qd, strict=True)]
    potential = [pin.computePotentialEnergy(model, data, row) for row in q]
    return np.array(kinetic), np.array(potential)


@pytest.mark.parametrize('integrator', INTEGRATORS)
@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_steps_and_rollout_give_the_same_bits(integrator: str, dtype: str) -> None:
    robot = pfd.load_robot('puma560')
    taus = np.random.default_rng(1).normal(size=(50, 6)).astype(dtype) * 10
    make = partial(pfd.Simulator, robot, integrator=integrator, dtype=dtype, substeps=3)
    one, other = make(), make()
    trajectory = one.rollout(taus)
    for k, tau in enumerate(taus):
        other.step(tau)
        np.testing.assert_array_equal(other.q, trajectory.q[k])
        np.testing.assert_array_equal(other.qd, trajectory.qd[k])
        np.testing.assert_array_equal(other.qdd, trajectory.qdd[k])
        assert other.time == trajectory.time[k]
    np.testing.assert_array_equal(one.q, other.q)
    assert trajectory.status == one.status == 'ok'
    assert trajectory.finite_steps == 50


@pytest.mark.parametrize(('integrator', 'q0', 'seconds', 'most'), ENERGY_DRIFT)
def test_the_energy_of_the_two_link_arm_stays(
    integrator: str, q0: list[float], seconds: int, most: float
) -> None:
    robot = pfd.load_robot('planar2')
    sim = pfd.Simulator(robot, step_size=1e-3, substeps=1, integrator=integrator)
    sim.reset(q=q0)
    trajectory = sim.rollout(np.zeros((1000 * seconds, 2)))
    kinetic, potential = energies(robot, trajectory.q, trajectory.qd)
    start = energies(robot, np.array([q0]), np.zeros((1, 2)))
    drift = np.abs(kinetic + potential - start[0] - start[1]).max()
    assert kinetic.max() > 1  # it does swing
    assert drift < most * kinetic.max()


@pytest.mark.parametrize('integrator', INTEGRATORS)
def test_the_error_falls_with_the_order_of_the_integrator(integrator: str) -> None:
    robot = pfd.load_robot('planar2')

    def end(substeps: int) -> np.ndarray:
        sim = pfd.Simulator(robot, step_size=0.02, substeps=substeps, integrator=integrator)
        sim.reset(q=SWING)
        return sim.rollout(np.full((50, 2), 0.3)).q[-1]

    reference = pfd.integrate(
        robot, [0.3, 0.3], 1.0, q=SWING, rtol=1e-13, atol=1e-15, dense=False
    ).q[-1]
    errors = [np.abs(end(substeps) - reference).max() for substeps in (2, 4, 8)]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(TABLEAUX[integrator].order, abs=0.2)


def test_time_does_not_drift() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=1e-3)
    sim.reset(time=5.0)
    sim.rollout(np.zeros((700, 2)))
    for _ in range(300):
        sim.step([0.0, 0.0])
    assert sim.time == 5.0 + 1000 * 1e-3


def test_a_reset_sets_state_and_time_after_any_number_of_steps() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'))
    for steps in (0, 1, 2, 3):
        sim.reset([0.1, steps], [0.2, steps], time=steps)
        assert (sim.q.tolist(), sim.qd.tolist()) == ([0.1, steps], [0.2, steps])
        assert sim.time == steps
        for _ in range(steps):
            sim.step([1.0, 0.0])


def test_an_overflow_is_a_status_and_the_finite_steps_are_counted() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=1e-3)
    taus = np.zeros((40, 2))
    taus[3:] = 1e200
    trajectory = sim.rollout(taus)
    assert trajectory.status == sim.status == 'not_finite'
    assert trajectory.finite_steps == 3
    assert np.isfinite(trajectory.q[: trajectory.finite_steps]).all()
    assert not np.isfinite(trajectory.qdd[3]).all()
    sim.reset()
    assert sim.status == 'ok'


@pytest.mark.parametrize('kind', [pfd.Simulator, partial(pfd.Ensemble, size=2)])
def test_what_native_code_was_made_for_cannot_be_changed_nor_the_state_by_its_copy(
    kind: Any,
) -> None:
    sim = kind(pfd.load_robot('planar2'))
    names = ('robot', 'scene', 'step_size', 'substeps', 'integrator', 'method', 'dtype')
    for name in (*names, 'compensated', *(['size'] if sim.batch else [])):
        before = getattr(sim, name)
        with pytest.raises(AttributeError, match=name):
            setattr(sim, name, before)
    # What is handed out is a copy.
    sim.q[:] = 7.0
    np.testing.assert_array_equal(sim.q, 0.0)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'step_size': 0.0}, 'step_size must be above zero seconds, got 0.0'),
        ({'substeps': 1.5}, 'substeps must be an integer of at least 1, got 1.5'),
        # Numbers that a 64-bit integer would take for 2 and for 0.
        (
            {'substeps': 2**64 + 2},
            'substeps must be an integer from 1 to 100000, got 184467440737',
        ),
        ({'refine': 2**64}, 'refine must be an integer from 0 to 16, got 18446744073709551616'),
        ({'dtype': 'float16'}, "dtype must be one of .* got 'float16'"),
    ],
)
def test_bad_settings_are_named(options, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        pfd.Simulator(pfd.load_robot('planar2'), **options)


# Moment of inertia of the wheel about its joint [kg m^2].
INERTIA = 0.025


@pytest.mark.sweep
@pytest.mark.parametrize('substeps', one_fast([1, 3], 3))
@pytest.mark.parametrize('integrator', TABLEAUX)
@pytest.mark.parametrize(
    ('kp', 'kd', 'radius'),
    [
        (40_000.0, 50.0, 1.058),  # kp/kd = 800 > 2/T = 500
        (10_000.0, 50.0, None),
        (400.0, 480.0, None),
        (400.0, 510.0, 1.040),  # kd > 2 I/T
    ],
)
def test_a_sampled_loop_is_the_closed_form_of_the_hold(
    kp: float, kd: float, radius: float | None, integrator: str, substeps: int
) -> None:
    T = 4e-3
    # One step of I dqd/dt = u, u = -kp q - kd qd of its beginning; gains for 1 kg m^2.
    A = np.array([[1 - kp * T**2 / 2, T - kd * T**2 / 2], [-kp * T, 1 - kd * T]])
    if radius is None:
        assert np.abs(np.linalg.eigvals(A)).max() < 1
    else:
        assert np.abs(np.linalg.eigvals(A)).max() == pytest.approx(radius, abs=5e-4)
    many = pfd.Ensemble(
        pfd.load_robot(WHEEL),
        1,
        pfd.Scene(gravity=None),
        step_size=T,
        substeps=substeps,
        integrator=integrator,
    )
    many.reset([1.0])
    run = many.rollout(steps=300, feedback=pfd.Feedback([INERTIA * kp], [INERTIA * kd], [0.0]))
    state = np.array([1.0, 0.0])
    for q, qd in zip(run.q[0, :, 0], run.qd[0, :, 0], strict=True):
        state = A @ state
        np.testing.assert_allclose([q, qd], state, rtol=1e-9, atol=1e-9)


# ---- a small velocity of a held joint ---------------------------------------------------------

STATES, SCENES, SMALL = 25, 8, 1e-4
ARMATURE = np.array([0.8, 4.0, 0.8])


@pytest.mark.parametrize('seed', range(SCENES))
def test_a_small_velocity_of_a_held_joint_changes_the_end_of_an_implicit_step_little(
    seed: int,
) -> None:
    # Damping D of strengths h D / H up to 120, and torques that keep the other joints moving.
    rng, h = np.random.default_rng(seed), 1e-3
    robot = pfd.load_robot('puma560', locked={f'joint{k}': 0.3 for k in (4, 5, 6)})
    rotors = pfd.Scene(armature=ARMATURE)
    H = pfd.compile_kernel(robot, scene=rotors, quantity='inertia_matrix')
    bias = pfd.compile_kernel(robot, scene=rotors, quantity='bias_torques')
    q, v = rng.uniform(-1, 1, (STATES, 3)), rng.uniform(-1.5, 1.5, (STATES, 3))
    diagonals = np.diagonal(H(q), axis1=1, axis2=2)
    damping = diagonals.min(axis=0) / h * np.exp(rng.uniform(np.log(0.05), np.log(120), 3))
    friction, held = rng.uniform(2, 20, 3), rng.integers(3, size=STATES)
    of = np.arange(STATES), held
    v[of] = 0.0
    tau = bias(q, v) + damping * v + friction * (np.sign(v) + rng.uniform(-0.3, 0.3, v.shape))
    scene = pfd.Scene(armature=ARMATURE, friction=friction, damping=damping)
    arms = pfd.Ensemble(robot, STATES, scene, step_size=h, substeps=1, integrator='imex2')
    ends = []
    for velocity in (0.0, SMALL, -SMALL):
        v[of] = velocity
        arms.reset(q, v)
        arms.rollout(tau[:, np.newaxis])
        ends.append(np.hstack([arms.q, arms.qd]))
    assert (ends[0][of[0], 3 + held] == 0.0).all()
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max() < 10 * SMALL


WRENCH = np.arange(6) / 7
REFUSED: dict[str, Callable[[pfd.Simulator], Any]] = {
    'torque': lambda s: s.step([7.0], WRENCH),
    'no wrench': lambda s: s.step([7.0, 8.0]),
    'wrench that is not finite': lambda s: s.step([7.0, 8.0], np.full(6, np.nan)),
    'brakes of three': lambda s: s.step([7.0, 8.0], WRENCH + 1, brakes=[True] * 3),
    'rollout': lambda s: s.rollout([[7.0, 8.0]], WRENCH + 1, brakes=[1, 0]),
    'empty rollout': lambda s: s.rollout(np.zeros((0, 2)), WRENCH + 1, brakes=[1, 0]),
    'reset to a wrong velocity': lambda s: s.reset([1.0, 2.0], [3.0], 4.0),
    'reset to no time': lambda s: s.reset([1.0, 2.0], [3.0, 4.0], np.nan),
}


def facts(sim: pfd.Simulator) -> tuple[Any, ...]:
    """Return all public values of a simulation, as bits."""
    return sim.q.tobytes(), sim.qd.tobytes(), sim.qdd.tobytes(), sim.time, sim.status


@pytest.mark.parametrize('call', REFUSED)
def test_a_call_that_is_refused_leaves_everything_as_it_was(call: str) -> None:
    scene = pfd.Scene(external_wrench=True, brakes=True)
    sim, twin = (pfd.Simulator(pfd.load_robot('planar2'), scene) for _ in range(2))
    for one in (sim, twin):
        one.step([1.0, -1.0], WRENCH, brakes=[False, True])
    with pytest.raises(ValueError, match=r'must|the call needs wrench='):
        REFUSED[call](sim)
    assert facts(sim) == facts(twin)
    assert sim.rollout(np.zeros((0, 2)), 2 * WRENCH).q.shape == (0, 2)
    assert facts(sim) == facts(twin)
    for one in (sim, twin):
        one.step([0.5, 0.25], WRENCH)
    assert facts(sim) == facts(twin)


START = np.array([0.1, -0.7, 0.9, 0.3, 0.2, 0.5])
COMMAND = np.array([20.0, -30.0, 10.0, 1.0, -1.0, 0.5])
HOLD = 0.036
# Time constants of all kinds: none, as short as a step, ten times as long.
MIXED = np.array([0.0, 2e-3, 0.0, 5e-4, 4e-3, 0.0])


def lagging_puma(lag: Any, integrator: str, substeps: int, **scene: Any) -> pfd.Simulator:
    """Return an arm before a step of HOLD seconds, its motors without torque."""
    scene = {'armature': 'model', **scene}
    robot = pfd.load_robot('puma560')
    sim = pfd.Simulator(
        robot,
        pfd.Scene(motor_lag=lag, **scene),
        step_size=HOLD,
        substeps=substeps,
        integrator=integrator,
    )
    sim.reset(q=START)
    return sim


def lagging_reference(lag: np.ndarray, **scene: Any) -> np.ndarray:
    """Return the position after HOLD seconds, by the closed form of the torque and DOP853."""
    lags = np.where(lag > 0, lag, 1.0)

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return COMMAND * np.where(lag > 0, -np.expm1(-t / lags), 1.0)

    run = pfd.integrate(
        pfd.load_robot('puma560'),
        torque,
        HOLD,
        scene=pfd.Scene(armature='model', **scene),
        q=START,
        rtol=1e-13,
        atol=1e-15,
        dense=False,
    )
    assert run.status == 'ok'
    return np.asarray(run.q[-1])


@pytest.mark.parametrize('integrator', one_fast(INTEGRATORS))
@pytest.mark.parametrize(
    'lag',
    [
        pytest.param(np.full(6, 2e-3), marks=pytest.mark.slow),
        pytest.param(np.full(6, 8e-3), marks=pytest.mark.slow),
        MIXED * [1, 1, 1, 0, 1, 1],
    ],
    ids=str,
)
def test_the_error_with_motors_that_lag_falls_with_the_order_of_the_integrator(
    integrator: str, lag: np.ndarray
) -> None:
    scene = {'damping': np.full(6, 100.0)} if TABLEAUX[integrator].implicit else {}
    right = lagging_reference(lag, **scene)
    errors = []
    for substeps in (30, 120):
        sim = lagging_puma(lag, integrator, substeps, **scene)
        sim.step(COMMAND)
        errors.append(np.abs(sim.q - right).max())
    assert errors[-1] < (1e-9 if integrator == 'rk4' else 3e-6)
    order = math.log2(errors[0] / errors[1]) / 2
    assert order == pytest.approx(TABLEAUX[integrator].order, abs=0.2)


@pytest.mark.parametrize(
    ('lag', 'h', 'most'),
    one_fast([(0.02, 1e-3, 1e-9), (2e-3, 1e-3, 2e-8), (2e-4, 6e-4, 3e-7)], (2e-4, 6e-4, 3e-7)),
)
def test_a_wheel_turns_as_the_closed_form_says(lag: float, h: float, most: float) -> None:
    # I dqd/dt = u (1 - exp(-t/T)) from rest; 1 rad/s^2 in the end. T = 0.2 ms is stable though
    # three times shorter than a step: as a separate equation it would need h < 2.78 T.
    sim = pfd.Simulator(
        pfd.load_robot(WHEEL), pfd.Scene(gravity=None, motor_lag=[lag]), step_size=h, substeps=1
    )
    run = sim.rollout(np.full((60, 1), INERTIA))
    t = run.time
    rise = -np.expm1(-t / lag)
    np.testing.assert_allclose(sim.tau_motor, [INERTIA * rise[-1]], rtol=1e-12)
    np.testing.assert_allclose(run.qdd[:, 0], rise, rtol=1e-12)
    np.testing.assert_allclose(run.q[:, 0], t * t / 2 - lag * t + lag**2 * rise, atol=most)


@pytest.mark.parametrize('lag', one_fast([1e-300, 1e-9, 1e-4, 1.0, 1e9]))
def test_no_time_constant_makes_a_step_unstable(lag: float) -> None:
    sim = lagging_puma(np.full(6, lag), 'rk4', 36)
    sim.rollout([COMMAND, -COMMAND, COMMAND])
    assert sim.status == 'ok'
    assert np.abs(sim.qd).max() < 10


@pytest.mark.parametrize('integrator', INTEGRATORS)
def test_a_lag_of_zero_changes_neither_programs_nor_bits(integrator: str) -> None:
    robot = pfd.load_robot('planar2')
    states = []
    for scene in (pfd.Scene(), pfd.Scene(motor_lag=[0.0, 0.0])):
        sim = pfd.Simulator(robot, scene, integrator=integrator)
        sim.step([1.0, -1.0])
        states.append((sim.code_digest, sim.q.tobytes(), sim.qd.tobytes()))
    assert states[0] == states[1]


def test_an_arm_whose_motors_hold_it_from_the_start_does_not_fall() -> None:
    robot = pfd.load_robot('puma560')
    scene = pfd.Scene(armature='model', motor_lag=np.full(6, 0.02))
    hold = pfd.inverse_dynamics(robot, START, np.zeros(6), np.zeros(6))
    starts = np.array([START, START])
    many = pfd.Ensemble(robot, 2, scene)
    many.reset(starts, tau_motor=hold)
    np.testing.assert_allclose(many.rollout(np.tile(hold, (50, 1))).q[:, -1], starts, atol=1e-9)
    many.reset(starts)
    assert np.abs(many.rollout(np.tile(hold, (50, 1))).q[:, -1] - starts).max() > 1e-3
    with pytest.raises(ValueError, match='tau_motor was given, but the scene has no motor_lag'):
        pfd.Simulator(robot).reset(tau_motor=hold)


def test_a_scene_without_lag_has_no_torques_of_motors() -> None:
    with pytest.raises(ValueError, match='tau_motor needs a scene with motor_lag'):
        _ = pfd.Simulator(pfd.load_robot(WHEEL)).tau_motor


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


def test_one_call_has_the_bits_of_single_steps_in_a_copied_state() -> None:
    motor = pfd.MotorSimulator(ROBOT, pfd.Scene(motor_lag=(0.02, 0.0)))
    state, counters = motor.new_state((0.3, -0.2)), pfd.MotorState(np.zeros(2))
    rows, out = efforts(60), np.empty((60, 3, 2))
    motor.bind(state, counters, LIMITS).run(rows[:20], out[:20])
    twin, same = deepcopy((state, counters))
    motor.bind(state, counters, LIMITS).run(rows[20:], out[20:])
    single = motor.bind(twin, same, LIMITS)
    for k in range(20, 60):
        row = np.empty((1, 3, 2))
        assert single.run(rows[k : k + 1], row) == 1
        assert row[0].tobytes() == out[k].tobytes()
    for name, array in state.arrays.items():
        assert array.tobytes() == twin.arrays[name].tobytes()
    assert (same.counts.tolist(), same.peaks.tolist()) == (
        counters.counts.tolist(),
        counters.peaks.tolist(),
    )


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


def test_a_run_ends_before_the_step_whose_effort_jumps() -> None:
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


def test_a_run_that_overflows_after_one_that_ended_at_a_jump_has_its_status() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state()
    limits = np.array([INF, INF, INF, INF, ZEROS, ZEROS, (5.0, 5.0)])
    out = np.zeros((2, 3, 2))
    bound = motor.bind(state, counters, limits)
    assert bound.run(np.array([(0.0, 0.0), (9.0, 0.0)]), out) == 1
    assert counters.jumped
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
