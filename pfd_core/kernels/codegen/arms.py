# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of many simulations at once: one arm per SIMD lane, all steps in native code.

    @step        an integrator's step for `width` arms (pfd_core.kernels.codegen.step)
    @arms        all steps of `width` arms, with the torque that their law gives at each
    @ensemble    a block of arms

The torque of a step is taken from an array, to which a law may add what the state at its beginning
asks for (pfd_core.kernels.codegen.law); it is held for the step. Every operation on an arm
is one that the simulation of a single arm does, in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pfd_core.kernels.codegen.law import (
    GAINS,
    JOINTS,
    MATRIX,
    NONE,
    REFERENCES,
    errors,
    joint_by_joint,
)
from pfd_core.kernels.codegen.spelling import Format, arguments, splat
from pfd_core.kernels.codegen.step import (
    REPORT,
    STATE,
    finite,
    goes_on,
    held,
    pointers,
    stop,
)
from pfd_core.machine.program import Program

# One row of the table for each of these: pointer, and strides from arm to arm, from element to
# element and from step to step [bytes].
SLOTS = (
    *REPORT,
    'tau',
    'wrench',
    'free',
    *GAINS,
    MATRIX,
    *REFERENCES,
    *(f'{name}.out' for name in REPORT),
)
# Arms `first` to `until` - 1; `last` is the last of all arms; the others are those of @arms.
PARAMETERS = (
    *('i64 %first', 'i64 %until', 'i64 %last', 'i64 %steps', 'i64 %substeps', 'i64 %every'),
    *('i64 %law', 'ptr %table', 'ptr %sound'),
)


def arms(program: Program, dynamics: Program, form: Format) -> str:
    """
    Return `void @arms(b, last, steps, substeps, every, law, table, sound)`.

    It runs arms b to b + width - 1, of which those beyond `last` repeat it. `table` holds what
    SLOTS says; each `every`-th state is written, with its acceleration. `sound`, one number per
    arm, receives after how many steps the arm's state was finite.
    """
    n, W = dynamics.inputs['q'], form.width
    constant = [name for name in arguments(dynamics) if name in ('wrench', 'free')]
    evaluation = f'  call void @evaluate({pointers(STATE)}{held(dynamics)}, ptr %qdd)'
    lines = [
        'define internal void @arms(i64 %b, i64 %last, i64 %steps, i64 %substeps, i64 %every, '
        'i64 %law, ptr %table, ptr %sound) {',
        *_prepare(n, constant, form),
        'outer:',
        '  %t = phi i64 [ 0, %start ], [ %t.next, %counted ]',
        '  %row = phi i64 [ 0, %start ], [ %row.next, %counted ]',
        '  %wait = phi i64 [ 1, %start ], [ %wait.next, %counted ]',
        f'  %good = phi <{W} x i64> [ zeroinitializer, %start ], [ %good.next, %counted ]',
        *_torque(n, form),
        *(line for k in range(n) if 'free' in constant for line in stop(k, form)),
        *([evaluation] if goes_on(program) else []),
        '  br label %inner',
        'inner:',
        '  %s = phi i64 [ 0, %torque ], [ %s.next, %inner ]',
        f'  call void @step({pointers(REPORT)}{held(dynamics)})',
        '  %s.next = add i64 %s, 1',
        '  %s.more = icmp ult i64 %s.next, %substeps',
        '  br i1 %s.more, label %inner, label %finished',
        'finished:',
        *_count(n, form),
        '  %t.next = add i64 %t, 1',
        '  %t.more = icmp ult i64 %t.next, %steps',
        *_write_row(n, evaluation),
        '  br i1 %t.more, label %outer, label %done',
        'done:',
        *(_copied(False, name, n) for name in REPORT),
        *_report(W),
        '  ret void',
        '}',
    ]
    return '\n'.join(lines)


def _prepare(n: int, constant: Sequence[str], form: Format) -> Iterator[str]:
    """Yield the entry: the table is read, and what stays the same for all steps."""
    yield 'entry:'
    yield f'  %lanes = alloca <{form.width} x i64>, align 64'
    yield f'  %error = alloca [{2 * n} x {form.type}], align 64'
    yield f'  %end = add i64 %b, {form.width - 1}'
    yield '  %whole = icmp ule i64 %end, %last'
    sizes = {name: 6 if name == 'wrench' else n for name in SLOTS}
    for slot, name in enumerate(SLOTS):
        yield from _slot(slot, name, sizes[name], form)
    for name in (*STATE, *constant):
        yield _copied(True, name, sizes[name])
    yield f'  %follows = icmp ne i64 %law, {NONE}'
    yield f'  %joints = icmp eq i64 %law, {JOINTS}'
    yield '  br i1 %joints, label %gains, label %start'
    yield 'gains:'
    for name in GAINS:
        yield _copied(True, name, n)
    yield '  br label %start'
    yield 'start:'
    yield '  br label %outer'


def _torque(n: int, form: Format) -> Iterator[str]:
    """Yield the lines that find the torques of a step."""
    yield from _at('tau', 't')
    yield _copied(True, 'tau', n, 'tau.now')
    yield '  br i1 %follows, label %follow, label %torque'
    yield 'follow:'
    for name in REFERENCES:
        yield from _at(name, 't')
        yield _copied(True, name, n, f'{name}.now')
    yield from errors(n, form)
    yield '  br i1 %joints, label %each, label %all'
    yield 'each:'
    yield from joint_by_joint(n, form)
    yield '  br label %torque'
    yield 'all:'
    yield from _at(MATRIX, 't')
    yield (
        f'  call void @whole_state(ptr %tau, ptr %error, ptr %{MATRIX}.now, i64 %{MATRIX}.arm, '
        f'i64 %{MATRIX}.column, i64 %b, i64 %last)'
    )
    yield '  br label %torque'
    yield 'torque:'


def _write_row(n: int, evaluation: str) -> Iterator[str]:
    """Yield the lines that write the state after every so many steps, and find the last."""
    yield '  %due = icmp eq i64 %wait, %every'
    yield '  %final = xor i1 %t.more, true'
    yield '  %told = or i1 %due, %final'
    yield '  br i1 %told, label %tell, label %counted'
    yield 'tell:'
    yield evaluation
    yield '  br i1 %due, label %write, label %counted'
    yield 'write:'
    for name in REPORT:
        yield from _at(f'{name}.out', 'row')
        yield _copied(False, f'{name}.out', n, f'{name}.out.now', buffer=name)
    yield '  br label %counted'
    yield 'counted:'
    yield '  %one = zext i1 %due to i64'
    yield '  %row.next = add i64 %row, %one'
    yield '  %later = add i64 %wait, 1'
    yield '  %wait.next = select i1 %due, i64 1, i64 %later'


def _report(width: int) -> Iterator[str]:
    """Yield the lines that say of each arm there is after how many steps it was finite."""
    yield f'  store <{width} x i64> %good.next, ptr %lanes, align 64'
    yield '  br label %lane'
    yield 'lane:'
    yield '  %i = phi i64 [ 0, %done ], [ %i.next, %kept ]'
    yield '  %arm = add i64 %b, %i'
    yield '  %there = icmp ule i64 %arm, %last'
    yield '  br i1 %there, label %keep, label %kept'
    yield 'keep:'
    yield '  %i.at = getelementptr i64, ptr %lanes, i64 %i'
    yield '  %i.good = load i64, ptr %i.at'
    yield '  %arm.at = getelementptr i64, ptr %sound, i64 %arm'
    yield '  store i64 %i.good, ptr %arm.at'
    yield '  br label %kept'
    yield 'kept:'
    yield '  %i.next = add i64 %i, 1'
    yield f'  %i.more = icmp ult i64 %i.next, {width}'
    yield '  br i1 %i.more, label %lane, label %out'
    yield 'out:'


def _slot(slot: int, name: str, size: int, form: Format) -> Iterator[str]:
    """Yield the lines that read one row of the table and make room for `width` arms."""
    if name != MATRIX and not name.endswith('.out'):
        yield f'  %{name} = alloca [{size} x {form.type}], align 64'
    for column, part in enumerate(('base', 'arm', 'column', 'step')):
        kind = 'ptr' if part == 'base' else 'i64'
        yield f'  %{name}.{part}.at = getelementptr i64, ptr %table, i64 {4 * slot + column}'
        yield f'  %{name}.{part} = load {kind}, ptr %{name}.{part}.at'


def _at(name: str, index: str) -> tuple[str, str]:
    """Return the lines that leave the address of a step's rows in `name`.now."""
    return (
        f'  %{name}.far = mul i64 %{index}, %{name}.step',
        f'  %{name}.now = getelementptr i8, ptr %{name}.base, i64 %{name}.far',
    )


def _copied(
    inward: bool, name: str, size: int, base: str | None = None, buffer: str | None = None
) -> str:
    way = 'copy_in' if inward else 'copy_out'
    return (
        f'  call void @{way}(i1 false, ptr %{buffer or name}, ptr %{base or name + ".base"}, '
        f'i64 %{name}.arm, i64 %{name}.column, i64 %b, i1 %whole, i64 %last, i64 {size})'
    )


def _count(n: int, form: Format) -> Iterator[str]:
    """Yield the lines that count a step for those arms that have been finite up to its end."""
    W = form.width
    yield from finite(n, form)
    yield splat('t', W)
    yield f'  %in.order = icmp eq <{W} x i64> %good, %t.all'
    yield f'  %counts = and {form.flag} %in.order, %finite'
    yield f'  %more = zext {form.flag} %counts to <{W} x i64>'
    yield f'  %good.next = add <{W} x i64> %good, %more'


def ensemble(form: Format) -> str:
    """Return `void @ensemble` of PARAMETERS, which runs @arms on a block of arms."""
    return f"""define void @ensemble({', '.join(PARAMETERS)}) {{
entry:
  br label %rows
rows:
  %b = phi i64 [ %first, %entry ], [ %b.next, %rows ]
  call void @arms(i64 %b, i64 %last, i64 %steps, i64 %substeps, i64 %every, i64 %law, ptr %table, \
ptr %sound)
  %b.next = add i64 %b, {form.width}
  %more = icmp ult i64 %b.next, %until
  br i1 %more, label %rows, label %done
done:
  ret void
}}"""
