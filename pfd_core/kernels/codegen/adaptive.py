# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of adaptive steps: stages, error control, dense output and events in one loop.

    @begin       slopes at the start and the size of the first step
    @adaptive    attempts of steps, until the end, a status, or as many as the caller allows
    @slope       accelerations of a stage
    @ask         torques of a law in Python
    @settle      impacts, modes and accelerations after an event
    @margin_at   the margin of all events at a part of a step

pfd_core.simulation.step_control records the programs, and pfd_core.simulation.contact further ones
for dry friction and joint stops; this module calls them in their order. All values that an attempt
takes from the attempt before lie in arrays of the caller, so that a run can be split into calls
after any attempt.

A law of torques is a Python object that is called without arguments: it reads time and state from
the array `asked` and writes the torques behind them. If it raises, the count `failed` is set, no
further call is made, and the exception is left to the caller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.calls import Calls
from pfd_core.kernels.codegen.segments import Contact, hold_arguments, impact, unbrake
from pfd_core.kernels.codegen.spelling import Array, Format
from pfd_core.kernels.codegen.step import MOTION, REPORT

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

DECLARATIONS = 'declare ptr @pfd.call(ptr)\ndeclare void @pfd.decref(ptr)'
CONTEXT = ('ptr %law', 'ptr %asked', 'ptr %counts')


@dataclass(frozen=True)
class AdaptivePair:
    """The numbers of an embedded pair that the native code needs."""

    nodes: tuple[float, ...]
    end: int  # the stage at the end of the step; later ones serve the dense output
    rows: int  # of the dense output


def adaptive(
    pair: AdaptivePair, contact: Contact, extra: Sequence[str], form: Format
) -> list[str]:
    """
    Return the functions; programs and dynamics of `contact` are lowered.

    Without the program `modes` there are no events. `extra` are the inputs of the dynamics besides
    the state.
    """
    writer = _Writer(pair, contact, extra, form)
    functions = [_ask(contact.dynamics['_braked'].inputs['q'], form), writer.slope()]
    if writer.events:
        functions += [writer.settle(), writer.margin_at()]
    return [DECLARATIONS, *functions, writer.begin(), writer.loop()]


def carried(contact: Contact, extra: Sequence[str]) -> tuple[str, ...]:
    """Return the arrays that @begin and @adaptive take before the output arrays."""
    return (*REPORT, *extra, *(MODES if 'modes' in contact.programs else ()))


def _ask(n: int, form: Format) -> str:
    """Return `void @ask(law, asked, counts, t, q, qd, tau)`; NaN if a state is not finite."""
    ir = Function(
        f'define internal void @ask({", ".join(CONTEXT)}, double %t, ptr %q, ptr %qd, ptr %tau)'
    )
    values = [form.read(ir, Array(f'%{name}'), k) for name in MOTION for k in range(n)]
    nonfinite = form.not_finite(ir, values)
    finite = ir.let(f'fcmp ord double {nonfinite}, {nonfinite}')
    failed = ir.element('i64', '%counts', COUNTS.index('failed'))
    fine = ir.let(f'icmp eq i64 {ir.load("i64", failed)}, 0')
    answered = Variable('i1', 'false')
    with ir.when(ir.let(f'and i1 {finite}, {fine}'), answered):
        for k, value in enumerate(['%t', *values]):
            form.write(ir, Array('%asked'), k, value)
        result = ir.call('ptr', 'pfd.call', 'ptr %law')
        answered.value = ir.let(f'icmp ne ptr {result}, null')
        with ir.when(answered.value):
            ir.call('void', 'pfd.decref', f'ptr {result}')
        with ir.when(ir.let(f'xor i1 {answered}, true')):
            ir.store('i64', 1, failed)
    with ir.when(ir.let(f'xor i1 {answered}, true')):
        for k in range(n):
            form.write(ir, Array('%tau'), k, form.constant(float('nan')))
    ir.ret()
    return str(ir)


class _Writer:
    """Writer of the functions of one run."""

    def __init__(
        self, pair: AdaptivePair, contact: Contact, extra: Sequence[str], form: Format
    ) -> None:
        self._pair, self._contact, self._form = pair, contact, form
        self._extra = tuple(extra)
        self.events = 'modes' in contact.programs
        self._dense = [f'dense{k}.{part}' for k in range(pair.rows) for part in ('q', 'qd')]
        held = ('direction', 'moving') if self.events else ()
        self._slope_arrays = ('q', 'qd', *self._extra, *held, 'result')
        self._settled = ('time', *REPORT, *self._extra, *MODES, 'unbraked')
        self._looked = (
            *('time', 'h', 'theta', 'q', 'qd', *self._extra, *MODES, 'unbraked'),
            *self._dense,
            *('dq.at', 'q.at', 'qd.at', 'margin'),
        )

    def _calls(self, head: str, given: Sequence[str], first: Sequence[str] = CONTEXT) -> Calls:
        contact = self._contact
        return Calls(head, given, contact.programs, contact.dynamics, self._form, first)

    def _ask(self, calls: Calls, t: str) -> None:
        """Write the torques of the law, if any, at a time and state to `tau`."""
        ir = calls.ir
        with ir.when(ir.let('icmp ne ptr %law, null')):
            calls.call('ask', ('q', 'qd', 'tau'), (*CONTEXT, f'double {t}'))

    def _count(self, ir: Function, name: str, more: str = '1') -> None:
        place = ir.element('i64', '%counts', COUNTS.index(name))
        ir.store('i64', ir.let(f'add i64 {ir.load("i64", place)}, {more}'), place)

    def _at(self, calls: Calls, part: str) -> str:
        """Return the time after a part of a step."""
        ahead = calls.ir.let(f'fmul double {calls.number("h")}, {part}')
        return calls.ir.let(f'fadd double {calls.number("time")}, {ahead}')

    def slope(self) -> str:
        """Return `void @slope(context, t, q, qd, extra..., direction, moving, result)`."""
        calls = self._calls(
            'define internal void @slope', self._slope_arrays, (*CONTEXT, 'double %t')
        )
        self._ask(calls, '%t')
        self._count(calls.ir, 'evaluations')
        tau, own = 'tau', {}
        if self.events:
            tau = calls.effort('qd', calls.motor('q', 'qd', 'tau'))
            own = {'free': 'moving'}
        calls.evaluate('_braked', 'result', tau=tau, **own)
        return calls.finish()

    def _slope(self, calls: Calls, t: str, **arrays: str) -> None:
        """Evaluate the accelerations at a time; `arrays` replace arrays by name."""
        names = [arrays.get(name, name) for name in self._slope_arrays]
        calls.call('slope', names, (*CONTEXT, f'double {t}'))

    def settle(self) -> str:
        """Return `void @settle(context, ...)`: velocities after impacts, modes, accelerations."""
        calls = self._calls('define internal void @settle', self._settled)
        hold = hold_arguments(self._contact, self._extra)
        calls.fill('rest', 1.0)
        calls.fill('zero', 0.0)
        calls.run('watch')
        self._ask(calls, calls.number('time'))
        if 'hits' in self._contact.programs:
            with calls.ir.when(calls.any('watch')):
                calls.run('hits')
                with calls.ir.when(calls.any('hits')):
                    impact(calls, self._contact, hold)
                    self._ask(calls, calls.number('time'))
        self._count(calls.ir, 'evaluations')
        calls.call('hold', hold)
        if 'calm' in self._contact.programs:
            with calls.ir.when(calls.any('watch')):
                calls.run('calm')
                with calls.ir.when(calls.any('calmed')):
                    calls.call('hold', hold)
        return calls.finish()

    def margin_at(self) -> str:
        """Return `void @margin_at(context, ...)`: state and margin at `theta`."""
        calls = self._calls('define internal void @margin_at', self._looked)
        calls.run('look')
        with calls.ir.when(calls.any('held')):
            t = self._at(calls, calls.number('theta'))
            self._slope(calls, t, q='q.at', qd='qd.at', result='qdd')
            load = calls.motor('q.at', 'qd.at', 'tau')
            calls.evaluate('_inverse', 'torque', q='q.at', qd='qd.at')
            calls.run('excess', load=load)
        return calls.finish()

    def _main(self, name: str, first: Sequence[str], arrays: Sequence[str]) -> Calls:
        given = (*carried(self._contact, self._extra), *arrays)
        calls = self._calls(f'define {name}', given, (*first, *CONTEXT, 'ptr %control'))
        for k, single in enumerate(CONTROL):
            calls.place(single, calls.ir.element('double', '%control', k))
        if self.events:
            unbrake(calls, self._extra)
        return calls

    def begin(self) -> str:
        """Return `void @begin(context, control, carried...)`."""
        calls = self._main('void @begin', (), ())
        if self.events:
            calls.fill('sticks', 0.0)
            calls.call('settle', self._settled, CONTEXT)
        else:
            self._slope(calls, calls.number('time'), result='qdd')
        calls.run('first_size')
        nonfinite = self._nonfinite(calls, REPORT)
        flag = calls.ir.let(f'fcmp uno double {nonfinite}, {nonfinite}')
        with calls.ir.when(flag):
            self._end(calls.ir, 'not_finite')
        return calls.finish()

    def _nonfinite(self, calls: Calls, names: Sequence[str]) -> str:
        """Return 0, or NaN if a number of some arrays is not finite."""
        values = [
            self._form.read(calls.ir, Array(calls.address(name)), k)
            for name in names
            for k in range(calls.size(name))
        ]
        return self._form.not_finite(calls.ir, values)

    def _end(self, ir: Function, status: str) -> None:
        ir.store('i64', STATUSES.index(status), ir.element('i64', '%counts', 0))

    def loop(self) -> str:
        """
        Return `i64 @adaptive(attempts, wanted, context, control, carried..., written...)`.

        `wanted` is 1 if the dense output is written, else 0. The result is the number of accepted
        steps that were written.
        """
        written = [f'out.{name}' for name in WRITTEN]
        calls = self._main('i64 @adaptive', ('i64 %attempts', 'i64 %wanted'), written)
        ir = calls.ir
        rows, again = Variable('i64', '0'), Variable('i1', 'true')
        with ir.loop('%attempts', rows, condition=again):
            small = ir.let(f'fcmp olt double {calls.number("size")}, {calls.number("smallest")}')
            with ir.when(small):
                error = calls.number('error')
                nothing = self._form.not_finite(ir, [error])
                for flag, status in (('ord', 'step_too_small'), ('uno', 'not_finite')):
                    with ir.when(ir.let(f'fcmp {flag} double {nothing}, {nothing}')):
                        self._end(ir, status)
            with ir.when(ir.let(f'xor i1 {small}, true'), rows):
                self._attempt(calls, rows)
            status, failed = (
                ir.load('i64', ir.element('i64', '%counts', COUNTS.index(name)))
                for name in ('status', 'failed')
            )
            again.value = ir.let(f'icmp eq i64 {ir.let(f"or i64 {status}, {failed}")}, 0')
        ir.ret('i64', rows)
        return str(ir)

    def _stage(self, calls: Calls, k: int) -> None:
        calls.run(f'stage{k}')
        at = 'q.end' if k == self._pair.end else f'at{k}'
        t = self._at(calls, self._form.constant(self._pair.nodes[k]))
        self._slope(calls, t, q=at, qd=f'qd{k}', result=f'qdd{k}')

    def _attempt(self, calls: Calls, rows: Variable) -> None:
        """Write one attempt, which adds a row if it is accepted."""
        ir, end = calls.ir, self._pair.end
        calls.run('attempt')
        for k in range(1, end + 1):
            self._stage(calls, k)
        calls.set('finite', self._nonfinite(calls, ('q.end', f'qd{end}', f'qdd{end}')))
        calls.run('judge')
        accepted = calls.any('accepted')
        with ir.when(ir.let(f'xor i1 {accepted}, true')):
            self._count(ir, 'rejected')
        with ir.when(accepted, rows):
            n = calls.size('q')
            row = ir.let(f'mul i64 {rows}, {2 * n * self._pair.rows}')
            row = ir.let(f'mul i64 {row}, %wanted')
            for k, name in enumerate(self._dense):
                place = ir.let(f'add i64 {row}, {k * n}')
                calls.place(name, ir.element('double', '%out.dense', place))
            finite = Variable('i1', 'true')
            needed = 'true' if self.events else ir.let('icmp ne i64 %wanted, 0')
            with ir.when(needed, finite):
                for k in range(end + 1, len(self._pair.nodes)):
                    self._stage(calls, k)
                calls.run('dense')
                nonfinite = self._nonfinite(calls, self._dense)
                finite.value = ir.let(f'fcmp ord double {nonfinite}, {nonfinite}')
            with ir.when(ir.let(f'xor i1 {finite}, true')):
                calls.set('error', self._form.constant(float('nan')))
                self._again(calls)
            with ir.when(finite.value, rows):
                calls.run('stiffness')
                self._count(ir, 'stiff', ir.let(f'zext i1 {calls.any("stiff")} to i64'))
                if self.events:
                    self._commit_event(calls, rows)
                else:
                    self._commit(calls)
                    self._write(calls, rows)

    def _again(self, calls: Calls) -> None:
        """Reject the attempt, for a shorter one."""
        shorter = self._form.constant(SHORTER)
        calls.set('size', calls.ir.let(f'fmul double {calls.number("h")}, {shorter}'))
        self._count(calls.ir, 'rejected')

    def _commit(self, calls: Calls) -> None:
        """Make the end of the step the state."""
        end = self._pair.end
        for source, target in (('q.end', 'q'), (f'qd{end}', 'qd'), (f'qdd{end}', 'qdd')):
            calls.copy(source, target)
        calls.copy('time.end', 'time')
        calls.fill('event', 0.0)

    def _write(self, calls: Calls, rows: Variable) -> None:
        """Write a row, and the status at the end of the run."""
        ir, n = calls.ir, calls.size('q')
        for name in WRITTEN[:-1]:
            single = name not in REPORT
            source = 'h' if name == 'size' else name
            row = rows.value if single else ir.let(f'mul i64 {rows}, {n}')
            out = Array(ir.element('double', f'%out.{name}', row))
            for k in range(1 if single else n):
                value = self._form.read(ir, Array(calls.address(source)), k)
                self._form.write(ir, out, k, value)
        rows.value = ir.let(f'add i64 {rows}, 1')
        time, duration = calls.number('time'), calls.number('duration')
        with ir.when(ir.let(f'fcmp oge double {time}, {duration}')):
            self._end(ir, 'ok')

    # Events.

    def _commit_event(self, calls: Calls, rows: Variable) -> None:
        """Make the first event of the step, or its end, the state."""
        ir, zero = calls.ir, self._form.zero
        found, begins = self._search(calls)
        none = ir.let(f'xor i1 {found}, true')
        strikes = ir.let(f'and i1 {found}, {ir.let(f"xor i1 {begins}, true")}')
        with ir.when(none):
            self._commit(calls)
            stuck = ir.let(f'fcmp ogt double {self._sum(calls, "sticks")}, {zero}')
            with ir.when(stuck):
                calls.fill('sticks', 0.0)
                calls.call('settle', self._settled, CONTEXT)
        with ir.when(strikes):
            time = self._at(calls, calls.number('theta'))
            calls.run('strike')
            calls.set('time', time)
            calls.fill('sticks', 0.0)
            calls.call('settle', self._settled, CONTEXT)
            calls.fill('event', 1.0)
        with ir.when(begins):
            calls.run('stick')
            fresh = calls.any('stuck')
            with ir.when(fresh):
                calls.call('settle', self._settled, CONTEXT)
                calls.copy('h', 'size')
                self._count(ir, 'rejected')
            with ir.when(ir.let(f'xor i1 {fresh}, true')):
                self._again(calls)
        with ir.when(ir.let(f'xor i1 {begins}, true'), rows):
            self._write(calls, rows)

    def _sum(self, calls: Calls, name: str) -> str:
        total = self._form.zero
        for k in range(calls.size(name)):
            value = self._form.read(calls.ir, Array(calls.address(name)), k)
            total = calls.ir.let(f'fadd double {total}, {value}')
        return total

    def _look(self, calls: Calls, theta: str) -> str:
        """Look at a part of the step; return whether an event has happened by then."""
        calls.set('theta', theta)
        calls.call('margin_at', self._looked, CONTEXT)
        return calls.ir.let(f'fcmp olt double {calls.number("margin")}, {self._form.zero}')

    def _search(self, calls: Calls) -> tuple[str, str]:
        """
        Write the search for the first event.

        Returns two i1: whether there is an event, and whether it is at the beginning of the step.
        The state at the event is in q.at and qd.at, its part of the step in theta.
        """
        ir, number = calls.ir, self._form.constant
        calls.fill('theta.before', 0.0)
        calls.fill('dq.before', 0.0)
        calls.copy('qd', 'qd.before')
        over, more = Variable('i1', 'false'), Variable('i1', 'true')
        with ir.loop(LOOKS, over, condition=more) as k:
            count = ir.let(f'uitofp i64 {ir.let(f"add i64 {k}, 1")} to double')
            theta = ir.let(f'fmul double {count}, {number(1 / LOOKS)}')
            over.value = self._look(calls, theta)
            if 'turn' in self._contact.programs:
                calls.run('turn')
                turn = calls.number('theta.turn')
                with ir.when(ir.let(f'fcmp olt double {turn}, {theta}'), over):
                    ended = over.value
                    touches = self._look(calls, turn)
                    with ir.when(ir.let(f'xor i1 {touches}, true')):
                        self._look(calls, theta)
                    over.value = ir.let(f'or i1 {touches}, {ended}')
            more.value = ir.let(f'xor i1 {over}, true')
            with ir.when(more.value):
                calls.copy('theta', 'theta.before')
                for name in ('dq', 'qd'):
                    calls.copy(f'{name}.at', f'{name}.before')
        begins = Variable('i1', 'false')
        with ir.when(over.value, begins):
            left = Variable('double', calls.number('theta.before'))
            right = Variable('double', calls.number('theta'))
            at_start = ir.let(f'fcmp ole double {left}, {self._form.zero}')
            with ir.when(at_start, left, right):
                self._halve(calls, left, right)
            begins.value = ir.let(f'fcmp ole double {left}, {self._form.zero}')
            with ir.when(ir.let(f'xor i1 {begins}, true')):
                self._refine(calls, left, right)
        return over.value, begins.value

    def _halve(self, calls: Calls, left: Variable, right: Variable) -> None:
        """Halve the first part until a time before the event is found."""
        ir, half = calls.ir, self._form.constant(0.5)
        more = Variable('i1', 'true')
        with ir.loop(HALVINGS, left, right, condition=more):
            theta = ir.let(f'fmul double {right}, {half}')
            more.value = self._look(calls, theta)
            left.value = ir.let(f'select i1 {more}, double {left}, double {theta}')
            right.value = ir.let(f'select i1 {more}, double {theta}, double {right}')

    def _refine(self, calls: Calls, left: Variable, right: Variable) -> None:
        """
        Find the event between two times by the Illinois method; the state is just after the event.

        Every third iteration is a bisection.
        """
        ir, number = calls.ir, self._form.constant
        self._look(calls, left.value)
        f_left = Variable('double', calls.number('margin'))
        self._look(calls, right.value)
        f_right = Variable('double', calls.number('margin'))
        side, more = Variable('i1', 'true'), Variable('i1', 'true')
        variables = (left, right, f_left, f_right, side)
        half = number(0.5)
        with ir.loop(ITERATIONS, *variables, condition=more) as k:
            width = ir.let(f'fsub double {right}, {left}')
            rise = ir.let(f'fsub double {f_right}, {f_left}')
            part = ir.let(f'fdiv double {f_right}, {rise}')
            secant = ir.let(f'fsub double {right}, {ir.let(f"fmul double {part}, {width}")}')
            middle = ir.let(f'fadd double {left}, {ir.let(f"fmul double {half}, {width}")}')
            above = ir.let(f'fcmp ogt double {secant}, {left}')
            below = ir.let(f'fcmp olt double {secant}, {right}')
            inside = ir.let(f'and i1 {above}, {below}')
            third = ir.let(f'icmp eq i64 {ir.let(f"urem i64 {k}, 3")}, 2')
            wanted = ir.let(f'and i1 {inside}, {ir.let(f"xor i1 {third}, true")}')
            theta = ir.let(f'select i1 {wanted}, double {secant}, double {middle}')
            after = self._look(calls, theta)
            margin = calls.number('margin')
            same = ir.let(f'icmp eq i1 {after}, {side}')
            weight = ir.let(f'select i1 {same}, double {half}, double {number(1.0)}')
            lighter_left, lighter_right = (
                ir.let(f'fmul double {f}, {weight}') for f in (f_left, f_right)
            )
            for variable, chosen, other in (
                (left, left.value, theta),
                (right, theta, right.value),
                (f_left, lighter_left, margin),
                (f_right, margin, lighter_right),
            ):
                variable.value = ir.let(f'select i1 {after}, double {chosen}, double {other}')
            side.value = after
            gap = ir.let(f'fsub double {right}, {left}')
            least = ir.let(f'fmul double {right}, {number(TOLERANCE)}')
            more.value = ir.let(f'fcmp ogt double {gap}, {least}')
        self._look(calls, right.value)
