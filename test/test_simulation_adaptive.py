# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive integration: order conditions of the pair, closed forms, energy, status, bad input."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import cache
from itertools import pairwise
import math
import pickle
from typing import Any

from bridge import EMBEDDED_PAIRS, interpolate_dense
import mpmath
import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
from zoo import random_chain, to_pinocchio

import pfd_core as pfd

DOP853 = EMBEDDED_PAIRS['dop853']
MATRIX, END = np.array(DOP853.tableau.A), DOP853.end
# Sums of products of up to eight coefficients, which are doubles, up to 4e2 and cancel.
ROUNDED_COEFFICIENTS = 1e-12

# Error of an angle over 3 s in units of rtol: what `integrate` promises.
KEPT = 10.0

# Drift of the energy in units of the peak kinetic energy, at two tolerances, over 10 s.
# Seen a fifth of this.
ENERGY_DRIFT = {1e-9: 2e-10, 1e-12: 3e-12}

# A rooted tree is the tuple of the trees on its root.
Tree = tuple[Any, ...]


@cache
def trees(nodes: int) -> frozenset[Tree]:
    """Return the rooted trees with a number of nodes: add a leaf to each node of smaller ones."""
    if nodes == 1:
        return frozenset({()})
    return frozenset(grown for tree in trees(nodes - 1) for grown in with_a_leaf(tree))


def with_a_leaf(tree: Tree) -> Iterator[Tree]:
    yield tuple(sorted((*tree, ())))
    for k, branch in enumerate(tree):
        for grown in with_a_leaf(branch):
            yield tuple(sorted((*tree[:k], grown, *tree[k + 1 :])))


def stage_weights(tree: Tree) -> np.ndarray:
    """Return the elementary weights of a tree at each stage."""
    product = np.ones(len(MATRIX))
    for branch in tree:
        product *= MATRIX @ stage_weights(branch)
    return product


def size_and_density(tree: Tree) -> tuple[int, int]:
    branches = [size_and_density(branch) for branch in tree]
    size = 1 + sum(size for size, _ in branches)
    return size, size * math.prod(density for _, density in branches)


def misfits(weights: np.ndarray, order: int, part: float = 1.0) -> list[float]:
    """Return the error of each order condition of an order, for a step to a part of h."""
    assert len(trees(order)) == [1, 1, 2, 4, 9, 20, 48, 115][order - 1]
    return [
        abs(weights @ stage_weights(tree) - part**order / size_and_density(tree)[1])
        for tree in trees(order)
    ]


def test_the_nodes_are_the_sums_of_the_rows() -> None:
    np.testing.assert_allclose(MATRIX.sum(1), DOP853.tableau.c, rtol=0, atol=1e-13)


@pytest.mark.parametrize('order', range(1, 9))
def test_the_step_meets_all_order_conditions_up_to_order_8(order: int) -> None:
    assert max(misfits(np.array(DOP853.tableau.b), order)) < ROUNDED_COEFFICIENTS


@pytest.mark.parametrize(('estimate', 'order'), [(0, 5), (1, 3)])
def test_an_error_estimate_is_the_difference_to_a_method_of_its_order(
    estimate: int, order: int
) -> None:
    other = MATRIX[END] - DOP853.estimates[estimate]
    for k in range(1, order + 1):
        assert max(misfits(other, k)) < ROUNDED_COEFFICIENTS
    assert max(misfits(other, order + 1)) > 1e-5


@pytest.mark.parametrize('part', [0.0, 0.1, 0.5, 0.77, 1.0])
def test_the_dense_output_meets_all_order_conditions_up_to_order_7(part: float) -> None:
    # With the unit matrix as slopes the rise is the weights.
    first, last = np.eye(len(MATRIX))[[0, END]]
    rise = MATRIX[END]
    rows = np.vstack([rise, first - rise, 2 * rise - (first + last), DOP853.tail])
    weights = interpolate_dense(rows[np.newaxis], np.array([[part]]))[0][0]
    for order in range(1, 8):
        assert max(misfits(weights, order, part)) < 10 * ROUNDED_COEFFICIENTS


def pendulum(swing: float, times: np.ndarray) -> np.ndarray:
    """Return the angle of two rods of 0.5 m in line, released at rest at an angle `swing`."""
    # A rod of length L = 1: theta'' = -3 g / (2 L) sin theta; sin(theta/2) = k cd(w t, k).
    k, w = math.sin(swing / 2), math.sqrt(3 * 9.81 / 2)
    cd = [float(mpmath.ellipfun('cd', w * t, k=k)) for t in times]
    return 2 * np.arcsin(k * np.array(cd))


def swing_with_the_elbow_held(
    duration: float, swing: float = 2.0, **options: Any
) -> pfd.AdaptiveTrajectory:
    return pfd.integrate(
        pfd.load_robot('planar2'),
        np.zeros(2),
        duration,
        scene=pfd.Scene(brakes=True),
        brakes=[False, True],
        q=[-np.pi / 2 + swing, 0.0],
        qd=[0.0, 5.0],
        **options,
    )


def pendulum_errors(run: pfd.Trajectory, swing: float = 2.0) -> np.ndarray:
    return np.abs(run.q[:, 0] + np.pi / 2 - pendulum(swing, run.time))


def test_the_error_falls_with_the_eighth_power_of_the_step() -> None:
    errors = []
    for size in (0.2, 0.1, 0.05):
        # A tolerance that every step meets leaves the largest step.
        run = swing_with_the_elbow_held(6.0, 0.5, rtol=0.5, atol=1e3, max_step=size)
        np.testing.assert_allclose(np.diff(run.time), size, rtol=1e-9)
        # At the same times for all sizes.
        common = pendulum_errors(run, 0.5)[:: round(0.2 / size)]
        errors.append(math.sqrt((common**2).mean()))
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(8, abs=0.2)


@pytest.mark.parametrize('rtol', one_fast([1e-4, 1e-7, 1e-10, 1e-13], 1e-10))
def test_a_pendulum_swings_as_in_its_closed_form_between_the_steps_too(rtol: float) -> None:
    run = swing_with_the_elbow_held(3.0, rtol=rtol, atol=rtol)
    assert run.status == 'ok'
    assert run.time[-1] == 3.0
    assert pendulum_errors(run).max() < KEPT * rtol
    between = run.at(np.linspace(0.0, 3.0, 301)[::-1])
    assert pendulum_errors(between).max() < KEPT * rtol
    for states in (run, between):
        np.testing.assert_array_equal(states.q[:, 1], 0.0)
        np.testing.assert_array_equal(states.qd[:, 1], 0.0)


def test_states_at_the_ends_of_steps_equal_the_run() -> None:
    run = swing_with_the_elbow_held(1.0)
    at_ends = run.at(run.time)
    for name in ('q', 'qd'):
        np.testing.assert_allclose(getattr(at_ends, name), getattr(run, name), atol=1e-14)
    # The derivative of a polynomial that is of size h |qd|, over h.
    np.testing.assert_allclose(at_ends.qdd, run.qdd, rtol=0, atol=1e-10)


@pytest.mark.parametrize('rtol', ENERGY_DRIFT)
def test_the_energy_of_a_swinging_arm_stays_within_the_tolerance(rtol: float) -> None:
    robot = pfd.load_robot('planar2')
    run = pfd.integrate(robot, np.zeros(2), 10.0, q=[-np.pi / 2 + 0.5, 0.2], rtol=rtol)
    model = to_pinocchio(robot)
    data = model.createData()
    kinetic = np.array(
        [pin.computeKineticEnergy(model, data, *row) for row in zip(run.q, run.qd, strict=True)]
    )
    potential = np.array([pin.computePotentialEnergy(model, data, q) for q in run.q])
    total = kinetic + potential
    assert kinetic.max() > 1  # it does swing
    assert np.abs(total - total[0]).max() < ENERGY_DRIFT[rtol] * kinetic.max()


def test_a_torque_law_of_time_and_state_moves_an_arm_as_it_was_computed_to() -> None:
    # The torque that the accelerations of 0.3 + cos(w t) need in the state of the moment.
    robot = random_chain(np.random.default_rng(4), 6)
    w = np.arange(1.0, 7.0)
    q0 = 0.3 + np.ones(6)

    def law(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return pfd.inverse_dynamics(robot, q, qd, -(w**2) * np.cos(w * t))

    run = pfd.integrate(robot, law, 1.0, q=q0, rtol=1e-10)
    np.testing.assert_allclose(run.q, 0.3 + np.cos(np.outer(run.time, w)), atol=1e-8)
    np.testing.assert_allclose(run.qd, -w * np.sin(np.outer(run.time, w)), atol=1e-8)
    np.testing.assert_allclose(run.qdd, -(w**2) * np.cos(np.outer(run.time, w)), atol=1e-7)


@pytest.mark.slow
def test_a_wrench_at_the_tip_acts_as_its_torques() -> None:
    robot = pfd.load_robot('ur5')
    model = to_pinocchio(robot)
    data = model.createData()
    wrench = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])

    def law(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        frame = model.nframes - 1
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        return np.asarray(jacobian.T @ wrench)

    scene = pfd.Scene(external_wrench=True)
    pushed = pfd.integrate(robot, np.zeros(6), 0.5, scene=scene, wrench=wrench)
    driven = pfd.integrate(robot, law, 0.5)
    np.testing.assert_allclose(pushed.q[-1], driven.q[-1], rtol=0, atol=1e-8)


def test_evaluations_are_counted() -> None:
    robot = pfd.load_robot('planar2')
    times: list[float] = []

    def law(t: float, q: np.ndarray, qd: np.ndarray) -> list[float]:
        times.append(t)
        q[:] = qd[:] = 7.0  # a copy
        return [0.5, 0.2]

    for dense, stages in ((True, 15), (False, 12)):
        times.clear()
        run = pfd.integrate(robot, law, 1.0, dense=dense)
        assert run.evaluations == len(times)
        assert run.evaluations == 1 + stages * run.finite_steps + 12 * run.rejected_steps
        assert run.finite_steps == len(run.time) - 1
        constant = pfd.integrate(robot, [0.5, 0.2], 1.0, dense=dense)
        np.testing.assert_array_equal(run.q, constant.q)


def test_the_longest_step_sees_a_pulse_that_an_arm_at_rest_would_step_over() -> None:
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(gravity=None)

    def pulse(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return np.full(2, 4.0 <= t < 4.01)

    over, seen = (
        pfd.integrate(robot, lambda *x: 1.0 * pulse(*x), 10.0, scene=scene, max_step=longest)
        for longest in (np.inf, 0.01)
    )
    np.testing.assert_array_equal(over.q, 0.0)
    assert np.abs(seen.qd[-1]).max() > 1e-3


def not_a_number_after(time: float) -> Callable[..., np.ndarray]:
    return lambda t, q, qd: np.full(2, np.nan if t > time else 0.0)


@pytest.mark.parametrize(
    ('tau', 'steps'),
    [([1e200, 0.0], 0), (lambda t, q, qd: np.full(2, np.nan), 0), (not_a_number_after(0.5), None)],
)
def test_a_number_that_is_not_finite_is_a_status(tau: Any, steps: int | None) -> None:
    run = pfd.integrate(pfd.load_robot('planar2'), tau, 1.0)
    assert run.status == 'not_finite'
    assert np.isfinite(run.q).all()
    assert np.isfinite(run.qd).all()
    if steps is None:
        assert run.time[-1] == pytest.approx(0.5, abs=1e-12)
        assert np.isfinite(run.at([0.25]).q).all()
    else:
        assert run.finite_steps == steps
        with pytest.raises(ValueError, match="no step to look into: status 'not_finite'"):
            run.at([0.0])


def test_a_velocity_that_goes_to_infinity_ends_the_run_at_its_pole() -> None:
    # qdd = qd^2 from qd = 1: qd = 1 / (1 - t).
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(gravity=None)

    def law(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return pfd.inverse_dynamics(robot, q, qd, qd**2, scene=scene)

    run = pfd.integrate(robot, law, 2.0, scene=scene, qd=[1.0, 1.0])
    assert run.status in ('step_too_small', 'not_finite')
    assert run.time[-1] == pytest.approx(1.0, abs=1e-6)
    early = run.at(np.linspace(0.0, 0.9, 10))
    np.testing.assert_allclose(early.qd[:, 0], 1 / (1 - early.time), rtol=1e-6)


def test_a_torque_without_a_limit_of_its_error_is_a_step_too_small() -> None:
    noise = np.random.default_rng(5)
    run = pfd.integrate(
        pfd.load_robot('planar2'), lambda t, q, qd: 1e6 * noise.normal(size=2), 1.0
    )
    assert run.status == 'step_too_small'


def test_the_number_of_steps_is_bounded() -> None:
    robot = pfd.load_robot('planar2')
    run = pfd.integrate(robot, np.zeros(2), 100.0, max_steps=7)
    assert run.status == 'too_many_steps'
    assert run.finite_steps + run.rejected_steps == 7
    assert run.time[-1] < 100.0


def test_an_arm_at_rest_stays_and_takes_few_steps() -> None:
    run = pfd.integrate(pfd.load_robot('planar2'), np.zeros(2), 1e3, scene=pfd.Scene(gravity=None))
    assert run.status == 'ok'
    assert run.finite_steps == 1
    np.testing.assert_array_equal(run.at([0.0, 500.0]).q, 0.0)


def test_a_run_can_be_copied_and_pickled() -> None:
    run = pfd.integrate(pfd.load_robot('planar2'), lambda t, q, qd: [1.0, 0.0], 1.0)
    for twin in (deepcopy(run), pickle.loads(pickle.dumps(run))):
        np.testing.assert_array_equal(twin.at([0.3]).q, run.at([0.3]).q)
        np.testing.assert_array_equal(twin.qdd, run.qdd)
        assert (twin.status, twin.evaluations) == (run.status, run.evaluations)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'robot': 'ur5'}, r"robot must be a Robot, got 'ur5'"),
        ({'tau': [0.0]}, r'tau must have shape \(2,\), got \(1,\)'),
        ({'tau': [0.0, np.nan]}, 'tau must be finite'),
        ({'tau': lambda t, q, qd: [0.0]}, r'tau\(t, q, qd\) must have shape \(2,\), got \(1,\)'),
        ({'tau': lambda t, q, qd: None}, r'tau\(t, q, qd\) must be an array of numbers, got None'),
        ({'duration': 0.0}, 'duration must be above zero, got 0.0'),
        ({'duration': np.inf}, 'duration must be finite, got inf'),
        ({'duration': '1'}, "duration must be a number, got '1'"),
        ({'q': [0.0]}, r'q must have shape \(2,\), got \(1,\)'),
        ({'qd': [0.0, np.inf]}, 'qd must be finite'),
        ({'wrench': np.zeros(6)}, 'external_wrench=False'),
        ({'brakes': [True, True]}, r'Scene\(brakes=True\)'),
        ({'rtol': 1e-16}, 'rtol must be at least 1e-14 and below 1, got 1e-16'),
        ({'rtol': np.nan}, 'rtol must be finite, got nan'),
        ({'atol': 0.0}, 'atol must be above zero, got 0.0'),
        ({'max_step': np.nan}, 'max_step must be above zero, got nan'),
        ({'max_steps': 0}, 'max_steps must be an integer of at least 1, got 0'),
        ({'integrator': 'rk45'}, r"integrator must be one of \('dop853',\), got 'rk45'"),
        ({'method': 'aba'}, "method must be 'auto' or one of .* got 'aba'"),
        ({'refine': 0.5}, 'refine must be an integer of at least 0, got 0.5'),
    ],
)
def test_bad_arguments_are_named(changes: dict[str, Any], message: str) -> None:
    given = {'robot': pfd.load_robot('planar2'), 'tau': np.zeros(2), 'duration': 1.0} | changes
    with pytest.raises(ValueError, match=message):
        pfd.integrate(**given)


@pytest.mark.parametrize(
    ('dense', 'times', 'message'),
    [
        (True, [0.5, 1.5], r'times must lie from 0 to 1 s, got 1.5'),
        (True, [-0.1], r'times must lie from 0 to 1 s, got -0.1'),
        (True, 0.5, r'times must have shape \(M,\), got \(\)'),
        (True, [np.nan], 'times must be finite'),
        (False, [0.5], r'need integrate\(..., dense=True\)'),
    ],
)
def test_bad_times_are_named(dense: bool, times: Any, message: str) -> None:
    run = pfd.integrate(pfd.load_robot('planar2'), np.zeros(2), 1.0, dense=dense)
    with pytest.raises(ValueError, match=message):
        run.at(times)
