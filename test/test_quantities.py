# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities for controllers, and derivatives of programs and of forward dynamics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import mpmath
import numpy as np
from numpy.typing import ArrayLike
from oracle import ARMS, DYNAMICS, FIFTY_DIGITS, Oracle, chains, relative
import pinocchio as pin
import pytest
from zoo import Array, one_fast, random_chain, random_state

from benchmarks.cases.robots import coaxial
from benchmarks.cases.robots import robot as robot_called
import pfd_core as pfd
from pfd_core.dynamics.acceleration import record_derivatives
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.kernels import lower, simplify
from pfd_core.machine import derivative, lanes
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.geometry import rotation_z
from pfd_core.model.plant import Plant
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.model.robot import Frame

FEW, MANY = 6, 100
SEVERAL = [FEW, pytest.param(MANY, marks=[pytest.mark.slow, pytest.mark.long])]
# Operations of a lowered program, changes of sign apart, sine and cosine written out.
MOST = {
    'ur5': {
        'inverse_dynamics': 388,
        'inertia_matrix': 248,
        'bias_torques': 370,
        'gravity_torques': 173,
        'energy': 227,
        'tip_pose': 265,
        'tip_jacobian': 227,
        'tip_velocity': 230,
        'wrench_torques': 222,
    },
    'panda': {
        'inverse_dynamics': 630,
        'inertia_matrix': 439,
        'bias_torques': 611,
        'gravity_torques': 275,
        'energy': 372,
        'tip_pose': 328,
        'tip_jacobian': 314,
        'tip_velocity': 296,
        'wrench_torques': 267,
    },
}


def quantity(
    name: str,
    robot: pfd.Robot,
    scene: pfd.Scene | None = None,
    frame: str | None = None,
    **given: Any,
) -> Array:
    program = pfd.QUANTITIES[name](resolve_plant(robot, scene), frame)
    assert len(program.outputs) == 1
    assert program.inputs == {key: given[key].size for key in program.inputs}
    (value,) = run_program(program, given).values()
    found: Array = value
    return found


def robots(count: int, seed: int) -> Iterator[tuple[np.random.Generator, pfd.Robot]]:
    """Yield the published arms, one with parallel axes, and random chains of up to 12 joints."""
    rng = np.random.default_rng(seed)
    for name in ARMS:
        # A value that the model does not state is 0.
        yield rng, replace(pfd.load_robot(name), silent={})
    yield rng, parallel_axes(rng)
    yield from chains(count, seed)


def parallel_axes(rng: np.random.Generator) -> pfd.Robot:
    """Return a chain of four and two parallel axes, one of which slides and one points back."""
    types = ['revolute', 'revolute', 'prismatic', 'revolute', 'revolute', 'continuous']
    robot = random_chain(rng, 6, joint_types=types)
    angles = rng.uniform(-np.pi, np.pi, 6)
    rotations = np.array([rotation_z(np.cos(x), np.sin(x)) for x in angles])
    rotations[1] = rotations[1] @ np.diag([1.0, -1.0, -1.0])
    rotations[3] = robot.rotations[3]
    return replace(robot, name='parallel', rotations=rotations)


@pytest.mark.parametrize('count', SEVERAL)
def test_dynamic_quantities_agree_with_pinocchio(count: int) -> None:
    for rng, robot in robots(count, seed=61):
        oracle = Oracle(robot, robot.armature)
        model, data = oracle.model, oracle.data
        q, qd, qdd = random_state(rng, robot.n)
        rotors = pfd.Scene(armature='model')
        H = quantity('inertia_matrix', robot, rotors, q=q)
        np.testing.assert_array_equal(H, H.T)
        assert relative(H, oracle.H(q)) < DYNAMICS
        tau = quantity('inverse_dynamics', robot, rotors, q=q, qd=qd, qdd=qdd)
        assert relative(tau, oracle.tau(q, qd, qdd)) < DYNAMICS
        bias = quantity('bias_torques', robot, rotors, q=q, qd=qd)
        assert relative(bias, pin.nonLinearEffects(model, data, q, qd)) < DYNAMICS
        gravity = quantity('gravity_torques', robot, rotors, q=q)
        wanted = pin.computeGeneralizedGravity(model, data, q)
        assert np.abs(gravity - wanted).max() < DYNAMICS * np.abs(bias).max()
        kinetic, potential = quantity('energy', robot, rotors, q=q, qd=qd)
        # Pinocchio 3 and 4 differ in whether the energy of rotors is part of it.
        model.armature = np.zeros(robot.n)
        wanted = pin.computeKineticEnergy(model, data, q, qd) + qd @ (robot.armature * qd) / 2
        assert relative(kinetic, wanted) < DYNAMICS
        wanted = pin.computePotentialEnergy(model, data, q)
        weight = 9.81 * float(robot.masses.sum())
        assert abs(potential - wanted) < DYNAMICS * max(abs(wanted), weight)


@pytest.mark.parametrize('count', SEVERAL)
def test_quantities_of_the_tip_agree_with_pinocchio(count: int) -> None:
    for rng, robot in robots(count, seed=63):
        model = Oracle(robot).model
        data, tip = model.createData(), model.nframes - 1
        q, qd, _ = random_state(rng, robot.n)
        J, local = (  # Pinocchio drops the second axis of a single column.
            pin.computeFrameJacobian(model, data, q, tip, axes).reshape(6, robot.n)
            for axes in (pin.LOCAL_WORLD_ALIGNED, pin.LOCAL)
        )
        assert relative(quantity('tip_jacobian', robot, q=q), J) < DYNAMICS
        assert relative(quantity('tip_velocity', robot, q=q, qd=qd), J @ qd) < DYNAMICS
        pin.framesForwardKinematics(model, data, q)
        pose = quantity('tip_pose', robot, q=q)
        assert relative(pose, data.oMf[tip].homogeneous) < DYNAMICS
        k = 10 * rng.normal(size=6)
        found = quantity('wrench_torques', robot, q=q, wrench=k)
        assert relative(found, local.T @ k) < DYNAMICS


@pytest.mark.parametrize('name', ARMS)
def test_the_base_link_does_not_move_and_a_wrench_on_it_needs_no_torques(name: str) -> None:
    robot = replace(
        pfd.load_robot(name), base_rotation=rotation_z(0.6, 0.8), base_position=np.ones(3)
    )
    n = robot.n
    q, qd, _ = random_state(np.random.default_rng(69), n)
    equal = np.testing.assert_array_equal
    base = robot.base
    equal(quantity('tip_jacobian', robot, frame=base, q=q), np.zeros((6, n)))
    equal(quantity('tip_velocity', robot, frame=base, q=q, qd=qd), np.zeros(6))
    equal(quantity('tip_pose', robot, frame=base, q=q), np.eye(4))
    k = np.ones(6)
    equal(quantity('wrench_torques', robot, frame=base, q=q, wrench=k), np.zeros(n))
    for key in ('tip_pose', 'tip_jacobian', 'tip_velocity', 'wrench_torques'):
        still = lower.lower(pfd.QUANTITIES[key](resolve_plant(robot), base), 'float64').compiled
        assert lower.operations(still) == {}, key
        assert still.inputs['q'] == n


def test_a_frame_within_the_chain_does_not_feel_the_joints_beyond() -> None:
    rng = np.random.default_rng(70)
    robot = random_chain(rng, 6)
    robot = replace(robot, frames={'third': Frame(3, np.eye(3), rng.normal(size=3))})
    q, qd, _ = random_state(rng, 6)
    J = quantity('tip_jacobian', robot, frame='third', q=q)
    np.testing.assert_array_equal(J[:, 3:], np.zeros((6, 3)))
    np.testing.assert_allclose(
        quantity('tip_velocity', robot, frame='third', q=q, qd=qd), J @ qd, rtol=DYNAMICS
    )
    k = rng.normal(size=6)
    turn = quantity('tip_pose', robot, frame='third', q=q)[:3, :3]
    wanted = J.T @ np.concatenate([turn @ k[:3], turn @ k[3:]])
    found = quantity('wrench_torques', robot, frame='third', q=q, wrench=k)
    assert relative(found, wanted) < DYNAMICS


@pytest.mark.parametrize('name', list(MOST))
def test_quantities_take_no_more_operations_than_promised(name: str) -> None:
    plant = resolve_plant(pfd.load_robot(name))
    for key, most in MOST[name].items():
        program = lower.lower(pfd.QUANTITIES[key](plant), 'float64').compiled
        counts = lower.operations(program)
        assert sum(count for op, count in counts.items() if op != 'neg') <= most, key


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
in_both_modes = pytest.mark.parametrize('mode', derivative.MODES)


def recorded(size: int, function: Callable[..., Any]) -> pfd.Program:
    """Return the program of y = function(*x), x of the given size, y one value or several."""
    recorder = Recorder(1, 'sequential')
    values = function(*(recorder.input('x', [k]) for k in range(size)))
    values = values if isinstance(values, tuple) else (values,)
    recorder.output('y', (len(values),), [(recorder.lift(value), 0) for value in values])
    return recorder.program()


def jacobian(program: pfd.Program, x: Any, mode: str, digits: int | None = 50) -> Any:
    made = derivative.derivative(program, ['y'], ['x'], mode)
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


def all_operations(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return composite functions of all operations, with shared parts, for |x| < 1."""
    root = lanes.sqrt(1.0 - x * x) + y
    angle = z * root / (3.0 + lanes.sin(x * y))
    first = lanes.cos(angle) * lanes.sin(angle) - lanes.where(z, angle * z, -z)
    return first, first * first + root * 0.25, -(y / root) + 2.0, x, root - root + 1.5


def sums(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return sums of products that fuse in every way, of operands that depend on all inputs."""
    a, b, c = lanes.sin(x) + y, x / y, lanes.sqrt(x * x + y) + z
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
            simplify.fold(program) if passes == 'folded' else simplify.fuse(simplify.fold(program))
        )
    for x in (['0.3', '1.2', '-0.8'], ['-0.6', '2.1', '0.9']):
        point = [mpmath.mpf(v) for v in x]
        tangent, adjoint = (jacobian(program, point, mode) for mode in derivative.MODES)
        assert close(tangent, differences(program, {'x': point}, 'y', 'x'))
        assert close(tangent, adjoint, FIFTY_DIGITS)


def test_directional_derivatives_are_products_with_the_jacobian() -> None:
    program = recorded(3, all_operations)
    rng = np.random.default_rng(2)
    x, dx = rng.uniform(0.1, 0.9, 3), rng.normal(size=3)
    made = derivative.directional(program, ['y'], ['x'])
    assert made.inputs == {'x': 3, 'd x': 3}
    found = run_program(made, {'x': x, 'd x': dx}, digits=50)['d y'].astype(float)
    wanted = jacobian(program, x, 'tangent').astype(float) @ dx
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
    """Return d qdd / d(q, qd, tau), (n, 3 n), of the factors that a kernel multiplies."""
    parts = run_program(record_derivatives(resolve_plant(robot, scene)), given, **options)
    X = parts['X']
    with mpmath.workdps(DIGITS):
        by_tau = X * parts['T'] if 'T' in parts else X
        return np.concatenate([-(X @ parts['D']), by_tau], axis=1)


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


@pytest.mark.parametrize('seed', one_fast(range(8), 3))
def test_chains_in_a_scene_with_everything_equal_central_differences(seed: int) -> None:
    rng = np.random.default_rng([42, seed])
    robot = random_chain(rng, 1 + seed % 6, 0.4)
    scene = everything(rng, robot)
    given = inputs(rng, robot, scene)
    wanted = by_differences(robot, scene, given)
    for options in ({}, {'digits': 50}):
        assert relative(derivatives(robot, scene, given, **options), wanted) < ROUNDING


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


def test_articulated_bodies_keep_the_inverse_inertia_of_nearly_coaxial_joints() -> None:
    # kappa_J is 7e11: the factor of H has few digits left.
    plant = resolve_plant(coaxial(1e-12))
    given = inputs(np.random.default_rng(53), plant.robot, pfd.Scene())
    wanted = by_unit_torques(plant, given)
    assert relative(inverse(plant, FACTOR, given), wanted) > 1e-8
    assert relative(inverse(plant, BODIES, given), wanted) < 4 * 2.0**-53


METHODS = ('composite_body', 'grouped_articulated_body', 'pcgm')


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
OPERATIONS_OF_DERIVATIVES = [
    ('ur5', 1125, 1760),
    ('panda', 2078, 3200),
    pytest.param('chain30', 43_000, np.inf, marks=[pytest.mark.slow, pytest.mark.long]),
]


@pytest.mark.parametrize(('name', 'factors', 'whole'), OPERATIONS_OF_DERIVATIVES)
def test_derivatives_take_no_more_operations_than_promised(
    name: str, factors: int, whole: float
) -> None:
    robot = robot_called(name)
    program = lower.lower(record_derivatives(resolve_plant(robot)), 'float64').compiled
    elements = [program.instructions[register] for register, _ in program.outputs['D'].places]
    product = robot.n * sum(one.op != 'constant' for one in elements)
    counts = lower.operations(program)
    work = sum(counts.values()) - counts.get('neg', 0)
    assert work <= factors
    assert work + product <= whole


@pytest.mark.parametrize('name', one_fast(['ur5', 'panda']))
def test_a_first_joint_along_gravity_gives_an_exact_zero_column(name: str) -> None:
    robot, given, _ = arm(name)
    down = -9.81 * robot.base_rotation[:, 2]
    assert not derivatives(robot, pfd.Scene(gravity=down), given)[:, 0].any()
    assert derivatives(robot, pfd.Scene(gravity=(3.0, 0.0, -9.0)), given)[:, 0].any()
