# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every parameter of every public function: wrong values are errors that name the parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import inspect
from pathlib import Path
import re
import reprlib
from typing import Any
import warnings

import numpy as np
import pytest

import pfd_core as pfd

ROBOT = pfd.load_robot('planar2')
STATE = np.zeros(2)
# What the functions return; a user has no reason to construct one.
RESULTS = {
    'AdaptiveTrajectory',
    'Kernel',
    'Linearization',
    'PhysicsWarning',
    'Program',
    'Run',
    'SimulationState',
    'Steps',
    'Trajectory',
    'TreeError',
    'Urdf',
}
# Valid arguments of each public function and constructor, as far as it needs some.
VALID: dict[str, dict[str, Any]] = {
    'Ensemble': {'robot': ROBOT, 'size': 2},
    'Feedback': {'kp': 1.0, 'kd': 1.0, 'q': STATE},
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
    'StateFeedback': {'gain': np.zeros((2, 4)), 'q': STATE},
    'compile_kernel': {'robot': ROBOT},
    'emulate': {'robot': ROBOT, 'q': STATE, 'qd': STATE, 'tau': STATE},
    'estimated_armature': {'robot': ROBOT},
    'forward_dynamics': {'robot': ROBOT, 'q': STATE, 'qd': STATE, 'tau': STATE},
    'integrate': {'robot': ROBOT, 'tau': STATE, 'duration': 0.01},
    'inverse_dynamics': {'robot': ROBOT, 'q': STATE, 'qd': STATE, 'qdd': STATE},
    'known_robots': {},
    'load_robot': {'source': 'planar2'},
    'load_scene': {'source': 'gravity: [0, 0, -9.81]\n'},
    'lock': {'robot': ROBOT, 'positions': {'shoulder': 0.0}},
    'read_urdf': {'source': 'planar2'},
    'reflected_inertia': {'rotor_inertia': [1.0], 'gear_ratio': [2.0]},
    'robot_to_urdf': {'robot': ROBOT},
    'robot_to_yaml': {'robot': ROBOT},
    'scene_to_yaml': {'scene': pfd.Scene()},
    'urdf_of': {'source': 'planar2'},
    'with_payload': {'robot': ROBOT, 'payload': pfd.Payload(1.0)},
}
HOSTILE = [
    *(
        None,
        True,
        0,
        -1,
        2,
        1.5,
        1j,
        float('nan'),
        float('inf'),
        10**400,
        -(10**400),
        np.float32(3),
    ),
    *(
        '',
        'no',
        'a\nb',
        b'bytes',
        [],
        [1],
        [[1.0], [2.0, 3.0]],
        (),
        {},
        {'a': 1},
        {1: 'a'},
        {1, 2},
    ),
    *(object(), len, Exception, np.zeros((2, 6)), np.zeros((3, 6)), np.array('text'), range(3)),
    *(np.float64, np.dtype('float64')),
    *(np.datetime64('2020-01-01'), np.ma.masked, ROBOT, pfd.Scene(), pfd.Payload(1.0)),
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
    'AdaptiveTrajectory': lambda: pfd.integrate(ROBOT, STATE, duration=0.01, dense=True),
    'Ensemble': lambda: pfd.Ensemble(ROBOT, 2),
    'Kernel': lambda: pfd.compile_kernel(ROBOT, refine=1),
    'MotorSimulator': lambda: pfd.MotorSimulator(ROBOT),
    'Program': lambda: pfd.compile_kernel(ROBOT, refine=1).program,
    'Robot': lambda: ROBOT,
    'Scene': pfd.Scene,
    'Simulator': lambda: pfd.Simulator(ROBOT),
    'Urdf': lambda: pfd.read_urdf(pfd.urdf_of('planar2')),
}
STATES: dict[str, Any] = {'q': STATE, 'qd': STATE, 'tau': STATE}
OUT = np.zeros(2)
MOTION = pfd.MotorSimulator(ROBOT).new_state()
# Valid arguments of each public method with parameters.
METHODS: dict[str, dict[str, dict[str, Any]]] = {
    'AdaptiveTrajectory': {'at': {'times': [0.0]}},
    'Ensemble': {
        'linearize': STATES,
        'reset': {},
        'rollout': {'steps': 2},
    },
    'Kernel': {'__call__': STATES, 'bind': STATES | {'out': OUT}, 'error_estimate': STATES},
    'MotorSimulator': {
        'accelerations': {'state': MOTION},
        'bind': {
            'state': MOTION,
            'motors': pfd.MotorState(np.zeros(2)),
            'limits': np.ones((7, 2)),
        },
        'converted': {'state': MOTION},
        'linearize': STATES,
        'new_state': {},
        'prepare_payload': {'payload': None},
        'reset': {},
        'rollout': {'taus': np.zeros((2, 2))},
        'set_inputs': {'state': MOTION},
        'step': {'tau': STATE},
    },
    'Program': {'count': {}},
    'Robot': {'frame': {}},
    'Scene': {'save': {}, 'without': {'names': ()}},
    'Simulator': {
        'linearize': STATES,
        'prepare_payload': {'payload': None},
        'reset': {},
        'rollout': {'taus': np.zeros((2, 2))},
        'step': {'tau': STATE},
    },
    'Urdf': {'with_followers': {'locked': {}}},
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


def test_batches_that_do_not_agree_are_named_by_emulate() -> None:
    robot = pfd.load_robot('puma560')
    with pytest.raises(ValueError, match=r'agree in their batch, got q \(2, 6\), qd \(3, 6\)'):
        pfd.emulate(robot, np.zeros((2, 6)), np.zeros((3, 6)), np.zeros(6))
