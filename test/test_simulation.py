# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time: the same bits step by step, in a rollout and on the emulator; energy; convergence."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import pairwise
import math
import operator
from typing import Any

from bridge import TABLEAUX
import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
from zoo import random_chain, to_pinocchio

import pfd_core as pfd

INTEGRATORS = tuple(TABLEAUX)

# Of three joints, so strong that the implicit stages change a step in its first digits.
DAMPING = np.array([50.0, 10.0, 200.0])

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


class ExactLoss:
    """Sums q + dq with the loss of one added to the next dq, by rational numbers."""

    def __init__(self) -> None:
        self.low = np.zeros(3)

    def __call__(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        y = dq + self.low
        total: np.ndarray = q + y
        exact = [[Fraction(float(x)) for x in row] for row in (q, y, total)]
        self.low = np.array([float(a + b - s) for a, b, s in zip(*exact, strict=True)])
        return total


def after(x: np.ndarray, h: float, factors: Any, rows: list[np.ndarray]) -> np.ndarray:
    """Return x + (h w) row + ..., without factors w of zero."""
    for w, row in zip(factors, rows, strict=False):
        x = x + row * (h * w) if w else x
    return x


class Step:
    """A step of an integrator on NumPy, from its tableau, in the order of the native code."""

    def __init__(self, integrator: str, h: float, damping: np.ndarray, compensated: bool) -> None:
        self.tableau, self.h, self.damping = TABLEAUX[integrator], h, damping
        self.advance: Any = ExactLoss() if compensated else operator.add
        self.shared: np.ndarray | None = None

    def explicit(self, f: Any, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the end of a step of q'' = f(q, q')."""
        t, h = self.tableau, self.h
        K = [f(q, qd) if self.shared is None else self.shared]
        for c, A, A_bar in zip(t.c[1:], t.A[1:], t.A_bar[1:], strict=True):
            dq = after(qd * (h * c), h * h, A_bar, K)
            K.append(f(q + dq, after(qd, h, A, K)))
        self.shared = K[-1] if t.shared else None
        dq = after(qd * h, h * h, t.b_bar, K)
        return self.advance(q, dq), after(qd, h, t.b, K)

    def implicit(
        self, f: Any, solve: Any, q: np.ndarray, qd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the end of a step of ARS(2, 2, 2); solve(q, y) = (H + c h D)^-1 y."""
        h, D, c, d = self.h, self.damping, self.tableau.implicit, self.tableau.b[0]
        a = f(q, qd)
        w = after(qd, h, [c], [a])
        x = solve(q + qd * (h * c), w * D)
        v1 = w - x * (h * c)
        a1 = f(q + v1 * (h * c), v1)
        w = after(qd, h, [d, 1 - d, c - 1], [a, a1, x])
        y = solve(after(q, h, [d, 1 - d], [qd, v1]), w * D)
        v2 = w - y * (h * c)
        return self.advance(q, v1 * (h * (1 - c)) + v2 * (h * c)), v2


@pytest.mark.parametrize('compensated', one_fast([False, True], True))
@pytest.mark.parametrize('integrator', INTEGRATORS)
def test_native_steps_are_the_tableau_on_numpy_bit_for_bit(
    integrator: str, compensated: bool
) -> None:
    robot = random_chain(np.random.default_rng(2), 3)
    scene = pfd.Scene(damping=DAMPING, armature=np.full(3, 0.1))
    step_size, substeps = 2e-3, 2
    settings = {'step_size': step_size, 'substeps': substeps, 'compensated': compensated}
    sim = pfd.Simulator(robot, scene, integrator=integrator, **settings)
    tableau, h = TABLEAUX[integrator], step_size / substeps
    undamped = replace(scene, damping=None)
    heavier = replace(undamped, gravity=None, armature=tableau.implicit * h * DAMPING + 0.1)
    kernel, explicit, heavy = (
        pfd.compile_kernel(robot, method='composite_body', scene=x)
        for x in (scene, undamped, heavier)
    )
    step = Step(integrator, h, DAMPING, compensated)
    q, qd = np.zeros(3), np.zeros(3)
    for tau in np.random.default_rng(3).normal(size=(20, 3)):
        sim.step(tau)
        # A new torque: the step begins with an acceleration of its own.
        step.shared = None
        for _ in range(substeps):
            if tableau.implicit:
                functions = partial(explicit, tau=tau), lambda q, y: heavy(q, np.zeros(3), y)
                q, qd = step.implicit(*functions, q, qd)
            else:
                q, qd = step.explicit(partial(kernel, tau=tau), q, qd)
        np.testing.assert_array_equal(sim.q, q)
        np.testing.assert_array_equal(sim.qd, qd)
        np.testing.assert_array_equal(sim.qdd, kernel(q, qd, tau))


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


def test_a_pendulum_swings_as_its_equation_says() -> None:
    # With the second rod held in line, a rod of length 2 l: theta'' = -3 g / (2 2 l) sin theta.
    sim = pfd.Simulator(pfd.load_robot('planar2'), pfd.Scene(brakes=True), substeps=1)
    hanging, swing, omega = -np.pi / 2, 1e-4, np.sqrt(3 * 9.81 / (4 * 0.5))
    sim.reset(q=[hanging + swing, 0.0])
    trajectory = sim.rollout(np.zeros((2000, 2)), brakes=[False, True])
    expected = hanging + swing * np.cos(omega * trajectory.time)
    # The period of a pendulum grows by swing^2 / 16.
    np.testing.assert_allclose(trajectory.q[:, 0], expected, rtol=0, atol=swing**2)
    np.testing.assert_array_equal(trajectory.q[:, 1], 0.0)
    np.testing.assert_array_equal(trajectory.qd[:, 1], 0.0)


def test_accelerations_are_read_later_as_they_were() -> None:
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(external_wrench=True, brakes=True)
    kernel = pfd.compile_kernel(robot, method='composite_body', scene=scene)
    sim = pfd.Simulator(robot, scene)
    taus, wrench = np.full((4, 2), 0.5), np.full(6, 0.25)
    given, pushed = taus.copy(), wrench.copy()
    trajectory = sim.rollout(given, pushed, brakes=[True, False])
    given[:], pushed[:] = 7.0, 8.0
    sim.step([1.0, 2.0], np.zeros(6))
    for k in range(4):
        state = trajectory.q[k], trajectory.qd[k], taus[k], wrench
        np.testing.assert_array_equal(trajectory.qdd[k], kernel(*state, brakes=[True, False]))
    sim.reset()
    np.testing.assert_array_equal(sim.qdd, 0.0)


def test_time_does_not_drift() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=1e-3)
    sim.reset(time=5.0)
    sim.rollout(np.zeros((700, 2)))
    for _ in range(300):
        sim.step([0.0, 0.0])
    assert sim.time == 5.0 + 1000 * 1e-3


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


def test_no_steps_give_an_empty_trajectory() -> None:
    trajectory = pfd.Simulator(pfd.load_robot('planar2')).rollout(np.zeros((0, 2)))
    assert trajectory.q.shape == (0, 2)
    assert trajectory.status == 'ok'


@pytest.mark.parametrize('kind', [pfd.Simulator, partial(pfd.Ensemble, size=2)])
def test_what_native_code_was_made_for_cannot_be_changed(kind: Any) -> None:
    sim = kind(pfd.load_robot('planar2'))
    names = ('robot', 'scene', 'step_size', 'substeps', 'integrator', 'method', 'dtype')
    for name in (*names, 'compensated', *(['size'] if sim.batch else [])):
        before = getattr(sim, name)
        with pytest.raises(AttributeError, match=name):
            setattr(sim, name, before)


def test_the_state_handed_out_is_a_copy() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'))
    sim.q[:] = 7.0
    np.testing.assert_array_equal(sim.q, 0.0)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'step_size': 0.0}, 'step_size must be above zero seconds, got 0.0'),
        ({'step_size': np.nan}, 'step_size must be finite, got nan'),
        ({'substeps': 0}, 'substeps must be an integer of at least 1, got 0'),
        ({'substeps': 1.5}, 'substeps must be an integer of at least 1, got 1.5'),
        (
            {'substeps': 2**64 + 2},
            'substeps must be an integer from 1 to 100000, got 18446744073709551618',
        ),
        ({'substeps': 10**8}, 'substeps must be an integer from 1 to 100000, got 100000000'),
        ({'integrator': 'euler'}, "integrator must be one of .* got 'euler'"),
        ({'method': 'aba'}, "method must be 'auto' or one of .* got 'aba'"),
        ({'dtype': 'float16'}, "dtype must be one of .* got 'float16'"),
        ({'refine': 0.5}, 'refine must be an integer of at least 0, got 0.5'),
        ({'refine': 2**64}, 'refine must be an integer from 0 to 16, got 18446744073709551616'),
    ],
)
def test_bad_settings_are_named(options, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        pfd.Simulator(pfd.load_robot('planar2'), **options)


@pytest.mark.parametrize(
    ('act', 'message'),
    [
        (lambda s: s.reset(q=[0.0]), r'q must have shape \(2,\), got \(1,\)'),
        (lambda s: s.reset(qd=[0.0, np.inf]), 'qd must be finite'),
        (lambda s: s.reset(time=np.nan), 'time must be finite, got nan'),
        (lambda s: s.step([0.0]), r'tau must have shape \(2,\), got \(1,\)'),
        (lambda s: s.step('push'), "tau must be an array of numbers, got 'push'"),
        (lambda s: s.step([0.0, 0.0], np.zeros(6)), 'external_wrench=False'),
        (lambda s: s.step([0.0, 0.0], brakes=[True, True]), r'Scene\(brakes=True\)'),
        (lambda s: s.rollout(np.zeros(2)), r'taus must have shape \(steps, 2\), got \(2,\)'),
        (lambda s: s.rollout([[0.0, np.nan]]), 'taus must be finite'),
    ],
)
def test_bad_calls_are_named_and_change_nothing(act, message: str) -> None:  # type: ignore[no-untyped-def]
    sim = pfd.Simulator(pfd.load_robot('planar2'))
    sim.step([1.0, 1.0])
    before = sim.q, sim.qd, sim.time
    with pytest.raises(ValueError, match=message):
        act(sim)
    np.testing.assert_array_equal(sim.q, before[0])
    np.testing.assert_array_equal(sim.qd, before[1])
    assert sim.time == before[2]
