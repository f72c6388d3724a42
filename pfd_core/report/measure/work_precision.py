# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Work-precision of integrators: time and evaluations of a motion over its errors.

Runs of one motion:

    rk4, velocity_verlet, imex2      a Simulator in steps of h, in native code
    dop853                           pfd_core.integrate at a tolerance
    MuJoCo Euler, implicit, ...      mj_step in steps of h; contacts and constraints are off
    CasADi RK4, Pinocchio C++ RK4    classical Runge-Kutta around articulated bodies, native code

A run that blew up is a missing point, never a fast one: its state is not finite, MuJoCo has reset
it, or an angle is off by more than LOST. All others take turns in one process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from pfd_core.model import Plant
from pfd_core.report.cases.motions import FREE, MOTIONS, Motion
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders.casadi import Casadi
from pfd_core.report.contenders.control_loop import CASADI, PINOCCHIO
from pfd_core.report.contenders.mujoco import INTEGRATORS, Mujoco
from pfd_core.report.contenders.pinocchio_cpp import PinocchioCpp
from pfd_core.report.contenders.work import LeftOutError, Side
from pfd_core.report.measure.energies import SAMPLES, Reference, interval, reference
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.timing import Pace, interleave
from pfd_core.simulation.integrators import TABLE, record_step
from pfd_core.simulation.simulator import Simulator

# A turn of a joint [rad].
LOST = 2 * np.pi
ADAPTIVE = 'dop853'
# The absolute tolerance, as a part of the relative one.
ABSOLUTE = 1e-3
# Ways in native code with four evaluations in a step.
NATIVE = (CASADI, PINOCCHIO)
WAYS = (*TABLE, ADAPTIVE, *INTEGRATORS, *NATIVE)
# Moves a state q and qd, (n,), from one sample to the next.
Advance = Callable[[], object]


@dataclass(frozen=True)
class Plan:
    """
    Plan of a comparison of integrators.

    Attributes
    ----------
    motions : tuple of Motion
        The motions.
    steps : tuple of float
        Steps h [s] of the fixed integrators; the interval between samples is a multiple of each.
    tolerances : tuple of float
        Relative tolerances of the adaptive one.
    peers : tuple of str
        Names in PEERS.
    pace : Pace
        Durations and repetitions.

    """

    motions: tuple[Motion, ...] = FREE
    steps: tuple[float, ...] = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
    tolerances: tuple[float, ...] = tuple(10.0**-k for k in range(3, 13))
    peers: tuple[str, ...] = ('MuJoCo', *NATIVE)
    pace: Pace = field(default_factory=lambda: Pace(budget=16.0, turns=20, fewest=3))


QUICK = Plan(
    motions=tuple(motion for motion in MOTIONS if motion.name == 'planar2_swing'),
    steps=(1e-2, 2e-3),
    tolerances=(1e-4, 1e-8),
    pace=Pace(chunk=1e-4, turns=2, fewest=2),
)


@dataclass(frozen=True)
class MotionFacts:
    """A motion: name, note, joints, seconds, and the self-difference of its reference [rad]."""

    name: str
    note: str
    n: int
    duration: float
    self_difference: float


@dataclass(frozen=True)
class RunPoint:
    """
    Work and errors of one run.

    Attributes
    ----------
    motion, way : str
        Names of the motion and of the integrator.
    step, tolerance : float or None
        Step h [s] of a fixed integrator, relative tolerance of an adaptive one.
    status : str
        'ok', or the reason for which the point is missing.
    evaluations : float or None
        Evaluations of the dynamics for each simulated second.
    minimum, median : float or None
        Seconds for each simulated second.
    trajectory_error, energy_error : float or None
        Errors, as pfd_core.report.measure.energies defines them.

    """

    motion: str
    way: str
    step: float | None
    tolerance: float | None
    status: str
    evaluations: float | None = None
    minimum: float | None = None
    median: float | None = None
    trajectory_error: float | None = None
    energy_error: float | None = None

    @property
    def setting(self) -> str:
        """Step or tolerance as a string."""
        if self.step is None:
            return f'rtol {self.tolerance:.0e}'
        return f'{self.step * 1e3:g} ms'


@dataclass(frozen=True)
class Outcome:
    """Result of a run: status, states at the samples, (SAMPLES, n), and all evaluations."""

    status: str
    q: Array
    qd: Array
    evaluations: int


@dataclass(frozen=True)
class Run:
    """One way with one setting; `run` computes the motion from its start."""

    way: str
    step: float | None
    tolerance: float | None
    run: Callable[[], Outcome]


def measure(motion: Motion, plan: Plan) -> tuple[MotionFacts, list[RunPoint], list[str]]:
    """Return a motion, its points, and the excluded implementations with reasons."""
    show_progress(f'{motion.name}: reference')
    known = reference(motion)
    facts = MotionFacts(
        motion.name, motion.cause, motion.robot.n, motion.duration, known.self_difference
    )
    left_out: list[str] = []
    runs = list(_runs(motion, plan, left_out))
    show_progress(f'{motion.name}: {len(runs)} runs')
    points = [_point(motion, known, run) for run in runs]
    sound = [k for k, point in enumerate(points) if point.status == 'ok']
    # The unit is a simulated second.
    sides = [Side(runs[k].way, runs[k].run, lambda: known.q) for k in sound]
    for k, times in zip(sound, interleave(sides, 1, plan.pace), strict=True):
        seconds = {name: getattr(times, name) / motion.duration for name in ('minimum', 'median')}
        points[k] = RunPoint(**vars(points[k]) | seconds)
    return facts, points, left_out


def _point(motion: Motion, known: Reference, run: Run) -> RunPoint:
    """Return the errors of a run, without times, or the status of one that diverged."""
    found = run.run()
    point = partial(RunPoint, motion.name, run.way, run.step, run.tolerance)
    if found.status != 'ok':
        return point(found.status)
    trajectory, drift = known.errors(motion, found.q, found.qd)
    if not trajectory <= LOST:
        return point('lost')
    return point(
        'ok',
        found.evaluations / motion.duration,
        trajectory_error=trajectory,
        energy_error=drift,
    )


def _runs(motion: Motion, plan: Plan, left_out: list[str]) -> Iterator[Run]:
    for way in TABLE:
        for step in plan.steps:
            yield Run(way, step, None, _fixed(motion, way, step))
    for tolerance in plan.tolerances:
        yield Run(ADAPTIVE, None, tolerance, partial(_adaptive, motion, tolerance))
    for peer in plan.peers:
        try:
            yield from PEERS[peer](motion, plan)
        except LeftOutError as reason:
            left_out.append(f'{peer} at {motion.name}: {reason}')


def _of_mujoco(motion: Motion, plan: Plan) -> Iterator[Run]:
    peer = Mujoco(motion.robot)
    for way in INTEGRATORS:
        for step in plan.steps:
            yield Run(way, step, None, _mujoco(peer, motion, way, step))


def _of_native(
    way: str, make: Callable[[Plant], Casadi | PinocchioCpp], motion: Motion, plan: Plan
) -> Iterator[Run]:
    peer, n = make(motion.plant), motion.robot.n
    for step in plan.steps:
        q, qd = np.empty((2, n))
        substeps = round(interval(motion) / step)
        advance = peer.rollout(step, q, qd, np.zeros((1, n)), substeps)
        yield Run(way, step, None, _native(motion, advance, q, qd, substeps))


PEERS: dict[str, Callable[[Motion, Plan], Iterator[Run]]] = {
    'MuJoCo': _of_mujoco,
    CASADI: partial(_of_native, CASADI, Casadi),
    PINOCCHIO: partial(_of_native, PINOCCHIO, PinocchioCpp),
}


def _fixed(motion: Motion, way: str, step: float) -> Callable[[], Outcome]:
    """Return a run of a Simulator; the torque, which is zero, is constant between two samples."""
    substeps = round(interval(motion) / step)
    simulator = Simulator(
        motion.robot,
        motion.scene,
        step_size=interval(motion),
        substeps=substeps,
        integrator=way,
    )
    taus = np.zeros((SAMPLES, motion.robot.n))
    program = record_step(TABLE[way], motion.robot.n, step, motion.plant.viscosity)
    calls = sum(instruction.op == 'call' for instruction in program.instructions)
    evaluations = calls * substeps * SAMPLES

    def run() -> Outcome:
        simulator.reset(motion.q, motion.qd)
        found = simulator.rollout(taus)
        return Outcome(found.status, found.q, found.qd, evaluations)

    return run


def _adaptive(motion: Motion, tolerance: float) -> Outcome:
    """Return the run of `integrate` at a tolerance, the states from its dense output."""
    found = motion.integrated(rtol=tolerance, atol=tolerance * ABSOLUTE)
    if found.status != 'ok':
        return Outcome(found.status, found.q, found.qd, found.evaluations)
    times = np.linspace(0, motion.duration, SAMPLES + 1)[1:]
    states = found.at(times)
    return Outcome('ok', states.q, states.qd, found.evaluations)


def _mujoco(peer: Mujoco, motion: Motion, way: str, step: float) -> Callable[[], Outcome]:
    """Return a run of mj_step by one of MuJoCo's integrators."""
    mj, (_, evaluations) = peer.mj, INTEGRATORS[way]
    model = peer.model_of(motion.plant, way, step)
    data = mj.MjData(model)
    substeps = round(interval(motion) / step)
    q, qd = np.empty((2, SAMPLES, motion.robot.n))

    def run() -> Outcome:
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion.q, motion.qd
        for k in range(SAMPLES):
            mj.mj_step(model, data, nstep=substeps)
            q[k], qd[k] = data.qpos, data.qvel
        # After a warning about a number that is too large MuJoCo restarts from its initial state.
        status = 'failed: MuJoCo warned' if data.warning.number.any() else 'ok'
        if not np.isfinite([q, qd]).all():
            status = 'not_finite'
        return Outcome(status, q, qd, evaluations * substeps * SAMPLES)

    return run


def _native(
    motion: Motion, advance: Advance, q: Array, qd: Array, substeps: int
) -> Callable[[], Outcome]:
    """Return a run of native code, which moves q and qd in place."""
    states = np.empty((2, SAMPLES, motion.robot.n))

    def run() -> Outcome:
        q[:], qd[:] = motion.q, motion.qd
        for k in range(SAMPLES):
            advance()
            states[:, k] = q, qd
        status = 'ok' if np.isfinite(states).all() else 'not_finite'
        return Outcome(status, states[0], states[1], 4 * substeps * SAMPLES)

    return run
