# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of an integrator's step around @evaluate.

The step is a program recorded over one lane per joint. Each lane is a separate value here,
which holds one number, or one for each of `width` arms: numbers that are written one by one and
read as a vector would have to reach the cache first, which takes longer than the operations of
the step.

The state is a list of named rows of one number per joint: MOTION, and a row for each effect that
has further state (`further_rows`). An integrator's program names them by its outputs; they
begin at zero, and are carried on from step to step, but not reported.

The step's `call` of qdd hands positions and velocities to @evaluate, and torques that change
within the step. Its `call` of solve
hands positions and torques at rest to @evaluate_solve, and of undamped its state to
@evaluate_undamped.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.machine.program import Program

# The rows of the state that every simulation has, and the arrays that it reports.
MOTION = ('q', 'qd')
REPORT = (*MOTION, 'qdd')

# Inputs that a `call` hands over, by the name of its function; the step holds the others. The
# torque is handed over where it changes within a step.
HANDED = {'qdd': (*MOTION, 'tau'), 'undamped': (*MOTION, 'tau'), 'solve': ('q', 'tau')}
# A loop that its condition ends.
ENDLESS = 2**63 - 1
# The row of the state that is the torque, where motors lag behind the commanded one.
MOTOR_TORQUE = 'tau_motor'


def step(
    program: Program,
    dynamics: Program,
    form: Format,
    others: Mapping[str, Program] = MappingProxyType({}),
) -> str:
    """
    Return `void @step(q, qd, qdd, further..., extra...)`: it advances `width` arms in place.

    Parameters
    ----------
    program : Program
        An integrator's step, parallel: inputs and outputs are the rows of the state, and qdd
        where a step begins with the acceleration that the one before ended with.
    dynamics : Program
        The lowered program that @evaluate runs.
    form : Format
        Number format and width.
    others : dict
        Lowered programs of the other functions that the step calls, by name.

    """
    n = program.lanes
    names = _arguments(program, dynamics)
    ir = Function(f'define internal void @step({pointers(f"%{name}" for name in names)})')
    arrays = {name: f'%{name}' for name in names}
    local = (*REPORT, 'tau') if torque_row(program) == MOTOR_TORQUE else REPORT
    own = arrays | {name: ir.array(form.type, n) for name in local}
    rest = own
    if 'solve' in others:
        rest = own | {name: ir.array(form.type, n) for name in ('qd', 'tau')}
        for k in range(n):
            form.write(ir, Array(rest['qd']), k, form.zero)
    values: list[list[str]] = []
    for op, args, data, *_ in program.instructions:
        operands = [values[a] for a in args]
        if op == 'call':
            buffers = rest if data == 'solve' else own
            for k in range(n):
                for name, value in zip(HANDED[data], operands, strict=False):
                    form.write(ir, Array(buffers[name]), k, value[k])
            if data in others:
                evaluate_at(ir, others[data], buffers, f'_{data}')
            else:
                evaluate_at(ir, dynamics, buffers)
            values.append([form.read(ir, Array(own['qdd']), k) for k in range(n)])
        elif op == 'input':
            values.append([form.read(ir, Array(arrays[name]), k) for name, k in data])
        else:
            lanes = [[value[k] for value in operands] for k in range(n)]
            values.append(
                [
                    form.constant(data[k]) if op == 'constant' else form.operation(ir, op, lane)
                    for k, lane in enumerate(lanes)
                ]
            )
    for name, (_, places) in program.outputs.items():
        for k, (register, _) in enumerate(places):
            form.write(ir, Array(arrays[name]), k, values[register][k])
    ir.ret()
    return str(ir)


def further_rows(program: Program) -> tuple[str, ...]:
    """Return the rows of the state other than MOTION that an integrator's program advances."""
    return tuple(name for name in program.outputs if name not in REPORT)


def torque_row(program: Program) -> str:
    """Return the row or input that is the torque at the beginning and the end of a step."""
    return MOTOR_TORQUE if MOTOR_TORQUE in program.outputs else 'tau'


def _arguments(program: Program, dynamics: Program) -> tuple[str, ...]:
    return *REPORT, *further_rows(program), *extra_arguments(dynamics)


def begins_with_acceleration(program: Program) -> bool:
    """Return whether a step reads the acceleration at its beginning, which is then passed on."""
    return 'qdd' in program.inputs


def extra_arguments(dynamics: Program) -> list[str]:
    """Return the arguments of @evaluate after q and qd."""
    return [name for name in arguments(dynamics) if name not in MOTION]


def pointers(addresses: Iterable[str]) -> str:
    """Return addresses as parameters or, spelled alike, as arguments."""
    return ', '.join(f'ptr {address}' for address in addresses)


def evaluate_at_end(
    ir: Function, program: Program, dynamics: Program, arrays: Mapping[str, str]
) -> None:
    """Write qdd of a state between two steps."""
    evaluate_at(ir, dynamics, {**arrays, 'tau': arrays[torque_row(program)]})


def evaluate_at(
    ir: Function, dynamics: Program, arrays: Mapping[str, str], suffix: str = ''
) -> None:
    """Write qdd of a state, each array given by its address."""
    names = (*arguments(dynamics), 'qdd')
    ir.call('void', f'evaluate{suffix}', pointers(arrays[name] for name in names))


def take_steps(
    ir: Function, substeps: str, program: Program, dynamics: Program, arrays: Mapping[str, str]
) -> None:
    """
    Advance a state by a number of steps under one torque.

    The number is read from memory, at the address `substeps`, after each step: a caller in another
    thread ends the loop by writing 0. The load is atomic: LLVM leaves the value that an ordinary
    or volatile load has in a race undefined or up to the target.
    """
    if begins_with_acceleration(program):
        evaluate_at_end(ir, program, dynamics, arrays)
    more = Variable('i1', 'true')
    with ir.loop(ENDLESS, condition=more) as k:
        names = _arguments(program, dynamics)
        ir.call('void', 'step', pointers(arrays[name] for name in names))
        count = ir.let(f'load atomic i64, ptr {substeps} monotonic, align 8')
        taken = ir.let(f'add i64 {k}, 1')
        more.value = ir.let(f'icmp ult i64 {taken}, {count}')


def brake(dynamics: Mapping[str, Program], form: Format) -> str:
    """
    Return `void @brake(q, qd, free)`: it brings braked joints to rest, by impulses of the brakes.

    A payload that is an input is its fourth argument.

    H v = H qd + p, v = 0 and p any where a joint is braked, p = 0 elsewhere. An arm whose braked
    joints are at rest keeps its velocities. `dynamics` are the lowered programs of
    @evaluate_momentum, H qdd, and @evaluate_inertial, H^-1 tau of the free joints.
    """
    given = ['q', 'qd', 'free', *(['payload'] * ('payload' in arguments(dynamics['inertial'])))]
    ir = Function(f'define internal void @brake({pointers(f"%{name}" for name in given)})')
    n, T = dynamics['inertial'].inputs['q'], form.type
    moves = ''
    for k in range(n):
        free, velocity = (form.read(ir, Array(name), k) for name in ('%free', '%qd'))
        braked = ir.let(f'fcmp ole {T} {free}, {form.zero}')
        moving = ir.let(f'fcmp une {T} {velocity}, {form.zero}')
        flag = ir.let(f'and {form.flag} {braked}, {moving}')
        moves = ir.let(f'or {form.flag} {moves}, {flag}') if moves else flag
    with ir.when(form.any(ir, moves), rarely=True):
        still, load, after = (ir.array(T, n) for _ in range(3))
        for k in range(n):
            form.write(ir, Array(still), k, form.zero)
        places = {**{name: f'%{name}' for name in given}, 'qd': still}
        for name, own, result in (
            ('momentum', {'qdd': '%qd'}, load),
            ('inertial', {'tau': load}, after),
        ):
            found = {**places, **own}
            names = arguments(dynamics[name])
            ir.call('void', f'evaluate_{name}', pointers([*(found[x] for x in names), result]))
        for k in range(n):
            free, old, new = (form.read(ir, Array(x), k) for x in ('%free', '%qd', after))
            goes = ir.let(f'fcmp ogt {T} {free}, {form.zero}')
            new = form.select(ir, goes, new, form.zero)
            form.write(ir, Array('%qd'), k, form.select(ir, moves, new, old))
    ir.ret()
    return str(ir)


def close_brakes(ir: Function, arrays: Mapping[str, str]) -> None:
    """Bring braked joints to rest before a step."""
    given = [name for name in ('q', 'qd', 'free', 'payload') if name in arrays]
    ir.call('void', 'brake', pointers(arrays[name] for name in given))


def count_finite(
    ir: Function, finite_steps: Variable, t: str, arrays: Mapping[str, str], n: int, form: Format
) -> dict[str, list[str]]:
    """
    Count step t for each of `width` arms whose state has been finite up to its end.

    Returns the values of MOTION, which are read for that. Other rows are not looked at: they
    reach the motion in the next step.
    """
    state = {name: [form.read(ir, Array(arrays[name]), k) for k in range(n)] for name in MOTION}
    nonfinite = form.not_finite(ir, [value for values in state.values() for value in values])
    finite = ir.let(f'fcmp ord {form.type} {nonfinite}, {nonfinite}')
    so_far = ir.let(f'icmp eq {form.index} {finite_steps}, {form.splat(ir, t)}')
    counts = ir.let(f'and {form.flag} {so_far}, {finite}')
    one = ir.let(f'zext {form.flag} {counts} to {form.index}')
    finite_steps.value = ir.let(f'add {form.index} {finite_steps}, {one}')
    return state
