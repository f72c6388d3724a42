# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of a simulation in native code: `width` arms at a time, one arm in each lane.

    @simulate(plan)                 arms, steps, substeps, every, table, finite
    @accelerations(steps, table)    qdd of states that were written before, of one arm

A plan is a block of these six integers: one argument, since ctypes takes 70 ns to pass each. The
table holds for each of `Steps.arrays` its address, and the bytes from arm to arm, from element to
element and from step to step. Each step takes its torque, or runs a control program that
computes it; brings braked joints to rest; takes `substeps` steps of the integrator; and writes
each `every`-th state. `finite` receives for each arm the number of steps after which its state was
finite.

Every operation on an arm is the same for each width, in the same order: so are the bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from pfd_core.kernels.generate import (
    body,
    declarations,
    evaluate,
    given,
    inputs_of,
    operations,
    to_columns,
    to_rows,
)
from pfd_core.kernels.ir import Code
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


@dataclass(frozen=True)
class Steps:
    """
    The steps of a simulation.

    Attributes
    ----------
    n : int
        Number of joints.
    further : tuple of str
        Rows of the state other than q, qd and qdd: zero before the first step.
    inputs : dict
        Elements of the inputs of the dynamics besides q and qd.
    written : tuple of str
        What is written after a step: rows of the state, qdd, or outputs of `control`. With qdd the
        acceleration is also a row, else there is @accelerations.
    dtype, width
        As of Code.
    shared : bool
        Whether a substep begins with the acceleration qdd that the one before ended with.
    control : Program, optional
        A lowered or recorded program that computes the torque of each step, its output tau; else
        tau is an array. It reads the state, inputs, its own outputs of the step before, and
        further arrays. Each number above 0 of its output `counts` adds one to an element of the
        array `counts`, and if `stop` is above 0 the run ends before the step. A run with `stop`,
        which is of one arm, also ends after a step whose state is not finite.

    """

    n: int
    further: tuple[str, ...]
    inputs: Mapping[str, int]
    written: tuple[str, ...]
    dtype: str
    width: int = 1
    shared: bool = False
    control: Program | None = None

    @property
    def torque(self) -> str:
        """The row or input that is the torque at the beginning and the end of a step."""
        return MOTOR_TORQUE if MOTOR_TORQUE in self.further else 'tau'

    @property
    def rows(self) -> dict[str, int]:
        """Arrays that a run reads at its beginning and writes at its end, and their elements."""
        names = [*MOTION, *self.further, *(['qdd'] if 'qdd' in self.written else [])]
        if self.control is not None:
            names += [name for name in self.control.inputs if name in self.control.outputs]
        return dict.fromkeys(names, self.n)

    @property
    def arrays(self) -> tuple[str, ...]:
        """The arrays of the table of @simulate."""
        names = [*self.rows, *self.held]
        if self.control is None:
            names.append('tau')
        else:
            names += [name for name in self.control.inputs if name not in names]
            names += [COUNTS] if COUNTS in self.control.outputs else []
        return (*names, *(f'{name}.out' for name in self.written))

    @property
    def held(self) -> tuple[str, ...]:
        """Inputs that are the same for all steps of a run."""
        return tuple(name for name in self.inputs if name != 'tau')

    @property
    def sampled(self) -> tuple[str, ...]:
        """The arrays of the table of @accelerations; the torque is a row in each."""
        given = [self.torque if name == 'tau' else name for name in self.inputs]
        return (*MOTION, *given, 'qdd')


def simulation_functions(steps: Steps, dynamics: Mapping[str, Program], frame: Frame) -> list[str]:
    """
    Return @simulate and what it calls, and @accelerations if accelerations are not written.

    They call @advance, which takes a frame through a step, and @accelerate, which writes its qdd
    between two steps. In scenes with brakes `dynamics` has `momentum`, H qdd, and `inertial`,
    H^-1 tau of the free joints.
    """
    parts = [_brake(steps, dynamics, frame)] if 'free' in steps.inputs else []
    if 'qdd' not in steps.written:
        parts.append(_accelerations(steps, frame))
    if steps.width > 1:
        sizes = sorted({steps.n, *steps.inputs.values()})
        parts += [_copy(steps, size, inward) for size in sizes for inward in (True, False)]
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


def simulation_module(parts: Sequence[str], steps: Steps, wrapped: bool) -> str:
    """Return functions with what they refer to; `wrapped` states whether angles are wrapped."""
    code = Code('', steps.dtype, steps.width)
    further = []
    if code.width > 1:
        kind, flags = f'<{code.width} x ptr>', code.flag
        further = [
            f'declare {code.index} @{_least(code)}({code.index}, {code.index})',
            f'declare {code.type} @{_gather(code)}({kind}, {flags}, {code.type})',
        ]
    widths = {1, steps.width}
    return '\n\n'.join([*parts, *further, declarations(steps.dtype, widths, wrapped)])


def new_frame(steps: Steps) -> Frame:
    """Return a frame with the state, the inputs of the dynamics, and results of the control."""
    frame = Frame()
    sizes = steps.rows | {'qdd': steps.n} | dict(steps.inputs)
    if steps.control is not None:
        sizes |= {name: len(places) for name, (_, places) in steps.control.outputs.items()}
    for name, size in sizes.items():
        frame.place(name, size)
    return frame


def _brake(steps: Steps, dynamics: Mapping[str, Program], frame: Frame) -> str:
    """
    Return `void @brake(frame)`: it brings braked joints to rest, by impulses of the brakes.

    H v = H qd + p, v = 0 and p any where a joint is braked, p = 0 elsewhere. An arm whose braked
    joints are at rest keeps its velocities.
    """
    s = Script('brake', frame, dynamics, steps.dtype, steps.width)
    code, zero = s.code, s.code.constant(0.0)
    free, before = s.read('free'), s.read('qd')
    moves = ''
    for own, velocity in zip(free, before, strict=True):
        braked = code.let(f'fcmp ole {code.type} {own}, {zero}')
        moving = code.let(f'fcmp une {code.type} {velocity}, {zero}')
        flag = code.let(f'and {code.flag} {braked}, {moving}')
        moves = code.let(f'or {code.flag} {moves}, {flag}') if moves else flag
    with code.when(code.any(moves), rarely=True):
        s.fill('zero', 0.0, steps.n)
        s.evaluate('load', 'momentum', qd='zero', qdd='qd')
        s.evaluate('after', 'inertial', qd='zero', tau='load')
        velocities = []
        for own, old, new in zip(free, before, s.read('after'), strict=True):
            value = code.choose(code.above(own), new, zero)
            velocities.append(code.choose(moves, value, old))
        s.write('qd', velocities)
    return str(s)


def _accelerations(steps: Steps, frame: Frame) -> str:
    """Return `void @accelerations(steps, table)`, of one arm."""
    head = 'define void @accelerations(i64 %steps, ptr %table)'
    arms = _Arms(head, steps, steps.sampled, frame)
    with arms.code.loop('%steps') as t:
        for name in steps.sampled[:-1]:
            arms.take(name, t)
        arms.call('accelerate')
        arms.give('qdd', 'qdd', t)
    arms.code.ret()
    return str(arms.code)


def _simulate(steps: Steps, frame: Frame) -> str:
    names = ('arms', 'steps', 'substeps', 'every')
    parameters = ', '.join([*(f'i64 %{name}' for name in names), 'ptr %table', 'ptr %finite'])
    entry = Code('define void @simulate(ptr %plan)')
    given = [
        f'{kind} {entry.load(kind, entry.at("%plan", k, 8))}'
        for k, kind in enumerate(['i64'] * len(names) + ['ptr', 'ptr'])
    ]
    entry.call('void', 'run', *given)
    entry.ret()
    arms = _Arms(f'define internal void @run({parameters})', steps, steps.arrays, frame)
    code = arms.code
    with code.loop('%arms', step=steps.width) as first:
        arms.begin(first, code.integer('sub', code.integer('sub', '%arms', 1), first))
        for name in (*steps.rows, *steps.held):
            arms.take(name)
        reached = code.variable(code.index, 'zeroinitializer')
        row, wait = code.variable('i64', 0), code.variable('i64', 1)
        stops = steps.control is not None and STOP in steps.control.outputs
        again = code.variable('i1', 'true') if stops else None
        with code.loop('%steps', again=again) as t, ExitStack() as unless_stopped:
            due = code.test('eq', wait.get(), '%every')
            if steps.control is None:
                arms.take('tau', t)
            else:
                stop = arms.control(steps.control, t)
                with code.when(due):
                    arms.write([x for x in steps.written if x in steps.control.outputs], row.get())
                if again is not None:
                    again.set('false')
                    unless_stopped.enter_context(code.when(code.negated(stop)))
            if 'free' in steps.inputs:
                arms.call('brake')
            if steps.shared:
                arms.call('accelerate')
            with code.loop('%substeps'):
                arms.call('advance')
            finite = arms.finite()
            if again is not None:
                again.set(code.any(finite))
            counts = code.let(f'icmp eq {code.index} {reached.get()}, {_everywhere(code, t)}')
            counts = code.let(f'and {code.flag} {counts}, {finite}')
            counts = code.let(f'zext {code.flag} {counts} to {code.index}')
            reached.set(code.let(f'add {code.index} {reached.get()}, {counts}'))
            if 'qdd' in steps.written:
                final = code.test('eq', t, code.integer('sub', '%steps', 1))
                with code.when(code.either(due, final)):
                    arms.call('accelerate')
            with code.when(due):
                controlled = () if steps.control is None else steps.control.outputs
                arms.write([x for x in steps.written if x not in controlled], row.get())
            row.set(code.integer('add', row.get(), code.let(f'zext i1 {due} to i64')))
            later = code.integer('add', wait.get(), 1)
            wait.set(code.let(f'select i1 {due}, i64 1, i64 {later}'))
        for name in steps.rows:
            arms.give(name, name)
        arms.report(reached.get())
    code.ret()
    return f'{code}\n\n{entry}'


@dataclass(frozen=True)
class _Array:
    """An array of the table: its address, and bytes between arms, elements and steps."""

    base: str
    arm: str
    element: str
    step: str


class _Arms:
    """
    Writer of a function that moves `width` arms from the arrays of a table into a frame and back.

    `take`, `give` and `control` use the arms of `begin`, at first the first one.
    """

    def __init__(self, head: str, steps: Steps, names: Sequence[str], frame: Frame) -> None:
        self.code = code = Code(head, steps.dtype, steps.width)
        self._frame, self._near = frame, code.array(frame.size)
        self._step = code.width * code.bytes
        kinds = ('ptr', 'i64', 'i64', 'i64')
        self._table = {
            name: _Array(
                *(code.load(kind, code.at('%table', 4 * k + j, 8)) for j, kind in enumerate(kinds))
            )
            for k, name in enumerate(names)
        }
        self._first: object = 0
        self._last: object = 0
        # For each lane its arm, counted from the first one.
        self._numbers = ''

    def begin(self, first: str, last: str) -> None:
        """Go to the arms from `first` on, of which `last` more are there."""
        code = self.code
        self._first, self._last = first, last
        if code.width > 1:
            lanes = f'<{", ".join(f"i64 {lane}" for lane in range(code.width))}>'
            arguments = f'{code.index} {lanes}', f'{code.index} {_everywhere(code, last)}'
            self._numbers = code.call(code.index, _least(code), *arguments)

    def take(self, name: str, step: object = 0) -> None:
        """Copy an array at a step into the frame."""
        self._move(name, name, step, True)

    def give(self, name: str, target: str, step: object = 0) -> None:
        """Copy an array of the frame to an array of the table, at a step."""
        self._move(name, target, step, False)

    def write(self, names: Sequence[str], row: str) -> None:
        """Copy arrays of the frame to a row of those that are written."""
        for name in names:
            self.give(name, f'{name}.out', row)

    def call(self, name: str) -> None:
        """Call a function of a frame."""
        self.code.call('void', name, f'ptr {self._near}')

    def finite(self) -> str:
        """Return for each arm whether its motion is finite."""
        code, nothing = self.code, self.code.constant(0.0)
        for name in MOTION:
            for k in range(self._frame.length(name)):
                nothing = code.op('fma', self._element(name, k), code.constant(0.0), nothing)
        return code.let(f'fcmp ord {code.type} {nothing}, {nothing}')

    def control(self, program: Program, step: str) -> str:
        """Run a control program; return an i1, whether the run ends here."""
        code = self.code
        starts = {name: self._start(name, step) for name in program.inputs if name in self._table}

        def read(name: str, k: int) -> str:
            if name in self._frame:
                return self._element(name, k)
            return self._gathered(name, code.at(starts[name], k, self._table[name].element))

        values = operations(code, program, read)
        stop = 'false'
        for name, (_, places) in program.outputs.items():
            for k, (register, _) in enumerate(places):
                if name == STOP:
                    stop = code.above(values[register])
                elif name == COUNTS:
                    place = code.at(self._table[COUNTS].base, k, 8)
                    one = code.let(f'zext i1 {code.above(values[register])} to i64')
                    code.store('i64', code.integer('add', code.load('i64', place), one), place)
                else:
                    first = self._frame.place(name, len(places))
                    code.write(values[register], self._near, first + k, self._step)
        return stop

    def report(self, reached: str) -> None:
        """Write a number for each arm to %finite; lanes beyond the last arm repeat it."""
        code = self.code
        lanes = code.array(1, code.index)
        code.store(code.index, reached, lanes)
        with code.loop(code.width) as lane:
            place = code.at(code.at('%finite', self._first, 8), code.least(lane, self._last), 8)
            code.store('i64', code.load('i64', code.at(lanes, lane, 8)), place)

    def _element(self, name: str, k: int) -> str:
        first = self._frame.place(name, self._frame.length(name))
        return self.code.read(self._near, first + k, self._step)

    def _start(self, name: str, step: object) -> str:
        code, array = self.code, self._table[name]
        return code.at(code.at(array.base, self._first, array.arm), step, array.step)

    def _gathered(self, name: str, place: str) -> str:
        """Return the number at an address, and behind it those of the other arms."""
        code, arm = self.code, self._table[name].arm
        if code.width == 1:
            return code.load(code.scalar, place, code.bytes)
        offsets = code.let(f'mul {code.index} {self._numbers}, {_everywhere(code, arm)}')
        places = code.let(f'getelementptr i8, ptr {place}, {code.index} {offsets}')
        addresses = f'<{code.width} x ptr> align {code.bytes} {places}'
        flags = f'{code.flag} splat (i1 true)'
        return code.call(code.type, _gather(code), addresses, flags, f'{code.type} poison')

    def _move(self, name: str, there: str, step: object, inward: bool) -> None:
        code, size, array = self.code, self._frame.length(name), self._table[there]
        start = self._start(there, step)
        near = code.at(self._near, self._frame.place(name, size), self._step)
        if code.width == 1:
            _move(code, size, (start, array.element), (near, code.bytes), inward)
            return
        strides = f'i64 {array.arm}', f'i64 {array.element}'
        function = f'arms_{"in" if inward else "out"}{size}'
        code.call('void', function, f'ptr {start}', *strides, f'ptr {near}', f'i64 {self._last}')


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
    whole = code.test('uge', '%last', code.width - 1)
    dense = code.test('eq', '%element', code.bytes)
    with code.when(code.both(whole, dense)):
        if inward:
            to_columns(code, '%start', '%arm', '%near', size)
        else:
            to_rows(code, '%near', '%start', '%arm', size)
        code.ret()
    with code.loop(code.width) as lane:
        there = code.at('%start', code.least(lane, '%last'), '%arm')
        here = code.at('%near', lane, code.bytes)
        _move(code, size, (there, '%element'), (here, code.width * code.bytes), inward)
    code.ret()
    return str(code)


def _move(
    code: Code, size: int, there: tuple[str, object], here: tuple[str, object], inward: bool
) -> None:
    """Copy numbers between two arrays, each an address and bytes from number to number."""
    source, target = (there, here) if inward else (here, there)
    for k in range(size):
        value = code.load(code.scalar, code.at(source[0], k, source[1]), code.bytes)
        code.store(code.scalar, value, code.at(target[0], k, target[1]), code.bytes)


def _everywhere(code: Code, integer: object) -> str:
    """Return an i64 in all lanes."""
    if code.width == 1:
        return str(integer)
    one = code.let(f'insertelement {code.index} poison, i64 {integer}, i64 0')
    return code.shuffle(code.index, one, 'poison', [0] * code.width)


def _least(code: Code) -> str:
    return f'llvm.umin.v{code.width}i64'


def _gather(code: Code) -> str:
    return f'llvm.masked.gather.{code.suffix}.v{code.width}p0'
