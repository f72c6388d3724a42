# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of adaptive steps: stages, error control, dense output and events in one loop.

    @begin       slopes at the start and the size of the first step, by @start
    @adaptive    attempts of steps, until the end, a status, or as many as the caller allows, by
                 @attempt_steps
    @slope       accelerations of a stage
    @ask         torques of a law in Python
    @settle      impacts, modes and accelerations after an event
    @margin_at   the margin of all events at a part of a step

pfd_core.simulation.step_control records the programs, and other modules there further ones
for dry friction and joint stops; this module calls them in their order. All values that an attempt
takes from the attempt before lie in arrays of the caller, so that a run can be split into calls
after any attempt.

A law of torques is a Python object that is called without arguments: it reads time and state from
the array `asked` and writes the torques behind them. If it raises, the count `failed` is set, no
further call is made, and the exception is left to the caller.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math

from pfd_core.kernels.contact import Contact, ContactWriter
from pfd_core.kernels.generate import declarations
from pfd_core.kernels.ir import Code, Variable
from pfd_core.kernels.script import Frame, Script
from pfd_core.kernels.simulate import MOTION, REPORT

# Numbers of a run, in the order in which they lie in its array `control`.
CONTROL = (
    *('time', 'size', 'grow', 'error'),
    *('duration', 'longest', 'smallest', 'rtol', 'atol'),
)
# Integers of a run, in the order in which they lie in its array `counts`.
COUNTS = ('status', 'evaluations', 'rejected', 'stiff', 'failed')
STATUSES = ('', 'ok', 'not_finite', 'step_too_small')
# Arrays that a step with events carries on besides the state.
MODES = ('direction', 'moving', 'sticks')
# What is written for each accepted step: its end, its size before an event shortened it, whether
# an event did, and its dense output.
WRITTEN = ('time', *REPORT, 'size', 'event', 'dense')

# Equal parts of a step, at whose ends events are searched for.
LOOKS = 8
# Halvings of the first part, where a joint begins at the event; 2^-60 of a step is no time.
HALVINGS = 60
# Iterations for the time of an event, and its tolerance as a fraction of that time.
ITERATIONS = 100
TOLERANCE = 2.0**-51
# A step whose dense output is not finite, or that cannot begin, is tried again with this fraction.
SHORTER = 1 / 3

# Parameters of @attempt_steps before the context.
ATTEMPTS = (
    *('i64 %attempts', 'i64 %wanted', 'ptr %accepted'),
    *(f'ptr %out.{name}' for name in WRITTEN),
)

DECLARATIONS = 'declare ptr @pfd.call(ptr)\ndeclare void @pfd.decref(ptr)'
CONTEXT = ('ptr %law', 'ptr %asked', 'ptr %counts')


@dataclass(frozen=True)
class AdaptivePair:
    """The numbers of an embedded pair that the native code needs."""

    nodes: tuple[float, ...]
    end: int  # the stage at the end of the step; later ones serve the dense output
    rows: int  # of the dense output


def adaptive_module(
    pair: AdaptivePair, contact: Contact, extra: Mapping[str, int], angles: Sequence[int]
) -> str:
    """
    Return the module of one arm with adaptive steps by an embedded pair, in float64.

    `contact` has the lowered programs of the steps and, in scenes with events, of events: without
    the program `modes` there are none. `extra` are the inputs of the dynamics besides the state;
    `angles` are the elements of q that turn.
    """
    writer = _Writer(pair, contact, extra)
    functions = [*writer.contact.parts(angles), writer.ask(), writer.slope()]
    if writer.events:
        functions += [writer.settle(), writer.margin_at()]
    functions += [writer.begin(), writer.loop(), *writer.entries()]
    functions += [DECLARATIONS, declarations('float64', {1}, bool(angles))]
    return '\n\n'.join(functions)


def carried(contact: Contact, extra: Collection[str]) -> tuple[str, ...]:
    """Return the arrays that @begin and @adaptive take before the output arrays."""
    return (*REPORT, *extra, *(MODES if 'modes' in contact.programs else ()))


class _Writer:
    """Writer of the functions of one run."""

    def __init__(self, pair: AdaptivePair, contact: Contact, extra: Mapping[str, int]) -> None:
        self._pair, self._contact, self._extra = pair, contact, extra
        self._n = n = contact.dynamics['braked'].inputs['q']
        self.events = 'modes' in contact.programs
        self._dense = [f'dense{k}.{part}' for k in range(pair.rows) for part in ('q', 'qd')]
        self._frame = frame = Frame()
        sizes = dict.fromkeys(CONTROL, 1) | dict.fromkeys((*REPORT, *MODES), n) | dict(extra)
        for name, size in sizes.items():
            frame.place(name, size)
        self.contact = ContactWriter(contact, 'free' in extra, frame, 'float64', 1)

    def ask(self) -> str:
        """Return `void @ask(context, t, frame, q, qd)`; NaN if a state is not finite."""
        s = self.contact.script('ask', (*CONTEXT, 'double %t'), q='%q', qd='%qd')
        code, n = s.code, self._n
        values = [x for name in MOTION for x in s.read(name)]
        nonfinite = _nonfinite(code, values)
        finite = code.let(f'fcmp ord double {nonfinite}, {nonfinite}')
        failed = code.at('%counts', COUNTS.index('failed'), 8)
        fine = code.test('eq', code.load('i64', failed), 0)
        answered = code.variable('i1', 'false')
        with code.when(code.both(finite, fine)):
            for k, value in enumerate(['%t', *values]):
                code.write(value, '%asked', k, 8)
            result = code.call('ptr', 'pfd.call', 'ptr %law')
            answered.set(code.test('ne', result, 'null', 'ptr'))
            with code.when(answered.get()):
                code.call('void', 'pfd.decref', f'ptr {result}')
                s.write('tau', [code.read('%asked', 1 + 2 * n + k, 8) for k in range(n)])
            with code.when(code.negated(answered.get())):
                code.store('i64', 1, failed)
        with code.when(code.negated(answered.get())):
            s.fill('tau', math.nan, n)
        return str(s)

    def _ask(self, s: Script, t: str) -> None:
        """Write the torques of the law, if any, at a time and state to `tau`."""
        with s.code.when(s.code.test('ne', '%law', 'null', 'ptr')):
            s.call('ask', (*CONTEXT, f'double {t}'), (s.at('q'), s.at('qd')))

    def _count(self, code: Code, name: str, more: str = '1') -> None:
        place = code.at('%counts', COUNTS.index(name), 8)
        code.store('i64', code.integer('add', code.load('i64', place), more), place)

    def _at(self, s: Script, part: str) -> str:
        """Return the time after a part of a step."""
        ahead = s.code.let(f'fmul double {_number(s, "h")}, {part}')
        return s.code.let(f'fadd double {_number(s, "time")}, {ahead}')

    def slope(self) -> str:
        """Return `void @slope(context, t, frame, q, qd, result)`: accelerations of a state."""
        arrays = {name: f'%{name}' for name in (*MOTION, 'result')}
        s = self.contact.script('slope', (*CONTEXT, 'double %t'), **arrays)
        self._ask(s, '%t')
        self._count(s.code, 'evaluations')
        tau, own = 'tau', {}
        if self.events:
            tau = self.contact.effort(s, 'qd', self.contact.motor(s, 'q', 'qd', 'tau'))
            own = {'free': 'moving'}
        s.evaluate('result', 'braked', tau=tau, **own)
        return str(s)

    def _slope(self, s: Script, t: str, q: str, qd: str, result: str) -> None:
        """Evaluate the accelerations of a state at a time."""
        places = [s.at(name, self._n) for name in (q, qd, result)]
        s.call('slope', (*CONTEXT, f'double {t}'), places)

    def settle(self) -> str:
        """Return `void @settle(context, frame)`: velocities after impacts, modes, slopes."""
        s = self.contact.script('settle', CONTEXT)
        s.fill('rest', 1.0, 1)
        s.fill('zero', 0.0, self._n)
        s.run('watch')
        self._ask(s, _number(s, 'time'))
        if 'hits' in self._contact.programs:
            with s.when_any('watch'):
                s.run('hits')
                with s.when_any('hits'):
                    s.call('impact')
                    self._ask(s, _number(s, 'time'))
        self._count(s.code, 'evaluations')
        s.call('hold')
        if 'calm' in self._contact.programs:
            with s.when_any('watch'):
                s.run('calm')
                with s.when_any('calmed'):
                    s.call('hold')
        return str(s)

    def margin_at(self) -> str:
        """Return `void @margin_at(context, frame)`: state and margin at `theta`."""
        s = self.contact.script('margin_at', CONTEXT)
        s.run('look')
        with s.when_any('held'):
            t = self._at(s, _number(s, 'theta'))
            self._slope(s, t, 'q.at', 'qd.at', 'qdd')
            load = self.contact.motor(s, 'q.at', 'qd.at', 'tau')
            s.evaluate('torque', 'inverse', q='q.at', qd='qd.at')
            s.run('excess', load=load)
        return str(s)

    def begin(self) -> str:
        """Return `void @start(context, frame)`: slopes, and the size of the first step."""
        s = self.contact.script('start', CONTEXT)
        if self.events:
            self.contact.unbrake(s)
            s.fill('sticks', 0.0, self._n)
            s.call('settle', CONTEXT)
        else:
            self._slope(s, _number(s, 'time'), 'q', 'qd', 'qdd')
        s.run('first_size')
        nonfinite = self._nonfinite(s, REPORT)
        with s.code.when(s.code.let(f'fcmp uno double {nonfinite}, {nonfinite}')):
            self._end(s.code, 'not_finite')
        return str(s)

    def _nonfinite(self, s: Script, names: Sequence[str]) -> str:
        """Return 0, or NaN if a number of some arrays is not finite."""
        return _nonfinite(s.code, [value for name in names for value in s.read(name)])

    def _end(self, code: Code, status: str) -> None:
        code.store('i64', STATUSES.index(status), '%counts')

    def loop(self) -> str:
        """
        Return `void @attempt_steps(attempts, wanted, accepted, written..., context, frame)`.

        `wanted` is 1 if the dense output is written, else 0; `accepted` receives the number of
        accepted steps that were written.
        """
        s = self.contact.script('attempt_steps', (*ATTEMPTS, *CONTEXT))
        code = s.code
        if self.events:
            self.contact.unbrake(s)
        rows, again = code.variable('i64', 0), code.variable('i1', 'true')
        with code.loop('%attempts', again=again):
            small = code.let(f'fcmp olt double {_number(s, "size")}, {_number(s, "smallest")}')
            with code.when(small):
                nothing = _nonfinite(code, [_number(s, 'error')])
                for flag, status in (('ord', 'step_too_small'), ('uno', 'not_finite')):
                    with code.when(code.let(f'fcmp {flag} double {nothing}, {nothing}')):
                        self._end(code, status)
            with code.when(code.negated(small)):
                self._attempt(s, rows)
            status, failed = (
                code.load('i64', code.at('%counts', COUNTS.index(name), 8))
                for name in ('status', 'failed')
            )
            again.set(code.test('eq', code.integer('or', status, failed), 0))
        code.store('i64', rows.get(), '%accepted')
        return str(s)

    def entries(self) -> list[str]:
        """
        Return the functions that Python calls.

        `void @begin(context, control, carried...)` and `i64 @adaptive(attempts, wanted, context,
        control, carried..., written...)` move what an attempt takes from the attempt before into
        a frame and back. The result is the number of accepted steps that were written.
        """
        names = carried(self._contact, self._extra)
        own = [*CONTEXT, 'ptr %control', *(f'ptr %{name}' for name in names)]
        written = [parameter for parameter in ATTEMPTS if parameter != 'ptr %accepted']
        begin = Code(f'define void @begin({", ".join(own)})')
        frame = self._taken(begin, names)
        begin.call('void', 'start', *CONTEXT, f'ptr {frame}')
        self._given(begin, names, frame)
        begin.ret()
        run = Code(f'define i64 @adaptive({", ".join([*written[:2], *own, *written[2:]])})')
        frame, accepted = self._taken(run, names), run.array(1, 'i64')
        given = [f'ptr {accepted}' if x == 'ptr %accepted' else x for x in ATTEMPTS]
        run.call('void', 'attempt_steps', *given, *CONTEXT, f'ptr {frame}')
        self._given(run, names, frame)
        run.ret('i64', run.load('i64', accepted))
        return [str(begin), str(run)]

    def _taken(self, code: Code, names: Sequence[str]) -> str:
        """Return a frame with the arrays of the caller."""
        frame = code.array(self._frame.size)
        for place, here in self._pairs(code, names, frame):
            code.store('double', code.load('double', place), here)
        return frame

    def _given(self, code: Code, names: Sequence[str], frame: str) -> None:
        """Write the arrays of the caller, except inputs."""
        own = [name for name in names if name not in self._extra]
        for place, here in self._pairs(code, own, frame):
            code.store('double', code.load('double', here), place)

    def _pairs(self, code: Code, names: Sequence[str], frame: str) -> Iterator[tuple[str, str]]:
        """Yield the address of each number of `control` and of some arrays, and of its copy."""
        sizes = {name: self._frame.length(name) for name in names}
        numbers = [('%control', k, name, 0) for k, name in enumerate(CONTROL)]
        numbers += [(f'%{name}', k, name, k) for name, size in sizes.items() for k in range(size)]
        for base, k, name, element in numbers:
            first = self._frame.place(name, self._frame.length(name))
            yield code.at(base, k, 8), code.at(frame, first + element, 8)

    def _stage(self, s: Script, k: int) -> None:
        s.run(f'stage{k}')
        at = 'q.end' if k == self._pair.end else f'at{k}'
        t = self._at(s, s.code.constant(self._pair.nodes[k]))
        self._slope(s, t, at, f'qd{k}', f'qdd{k}')

    def _attempt(self, s: Script, rows: Variable) -> None:
        """Write one attempt, which adds a row if it is accepted."""
        code, end = s.code, self._pair.end
        s.run('attempt')
        for k in range(1, end + 1):
            self._stage(s, k)
        _set(s, 'finite', self._nonfinite(s, ('q.end', f'qd{end}', f'qdd{end}')))
        s.run('judge')
        accepted = s.any('accepted')
        with code.when(code.negated(accepted)):
            self._count(code, 'rejected')
        with code.when(accepted):
            finite = code.variable('i1', 'true')
            needed = 'true' if self.events else code.test('ne', '%wanted', 0)
            with code.when(needed):
                for k in range(end + 1, len(self._pair.nodes)):
                    self._stage(s, k)
                s.run('dense')
                nonfinite = self._nonfinite(s, self._dense)
                finite.set(code.let(f'fcmp ord double {nonfinite}, {nonfinite}'))
            with code.when(code.negated(finite.get())):
                _set(s, 'error', code.constant(math.nan))
                self._again(s)
            with code.when(finite.get()):
                s.run('stiffness')
                self._count(code, 'stiff', code.let(f'zext i1 {s.any("stiff")} to i64'))
                if self.events:
                    self._commit_event(s, rows)
                else:
                    self._commit(s)
                    self._write(s, rows)

    def _again(self, s: Script) -> None:
        """Reject the attempt, for a shorter one."""
        shorter = s.code.constant(SHORTER)
        _set(s, 'size', s.code.let(f'fmul double {_number(s, "h")}, {shorter}'))
        self._count(s.code, 'rejected')

    def _commit(self, s: Script) -> None:
        """Make the end of the step the state."""
        end = self._pair.end
        for source, target in (('q.end', 'q'), (f'qd{end}', 'qd'), (f'qdd{end}', 'qdd')):
            s.copy(source, target)
        s.copy('time.end', 'time')
        s.fill('event', 0.0, 1)

    def _write(self, s: Script, rows: Variable) -> None:
        """Write a row, and the status at the end of the run."""
        code, n = s.code, self._n
        row = rows.get()
        for name in WRITTEN[:-1]:
            values = s.read('h' if name == 'size' else name)
            out = code.at(f'%out.{name}', row, 8 * len(values))
            for k, value in enumerate(values):
                code.write(value, out, k, 8)
        with code.when(code.test('ne', '%wanted', 0)):
            out = code.at('%out.dense', row, 8 * n * len(self._dense))
            for k, value in enumerate(x for name in self._dense for x in s.read(name)):
                code.write(value, out, k, 8)
        rows.set(code.integer('add', row, 1))
        time, duration = _number(s, 'time'), _number(s, 'duration')
        with code.when(code.let(f'fcmp oge double {time}, {duration}')):
            self._end(code, 'ok')

    # Events.

    def _commit_event(self, s: Script, rows: Variable) -> None:
        """Make the first event of the step, or its end, the state."""
        code, zero = s.code, s.code.constant(0.0)
        found, begins = self._search(s)
        strikes = code.both(found, code.negated(begins))
        with code.when(code.negated(found)):
            self._commit(s)
            stuck = code.let(f'fcmp ogt double {self._sum(s, "sticks")}, {zero}')
            with code.when(stuck):
                s.fill('sticks', 0.0, self._n)
                s.call('settle', CONTEXT)
        with code.when(strikes):
            time = self._at(s, _number(s, 'theta'))
            s.run('strike')
            _set(s, 'time', time)
            s.fill('sticks', 0.0, self._n)
            s.call('settle', CONTEXT)
            s.fill('event', 1.0, 1)
        with code.when(begins):
            s.run('stick')
            fresh = s.any('stuck')
            with code.when(fresh):
                s.call('settle', CONTEXT)
                s.copy('h', 'size')
                self._count(code, 'rejected')
            with code.when(code.negated(fresh)):
                self._again(s)
        with code.when(code.negated(begins)):
            self._write(s, rows)

    def _sum(self, s: Script, name: str) -> str:
        total = s.code.constant(0.0)
        for value in s.read(name):
            total = s.code.let(f'fadd double {total}, {value}')
        return total

    def _look(self, s: Script, theta: str) -> str:
        """Look at a part of the step; return whether an event has happened by then."""
        _set(s, 'theta', theta)
        s.call('margin_at', CONTEXT)
        return s.code.let(f'fcmp olt double {_number(s, "margin")}, {s.code.constant(0.0)}')

    def _search(self, s: Script) -> tuple[str, str]:
        """
        Write the search for the first event.

        Returns two i1: whether there is an event, and whether it is at the beginning of the step.
        The state at the event is in q.at and qd.at, its part of the step in theta.
        """
        code, number, zero = s.code, s.code.constant, s.code.constant(0.0)
        s.fill('theta.before', 0.0, 1)
        s.fill('dq.before', 0.0, self._n)
        s.copy('qd', 'qd.before')
        over, more = code.variable('i1', 'false'), code.variable('i1', 'true')
        with code.loop(LOOKS, again=more) as k:
            count = code.let(f'uitofp i64 {code.integer("add", k, 1)} to double')
            theta = code.let(f'fmul double {count}, {number(1 / LOOKS)}')
            over.set(self._look(s, theta))
            if 'turn' in self._contact.programs:
                s.run('turn')
                turn = _number(s, 'theta.turn')
                with code.when(code.let(f'fcmp olt double {turn}, {theta}')):
                    touches = self._look(s, turn)
                    with code.when(code.negated(touches)):
                        self._look(s, theta)
                    over.set(code.either(touches, over.get()))
            more.set(code.negated(over.get()))
            with code.when(more.get()):
                s.copy('theta', 'theta.before')
                for name in ('dq', 'qd'):
                    s.copy(f'{name}.at', f'{name}.before')
        begins = code.variable('i1', 'false')
        with code.when(over.get()):
            left = code.variable('double', _number(s, 'theta.before'))
            right = code.variable('double', _number(s, 'theta'))
            with code.when(code.let(f'fcmp ole double {left.get()}, {zero}')):
                self._halve(s, left, right)
            begins.set(code.let(f'fcmp ole double {left.get()}, {zero}'))
            with code.when(code.negated(begins.get())):
                self._refine(s, left, right)
        return over.get(), begins.get()

    def _halve(self, s: Script, left: Variable, right: Variable) -> None:
        """Halve the first part until a time before the event is found."""
        code, half = s.code, s.code.constant(0.5)
        more = code.variable('i1', 'true')
        with code.loop(HALVINGS, again=more):
            old = right.get()
            theta = code.let(f'fmul double {old}, {half}')
            after = self._look(s, theta)
            more.set(after)
            left.set(code.choose(after, left.get(), theta))
            right.set(code.choose(after, theta, old))

    def _refine(self, s: Script, left: Variable, right: Variable) -> None:
        """
        Find the event between two times by the Illinois method; the state is just after the event.

        Every third iteration is a bisection.
        """
        code, number = s.code, s.code.constant
        self._look(s, left.get())
        f_left = code.variable('double', _number(s, 'margin'))
        self._look(s, right.get())
        f_right = code.variable('double', _number(s, 'margin'))
        side, more = code.variable('i1', 'true'), code.variable('i1', 'true')
        half = number(0.5)
        with code.loop(ITERATIONS, again=more) as k:
            a, b, f_a, f_b = (x.get() for x in (left, right, f_left, f_right))
            width, rise = code.op('sub', b, a), code.op('sub', f_b, f_a)
            secant = code.op('sub', b, code.op('mul', code.op('div', f_b, rise), width))
            middle = code.op('add', a, code.op('mul', half, width))
            above, below = code.above(secant, a), code.above(b, secant)
            third = code.test('eq', code.integer('urem', k, 3), 2)
            theta = code.choose(code.both(above, below, code.negated(third)), secant, middle)
            after = self._look(s, theta)
            margin = _number(s, 'margin')
            same = code.test('eq', after, side.get(), 'i1')
            weight = code.choose(same, half, number(1.0))
            left.set(code.choose(after, a, theta))
            right.set(code.choose(after, theta, b))
            f_left.set(code.choose(after, code.op('mul', f_a, weight), margin))
            f_right.set(code.choose(after, margin, code.op('mul', f_b, weight)))
            side.set(after)
            gap = code.op('sub', right.get(), left.get())
            least = code.op('mul', right.get(), number(TOLERANCE))
            more.set(code.above(gap, least))
        self._look(s, right.get())


def _number(s: Script, name: str) -> str:
    """Return the only number of an array."""
    return s.element(name, 0)


def _set(s: Script, name: str, value: str) -> None:
    """Write the only number of an array."""
    s.write(name, [value])


def _nonfinite(code: Code, values: Sequence[str]) -> str:
    """Return NaN where a value is not finite, else zero."""
    total = code.constant(0.0)
    for value in values:
        total = code.op('fma', value, code.constant(0.0), total)
    return total
