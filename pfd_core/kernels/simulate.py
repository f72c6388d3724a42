# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of a simulation in native code: `width` arms at a time, one arm in each lane.

    @simulate(plan)         some steps of some arms
    @accelerations(plan)    qdd of states that were written before, each of them an arm here

A plan is a block of 64-bit integers: one argument, since ctypes takes 70 ns to pass each. Behind
those of PLAN it has for each of `Steps.arrays` the address, and the bytes from arm to arm, from
element to element and from step to step. An array that changes from step to step is read before
each step, any other once. In a step a control program, if there is one, computes the torque;
braked joints are brought to rest; the integrator takes `substeps` steps; and each `every`-th state
is written. The number of steps after which its state was finite grows in `finite` for each arm
that was finite before; @simulate returns whether one of the arms has fewer than `until`.

Every operation on an arm is the same for each width, in the same order: so are the bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from pfd_core.forking import cached_property
from pfd_core.kernels.generate import (
    body,
    evaluate,
    given,
    inputs_of,
    to_columns,
    to_rows,
)
from pfd_core.kernels.ir import Code, Variable
from pfd_core.kernels.script import Frame, Script
from pfd_core.machine.program import Program

# The rows of the state that every simulation has, and the arrays that it reports.
MOTION = ('q', 'qd')
REPORT = (*MOTION, 'qdd')
# Rows of the state in some simulations: the torque, where motors lag behind the commanded one;
# rounding errors of the positions, for sums that keep them; 1 once a step had too many events.
MOTOR_TORQUE, LOW_POSITION, UNFINISHED = 'tau_motor', 'q_low', 'unfinished'
# Outputs of a control program that are no arrays: flags that are counted, and the end of the run.
COUNTS, STOP = 'counts', 'stop'
# Arms from `first` to before `end`, steps from `begin` to before `until`; `apart` has the bytes
# from one written array to the next, `finite` is an address. Written rows and finite steps are
# counted from step 0.
PLAN = ('first', 'end', 'begin', 'until', 'substeps', 'every', 'apart', 'finite')
# The first of the arrays that are written.
OUT = 'out'
# Above 0 once a step has kept what it may use again; 0 at the beginning of a run.
KNOWN = 'known'


@dataclass(frozen=True)
class Steps:
    """The steps of a simulation."""

    n: int  # number of joints
    further: tuple[str, ...]  # rows of the state but q, qd and qdd: zero before the first step
    inputs: Mapping[str, int]  # elements of the inputs of the dynamics besides q and qd
    # What is written after a step: rows of the state, or outputs of `control`. Without qdd in it
    # no step computes the acceleration at its end, and there is @accelerations.
    written: tuple[str, ...]
    dtype: str  # this and `width` as of Code
    width: int = 1
    shared: bool = False  # whether a substep begins with the qdd that the one before ended with
    # A recorded program that computes the torque of each step, its output tau; else tau is an
    # array. It reads the state, inputs, its own outputs of the step before, and further arrays.
    # Each number above 0 of its output `counts` adds one to an element of the array `counts`, and
    # if `stop` is above 0 the run ends before the step. A run with `stop`, which is of one arm,
    # also ends after a step whose state is not finite.
    control: Program | None = None

    @property
    def torque(self) -> str:
        """The row or input that is the torque at the beginning and the end of a step."""
        return MOTOR_TORQUE if MOTOR_TORQUE in self.further else 'tau'

    @property
    def _controlled(self) -> Mapping[str, object]:
        return {} if self.control is None else self.control.outputs

    @property
    def rows(self) -> tuple[str, ...]:
        """Arrays that a run reads at its beginning and writes at its end."""
        own = () if self.control is None else self.control.inputs
        qdd = ['qdd'] * ('qdd' in self.written)
        return (*MOTION, *qdd, *self.further, *(name for name in own if name in self._controlled))

    @property
    def given(self) -> dict[str, int]:
        """Arrays that are only read, and their elements."""
        names = dict(self.inputs) | ({} if self.control is None else dict(self.control.inputs))
        off = {*self.rows, *self._controlled}
        return {name: size for name, size in names.items() if name not in off}

    @cached_property
    def arrays(self) -> tuple[str, ...]:
        """The arrays of the table."""
        others = [COUNTS] * (COUNTS in self._controlled) + ['qdd'] * ('qdd' not in self.written)
        return (*self.rows, *self.given, *others, OUT)

    def frame(self) -> Frame:
        """Return a frame with the state, the inputs, and the results of the control."""
        frame = Frame()
        sizes = dict.fromkeys((*self.rows, 'qdd'), self.n) | self.given
        if self.control is not None:
            sizes |= {name: len(x.places) for name, x in self.control.outputs.items()}
        for name, size in sizes.items():
            frame.place(name, size)
        return frame


def simulation_functions(
    steps: Steps, control: Program | None, dynamics: Mapping[str, Program], frame: Frame
) -> list[str]:
    """
    Return @simulate and what it calls, and @accelerations if accelerations are not written.

    `control` is the lowered control program. They call @advance, which takes a frame through a
    step, and @accelerate, which writes its qdd between two steps. In scenes with brakes `dynamics`
    has `momentum`, H qdd, and `inertial`, H^-1 tau of the free joints.
    """
    parts = []
    if 'free' in steps.inputs:
        parts.append(brake(Script('brake', frame, dynamics, steps.dtype, steps.width), steps.n))
    sizes = sorted({steps.n, *steps.given.values()})
    parts += [_copy(steps, size, inward) for size in sizes for inward in (True, False)]
    if control is not None:
        s = Script('control', frame, {}, steps.dtype, steps.width, {'law': control}, inline=True)
        s.run('law')
        parts.append(str(s))
    parts += [] if 'qdd' in steps.written else [_accelerations(steps, frame)]
    return [*parts, _simulate(steps, frame)]


def evaluations(
    dynamics: Mapping[str, Program], dtype: str, width: int, angles: Sequence[int]
) -> list[str]:
    """
    Return `void @evaluate_name(inputs..., out)` of some lowered programs, on arrays of a frame.

    `angles` are the elements of q that turn.
    """
    parts = []
    for name, program in dynamics.items():
        parts.append(body(program, dtype, width, f'_{name}'))
        parts.append(evaluate(program, dtype, width, angles, f'_{name}', check=False))
        # In a function of its own, where LLVM knows the strides.
        arrays = [*inputs_of(program), 'out']
        parameters = ', '.join(f'ptr %{array}' for array in arrays)
        code = Code(f'define internal void @evaluate_{name}({parameters}) noinline', dtype, width)
        places = [(f'%{array}', width * code.bytes) for array in arrays]
        code.call('void', f'evaluate{width}_{name}', *given(places))
        code.ret()
        parts.append(str(code))
    return parts


def brake(s: Script, n: int, tangent: str = '') -> str:
    """
    Return `void @brake(frame)`, by a new script: impulses of brakes bring braked joints to rest.

    H v = H qd + p, v = 0 and p any where a joint is braked, p = 0 elsewhere. An arm whose braked
    joints are at rest keeps its velocities. On dual numbers `tangent` ends the names of tangents,
    which a brake changes at rest, too.
    """
    code, zero = s.code, s.code.constant(0.0)
    free, before = s.read('free'), s.read('qd')
    moves = closed = ''
    for own, velocity in zip(free, before, strict=True):
        braked = code.let(f'fcmp ole {code.type} {own}, {zero}')
        moving = code.let(f'fcmp une {code.type} {velocity}, {zero}')
        flag = code.let(f'and {code.flag} {braked}, {moving}')
        moves = code.let(f'or {code.flag} {moves}, {flag}') if moves else flag
        closed = code.let(f'or {code.flag} {closed}, {braked}') if closed else braked
    with code.when(code.any(closed if tangent else moves), rarely=True):
        s.fill('zero', 0.0, n)
        s.evaluate('load', 'momentum', qd='zero', qdd='qd')
        s.evaluate('after', 'inertial', qd='zero', tau='load')
        velocities = []
        for own, old, new in zip(free, before, s.read('after'), strict=True):
            value = code.choose(code.above(own), new, zero)
            velocities.append(code.choose(moves, value, old))
        s.write('qd', velocities)
        if tangent:
            pairs = zip(free, s.read(f'after{tangent}'), strict=True)
            s.write(f'qd{tangent}', [code.choose(code.above(f), x, zero) for f, x in pairs])
    return str(s)


def _accelerations(steps: Steps, frame: Frame) -> str:
    arms = _Arms('void', 'accelerations', steps, frame)
    with arms.each():
        arms.call('accelerate')
        arms.give('qdd')
    return str(arms)


def _simulate(steps: Steps, frame: Frame) -> str:
    arms = _Arms('i64', 'simulate', steps, frame)
    code, plan = arms.code, arms.plan
    lost = code.variable('i64', 0)
    controlled = () if steps.control is None else tuple(steps.control.outputs)
    # The control's outputs are those before a step, also before one that it stops.
    before = [name for name in steps.written if name in controlled]
    after = [name for name in steps.written if name not in controlled]
    with arms.each():
        finite = code.variable(code.flag, 'true' if code.width == 1 else 'splat (i1 true)')
        reached = code.variable(code.index, 'zeroinitializer')
        again = code.variable('i1', 'true') if STOP in controlled else None
        loop = code.loop(plan['until'], start=plan['begin'], again=again)
        with loop as t, ExitStack() as unless_stopped:
            past = code.integer('urem', code.integer('add', t, 1), plan['every'])
            due = code.test('eq', past, 0)
            for name in steps.given:
                with code.when(arms.changes(name)):
                    arms.take(name, t)
            if controlled:
                arms.call('control')
                with code.when(due):
                    arms.report(before, t)
            if COUNTS in controlled:
                arms.count()
            if again is not None:
                again.set('false')
                unless_stopped.enter_context(code.when(code.negated(arms.any(STOP))))
            if 'free' in steps.inputs:
                arms.call('brake')
            if steps.shared:
                arms.call('accelerate')
            with code.loop(plan['substeps']):
                arms.call('advance')
            finite.set(code.let(f'and {code.flag} {finite.get()}, {arms.finite()}'))
            if again is not None:
                again.set(code.any(finite.get()))
            one = code.let(f'zext {code.flag} {finite.get()} to {code.index}')
            reached.set(code.let(f'add {code.index} {reached.get()}, {one}'))
            if 'qdd' in after:
                last = code.test('eq', t, code.integer('sub', plan['until'], 1))
                with code.when(code.either(due, last)):
                    arms.call('accelerate')
            with code.when(due):
                arms.report(after, t)
        for name in steps.rows:
            arms.give(name)
        arms.end(reached.get(), lost)
    code.ret('i64', lost.get())
    return str(code)


class _Arms(Script):
    """Writer of a function that moves arms from the arrays of a plan into a frame and back."""

    def __init__(self, kind: str, name: str, steps: Steps, frame: Frame) -> None:
        head = f'define {kind} @{name}(ptr %plan)'
        super().__init__(name, frame, {}, steps.dtype, steps.width, head=head)
        self._steps, code = steps, self.code
        kinds = ['i64'] * (len(PLAN) - 1) + ['ptr'] + ['ptr', *['i64'] * 3] * len(steps.arrays)
        numbers = [code.load(kind, code.at('%plan', k, 8)) for k, kind in enumerate(kinds)]
        self.plan = dict(zip(PLAN, numbers, strict=False))
        # Of each array the address, and bytes between arms, elements and steps.
        rows = range(len(PLAN), len(numbers), 4)
        self._table = {x: numbers[k : k + 4] for x, k in zip(steps.arrays, rows, strict=True)}

    @contextmanager
    def each(self) -> Iterator[None]:
        """Repeat the body for `width` arms each, which are in the frame then."""
        code, end = self.code, self.plan['end']
        with code.loop(end, start=self.plan['first'], step=code.width) as self._first:
            # So many further arms are there.
            self._last = code.integer('sub', code.integer('sub', end, 1), self._first)
            for name in self._steps.rows:
                self.take(name)
            for name in self._steps.given:
                with code.when(code.negated(self.changes(name))):
                    self.take(name)
            if KNOWN in self._frame:
                self.fill(KNOWN, 0.0, 1)
            yield

    def changes(self, name: str) -> str:
        """Return an i1, whether an array changes from step to step."""
        return self.code.test('ne', self._table[name][-1], 0)

    def take(self, name: str, step: object = 0) -> None:
        """Copy an array at a step into the frame."""
        self._move(name, name, step, True)

    def give(self, name: str) -> None:
        """Copy an array of the frame to the array of the table."""
        self._move(name, name, 0, False)

    def report(self, names: Sequence[str], step: str) -> None:
        """Copy arrays of the frame to the row that is written at a step."""
        row = self.code.integer('udiv', step, self.plan['every'])
        for name in names:
            k = self._steps.written.index(name)
            self._move(name, OUT, row, False, self.code.integer('mul', self.plan['apart'], k))

    def finite(self) -> str:
        """Return for each arm whether its motion is finite."""
        code, nothing = self.code, self.code.constant(0.0)
        for number in (x for name in MOTION for x in self.read(name)):
            nothing = code.op('fma', number, code.constant(0.0), nothing)
        return code.let(f'fcmp ord {code.type} {nothing}, {nothing}')

    def count(self) -> None:
        """Add one to the numbers in the table whose flags in the frame are set."""
        code, (base, *_) = self.code, self._table[COUNTS]
        for k, flag in enumerate(self.read(COUNTS)):
            place = code.at(base, k, 8)
            one = code.let(f'zext i1 {code.above(flag)} to i64')
            code.store('i64', code.integer('add', code.load('i64', place), one), place)

    def end(self, reached: str, lost: Variable) -> None:
        """Add finite steps of each arm; lanes beyond the last arm repeat it, and add none."""
        code, plan = self.code, self.plan
        lanes, there = code.array(1, code.index), code.at(plan['finite'], self._first, 8)
        code.store(code.index, reached, lanes)
        with code.loop(code.width) as lane:
            place = code.at(there, code.least(lane, self._last), 8)
            number = code.integer('add', plan['begin'], code.load('i64', code.at(lanes, lane, 8)))
            with code.when(code.test('eq', code.load('i64', place), plan['begin'])):
                code.store('i64', number, place)
            with code.when(code.test('ne', code.load('i64', place), plan['until'])):
                lost.set(1)

    def _move(self, name: str, there: str, step: object, inward: bool, on: object = 0) -> None:
        code, size = self.code, self._frame.length(name)
        base, arm, element, later = self._table[there]
        start = code.at(code.at(code.at(base, on), self._first, arm), step, later)
        function = f'arms_{"in" if inward else "out"}{size}'
        strides = f'i64 {arm}', f'i64 {element}'
        code.call(
            'void', function, f'ptr {start}', *strides, f'ptr {self.at(name)}', f'i64 {self._last}'
        )


def _copy(steps: Steps, size: int, inward: bool) -> str:
    """
    Return @arms_in or @arms_out: a row of `size` elements of each of `width` arms.

    Lanes beyond the last arm repeat it, so that they are computed like any other, and written as
    equal bits.
    """
    parameters = 'ptr %start, i64 %arm, i64 %element, ptr %near, i64 %last'
    name = f'arms_{"in" if inward else "out"}{size}'
    head = f'define internal void @{name}({parameters}) noinline'
    code = Code(head, steps.dtype, steps.width)
    if code.width > 1:
        whole = code.test('uge', '%last', code.width - 1)
        dense = code.test('eq', '%element', code.bytes)
        with code.when(code.both(whole, dense)):
            if inward:
                to_columns(code, '%start', '%arm', '%near', size)
            else:
                to_rows(code, '%near', '%start', '%arm', size)
            code.ret()
    with code.loop(code.width) as lane:
        there = code.at('%start', code.least(lane, '%last'), '%arm'), '%element'
        here = code.at('%near', lane, code.bytes), code.width * code.bytes
        source, target = (there, here) if inward else (here, there)
        for k in range(size):
            value = code.load(code.scalar, code.at(source[0], k, source[1]), code.bytes)
            code.store(code.scalar, value, code.at(target[0], k, target[1]), code.bytes)
    code.ret()
    return str(code)
