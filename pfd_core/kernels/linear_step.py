# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearised steps in native code: A and B of x' = A x + B tau.

    @linear_step    an integrator's step, with the derivatives of its end by its beginning
    @body1          these of all substeps, multiplied up
    @jacobian_...   J of the accelerations that the step calls

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
from itertools import accumulate

from pfd_core.kernels.generate import (
    ORDER,
    batch,
    body,
    declarations,
    evaluate,
    given,
    inputs_of,
    parameters,
    wrap_number,
)
from pfd_core.kernels.ir import Code
from pfd_core.kernels.lower import joined
from pfd_core.kernels.matmul import LONGEST, PART, multiply
from pfd_core.kernels.matrices import Matrices, Matrix, widths
from pfd_core.kernels.simulate import MOTION, MOTOR_TORQUE
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.machine.program import Program

# Inputs that a `call` of a step hands over, by the name of its function.
HANDED = {'qdd': (*MOTION, 'tau'), 'undamped': (*MOTION, 'tau'), 'solve': ('q', 'tau')}
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


def linear_functions(
    step: Program,
    dynamics: Mapping[str, Program],
    substeps: int,
    dtype: str,
    angles: Sequence[int],
    periodic: bool,
) -> list[str]:
    """
    Return the module of a kernel without entry, as generate.kernel_functions, for one state.

    Parameters
    ----------
    step : Program
        An integrator's step, on n lanes, with plain sums.
    dynamics : dict
        Programs of factors, of the derivatives of the functions that it calls, by name.
    substeps : int
        Steps of the integrator.
    dtype : str
        Number format.
    angles : sequence of int
        Elements of q that are turned.
    periodic : bool
        Whether the angles enter only by sine and cosine.

    """
    n, rows = step.lanes, len(state_rows(step))
    inputs = {k: size for program in dynamics.values() for k, size in program.inputs.items()}
    signature = Program(1, (), inputs, {})
    functions = [x for name, own in dynamics.items() for x in _jacobian(name, own, dtype, angles)]
    functions += [
        linear_step(step, dynamics, dtype),
        linearisation(step, dynamics, dtype, substeps, angles if periodic else ()),
        evaluate(signature, dtype, 1, ()),
        batch(signature, dtype, 1, n * rows * (n * (rows + 1) + 1)),
        declarations(dtype, {1, *widths(dtype)}, False),
    ]
    if angles:
        functions.append(wrap_angle(ANGLE_LIMIT if periodic else WRAP_LIMIT))
    return functions


def _jacobian(name: str, factors: Program, dtype: str, angles: Sequence[int]) -> list[str]:
    """Return `void @jacobian_NAME(inputs..., qdd, out)`, and what it calls."""
    names, suffix = inputs_of(factors), f'.{name}'
    arrays = ', '.join(f'ptr %{array}' for array in (*names, 'qdd', 'out'))
    code = Code(f'define internal void @jacobian_{name}({arrays}) noinline', dtype)
    sizes = {factor: len(output.places) for factor, output in factors.outputs.items()}
    starts = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
    scratch, bytes_ = code.array(sum(sizes.values())), code.bytes
    places = [(f'%{array}', bytes_) for array in names]
    code.call('void', f'evaluate1{suffix}', *given([*places, (scratch, bytes_)]))
    X, D, T = (code.at(scratch, starts.get(factor, 0), bytes_) for factor in ('X', 'D', 'T'))
    code.call(
        'void', f'multiply1{suffix}', f'ptr {X}, ptr {D}, ptr {T}', *given([('%out', bytes_)])
    )
    for k in range(sizes['qdd']):
        code.write(code.read(scratch, starts['qdd'] + k, bytes_), '%qdd', k, bytes_)
    code.ret()
    return [
        body(joined(factors), dtype, 1, suffix, (LONGEST, PART), packed=True),
        evaluate(factors, dtype, 1, angles, suffix, check=False),
        multiply(dtype, 1, factors.inputs['q'], 'T' in sizes, suffix),
        str(code),
    ]


def linear_step(step: Program, dynamics: Mapping[str, Program], dtype: str) -> str:
    """
    Return `void @linear_step(rows..., tau, extra..., S)`: it advances the rows in place.

    Parameters
    ----------
    step : Program
        An integrator's step, on n lanes, with plain sums.
    dynamics : dict
        Lowered programs of the functions that it calls, by name.
    dtype : str
        Number format.

    S, (rows n, (rows + 1) n), is the derivative of the carried rows by themselves and by tau.
    """
    arrays = ', '.join(f'ptr %{name}' for name in (*_arguments(step, dynamics), 'S'))
    code = Code(f'define internal void @linear_step({arrays}) noinline', dtype)
    _Step(code, step, dynamics).write()
    code.ret()
    return str(code)


def _arguments(step: Program, dynamics: Mapping[str, Program]) -> tuple[str, ...]:
    """Return the arguments of @linear_step: rows of the state, the torque, other inputs."""
    own = (*carried_rows(step), COMMAND)
    extra = {name for program in dynamics.values() for name in inputs_of(program)}
    return (*own, *sorted(extra - {*own}))


class _Step:
    """Writer of @linear_step."""

    def __init__(self, code: Code, step: Program, dynamics: Mapping[str, Program]) -> None:
        self._code, self._step, self._dynamics = code, step, dynamics
        self._n = n = step.lanes
        self._inputs = (*carried_rows(step), COMMAND)
        self._m = n * len(self._inputs)
        self._matrices = Matrices(code)
        self._jacobian = self._matrices.new(n, 3 * n)
        self._given = {name: code.array(n) for name in (*MOTION, COMMAND, 'qdd')}
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
            place = self._code.at('%S', part * self._n * self._m, self._code.bytes)
            self._write_tangent(Matrix(place, self._m), self._tangents[register])
        for name in rows:
            for k, (register, _) in enumerate(self._step.outputs[name].places):
                self._code.write(self._values[register][k], f'%{name}', k, self._code.bytes)

    def _row(self, op: str, args: tuple[int, ...], data: object) -> tuple[list[str], Tangent]:
        """Return the numbers of a register and its derivative."""
        code, n = self._code, self._n
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
            return [code.constant(x) for x in data], Tangent()
        lanes = [[self._values[a][k] for a in args] for k in range(n)]
        value = [code.op(op, *lane) for lane in lanes]
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
        return [self._code.read(address, k, self._code.bytes) for k in range(self._n)]

    def _call(
        self, function: str, values: Sequence[list[str]], tangents: Sequence[Tangent]
    ) -> tuple[list[str], Tangent]:
        """Return the accelerations of a call, and their derivative, a dense matrix."""
        names = HANDED[function]
        given = dict(zip(names, values, strict=False))
        if function == 'solve':
            given['qd'] = [self._code.constant(0.0)] * self._n
        addresses = {name: f'%{name}' for name in inputs_of(self._dynamics[function])}
        for name, row in given.items():
            addresses[name] = self._given[name]
            for k, value in enumerate(row):
                self._code.write(value, self._given[name], k, self._code.bytes)
        derived = dict(zip(names, tangents, strict=False))
        if COMMAND not in given:
            derived[COMMAND] = Tangent({COMMAND: (1.0,) * self._n})
        operands = [addresses[name] for name in inputs_of(self._dynamics[function])]
        operands += [self._given['qdd'], self._jacobian.address]
        self._code.call('void', f'jacobian_{function}', *(f'ptr {x}' for x in operands))
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
        n, code = self._n, self._code
        terms = [(self._dense[call], factors) for call, factors in tangent.dense.items()]
        self._matrices.combine(out, (n, self._m), terms)
        for k, name in enumerate(self._inputs):
            for i, factor in enumerate(tangent.units.get(name, ())):
                place = code.at(out.address, i * self._m + k * n + i, code.bytes)
                value = code.op('add', code.read(place, 0, 0), code.constant(factor))
                code.write(value, place, 0, 0)


def linearisation(
    step: Program,
    dynamics: Mapping[str, Program],
    dtype: str,
    substeps: int,
    angles: Sequence[int],
) -> str:
    """
    Return `void @body1(inputs..., out)`: the derivative of the state after some substeps.

    It is that by the state before them and by the torque, with the state itself as the last
    column, (rows n, (rows + 1) n + 1). A joint that its brake holds loses its velocity first, so
    that nothing depends on that. Motors with a lag have reached the torque. Of `angles`, elements
    of q, only the part within half a turn enters the stages: a stage would round a large angle.
    The turns are added to the angle at the end.
    """
    n, rows, carried = step.lanes, state_rows(step), carried_rows(step)
    names = _arguments(step, dynamics)
    arrays = [name for name in ORDER if name in names and name not in carried[2:]]
    code = Code(f'define internal void @body1({parameters([*arrays, "out"])})', dtype)
    bytes_ = code.bytes
    own = _copied(code, names, n)
    turns = _wrap(code, own['q'], angles)
    matrices = Matrices(code)
    height, m = n * len(carried), n * (len(rows) + 1)
    once = matrices.new(height, height + n)
    arguments = [f'ptr {own[name]}' for name in names]
    total = once
    if 'qdd' in carried:
        total = _beginning(code, matrices, step, dynamics, own)
    else:
        code.call('void', 'linear_step', *arguments, f'ptr {once.address}')
    further = substeps - (total is once)
    if further:
        total, product = matrices.new(height, m), total
        ones = (1.0,) * height
        matrices.combine(total, (height, m), [(product, ones)])
        product = matrices.new(height, m)
        with code.loop(further):
            code.call('void', 'linear_step', *arguments, f'ptr {once.address}')
            matrices.combine(product, (height, m - n), [])
            matrices.combine(product.block(m - n), (height, n), [(once.block(height), ones)])
            matrices.add_products(product, (height, m), [(once, total)], height, product)
            matrices.combine(total, (height, m), [(product, ones)])
    for i in range(n * len(rows)):
        for j in range(m):
            value = code.read(total.address, i * m + j, bytes_)
            if 'free' in names and n <= j < 2 * n:
                value = _while_free(code, j - n, value)
            code.write(value, '%out', i * (m + 1) + j, '%out.s')
        part, k = divmod(i, n)
        value = code.read(own[rows[part]], k, bytes_)
        if rows[part] == 'q' and k in turns:
            value = code.op('add', value, turns[k])
        code.write(value, '%out', i * (m + 1) + m, '%out.s')
    code.ret()
    return str(code)


def _copied(code: Code, names: Sequence[str], n: int) -> dict[str, str]:
    """Return the addresses of copies of the inputs, with zero velocities of braked joints."""
    own = {}
    for name in names:
        size = 6 if name == 'wrench' else n
        own[name] = code.array(size)
        if name == 'qdd':
            continue
        source = COMMAND if name == MOTOR_TORQUE else name
        for k in range(size):
            value = code.read(f'%{source}', k, f'%{source}.s')
            if name == 'qd' and 'free' in names:
                value = _while_free(code, k, value)
            code.write(value, own[name], k, code.bytes)
    return own


def _wrap(code: Code, q: str, angles: Sequence[int]) -> dict[int, str]:
    """Wrap the angles among the positions in place; return what each of them has lost."""
    whole = {k: code.read(q, k, code.bytes) for k in angles}
    squares = code.constant(0.0)
    for x in whole.values():
        squares = code.op('fma', x, x, squares)
    limit = code.constant(ANGLE_LIMIT**2)
    with code.when(code.let(f'fcmp ugt {code.type} {squares}, {limit}'), rarely=True):
        for k in angles:
            wrap_number(code, code.at(q, k, code.bytes))
    return {k: code.op('sub', x, code.read(q, k, code.bytes)) for k, x in whole.items()}


def _beginning(
    code: Code,
    matrices: Matrices,
    step: Program,
    dynamics: Mapping[str, Program],
    own: Mapping[str, str],
) -> Matrix:
    """Write the acceleration before the first step; return the derivative of what it carries."""
    n, rows = step.lanes, state_rows(step)
    size = n * len(rows)
    result, jacobian = matrices.new(size + n, size + n), matrices.new(n, 3 * n)
    operands = [own[name] for name in inputs_of(dynamics['qdd'])]
    operands += [own['qdd'], jacobian.address]
    code.call('void', 'jacobian_qdd', *(f'ptr {address}' for address in operands))
    matrices.combine(result, (size + n, size + n), [])
    for k in range(size):
        code.write(code.constant(1.0), result.address, k * (size + n) + k, code.bytes)
    last = Matrix(code.at(result.address, size * (size + n), code.bytes), size + n)
    ones = (1.0,) * n
    matrices.combine(last, (n, 2 * n), [(jacobian, ones)])
    # The torque at the beginning is the motors', which may be a row of the state.
    torque = n * (rows.index(MOTOR_TORQUE) if MOTOR_TORQUE in rows else len(rows))
    matrices.combine(last.block(torque), (n, n), [(jacobian.block(2 * n), ones)])
    return result


def _while_free(code: Code, k: int, value: str) -> str:
    """Return a value, or zero where the brake of joint k holds it."""
    return code.choose(code.above(code.read('%free', k, '%free.s')), value, code.constant(0.0))
