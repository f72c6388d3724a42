# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the work and errors of integrators, a section of speed-against-error.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pfd_core.report.markdown import cells, header
from pfd_core.report.motions import SAMPLES
from pfd_core.report.speed_tables import error_cell, least_and_median
from pfd_core.report.work_precision import MotionFacts, RunPoint

MOTIONS = """## Integrators

![Time and evaluations over trajectory and energy error](work-precision.png)

Free motions of an arm, without torques. The trajectory error is the largest difference of a joint
from the reference at {samples} times [rad], the energy error the largest difference of the energy
in units of the largest kinetic energy. Times and evaluations are for one simulated second.

- rk4, velocity_verlet and imex2 run in native code. dop853 is `pfd.integrate`, whose steps are in
  Python; its times hold some milliseconds to load its kernel. States at the {samples} times come
  from its dense output, whose evaluations are counted. imex2 has two evaluations a step, and two
  solutions for the damping where there is any; these count as evaluations.
- MuJoCo's integrators are those of `mj_step`; Euler and the implicit ones take the damping of the
  joints implicitly.
- The reference is `pfd.integrate` at its tightest tolerance, refined. Its self-difference is from
  a second one by another method and in shorter steps. Errors near it are not resolved.
- A run that blew up is a missing point: its state was not finite, was reset by MuJoCo, or was off
  by more than a turn (*lost*).
"""


def section(motions: Sequence[MotionFacts], runs: Sequence[RunPoint]) -> Iterator[str]:
    """Yield the paragraphs and lines of the section."""
    yield MOTIONS.format(samples=SAMPLES)
    for motion in motions:
        own = [run for run in runs if run.motion == motion.name]
        yield from (f'### {motion.name}\n', _moved(motion), *_motion_table(own), '')
        yield from ('Missing points:\n', *_missing(own), '')


def _moved(motion: MotionFacts) -> str:
    return (
        f'{motion.note}. n = {motion.n}, {motion.duration:g} s; self-difference of the reference '
        f'{motion.self_difference:.0e} rad.\n'
    )


def _motion_table(runs: Sequence[RunPoint]) -> list[str]:
    titles = ['time [ms]', 'evaluations', 'trajectory error [rad]', 'energy error']
    lines = header(' | '.join(['integrator', 'step or tolerance', *titles]))
    for run in runs:
        if run.minimum is None or run.median is None:
            found = ['missing', '-', '-', '-']
        else:
            evaluations = '-' if run.evaluations is None else f'{run.evaluations:.0f}'
            errors = [error_cell(run.trajectory_error), error_cell(run.energy_error)]
            found = [least_and_median(run.minimum, run.median, 1e3), evaluations, *errors]
        lines.append(cells(run.way, run.setting, *found))
    return lines


def _missing(runs: Sequence[RunPoint]) -> list[str]:
    found = [f'- {run.way}, {run.setting}: {run.status}' for run in runs if run.status != 'ok']
    return found or ['- none']
