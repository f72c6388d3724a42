# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A step on dual numbers, through its events.

The scripts of a step (pfd_core.simulation.native) run on values and tangents
(pfd_core.kernels.tangents). What they leave out is the time of an event, which the search finds
without a formula. It is the root of a margin g at the end of a segment of length r, so that

    dr = -dg / g_r        x(r) + dx + x_r dr

g_r and x_r are slopes of the *segment*, not of the motion that it approximates: the segment is
repeated along r alone for them, and once more along the directions of the state. The rest of the
step is shorter by dr, and the velocity of a reversal, or the position at a stop, is exact and has
no tangent. Impacts are programs and dynamics like the others, for the joints that they stop.

The search ends much nearer to the event than in a simulation: its last step is a Taylor step of
the motion, and would make the result uneven.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from pfd_core.kernels.script import Frame, Script
from pfd_core.kernels.simulate import MOTOR_TORQUE, Steps
from pfd_core.kernels.simulations import StepCode, Writer
from pfd_core.kernels.tangents import HAPPENED, DualScript, of
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.plant import Plant
from pfd_core.simulation.dry import Law, read, single
from pfd_core.simulation.flags import any_of, both, either, negated
from pfd_core.simulation.native import EventWriter, step_code

# The part of a segment that is left of an event where the search ends.
SHORT = 2.0**-34
# Flags, modes, inputs that do not vary, and what only decides.
CONSTANT = (
    *('free', 'wrench', 'unbraked', 'moving', 'direction', 'sticks', 'turns', 'zero'),
    *('candidate', 'lower', 'upper', 'last', 'barred', 'busy', 'watch', 'held', 'slides', 'hits'),
    *('still', 'again', 'loose', 'slack', 'seek', 'event', 'fired', 'stopped', 'noise', 'd'),
    *('delta', 'span', 'unfinished', 'on'),
)
# Programs of the search, and of a joint that is put onto its stop by rounding.
PLAIN = ('bracket', 'narrow', 'aim', 'hits', 'reach', 'shift', 'closing', 'braked')


def dual_step(plant: Plant, integrator: str, h: float) -> StepCode:
    """Return a step of length h [s] of an integrator, with positions as plain sums."""
    step = step_code(plant, integrator, h, 'float64', False, short=SHORT, writer=DualWriter)
    write = partial(_with_brakes, step.write) if plant.brakes else step.write
    return replace(step, programs=partial(_programs, step), write=write)


def _programs(step: StepCode) -> dict[str, Program]:
    plant, found = step.plant, step.programs()
    if step.contact:
        found |= {'reach': record_reach(), 'shift': record_shift(Law(plant, 'float64'))}
    if plant.brakes:
        n = plant.robot.n
        found |= {'closing': record_closing(n), 'braked': record_braked(n)}
    return found


def record_reach() -> Program:
    """Return the program of r, (1,), at the event, where a Taylor step delta would arrive."""
    recorder = Recorder(1, 'sequential')
    r, delta = single(recorder, 'r', 'delta')
    return recorder.program(r=[r + delta], delta=[recorder.constant(0.0)])


def record_shift(law: Law) -> Program:
    """
    Return the program of the tangents at the event.

    Inputs are those at a segment of fixed length, q.end.d, qd.end.d and g.d; the slopes along r,
    q.r, qd.r and g.r; `fired`, flags of the margins; and `happened`. Outputs are the tangents of
    the end and of r, and `happened`, flags of the joints that had an event.
    """
    recorder, n = Recorder(1, 'sequential'), law.n
    ends = read(recorder, n, of('q.end'), of('qd.end'), 'q.r', 'qd.r', HAPPENED)
    dq, dqd, q_r, qd_r, happened = ends
    dg, g_r, fired = read(recorder, len(law.margins), of('g'), 'g.r', 'fired')
    dr = taken = recorder.constant(0.0)
    for margin, change, slope, flag in zip(law.margins, dg, g_r, fired, strict=True):
        first = both(flag, negated(taken))
        dr, taken = where(first, -change / slope, dr), either(taken, flag)
        happened[margin.joint] = either(happened[margin.joint], flag)
    outputs = {
        of('q.end'): [x + dr * slope for x, slope in zip(dq, q_r, strict=True)],
        of('qd.end'): [x + dr * slope for x, slope in zip(dqd, qd_r, strict=True)],
        of('r'): [dr],
        HAPPENED: happened,
    }
    return recorder.program(**outputs)


def record_closing(n: int) -> Program:
    """Return the program of `closing`, (1,): whether a joint is braked."""
    recorder = Recorder(1, 'sequential')
    (free,) = read(recorder, n, 'free')
    return recorder.program(closing=[any_of([negated(x) for x in free])])


def record_braked(n: int) -> Program:
    """
    Return the program of velocities, (n,), after the impulses of brakes, and their tangents.

    Inputs are free, qd, and after = H^-1 H qd of the free joints with its tangents. Where no
    braked joint moves, velocities stay as they are.
    """
    recorder = Recorder(1, 'sequential')
    free, qd, after, tangents = read(recorder, n, 'free', 'qd', 'after', of('after'))
    moves = any_of([both(negated(x), absolute(v)) for x, v in zip(free, qd, strict=True)])
    found = [where(moves, new, old) for new, old in zip(after, qd, strict=True)]
    return recorder.program(
        **{
            'qd': [where(x, v, 0.0) for x, v in zip(free, found, strict=True)],
            of('qd'): [where(x, d, 0.0) for x, d in zip(free, tangents, strict=True)],
        },
    )


def _with_brakes(
    write: Writer,
    steps: Steps,
    programs: Mapping[str, Program],
    dynamics: Mapping[str, Program],
    frame: Frame,
    angles: Sequence[int],
) -> list[str]:
    """Return the functions of a step, and @brake, which brings braked joints to rest."""
    functions = write(steps, programs, dynamics, frame, angles)
    s = DualScript('brake', frame, dynamics, steps.dtype, steps.width, programs, inline=True)
    s.run('closing')
    with s.when_any('closing', rarely=True):
        s.fill('zero', 0.0, steps.n)
        s.evaluate('load', 'momentum', qd='zero', qdd='qd')
        s.evaluate('after', 'inertial', qd='zero', tau='load')
        s.run('braked')
    return [*functions, str(s)]


class DualWriter(EventWriter):
    """Writer of the functions of a step with events on dual numbers."""

    kind, keeps = DualScript, False

    def _snap(self, s: Script) -> None:
        """Write the state at an event, and its tangents."""
        s.run('reach')
        begin = ['q', 'qd', 'K0', 'tau', *([MOTOR_TORQUE] if self.segment.lags else [])]
        sizes = {of(name): self.frame.length(name) for name in begin}
        for name, size in sizes.items():
            Script.copy(s, name, f'kept {name}')
            Script.fill(s, name, 0.0, size)
        Script.fill(s, of('r'), 1.0, 1)
        s.call('ends')
        for source, target in ((of('q.end'), 'q.r'), (of('qd.end'), 'qd.r'), (of('g'), 'g.r')):
            Script.copy(s, source, target)
        for name in sizes:
            Script.copy(s, f'kept {name}', name)
        Script.fill(s, of('r'), 0.0, 1)
        s.call('ends')
        s.run('shift')
        super()._snap(s)
