# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A step that is refused, or a rollout that is interrupted, leaves state and time together."""

from __future__ import annotations

from collections.abc import Callable
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from sampling import one_fast

import pfd_core as pfd

WRENCH = np.arange(6) / 7
REFUSED: dict[str, Callable[[pfd.Simulator], Any]] = {
    'torque': lambda s: s.step([7.0], WRENCH),
    'no wrench': lambda s: s.step([7.0, 8.0]),
    'wrench that is not finite': lambda s: s.step([7.0, 8.0], np.full(6, np.nan)),
    'brakes of three': lambda s: s.step([7.0, 8.0], WRENCH + 1, brakes=[True] * 3),
    'rollout': lambda s: s.rollout([[7.0, 8.0]], WRENCH + 1, brakes=[1, 0]),
    'empty rollout': lambda s: s.rollout(np.zeros((0, 2)), WRENCH + 1, brakes=[1, 0]),
    'reset to a wrong velocity': lambda s: s.reset([1.0, 2.0], [3.0], 4.0),
    'reset to no time': lambda s: s.reset([1.0, 2.0], [3.0, 4.0], np.nan),
}


def facts(sim: pfd.Simulator) -> tuple[Any, ...]:
    """Return all public values of a simulation, as bits."""
    return sim.q.tobytes(), sim.qd.tobytes(), sim.qdd.tobytes(), sim.time, sim.status


@pytest.mark.parametrize('call', REFUSED)
def test_a_call_that_is_refused_leaves_everything_as_it_was(call: str) -> None:
    scene = pfd.Scene(external_wrench=True, brakes=True)
    sim, twin = (pfd.Simulator(pfd.load_robot('planar2'), scene) for _ in range(2))
    for one in (sim, twin):
        one.step([1.0, -1.0], WRENCH, brakes=[False, True])
    with pytest.raises(ValueError, match=r'must|the call needs wrench='):
        REFUSED[call](sim)
    assert facts(sim) == facts(twin)
    assert sim.rollout(np.zeros((0, 2)), 2 * WRENCH).q.shape == (0, 2)
    assert facts(sim) == facts(twin)
    for one in (sim, twin):
        one.step([0.5, 0.25], WRENCH)
    assert facts(sim) == facts(twin)


INTERRUPTED = """
import os, random, signal, sys, threading
import numpy as np
import pfd_core as pfd
signal.signal(signal.SIGINT, signal.default_int_handler)
rng, times = random.Random(sys.argv[1]), int(sys.argv[2])
taus = np.random.default_rng(1).normal(size=(400_000, 2)) / 10
robot, done, integrator = pfd.load_robot('planar2'), 0, rng.choice(['rk4', 'velocity_verlet'])
sim, other = (pfd.Simulator(robot, substeps=50, integrator=integrator) for _ in range(2))
facts = lambda s: (s.q.tobytes(), s.qd.tobytes(), s.qdd.tobytes(), s.time, s.status)
for _ in range(times):
    timer = threading.Timer(rng.random() * 0.1, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        if rng.random() < 0.3:
            for tau in taus[done:]:
                sim.step(tau)
        sim.rollout(taus[done:])
        timer.join()
    except KeyboardInterrupt:
        pass
    now = round(sim.time / sim.step_size)
    assert now < len(taus), 'it was not interrupted'
    other.rollout(taus[done:now])
    assert facts(sim) == facts(other), now
    done = now
print('went on after', done)
"""


@pytest.mark.parametrize(
    ('seed', 'times'),
    [
        *one_fast([(0, 3), (1, 3)]),
        pytest.param(2, 30, marks=(pytest.mark.slow, pytest.mark.long)),
    ],
)
def test_a_simulation_continues_where_it_was_interrupted(seed: int, times: int) -> None:
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED, str(seed), str(times)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('went on after'), done.stdout
