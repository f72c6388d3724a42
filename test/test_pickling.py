# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations and their trajectories: pickled, copied, in other processes, from many threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
import copy
from functools import partial
import multiprocessing
import pickle
import sys
from typing import Any

import bridge
from bridge import CACHED_KERNELS, cached_kernel
import numpy as np
import pytest

import pfd_core as pfd

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


def test_the_status_of_an_overflow_is_pickled_and_a_reset_clears_it() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'))
    sim.rollout(np.full((3, 2), 1e300))
    twin = pickle.loads(pickle.dumps(sim))
    assert twin.status == sim.status == 'not_finite'
    twin.reset()
    assert (twin.status, sim.status) == ('ok', 'not_finite')


@pytest.mark.parametrize('way', COPIES)
def test_a_copied_ensemble_continues_with_the_same_bits_independently(way: str) -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 5, EVERYTHING)
    many.reset(np.random.default_rng(1).normal(size=(5, 2)), time=1.0)
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


def test_a_pickled_trajectory_needs_no_compiler_to_be_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = pfd.Simulator(pfd.load_robot('planar2')).rollout(np.zeros((3, 2)))
    data = pickle.dumps(run)
    monkeypatch.setattr(*bridge.target('Simulator_compile'), lambda self: pytest.fail('compiled'))
    assert pickle.loads(data).qdd.tobytes() == run.qdd.tobytes()


@pytest.mark.parametrize('way', COPIES)
def test_laws_runs_and_trajectories_of_many_arms_survive_a_copy(way: str) -> None:
    robot = pfd.load_robot('planar2')
    law = COPIES[way](pfd.Feedback([1.0, 2.0], [0.1, 0.1], [0.0, 1.0]))
    whole = COPIES[way](pfd.StateFeedback(np.ones((2, 4)), [0.0, 1.0]))
    for feedback in (law, whole):
        runs = pfd.Ensemble(robot, 2).rollout(steps=5, feedback=feedback)
        np.testing.assert_array_equal(COPIES[way](runs).qdd, runs.qdd)
    for digits in (None, 30):
        run = pfd.emulate(robot, [0.1, 0.2], [0, 0], [1, 1], digits=digits)
        twin = COPIES[way](run)
        np.testing.assert_array_equal(twin.qdd, run.qdd)
        assert (twin.steps, twin.status) == (run.steps, run.status)
        assert str(twin.program) == str(run.program)


class _Kernel:
    """A kernel that takes no time, so that a cache of them is all there is to wait for."""

    def __call__(self, *args: Any, **kwargs: Any) -> float:
        return 0.0


def test_kernels_are_kept_without_a_race(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = pfd.load_robot('planar2')
    scenes = [pfd.Scene(gravity=(0.0, 0.0, float(k))) for k in range(CACHED_KERNELS + 8)]
    monkeypatch.setattr(*bridge.target('functions_KernelSpec'), lambda *options: options)
    monkeypatch.setattr(*bridge.target('functions_compile_spec'), lambda spec: _Kernel())
    interval = sys.getswitchinterval()

    def work(seed: int) -> None:
        for k in np.random.default_rng(seed).integers(len(scenes), size=2000):
            pfd.forward_dynamics(robot, 0, 0, 0, scene=scenes[k])
            pfd.inverse_dynamics(robot, 0, 0, 0, scene=scenes[k])

    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            for done in [pool.submit(work, seed) for seed in range(4)]:
                done.result()
    finally:
        sys.setswitchinterval(interval)
        cached_kernel.cache_clear()


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
