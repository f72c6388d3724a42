# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Adaptive steps of one arm in native code, on the segments and events of pfd_core.simulation.native.

    @adaptive       attempts of steps, until the end, a status, or as many as the caller allows
    @segment        the stages of an embedded pair, of any length r, up to the slope at the end
    @dense_output   further stages, and the dense output of a segment
    @look_at_parts  in a scene with events: the first part of a segment that has one
    @settle         impacts, modes and accelerations after an event
    @ask            torques of a law in Python

    attempt:    plan -> r;  segment, judge;  if accepted:
                    dense, look -> r or less;  if an event was seen: detect, search, snap
                    commit; after an event: settle; write a row

A step may be long, so that an event may begin and end in it. Its dense output is looked at LOOKS
times. It only shortens the segment: events are those of the segment itself, as in fixed steps.
The stages of a segment repeated by the search replace those before it, and the dense output.

All arrays lie in a frame of the caller, so that a run can be split after any attempt. A law of
torques is a Python object that is called without arguments: it reads time and state from the array
`asked` and writes `tau`. If it raises, `failed` is set, no further call is made, and the exception
is left to the caller. `lost` is NaN in an attempt with a torque that is not finite, of a joint at
rest, too; else 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
import math
from typing import Any

from pfd_core.kernels.ir import Code
from pfd_core.kernels.script import Frame, Script
from pfd_core.kernels.simulate import MOTION
from pfd_core.kernels.simulations import StepCode
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.model.plant import Plant
from pfd_core.simulation.dry import Law, has_contact, rests
from pfd_core.simulation.embedded_pairs import PAIRS, ROWS
from pfd_core.simulation.flags import (
    Inputs,
    Outputs,
    any_of,
    both,
    either,
    negated,
    record,
    sign_of,
)
from pfd_core.simulation.native import EventWriter, event_programs, write_functions
from pfd_core.simulation.stages import Segment, added
from pfd_core.simulation.step_control import control_programs
from pfd_core.simulation.tableaux import Tableau

# What is written of each step, in this order: its end; the length of its dense output; whether an
# event ended it; and the dense output.
WRITTEN = ('time', 'q', 'qd', 'K0', 'length', 'happened', 'dense')
# Numbers that the caller sets, and counts that it reads.
SETTINGS = ('duration', 'longest', 'smallest', 'rtol', 'atol', 'wanted', 'begins')
COUNTS = ('status', 'evaluations', 'rejected', 'stiff', 'failed')
# Equal parts of a step, at whose ends its dense output is looked at.
LOOKS = 8
# Part of a segment that a Taylor step to an event may be: such a step adds less than rounding.
SHORT = 2.0**-26

COPY = 'llvm.memcpy.p0.p0.i64'
DECLARATIONS = f"""declare ptr @pfd.call(ptr)
declare void @pfd.decref(ptr)
declare void @{COPY}(ptr, ptr, i64, i1)"""


def adaptive_frame(n: int, inputs: Mapping[str, int]) -> Frame:
    """Return a frame that begins with what is written, and has what the caller sets and reads."""
    frame = Frame()
    sizes = dict.fromkeys(('time', 'length', 'happened', *SETTINGS, *COUNTS), 1)
    sizes |= dict.fromkeys(('q', 'qd', 'K0'), n) | {'dense': 2 * ROWS * n}
    # An integer and an address.
    sizes |= {'rows': 1, 'law': 1, 'asked': 1 + 2 * n, 'tau': n} | dict(inputs)
    for name in dict.fromkeys([*WRITTEN, *sizes]):
        frame.place(name, sizes[name])
    frame.split('dense', *(f'dense{k}.{x}' for k in range(ROWS) for x in ('q', 'qd')))
    return frame


def adaptive_code(plant: Plant, integrator: str) -> StepCode:
    """Return adaptive steps of a plant by a pair of PAIRS, for pfd_core.kernels.simulations."""
    pair = PAIRS[integrator]
    law = Law(plant, 'float64', SHORT, jumps=True)
    segment = Segment(plant, pair, 0.0, False, law.load)
    return StepCode(
        plant,
        (),
        partial(_programs, law, segment),
        partial(write_functions, partial(AdaptiveWriter, law, segment)),
        pair.stages,
        integrator,
        contact=has_contact(plant),
        stops=plant.joint_limits is not None,
    )


def _programs(law: Law, segment: Segment) -> dict[str, Program]:
    found = control_programs(segment.tableau, law.n)
    if has_contact(law.plant):
        found |= event_programs(law, segment)
        n, m = law.n, len(law.margins)
        found['look'], found['looked'] = record(n, _look), record(n, _looked, law)
        found['noted'] = record(n, _noted, law, fired=m)
    else:
        found |= segment.programs()
    for name in (f'stage{segment.tableau.end}', 'commit', 'unfinished'):
        found.pop(name, None)
    return found


@dataclass(frozen=True)
class AdaptiveWriter(EventWriter):
    """Writer of the functions of adaptive steps; programs and dynamics are lowered."""

    keeps = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.events:
            self.frame.place('rest.look', 2 * self.law.n)
            self.frame.split('rest.look', 'x.look', 'lambda.look')
        for name in ('part', 'zero'):
            self.frame.place(name, 1 if name == 'part' else self.law.n)

    @property
    def pair(self) -> Tableau:
        """The embedded pair."""
        return self.segment.tableau

    @property
    def events(self) -> bool:
        """Whether the scene has friction or stops."""
        return 'detect' in self.programs

    def functions(self) -> list[str]:
        """Return all functions."""
        parts = [self._ask(), self._segment(), self._dense()]
        if self.events:
            parts += [self._hold(), *([self._impact()] if 'hits' in self.programs else [])]
            parts += [self._ends(), self._look(), self._settle()]
        parts.append(self._attempts())
        entry = Code('define void @adaptive(i64 %attempts, ptr %frame, ptr %out)')
        entry.call('void', 'attempts', 'i64 %attempts', 'ptr %out', 'ptr %frame')
        entry.ret()
        size = Code('define i64 @size()')
        size.ret('i64', self.frame.size)
        return [*map(str, parts), str(entry), str(size), DECLARATIONS]

    # Accelerations.

    def _ask(self) -> Script:
        """Write the torques of the law at a state, after `part` of the segment."""
        s = Script('ask', self.frame, {}, 'float64', 1, places={'q': '%q', 'qd': '%qd'})
        code = s.code
        ahead = code.op('mul', s.element('part', 0), s.element('r', 0))
        now = code.op('add', s.element('time', 0), ahead)
        state = [x for name in MOTION for x in s.read(name)]
        answered = code.variable('i1', 'false')
        nothing = _nothing(code, code.constant(0.0), state)
        finite = code.let(f'fcmp ord double {nothing}, {nothing}')
        fine = code.negated(code.above(s.element('failed', 0)))
        with code.when(code.both(finite, fine)):
            s.write('asked', [now, *state])
            result = code.call('ptr', 'pfd.call', f'ptr {code.load("ptr", s.at("law"))}')
            answered.set(code.test('ne', result, 'null', 'ptr'))
            with code.when(answered.get()):
                code.call('void', 'pfd.decref', f'ptr {result}')
            with code.when(code.negated(answered.get())):
                s.fill('failed', 1.0, 1)
        with code.when(code.negated(answered.get())):
            s.fill('tau', math.nan, self.law.n)
        s.write('lost', [_nothing(code, s.element('lost', 0), s.read('tau'))])
        return s

    def _asked(self, s: Script, q: str, qd: str) -> None:
        """Count an evaluation, and ask the law for its torques, if there is one."""
        code = s.code
        count = code.op('add', s.element('evaluations', 0), code.constant(1.0))
        s.write('evaluations', [count])
        law = code.load('ptr', s.at('law'))
        with code.when(code.test('ne', law, 'null', 'ptr'), rarely=True):
            s.call('ask', places=[s.at(q, self.law.n), s.at(qd, self.law.n)])

    def _load(self, s: Script, q: str, qd: str, tau: str, y: str, damped: bool = True) -> None:
        self._asked(s, q, qd)
        super()._load(s, q, qd, tau, y, damped)

    def _slope(self, s: Script, result: str, q: str, qd: str) -> None:
        if self.events:
            self._accelerations(s, result, q, qd, 'tau')
        else:
            self._asked(s, q, qd)
            s.evaluate(result, 'qdd', q=q, qd=qd)

    # Segments.

    @property
    def _end(self) -> dict[str, str]:
        return {'qdd.end': f'K{self.pair.end}'}

    def _stages(self, s: Script, stages: range) -> None:
        for k in stages:
            s.run(f'stage{k}')
            s.fill('part', self.pair.c[k], 1)
            self._slope(s, f'K{k}', 'q.stage', 'qd.stage')

    def _segment(self) -> Script:
        s = self._script('segment')
        self._stages(s, range(1, self.pair.end))
        s.run('finish')
        s.fill('part', 1.0, 1)
        self._slope(s, f'K{self.pair.end}', 'q.end', 'qd.end')
        return s

    def _dense(self) -> Script:
        s = self._script('dense_output')
        self._stages(s, range(self.pair.end + 1, self.pair.stages))
        s.run('dense')
        return s

    # Events.

    def _look(self) -> Script:
        s = self._script('look_at_parts')
        s.copy('q', 'q.look')
        s.copy('qd', 'qd.look')
        s.fill('part', 0.0, 1)
        with s.while_any('looks', LOOKS):
            s.run('look')
            own = {name: f'{name}.look' for name in ('loose', 'turns', 'slack', 'seek')}
            s.fill('loose.look', 0.0, 1)
            with s.when_any('held'):
                self._rest(s, 'look', 'q.look', 'qd.look', 'tau')
                s.run('loose', torque='lambda.look', **own, **{'y.end': 'y.look'})
            before = {'q': 'q.before', 'qd': 'qd.before', 'r': 'r.look', 'event': 'seek.look'}
            s.run('detect', **own, **before, **{'q.end': 'q.look', 'qd.end': 'qd.look'})
            s.run('looked')
        # The last part ends where the step does.
        for name in ('lambda', 'y'):
            s.copy(f'{name}.look', f'{name}.end')
        with s.when_any('shorter'):
            s.call('segment')
        return s

    def _snap(self, s: Script) -> None:
        with s.when_any('wanted'):
            s.call('dense_output')
        super()._snap(s)

    def _settle(self) -> Script:
        s = self._script('settle')
        s.fill('part', 0.0, 1)
        self._begin(s)
        return s

    # Steps.

    def _attempts(self) -> Script:
        s = self._script('attempts', ('i64 %attempts', 'ptr %out'))
        s.code.store('i64', 0, s.at('rows'))
        with s.when_any('begins', rarely=True):
            if self.events:
                self._unbrake(s)
                s.fill('rest', 1.0, 1)
                s.call('settle')
            else:
                self._slope(s, 'K0', 'q', 'qd')
            s.run('first_size')
            s.fill('begins', 0.0, 1)
            self._write(s)
        with s.while_any('goes', '%attempts'):
            s.run('plan')
            with s.when_any('goes'):
                s.call('segment')
                s.run('judge')
                with s.when_any('accepted'):
                    with nullcontext() if self.events else s.when_any('wanted'):
                        s.call('dense_output')
                        if self.events:
                            self._cut(s)
                        s.run('keep')
                    with s.when_any('kept'):
                        self._commit(s)
        return s

    def _cut(self, s: Script) -> None:
        """Shorten a step to its first event, if it has one."""
        s.call('look_at_parts')
        with s.when_any('found', rarely=True):
            self._find(s)
            seen = s.code.negated(s.any('event'))
            with s.code.when(s.code.both(seen, s.any('shorter'), s.any('wanted'))):
                s.call('dense_output')

    def _commit(self, s: Script) -> None:
        """Make the end of a step the state."""
        for source, target in (('q.end', 'q'), ('qd.end', 'qd'), (f'K{self.pair.end}', 'K0')):
            s.copy(source, target)
        s.run('clock')
        if self.events:
            for name in ('lambda', 'y'):
                s.copy(f'{name}.end', f'{name}.begin')
            s.run('noted')
            with s.when_any('settles'):
                s.call('settle')
        with s.when_any('moved'):
            self._write(s)

    def _write(self, s: Script) -> None:
        """Write a row, with the dense output if it is wanted."""
        code = s.code
        whole, short = (8 * sum(map(self.frame.length, x)) for x in (WRITTEN, WRITTEN[:-1]))
        size = code.let(f'select i1 {s.any("wanted")}, i64 {whole}, i64 {short}')
        rows = code.load('i64', s.at('rows'))
        out = code.at('%out', rows, size)
        code.call('void', COPY, f'ptr {out}', f'ptr {s.at(WRITTEN[0])}', f'i64 {size}', 'i1 false')
        code.store('i64', code.integer('add', rows, 1), s.at('rows'))


def _nothing(code: Code, nothing: str, values: Sequence[str]) -> str:
    """Return a zero, or NaN if a value is not finite."""
    for x in values:
        nothing = code.op('fma', x, code.constant(0.0), nothing)
    return nothing


def _look(at: Inputs) -> Outputs:
    """
    Return the state at the next part of a step, q.look and qd.look.

    The last one is moved to q.before and qd.before. Output r.look is the time between.
    """
    part, r = at.single('part', 'r')
    part = part + 1 / LOOKS
    rest = 1.0 - part
    outputs: dict[str, Any] = {'part': part, 'r.look': r * (1 / LOOKS)}
    for name in MOTION:
        begin, end, before = at.rows(name, f'{name}.end', f'{name}.look')
        rows = at.rows(*(f'dense{k}.{name}' for k in range(ROWS)))
        rise = [at.recorder.constant(0.0)] * len(begin)
        for k in reversed(range(ROWS)):
            factor = part if k % 2 == 0 else rest
            rise = [factor * (x + row) for x, row in zip(rise, rows[k], strict=True)]
        now = zip(added(begin, rise), end, strict=True)
        outputs[f'{name}.look'] = [where(rest, *x) for x in now]
        outputs[f'{name}.before'] = before
    return outputs


def _looked(law: Law, at: Inputs) -> Outputs:
    """
    Return what follows a look.

    Outputs are `looks`, whether there is another one; `found`, whether a margin was below zero;
    and then r, shortened, and `shorter`, whether it is. A step from which a margin at the end does
    not tell an event ends before it: where a joint has turned in front of its stop, or begins
    beyond it, so that it has another stop until it is back.
    """
    part, r, found = at.single('part', 'r', 'seek.look')
    beyond = [sign_of(s * (x - at.q[i])) for i, stops in enumerate(law.stops) for s, x in stops]
    before = both(any_of([*at.turns_look, *beyond]), sign_of(part - 1.5 / LOOKS))
    part = where(before, part - 1 / LOOKS, part)
    shorter = both(found, sign_of(1.0 - part))
    return {
        'looks': both(negated(found), sign_of(1.0 - part)),
        'found': found,
        'r': where(shorter, part * r, r),
        'shorter': shorter,
    }


def _noted(law: Law, at: Inputs) -> Outputs:
    """
    Return the flags after a step.

    Outputs, (1,): `happened`, whether an event ended it that a user knows, and `settles`, whether
    the modes may change; (n,), sticks: only for a step of no length.
    """
    event, r, span, moved = at.single('event', 'r', 'span', 'moved')
    known = []
    for margin, flag in zip(law.margins, at.fired, strict=True):
        i = margin.joint
        if not margin.stops and i not in law.rough:
            flag = both(flag, rests(at.unbraked[i], at.moving[i]))
        known.append(flag)
    at_once = both(event, negated(r - span * law.short))
    return {
        'happened': both(event, both(moved, any_of(known))),
        'settles': either(event, any_of(at.sticks)),
        'sticks': [both(at_once, flag) for flag in at.sticks],
    }
