# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time: steps and rollouts, energy, order; motors, damping, springs, friction by the load."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
import math
from typing import Any

import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from zoo import WHEEL, Array, joint, link, one_fast, slider, to_pinocchio, urdf

import pfd_core as pfd
from pfd_core.simulation.stiffness import STIFF as STIFF_DECAY
from pfd_core.simulation.tableaux import TABLEAUX

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


def test_an_overflow_is_a_status_and_the_finite_steps_are_counted() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=1e-3)
    taus = np.zeros((40, 2))
    taus[3:] = 1e200
    trajectory = sim.rollout(taus)
    assert trajectory.status == sim.status == 'not_finite'
    assert trajectory.finite_steps == 3
    assert np.isfinite(trajectory.q[: trajectory.finite_steps]).all()
    assert not np.isfinite(trajectory.qdd[3]).all()
    assert sim.wrapped[1].tolist() == [0, 0]
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


# Moment of inertia of the wheel about its joint [kg m^2].
INERTIA = 0.025


@pytest.mark.sweep
@pytest.mark.parametrize('substeps', [1, 3])
@pytest.mark.parametrize('integrator', TABLEAUX)
@pytest.mark.parametrize(('kp', 'kd', 'radius'), [(40_000.0, 50.0, 1.058), (400.0, 480.0, None)])
def test_a_sampled_loop_is_the_closed_form_of_the_hold(
    kp: float, kd: float, radius: float | None, integrator: str, substeps: int
) -> None:
    T = 4e-3
    # One step of I dqd/dt = u, u = -kp q - kd qd of its beginning; gains for 1 kg m^2. The first
    # has kp/kd = 800 > 2/T = 500.
    A = np.array([[1 - kp * T**2 / 2, T - kd * T**2 / 2], [-kp * T, 1 - kd * T]])
    largest = np.abs(np.linalg.eigvals(A)).max()
    assert largest < 1 if radius is None else largest == pytest.approx(radius, abs=5e-4)
    settings = {'step_size': T, 'substeps': substeps, 'integrator': integrator}
    many = pfd.Ensemble(pfd.load_robot(WHEEL), 1, pfd.Scene(gravity=None), **settings)
    many.reset([1.0])
    run = many.rollout(steps=300, feedback=pfd.Feedback([INERTIA * kp], [INERTIA * kd], [0.0]))
    state = np.array([1.0, 0.0])
    for q, qd in zip(run.q[0, :, 0], run.qd[0, :, 0], strict=True):
        state = A @ state
        np.testing.assert_allclose([q, qd], state, rtol=1e-9, atol=1e-9)


# ---- a small velocity of a held joint ---------------------------------------------------------

STATES, SMALL = 25, 1e-4
ARMATURE = np.array([0.8, 4.0, 0.8])


@pytest.mark.parametrize('seed', one_fast(range(3)))
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
NAN = np.array([0.0, np.nan])
AT_ELBOW = r"must be .*at index \[1\], joint 'elbow'"
REFUSED: dict[str, tuple[Callable[[pfd.Simulator], Any], str]] = {
    'torque': (lambda s: s.step([7.0], WRENCH), 'tau must'),
    'torque that is not finite': (lambda s: s.step(NAN, WRENCH), f'^tau {AT_ELBOW}'),
    'torques that are not finite': (
        lambda s: s.rollout([NAN], WRENCH),
        r"^taus must be .*at index \[0, 1\], joint 'elbow'",
    ),
    'no wrench': (lambda s: s.step([7.0, 8.0]), 'the call needs wrench='),
    'wrench that is not finite': (lambda s: s.step([7.0, 8.0], np.full(6, np.inf)), 'wrench must'),
    'brakes of three': (
        lambda s: s.step([7.0, 8.0], WRENCH + 1, brakes=[True] * 3),
        'brakes must',
    ),
    'rollout': (lambda s: s.rollout([[7.0, 8.0]], WRENCH + 1, brakes=[1, 0]), 'brakes must'),
    'empty rollout': (
        lambda s: s.rollout(np.zeros((0, 2)), WRENCH + 1, brakes=[1, 0]),
        'brakes must',
    ),
    'reset to a wrong velocity': (lambda s: s.reset([1.0, 2.0], [3.0], 4.0), 'qd must'),
    'reset to no position': (lambda s: s.reset(NAN), f'^q {AT_ELBOW}'),
    'reset to no velocity': (lambda s: s.reset([1.0, 2.0], NAN), f'^qd {AT_ELBOW}'),
    'reset to no time': (lambda s: s.reset([1.0, 2.0], [3.0, 4.0], np.nan), 'time must'),
}


def facts(sim: pfd.Simulator) -> tuple[Any, ...]:
    return sim.q.tobytes(), sim.qd.tobytes(), sim.qdd.tobytes(), sim.time, sim.status


@pytest.mark.parametrize('call', REFUSED)
def test_a_call_that_is_refused_leaves_everything_as_it_was(call: str) -> None:
    scene = pfd.Scene(external_wrench=True, brakes=True)
    sim, twin = (pfd.Simulator(pfd.load_robot('planar2'), scene) for _ in range(2))
    for one in (sim, twin):
        one.step([1.0, -1.0], WRENCH, brakes=[False, True])
    refused, message = REFUSED[call]
    with pytest.raises(ValueError, match=message):
        refused(sim)
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
LAGS = np.array([0.0, 2e-3, 0.0, 0.0, 4e-3, 0.0])


@pytest.mark.parametrize('integrator', one_fast(INTEGRATORS))
@pytest.mark.parametrize(
    'lag', [LAGS, *(pytest.param(np.full(6, x), marks=pytest.mark.slow) for x in (2e-3, 8e-3))]
)
def test_the_error_with_motors_that_lag_falls_with_the_order_of_the_integrator(
    integrator: str, lag: np.ndarray
) -> None:
    robot, kept = pfd.load_robot('puma560'), {'armature': 'model'}
    if TABLEAUX[integrator].implicit:
        kept['damping'] = np.full(6, 100.0)
    lags = np.where(lag > 0, lag, 1.0)

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return COMMAND * np.where(lag > 0, -np.expm1(-t / lags), 1.0)

    # The closed form of the torque, and DOP853.
    settings = {'q': START, 'rtol': 1e-13, 'atol': 1e-15, 'dense': False}
    right = pfd.integrate(robot, torque, HOLD, scene=pfd.Scene(**kept), **settings)
    assert right.status == 'ok'
    errors, scene = [], pfd.Scene(motor_lag=lag, **kept)
    for substeps in (30, 120):
        options = {'step_size': HOLD, 'substeps': substeps, 'integrator': integrator}
        sim = pfd.Simulator(robot, scene, **options)
        sim.reset(q=START)
        sim.step(COMMAND)
        errors.append(np.abs(sim.q - right.q[-1]).max())
    assert errors[-1] < (1e-9 if integrator == 'rk4' else 3e-6)
    order = math.log2(errors[0] / errors[1]) / 2
    assert order == pytest.approx(TABLEAUX[integrator].order, abs=0.2)


@pytest.mark.parametrize(
    ('lag', 'h', 'most'),
    [
        (1e-8, 1e-3, 1e-9),
        *one_fast(
            [(0.02, 1e-3, 1e-9), (2e-3, 1e-3, 2e-8), (2e-4, 6e-4, 3e-7)], (2e-4, 6e-4, 3e-7)
        ),
    ],
)
def test_a_wheel_turns_as_the_closed_form_says(lag: float, h: float, most: float) -> None:
    # I dqd/dt = u (1 - exp(-t/T)) from rest; 1 rad/s^2 in the end. T = 0.2 ms is stable though
    # three times shorter than a step: as a separate equation it would need h < 2.78 T. One far
    # shorter must not act for the sixth of a step that the first stage of rk4 weighs.
    scene = pfd.Scene(gravity=None, motor_lag=[lag])
    sim = pfd.Simulator(pfd.load_robot(WHEEL), scene, step_size=h, substeps=1)
    run = sim.rollout(np.full((60, 1), INERTIA))
    t, rise = run.time, -np.expm1(-run.time / lag)
    np.testing.assert_allclose(sim.tau_motor, [INERTIA * rise[-1]], rtol=1e-12)
    np.testing.assert_allclose(run.qdd[:, 0], rise, rtol=1e-12)
    np.testing.assert_allclose(run.q[:, 0], t * t / 2 - lag * t + lag**2 * rise, atol=most)


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


# The same of a rod from 1 rad/s on, at any damping. Seen up to 4e-5, at h d / I = 4.
COASTING = 6e-5


@pytest.mark.parametrize('integrator', ['imex2', 'auto'])
@pytest.mark.parametrize('damping', one_fast([1e-2, 1.0, 1e2, 3e3, 1e4, 1e6], 1e4))
def test_a_damped_rod_coasts_as_in_its_closed_form(damping: float, integrator: str) -> None:
    # Two rods of 0.5 m and 1 kg, in line: I = 2/3, qd = w0 exp(-d t / I).
    scene = pfd.Scene(gravity=None, damping=np.full(2, damping), brakes=True)
    sim = pfd.Simulator(
        pfd.load_robot('planar2'), scene, step_size=1e-3, substeps=1, integrator=integrator
    )
    sim.reset(qd=[1.0, 0.0])
    trajectory = sim.rollout(np.zeros((1000, 2)), brakes=[False, True])
    rate = damping / (2 / 3)
    expected = -np.expm1(-rate * trajectory.time) / rate
    np.testing.assert_allclose(trajectory.q[:, 0], expected, rtol=0, atol=COASTING)
    np.testing.assert_array_equal(trajectory.q[:, 1], 0.0)
    # No ringing: a trapezoidal rule would keep the velocity and change its sign.
    assert abs(trajectory.qd[-1, 0]) <= math.exp(-rate) + COASTING


# Roundings of a few substeps, compared with the terms of a stage that are h lambda times as large.
STEADY = 4.0


@pytest.mark.sweep
@pytest.mark.parametrize(('dtype', 'most'), [('float64', 9e13), ('float32', 1.6e6)])
@pytest.mark.parametrize('inertia', [1e-12, 0.5])
def test_damping_is_as_accurate_as_the_number_format_carries_and_refused_beyond(
    inertia: float, dtype: str, most: float
) -> None:
    # A rod about its axis: I qdd = tau - d qd, tau / d in steady state.
    J = f'{inertia} {inertia} {inertia} 0 0 0'
    text = urdf(
        'rod', link('base'), link('arm', 1.0, J=J), joint('axis', 'continuous', 'base', 'arm')
    )
    robot, h = pfd.load_robot(text), 1e-3

    def sim(stiffness: float) -> pfd.Simulator:
        scene = pfd.Scene(gravity=None, damping=[stiffness * inertia / h])
        return pfd.Simulator(
            robot, scene, step_size=h, substeps=1, integrator='imex2', dtype=dtype
        )

    for stiffness in (1e5, most / 10, most):
        arm = sim(stiffness)
        bound = STEADY * float(np.finfo(dtype).eps) / 2 * stiffness
        for tau in np.linspace(0.3, 3.0, 20).astype(dtype):
            arm.reset()
            arm.rollout(np.full((4, 1), tau))
            steady = float(tau) / (stiffness * inertia / h)
            assert abs(float(arm.qd[0]) - steady) <= bound * steady
    for stiffness in (1.2 * most, 1e24):
        with pytest.raises(ValueError, match=r'damping of the scene decays .* keep the digits'):
            sim(stiffness)


@pytest.mark.sweep
@pytest.mark.parametrize('integrator', ['auto', 'imex2'])
@pytest.mark.parametrize('first', [1e-18, 1e-20])
def test_damping_is_refused_where_the_inertia_matrix_has_no_factors(
    first: float, integrator: str
) -> None:
    # H = [[m1 + m2, m2], [m2, m2]] of two slides on one axis: m1 + m2 = m2 in float64.
    J = ' '.join([str(first)] * 3)
    robot = pfd.load_robot(
        urdf(
            'slides',
            *(link('base'), link('a', first, J=f'{J} 0 0 0'), link('b', 1.0, J='1 1 1 0 0 0')),
            joint('first', 'prismatic', 'base', 'a'),
            joint('second', 'prismatic', 'a', 'b'),
        )
    )
    scene = pfd.Scene(damping=[1.0, 1.0])
    with pytest.raises(ValueError, match=r'inertia matrix .* positive definite .* rotors'):
        pfd.Simulator(robot, scene, integrator=integrator)
    assert pfd.Simulator(robot, scene, integrator='rk4').integrator == 'rk4'
    with_rotors = pfd.Scene(damping=[1.0, 1.0], armature=[0.1, 0.1])
    assert pfd.Simulator(robot, with_rotors, integrator=integrator).step([0.0, 0.0]) is None


# ---- the integrator that 'auto' selects ------------------------------------------------------


# Phase that RK4 loses in 500 steps of w h = 0.2, (w h)^5 / 120 each, times 0.01 m.
PHASE_OF_RK4 = 500 * 0.2**5 / 120 * 0.01 * 1.1


@pytest.mark.parametrize('kind', one_fast(['Simulator', 'Ensemble']))
def test_a_wheel_is_stiff_from_a_damping_of_its_inertia_over_the_step(kind: str) -> None:
    make = {'Simulator': pfd.Simulator, 'Ensemble': partial(pfd.Ensemble, size=2)}[kind]

    def integrator(damping: float, **settings: float) -> str:
        scene = pfd.Scene(damping=[damping])
        found: str = make(load, scene=scene, **settings).integrator
        return found

    load = pfd.load_robot(WHEEL)
    # By default two substeps of 0.5 ms each.
    border = STIFF_DECAY * INERTIA / 0.5e-3
    assert integrator(0.0) == integrator(0.99 * border) == 'rk4'
    assert integrator(1.01 * border) == 'imex2'
    assert integrator(1.01 * border, substeps=3) == 'rk4'
    assert integrator(0.51 * border, step_size=2e-3) == 'imex2'
    assert pfd.Simulator(load, pfd.Scene(damping=[1e9]), integrator='rk4').integrator == 'rk4'


def test_a_joint_settles_into_the_period_of_its_cogging_and_swings_as_its_slope_says() -> None:
    # I qdd = -a sin(k q + p), about q = (2 pi m - p) / k with w^2 = a k / I.
    amplitude, periods, phase = 0.5, 8.0, 0.4
    scene = pfd.Scene(gravity=None, cogging=[(amplitude, periods, phase)])
    sim = pfd.Simulator(pfd.load_robot(WHEEL), scene)
    rest, small = (2 * np.pi * 3 - phase) / periods, 1e-5
    sim.reset([rest + small], [0.0])
    run = sim.rollout(np.zeros((500, 1)))
    frequency = np.sqrt(amplitude * periods / INERTIA)
    wanted = small * np.cos(frequency * run.time)
    assert np.abs(run.q[:, 0] - rest - wanted).max() < 1e-4 * small
    stiff = pfd.Scene(gravity=None, cogging=[(4e3 * amplitude, periods, phase)])
    with pytest.raises(ValueError, match=r'cogging of the scene swings at 80\d rad/s'):
        pfd.Simulator(sim.robot, stiff)


def test_springs_too_stiff_for_the_step_are_refused_with_the_substeps_that_they_need() -> None:
    robot = slider(1, 0)  # 1 kg
    scene = pfd.Scene(gravity=None, stiffness=[4e4])  # 200 rad/s
    with pytest.raises(ValueError, match=r'swings at 200 rad/s.* 5 substeps are needed'):
        pfd.Simulator(robot, scene, step_size=5e-3, substeps=4)
    sim = pfd.Simulator(robot, scene, step_size=5e-3, substeps=5)
    sim.reset([0.01], [0.0])
    run = sim.rollout(np.zeros((100, 1)))
    assert np.abs(run.q[:, 0] - 0.01 * np.cos(200 * run.time)).max() < PHASE_OF_RK4


MU = 0.2
ROUNDING = 1e-13


def simulator(robot: pfd.Robot, scene: pfd.Scene, **settings: Any) -> pfd.Simulator:
    return pfd.Simulator(robot, scene, **{'step_size': 1e-3, 'substeps': 1} | settings)


@pytest.mark.parametrize('integrator', TABLEAUX)
def test_friction_takes_its_share_of_a_torque_that_drives_and_adds_it_to_one_that_brakes(
    integrator: str,
) -> None:
    u = 1.0 / INERTIA
    sim = simulator(
        pfd.load_robot(WHEEL), pfd.Scene(gravity=None, load_friction=[MU]), integrator=integrator
    )
    sim.reset([0.0], [1.0])
    run = sim.rollout(np.repeat([[1.0], [-1.0]], 100, axis=0))
    up, down, back = u * (1 - MU), u * (1 + MU), u * (1 - MU)
    fast = 1 + 0.1 * up
    top = 0.1 + up * 0.1**2 / 2 + fast**2 / (2 * down)
    left = 0.1 - fast / down
    assert left > 0
    np.testing.assert_allclose(run.qd[99], [fast], rtol=ROUNDING)
    np.testing.assert_allclose(run.qd[-1], [-back * left], rtol=1e-11)
    np.testing.assert_allclose(run.q[-1], [top - back * left**2 / 2], rtol=1e-11)


@pytest.mark.parametrize(
    ('share', 'moves'),
    [(0.999 / (1 + MU), -1), (1.001 / (1 + MU), 0), (0.999 / (1 - MU), 0), (1.001 / (1 - MU), 1)],
)
def test_a_motor_holds_a_weight_between_that_over_1_plus_mu_and_over_1_minus_mu(
    share: float, moves: int
) -> None:
    weight = 9.81
    sim = simulator(slider(0.0, 1.0), pfd.Scene(load_friction=[MU]))
    run = sim.rollout(np.full((100, 1), share * weight))
    # Friction is against the motion: towards the motor's torque, if the weight falls.
    force = share * weight * (1 - moves * MU) - weight if moves else 0.0
    np.testing.assert_allclose(run.q[-1], [force * 0.1**2 / 2], rtol=1e-9, atol=0.0)


def test_a_weight_breaks_away_where_the_falling_torque_of_its_motor_lets_it() -> None:
    # The weight sinks once tau (1 + mu) is below it.
    rate, bound = 3.0, 9.81 / (1 + MU)

    def torque(t: float, q: Array, qd: Array) -> Array:
        return np.array([1.001 * bound - rate * t])

    scene = pfd.Scene(load_friction=[MU])
    motion = pfd.integrate(slider(0.0, 1.0), torque, 0.1, scene=scene, rtol=1e-12, atol=1e-14)
    freed = 0.001 * bound / rate
    np.testing.assert_allclose(motion.events, [freed], rtol=1e-9)
    way = rate * (1 + MU) * (0.1 - freed) ** 3 / 6
    np.testing.assert_allclose(motion.q[-1], [-way], rtol=1e-9)

    # The torque of a motor with lag falls within a step, to 0.9 of that bound.
    lag, end = 0.02, 0.9 * bound
    sim = simulator(slider(0.0, 1.0), pfd.Scene(load_friction=[MU], motor_lag=[lag]))
    sim.reset(tau_motor=[1.1 * bound])
    run = sim.rollout(np.full((50, 1), end))
    excess, t = bound - end, run.time - lag * np.log(2.0)
    way = (1 + MU) * excess * (lag * t + lag**2 * np.expm1(-t / lag) - t**2 / 2)
    np.testing.assert_allclose(run.q[:, 0], np.where(t > 0, way, 0.0), rtol=0, atol=1e-10)


@pytest.mark.long
def test_load_friction_behind_drives_with_stribeck_and_stops_keeps_the_fourth_order() -> None:
    scene = pfd.Scene(
        armature=[0.8, 4.0, 0.8],
        friction=[3.0, 4.0, 1.5],
        static_friction=[6.0, 9.0, 3.0],
        stribeck_velocity=[0.3] * 3,
        load_friction=[0.2, 0.15, 0.1],
        joint_limits=[[-1.0, 1.0], [-0.6, 0.9], [-0.5, 1.5]],
        restitution=0.4,
        gravity_compensation=True,
        effort_limits=[90.0] * 3,
    )
    robot = pfd.load_robot('puma560', locked={f'joint{k}': 0.3 for k in (4, 5, 6)})
    signs = np.array([[1], [-1], [1], [-1]]) * np.array([1, -1, 1])
    taus = np.random.default_rng(5).uniform(0.4, 1, (4, 3)) * [15, 35, 9] * signs
    ends = []
    for h in (2e-3, 1e-3, 5e-4, 1.25e-4):
        sim = simulator(robot, scene, step_size=h, integrator='rk4')
        sim.reset([0.0, 0.2, 0.3], [0.5, -0.5, 1.0])
        ends.append(sim.rollout(np.repeat(taus, round(0.25 / h), axis=0)).q[-1])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] < 1e-8
    assert np.log2(errors[0] / errors[-1]) / 2 > 3.5


def test_accelerations_are_those_of_pinocchio_under_the_torque_that_friction_leaves() -> None:
    robot, rng = pfd.load_robot('planar2'), np.random.default_rng(2)
    mu, dry, most = rng.uniform(0.05, 0.3, 2), rng.uniform(0.1, 1.0, 2), np.full(2, 20.0)
    rotors = np.full(2, 0.5)
    scene = pfd.Scene(armature=rotors, friction=dry, load_friction=mu, effort_limits=most)
    oracle = Oracle(robot, rotors)
    sim = simulator(robot, scene, integrator='rk4')
    for _ in range(20):
        q, qd, tau = rng.uniform(-2, 2, 2), rng.normal(size=2), rng.uniform(-40, 40, 2)
        sim.reset(q, qd)
        sim.step(tau)
        motor = np.clip(tau, -most, most)
        left = motor - np.sign(sim.qd) * (dry + mu * np.abs(motor))
        assert (sim.qd != 0.0).all()
        wanted = oracle.qdd(sim.q, sim.qd, left)
        np.testing.assert_allclose(sim.qdd, wanted, rtol=1e-9, atol=1e-9)
