# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors at the hard cases: bounds, their references, and units."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
import json
from pathlib import Path
from typing import Any

from bridge import (
    record_forward_dynamics,
    record_inverse_dynamics,
    resolve_plant,
    run_program,
)
import mpmath
import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
from tolerances import NOT_ORTHOGONAL, ROUNDED_FRAMES
from zoo import flywheel, to_pinocchio

from benchmarks.cases.problems import CASES, MECHANISMS, ROUNDING, Problem, arm, rods, scaled
from benchmarks.cases.robots import chain
from benchmarks.pages.hard_cases import ARMS, kernel_rows
from benchmarks.peers.answers import (
    first_answer,
    kernel_answer,
    kernel_jacobians,
    peer_jacobians,
)
from benchmarks.references import derivatives
from benchmarks.references.accelerations import (
    DIGITS,
    RMS,
    SPREAD,
    Reference,
    errors,
    kappa_j,
    kappa_s,
    norm,
    predicted,
    reference,
)
from benchmarks.timing import differences
import pfd_core as pfd

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
BY_NAME = {case.name: case for case in CASES}
FAST = (
    'heavy_tip_1e8_planar_n6',
    'collinear_axes_1e-12',
    'wrist_q5_0',
    'slides_3',
)
OFTEN = ('near_stretched_6', 'payload_1e6', 'tiny_tip_1e-18', 'far_base_1km', 'wrench_on_ur5')
SLOW = (pytest.mark.slow,)
LONG = (*SLOW, pytest.mark.long)
# Two evaluations in 50 digits differ by the condition of H, below 1e13 here, times 1e-50, and
# large terms that cancel. A wrong equation or a wrong frame differs in the first digits.
CERTIFICATE = 1e-35
# Errors above their bound at held-out states, as the page says.
MISSED = {('payload_1e6', 'float32'), ('collinear_axes_1e-8_payload_1e4', 'float32')}


@cache
def solved(name: str) -> tuple[Problem, Reference]:
    problem = BY_NAME[name].make()
    return problem, reference(problem)


@cache
def rows(name: str) -> tuple[dict[str, Any], ...]:
    problem, known = solved(name)
    return tuple(kernel_rows(problem, known, kappa_s(problem, known), kappa_j(problem)))


some_cases = pytest.mark.parametrize(
    'name',
    [
        pytest.param(name, marks=() if name in FAST else SLOW if name in OFTEN else LONG)
        for name in BY_NAME
    ],
)


@some_cases
def test_errors_are_within_five_times_what_analysis_predicts(name: str) -> None:
    found = rows(name)
    assert [(row['dtype'], row['refine']) for row in found] == [
        (dtype, refine) for dtype in ROUNDING for refine in (0, 1)
    ]
    assert all(row['share'] is None or row['share'] <= 1 for row in found), found
    # float64 has a bound everywhere; in float32 an estimate may leave no digit.
    assert all(row['share'] is not None for row in found if row['dtype'] == 'float64')


@some_cases
def test_an_error_estimate_is_within_a_factor_of_three_of_a_large_error(name: str) -> None:
    problem, known = solved(name)
    for dtype, u in ROUNDING.items():
        before, estimates = first_answer(problem, dtype)
        with np.errstate(all='ignore'):
            found = np.nan_to_num(differences(before, known.qdd).astype(float), nan=np.inf)
        k = int(np.argmax(found))
        # Of an error above 900 u that leaves a digit.
        if 900 * u < found[k] < 0.1:
            assert 1 / 3 < estimates[k] / found[k] < 3, (dtype, found[k])


@some_cases
def test_two_evaluations_in_other_frames_and_the_missed_torque_certify(name: str) -> None:
    problem, known = solved(name)
    plant, states = problem.plant, problem.states
    other = run_program(
        record_forward_dynamics(plant, 'pcrbm', 'parallel'), states, digits=DIGITS
    )['qdd']
    torques = record_inverse_dynamics(plant, 'parallel')
    needed, bias = (
        run_program(torques, states | {'qdd': x}, digits=DIGITS)['tau']
        for x in (known.qdd, 0 * known.qdd)
    )
    with mpmath.workdps(DIGITS):
        largest = np.abs(states['tau']).max(axis=-1) + np.abs(bias).max(axis=-1)
        residual = np.abs(states['tau'] - needed).max(axis=-1) / largest
        difference = norm(other - known.qdd) / known.scale
    certificate = ROUNDED_FRAMES if name in NOT_ORTHOGONAL else CERTIFICATE
    assert difference.max() < certificate
    assert residual.max() < certificate


def test_every_bound_on_the_page_is_met_but_two_at_held_out_states() -> None:
    data = json.loads((PAGES / 'hard-cases.json').read_text(encoding='utf-8'))['data']
    assert [row['case'] for row in data['cases']] == list(BY_NAME)
    assert len(data['compared']) == len(CASES) + len(MECHANISMS) == 93
    bounded = [row for row in data['errors'] if row.get('share') is not None]
    assert len(bounded) > 400
    missed = [row for row in bounded if row['share'] > 1]
    assert {row['states'] for row in missed} == {'held out'}
    assert {(row['case'], row['dtype']) for row in missed} == MISSED


@pytest.mark.parametrize('dtype', ROUNDING)
@pytest.mark.parametrize(
    ('problem', 'twin'),
    [
        (rods(6, 'yz', base=1000.0), rods(6, 'yz')),
        (scaled(2.0**-20, 2.0**-20), scaled(1.0, 1.0)),
        (scaled(2.0**10, 2.0**30), scaled(1.0, 1.0)),
    ],
    ids=['far base', 'micrometres', 'kilometres'],
)
def test_the_place_of_the_base_and_units_of_powers_of_two_leave_the_bits(
    problem: Problem, twin: Problem, dtype: str
) -> None:
    one, other = (kernel_answer(x, dtype, 1) for x in (problem, twin))
    np.testing.assert_array_equal(one, other)


# At the second one the kernel of the error estimate alone has other bits.
@pytest.mark.parametrize(
    'name', ['wrist_q5_0', pytest.param('heavy_tip_1e8_n12', marks=pytest.mark.slow)]
)
def test_emulated_answers_have_the_bits_of_the_compiled_kernel_and_its_estimate(name: str) -> None:
    problem, _ = solved(name)
    kernel = pfd.compile_kernel(problem.plant.robot, refine=1)
    states = [problem.states[key] for key in ('q', 'qd', 'tau')]
    qdd, _ = kernel.error_estimate(*states)
    answer = kernel_answer(problem, 'float64', 1)
    np.testing.assert_array_equal(answer, kernel(*states))
    np.testing.assert_array_equal(answer, qdd)


def test_auto_refines_coaxial_joints_by_articulated_bodies_for_composite_ones_lose_digits() -> (
    None
):
    for name in ('collinear_axes_1e-12', 'collinear_axes_1e-8_payload_1e4'):
        problem, known = solved(name)
        assert errors(kernel_answer(problem, 'float64', 1), known) < 1e-15
        composite = kernel_answer(problem, 'float64', 1, 'composite_body')
        assert errors(composite, known) > 1e-11


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda', 'planar2'])
def test_the_default_of_an_included_arm_keeps_20_units_of_rounding(name: str) -> None:
    problem = arm(name, 3)
    assert (errors(kernel_answer(problem, 'float64', 0), reference(problem)) <= 2e-15).all()


def test_the_condition_after_jacobi_scaling_is_that_of_pinocchio_s_matrix() -> None:
    for name in ('wrist_q5_0', 'fast_qd_1e6', 'heavy_tip_1e8_n6'):
        problem = BY_NAME[name].make()
        model = to_pinocchio(problem.plant.robot)
        upper = np.triu(pin.crba(model, model.createData(), problem.states['q'][0]))
        H = upper + np.triu(upper, 1).T
        scale = np.diag(H) ** -0.5
        wanted = np.linalg.cond(H * scale * scale[:, None])
        assert kappa_j(problem) == pytest.approx(wanted, rel=1e-6)


def test_a_pendulum_in_closed_form_has_its_structured_condition_number() -> None:
    # J qdd = tau without gravity: relative changes of tau and J add, whatever the state is.
    states = {k: np.full((1, 1), x) for k, x in (('q', 0.3), ('qd', 2.0), ('tau', 5.0))}
    problem = Problem(flywheel(1.0), pfd.Scene(gravity=None), states)
    assert kappa_s(problem, reference(problem)) == pytest.approx(2.0, rel=1e-6)


def test_whole_turns_of_an_angle_are_no_part_of_its_condition() -> None:
    large = rods(6, 'yz', q=1e6)
    within = np.remainder(large.states['q'] + np.pi, 2 * np.pi) - np.pi
    reduced = replace(large, states=large.states | {'q': within})
    one, other = (kappa_s(problem, reference(problem)) for problem in (large, reduced))
    assert one == pytest.approx(other, rel=1e-6)


def test_a_predicted_error_follows_the_formula() -> None:
    u, two, thousand = 2.0**-24, np.array([2.0]), np.array([1e3])
    # 281 operations for 16 numbers, each of a root mean square of 0.4247 u.
    assert pytest.approx(0.4247 * np.sqrt(281 / 16), rel=1e-3) == SPREAD
    rounded = u * (1 + SPREAD * 2)
    for first, rest in ((None, SPREAD * 1e3 * u), (1e-3, 1e-3 * SPREAD * 1e3 * u), (1e-6, 1e-12)):
        estimate = None if first is None else np.array([first])
        found = predicted('float32', two, thousand, estimate)
        assert found == pytest.approx(rounded + rest), first
    assert predicted('float32', two, thousand, np.array([np.inf])) == np.inf
    x = np.exp2(np.random.default_rng(1).uniform(0, 20, 100_000))
    found = (x.astype(np.float32) - x) / x / u
    assert np.sqrt(np.mean(found**2)) == pytest.approx(RMS, rel=0.01)


@pytest.mark.parametrize('name', one_fast(ARMS))
def test_the_wide_reference_has_100_times_the_digits_of_float64(name: str) -> None:
    problem = arm(name, 5)
    found = errors(reference(problem, wide=True).qdd, reference(problem))
    assert 0 < found.max() < 0.01 * ROUNDING['float64']


@pytest.mark.parametrize('name', ['wrench_on_ur5', 'heavy_tip_1e8_planar_n6'])
def test_exact_derivatives_are_central_differences_of_accelerations(name: str) -> None:
    whole, _ = solved(name)
    states = {key: x[:1] for key, x in whole.states.items()}
    J, _ = derivatives.jacobians(whole.plant, states, None)
    program = record_forward_dynamics(whole.plant, 'articulated_body', 'sequential')
    digits, n = 130, J.shape[-2]
    with mpmath.workdps(digits):
        change = mpmath.mpf(10) ** -40
        moves = change * np.vstack([np.eye(3 * n), -np.eye(3 * n)]).astype(object)
        x = np.concatenate([states[key] for key in ('q', 'qd', 'tau')], axis=-1) + moves
        given = dict(zip(('q', 'qd', 'tau'), np.split(x, 3, axis=-1), strict=True))
        given |= {
            key: np.broadcast_to(states[key], (len(x), states[key].shape[-1]))
            for key in program.inputs
            if key not in given
        }
        ahead, behind = np.split(run_program(program, given, digits=digits)['qdd'], 2)
        slope = ((ahead - behind) / (2 * change)).T
        assert np.abs(slope - J[0]).max() < CERTIFICATE * np.abs(J).max()


def test_the_step_of_a_wheel_is_its_closed_form_in_50_digits() -> None:
    inertia, h = 0.3, 2.0**-7
    plant = resolve_plant(flywheel(inertia), pfd.Scene(gravity=None))
    states = {key: np.array([[x]]) for key, x in (('q', 0.5), ('qd', 2.0), ('tau', 3.0))}
    found = derivatives.named(derivatives.jacobians(plant, states, h), h)
    np.testing.assert_array_equal(found['A'][0].astype(float), [[1, 1], [0, 1]])
    with mpmath.workdps(60):
        for row, part in zip(found['B'][0], (0.5, 1.0), strict=True):
            # Velocities are multiplied by h.
            assert abs(row[0] - part * mpmath.mpf(h) ** 2 / mpmath.mpf(inertia)) < 1e-50


@pytest.mark.parametrize('name', [*FAST, *(pytest.param(x, marks=SLOW) for x in OFTEN[:-1])])
def test_derivatives_have_at_most_twice_the_error_of_pinocchio_s_or_four_roundings(
    name: str,
) -> None:
    whole, _ = solved(name)
    problem = replace(whole, states={key: x[:1] for key, x in whole.states.items()})
    h = derivatives.step_length(reference(problem), problem.states)
    exact = derivatives.named(derivatives.jacobians(problem.plant, problem.states, h), h)
    own = derivatives.named(kernel_jacobians(problem, 'float64', 0, h), h)
    peer = peer_jacobians(problem, h)
    assert peer is not None
    for key, matrix in derivatives.named(peer, h).items():
        error, other = (derivatives.errors(x, exact[key]) for x in (own[key], matrix))
        assert error <= max(2 * other, 4 * ROUNDING['float64']), key


def test_in_a_step_no_joint_moves_or_accelerates_further_than_its_limit() -> None:
    for name in ('wrist_q5_0', 'fast_qd_1e6', 'tiny_tip_1e-18'):
        problem, known = solved(name)
        h = derivatives.step_length(known, problem.states)
        assert np.log2(h) == round(np.log2(h))
        speed, acceleration = (np.abs(x).max() for x in (problem.states['qd'], known.qdd))
        moves = max(h * speed, h**2 * float(acceleration))
        assert moves <= 2.0**-7
        assert h == 2.0**-7 or moves > 2.0**-10


@pytest.mark.sweep
@pytest.mark.parametrize(('dtype', 'bound'), [('float64', 1e-9), ('float32', 0.02)])
def test_a_wheel_keeps_its_angle_for_an_hour_although_turns_use_up_its_digits(
    dtype: str, bound: float
) -> None:
    rate, step, samples = 10.0, 1e-3, 100
    scene = pfd.Scene(gravity=None)
    sim = pfd.Simulator(chain(1, 'y'), scene, step_size=step, substeps=1, dtype=dtype)
    sim.reset((0.0,), (rate,))
    taus = np.zeros((round(3600.0 / step / samples), 1))
    for k in range(samples):
        assert sim.rollout(taus).status == 'ok'
        angle, turns = (mpmath.mpf(float(x[0])) for x in sim.wrapped)
        with mpmath.workdps(30):
            exact = mpmath.mpf(rate) * 3600 * (k + 1) / samples - 2 * mpmath.pi * turns
            assert abs(exact - angle) <= bound
