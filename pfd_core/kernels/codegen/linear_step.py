# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of the linearisation of an integrator's step: A and B of x' = A x + B tau.

    @linear_step    the step of `step.py`, with the derivatives of its end by its beginning
    @evaluate       these of all substeps, multiplied up

Between two calls of the accelerations a step is linear, with constant factors. The derivative of a
row by the state and the torque, (n, m), is therefore a sum of matrices, one for each call and one
unit matrix for each input, with factors that are known when the code is written. A matrix is
computed only where a call needs it: with J = d qdd / d(q, qd, tau) from @jacobian,

    dqdd = J_q dq + J_qd dqd + J_tau dtau

Everything here is a loop over memory: the length of the code does not depend on n.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pfd_core.kernels.codegen.builder import Function
from pfd_core.kernels.codegen.evaluate import wrapped
from pfd_core.kernels.codegen.matrices import Matrices, Matrix
from pfd_core.kernels.codegen.spelling import ARGUMENTS, Array, Format, arguments
from pfd_core.kernels.codegen.step import HANDED, MOTION, MOTOR_TORQUE
from pfd_core.machine.program import Program

# Angles of at most this magnitude stay as they are [rad]: a stage rounds them little.
ANGLE_LIMIT = 8.0
# The torque that a step is given, by which its end is derived as well.
COMMAND = 'tau'
Factors = tuple[float, ...]


@dataclass(frozen=True)
class Tangent:
    """
    Derivative of a row: factors, one for each lane, of unit matrices and of dense matrices.

    Attributes
    ----------
    units : dict
        Input to the factors of its unit matrix.
    dense : dict
        Number of a call to the factors of the rows of its matrix.

    """

    units: Mapping[str, Factors] = field(default_factory=dict)
    dense: Mapping[int, Factors] = field(default_factory=dict)

    def scaled(self, factors: Sequence[float]) -> Tangent:
        """Return the derivative of a row times constants."""

        def times(own: Factors) -> Factors:
            return tuple(a * b for a, b in zip(own, factors, strict=True))

        return Tangent(
            {name: times(own) for name, own in self.units.items()},
            {call: times(own) for call, own in self.dense.items()},
        )

    def plus(self, other: Tangent) -> Tangent:
        """Return the derivative of the sum of two rows."""
        units, dense = dict(self.units), dict(self.dense)
        for name, factors in other.units.items():
            units[name] = _sum(units.get(name), factors)
        for call, factors in other.dense.items():
            dense[call] = _sum(dense.get(call), factors)
        return Tangent(units, dense)


def _sum(a: Factors | None, b: Factors) -> Factors:
    return b if a is None else tuple(x + y for x, y in zip(a, b, strict=True))


def state_rows(step: Program) -> tuple[str, ...]:
    """Return the rows of the state that the motion depends on: the rows of a linearisation."""
    return tuple(name for name in step.outputs if name in (*MOTION, MOTOR_TORQUE))


def carried_rows(step: Program) -> tuple[str, ...]:
    """Return the rows that one step hands to the next: also the acceleration, where it does."""
    return (*state_rows(step), *(('qdd',) if 'qdd' in step.inputs else ()))


def called(step: Program) -> tuple[str, ...]:
    """Return the functions that a linearised step calls."""
    names = [instruction.data for instruction in step.instructions if instruction.op == 'call']
    return tuple(dict.fromkeys(['qdd'] * ('qdd' in step.inputs) + names))


def linear_step(step: Program, dynamics: Mapping[str, Program], form: Format) -> str:
    """
    Return `void @linear_step(rows..., tau, extra..., S)`: it advances the rows in place.

    Parameters
    ----------
    step : Program
        An integrator's step, on n lanes, with plain sums.
    dynamics : dict
        Lowered programs of the functions that it calls, by name.
    form : Format
        Number format and width; arrays are not strided.

    S, (rows n, (rows + 1) n), is the derivative of the carried rows by themselves and by tau.
    """
    parameters = ', '.join(f'ptr %{name}' for name in (*_arguments(step, dynamics), 'S'))
    ir = Function(f'define internal void @linear_step({parameters}) noinline')
    _Step(ir, step, dynamics, form).write()
    ir.ret()
    return str(ir)


def _arguments(step: Program, dynamics: Mapping[str, Program]) -> tuple[str, ...]:
    """Return the arguments of @linear_step: rows of the state, the torque, other inputs."""
    own = (*carried_rows(step), COMMAND)
    extra = {name for program in dynamics.values() for name in arguments(program)}
    return (*own, *sorted(extra - {*own}))


class _Step:
    """Writer of @linear_step."""

    def __init__(
        self, ir: Function, step: Program, dynamics: Mapping[str, Program], form: Format
    ) -> None:
        self._ir, self._step, self._dynamics, self._form = ir, step, dynamics, form
        self._n = n = step.lanes
        self._inputs = (*carried_rows(step), COMMAND)
        self._m = n * len(self._inputs)
        self._matrices = Matrices(ir, form)
        self._jacobian = self._matrices.new(n, 3 * n)
        self._given = {name: ir.array(form.type, n) for name in (*MOTION, COMMAND, 'qdd')}
        self._dense: list[Matrix] = []
        self._factors: dict[str, Matrix] = {}
        self._values: list[list[str]] = []
        self._tangents: list[Tangent] = []

    def write(self) -> None:
        """Write all instructions of the step, its end, and S."""
        for instruction in self._step.instructions:
            value, tangent = self._row(*instruction[:3])
            self._values.append(value)
            self._tangents.append(tangent)
        rows = carried_rows(self._step)
        for part, name in enumerate(rows):
            register = self._step.outputs[name].places[0][0]
            place = self._ir.element(self._form.type, '%S', part * self._n * self._m)
            self._write_tangent(Matrix(place, self._m), self._tangents[register])
        for name in rows:
            for k, (register, _) in enumerate(self._step.outputs[name].places):
                self._form.write(self._ir, Array(f'%{name}'), k, self._values[register][k])

    def _row(self, op: str, args: tuple[int, ...], data: object) -> tuple[list[str], Tangent]:
        """Return the numbers of a register and its derivative."""
        form, ir, n = self._form, self._ir, self._n
        tangents = [self._tangents[a] for a in args]
        if op == 'call':
            assert isinstance(data, str)
            return self._call(data, [self._values[a] for a in args], tangents)
        if op == 'input':
            assert isinstance(data, tuple)
            name = str(data[0][0])
            return self._read(f'%{name}'), Tangent({name: (1.0,) * n})
        if op == 'constant':
            assert isinstance(data, tuple)
            return [form.constant(x) for x in data], Tangent()
        lanes = [[self._values[a][k] for a in args] for k in range(n)]
        value = [form.operation(ir, op, lane) for lane in lanes]
        return value, self._derivative(op, args, tangents)

    def _derivative(self, op: str, args: Sequence[int], tangents: Sequence[Tangent]) -> Tangent:
        """Return the derivative of an operation that is linear in all but constants."""
        minus = (-1.0,) * self._n
        if op == 'neg':
            return tangents[0].scaled(minus)
        if op in ('add', 'sub'):
            return tangents[0].plus(tangents[1] if op == 'add' else tangents[1].scaled(minus))
        constants = [self._constant(a) for a in args]
        if op == 'mul':
            for factors, tangent in zip(constants, reversed(tangents), strict=True):
                if factors is not None:
                    return tangent.scaled(factors)
        if op == 'select' and constants[0] is not None:
            chosen = tuple(float(c > 0) for c in constants[0])
            other = tuple(1 - c for c in chosen)
            return tangents[1].scaled(chosen).plus(tangents[2].scaled(other))
        raise ValueError(f'a step with {op} of two rows of the state is not linear between calls')

    def _constant(self, register: int) -> Factors | None:
        op, _, data, *_ = self._step.instructions[register]
        return tuple(data) if op == 'constant' else None

    def _read(self, address: str) -> list[str]:
        return [self._form.read(self._ir, Array(address), k) for k in range(self._n)]

    def _call(
        self, function: str, values: Sequence[list[str]], tangents: Sequence[Tangent]
    ) -> tuple[list[str], Tangent]:
        """Return the accelerations of a call, and their derivative, a dense matrix."""
        names = HANDED[function]
        given = dict(zip(names, values, strict=False))
        if function == 'solve':
            given['qd'] = [self._form.zero] * self._n
        addresses = {name: f'%{name}' for name in arguments(self._dynamics[function])}
        for name, row in given.items():
            addresses[name] = self._given[name]
            for k, value in enumerate(row):
                self._form.write(self._ir, Array(self._given[name]), k, value)
        derived = dict(zip(names, tangents, strict=False))
        if COMMAND not in given:
            derived[COMMAND] = Tangent({COMMAND: (1.0,) * self._n})
        operands = [addresses[name] for name in arguments(self._dynamics[function])]
        operands += [self._given['qdd'], self._jacobian.address]
        self._ir.call('void', f'jacobian_{function}', *(f'ptr {x}' for x in operands))
        self._dense.append(self._product(derived))
        return self._read(self._given['qdd']), Tangent(
            dense={len(self._dense) - 1: (1.0,) * self._n}
        )

    def _product(self, derived: Mapping[str, Tangent]) -> Matrix:
        """Return J times the derivatives of the arguments."""
        n, m, matrices = self._n, self._m, self._matrices
        places = {'q': 0, 'qd': n, COMMAND: 2 * n}
        result = matrices.new(n, m)
        for k, name in enumerate(self._inputs):
            scaled = [
                (self._jacobian.block(places[row]), tangent.units[name])
                for row, tangent in derived.items()
                if name in tangent.units
            ]
            matrices.combine(result.block(k * n), (n, n), (), scaled)
        pairs = []
        for row, tangent in derived.items():
            if tangent.dense:
                if row not in self._factors:
                    self._factors[row] = matrices.new(n, m)
                factor = self._factors[row]
                terms = [(self._dense[call], f) for call, f in tangent.dense.items()]
                matrices.combine(factor, (n, m), terms)
                pairs.append((self._jacobian.block(places[row]), factor))
        if pairs:
            matrices.add_products(result, (n, m), pairs, n, result)
        return result

    def _write_tangent(self, out: Matrix, tangent: Tangent) -> None:
        n, ir, form = self._n, self._ir, self._form
        terms = [(self._dense[call], factors) for call, factors in tangent.dense.items()]
        self._matrices.combine(out, (n, self._m), terms)
        for k, name in enumerate(self._inputs):
            for i, factor in enumerate(tangent.units.get(name, ())):
                place = ir.element(form.type, out.address, i * self._m + k * n + i)
                total = ir.load(form.type, place, form.bytes)
                value = form.operation(ir, 'add', [total, form.constant(factor)])
                ir.store(form.type, value, place, form.bytes)


def linearisation(
    step: Program,
    dynamics: Mapping[str, Program],
    form: Format,
    substeps: int,
    angles: Sequence[int],
) -> str:
    """
    Return `void @evaluate(inputs..., out)`: the derivative of the state after some substeps.

    It is that by the state before them and by the torque, with the state itself as the last
    column, (rows n, (rows + 1) n + 1). Arrays are of the format, strided or not. A joint that its
    brake holds loses its velocity first, so that nothing depends on that. Motors with a lag have
    reached the torque. Of `angles`, elements of q, only the part within half a turn enters the
    stages: a stage would round a large angle. The turns are added to the angle at the end.
    """
    n, rows, carried = step.lanes, state_rows(step), carried_rows(step)
    inner = Format(form.dtype, form.width)
    names = _arguments(step, dynamics)
    given = (*(name for name in ARGUMENTS if name in names and name not in carried[2:]), 'out')
    ir = Function(f'define void @evaluate({form.parameters(given)})')
    own = _copied(ir, form, names, n)
    turns = _wrap(ir, inner, own, n, angles) if angles else {}
    matrices = Matrices(ir, inner)
    height, m = n * len(carried), n * (len(rows) + 1)
    once = matrices.new(height, height + n)
    arguments_ = [f'ptr {own[name]}' for name in names]
    total = once
    if 'qdd' in carried:
        total = _beginning(ir, matrices, step, dynamics, own, form)
    else:
        ir.call('void', 'linear_step', *arguments_, f'ptr {once.address}')
    further = substeps - (total is once)
    if further:
        total, product = matrices.new(height, m), total
        ones = (1.0,) * height
        matrices.combine(total, (height, m), [(product, ones)])
        product = matrices.new(height, m)
        with ir.loop(further):
            ir.call('void', 'linear_step', *arguments_, f'ptr {once.address}')
            matrices.combine(product, (height, m - n), [])
            matrices.combine(product.block(m - n), (height, n), [(once.block(height), ones)])
            matrices.add_products(product, (height, m), [(once, total)], height, product)
            matrices.combine(total, (height, m), [(product, ones)])
    for i in range(n * len(rows)):
        for j in range(m):
            value = inner.read(ir, Array(total.address), i * m + j)
            if 'free' in names and n <= j < 2 * n:
                value = _while_free(ir, form, j - n, value)
            form.write(ir, form.parameter('out'), i * (m + 1) + j, value)
        part, k = divmod(i, n)
        value = inner.read(ir, Array(own[rows[part]]), k)
        if rows[part] == 'q' and k in turns:
            value = form.operation(ir, 'add', [value, turns[k]])
        form.write(ir, form.parameter('out'), i * (m + 1) + m, value)
    ir.ret()
    return str(ir)


def _copied(ir: Function, form: Format, names: Sequence[str], n: int) -> dict[str, str]:
    """Return the addresses of copies of the inputs, with zero velocities of braked joints."""
    own, inner = {}, Format(form.dtype, form.width)
    for name in names:
        size = 6 if name == 'wrench' else n
        own[name] = ir.array(form.type, size)
        if name == 'qdd':
            continue
        source = form.parameter(COMMAND if name == MOTOR_TORQUE else name)
        for k in range(size):
            value = form.read(ir, source, k)
            if name == 'qd' and 'free' in names:
                value = _while_free(ir, form, k, value)
            inner.write(ir, Array(own[name]), k, value)
    return own


def _wrap(
    ir: Function, form: Format, own: dict[str, str], n: int, angles: Sequence[int]
) -> dict[int, str]:
    """Wrap the angles among the inputs; return what each of them has lost."""
    whole = Array(own['q'])
    rest = wrapped(ir, form, whole, n, angles, ANGLE_LIMIT)
    own['q'] = rest.address
    return {
        k: form.operation(ir, 'sub', [form.read(ir, x, k) for x in (whole, rest)]) for k in angles
    }


def _beginning(
    ir: Function,
    matrices: Matrices,
    step: Program,
    dynamics: Mapping[str, Program],
    own: Mapping[str, str],
    form: Format,
) -> Matrix:
    """Write the acceleration before the first step; return the derivative of what it carries."""
    n, rows = step.lanes, state_rows(step)
    size = n * len(rows)
    result, jacobian = matrices.new(size + n, size + n), matrices.new(n, 3 * n)
    operands = [own[name] for name in arguments(dynamics['qdd'])]
    operands += [own['qdd'], jacobian.address]
    ir.call('void', 'jacobian_qdd', *(f'ptr {address}' for address in operands))
    matrices.combine(result, (size + n, size + n), [])
    inner = Format(form.dtype, form.width)
    for k in range(size):
        inner.write(ir, Array(result.address), k * (size + n) + k, inner.constant(1.0))
    last = Matrix(ir.element(form.type, result.address, size * (size + n)), size + n)
    ones = (1.0,) * n
    matrices.combine(last, (n, 2 * n), [(jacobian, ones)])
    # The torque at the beginning is the motors', which may be a row of the state.
    torque = n * (rows.index(MOTOR_TORQUE) if MOTOR_TORQUE in rows else len(rows))
    matrices.combine(last.block(torque), (n, n), [(jacobian.block(2 * n), ones)])
    return result


def _while_free(ir: Function, form: Format, k: int, value: str) -> str:
    """Return a value, or zero where the brake of joint k holds it."""
    free = form.read(ir, form.parameter('free'), k)
    moves = ir.let(f'fcmp ogt {form.type} {free}, {form.zero}')
    return form.select(ir, moves, value, form.zero)
