# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of programs and of forward dynamics: rules, differences in 50 digits, Pinocchio."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from itertools import product
from typing import Any

from bridge import (
    DERIVATIVE_MODES,
    OPERATIONS,
    Lanes,
    Plant,
    Recorder,
    derivative_program,
    directional_program,
    fold_program,
    fuse_program,
    lane_cos,
    lane_sin,
    lane_sqrt,
    lane_where,
    lower_program,
    program_operations,
    record_derivatives,
    record_forward_dynamics,
    resolve_plant,
    run_program,
)
from derivative_programs import record_acceleration_derivatives
import mpmath
import numpy as np
from numpy.typing import ArrayLike
from oracle import Oracle, chains, relative
import pytest
from sampling import one_fast
from tolerances import FIFTY_DIGITS
from zoo import Array, random_chain, random_state, without_mass

from benchmarks.cases.robots import coaxial
from benchmarks.cases.robots import robot as robot_called
import pfd_core as pfd


def differences(
    program: pfd.Program,
    inputs: Mapping[str, ArrayLike],
    output: str,
    name: str,
    step: str = '1e-16',
    digits: int = 50,
) -> Any:
    """
    Return the derivatives of an output with respect to an input, (..., elements of the input).

    What is cut off are third derivatives times the square of the step.
    """
    with mpmath.workdps(digits):
        change = mpmath.mpf(step)
        n = program.inputs[name]
        moves = np.array([[change * (i == j) for j in range(n)] for i in range(n)])
        at = {
            key: np.broadcast_to(np.asarray(inputs[key], dtype=object), (2 * n, size))
            for key, size in program.inputs.items()
        }
        at[name] = at[name] + np.concatenate([moves, -moves])
        values = run_program(program, at, digits=digits)[output]
        return np.moveaxis((values[:n] - values[n:]) / (2 * change), 0, -1)


RULES = [name for name, row in OPERATIONS.items() if row.partials or name == 'select']
# Central differences over 1e-16 on 50 digits: 1e-32 are cut off, 1e-34 rounded.
RULE_DIFFERENCES = 1e-28
in_both_modes = pytest.mark.parametrize('mode', DERIVATIVE_MODES)


def recorded(size: int, function: Callable[..., Any]) -> pfd.Program:
    """Return the program of y = function(*x), x of the given size, y one value or several."""
    recorder = Recorder(1, 'sequential')
    values = function(*(recorder.input('x', [k]) for k in range(size)))
    values = values if isinstance(values, tuple) else (values,)
    recorder.output('y', (len(values),), [(recorder.lift(value), 0) for value in values])
    return recorder.program()


def jacobian(program: pfd.Program, x: Any, mode: str, digits: int | None = 50) -> Any:
    made = derivative_program(program, ['y'], ['x'], mode)
    return run_program(made, {'x': x}, digits=digits)['d y/d x']


def close(found: Any, wanted: Any, tolerance: float = RULE_DIFFERENCES) -> bool:
    with mpmath.workdps(50):
        return bool(np.abs(found - wanted).max() <= tolerance * max(1, np.abs(wanted).max()))


@pytest.mark.sweep
@in_both_modes
@pytest.mark.parametrize('op', RULES)
def test_each_rule_agrees_with_differences_for_inputs_equal_operands_and_constants(
    op: str, mode: str
) -> None:
    x = [mpmath.mpf('0.7'), mpmath.mpf('1.9'), mpmath.mpf('1.3' if op == 'sqrt' else '-1.3')]
    for choice in product([0, 1, 2, 0.0, 1.0, -1.0, 2.5], repeat=OPERATIONS[op].arity):
        # Integers are inputs, of which there is one at least.
        by_zero = op == 'div' and str(choice[1]) == '0.0'
        if by_zero or all(isinstance(c, float) for c in choice):
            continue

        def function(*inputs: Lanes, choice: tuple[float, ...] = choice) -> Lanes:
            recorder = inputs[0].recorder
            operands = [inputs[c] if isinstance(c, int) else recorder.lift(c) for c in choice]
            return recorder.apply(op, *operands)

        program = recorded(3, function)
        assert close(jacobian(program, x, mode), differences(program, {'x': x}, 'y', 'x')), choice


def test_all_arithmetic_has_derivatives() -> None:
    assert set(RULES) == {row.name for row in OPERATIONS.values() if row.meaning is not None}


@in_both_modes
def test_a_select_has_the_derivative_of_the_operand_it_selects_and_none_of_its_condition(
    mode: str,
) -> None:
    program = recorded(2, lambda c, x: (lane_where(c, c * c + 3.0 * c, 5.0 * c) + x, x))
    for c, slope in ((2.0, 7.0), (0.0, 5.0), (-2.0, 5.0)):
        found = jacobian(program, [c, 3.0], mode, digits=None)
        np.testing.assert_array_equal(found, [[slope, 1.0], [0.0, 1.0]])


def all_operations(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return composite functions of all operations, with shared parts, for |x| < 1."""
    root = lane_sqrt(1.0 - x * x) + y
    angle = z * root / (3.0 + lane_sin(x * y))
    first = lane_cos(angle) * lane_sin(angle) - lane_where(z, angle * z, -z)
    return first, first * first + root * 0.25, -(y / root) + 2.0, x, root - root + 1.5


def sums(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return sums of products that fuse in every way, of operands that depend on all inputs."""
    a, b, c = lane_sin(x) + y, x / y, lane_sqrt(x * x + y) + z
    p = b * a
    fused = (a * b + c, c + a * c, b * c - a, c - a * a, a * b - b * c, a * a - b * b)
    return *fused, a * c + a, 1.0 - 3.0 * b, 2.5 * a - (b * -1.0 + c), p + p, p - c, c - p


@pytest.mark.parametrize('passes', ['recorded', 'folded', 'fused'])
@pytest.mark.parametrize('function', [all_operations, sums])
def test_composite_functions_agree_with_differences_and_both_modes_with_each_other(
    function: Callable[..., Any], passes: str
) -> None:
    program = recorded(3, function)
    if passes != 'recorded':
        program = (
            fold_program(program) if passes == 'folded' else fuse_program(fold_program(program))
        )
    for x in (['0.3', '1.2', '-0.8'], ['-0.6', '2.1', '0.9']):
        point = [mpmath.mpf(v) for v in x]
        tangent, adjoint = (jacobian(program, point, mode) for mode in DERIVATIVE_MODES)
        assert close(tangent, differences(program, {'x': point}, 'y', 'x'))
        assert close(tangent, adjoint, FIFTY_DIGITS)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_the_outputs_keep_their_bits_when_derivatives_are_added(dtype: str) -> None:
    program = recorded(3, all_operations)
    x = np.random.default_rng(1).uniform(0.1, 0.9, (5, 3))
    wanted = run_program(program, {'x': x}, dtype)['y']
    for mode in DERIVATIVE_MODES:
        found = run_program(derivative_program(program, ['y'], ['x'], mode), {'x': x}, dtype)
        assert list(found) == ['y', 'd y/d x']
        np.testing.assert_array_equal(found['y'], wanted)
        assert found['d y/d x'].shape == (5, 5, 3)
        assert found['d y/d x'].dtype == dtype


@in_both_modes
def test_a_program_of_two_thousand_operations_in_a_row_needs_no_recursion(mode: str) -> None:
    def function(x: Lanes) -> Lanes:
        for _ in range(2000):
            x = x + x * x
        return x

    assert jacobian(recorded(1, function), [0.0], mode, digits=None)[0, 0] == 1.0


@pytest.mark.parametrize('modes', list(product(DERIVATIVE_MODES, repeat=2)))
def test_second_derivatives_agree_with_differences_of_the_first_and_are_symmetric(
    modes: tuple[str, str],
) -> None:
    first = derivative_program(recorded(3, all_operations), ['y'], ['x'], modes[0])
    second = derivative_program(first, ['d y/d x'], ['x'], modes[1])
    point = [mpmath.mpf(v) for v in ('0.3', '1.2', '0.8')]
    found = run_program(second, {'x': point}, digits=50)['d d y/d x/d x']
    assert close(found, found.transpose(0, 2, 1), FIFTY_DIGITS)
    assert close(found, differences(first, {'x': point}, 'd y/d x', 'x'))


def test_directional_derivatives_are_products_with_the_jacobian() -> None:
    program = recorded(3, all_operations)
    rng = np.random.default_rng(2)
    x, dx, dy = rng.uniform(0.1, 0.9, 3), rng.normal(size=3), rng.normal(size=5)
    J = jacobian(program, x, 'tangent').astype(float)
    for mode, given, name, wanted in (
        ('tangent', {'x': x, 'd x': dx}, 'd y', J @ dx),
        ('adjoint', {'x': x, 'd y': dy}, 'd x', dy @ J),
    ):
        made = directional_program(program, ['y'], ['x'], mode)
        assert made.inputs == {key: len(value) for key, value in given.items()}
        found = run_program(made, given, digits=50)[name].astype(float)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)


EXACT = ('ur5', 'panda', 'puma560', 'planar2', 'chain4')  # twists whose sine and cosine are exact
STATE = ('q', 'qd', 'tau')
# Central by_differences over STEP at DIGITS: the third derivative times STEP^2 is cut off, and the
# rounding is divided by STEP.
STEP, DIGITS = '1e-20', 60
DIFFERENCES = 1e-35
# Relative to the largest entry. In float64 the rounding of some thousand operations is multiplied
# by the condition number of H, at most 2e3 here; in 50 digits a twist whose sine and cosine are
# rounded to float64 is no rotation, which is the same to first order. Seen up to 5e-14.
ROUNDING = 1e-13


def everything(rng: np.random.Generator, robot: pfd.Robot) -> pfd.Scene:
    """Return a scene with all effects of an instant, whose limits cut off some torques."""
    n = robot.n
    falling = [(0.0, 30.0), (1.0, 20.0), (2.5, 5.0)]
    return pfd.Scene(
        gravity=(1.0, 2.0, -9.0),
        external_wrench=True,
        damping=robot.damping,
        armature=robot.armature,
        brakes=True,
        stiffness=rng.uniform(1.0, 5.0, n),
        rest_position=rng.uniform(-1.0, 1.0, n),
        effort_limits=np.full(n, 25.0),
        torque_speed=[falling if rng.random() < 0.5 else None for _ in range(n)],
        gravity_compensation=bool(rng.random() < 0.5),
    )


def inputs(rng: np.random.Generator, robot: pfd.Robot, scene: pfd.Scene) -> dict[str, Array]:
    """Return a state of the order of one, with a wrench and about a fifth of the joints held."""
    n = robot.n
    q, qd, qdd = random_state(rng, n)
    given = {'q': q, 'qd': qd, 'tau': Oracle(robot).tau(q, qd, qdd)}
    if scene.external_wrench:
        given['wrench'] = rng.normal(size=6) * 10
    if scene.brakes:
        given['free'] = 1.0 - (rng.random(n) < 0.2)
        given['free'][rng.integers(n)] = 1.0
    return given


def by_differences(robot: pfd.Robot, scene: pfd.Scene, given: dict[str, Array]) -> Any:
    """Return differences by_differences of qdd by q, qd and tau, (n, 3 n), on mpmath numbers."""
    program = record_forward_dynamics(resolve_plant(robot, scene), 'composite_body', 'sequential')
    parts = [differences(program, given, 'qdd', name, STEP, DIGITS) for name in STATE]
    return np.concatenate(parts, axis=1)


def derivatives(
    robot: pfd.Robot, scene: pfd.Scene, given: dict[str, Array], **options: Any
) -> Any:
    program = record_acceleration_derivatives(resolve_plant(robot, scene))
    return run_program(program, given, **options)['derivatives']


@cache
def arm(name: str) -> tuple[pfd.Robot, dict[str, Array], Any]:
    """Return a robot, inputs, and 50-digit by_differences there, in gravity alone."""
    robot = robot_called(name)
    given = inputs(np.random.default_rng(41), robot, pfd.Scene())
    return robot, given, by_differences(robot, pfd.Scene(), given)


@pytest.mark.parametrize('name', one_fast(EXACT))
def test_fifty_digits_equal_central_differences_entry_by_entry(name: str) -> None:
    robot, given, wanted = arm(name)
    found = derivatives(robot, pfd.Scene(), given, digits=50)
    assert relative(found, wanted) < DIFFERENCES
    largest = np.abs(wanted).max()
    assert (np.abs(found - wanted) <= DIFFERENCES * (np.abs(wanted) + 1e-3 * largest)).all()


@pytest.mark.slow
@pytest.mark.parametrize('name', [*EXACT, 'dense6', 'chain12'])
def test_a_kernel_has_thirteen_digits_of_the_largest_derivative(name: str) -> None:
    robot, given, wanted = arm(name)
    program = lower_program(
        record_acceleration_derivatives(resolve_plant(robot)), 'float64'
    ).compiled
    found = run_program(program, given)['derivatives']
    assert relative(found, wanted) < ROUNDING
    # Row by row, relative to the largest terms of the sums: an entry that cancels has no digits.
    parts = run_program(record_derivatives(resolve_plant(robot)), given)
    terms = np.abs(parts['X']) @ np.hstack([np.abs(parts['D']), np.eye(robot.n)])
    assert (np.abs(found - wanted).max(axis=1) <= ROUNDING * terms.max(axis=1)).all()


@pytest.mark.parametrize('seed', one_fast(range(8), 3))
def test_chains_in_a_scene_with_everything_equal_central_differences(seed: int) -> None:
    rng = np.random.default_rng([42, seed])
    robot = random_chain(rng, 1 + seed % 6, 0.4)
    scene = everything(rng, robot)
    given = inputs(rng, robot, scene)
    wanted = by_differences(robot, scene, given)
    for options in ({}, {'digits': 50}):
        assert relative(derivatives(robot, scene, given, **options), wanted) < ROUNDING


@pytest.mark.parametrize('name', one_fast(['ur5', 'panda', 'dense6']))
def test_the_derivative_by_tau_is_the_inverse_of_the_inertia_matrix(name: str) -> None:
    robot, given, _ = arm(name)
    parts = run_program(record_derivatives(resolve_plant(robot)), given)
    np.testing.assert_array_equal(parts['X'], parts['X'].T)
    H = Oracle(robot).H(given['q'])
    np.testing.assert_allclose(H @ parts['X'], np.eye(robot.n), atol=1e-12)
    assert 'T' not in parts
    found = derivatives(robot, pfd.Scene(), given)
    np.testing.assert_array_equal(found[:, 2 * robot.n :], parts['X'])
    np.testing.assert_allclose(found[:, : 2 * robot.n], -parts['X'] @ parts['D'], rtol=1e-12)


FACTOR, BODIES = ('composite_body', 0), ('grouped_articulated_body', 0)


def inverse(plant: Plant, how: tuple[str, int], given: dict[str, Array], **options: Any) -> Any:
    return run_program(record_derivatives(plant, *how), given, **options)['X']


def by_unit_torques(plant: Plant, given: dict[str, Array]) -> Any:
    """Return H^-1 in 50 digits: accelerations by unit torques, of parameters as given."""
    program = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    n = plant.robot.n
    still = given | {'qd': np.zeros(n)}
    rest, *columns = (
        run_program(program, still | {'tau': tau}, digits=50)['qdd']
        for tau in (np.zeros(n), *np.eye(n))
    )
    return np.array([column - rest for column in columns]).T


def braked(seed: int) -> tuple[Plant, dict[str, Array]]:
    """Return a chain with rotors and a braked joint, and inputs."""
    rng = np.random.default_rng(seed)
    robot = robot_called('chain4')
    scene = pfd.Scene(brakes=True, armature=rng.uniform(0.1, 1.0, robot.n), external_wrench=True)
    given = inputs(rng, robot, scene)
    given['free'][:] = [1.0, 0.0, 1.0, 1.0]
    return resolve_plant(robot, scene), given


def test_articulated_bodies_and_the_factor_have_the_same_inverse_in_fifty_digits() -> None:
    plant, given = braked(51)
    X, wanted = (inverse(plant, how, given, digits=50) for how in (BODIES, FACTOR))
    np.testing.assert_array_equal(X, X.T)
    assert not X[1].any()
    assert relative(X, wanted) < FIFTY_DIGITS


def test_articulated_bodies_keep_the_inverse_inertia_of_nearly_coaxial_joints() -> None:
    # kappa_J is 7e11: the factor of H has few digits left.
    plant = resolve_plant(coaxial(1e-12))
    given = inputs(np.random.default_rng(53), plant.robot, pfd.Scene())
    wanted = by_unit_torques(plant, given)
    assert relative(inverse(plant, FACTOR, given), wanted) > 1e-8
    assert relative(inverse(plant, BODIES, given), wanted) < 4 * 2.0**-53


def test_braked_joints_have_rows_of_zeros_and_torques_on_them_change_nothing() -> None:
    for rng, robot in chains(8, seed=47):
        scene = everything(rng, robot)
        given = inputs(rng, robot, scene)
        held = given['free'] == 0
        found = derivatives(robot, scene, given)
        assert not found[held].any()
        assert not found[:, 2 * robot.n :][:, held].any()


def test_a_massless_joint_can_be_braked() -> None:
    robot = random_chain(np.random.default_rng(48), 3, 0.0)
    weightless = without_mass(robot, [2])
    given = inputs(np.random.default_rng(49), robot, pfd.Scene()) | {'free': np.array([1.0, 1, 0])}
    found = derivatives(weightless, pfd.Scene(brakes=True), given)
    assert np.isfinite(found).all()
    assert not found[2].any()


def test_a_torque_beyond_its_limit_changes_nothing_and_one_within_it_does() -> None:
    robot = pfd.load_robot('ur5')
    _, given, _ = arm('ur5')
    limits = np.abs(given['tau']) + np.array([1.0, -0.5, 1.0, 1.0, 1.0, 1.0])
    scene = pfd.Scene(effort_limits=limits)
    parts = run_program(record_derivatives(resolve_plant(robot, scene)), given)
    np.testing.assert_array_equal(parts['T'], [1.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    by_tau = derivatives(robot, scene, given)[:, 12:]
    np.testing.assert_array_equal(by_tau, parts['X'] * parts['T'])


METHODS = ('composite_body', 'grouped_articulated_body', 'pcgm')


@pytest.mark.parametrize('method', METHODS)
def test_the_answer_of_any_method_has_the_same_derivatives(method: str) -> None:
    robot, given, wanted = arm('panda')
    found = run_program(record_acceleration_derivatives(resolve_plant(robot), method), given)[
        'derivatives'
    ]
    assert relative(found, wanted) < ROUNDING


@pytest.mark.parametrize('method', METHODS[:2])
def test_refined_answers_and_the_derivatives_of_torques_there_have_all_digits(method: str) -> None:
    # A tip of 1e6 kg costs half of the digits of grouped parameters.
    robot, given, _ = arm('panda')
    plant = resolve_plant(
        robot, pfd.Scene(payload=pfd.Payload(1e6, (0.1, 0.2, 0.3), 1e4 * np.eye(3)))
    )
    own = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    exact = run_program(own, given, digits=50)['qdd']
    rough, refined = (run_program(record_derivatives(plant, method, k), given) for k in (0, 1))
    assert relative(rough['qdd'], exact) > 1e-12
    assert relative(refined['qdd'], exact) < 1e-15
    D = run_program(record_derivatives(plant, method, 1), given, digits=50)['D']
    assert relative(refined['D'], D) < 1e-14


# Operations of the factors of a kernel, at most, and with the product of X and D, which takes n
# for each element of D that varies.
MOST = [
    ('ur5', 1125, 1760),
    ('panda', 2078, 3200),
    ('dense6', 2507, 3500),
    ('chain12', 5635, np.inf),
    pytest.param('chain30', 43_000, np.inf, marks=[pytest.mark.slow, pytest.mark.long]),
]


@pytest.mark.parametrize(('name', 'factors', 'whole'), MOST)
def test_kernels_take_no_more_operations_than_they_did(
    name: str, factors: int, whole: float
) -> None:
    robot = robot_called(name)
    program = lower_program(record_derivatives(resolve_plant(robot)), 'float64').compiled
    elements = [program.instructions[register] for register, _ in program.outputs['D'].places]
    product = robot.n * sum(one.op != 'constant' for one in elements)
    counts = program_operations(program)
    work = sum(counts.values()) - counts.get('neg', 0)
    assert work <= factors
    assert work + product <= whole


@pytest.mark.parametrize('name', one_fast(['ur5', 'panda', 'puma560', 'dense6']))
def test_a_first_joint_along_gravity_gives_an_exact_zero_column(name: str) -> None:
    robot, given, _ = arm(name)
    down = -9.81 * robot.base_rotation[:, 2]
    assert not derivatives(robot, pfd.Scene(gravity=down), given)[:, 0].any()
    assert derivatives(robot, pfd.Scene(gravity=(3.0, 0.0, -9.0)), given)[:, 0].any()
