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

import numpy as np
import pytest
from zoo import ARM, WHEEL, joint, link, random_state, urdf, without_mass

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
    'positions': 'lock|positions',
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
    'Urdf': lambda: pfd.read_urdf(pfd.urdf_of('planar2')),
}
ZEROS: dict[str, Any] = {'q': ZERO, 'qd': ZERO, 'tau': ZERO}
OUT = np.zeros(2)
# A state of the simulation itself, which is made in its test.
MOTION: Any = None
MANY: dict[str, dict[str, Any]] = {'linearize': ZEROS, 'outside_stops': {'q': ZERO}, 'reset': {}}
ONE = MANY | {'rollout': {'taus': np.zeros((2, 2))}, 'step': {'tau': ZERO}}
ONE |= {'prepare_payload': {'payload': None}}
BOUND = {'motors': pfd.MotorState(np.zeros(2)), 'limits': np.ones((7, 2))}
# Valid arguments of each public method with parameters.
METHODS: dict[str, dict[str, dict[str, Any]]] = {
    'AdaptiveTrajectory': {'at': {'times': [0.0]}},
    'Ensemble': MANY | {'rollout': {'steps': 2}},
    'Kernel': {'__call__': ZEROS, 'bind': ZEROS | {'out': OUT}, 'error_estimate': ZEROS},
    'MotorSimulator': ONE
    | {key: {'state': MOTION} for key in ('accelerations', 'converted', 'set_inputs')}
    | {'bind': {'state': MOTION, **BOUND}, 'new_state': {}},
    'Program': {'count': {}},
    'Robot': {'frame': {}},
    'Scene': {'save': {}, 'without': {'names': ()}},
    'Simulator': ONE,
    'Urdf': {'with_followers': {'positions': {}}},
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
    one, found = INSTANCES[owner](), list[str]()
    for name, valid in METHODS[owner].items():
        own = {'state': one.new_state()} if 'state' in valid else {}
        found += problems(f'{owner}.{name}', getattr(one, name), valid | own)
    assert not found, '\n'.join(found)


# Numbers at run time.


def wrong_calls() -> Iterator[Any]:
    """Yield calls, arguments of which one is wrong or missing, and the error."""
    torques = np.zeros((5, 2))
    rows: list[tuple[Callable[..., Any], list[tuple[dict[str, Any], str]]]] = [
        (
            partial(pfd.Simulator, ROBOT),
            [
                ({'step_size': 0.0}, 'step_size must be above zero seconds, got 0.0'),
                ({'substeps': 1.5}, 'substeps must be an integer of at least 1, got 1.5'),
                # Numbers that a 64-bit integer would take for 2 and for 0.
                (
                    {'substeps': 2**64 + 2},
                    'substeps must be an integer from 1 to 100000, got 1844',
                ),
                ({'refine': 2**64}, 'refine must be an integer from 0 to 16, got 18446744073709'),
                ({'dtype': 'float16'}, "dtype must be one of .* got 'float16'"),
            ],
        ),
        (
            partial(pfd.compile_kernel, ROBOT),
            [
                ({'method': 'euler'}, "method must be 'auto' or one of .* got 'euler'"),
                ({'refine': -1}, 'refine must be an integer of at least 0, got -1'),
                ({'scene': pfd.Scene(damping=[1.0])}, 'damping .* 1 numbers, .* 2 joints'),
                ({'scene': {}}, 'scene must be a Scene or None'),
                (
                    {'scene': pfd.Scene(friction=[0, 0], static_friction=[1, 1])},
                    "'static_friction'.* act over a step of time",
                ),
                ({'frame': 'tool0'}, 'forward_dynamics does not take a frame'),
                ({'quantity': 'tip_pose', 'frame': 'hand'}, "frame 'hand' is not carried by"),
                # A kernel of the simulator alone.
                ({'quantity': 'step'}, "quantity must be one of .* got 'step'"),
                ({'quantity': 'mass'}, "quantity must be one of .*'inertia_matrix'.* got 'mass'"),
                ({'quantity': 'energy', 'refine': 1}, 'refine must be 0 for energy, .* got 1'),
                (
                    {'quantity': 'energy', 'method': 'pcrbm'},
                    "method must be 'auto' or 'link_velocities' for energy, got 'pcrbm'",
                ),
                ({'quantity': 'energy', 'frame': 'tool0'}, 'energy does not take a frame, got'),
            ],
        ),
        (
            lambda **given: pfd.emulate(ROBOT, **ZEROS | given),
            [
                ({'method': 'aba'}, "method must be one of .* got 'aba'"),
                ({'processors': 0}, 'processors must be an integer of at least 1, got 0'),
                ({'processors': 3}, 'processors must be an integer from 1 to 2, got 3'),
                ({'processors': 1.5}, 'processors must be an integer of at least 1, got 1.5'),
                ({'dtype': 'float16'}, "dtype must be one of .* got 'float16'"),
                (
                    {'processors': 2, 'method': 'articulated_body'},
                    "processors must be 1 for the serial method 'articulated_body', got 2",
                ),
                ({'q': np.zeros(3)}, r'q must have shape \(2,\) or \(B, 2\), got \(3,\)'),
                ({'tau': [np.nan, 0.0]}, 'tau must be finite'),
                ({'tau': [1e50, 0.0], 'dtype': 'float32'}, 'tau must fit float32'),
                ({'wrench': np.zeros(5)}, r'wrench must have shape \(6,\) or \(B, 6\), got'),
                ({'edition': 'second'}, r"edition must be one of .*'printed'.* got 'second'"),
                (
                    {'edition': 'printed'},
                    r"edition 'printed' needs one of the methods .*'pcrbm_1987'.*, got 'pcrbm'",
                ),
                ({'scene': pfd.Scene(external_wrench=True)}, 'the call needs wrench='),
                ({'network': 'torus'}, r"network must be one of .*'ring'.* got 'torus'"),
            ],
        ),
        (
            lambda **given: pfd.Ensemble(ROBOT, 3).rollout(**given),
            [
                ({}, 'steps is required without taus of several steps'),
                ({'taus': torques, 'steps': 4}, 'taus has 5 steps, but steps=4'),
                (
                    {'taus': np.zeros((4, 5, 2))},
                    r'shape \(steps, 2\) or \(3, steps, 2\), got \(4, 5, 2\)',
                ),
                (
                    {'taus': torques, 'feedback': pfd.StateFeedback(np.zeros((2, 2)), 0.0)},
                    r'feedback.gain must have shape .* or \(2, 4\) or \(4,\), got \(2, 2\)',
                ),
                (
                    {'taus': torques, 'feedback': pfd.StateFeedback(np.nan, 0.0)},
                    'feedback.gain must be finite',
                ),
                # Numbers that wrap in 64 bits.
                (
                    {'steps': 2**64 + 2},
                    'steps must be an integer from 0 to 1000000000000, got 184',
                ),
                (
                    {'steps': 1, 'every': 2**64},
                    'every must be an integer from 1 to 92233720368547',
                ),
            ],
        ),
    ]
    for call, each in rows:
        yield from (pytest.param(call, *row, id=row[1]) for row in each)


@pytest.mark.parametrize(('call', 'given', 'message'), [*wrong_calls()])
def test_an_argument_that_cannot_be_is_refused_by_name(
    call: Callable[..., Any], given: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call(**given)


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
    many = pfd.Ensemble(pfd.load_robot('ur5'), 3)
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
    robot = pfd.load_robot('ur5')
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
    if moved == 'kernel':
        MOVED[moved](robot, pfd.Scene(payload=pfd.Payload(1.0, (0.1, 0, 0))))
        MOVED[moved](pfd.lock(robot, {'elbow': 0.0}), None)


def test_an_arm_whose_last_link_has_no_inertia_loads_and_has_all_other_quantities() -> None:
    text = urdf(
        *('thin', *ARM, link('tip', 0.0, J='0 0 0 0 0 0')),
        joint('turn', 'continuous', 'base', 'arm'),
        joint('roll', 'continuous', 'arm', 'tip', axis='1 0 0'),
    )
    robot = pfd.load_robot(text)
    state = random_state(np.random.default_rng(5), 2)
    assert np.isfinite(pfd.inverse_dynamics(robot, *state)).all()
    assert np.isfinite(pfd.compile_kernel(robot, quantity='inertia_matrix')(state[0])).all()
    # Brakes may hold the joint, and an input may give it inertia.
    for scene in (pfd.Scene(brakes=True), pfd.Scene(payload='input')):
        pfd.compile_kernel(robot, scene=scene)
    rotors = np.full((2, 2), 0.1)
    pfd.Ensemble(robot, 2, parameters={'armature': rotors})
    rotors[1, 1] = 0.0
    with pytest.raises(ValueError, match=r"arm 1.*'roll' no armature"):
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
INPUTS: dict[str, Any] = {'wrench': np.arange(6) / 7, 'brakes': [True, False]}
COPIES: dict[str, Callable[[Any], Any]] = {
    'pickle': lambda x: pickle.loads(pickle.dumps(x)),
    'oldest protocol': lambda x: pickle.loads(pickle.dumps(x, 2)),
    'copy': copy.copy,
    'deepcopy': copy.deepcopy,
}
DAMPING = [[0.5, 1.0], [1.0, 2.0], [2.0, 0.5]]
CONTINUING: dict[str, Callable[[], Any]] = {
    'plain': lambda: pfd.Simulator(ROBOT),
    'everything': lambda: pfd.Simulator(
        ROBOT, EVERYTHING, substeps=3, step_size=2e-3, integrator='velocity_verlet'
    ),
    'single': lambda: pfd.Simulator(
        ROBOT, dtype='float32', refine=1, method='grouped_articulated_body'
    ),
    'ensemble': lambda: pfd.Ensemble(ROBOT, 5, EVERYTHING),
    'differing arms': lambda: pfd.Ensemble(ROBOT, 3, parameters={'damping': DAMPING}),
}


def facts(sim: Any) -> tuple[Any, ...]:
    """Return all public values of a simulation, as bits."""
    lagging = sim.tau_motor.tobytes() if sim.scene.motor_lag else b''
    arrays = sim.q.tobytes(), sim.qd.tobytes(), sim.qdd.tobytes(), lagging
    return *arrays, sim.time, sim.status, sim.method


def go_on(sim: Any) -> tuple[Any, ...]:
    """Take further steps and return the facts."""
    inputs = INPUTS if sim.scene.brakes else {}
    sim.rollout(np.full((20, 2), -0.25), **inputs)
    if not sim.batch:
        sim.step([1.0, 2.0], **inputs)
    return facts(sim)


def begun(kind: str) -> tuple[Any, tuple[Any, ...]]:
    """Return a simulation that has run for a while, and its facts."""
    sim = CONTINUING[kind]()
    sim.reset(q=[0.1, 0.2], qd=[0.3, -0.4], time=2.0)
    return sim, go_on(sim)


@pytest.mark.sweep
@pytest.mark.parametrize('way', COPIES)
@pytest.mark.parametrize('kind', CONTINUING)
def test_a_copied_simulation_continues_with_the_same_bits_independently(
    kind: str, way: str
) -> None:
    sim, before = begun(kind)
    twin = COPIES[way](sim)
    assert facts(twin) == before
    assert (twin.robot, twin.scene, twin.dtype) == (sim.robot, sim.scene, sim.dtype)
    after = go_on(twin)
    assert facts(sim) == before
    assert go_on(sim) == after


def test_a_simulation_continues_in_a_fresh_process() -> None:
    sim, _ = begun('everything')
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as pool:
        there = pool.submit(go_on, sim).result()
    assert there == go_on(sim)


@pytest.mark.parametrize('way', COPIES)
def test_a_copied_result_has_the_same_values(way: str) -> None:
    sim = pfd.Simulator(ROBOT, EVERYTHING)
    read, unread = (sim.rollout(np.full((9, 2), 0.5), **INPUTS) for _ in range(2))
    assert read.qdd.any()
    laws = (
        pfd.Feedback([1.0, 2.0], [0.1, 0.1], [0.0, 1.0]),
        pfd.StateFeedback(np.ones((2, 4)), [0.0, 1.0]),
    )
    results = [
        *(read, unread, pfd.integrate(ROBOT, lambda t, q, qd: [1.0, 0.0], 1.0)),
        pfd.Simulator(ROBOT).linearize([0.1, 0.2], [0, 0], [1, 1]),
        *(pfd.emulate(ROBOT, [0.1, 0.2], [0, 0], [1, 1], digits=digits) for digits in (None, 30)),
        *(pfd.Ensemble(ROBOT, 2).rollout(steps=5, feedback=law) for law in laws),
    ]
    twins = [COPIES[way](result) for result in results]
    sim.reset()
    names = ('time', 'q', 'qd', 'qdd', 'status', 'finite_steps', 'evaluations')
    for one, twin in zip(results, twins, strict=True):
        for name in (*names, 'A', 'B', 'steps', 'program'):
            if hasattr(one, name):
                np.testing.assert_array_equal(getattr(twin, name), getattr(one, name), name)
    np.testing.assert_array_equal(twins[2].at([0.3]).q, results[2].at([0.3]).q)
    for law, wanted in zip(laws, results[-2:], strict=True):
        found = pfd.Ensemble(ROBOT, 2).rollout(steps=5, feedback=COPIES[way](law))
        np.testing.assert_array_equal(found.q, wanted.q)


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
