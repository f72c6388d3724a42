# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy: the default method, refinement and its estimate, hard cases against 50 digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
import json
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray
from oracle import ACCELERATION, NOT_ORTHOGONAL, ROUNDED_FRAMES, Oracle, jacobi_condition, relative
import pytest
from zoo import one_fast, random_chain, random_state, without_mass

from benchmarks.cases.problems import (
    CASES,
    MECHANISMS,
    ROUNDING,
    Case,
    Problem,
    arm,
    drawing,
    links,
    rods,
    scaled,
)
from benchmarks.cases.problems import problem as states_of
from benchmarks.cases.robots import chain, coaxial, uniform_chain
from benchmarks.cases.robots import robot as robot_called
from benchmarks.pages.hard_cases import (
    COMPARED,
    MANY,
    PEER,
    compared,
    held_out,
    kernel_rows,
    over_limit,
)
from benchmarks.peers.answers import first_answer, kernel_answer, kernel_jacobians, peer_jacobians
from benchmarks.references import derivatives
from benchmarks.references.accelerations import (
    DIGITS,
    Reference,
    errors,
    kappa_j,
    kappa_s,
    norm,
    reference,
)
from benchmarks.timing import differences
import pfd_core as pfd
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.dynamics.refinement import record_error, record_refined
from pfd_core.kernels import auto, lower
from pfd_core.kernels.spec import STEP as STEP_KIND
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.iteration import TOLERANCES as ITERATION_TOLERANCES
from pfd_core.model.plant import Plant
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.newton_euler import record_inverse_dynamics

Array = NDArray[np.float64]
# Forward dynamics of an ordinary arm of six joints errs by up to 16 units of rounding.
LAST_DIGITS = 32 * 2.0**-53
# Five turns on one axis, with small links between.
COAXIAL = links(
    'zzzzzy',
    masses=dict.fromkeys(range(4), 0.0),
    lengths=dict.fromkeys(range(4), 0.0),
    inertias=dict.fromkeys(range(4), 1e-8),
)


def error(problem: Problem, refine: int = 0) -> float:
    """Return the error of the default compared with 50 digits."""
    return float(errors(kernel_answer(problem, 'float64', refine), reference(problem)).max())


@pytest.mark.parametrize('distance', [10.0, 1e6])
def test_a_distance_along_an_axis_to_a_parallel_joint_costs_no_digits(distance: float) -> None:
    problem = links('zzyz', lifts={0: distance})
    assert error(problem) < LAST_DIGITS
    assert error(problem, refine=1) < LAST_DIGITS


@pytest.mark.parametrize(
    'problem', [links('XYZXYZ', masses={5: 1e4}), COAXIAL], ids=['slides', 'turns']
)
def test_the_default_keeps_the_digits_where_pivots_lose_them(problem: Problem) -> None:
    assert auto.roundings(problem.plant, auto.FEW_JOINTS) > 32
    assert error(problem) < LAST_DIGITS


FACTOR, BODIES = auto.FEW_JOINTS, auto.MANY_JOINTS
DERIVATIVES: dict[str, Any] = {'quantity': 'derivatives'}
STEP: dict[str, Any] = {'quantity': STEP_KIND}  # nothing is refined there
WHOLE = pfd.Scene(external_wrench=True, brakes=True)
# A robot, options of its kernel, and the method and the steps of refinement that follow.
SELECTED: list[Any] = [
    # The included arms need no refinement.
    *((pfd.load_robot(name), {}, (FACTOR, 0)) for name in ('puma560', 'ur5')),
    *((pfd.load_robot(name), {}, (BODIES, 0)) for name in ('panda', 'planar2')),
    # With brakes or rotors no row of a grouped articulated body vanishes.
    (pfd.load_robot('panda'), {'scene': pfd.Scene(brakes=True)}, (FACTOR, 1)),
    (pfd.load_robot('planar2'), {'scene': pfd.Scene(armature=[0.1] * 2)}, (FACTOR, 0)),
    # Rods do; a named method is not refined.
    (chain(6, 'y'), {}, (FACTOR, 1)),
    (chain(6, 'y'), {'method': FACTOR}, (FACTOR, 0)),
    # Composite bodies in a step of an arm, articulated bodies for long chains.
    *((pfd.load_robot(name), STEP, (FACTOR, 0)) for name in ('ur5', 'panda')),
    (uniform_chain(16), STEP, (BODIES, 0)),
    (uniform_chain(16), {}, (BODIES, 1)),
    (uniform_chain(20), {'method': FACTOR}, (FACTOR, 0)),
    # Refinement of ordinary arms, and of a joint without mass that only a brake can hold.
    *(
        (pfd.load_robot(name), {'refine': 1, 'scene': scene}, (FACTOR, 1))
        for name in pfd.known_robots()
        for scene in (pfd.Scene(), WHOLE)
    ),
    (
        without_mass(uniform_chain(3), [2]),
        {'refine': 1, 'scene': pfd.Scene(brakes=True)},
        (FACTOR, 1),
    ),
    # The inertia between two joints on one axis is what is left of a diagonal of about 1: below
    # 1e-6 of it, refinement cannot correct the cancelled pivot.
    *(
        (coaxial(inertia), options, (method, options.get('refine', 0)))
        for inertia, method in ((1e-4, FACTOR), (1e-12, BODIES), (1e-18, BODIES))
        for options in (STEP, {'refine': 1})
    ),
    (coaxial(1e-18), {'method': FACTOR, 'refine': 1}, (FACTOR, 1)),
    # Derivatives: of ordinary arms; where the factor of H loses digits; where rounded grouped
    # parameters do, too.
    (robot_called('puma560'), DERIVATIVES, (FACTOR, 0)),
    *(
        pytest.param(robot_called(name), DERIVATIVES, (FACTOR, 0), marks=pytest.mark.slow)
        for name in ('panda', 'ur10')
    ),
    pytest.param(chain(6, 'y'), DERIVATIVES, (BODIES, 0), marks=pytest.mark.slow),
    (coaxial(1e-12), DERIVATIVES, (BODIES, 0)),
    (robot_called('kinova'), DERIVATIVES, (FACTOR, 1)),
    (robot_called('kinova'), DERIVATIVES | {'method': FACTOR}, (FACTOR, 0)),
]


@pytest.mark.parametrize(('robot', 'options', 'wanted'), SELECTED)
def test_the_default_is_the_cheapest_accurate_method(
    robot: pfd.Robot, options: dict[str, Any], wanted: tuple[str, int]
) -> None:
    spec = KernelSpec(robot, **{'scene': pfd.Scene()} | options)
    assert (spec.method, spec.refine) == wanted


def test_units_of_length_and_mass_do_not_change_the_selection() -> None:
    small, plain = (scaled(unit, unit).plant for unit in (2.0**-20, 1.0))
    for method in (auto.FEW_JOINTS, auto.MANY_JOINTS):
        assert auto.roundings(small, method) == auto.roundings(plain, method)


FAST = {'collinear_axes_1e-12', 'planar_ratio_100', 'ordinary_ur5'}
OFTEN = {'near_stretched_6', 'heavy_base_1e8', 'static_hold', 'ordinary_panda'}
OFTEN |= {'lift_1km', 'six_slides_tip_1e2'}
SLOW = (pytest.mark.slow,)
# Chains of 200 joints take a minute each, the other hard cases a minute together.
LONG = (*SLOW, pytest.mark.long)
HELD_OUT = [
    pytest.param(
        case,
        id=case.name,
        marks=()
        if case.name in FAST
        else SLOW
        if case in MECHANISMS or case.name in OFTEN
        else LONG,
    )
    for case in (*CASES, *MECHANISMS)
]


@pytest.mark.parametrize('case', HELD_OUT)
def test_the_default_is_not_the_worse_choice_at_states_that_chose_no_limit(case: Case) -> None:
    row = compared(case.name, held_out(case), ['default'])
    assert (PEER in row) == ('wrench' not in case.name)
    assert over_limit(row) <= 1, row


@pytest.mark.parametrize('name', ['ur5', 'panda'])
def test_in_free_fall_an_arm_is_at_most_four_times_as_inaccurate_as_the_peer(name: str) -> None:
    # Not two times, as elsewhere (docs/decisions/0040-a-default-that-is-not-worse.md).
    with drawing(COMPARED, MANY):
        problem = states_of(pfd.load_robot(name), qd=1.0, tau=0.0)
    assert 0 < over_limit(compared(name, problem, ['default'])) <= 2


# ---- long chains ----


@pytest.mark.parametrize('n', [16, *(pytest.param(n, marks=LONG) for n in (30, 100, 200))])
def test_a_long_chain_agrees_with_pinocchio(n: int) -> None:
    rng = np.random.default_rng(n)
    kernel = pfd.compile_kernel(random_chain(rng, n))
    assert kernel.method == auto.MANY_JOINTS
    assert '@part1.1(' in kernel.ir
    oracle = Oracle(kernel.robot)
    for _ in range(3):
        q, qd, tau = random_state(rng, n)
        tolerance = ACCELERATION * jacobi_condition(oracle.H(q))
        assert relative(kernel(q, qd, tau), oracle.qdd(q, qd, tau)) < tolerance


def fifty_digits(plant: Plant, inputs: dict[str, Array], method: str) -> Any:
    """Return qdd to 50 digits."""
    return run_program(record_forward_dynamics(plant, method, 'sequential'), inputs, digits=50)[
        'qdd'
    ]


def relative_error(found: Array, right: Any) -> Array:
    """Return max |difference| / max |reference| of each state; infinity for NaN."""
    sound = np.isfinite(found).all(axis=-1)
    difference = np.abs(np.where(sound[:, None], found, 0.0).astype(object) - right)
    errors = (difference.max(axis=-1) / np.abs(right).max(axis=-1)).astype(np.float64)
    return np.where(sound, errors, np.inf)


# What a refined answer is off by, in units of rounding: the last addition, and the change of the
# answer with its inputs' last digits, which is 1 to 20 of them in these cases. Seen up to 18.
LAST_ROUNDINGS = 100.0


def emulated(
    plant: Plant, method: str, steps: int, dtype: str, states: dict[str, Array]
) -> tuple[Array, Array]:
    """Return qdd, (B, n), and its estimated error, (B,), as kernels compute them."""
    stop = ITERATION_TOLERANCES[dtype]
    with np.errstate(all='ignore'):
        recorded = record_refined(plant, method, steps, stop)
        qdd = run_program(lower.lower(recorded, dtype, ['qdd']).compiled, states, dtype)['qdd']
        program = lower.lower(record_error(plant, method, dtype, stop), dtype).compiled
        error = run_program(program, states | {'qdd': qdd}, dtype)['error']
    return qdd, error[:, 0].astype(np.float64)


EVERYTHING = pfd.Scene(
    damping='model',
    armature='model',
    external_wrench=True,
    brakes=True,
    payload=pfd.Payload(2.0, (0.1, 0.0, 0.1)),
)


@pytest.mark.parametrize('method', pfd.METHODS)
@pytest.mark.slow
def test_every_method_is_refined_in_a_scene_with_everything(method: str) -> None:
    rng = np.random.default_rng(3)
    n = 4
    kinds = ['revolute', 'prismatic', 'continuous', 'revolute']
    plant = resolve_plant(random_chain(rng, n, joint_types=kinds), EVERYTHING)
    inputs = {k: rng.uniform(-2, 2, (3, n)) for k in ('q', 'qd', 'tau')}
    inputs |= {
        'wrench': rng.normal(size=(3, 6)),
        'free': np.array([[1, 1, 1, 1], [1, 0, 1, 1]])[[0, 1, 1]],
    }
    other = 'pcrbm' if method == 'articulated_body' else 'articulated_body'
    right = fifty_digits(plant, inputs, other)
    qdd, estimates = emulated(plant, method, 1, 'float64', inputs)
    errors = relative_error(qdd, right)
    assert errors.max() <= LAST_ROUNDINGS * ROUNDING['float64']
    assert (qdd[1:, 1] == 0).all()
    assert (estimates < 1e-13).all()


@pytest.mark.sweep
@pytest.mark.parametrize('dtype', ROUNDING)
@pytest.mark.parametrize(('name', 'steps'), [('chain', 2), ('planar2', 1)])
def test_kernel_batch_emulator_and_estimate_give_the_same_bits(
    name: str, steps: int, dtype: str
) -> None:
    robot = chain_of(3, 0.5) if name == 'chain' else pfd.load_robot(name)
    kernel = pfd.compile_kernel(robot, method='composite_body', dtype=dtype, refine=steps)
    q, qd, tau = np.random.default_rng(2).uniform(-3, 3, (3, 21, robot.n)).astype(dtype)
    found = kernel(q, qd, tau)
    (wanted,) = run_program(kernel.program, {'q': q, 'qd': qd, 'tau': tau}, dtype).values()
    np.testing.assert_array_equal(found, wanted)
    again, errors = kernel.error_estimate(q, qd, tau)
    np.testing.assert_array_equal(again, found)
    assert (errors.shape, errors.dtype) == ((21,), dtype)
    for k in range(3):
        np.testing.assert_array_equal(kernel(q[k], qd[k], tau[k]), found[k])
        one, error = kernel.error_estimate(q[k], qd[k], tau[k])
        np.testing.assert_array_equal(one, found[k])
        assert error == errors[k]
    assert (errors < 1600 * ROUNDING[dtype]).all()


@pytest.mark.parametrize('name', one_fast(['ur5', 'panda', 'puma560']))
def test_a_step_costs_one_recursion_and_one_solve_and_at_most_1_6_times_an_answer(
    name: str,
) -> None:
    # Luh, Walker and Paul as Lee and Chang 1987 count them, 137 n - 22 and 101 n - 11, and the
    # factors once forward and once back, n (n - 1) each way, n products with the pivots; n
    # differences, n additions. Signs are free, and nothing is divided again.
    plant = resolve_plant(pfd.load_robot(name))
    n, work = plant.robot.n, []
    for steps in (0, 1):
        recorded = record_refined(plant, 'composite_body', steps)
        counts = lower.operations(lower.lower(recorded, 'float64', ['qdd']).compiled)
        assert counts['div'] <= n
        work.append(sum(counts.values()) - counts['neg'])
    recursion, solve = (137 * n - 22) + (101 * n - 11), 2 * n * (n - 1) + n
    assert 0 < work[1] - work[0] <= recursion + solve + 2 * n
    assert name == 'puma560' or work[1] <= 1.6 * work[0]


def test_an_arm_at_rest_without_load_has_no_error_and_a_massless_end_an_infinite_one() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=pfd.Scene(gravity=None), refine=1)
    qdd, error = kernel.error_estimate(*np.zeros((3, 2)))
    assert not qdd.any()
    assert error == 0
    plant = resolve_plant(without_mass(uniform_chain(3), [2]))
    inputs = {k: np.full((1, 3), 0.3) for k in ('q', 'qd', 'tau')}
    for method in ('composite_body', 'articulated_body'):
        assert emulated(plant, method, 1, 'float64', inputs)[1] == np.inf


# ---- the error estimate over random states ---------------------------------------------------


def chain_of(n: int, slides: float = 0.3) -> pfd.Robot:
    """Return a random chain of n joints."""
    return random_chain(np.random.default_rng(n), n, slides)


def near_and_far(robot: pfd.Robot, count: int, dtype: str, scene: Any = None) -> dict[str, Array]:
    """Return ordinary states and as many with tau near the bias, in numbers of a format."""
    rng = np.random.default_rng(501)
    q, qd, tau = (rng.uniform(-s, s, (count, robot.n)) for s in (np.pi, 2.0, 10.0))
    bias = pfd.compile_kernel(robot, quantity='bias_torques', scene=scene)(q, qd)
    near = bias * (1.0 + 10.0 ** -rng.integers(1, SHARES[dtype], (count, 1)))
    states = {
        'q': np.tile(q, (2, 1)),
        'qd': np.tile(qd, (2, 1)),
        'tau': np.concatenate([tau, near]),
    }
    return {name: x.astype(dtype) for name, x in states.items()}


# Shares by which tau is off the bias: 10^-k with k below this.
SHARES = {'float64': 15, 'float32': 7}
# The correction is solved for with the digits of the number format, from a residual with nearly
# twice as many. Seen from 0.986 to 1.02 over 1920 ordinary states of these and ten more arms.
CLOSE = 1.05
ORDINARY = [
    *(
        pytest.param(arm, id=name)
        for name, arm in {
            'planar2': partial(pfd.load_robot, 'planar2'),
            'chain1': partial(chain_of, 1),
        }.items()
    ),
    *(
        pytest.param(arm, id=name, marks=pytest.mark.slow)
        for name, arm in {
            'ur5': partial(pfd.load_robot, 'ur5'),
            'panda': partial(pfd.load_robot, 'panda'),
            'puma560': partial(pfd.load_robot, 'puma560'),
            **{f'chain{n}': partial(chain_of, n) for n in (2, 3, 5)},
            **{f'turning{n}': partial(chain_of, n, 0.0) for n in (4,)},
        }.items()
    ),
]


@pytest.mark.parametrize(
    'method', ['auto', *(pytest.param(m, marks=pytest.mark.long) for m in pfd.METHODS)]
)
@pytest.mark.parametrize('arm', ORDINARY)
def test_the_estimate_is_within_5_percent_of_the_error_of_the_result_refined_or_not(
    arm: Callable[[], pfd.Robot], method: str
) -> None:
    robot = arm()
    plant = resolve_plant(robot)
    for dtype in ROUNDING:
        states = near_and_far(robot, 20, dtype)
        exact = {name: x.astype(np.float64) for name, x in states.items()}
        right = pfd.emulate(robot, **exact, digits=50).qdd
        for refine in (0, 1):
            name, steps = auto.select(plant, method, refine)
            qdd, estimates = emulated(plant, name, steps, dtype, states)
            ratio = estimates / relative_error(qdd, right)
            assert (ratio[:20] <= CLOSE).all(), (dtype, refine, ratio)
            assert (ratio[:20] >= 1 / CLOSE).all(), (dtype, refine, ratio)
            assert (ratio <= EITHER_WAY).all(), (dtype, refine, ratio)
            assert (ratio >= 1 / EITHER_WAY).all(), (dtype, refine, ratio)


# Largest ratio of estimate and error near equilibrium, and of hard arms elsewhere, either way.
EITHER_WAY = 3.0


PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
BY_NAME = {case.name: case for case in CASES}
FIRST = ('collinear_axes_1e-12', 'slides_3')
SECOND = (
    'wrist_q5_0',
    'heavy_tip_1e8_planar_n6',
    'near_stretched_6',
    'payload_1e6',
    'tiny_tip_1e-18',
    'far_base_1km',
    'wrench_on_ur5',
)
# Two evaluations in 50 digits differ by the condition of H, below 1e13 here, times 1e-50, and
# large terms that cancel. A wrong equation or a wrong frame differs in the first digits.
CERTIFICATE = 1e-35
# Errors above their bound at held-out states, as the page says.
MISSED = {('payload_1e6', 'float32'), ('collinear_axes_1e-8_payload_1e4', 'float32')}


@cache
def solved(name: str) -> tuple[Problem, Reference]:
    problem = BY_NAME[name].make()
    return problem, reference(problem)


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(name, marks=() if name in FIRST else SLOW if name in SECOND else LONG)
        for name in BY_NAME
    ],
)
def test_a_hard_case_has_errors_and_estimates_as_analysis_predicts_and_a_reference_that_holds(
    name: str,
) -> None:
    problem, known = solved(name)
    rows = kernel_rows(problem, known, kappa_s(problem, known), kappa_j(problem))
    wanted = [(dtype, refine) for dtype in ROUNDING for refine in (0, 1)]
    assert [(row['dtype'], row['refine']) for row in rows] == wanted
    # A share is of five times the prediction.
    assert all(row['share'] is None or row['share'] <= 1 for row in rows), rows
    # float64 has a bound everywhere; in float32 an estimate may leave no digit.
    assert all(row['share'] is not None for row in rows if row['dtype'] == 'float64')
    for dtype, u in ROUNDING.items():
        before, estimates = first_answer(problem, dtype)
        with np.errstate(all='ignore'):
            off = np.nan_to_num(differences(before, known.qdd).astype(float), nan=np.inf)
        k = int(np.argmax(off))
        # Of an error above 900 u that leaves a digit.
        if 900 * u < off[k] < 0.1:
            assert 1 / 3 < estimates[k] / off[k] < 3, (dtype, off[k])
    # Two evaluations in other frames, and the torque that the reference misses.
    plant, states = problem.plant, problem.states
    program = record_forward_dynamics(plant, 'pcrbm', 'parallel')
    other = run_program(program, states, digits=DIGITS)['qdd']
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
    assert max(difference.max(), residual.max()) < certificate


def test_every_bound_on_the_page_is_met_but_two_at_held_out_states() -> None:
    data = json.loads((PAGES / 'hard-cases.json').read_text(encoding='utf-8'))['data']
    assert [row['case'] for row in data['cases']] == list(BY_NAME)
    assert len(data['compared']) == len(CASES) + len(MECHANISMS) == 93
    bounded = [row for row in data['errors'] if row.get('share') is not None]
    assert len(bounded) > 400
    missed = [row for row in bounded if row['share'] > 1]
    assert {row['states'] for row in missed} == {'held out'}
    assert {(row['case'], row['dtype']) for row in missed} == MISSED


@pytest.mark.sweep
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


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda', 'planar2'])
def test_the_default_of_an_included_arm_keeps_20_units_of_rounding(name: str) -> None:
    problem = arm(name, 3)
    assert (errors(kernel_answer(problem, 'float64', 0), reference(problem)) <= 2e-15).all()


@pytest.mark.parametrize(
    'name', [FIRST[1], *(pytest.param(x, marks=LONG) for x in (FIRST[0], *SECOND[:-1]))]
)
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
