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

from dataclasses import replace
from functools import partial
from typing import Any

from pfd_core.kernels.script import Script
from pfd_core.kernels.simulate import MOTOR_TORQUE
from pfd_core.kernels.simulations import StepCode
from pfd_core.kernels.tangents import HAPPENED, DualScript, of
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.model.plant import Plant
from pfd_core.simulation.dry import Law
from pfd_core.simulation.flags import Inputs, Outputs, both, either, negated, record
from pfd_core.simulation.native import EventWriter, step_code

# The part of a segment that is left of an event where the search ends.
SHORT = 2.0**-34
# Flags, modes, inputs that do not vary, and what only decides.
CONSTANT = (
    *('free', 'wrench', 'unbraked', 'moving', 'direction', 'sticks', 'turns', 'zero'),
    *('candidate', 'lower', 'upper', 'last', 'barred', 'busy', 'watch', 'held', 'slides', 'hits'),
    *('still', 'again', 'loose', 'slack', 'seek', 'event', 'fired', 'stopped', 'noise', 'd'),
    *('delta', 'span', 'unfinished', 'on', 'wrong', 'excess', 'side'),
)
# Programs of the search, and of a joint that is put onto its stop by rounding.
PLAIN = ('bracket', 'narrow', 'aim', 'hits', 'reach', 'shift')


def dual_step(plant: Plant, integrator: str, h: float) -> StepCode:
    """Return a step of length h [s] of an integrator, with positions as plain sums."""
    step = step_code(plant, integrator, h, 'float64', False, short=SHORT, writer=DualWriter)
    return replace(step, programs=partial(_programs, step)) if step.contact else step


def _programs(step: StepCode) -> dict[str, Program]:
    law = Law(step.plant, 'float64')
    sizes = dict.fromkeys((of('g'), 'g.r', 'fired'), len(law.margins))
    own = {'reach': record(law.n, _reach), 'shift': record(law.n, _shift, law, **sizes)}
    return step.programs() | own


def _reach(at: Inputs) -> Outputs:
    """Return r at the event, where a Taylor step delta would arrive."""
    r, delta = at.single('r', 'delta')
    return {'r': r + delta, 'delta': 0.0}


def _shift(law: Law, at: Inputs) -> Outputs:
    """
    Return the tangents at the event.

    Inputs are those at a segment of fixed length, q.end.d, qd.end.d and g.d; the slopes along r,
    q.r, qd.r and g.r; `fired`, flags of the margins; and `happened`. Outputs are the tangents of
    the end and of r, and `happened`, flags of the joints that had an event.
    """
    (dg,), happened = at.rows(of('g')), list(at.happened)
    dr = taken = at.recorder.constant(0.0)
    for margin, change, slope, flag in zip(law.margins, dg, at.g_r, at.fired, strict=True):
        first = both(flag, negated(taken))
        dr, taken = where(first, -change / slope, dr), either(taken, flag)
        happened[margin.joint] = either(happened[margin.joint], flag)
    outputs: dict[str, Any] = {of('r'): dr, HAPPENED: happened}
    for name, slopes in (('q.end', at.q_r), ('qd.end', at.qd_r)):
        (tangents,) = at.rows(of(name))
        outputs[of(name)] = [x + dr * slope for x, slope in zip(tangents, slopes, strict=True)]
    return outputs


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
