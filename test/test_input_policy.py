# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The policy on bad input, one fact a test, with published URDF files where a file is input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
import xml.etree.ElementTree as ElementTree

import numpy as np
from oracle import Oracle, jacobi_condition
import pinocchio as pin
import pytest
from sampling import one_fast
from tolerances import ACCELERATION
from urdf_models import assert_same_physics, exact_angles, example
from zoo import BODY, WHEEL, joint, link, random_chain, random_state, urdf, without_mass

import pfd_core as pfd

UR5 = 'ur_description/urdf/ur5_robot.urdf'
WRIST = "link[@name='wrist_3_link']/inertial"


def edited(name: str, edit: Callable[[ElementTree.Element], object]) -> str:
    """Return the text of a URDF of example-robot-data after an edit of its elements."""
    root = ElementTree.fromstring(example(name).strip())
    edit(root)
    return ElementTree.tostring(root, encoding='unicode')


def found(root: ElementTree.Element, path: str) -> ElementTree.Element:
    """Return the element of a URDF at a path."""
    element = root.find(path)
    assert element is not None, path
    return element


def without_last_mass(root: ElementTree.Element) -> None:
    """Set the mass and the inertia of the last link to zero; those welded to it have none."""
    found(root, f'{WRIST}/mass').set('value', '0')
    inertia = found(root, f'{WRIST}/inertia')
    inertia.attrib.update(dict.fromkeys(inertia.attrib, '0'))


def without_limits(root: ElementTree.Element) -> None:
    """Remove all <limit> elements."""
    for element in root.findall('joint'):
        for limit in element.findall('limit'):
            element.remove(limit)


# Numbers at run time.

NOT_FINITE: dict[str, Callable[[pfd.Simulator, np.ndarray], Any]] = {
    'tau': lambda sim, x: sim.step(x),
    'taus': lambda sim, x: sim.rollout([x, x]),
    'q': lambda sim, x: sim.reset(q=x),
    'qd': lambda sim, x: sim.reset(qd=x),
}


@pytest.mark.parametrize('value', one_fast([np.nan, np.inf, -np.inf]))
@pytest.mark.parametrize('name', NOT_FINITE)
def test_a_number_that_is_not_finite_is_refused_with_joint_and_index_and_the_state_stays(
    name: str, value: float
) -> None:
    sim = pfd.Simulator(pfd.load_robot(example(UR5), tip='ee_link'))
    sim.step(np.ones(6))
    before = sim.q.tobytes(), sim.qd.tobytes(), sim.time, sim.status
    bad = np.zeros(6)
    bad[2] = value
    index = r'\[0, 2\]' if name == 'taus' else r'\[2\]'
    with pytest.raises(ValueError, match=rf"^{name} must be .*at index {index}, joint 'elbow_j"):
        NOT_FINITE[name](sim, bad)
    assert (sim.q.tobytes(), sim.qd.tobytes(), sim.time, sim.status) == before


class Degrees(np.ndarray):
    """An array with units, as packages of units have them."""

    unit = 'deg'


NOT_REAL: dict[str, tuple[Any, str]] = {
    'complex': ([1j] * 6, 'complex128'),
    'bools': (np.ones(6, bool), 'bool'),
    'a bool among numbers': ([0.0] * 5 + [True], 'bool True'),
    'texts': (['1'] * 6, '<U1'),
    'None among numbers': ([0.0] * 5 + [None], 'None'),
    'a huge integer': ([10**400] * 6, 'fit float64'),
    'masked nowhere': (np.ma.masked_array(np.zeros(6)), 'masked array'),
    'units': ([np.zeros(6).view(Degrees)], "units .'deg'"),
    'dates': (np.zeros(6, 'M8[s]'), r'datetime64\[s\]'),
    'durations': (np.zeros(6, 'm8[s]'), r'timedelta64\[s\]'),
    'ragged rows': ([[1.0], [2.0, 3.0]], 'inhomogeneous'),
    'many': ([[0.0, 'x' * 10_000]] * 100, 'array of numbers'),
}


@pytest.mark.parametrize('case', NOT_REAL)
def test_a_value_that_is_no_real_number_is_refused_by_name_in_a_short_line(case: str) -> None:
    value, message = NOT_REAL[case]
    sim = pfd.Simulator(pfd.load_robot('ur5'))
    with pytest.raises(ValueError, match=rf'^tau must .*{message}') as caught:
        sim.step(value)
    assert len(str(caught.value)) < 400


def test_of_an_ensemble_the_arm_is_named_too() -> None:
    many = pfd.Ensemble(pfd.load_robot(example(UR5), tip='ee_link'), 3)
    bad = np.zeros((3, 6))
    bad[1, 2] = np.nan
    message = r"must be finite, got nan at index \[1, 2\], joint 'elbow_joint'"
    with pytest.raises(ValueError, match='q ' + message):
        many.reset(q=bad)
    with pytest.raises(ValueError, match='taus ' + message):
        many.rollout(bad)


@pytest.mark.parametrize(('dtype', 'most'), [('float64', 2.0**30), ('float32', 2.0**10)])
def test_a_simulation_does_not_start_at_an_angle_that_has_lost_its_digits(
    dtype: str, most: float
) -> None:
    sim = pfd.Simulator(pfd.load_robot(WHEEL), dtype=dtype)
    sim.reset(q=[most])
    for angle in (np.nextafter(np.dtype(dtype).type(most), np.inf), -1e30):
        with pytest.raises(ValueError, match=r"q must be .* at most .*\[0\], joint 'hub'"):
            sim.reset(q=[angle])
    assert sim.q[0] == most
    # A distance is no angle: it may have any size.
    slide = pfd.load_robot(WHEEL.replace('continuous', 'prismatic').replace('-2', '-inf'))
    pfd.Simulator(slide, dtype=dtype).reset(q=[1e30])


def test_float32_arrays_are_computed_with_in_float64_unless_float32_is_requested() -> None:
    robot = pfd.load_robot(example(UR5), tip='ee_link')
    state = [x.astype('f4') for x in random_state(np.random.default_rng(4), 6)]
    qdd = pfd.forward_dynamics(robot, *state)
    assert qdd.dtype == np.float64
    np.testing.assert_array_equal(
        qdd, pfd.forward_dynamics(robot, *(x.astype('f8') for x in state))
    )
    assert pfd.forward_dynamics(robot, *state, dtype='float32').dtype == np.float32


# Masses and inertias.


MOVED: dict[str, Callable[[pfd.Robot, pfd.Scene | None], Any]] = {
    'kernel': lambda robot, scene: pfd.compile_kernel(robot, scene=scene),
    'derivatives': lambda robot, scene: pfd.compile_kernel(
        robot, scene=scene, quantity='derivatives'
    ),
    'function': lambda robot, scene: pfd.forward_dynamics(
        robot, *np.zeros((3, robot.n)), method='pcgm', scene=scene
    ),
    'simulator': pfd.Simulator,
    'motors': pfd.MotorSimulator,
    'ensemble': lambda robot, scene: pfd.Ensemble(robot, 2, scene),
    'integrate': lambda robot, scene: pfd.integrate(robot, np.zeros(robot.n), 0.01, scene=scene),
}


@pytest.mark.parametrize('moved', MOVED)
def test_an_arm_whose_last_link_has_no_inertia_is_refused_where_it_should_move(moved: str) -> None:
    robot = without_mass(pfd.load_robot('planar2'), [1])
    refused = (
        r"link 2 of 'planar2' \(moved by joint 'elbow'\) has no inertia about its joint and "
        "'elbow' no armature, so its acceleration has no value: give one of them, a payload with "
        "inertia about its joint, or lock 'elbow'"
    )
    with pytest.raises(ValueError, match=refused):
        MOVED[moved](robot, None)
    # Obeyed, or with a payload, it moves.
    MOVED[moved](robot, pfd.Scene(armature={'elbow': 0.1}))
    MOVED[moved](robot, pfd.Scene(payload=pfd.Payload(1.0, (0.1, 0, 0))))
    MOVED[moved](pfd.lock(robot, {'elbow': 0.0}), None)


def test_an_arm_whose_last_link_has_no_inertia_loads_and_has_all_other_quantities() -> None:
    robot = pfd.load_robot(edited(UR5, without_last_mass), tip='ee_link')
    assert robot.masses[-1] == 0
    state = random_state(np.random.default_rng(5), 6)
    assert np.isfinite(pfd.inverse_dynamics(robot, *state)).all()
    assert np.isfinite(pfd.compile_kernel(robot, quantity='inertia_matrix')(state[0])).all()
    # Brakes may hold the joint, and an input may give it inertia.
    for scene in (pfd.Scene(brakes=True), pfd.Scene(payload='input')):
        pfd.compile_kernel(robot, scene=scene)
    rotors = np.full((2, 6), 0.1)
    pfd.Ensemble(robot, 2, parameters={'armature': rotors})
    rotors[1, 5] = 0.0
    with pytest.raises(ValueError, match=r"arm 1.*'wrist_3_joint' no armature"):
        pfd.Ensemble(robot, 2, parameters={'armature': rotors})


@pytest.mark.parametrize('rod', [0.0, 1.0])
def test_a_body_on_a_skew_axis_has_no_inertia_about_it_whatever_rounding_leaves(
    rod: float,
) -> None:
    def text(values: np.ndarray) -> str:
        return ' '.join(map(repr, values.tolist()))

    rng = np.random.default_rng(0)
    for _ in range(20):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        # A point, and a thin rod along the axis: ixx iyy izz ixy iyz ixz.
        J = rod * (np.eye(3) - np.outer(axis, axis))[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        robot = pfd.load_robot(
            urdf(
                'skew',
                *(
                    link('base'),
                    link('a', 1.0, J=BODY),
                    link('b', 1.0, text(0.3 * axis), J=text(J)),
                ),
                joint('turn', 'revolute', 'base', 'a'),
                joint(
                    *('spin', 'revolute', 'a', 'b', '0.3 0.1 0'),
                    *(text(rng.uniform(-3, 3, 3)), text(axis)),
                ),
            )
        )
        with pytest.raises(ValueError, match=r"'spin'\) has no inertia about its joint"):
            pfd.compile_kernel(robot)


def test_a_joint_whose_links_beyond_have_no_mass_needs_a_rotor_of_its_own() -> None:
    robot = without_mass(random_chain(np.random.default_rng(3), 3, 0.0), [1, 2])
    rotors = {'joint3': 0.1}
    with pytest.raises(ValueError, match=r"'joint2'\) has no inertia.*lock 'joint2'"):
        pfd.compile_kernel(robot, scene=pfd.Scene(armature=rotors))
    pfd.compile_kernel(robot, scene=pfd.Scene(armature=rotors | {'joint2': 0.1}))


def test_a_sliding_link_needs_a_mass_and_a_turning_one_an_inertia_about_its_axis() -> None:
    def arm(kind: str, mass: float, xyz: str, J: str) -> pfd.Robot:
        return pfd.load_robot(
            urdf('x', link('base'), link('arm', mass, xyz, J=J), joint('j', kind, 'base', 'arm'))
        )

    zero, ball = '0 0 0 0 0 0', '0.1 0.1 0.1 0 0 0'
    pfd.Simulator(arm('revolute', 0.0, '0 0 0', ball))
    pfd.Simulator(arm('revolute', 1.0, '0.1 0 0', zero))
    pfd.Simulator(arm('prismatic', 1.0, '0 0 0', zero))
    with pytest.raises(ValueError, match='no mass'):
        pfd.Simulator(arm('prismatic', 0.0, '0 0 0', ball))
    with pytest.raises(ValueError, match='no inertia about its joint'):
        pfd.Simulator(arm('revolute', 1.0, '0 0 0.1', zero))


def test_a_link_with_inertia_and_without_mass_moves_as_in_pinocchio() -> None:
    text = edited(UR5, lambda root: found(root, f'{WRIST}/mass').set('value', '0'))
    robot = pfd.load_robot(text, tip='ee_link')
    assert robot.masses[-1] == 0
    assert_same_physics(robot, text, {})
    model = pin.buildModelFromXML(exact_angles(text))
    q, qd, tau = random_state(np.random.default_rng(6), 6)
    right = pin.aba(model, model.createData(), q, qd, tau)
    condition = jacobi_condition(Oracle(robot).H(q))
    for method in ('composite_body', 'articulated_body'):
        qdd = pfd.forward_dynamics(robot, q, qd, tau, method=method)
        assert np.abs(qdd - right).max() <= ACCELERATION * condition * np.abs(right).max()


def test_an_arm_scaled_to_micrometres_is_loaded_with_the_same_digits() -> None:
    # Lengths: 2^-14; masses: 2^-42; inertias: 2^-70. All of these are exact, and moments are of
    # the order of 1e-23 kg m^2: nothing may be compared with a fixed number.
    length, mass = 2.0**-14, 2.0**-42

    def shrink(root: ElementTree.Element) -> None:
        for origin in (*root.findall('joint/origin'), *root.findall('link/inertial/origin')):
            xyz = [repr(float(x) * length) for x in origin.get('xyz', '0 0 0').split()]
            origin.set('xyz', ' '.join(xyz))
        for element in root.findall('link/inertial/mass'):
            element.set('value', repr(float(element.get('value', '')) * mass))
        for element in root.findall('link/inertial/inertia'):
            for key, value in element.items():
                element.set(key, repr(float(value) * mass * length**2))

    arm = pfd.load_robot(example(UR5), tip='ee_link')
    micro = pfd.load_robot(edited(UR5, shrink), tip='ee_link')
    assert np.abs(micro.inertias).max() < 1e-20
    np.testing.assert_array_equal(micro.inertias, arm.inertias * mass * length**2)
    np.testing.assert_array_equal(micro.rotations, arm.rotations)


# Axes, limits, friction and structure.


def test_a_joint_without_limits_is_unlimited_and_warned_of() -> None:
    with pytest.warns(pfd.PhysicsWarning) as warned:
        robot = pfd.load_robot(edited(UR5, without_limits), tip='ee_link')
    assert [str(w.message).split(' is ')[0] for w in warned] == [
        f"joint '{name}'" for name in robot.joint_names
    ]
    assert all(w.filename == __file__ for w in warned)
    for key in ('position_upper', 'velocity_limit', 'effort_limit'):
        np.testing.assert_array_equal(getattr(robot, key), np.inf)
    np.testing.assert_array_equal(robot.position_lower, -np.inf)


def test_joint_limits_are_off_also_for_an_arm_that_starts_beyond_them() -> None:
    robot = pfd.load_robot(example(UR5), tip='ee_link')
    with pytest.warns(pfd.PhysicsWarning):
        free = pfd.load_robot(edited(UR5, without_limits), tip='ee_link')
    q = robot.position_upper + np.array([1.0, -1.0, 0.5, 2.0, -3.0, 1.0])
    runs = []
    for each in (robot, free):
        sim = pfd.Simulator(each)
        sim.reset(q=q)
        np.testing.assert_array_equal(sim.q, q)
        runs.append(sim.rollout(np.zeros((100, 6))))
    assert (runs[0].q[0] > robot.position_upper).any()
    np.testing.assert_array_equal(runs[0].q, runs[1].q)


def test_turns_of_a_joint_are_counted_and_a_slow_joint_moves_in_float32() -> None:
    scene = pfd.Scene(gravity=None)
    for kind in ('continuous', 'revolute'):
        sim = pfd.Simulator(
            pfd.load_robot(WHEEL.replace('continuous', kind)), scene, dtype='float32'
        )
        sim.reset(q=[1.0], qd=[5e-5])
        sim.rollout(np.zeros((10_000, 1)))
        assert abs(float(sim.q[0]) - 1.0005) <= 1e-7
        sim.reset(qd=[100.0])
        sim.rollout(np.zeros((60_000, 1)))
        right = np.float32(6000)
        assert abs(sim.q[0] - right) <= 2 * np.spacing(right)
        angle, turns = sim.wrapped
        assert turns.tolist() == [round(6000 / (2 * np.pi))]
        # h qd / 6 is rounded once for all steps: the error may be half a digit of q itself.
        assert abs(angle[0] - (6000 - 2 * np.pi * turns[0])) <= np.spacing(right) / 2


def test_sliding_joints_have_no_turns() -> None:
    crane = urdf(
        'crane',
        *(link('base'), link('beam', 1, J=BODY), link('hook', 1, J=BODY)),
        joint('turn', 'continuous', 'base', 'beam'),
        joint('slide', 'prismatic', 'beam', 'hook'),
    )
    many = pfd.Ensemble(pfd.load_robot(crane), 2)
    many.reset([[-20.0, -20.0], [3.0, 1.5]])
    angle, turns = many.wrapped
    np.testing.assert_array_equal(turns, [[-3, 0], [0, 0]])
    np.testing.assert_allclose(angle, [[-20.0 + 6 * np.pi, -20.0], [3.0, 1.5]], rtol=1e-15)
