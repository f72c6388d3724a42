# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The bits of kernels, simulations and recordings, and the findings of logs, are those stored.

    python test/test_digests.py   writes test/data/digests.json and test/data/findings/*.json

The files are written anew only for an intended change of bits, which the commit names. All bits
are the same on every processor and in every version of Python and NumPy: numbers of robots are
therefore stored, and random ones come from Python's own arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
import hashlib
import json
from pathlib import Path
import random
from typing import Any

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.kernels import native
from pfd_ros import read_log
from pfd_ros.page import page

DATA = Path(__file__).resolve().parent / 'data'
DIGESTS = DATA / 'digests.json'
FINDINGS = DATA / 'findings'
# A batch of one full register and a tail, in every format and on every processor.
STATES = 19
Array = np.ndarray[Any, Any]

# Robots: included ones, and files of data/robots.
ROBOTS = ('puma560', 'ur5', 'panda', 'planar2', 'pendulum', 'slider', 'mixed5', 'dense6')
PAYLOAD = pfd.Payload(1.5, (0.02, -0.05, 0.1), np.diag([0.02, 0.03, 0.04]))


def _over(n: int, start: float, step: float) -> list[float]:
    return [start + step * i for i in range(n)]


def loads(n: int) -> pfd.Scene:
    """Return a scene with everything that acts on links, and with brakes."""
    return pfd.Scene(
        gravity=(0.3, -0.2, -9.6),
        damping=_over(n, 0.25, 0.125),
        armature=_over(n, 0.5, -0.0625),
        payload=PAYLOAD,
        external_wrench=True,
        brakes=True,
    )


def motors(n: int) -> pfd.Scene:
    """Return a scene with motors that compensate gravity and have limits, and with springs."""
    return pfd.Scene(
        effort_limits=_over(n, 30.0, -2.0),
        torque_speed=[[(0.2 + 0.1 * i, 25.0 + i), (4.0 + i, 1.0)] for i in range(n)],
        gravity_compensation=pfd.Scene(gravity=(0.0, 0.1, -9.7)),
        stiffness=_over(n, 5.0, 1.5),
        rest_position=_over(n, -0.5, 0.25),
        cogging=[(0.5, 6.0 + i, 0.25 * i) for i in range(n)],
    )


def contact(n: int) -> pfd.Scene:
    """Return a scene with friction, stops and their restitution."""
    return pfd.Scene(
        damping=_over(n, 0.5, 0.125),
        friction=_over(n, 3.0, -0.375),
        static_friction=_over(n, 4.0, -0.375),
        stribeck_velocity=_over(n, 0.125, 0.0625),
        joint_limits=[(-0.5 - 0.125 * i, 0.375 + 0.125 * i) for i in range(n)],
        restitution=0.5,
    )


def plain(n: int) -> pfd.Scene:
    """Return rigid links and gravity."""
    return pfd.Scene()


# A robot and its scene.
CASES: Mapping[str, tuple[str, Callable[[int], pfd.Scene]]] = {
    **{name: (name, plain) for name in ROBOTS},
    'ur5 with loads': ('ur5', loads),
    'mixed5 with loads': ('mixed5', loads),
    'mixed5 with motors': ('mixed5', motors),
    'mixed5 with a payload as an input': ('mixed5', lambda n: pfd.Scene(payload='input')),
}
# Kernels of which the bits are stored, by case and format: the default of each, all of one.
MANY = 'mixed5'
SINGLE = {'ur5': ('composite_body',), MANY: ('derivatives', 'pcgm')}
# What repeats the way of others through the generators of code: slow.
REPEATED = {
    *((case, 'float64', 'default') for case in ('dense6', 'panda', 'ur5 with loads')),
    *((MANY, 'float64', name) for name in ('default', 'divide_and_conquer')),
    *((MANY, 'float32', name) for name in ('default', 'derivatives')),
    'rk4, mixed5 with friction and stops',
    *('velocity_verlet, mixed5 with friction and stops', 'linearize, ur5', 'adaptive, ur5'),
}


@cache
def robot_of(case: str) -> pfd.Robot:
    """Return the robot of a case."""
    name = CASES[case][0]
    path = DATA / 'robots' / f'{name}.yaml'
    return pfd.load_robot(path if path.exists() else name)


def options(name: str) -> dict[str, Any]:
    """Return the options of a kernel: a method of forward dynamics, or another quantity."""
    if name == 'default':
        return {}
    if name in pfd.METHODS:
        return {'method': name}
    # By name, so that the choice of a method is not part of this digest.
    return {'quantity': name} | ({'method': 'composite_body'} if name == 'derivatives' else {})


def kernels() -> list[tuple[str, str, str]]:
    """Return case, format and name of each kernel."""
    others = (name for name in pfd.QUANTITIES if name != 'forward_dynamics')
    every = {MANY: (*pfd.METHODS, *others), 'planar2': ('divide_and_conquer',)}
    return [
        (case, dtype, name)
        for case in CASES
        for dtype, more in (('float64', every), ('float32', SINGLE))
        if dtype == 'float64' or case in more
        for name in ('default', *more.get(case, ()))
    ]


# Results.


def bits(*arrays: Any) -> str:
    """Return the shapes, number formats and digest of some arrays; all NaN are one."""
    told = []
    for given in arrays:
        array = np.array(given, order='C')
        if array.dtype.kind == 'f':
            array = np.where(np.isnan(array), np.nan, array + 0.0)
        told.append(f'{array.dtype.str}{array.shape}{array.tobytes().hex()}')
    return hashlib.blake2b('\0'.join(told).encode(), digest_size=8).hexdigest()


def drawn(name: str, low: float, high: float, *shape: int) -> Array:
    """Return random numbers between two others, the same ones for the same name."""
    draw = random.Random(name)
    numbers = [draw.uniform(low, high) for _ in range(int(np.prod(shape)))]
    return np.array(numbers).reshape(shape)


def arguments(case: str, kernel: pfd.Kernel) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return arguments of a kernel for a batch of STATES, and those that a batch shares."""
    n = robot_of(case).n
    ranges = {'q': 3.0, 'qd': 2.0, 'qdd': 5.0, 'tau': 20.0}
    inputs = kernel.program.inputs
    found = {name: drawn(name, -most, most, STATES, n) for name, most in ranges.items()}
    each = {'tau' if k == 'qdd' else k: x for k, x in found.items() if k in inputs}
    if 'wrench' in inputs:
        each['wrench'] = drawn('wrench', -10.0, 10.0, STATES, 6)
    each = {name: x.astype(kernel.dtype) for name, x in each.items()}
    if kernel.scene.brakes:
        each['brakes'] = drawn('brakes', 0.0, 1.0, STATES, n) > 0.8
    return each, {'payload': PAYLOAD} if 'p' in inputs else {}


def result(case: str, dtype: str, name: str) -> str:
    """Return the digest of what a kernel computes for a batch, and for its first state alone."""
    robot = robot_of(case)
    scene = CASES[case][1](robot.n)
    kernel = pfd.compile_kernel(robot, scene=scene, dtype=dtype, **options(name))
    each, shared = arguments(case, kernel)
    batch = kernel(**each, **shared)
    single = kernel(**{key: x[0] for key, x in each.items()}, **shared)
    assert np.isfinite(batch).all(), f'{case}: {name} is not finite'
    return bits(batch, single)


# Simulations.

STEPS = 200


def _start(n: int, *arms: int) -> tuple[Array, Array]:
    return drawn('start', -0.25, 0.25, *arms, n), drawn('speed', -1.0, 1.0, *arms, n)


def _rollout(case: str, scene: Callable[[int], pfd.Scene], **settings: Any) -> str:
    """Return the digest of a rollout of one arm."""
    robot = robot_of(case)
    simulator = pfd.Simulator(robot, scene(robot.n), **settings)
    simulator.reset(*_start(robot.n))
    run = simulator.rollout(drawn('taus', -4.0, 4.0, STEPS, robot.n))
    assert run.status == 'ok'
    return bits(run.time, run.q, run.qd, run.qdd)


def _ensemble(case: str, scene: Callable[[int], pfd.Scene], **settings: Any) -> str:
    """Return the digest of a rollout of 13 arms with feedback."""
    robot = robot_of(case)
    n, arms = robot.n, 13
    many = pfd.Ensemble(robot, arms, scene(n), **settings)
    many.reset(*_start(n, arms))
    law = pfd.Feedback(np.full(n, 2.0), np.full(n, 0.125), drawn('goal', -0.5, 0.5, n))
    run = many.rollout(drawn('taus', -4.0, 4.0, arms, STEPS, n), feedback=law)
    assert run.status == 'ok'
    return bits(run.time, run.q, run.qd, run.qdd)


def _linearize(case: str, scene: Callable[[int], pfd.Scene], **settings: Any) -> str:
    """Return the digest of A, B and the statuses of a step."""
    robot = robot_of(case)
    simulator = pfd.Simulator(robot, scene(robot.n), **settings)
    step = simulator.linearize(*_start(robot.n), drawn('tau', -4.0, 4.0, robot.n))
    return bits(step.A, step.B, step.status.astype('S'))


def _adaptive(case: str, scene: Callable[[int], pfd.Scene], **settings: Any) -> str:
    """Return the digest of the times and states of an adaptive run."""
    robot = robot_of(case)
    q, qd = _start(robot.n)
    tau = drawn('tau', -4.0, 4.0, robot.n)
    run = pfd.integrate(robot, tau, 0.5, q=q, qd=qd, scene=scene(robot.n), **settings)
    assert run.status == 'ok'
    return bits(run.time, run.q, run.qd)


SIMULATIONS: Mapping[str, Callable[[], str]] = {
    'rk4, ur5': lambda: _rollout('ur5', plain, integrator='rk4'),
    'rk4, ur5, float32': lambda: _rollout('ur5', plain, integrator='rk4', dtype='float32'),
    'velocity_verlet, panda': lambda: _rollout('panda', plain, integrator='velocity_verlet'),
    'imex2, puma560': lambda: _rollout('puma560', plain, integrator='imex2', substeps=2),
    'rk4, mixed5 with friction and stops': lambda: _rollout('mixed5', contact, integrator='rk4'),
    'velocity_verlet, mixed5 with friction and stops': lambda: _rollout(
        'mixed5', contact, integrator='velocity_verlet'
    ),
    'imex2, mixed5 with friction and stops': lambda: _rollout(
        'mixed5', contact, integrator='imex2'
    ),
    'rk4, planar2 with friction, stops and lag': lambda: _rollout(
        'planar2', lambda n: replace(contact(n), motor_lag=_over(n, 0.01, 0.005))
    ),
    'ensemble, ur5': lambda: _ensemble('ur5', plain, integrator='rk4'),
    'ensemble, planar2 with friction and stops': lambda: _ensemble(
        'planar2', contact, integrator='imex2'
    ),
    'linearize, ur5': lambda: _linearize('ur5', plain, integrator='rk4'),
    'linearize, planar2 with friction and stops': lambda: _linearize(
        'planar2', contact, integrator='imex2'
    ),
    'adaptive, ur5': lambda: _adaptive('ur5', plain),
    'adaptive, planar2 with friction and stops': lambda: _adaptive('planar2', contact),
}


# Recordings.

LOGS = ('golden_3_puma560', 'golden_3_ur5', 'faulty', 'demo', 'rejected')


def findings(name: str) -> dict[str, Any]:
    """Return what the page of a log finds and draws, without sentences."""
    log = read_log(DATA / f'{name}.mcap', types=page.TYPES, unreadable='count')
    shown = page.page(log)
    first = shown.first
    return {
        'first': first and [first.kind, first.joint, round(first.time, 6)],
        'findings': [
            {
                'kind': found.kind,
                'severity': found.severity,
                'joint': found.joint,
                'count': len(found.spans),
                'times': [[round(x, 6) for x in span] for span in found.spans[:5].tolist()],
            }
            for found in shown.findings
        ],
        'plots': [
            {
                'title': plot.title,
                'topic': plot.source if plot.source.startswith('/') else None,
                'labels': list(plot.labels),
                'samples': len(plot.time),
            }
            for plot in shown.plots
        ],
        'notes': len(shown.run.notes),
    }


def stored(path: Path = DIGESTS) -> Any:
    return json.loads(path.read_text(encoding='utf-8'))


def sampled(values: Iterable[Any]) -> list[Any]:
    """Return parameters, those that repeat others marked as slow."""
    return [
        pytest.param(
            *(value if isinstance(value, tuple) else (value,)),
            marks=[pytest.mark.slow] * (value in REPEATED),
        )
        for value in values
    ]


@pytest.mark.parametrize(('case', 'dtype', 'name'), sampled(kernels()))
def test_a_kernel_has_the_stored_bits(case: str, dtype: str, name: str) -> None:
    assert result(case, dtype, name) == stored()['kernels'][f'{case}, {dtype}, {name}']


@pytest.mark.parametrize('name', sampled(SIMULATIONS))
def test_a_simulation_has_the_stored_bits(name: str) -> None:
    assert SIMULATIONS[name]() == stored()['simulations'][name]


@pytest.mark.skipif(
    not native.host().triple.startswith('x86_64'), reason='the processor is of x86-64'
)
@pytest.mark.slow
def test_another_processor_has_the_stored_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PFD_CACHE', '')
    # It has no fused multiply-add: the C library computes it. A long test has all levels.
    monkeypatch.setenv('PFD_TARGET_CPU', 'x86-64-v2')
    for case, dtype, name in (
        ('planar2', 'float64', 'default'),
        ('ur5', 'float32', 'default'),
    ):
        assert result(case, dtype, name) == stored()['kernels'][f'{case}, {dtype}, {name}']
    name = 'rk4, planar2 with friction, stops and lag'
    assert SIMULATIONS[name]() == stored()['simulations'][name]


@pytest.mark.parametrize('name', LOGS)
def test_the_page_of_a_log_has_the_stored_findings(name: str) -> None:
    assert findings(name) == stored(FINDINGS / f'{name}.json')


def test_the_logs_have_findings_of_all_kinds() -> None:
    found = [one for name in LOGS for one in stored(FINDINGS / f'{name}.json')['findings']]
    assert {one['severity'] for one in found} == {'bad', 'warning', 'note'}
    kinds = {'gap', 'event', 'rejected input', 'reflex', 'watchdog', 'diagnostics'}
    assert {one['kind'] for one in found} == kinds | {
        f'{name} limit' for name in ('position', 'velocity', 'effort')
    }


def main() -> None:
    """Write the files."""
    found = {
        'kernels': {', '.join(kernel): result(*kernel) for kernel in kernels()},
        'simulations': {name: simulation() for name, simulation in SIMULATIONS.items()},
    }
    DIGESTS.write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')
    for name in LOGS:
        text = json.dumps(findings(name), indent=1)
        (FINDINGS / f'{name}.json').write_text(text + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
