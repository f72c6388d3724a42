# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Runs of the hard motions: errors relative to the stored references, and two effects of time.

    runs                 every check of CHECKS, in native code (Run)
    steady_runs          the motions of STEADY, whose angles are known exactly (SteadyRun)
    predicted_runs        motions of EXACT, and undamped ones in float32, with predicted errors
    formulation          evaluations of the adaptive integrator, by steps of refinement (Effort)
    holds                gains at which a loop through a zero-order hold is stable (Hold)

A torque is constant for T seconds. One joint of inertia I under kp and kd is then stable exactly
if kd < 2 I / T and kp / kd < 2 / T. For several joints, the smallest eigenvalue of H replaces I.
A simulation has these limits only if its integrator does not evaluate the controller.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pfd_core.algorithms.programs import record_terms
from pfd_core.machine.emulator import run
from pfd_core.model import Robot, Scene, load_robot, resolve
from pfd_core.report.cases import exact_motions
from pfd_core.report.cases.exact_motions import EXACT, WHEEL, ExactMotion
from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.cases.motions import CHECKS, MOTIONS, REFERENCES, STEADY, Check, Motion
from pfd_core.report.cases.problems import SEED
from pfd_core.report.cases.robots import Array
from pfd_core.report.measure import predictions
from pfd_core.report.measure.energies import energy
from pfd_core.simulation.embedded_pairs import PAIRS
from pfd_core.simulation.simulator import Simulator

BY_NAME = {motion.name: motion for motion in MOTIONS}
# Absolute tolerance of an adaptive run, as a part of the relative one.
ABSOLUTE = 0.1
# Samples of the energy, and of the angle of a steady motion.
ENERGY_SAMPLES, SAMPLES = 6000, 100
# Step of a steady motion [s].
STEP = 1e-3
# Formulation stiffness: the motion, its tolerance, and the largest number of steps.
STIFF_FORMULATION, TOLERANCE, MOST_STEPS = 'heavy_tip_1e8_planar_n12', 1e-12, 2000
# Evaluations of a run refined once, at most, over the evaluations of a run refined twice.
SAME_EFFORT = 1.05


@dataclass(frozen=True)
class Run:
    """A check, and the error found; infinity for a run that is not finite at its end."""

    check: Check
    error: float

    @property
    def met(self) -> bool:
        """Whether the error is within its bound."""
        return self.error <= self.check.bound


def runs() -> Iterator[Run]:
    """Yield the run of each check."""
    for check in CHECKS:
        yield Run(check, error(check))


def error(check: Check) -> float:
    """Return the error of a check's run."""
    motion = BY_NAME[check.motion]
    duration = motion.duration if check.duration is None else check.duration
    finite, q, qd = _states(check, duration)
    if not finite:
        return np.inf
    if check.quantity == 'angle':
        wanted = np.array([float(x) for x in REFERENCES[motion.name].q])
        return float(np.abs(q[-1] - wanted).max())
    every = max(1, len(q) // ENERGY_SAMPLES)
    kinetic, potential = energy(motion.plant, q[::every], qd[::every])
    total = kinetic + potential
    return float(np.abs(total - total[0]).max() / kinetic.max())


def _states(
    check: Check, duration: float, motion: Motion | None = None
) -> tuple[bool, Array, Array]:
    """Return whether a run, perhaps of another motion, is finite, and its q and qd, (K, n)."""
    motion = motion or BY_NAME[check.motion]
    if check.integrator in PAIRS:
        made = motion.integrated(
            duration,
            integrator=check.integrator,
            rtol=check.step,
            atol=ABSOLUTE * check.step,
            refine=1,
            dense=False,
        )
        return made.status == 'ok', made.q, made.qd
    sim = Simulator(
        motion.robot,
        motion.scene,
        step_size=check.step,
        substeps=1,
        integrator=check.integrator,
        dtype=check.dtype,
    )
    sim.reset(q=motion.q, qd=motion.qd)
    steps = round(duration / check.step)
    rolled = sim.rollout(np.zeros((steps, motion.robot.n), dtype=check.dtype))
    return rolled.status == 'ok', rolled.q, rolled.qd


@dataclass(frozen=True)
class SteadyRun:
    """The error of a steady motion in a number format [rad], and its bound."""

    name: str
    cause: str
    dtype: str
    duration: float
    error: float
    bound: float

    @property
    def met(self) -> bool:
        """Whether the error is within its bound."""
        return self.error <= self.bound


def steady_runs() -> Iterator[SteadyRun]:
    """Yield the run of each steady motion in each number format."""
    for motion in STEADY:
        for dtype, bound in motion.bounds.items():
            found = steady_error(motion, dtype)
            yield SteadyRun(motion.name, motion.cause, dtype, motion.duration, found, bound)


def steady_error(motion: Motion, dtype: str) -> float:
    """
    Return the error of a steady motion; infinity if a state is not finite.

    It is the largest difference of an angle from q(0) + qd t, modulo whole turns, at SAMPLES times
    of the motion [rad].
    """
    import mpmath

    simulator = Simulator(motion.robot, motion.scene, step_size=STEP, substeps=1, dtype=dtype)
    simulator.reset(motion.q, motion.qd)
    begin = simulator.q.astype(np.float64)
    taus = np.zeros((round(motion.duration / STEP / SAMPLES), motion.robot.n))
    largest = 0.0
    for k in range(SAMPLES):
        if simulator.rollout(taus).status != 'ok':
            return np.inf
        passed = motion.duration * (k + 1) / SAMPLES
        with mpmath.workdps(30):
            for angle, turns, at, rate in zip(*simulator.wrapped, begin, motion.qd, strict=True):
                wanted = at + rate * mpmath.mpf(passed) - 2 * mpmath.pi * int(turns)
                largest = max(largest, float(abs(wanted - float(angle))))
    return largest


@dataclass(frozen=True)
class PredictedRun:
    """A motion in fixed steps: error at its end and predicted error [rad]."""

    name: str
    cause: str
    dtype: str
    steps: int
    error: float
    predicted: float

    @property
    def share(self) -> float:
        """The error over its bound."""
        return self.error / (predictions.FACTOR * self.predicted)

    @property
    def met(self) -> bool:
        """Whether the error is within its bound."""
        return self.share <= 1


# Undamped motions in float32, in steps of STEP, and the largest error of rk4 [rad].
UNDAMPED, RK4_ERROR = ('planar2_swing', 'puma560_fall', 'so100_fall'), 1e-8
# Change of a start by which the growth of a motion is measured, and its directions.
CHANGED, GROWTHS = 2.0**-20, 4


def predicted_runs() -> Iterator[PredictedRun]:
    """Yield the motions of EXACT in both number formats, and undamped motions in float32."""
    terms = record_terms(resolve(WHEEL, Scene(gravity=None)), 'parallel')
    zero = np.zeros((1, 1))
    J = float(run(terms, {'q': zero, 'qd': zero})['H'][0, 0, 0])
    for exact in EXACT:
        yield from (exact_run(exact, dtype, J) for dtype in ROUNDING)
    for name in UNDAMPED:
        yield _undamped(BY_NAME[name])


def exact_run(motion: ExactMotion, dtype: str, inertia: float) -> PredictedRun:
    """Return the run of a motion of EXACT; the wheel's inertia is in kg m^2."""
    sim = Simulator(WHEEL, motion.scene, step_size=exact_motions.STEP, substeps=1, dtype=dtype)
    sim.reset(q=(motion.q,), qd=(motion.qd,))
    torques, counts = zip(*motion.torques, strict=True)
    made = sim.rollout(np.repeat(torques, counts)[:, np.newaxis].astype(dtype))
    error = abs(float(made.q[-1, 0]) - motion.end(inertia)) if made.status == 'ok' else np.inf
    rounding = _rounding(made.q, made.qd, motion.steps * exact_motions.STEP, dtype)
    return PredictedRun(
        motion.name, motion.cause, dtype, motion.steps, error, rounding + motion.method(inertia)
    )


def _rounding(q: Array, qd: Array, duration: float, dtype: str) -> float:
    """Return the predicted error of an angle from the roundings of its steps, without growth."""
    # Each step rounds angle and velocity, and an error of a velocity acts until the end.
    # Accelerations have the roundings of the robot's numbers.
    carried = float(np.abs(qd).max()) * duration
    steps = predictions.RMS * np.sqrt(len(q)) * (float(np.abs(q).max()) + carried)
    return ROUNDING[dtype] * float(steps + predictions.SPREAD * carried)


def _undamped(motion: Motion) -> PredictedRun:
    steps = round(motion.duration / STEP)
    check = Check(motion.name, 'rk4', STEP, 'angle', 0.0, dtype='float32')
    finite, q, qd = _states(check, motion.duration)
    wanted = np.array([float(x) for x in REFERENCES[motion.name].q])
    predicted = _rounding(q, qd, motion.duration, 'float32') * _growth(motion) + RK4_ERROR
    error = float(np.abs(q[-1] - wanted).max()) if finite else np.inf
    cause = 'undamped: roundings grow with the motion'
    return PredictedRun(motion.name, cause, 'float32', steps, error, predicted)


def _growth(motion: Motion) -> float:
    """Return how much the angles at the end change over a change of the start, 1 or more."""
    check = Check(motion.name, 'rk4', STEP, 'angle', 0.0)
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], (GROWTHS, 2, motion.robot.n))
    end = _states(check, motion.duration)[1][-1]
    ends = []
    for by_q, by_qd in CHANGED * signs:
        q, qd = (tuple(x) for x in (motion.q + by_q, motion.qd + by_qd))
        ends.append(_states(check, motion.duration, replace(motion, q=q, qd=qd))[1][-1])
    return max(1.0, float(np.abs(np.array(ends) - end).max() / CHANGED))


@dataclass(frozen=True)
class Effort:
    """Evaluations of an adaptive run of STIFF_FORMULATION, None beyond MOST_STEPS."""

    refine: int
    evaluations: int | None


def formulation() -> list[Effort]:
    """Return the effort without, with one and with two steps of refinement."""
    motion = BY_NAME[STIFF_FORMULATION]
    efforts = []
    for refine in range(3):
        made = motion.integrated(
            rtol=TOLERANCE,
            atol=ABSOLUTE * TOLERANCE,
            refine=refine,
            max_steps=MOST_STEPS,
            dense=False,
        )
        efforts.append(Effort(refine, made.evaluations if made.status == 'ok' else None))
    return efforts


@dataclass(frozen=True)
class Hold:
    """
    A control loop through a zero-order hold.

    Attributes
    ----------
    name : str
        The arm and the gain that is varied.
    period : float
        T [s].
    kp, kd : float
        Gains at the limit of stability.
    decays, grows : bool
        Whether a small deviation decays with the varied gain below the limit by NEAR, and grows
        with it above by NEAR.

    """

    name: str
    period: float
    kp: float
    kd: float
    decays: bool
    grows: bool


# Distance from the limit of stability, as a part of it.
NEAR = 0.1
# Deviation [rad] in a period, growth that ends a run, and its periods.
DEVIATION, GROWN, TICKS = 1e-6, 1e3, 2000


def holds() -> Iterator[Hold]:
    """Yield the limits of a rod's and of PUMA's loops, of the gain kd and of the ratio kp / kd."""
    rod, wrist = load_robot('planar2'), load_robot('puma560')
    for name, robot, scene, period, ratio in (
        ('planar2, kd', rod, Scene(gravity=None), 4e-3, 0.0),
        ('puma560, kd', wrist, Scene(gravity=None, armature='model'), 1e-3, 400.0),
        ('puma560 without rotors, kd', wrist, Scene(gravity=None), 1e-3, 400.0),
    ):
        kd = 2 * _smallest(robot, scene)[0] / period
        decays, grows = (
            _decays(robot, scene, period, kd * part * ratio, kd * part)
            for part in (1 - NEAR, 1 + NEAR)
        )
        yield Hold(name, period, kd * ratio, kd, decays, not grows)
    period = 4e-3
    kd = 0.1 * 2 * _smallest(rod, Scene(gravity=None))[0] / period
    kp = kd * 2 / period
    decays, grows = (
        _decays(rod, Scene(gravity=None), period, kp * part, kd) for part in (1 - NEAR, 1 + NEAR)
    )
    yield Hold('planar2, kp / kd', period, kp, kd, decays, not grows)


def _smallest(robot: Robot, scene: Scene) -> tuple[float, Array]:
    """Return the smallest eigenvalue of H at the held position, and its vector."""
    program = record_terms(resolve(robot, scene), 'parallel')
    q = np.full(robot.n, 0.5)
    H = run(program, {'q': q[np.newaxis], 'qd': 0 * q[np.newaxis]})['H'][0]
    values, vectors = np.linalg.eigh(H)
    return float(values[0]), vectors[:, 0]


def _decays(robot: Robot, scene: Scene, period: float, kp: float, kd: float) -> bool:
    """Return whether a deviation along the lightest direction decays, with zero-order hold."""
    sim = Simulator(robot, scene, step_size=period, substeps=8)
    held = np.full(robot.n, 0.5)
    sim.reset(q=held, qd=DEVIATION / period * _smallest(robot, scene)[1])
    first = size = float(np.abs(sim.qd).max())
    for _ in range(TICKS):
        sim.step(-kp * (sim.q - held) - kd * sim.qd)
        size = float(np.abs(sim.qd).max())
        if size > GROWN * first:
            return False
    return size < first
