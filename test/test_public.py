# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Promises of public names: wrong arguments are named, bad input is refused, copies are equal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
import copy
from functools import partial
import inspect
import multiprocessing
from pathlib import Path
import pickle
import re
import reprlib
from typing import Any
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from sampling import one_fast
from zoo import WHEEL, example, joint, link, random_state, urdf, without_mass

import pfd_core as pfd
from pfd_core.kernels.compile import _kept_kernel as cached_kernel

ROBOT = pfd.load_robot('planar2')
ZERO = np.zeros(2)
# What the functions return; a user has no reason to construct one.
RESULTS = {'AdaptiveTrajectory', 'Kernel', 'Linearization', 'PhysicsWarning', 'Program', 'Run'}
RESULTS |= {'SimulationState', 'Steps', 'Trajectory', 'TreeError', 'Urdf'}
# Valid arguments of each public function and constructor, as far as it needs some.
VALID: dict[str, dict[str, Any]] = {
    'Ensemble': {'robot': ROBOT, 'size': 2},
    'Frame': {'link': 0, 'rotation': np.eye(3), 'translation': np.zeros(3)},
    'Feedback': {'kp': 1.0, 'kd': 1.0, 'q': ZERO},
    'MotorSimulator': {'robot': ROBOT},
    'MotorState': {'peaks': np.zeros(2)},
    'Payload': {'mass': 1.0},
    'Robot': {
        name: getattr(ROBOT, name)
        for name in ('name', 'joint_names', 'joint_types', 'rotations', 'translations')
    }
    | {name: getattr(ROBOT, name) for name in ('masses', 'centers', 'inertias')},
    'Scene': {},
    'Simulator': {'robot': ROBOT},
    'StateFeedback': {'gain': np.zeros((2, 4)), 'q': ZERO},
    'compile_kernel': {'robot': ROBOT},
    'emulate': {'robot': ROBOT, 'q': ZERO, 'qd': ZERO, 'tau': ZERO, 'processors': 2},
    'estimated_armature': {'robot': ROBOT},
    'find_description': {'name': 'planar2'},
    'find_package': {'name': 'no_package', 'folder': '/nowhere'},
    'forward_dynamics': {'robot': ROBOT, 'q': ZERO, 'qd': ZERO, 'tau': ZERO},
    'integrate': {'robot': ROBOT, 'tau': ZERO, 'duration': 0.01},
    'inverse_dynamics': {'robot': ROBOT, 'q': ZERO, 'qd': ZERO, 'qdd': ZERO},
    'known_robots': {},
    'load_robot': {'source': 'planar2'},
    'load_scene': {'source': 'gravity: [0, 0, -9.81]\n'},
    'lock': {'robot': ROBOT, 'positions': {'shoulder': 0.0}},
    'locked_joints': {'source': 'planar2'},
    'read_urdf': {'source': 'planar2'},
    'reflected_inertia': {'rotor_inertia': [1.0], 'gear_ratio': [2.0]},
    'robot_to_urdf': {'robot': ROBOT},
    'robot_to_yaml': {'robot': ROBOT},
    'scene_to_yaml': {'scene': pfd.Scene()},
    'start_positions': {'robot': ROBOT},
    'urdf_of': {'source': 'planar2'},
    'with_payload': {'robot': ROBOT, 'payload': pfd.Payload(1.0)},
}
HOSTILE = [
    *(None, True, 0, -1, 2, 1.5, 1j, float('nan'), float('inf'), 10**400, -(10**400)),
    *(np.float32(3), '', 'no', 'a\nb', b'bytes', [], [1], [[1.0], [2.0, 3.0]], (), {}, {'a': 1}),
    *({1: 'a'}, {1, 2}, object(), len, Exception, np.zeros((2, 6)), np.zeros((3, 6))),
    *(np.array('text'), range(3), np.float64, np.dtype('float64'), np.datetime64('2020-01-01')),
    *(np.ma.masked, ROBOT, pfd.Scene(), pfd.Payload(1.0)),
]
# Words by which an error may name a parameter instead.
WORDS = {
    'source': 'robot|scene',
    'locked': 'lock',
    'name': 'frame',
    'positions': 'lock',
    'path': 'directory|null byte|File name',
}


def problems(label: str, call: Callable[..., Any], valid: dict[str, Any]) -> Iterator[str]:
    """Yield one line for each hostile argument that is neither accepted nor refused by name."""
    for name, parameter in inspect.signature(call).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            continue
        kinds = (ValueError, TypeError, *[OSError] * (name == 'path'))
        for value in HOSTILE:
            if name == 'tau' and callable(value):  # a law, whose own errors pass through
                continue
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter('ignore', pfd.PhysicsWarning)
                    call(**(valid | {name: value}))
            except Exception as error:
                named = re.search(f'{name}|{WORDS.get(name, name)}', str(error))
                if not (named and isinstance(error, kinds)):
                    said = f'{type(error).__name__}: {error}'.replace(chr(10), ' ')
                    yield f'{label}({name}={reprlib.repr(value)}): {said:.120}'


def test_each_public_callable_is_tested_with_hostile_values() -> None:
    public = {name for name in pfd.__all__ if callable(getattr(pfd, name))}
    assert VALID.keys() | RESULTS == public
    assert not VALID.keys() & RESULTS


@pytest.mark.parametrize('name', VALID)
def test_a_wrong_argument_of_a_public_function_is_named(name: str) -> None:
    found = list(problems(name, getattr(pfd, name), VALID[name]))
    assert not found, '\n'.join(found)


INSTANCES: dict[str, Callable[[], Any]] = {
    'AdaptiveTrajectory': lambda: pfd.integrate(ROBOT, ZERO, duration=0.01, dense=True),
    'Ensemble': lambda: pfd.Ensemble(ROBOT, 2),
    'Kernel': lambda: pfd.compile_kernel(ROBOT, refine=1),
    'MotorSimulator': lambda: pfd.MotorSimulator(ROBOT),
    'Program': lambda: pfd.compile_kernel(ROBOT, refine=1).program,
    'Robot': lambda: ROBOT,
    'Scene': pfd.Scene,
    'Simulator': lambda: pfd.Simulator(ROBOT),
}
ZEROS: dict[str, Any] = {'q': ZERO, 'qd': ZERO, 'tau': ZERO}
OUT = np.zeros(2)
MOTION = pfd.MotorSimulator(ROBOT).new_state()
# Valid arguments of each public method with parameters.
METHODS: dict[str, dict[str, dict[str, Any]]] = {
    'AdaptiveTrajectory': {'at': {'times': [0.0]}},
    'Ensemble': {
        'linearize': ZEROS,
        'outside_stops': {'q': ZERO},
        'reset': {},
        'rollout': {'steps': 2},
    },
    'Kernel': {'__call__': ZEROS, 'bind': ZEROS | {'out': OUT}, 'error_estimate': ZEROS},
    'MotorSimulator': {
        'accelerations': {'state': MOTION},
        'bind': {
            'state': MOTION,
            'motors': pfd.MotorState(np.zeros(2)),
            'limits': np.ones((7, 2)),
        },
        'converted': {'state': MOTION},
        'linearize': ZEROS,
        'new_state': {},
        'outside_stops': {'q': ZERO},
        'prepare_payload': {'payload': None},
        'reset': {},
        'rollout': {'taus': np.zeros((2, 2))},
        'set_inputs': {'state': MOTION},
        'step': {'tau': ZERO},
    },
    'Program': {'count': {}},
    'Robot': {'frame': {}},
    'Scene': {'save': {}, 'without': {'names': ()}},
    'Simulator': {
        'linearize': ZEROS,
        'outside_stops': {'q': ZERO},
        'prepare_payload': {'payload': None},
        'reset': {},
        'rollout': {'taus': np.zeros((2, 2))},
        'step': {'tau': ZERO},
    },
}
# Of the simulations among themselves.
INTERNAL = {'clear', 'copy_from'}


def public_methods(owner: type) -> set[str]:
    """Return the names of the methods with parameters; __call__ of a kernel too."""
    return {
        name
        for name, method in inspect.getmembers(owner, inspect.isfunction)
        if (name == '__call__' or not name.startswith('_'))
        and len(inspect.signature(method).parameters) > 1
        and name not in INTERNAL
    }


def test_each_public_method_is_tested_with_hostile_values() -> None:
    classes = {name: getattr(pfd, name) for name in pfd.__all__}
    found = {
        name: public_methods(owner)
        for name, owner in classes.items()
        if isinstance(owner, type) and not issubclass(owner, Warning)
    }
    assert {k: v for k, v in found.items() if v} == {k: set(v) for k, v in METHODS.items()}


@pytest.mark.parametrize('owner', METHODS)
def test_a_wrong_argument_of_a_public_method_is_named(
    owner: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where Scene.save writes
    one = INSTANCES[owner]()
    found = [
        line
        for name, valid in METHODS[owner].items()
        for line in problems(f'{owner}.{name}', getattr(one, name), valid)
    ]
    assert not found, '\n'.join(found)


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


# Axes, limits, friction and structure.


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


# With rows of the state besides q and qd, which a step needs of the step before.
EVERYTHING = pfd.Scene(
    external_wrench=True,
    brakes=True,
    damping=[0.1, 0.2],
    motor_lag=[0.02, 0.0],
    friction=[0.2, 0.1],
    joint_limits=[(-0.3, 0.4), (-0.5, 0.6)],
)
WRENCH = np.arange(6) / 7
COPIES: dict[str, Callable[[Any], Any]] = {
    'pickle': lambda x: pickle.loads(pickle.dumps(x)),
    'oldest protocol': lambda x: pickle.loads(pickle.dumps(x, 2)),
    'copy': copy.copy,
    'deepcopy': copy.deepcopy,
}
SETTINGS: list[dict[str, Any]] = [
    {},
    {'scene': EVERYTHING, 'substeps': 3, 'step_size': 2e-3, 'integrator': 'velocity_verlet'},
    {'dtype': 'float32', 'refine': 1, 'method': 'grouped_articulated_body'},
]


def held(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the wrench and brakes that a scene asks for."""
    return {'wrench': WRENCH, 'brakes': [True, False]} if 'scene' in settings else {}


def moved(**settings: Any) -> pfd.Simulator:
    """Return a simulation that has run for a while."""
    sim = pfd.Simulator(pfd.load_robot('planar2'), **settings)
    sim.reset(q=[0.1, 0.2], qd=[0.3, -0.4], time=2.0)
    sim.rollout(np.full((7, 2), 0.5), **held(settings))
    sim.step([0.25, -0.5], **held(settings))
    return sim


def facts(sim: pfd.Simulator) -> tuple[Any, ...]:
    """Return all public values of a simulation, as bits."""
    lagging = sim.tau_motor.tobytes() if sim.scene.motor_lag else b''
    arrays = sim.q.tobytes(), sim.qd.tobytes(), sim.qdd.tobytes(), lagging
    return *arrays, sim.time, sim.status, sim.method


def go_on(sim: pfd.Simulator, settings: dict[str, Any]) -> tuple[Any, ...]:
    """Take further steps and return the facts."""
    sim.rollout(np.full((20, 2), -0.25), **held(settings))
    sim.step([1.0, 2.0], **held(settings))
    return facts(sim)


@pytest.mark.sweep
@pytest.mark.parametrize('way', COPIES)
@pytest.mark.parametrize('settings', SETTINGS, ids=['plain', 'everything', 'single'])
def test_a_copied_simulation_continues_with_the_same_bits_independently(
    way: str, settings: dict[str, Any]
) -> None:
    sim = moved(**settings)
    twin = COPIES[way](sim)
    before = facts(sim)
    assert facts(twin) == before
    assert (twin.robot, twin.scene, twin.dtype) == (sim.robot, sim.scene, sim.dtype)
    after = go_on(twin, settings)
    assert facts(sim) == before
    assert go_on(sim, settings) == after


def test_a_simulation_continues_in_a_fresh_process() -> None:
    settings = SETTINGS[1]
    sim = moved(**settings)
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as pool:
        there = pool.submit(go_on, sim, settings).result()
    assert there == go_on(sim, settings)


@pytest.mark.parametrize('way', COPIES)
def test_a_copied_ensemble_continues_with_the_same_bits_independently(way: str) -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 5, EVERYTHING)
    many.reset(np.random.default_rng(1).uniform(-0.3, 0.4, (5, 2)), time=1.0)
    run = partial(pfd.Ensemble.rollout, steps=10, wrench=WRENCH, brakes=[False, True])
    run(many)
    twin = COPIES[way](many)
    q, time = many.q, many.time
    first = run(twin)
    np.testing.assert_array_equal(many.q, q)
    assert many.time == time
    second = run(many)
    for name in ('time', 'q', 'qd', 'qdd', 'finite_steps'):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert twin.qdd.tobytes() == many.qdd.tobytes()


@pytest.mark.parametrize('way', COPIES)
@pytest.mark.parametrize('read', [False, True], ids=['not read', 'read'])
def test_a_trajectory_keeps_its_accelerations(way: str, read: bool) -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), EVERYTHING)
    runs = [sim.rollout(np.full((9, 2), 0.5), WRENCH, brakes=[False, True]) for _ in range(2)]
    wanted = [run.qdd.copy() for run in runs] if read else None
    twins = [COPIES[way](run) for run in runs]
    sim.reset()
    for k, (run, twin) in enumerate(zip(runs, twins, strict=True)):
        expected = run.qdd if wanted is None else wanted[k]
        assert twin.qdd.tobytes() == expected.tobytes()
        assert expected.any()
        for name in ('time', 'q', 'qd'):
            np.testing.assert_array_equal(getattr(twin, name), getattr(run, name))
        assert (twin.status, twin.finite_steps) == (run.status, run.finite_steps)


@pytest.mark.parametrize('way', COPIES)
def test_laws_runs_and_trajectories_of_many_arms_survive_a_copy(way: str) -> None:
    robot = pfd.load_robot('planar2')
    law = COPIES[way](pfd.Feedback([1.0, 2.0], [0.1, 0.1], [0.0, 1.0]))
    whole = COPIES[way](pfd.StateFeedback(np.ones((2, 4)), [0.0, 1.0]))
    for feedback in (law, whole):
        runs = pfd.Ensemble(robot, 2).rollout(steps=5, feedback=feedback)
        np.testing.assert_array_equal(COPIES[way](runs).qdd, runs.qdd)
    motion = pfd.integrate(robot, lambda t, q, qd: [1.0, 0.0], 1.0)
    again = COPIES[way](motion)
    np.testing.assert_array_equal(again.at([0.3]).q, motion.at([0.3]).q)
    assert (again.status, again.evaluations) == (motion.status, motion.evaluations)
    pair = pfd.Simulator(robot).linearize([0.1, 0.2], [0, 0], [1, 1])
    for one, two in zip(
        (*pair, pair.status), (*COPIES[way](pair), COPIES[way](pair).status), strict=True
    ):
        np.testing.assert_array_equal(one, two)
    damping = np.random.default_rng(1).uniform(0.5, 2.0, (3, 2))
    differing = pfd.Ensemble(robot, 3, parameters={'damping': damping})
    twins = COPIES[way](differing).rollout(steps=5)
    np.testing.assert_array_equal(twins.q, differing.rollout(steps=5).q)
    for digits in (None, 30):
        run = pfd.emulate(robot, [0.1, 0.2], [0, 0], [1, 1], digits=digits)
        twin = COPIES[way](run)
        np.testing.assert_array_equal(twin.qdd, run.qdd)
        assert (twin.steps, twin.status) == (run.steps, run.status)
        assert str(twin.program) == str(run.program)


def test_functions_called_from_many_threads_give_the_same_bits() -> None:
    robots = [pfd.load_robot(name) for name in ('planar2', 'ur5')]
    states = [np.random.default_rng(k).normal(size=(3, robot.n)) for k, robot in enumerate(robots)]

    def both(k: int) -> bytes:
        forward = pfd.forward_dynamics(robots[k % 2], *states[k % 2], method='auto')
        inverse = pfd.inverse_dynamics(robots[k % 2], *states[k % 2])
        return bytes(forward.tobytes() + inverse.tobytes())

    wanted = [both(k) for k in range(2)]
    cached_kernel.cache_clear()
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(both, range(64))) == wanted * 32
