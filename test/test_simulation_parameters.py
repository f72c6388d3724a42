# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles whose arms differ in parameters: each arm is a simulator of its robot and scene."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
import pickle
from typing import Any

from bridge import kernel_recipe, program_operations
import numpy as np
import pytest
from sampling import one_fast
from zoo import random_chain, without_mass

import pfd_core as pfd

STEPS = 60
# A register of arms and a tail, and some of them.
SIZE, SOME = 11, (0, 5, 10)
# Numbers that are known are folded with others before they are rounded, and a link's grouped
# numbers are sums in another order: a few roundings a step, amplified by the motion.
ROUNDING = 1e-12
Array = np.ndarray[Any, Any]


def drawn(low: float, high: float, *shape: int) -> Array:
    return np.random.default_rng(31).uniform(low, high, (SIZE, *shape))


def motion(n: int, size: int = SIZE) -> tuple[Array, Array, Array]:
    """Return positions and velocities, (size, n), and torques, (size, STEPS, n)."""
    rng = np.random.default_rng(32)
    return (
        rng.uniform(-0.3, 0.3, (size, n)),
        rng.uniform(-1, 1, (size, n)),
        rng.uniform(-4, 4, (size, STEPS, n)),
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
        pytest.param(FIRST_JOINT, ['damping', 'armature'], {}, id='first joint'),
        pytest.param(
            SCENE_NUMBERS, ['stiffness', 'rest_position'], {'damping': [1.0, 2.0]}, id='springs'
        ),
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
    many = pfd.Ensemble(robot, SIZE, pfd.Scene(**effects), parameters=given, integrator=integrator)
    q, qd, taus = motion(2)
    found = moved(many, q, qd, taus)
    for b in SOME:
        scene = pfd.Scene(**effects, **{name: x[b] for name, x in given.items()})
        one = pfd.Simulator(robot, scene, integrator=integrator)
        np.testing.assert_array_equal(found[:, b], moved(one, q[b], qd[b], taus[b]))


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_laws_wrenches_and_threads_act_on_arms_that_differ(dtype: str) -> None:
    robot = pfd.load_robot('planar2')
    scene, damping = pfd.Scene(external_wrench=True), SCENE_NUMBERS['damping']
    q, qd, taus = (x.astype(dtype) for x in motion(2))
    law, wrench = pfd.Feedback(5.0, 1.0, 0.2), drawn(-1, 1, 6).astype(dtype)
    many = pfd.Ensemble(robot, SIZE, scene, parameters={'damping': damping}, dtype=dtype)
    found = moved(many, q, qd, taus, feedback=law, wrench=wrench, threads=2)
    for b in SOME:
        one = pfd.Ensemble(robot, 1, replace(scene, damping=damping[b]), dtype=dtype)
        alone = moved(one, q[b : b + 1], qd[b], taus[b], feedback=law, wrench=wrench[b])
        np.testing.assert_array_equal(found[:, b], alone[:, 0])


def scaled(values: Array, low: float = 0.7, high: float = 1.4) -> Array:
    """Return numbers of arms, each link's and arm's scaled by another factor."""
    extra = (1,) * (values.ndim - 1)
    return values * drawn(low, high, len(values)).reshape(SIZE, len(values), *extra)


CHAIN = random_chain(
    np.random.default_rng(33), 4, joint_types=['revolute', 'prismatic', 'continuous', 'revolute']
)
BODIES = {
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
        pytest.param(['payload.mass'], id='payload mass'),
        pytest.param(['payload.mass', 'payload.center', 'payload.inertia'], id='payload'),
        pytest.param(['links.mass'], id='masses'),
        pytest.param(list(FIELDS), id='links'),
        pytest.param(list(BODIES), id='everything'),
    ],
)
def test_each_arm_moves_as_a_simulator_with_its_bodies(names: list[str], refine: int) -> None:
    given = {name: BODIES[name] for name in names}
    scene = pfd.Scene(damping=[1.0] * 4, joint_limits=[[-0.4, 0.4]] * 4, restitution=0.5)
    many = pfd.Ensemble(CHAIN, SIZE, scene, parameters=given, integrator='rk4', refine=refine)
    q, qd, taus = motion(4)
    found = moved(many, q, qd, taus)
    for b in SOME:
        robot, payload = arm_of(CHAIN, given, b)
        own = replace(scene, payload=payload)
        one = pfd.Simulator(robot, own, integrator='rk4', refine=refine)
        wanted = moved(one, q[b], qd[b], taus[b])
        for row, right in zip(found[:, b], wanted, strict=True):
            np.testing.assert_allclose(row, right, rtol=0, atol=ROUNDING * np.abs(right).max())


def test_the_gravity_of_each_arm_is_its_own() -> None:
    # With as many joints as gravity has components.
    robot, gravity = random_chain(np.random.default_rng(35), 3), drawn(-9.0, 9.0, 3)
    many = pfd.Ensemble(robot, SIZE, parameters={'gravity': gravity})
    q, qd, taus = motion(3)
    found = moved(many, q, qd, taus)
    for b in SOME:
        wanted = moved(pfd.Simulator(robot, pfd.Scene(gravity=gravity[b])), q[b], qd[b], taus[b])
        for row, right in zip(found[:, b], wanted, strict=True):
            np.testing.assert_allclose(row, right, rtol=0, atol=ROUNDING * np.abs(right).max())


def test_drives_compensate_the_gravity_of_the_model_that_all_arms_share() -> None:
    q, qd, taus = motion(4)
    given = {'links.mass': BODIES['links.mass'], 'payload.mass': BODIES['payload.mass']}
    many = pfd.Ensemble(CHAIN, SIZE, pfd.Scene(gravity_compensation=True), parameters=given)
    found = moved(many, q, qd, taus)[:, :, -1]
    gravity = pfd.compile_kernel(CHAIN, quantity='gravity_torques')
    for b in SOME:
        robot, payload = arm_of(CHAIN, given, b)
        end, speed, qdd = found[:, b]
        tau, scene = taus[b, -1] + gravity(end), pfd.Scene(payload=payload)
        wanted = pfd.forward_dynamics(robot, end, speed, tau, scene=scene)
        np.testing.assert_allclose(qdd, wanted, rtol=0, atol=ROUNDING * np.abs(wanted).max())


def test_256_arms_that_all_differ_need_one_compilation_and_other_values_none(
    emitted: list[str],
) -> None:
    robot, size = pfd.load_robot('ur5'), 256
    rng = np.random.default_rng(34)

    def given() -> dict[str, Array]:
        return {
            'friction': rng.uniform(0.1, 2.0, (size, 6)),
            'payload.mass': rng.uniform(0.5, 3.0, size),
            'links.mass': robot.masses * rng.uniform(0.8, 1.2, (size, 6)),
        }

    first, second = given(), given()
    many = pfd.Ensemble(robot, size, parameters=first)
    assert len(emitted) == 1
    others = pfd.Ensemble(robot, size, parameters=second)
    assert len(emitted) == 1
    q, qd, taus = motion(6, size)
    for ensemble, own in ((many, first), (others, second)):
        found = moved(ensemble, q, qd, taus)
        for b in (3, 255):
            arm, payload = arm_of(robot, own, b)
            one = pfd.Simulator(arm, pfd.Scene(payload=payload, friction=own['friction'][b]))
            wanted = moved(one, q[b], qd[b], taus[b])
            for row, right in zip(found[:, b], wanted, strict=True):
                np.testing.assert_allclose(row, right, rtol=0, atol=ROUNDING * np.abs(right).max())


def test_masses_as_inputs_cost_few_operations_since_zeros_stay_constants() -> None:
    robot = pfd.load_robot('ur5')
    given = {'links.mass': robot.masses * drawn(0.8, 1.2, 6), 'payload.mass': drawn(0.5, 1.0)}
    many = pfd.Ensemble(robot, SIZE, parameters=given)
    equal = pfd.Ensemble(robot, SIZE, pfd.Scene(payload=pfd.Payload(1.0)))
    inputs, constants = (
        sum(
            n for op, n in program_operations(kernel_recipe(x.spec).program).items() if op != 'neg'
        )
        for x in (many, equal)
    )
    assert constants < inputs < 1.02 * constants


def test_what_all_arms_have_in_common_is_a_constant() -> None:
    robot = pfd.load_robot('planar2')
    q, qd, taus = motion(2)
    given = {'damping': [0.5, 1.0], 'friction': np.full((SIZE, 2), 0.25), 'gravity': (0, -5, 0)}
    many = pfd.Ensemble(robot, SIZE, pfd.Scene(friction=[9.0, 9.0]), parameters=given)
    scene = pfd.Scene(damping=[0.5, 1.0], friction=[0.25] * 2, gravity=(0, -5, 0))
    equal = pfd.Ensemble(robot, SIZE, scene)
    np.testing.assert_array_equal(moved(many, q, qd, taus), moved(equal, q, qd, taus))


def test_an_arm_has_the_same_bits_in_another_ensemble() -> None:
    given = {name: BODIES[name] for name in ('links.mass', 'payload.mass')}
    q, qd, taus = motion(4)
    whole = moved(pfd.Ensemble(CHAIN, SIZE, parameters=given), q, qd, taus)
    few = [7, 2, 10]
    part = pfd.Ensemble(CHAIN, 3, parameters={name: x[few] for name, x in given.items()})
    np.testing.assert_array_equal(moved(part, q[few], qd[few], taus[few]), whole[:, few])


def test_copies_and_pickles_keep_the_parameters() -> None:
    robot = pfd.load_robot('planar2')
    many = pfd.Ensemble(robot, SIZE, parameters={'damping': SCENE_NUMBERS['damping']})
    q, qd, taus = motion(2)
    many.reset(q, qd)
    twins = deepcopy(many), pickle.loads(pickle.dumps(many))
    wanted = many.rollout(taus)
    for twin in twins:
        np.testing.assert_array_equal(twin.rollout(taus).q, wanted.q)


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
        ([1.0], r'parameters must map names to numbers of arms, got \[1\.0\]'),
        ({'frction': 1.0}, "parameters: 'frction' is unknown, only gravity, damping"),
        ({'joint_limits': 1.0}, "parameters: 'joint_limits' cannot differ among arms, only"),
        ({'links.rotation': 1.0}, "parameters: 'links.rotation' cannot differ among arms, only"),
        ({'motor_lag': [0.1, 0.1]}, "parameters: 'motor_lag' cannot differ among arms, only"),
        ({'payload': pfd.Payload(1.0)}, "parameters: 'payload' cannot differ among arms, only"),
        (
            {'friction': np.ones((2, 2))},
            r"parameters\['friction'\] must have shape \(3, 2\) or \(2,\), got \(2, 2\)",
        ),
        (
            {'links.center': np.ones((3, 2))},
            r"parameters\['links.center'\] must have shape \(3, 2, 3\) or .* got \(3, 2\)",
        ),
        ({'gravity': -9.81}, r"parameters\['gravity'\] must have shape \(3, 3\) or .*, got \(\)"),
        ({'friction': 'model'}, r"parameters\['friction'\] must be an array of numbers"),
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
        (
            {
                'friction': np.ones(2),
                'static_friction': np.ones(2),
                'stribeck_velocity': per_arm((2,), 0, 1, value=0.0),
            },
            "parameters, arm 0: stribeck_velocity of joint 'elbow' must be above 0",
        ),
        ({'static_friction': np.ones(2)}, 'static_friction was given without friction, which the'),
        ({'payload.center': np.ones(3)}, 'payload.center was given without payload.mass, which'),
        (
            {'payload.mass': [1.0, -2.0, 1.0]},
            'parameters, arm 1: payload mass must not be negative, got -2.0 kg',
        ),
        (
            {'payload.mass': 1.0, 'payload.inertia': per_arm((3, 3), 2, 0, 1, value=1, other=0)},
            'parameters, arm 2: payload inertia must be symmetric',
        ),
        (
            {'links.mass': per_arm((2,), 1, 0, value=-1.0)},
            "parameters, arm 1: 'planar2': masses of joint 'shoulder' must not be negative",
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


@pytest.mark.parametrize(
    ('call', 'message'),
    [
        (lambda many: many.linearize(*np.zeros((3, 3, 2))), 'linearize takes no Ensemble with'),
        (
            lambda many: pfd.Ensemble(many.robot, 3, parameters={'damping': [1, 1]}).linearize(
                *np.zeros((3, 3, 2))
            ),
            'linearize takes no Ensemble with parameters',
        ),
        (
            lambda many: pfd.Ensemble(
                many.robot, 2, method='pcrbm', parameters={'damping': [[1, 1], [2, 2]]}
            ),
            "an ensemble with parameters, needs one of the methods .* got 'pcrbm'",
        ),
    ],
)
def test_what_takes_no_parameters_says_so(call: Callable[[Any], Any], message: str) -> None:
    robot = pfd.load_robot('planar2')
    many = pfd.Ensemble(robot, 3, parameters={'damping': [[1, 1], [2, 2], [3, 3]]})
    with pytest.raises(ValueError, match=message):
        call(many)
