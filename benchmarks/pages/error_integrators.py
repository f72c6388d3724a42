# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Work-precision of integrators: time and evaluations of free motions over their errors.

    rk4, velocity_verlet, imex2      a Simulator in steps of h, in native code
    dop853                           pfd_core.integrate at a tolerance
    MuJoCo Euler, implicit, ...      mj_step in steps of h; contacts and constraints are off
    CasADi RK4, Pinocchio C++ RK4    classical Runge-Kutta around composite and articulated bodies

Errors are taken at SAMPLES times of a motion:

    trajectory error    largest |q - reference|, over joints and times [rad or m]
    energy error        largest |E - E of the reference| / largest kinetic energy of the reference

The reference is `integrate` at its tightest tolerance, refined, which is begun anew at each of the
times, so that no state is interpolated. Its self-difference is the largest difference in q from
a second reference by another method with steps of at most LONGEST seconds.

A run that blew up is a missing point, never a fast one: its state is not finite, MuJoCo has reset
it, or an angle is off by more than LOST. All others take turns in one process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases.motions import FREE, Motion
from benchmarks.cases.robots import Array
from benchmarks.peers.casadi import COMPOSITE, Casadi
from benchmarks.peers.mujoco import INTEGRATORS, Mujoco
from benchmarks.peers.pinocchio_cpp import PinocchioCpp
from benchmarks.peers.work import LeftOutError, Side
from benchmarks.plots import CASADI, FLOAT64, GREY, MUJOCO, PINOCCHIO, SKY, logarithmic
from benchmarks.run import show_progress
from benchmarks.table import Columns, Row, bullets, order, page, short, table
from benchmarks.timing import Pace, interleave
from pfd_core.kernels.compile import compile_kernel
from pfd_core.simulation.integrators import TABLE, record_step
from pfd_core.simulation.simulator import Simulator
from pfd_core.simulation.step_control import SMALLEST_RTOL

SAMPLES, LONGEST = 20, 2e-3
# A turn of a joint [rad].
LOST = 2 * np.pi
ADAPTIVE = 'dop853'
# The absolute tolerance of the adaptive integrator, as a part of the relative one.
ABSOLUTE = 1e-3
# Native code of other libraries, with four evaluations in a step.
NATIVE: Mapping[str, Callable[[Any], Casadi | PinocchioCpp]] = {
    'CasADi RK4': partial(Casadi, method=COMPOSITE),
    'Pinocchio C++ RK4': PinocchioCpp,
}
# Ways with colour, marker and line in the plot.
STYLES = dict(
    zip(
        (*TABLE, ADAPTIVE, *INTEGRATORS, *NATIVE),
        (
            *((FLOAT64, 'o', '-'), (SKY, '^', '-'), (FLOAT64, 's', '--'), (FLOAT64, '*', ':')),
            *((MUJOCO, '<', ':'), (MUJOCO, 'v', '-.'), (MUJOCO, '>', '--'), (MUJOCO, 'X', '-')),
            *((CASADI, 'P', '-'), (PINOCCHIO, 'D', '-')),
        ),
        strict=True,
    )
)
# Drawn large and open: Pinocchio's RK4 has the same points.
BEHIND = {'MuJoCo RK4'}


@dataclass(frozen=True)
class Plan:
    """Motions, steps h [s] (parts of the interval between samples), tolerances, and pace."""

    motions: Sequence[Motion] = FREE
    steps: Sequence[float] = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
    tolerances: Sequence[float] = tuple(10.0**-k for k in range(3, 13))
    pace: Pace = field(default_factory=lambda: Pace(budget=16.0, turns=20, fewest=3))


QUICK = Plan(
    motions=FREE[:1],
    steps=(1e-2, 2e-3),
    tolerances=(1e-4, 1e-8),
    pace=Pace(chunk=1e-4, turns=2, fewest=2),
)
# Status, and states (SAMPLES, n), with the number of all evaluations.
Outcome = tuple[str, Array, Array, int]
Run = Callable[[], Outcome]


def measure(quick: bool) -> dict[str, Any]:
    """
    Return motions, runs and what is missing.

    A run is {motion, way, step [s], tolerance, status, evaluations (a simulated second), minimum
    and median [s a simulated second], trajectory_error [rad], energy_error}.
    """
    plan = QUICK if quick else Plan()
    motions, rows, missing = [], list[dict[str, Any]](), list[str]()
    for motion in plan.motions:
        show_progress(f'{motion.name}: reference')
        known = _states(motion, 'articulated_body', motion.duration)
        other = _states(motion, 'composite_body', LONGEST)
        motions.append(
            {
                'name': motion.name,
                'note': motion.cause,
                'n': motion.robot.n,
                'duration': motion.duration,
                'self_difference': float(np.abs(known[0] - other[0]).max()),
            }
        )
        runs = [
            ({'motion': motion.name, 'way': way, 'step': step, 'tolerance': tolerance}, run)
            for way, step, tolerance, run in _runs(motion, plan, missing)
        ]
        show_progress(f'{motion.name}: {len(runs)} runs')
        errors = _errors(motion, *known)
        own = [row | _numbers(run(), motion.duration, errors) for row, run in runs]
        sound = [k for k, row in enumerate(own) if row['status'] == 'ok']
        # The unit is a simulated second.
        sides = [Side(own[k]['way'], runs[k][1], lambda: np.empty(0)) for k in sound]
        for k, times in zip(sound, interleave(sides, 1, plan.pace), strict=True):
            own[k]['minimum'] = times.minimum / motion.duration
            own[k]['median'] = times.median / motion.duration
        rows += own
    return {'motions': motions, 'runs': rows, 'missing': missing}


def _states(motion: Motion, method: str, longest: float) -> tuple[Array, Array]:
    """Return q and qd of the reference, (SAMPLES, n) each."""
    states = [(np.array(motion.q), np.array(motion.qd))]
    for _ in range(SAMPLES):
        q, qd = states[-1]
        step = motion.integrated(
            motion.duration / SAMPLES,
            q=q,
            qd=qd,
            rtol=SMALLEST_RTOL,
            atol=SMALLEST_RTOL,
            method=method,
            refine=1,
            dense=False,
            max_step=longest,
        )
        if step.status != 'ok':
            raise ArithmeticError(f'{motion.name} has no reference: {step.status}')
        states.append((step.q[-1], step.qd[-1]))
    found = np.array(states[1:])
    return found[:, 0], found[:, 1]


def _errors(motion: Motion, q: Array, qd: Array) -> Callable[[Array, Array], tuple[float, float]]:
    """Return the function that compares states with the reference q and qd, (SAMPLES, n)."""
    energy = compile_kernel(motion.robot, scene=motion.scene, quantity='energy')
    reference = energy(q, qd)
    largest = reference[:, 0].max()

    def errors(x: Array, v: Array) -> tuple[float, float]:
        drift = np.abs(energy(x, v).sum(axis=-1) - reference.sum(axis=-1)).max() / largest
        return float(np.abs(x - q).max()), float(drift)

    return errors


def _numbers(
    found: Outcome, duration: float, errors: Callable[[Array, Array], tuple[float, float]]
) -> dict[str, Any]:
    """Return status, evaluations and errors of a run, without times."""
    status, q, qd, evaluations = found
    numbers: dict[str, Any] = dict.fromkeys(
        ('evaluations', 'minimum', 'median', 'trajectory_error', 'energy_error')
    )
    if status == 'ok':
        trajectory, drift = errors(q, qd)
        if not trajectory <= LOST:
            return {'status': 'lost'} | numbers
        numbers |= {'evaluations': evaluations / duration}
        numbers |= {'trajectory_error': trajectory, 'energy_error': drift}
    return {'status': status} | numbers


def _runs(
    motion: Motion, plan: Plan, missing: list[str]
) -> Iterator[tuple[str, float | None, float | None, Run]]:
    for way in TABLE:
        for step in plan.steps:
            yield way, step, None, _fixed(motion, way, step)
    for tolerance in plan.tolerances:
        yield ADAPTIVE, None, tolerance, partial(_adaptive, motion, tolerance)
    try:
        peer = Mujoco(motion.robot)
        for way in INTEGRATORS:
            for step in plan.steps:
                yield way, step, None, _mujoco(peer, motion, way, step)
    except LeftOutError as reason:
        missing.append(f'MuJoCo at {motion.name}: {reason}')
    for way, make in NATIVE.items():
        try:
            native = make(motion.plant)
            for step in plan.steps:
                yield way, step, None, _native(native, motion, step)
        except LeftOutError as reason:
            missing.append(f'{way} at {motion.name}: {reason}')


def _substeps(motion: Motion, step: float) -> int:
    return round(motion.duration / SAMPLES / step)


def _fixed(motion: Motion, way: str, step: float) -> Run:
    """Return a run of a Simulator; the torque, which is zero, is constant between two samples."""
    substeps = _substeps(motion, step)
    simulator = Simulator(
        motion.robot,
        motion.scene,
        step_size=motion.duration / SAMPLES,
        substeps=substeps,
        integrator=way,
    )
    taus = np.zeros((SAMPLES, motion.robot.n))
    program = record_step(TABLE[way], motion.robot.n, step, motion.plant.viscosity)
    calls = sum(instruction.op == 'call' for instruction in program.instructions)

    def run() -> Outcome:
        simulator.reset(motion.q, motion.qd)
        found = simulator.rollout(taus)
        return found.status, found.q, found.qd, calls * substeps * SAMPLES

    return run


def _adaptive(motion: Motion, tolerance: float) -> Outcome:
    """Return the run of `integrate` at a tolerance, the states from its dense output."""
    found = motion.integrated(rtol=tolerance, atol=tolerance * ABSOLUTE)
    if found.status != 'ok':
        return found.status, found.q, found.qd, found.evaluations
    states = found.at(np.linspace(0, motion.duration, SAMPLES + 1)[1:])
    return 'ok', states.q, states.qd, found.evaluations


def _mujoco(peer: Mujoco, motion: Motion, way: str, step: float) -> Run:
    """Return a run of mj_step by one of MuJoCo's integrators."""
    mj, (_, evaluations) = peer.mj, INTEGRATORS[way]
    model = peer.model_of(motion.plant, way, step)
    data = mj.MjData(model)
    substeps = _substeps(motion, step)
    q, qd = np.empty((2, SAMPLES, motion.robot.n))

    def run() -> Outcome:
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion.q, motion.qd
        for k in range(SAMPLES):
            mj.mj_step(model, data, nstep=substeps)
            q[k], qd[k] = data.qpos, data.qvel
        # After a warning about a number that is too large MuJoCo restarts from its initial state.
        status = 'failed: MuJoCo warned' if data.warning.number.any() else 'ok'
        status = status if np.isfinite([q, qd]).all() else 'not_finite'
        return status, q, qd, evaluations * substeps * SAMPLES

    return run


def _native(peer: Casadi | PinocchioCpp, motion: Motion, step: float) -> Run:
    """Return a run of another library's native code, which moves q and qd in place."""
    n, substeps = motion.robot.n, _substeps(motion, step)
    q, qd = np.empty((2, n))
    advance = peer.rollout(step, q, qd, np.zeros((1, n)), substeps)
    states = np.empty((2, SAMPLES, n))

    def run() -> Outcome:
        q[:], qd[:] = motion.q, motion.qd
        for k in range(SAMPLES):
            advance()
            states[:, k] = q, qd
        status = 'ok' if np.isfinite(states).all() else 'not_finite'
        return status, states[0], states[1], 4 * substeps * SAMPLES

    return run


def text(data: Mapping[str, Any]) -> str:
    """Return the section of the page."""
    sections = []
    for motion in data['motions']:
        own = [run for run in data['runs'] if run['motion'] == motion['name']]
        facts = (
            f'{motion["note"]}. n = {motion["n"]}, {motion["duration"]:g} s; self-difference of '
            f'the reference {order(motion["self_difference"])} rad.'
        )
        lost = (f'{run["way"]}, {_setting(run)}: {run["status"]}' for run in own if _missing(run))
        lines = [
            f'### {motion["name"]}\n',
            facts,
            '',
            *table(COLUMNS, own),
            '',
            'Missing points:\n',
        ]
        sections.append('\n'.join([*lines, bullets(lost, '- none')]))
    return page(
        'error-integrators',
        samples=SAMPLES,
        motions='\n\n'.join(sections),
        missing=bullets(data['missing'], 'Nothing.'),
    )


def _missing(run: Row) -> bool:
    return bool(run['minimum'] is None)


def _setting(run: Row) -> str:
    if run['step'] is None:
        return f'rtol {run["tolerance"]:.0e}'
    return f'{run["step"] * 1e3:g} ms'


def _milliseconds(run: Row) -> str:
    if _missing(run):
        return 'missing'
    return f'{short(run["minimum"] * 1e3)} / {short(run["median"] * 1e3)}'


COLUMNS: Columns = {
    'integrator': 'way',
    'step or tolerance': _setting,
    'time [ms]': _milliseconds,
    'evaluations': lambda run: '-' if _missing(run) else f'{run["evaluations"]:.0f}',
    'trajectory error [rad]': lambda run: '-' if _missing(run) else order(run['trajectory_error']),
    'energy error': lambda run: '-' if _missing(run) else order(run['energy_error']),
}


def draw(data: Mapping[str, Any], figure: Any) -> None:
    """Draw time (above) and evaluations (below) over both errors of each motion."""
    motions, runs = data['motions'], [run for run in data['runs'] if not _missing(run)]
    panels = figure.subplots(2, 2 * len(motions), squeeze=False, sharey='row')
    for k, motion in enumerate(motions):
        own = [run for run in runs if run['motion'] == motion['name']]
        for column, error in ((2 * k, 'trajectory_error'), (2 * k + 1, 'energy_error')):
            for row, work in enumerate(('minimum', 'evaluations')):
                _draw_panel(panels[row][column], own, error, work)
            panels[0][column].set_title(motion['name'], fontsize=10)
            unit = 'trajectory error [rad]' if column % 2 == 0 else 'energy error / peak kinetic'
            panels[1][column].set_xlabel(unit)
        for row in (0, 1):
            panels[row][2 * k].axvline(motion['self_difference'], color=GREY, linestyle=':')
    panels[0][0].set_ylabel('time of a simulated second [s]')
    panels[1][0].set_ylabel('evaluations per simulated second')
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=5, frameon=False)
    figure.suptitle(
        'Integrators: work against error. Down and left is better; runs that diverged are '
        'missing; dotted: self-difference of the reference.'
    )


def _draw_panel(axes: Any, runs: Sequence[Row], error: str, work: str) -> None:
    logarithmic(axes)
    for way, (colour, marker, line) in STYLES.items():
        found = [run for run in runs if run['way'] == way]
        if found:
            axes.plot(
                [run[error] for run in found],
                [run[work] for run in found],
                linestyle=line, marker=marker, color=colour,
                label=way if ' ' in way else f'pfd {way}',
                markersize=10 if way in BEHIND else 5,
                markerfacecolor='white' if way in BEHIND else colour,
            )  # fmt: skip
