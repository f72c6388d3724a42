# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A step that is refused, or a rollout that is interrupted, leaves state and time together."""

from __future__ import annotations

from collections.abc import Callable
import subprocess
import sys
from typing import Any

import bridge
import numpy as np
import pytest
from sampling import one_fast

import pfd_core as pfd

EVERYTHING = pfd.Scene(external_wrench=True, brakes=True)
WRENCH = np.arange(6) / 7


def facts(sim: pfd.Simulator) -> tuple[Any, ...]:
    """Return all public values of a simulation, as bits."""
    return sim.q.tobytes(), sim.qd.tobytes(), sim.qdd.tobytes(), sim.time, sim.status


REFUSED: dict[str, Callable[[pfd.Simulator], Any]] = {
    'torque': lambda s: s.step([7.0], WRENCH),
    'wrench of five': lambda s: s.step([7.0, 8.0], np.ones(5)),
    'no wrench': lambda s: s.step([7.0, 8.0]),
    'wrench that is not finite': lambda s: s.step([7.0, 8.0], np.full(6, np.nan)),
    'brakes that are numbers': lambda s: s.step([7.0, 8.0], WRENCH + 1, brakes=[1, 0]),
    'brakes of three': lambda s: s.step([7.0, 8.0], WRENCH + 1, brakes=[True] * 3),
    'rollout': lambda s: s.rollout([[7.0, 8.0]], WRENCH + 1, brakes=[1, 0]),
    'empty rollout': lambda s: s.rollout(np.zeros((0, 2)), WRENCH + 1, brakes=[1, 0]),
    'rollout of another arm': lambda s: s.rollout(np.zeros((3, 6)), WRENCH + 1),
    'reset to a wrong velocity': lambda s: s.reset([1.0, 2.0], [3.0], 4.0),
    'reset to no time': lambda s: s.reset([1.0, 2.0], [3.0, 4.0], np.nan),
}


@pytest.mark.parametrize('call', REFUSED)
def test_a_call_that_is_refused_leaves_everything_as_it_was(call: str) -> None:
    sim, twin = (pfd.Simulator(pfd.load_robot('planar2'), EVERYTHING) for _ in range(2))
    for one in (sim, twin):
        one.step([1.0, -1.0], WRENCH, brakes=[False, True])
    before = facts(sim)
    with pytest.raises(ValueError, match=r'must|the call needs wrench='):
        REFUSED[call](sim)
    assert facts(sim) == before
    for one in (sim, twin):
        one.step([0.5, 0.25], WRENCH)
    assert facts(sim) == facts(twin)


def test_an_empty_rollout_changes_nothing() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), EVERYTHING)
    sim.step([1.0, -1.0], WRENCH, brakes=[False, True])
    before = facts(sim)
    run = sim.rollout(np.zeros((0, 2)), 2 * WRENCH)
    assert run.qdd.shape == run.q.shape == (0, 2)
    assert run.time.shape == (0,)
    assert facts(sim) == before


@pytest.mark.parametrize('piece', [1e-9, 1e3], ids=['shortest', 'longest'])
@pytest.mark.parametrize('integrator', ['rk4', 'velocity_verlet'])
def test_the_length_of_the_pieces_does_not_change_a_bit(
    piece: float, integrator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    taus = np.random.default_rng(1).normal(size=(300, 2))
    taus[250:] = 1e200  # the state overflows in the middle of a piece

    def run() -> tuple[Any, ...]:
        sim = pfd.Simulator(pfd.load_robot('planar2'), integrator=integrator)
        runs = sim.rollout(taus)
        arrays = (runs.time, runs.q, runs.qd, runs.qdd)
        return *(x.tobytes() for x in arrays), runs.finite_steps, runs.status, *facts(sim)

    wanted = run()
    assert wanted[4] == 250
    monkeypatch.setattr(*bridge.target('SIMULATOR_PIECE_SECONDS'), piece)
    monkeypatch.setattr(*bridge.target('SIMULATOR_FIRST_OPERATIONS'), 10_000)
    assert run() == wanted


INTERRUPTED = """
import os, random, signal, sys, threading
import numpy as np
import pfd_core as pfd

signal.signal(signal.SIGINT, signal.default_int_handler)
seed, times = int(sys.argv[1]), int(sys.argv[2])
settings = dict(substeps=50, integrator=('rk4', 'velocity_verlet')[seed % 2])
scene = pfd.Scene(external_wrench=True, brakes=True)
taus = np.random.default_rng(seed).normal(size=(400_000, 2)) / 10
held = dict(wrench=np.arange(6) / 70, brakes=[False, False])
robot = pfd.load_robot('planar2')
sim, other = (pfd.Simulator(robot, scene, **settings) for _ in range(2))
rng, done = random.Random(seed), 0

def facts(s):
    return s.q.tobytes(), s.qd.tobytes(), s.qdd.tobytes(), s.time, s.status

for _ in range(times):
    by_step = rng.random() < 0.3
    timer = threading.Timer(rng.random() * 0.1, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        if by_step:
            for tau in taus[done:]:
                sim.step(tau, **held)
        else:
            sim.rollout(taus[done:], **held)
        timer.join()
        sys.exit('it was not interrupted')
    except KeyboardInterrupt:
        pass
    now = round(sim.time / sim.step_size)
    if now == len(taus):
        sys.exit('it was not interrupted before its end')
    other.rollout(taus[done:now], **held)
    if facts(sim) != facts(other):
        sys.exit(f'after {now} steps: {facts(sim)} instead of {facts(other)}')
    done = now
for s in (sim, other):
    s.rollout(taus[done:done + 100], **held)
assert facts(sim) == facts(other)
print('went on after', done)
"""


def interrupt(seed: int, times: int) -> None:
    """Interrupt a simulation in a fresh process and compare it with an uninterrupted one."""
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED, str(seed), str(times)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('went on after'), done.stdout


@pytest.mark.parametrize('seed', one_fast(range(2)))
def test_a_simulation_continues_where_it_was_interrupted(seed: int) -> None:
    interrupt(seed, 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    'seed',
    [*range(100, 103), *(pytest.param(k, marks=pytest.mark.long) for k in range(103, 120))],
)
def test_many_simulations_continue_where_they_were_interrupted(seed: int) -> None:
    interrupt(seed, 10)
