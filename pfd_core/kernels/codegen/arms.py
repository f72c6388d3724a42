# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of many simulations at once: one arm per SIMD lane, all steps in native code.

    @step        an integrator's step for `width` arms (pfd_core.kernels.codegen.step)
    @arms        all steps of `width` arms, with the torque that their law gives at each
    @ensemble    a block of arms

The torque of a step is taken from an array, to which a law may add a feedback of the state at its
beginning (pfd_core.kernels.codegen.law); it is constant over the step. Every operation on an arm
is one that the simulation of a single arm does, in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_core.kernels.codegen.batch import table_row
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.copies import Block, Rows, copy
from pfd_core.kernels.codegen.law import (
    GAINS,
    JOINTS,
    MATRIX,
    NONE,
    REFERENCES,
    WHOLE,
    joint_by_joint,
    state_errors,
)
from pfd_core.kernels.codegen.spelling import Array, Format
from pfd_core.kernels.codegen.step import (
    MOTION,
    REPORT,
    close_brakes,
    count_finite,
    evaluate_at_end,
    extra_arguments,
    further_rows,
    take_steps,
)
from pfd_core.machine.program import Program

# One row of the table for each of these, then for each further row of the state: pointer, and
# strides from arm to arm, from element to element and from step to step [bytes].
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
# Parameters of @arms except its first arm.
COMMON = (
    *('i64 %last', 'i64 %steps', 'ptr %substeps', 'i64 %every', 'i64 %law', 'ptr %table'),
    'ptr %finite_steps',
)
# Parameters of @ensemble, which runs the arms `first` to `until` - 1.
PARAMETERS = ('i64 %first', 'i64 %until', *COMMON)


@dataclass(frozen=True)
class _Slot:
    """One row of the table: an array, with one row for each arm and a buffer for `width` arms."""

    rows: Rows
    step: str  # bytes from step to step
    size: int  # elements of an arm at one step
    buffer: str  # its address; empty for an array that is used in place

    def at(self, ir: Function, step: str) -> Rows:
        """Return the rows of one step."""
        base = ir.offset(self.rows.base, step, self.step)
        return Rows(base, self.rows.row, self.rows.column)


def arms(program: Program, dynamics: Program, form: Format) -> str:
    """
    Return `void @arms(b, last, steps, substeps, every, law, table, finite_steps)`.

    It runs arms b to b + width - 1; arms beyond `last` repeat arm `last`. `table` holds one row
    for each of SLOTS and of the further rows of the state; each `every`-th state is written, with
    its acceleration. `substeps` points to the number of calls of @step in a step. `finite_steps`,
    one number per arm, receives the number of steps after which the arm's state was finite.
    """
    n, W = dynamics.inputs['q'], form.width
    ir = Function(f'define internal void @arms({", ".join(("i64 %b", *COMMON))})')
    end = ir.let(f'add i64 %b, {W - 1}')
    block = Block('%b', '%last', ir.let(f'icmp ule i64 {end}, %last'))
    further = further_rows(program)
    slots = {name: _slot(ir, name, k, n, form) for k, name in enumerate((*SLOTS, *further))}
    arrays = {name: slot.buffer for name, slot in slots.items()}
    constant = [name for name in extra_arguments(dynamics) if name != 'tau']
    for name in (*MOTION, *further, *constant):
        copy(ir, 'in', slots[name].rows, arrays[name], slots[name].size, block)
    joints = ir.let(f'icmp eq i64 %law, {JOINTS}')
    with ir.when(joints):
        for name in GAINS:
            copy(ir, 'in', slots[name].rows, arrays[name], n, block)
    final = ir.let('sub i64 %steps, 1')
    row, wait = Variable('i64', '0'), Variable('i64', '1')
    finite_steps = Variable(form.index, 'zeroinitializer')
    with ir.loop('%steps', row, wait, finite_steps) as t:
        _torque(ir, slots, t, joints, block, form)
        if 'free' in constant:
            close_brakes(ir, arrays)
        take_steps(ir, '%substeps', program, dynamics, arrays)
        count_finite(ir, finite_steps, t, arrays, n, form)
        due = ir.let(f'icmp eq i64 {wait}, %every')
        ends = ir.let(f'icmp eq i64 {t}, {final}')
        with ir.when(ir.let(f'or i1 {due}, {ends}')):
            evaluate_at_end(ir, program, dynamics, arrays)
            with ir.when(due):
                for name in REPORT:
                    copy(ir, 'out', slots[f'{name}.out'].at(ir, row.value), arrays[name], n, block)
        one = ir.let(f'zext i1 {due} to i64')
        row.value = ir.let(f'add i64 {row}, {one}')
        later = ir.let(f'add i64 {wait}, 1')
        wait.value = ir.let(f'select i1 {due}, i64 1, i64 {later}')
    for name in (*REPORT, *further):
        copy(ir, 'out', slots[name].rows, arrays[name], n, block)
    _report(ir, finite_steps, W)
    ir.ret()
    return str(ir)


def _slot(ir: Function, name: str, k: int, n: int, form: Format) -> _Slot:
    """Read one row of the table and allocate arrays for `width` arms."""
    base, arm, column, step = table_row(ir, k, 4)
    size = 6 if name == 'wrench' else n
    in_place = name == MATRIX or name.endswith('.out')
    buffer = '' if in_place else ir.array(form.type, size)
    return _Slot(Rows(base, arm, column), step, size, buffer)


def _torque(
    ir: Function, slots: dict[str, _Slot], t: str, joints: str, block: Block, form: Format
) -> None:
    """Write the torques of a step: given torques plus feedback."""
    n = slots['tau'].size
    arrays = {name: Array(slot.buffer) for name, slot in slots.items()}
    copy(ir, 'in', slots['tau'].at(ir, t), slots['tau'].buffer, n, block)
    with ir.when(ir.let(f'icmp ne i64 %law, {NONE}')):
        for name in REFERENCES:
            copy(ir, 'in', slots[name].at(ir, t), slots[name].buffer, n, block)
        errors = state_errors(ir, arrays, n, form)
        with ir.when(joints):
            joint_by_joint(ir, arrays, errors, n, form)
        with ir.when(ir.let(f'icmp eq i64 %law, {WHOLE}')):
            error = Array(ir.array(form.type, 2 * n))
            for k, value in enumerate(errors):
                form.write(ir, error, k, value)
            gain = slots[MATRIX].at(ir, t)
            ir.call(
                'void',
                'whole_state',
                f'{arrays["tau"]}, {error}, ptr {gain.base}, i64 {gain.row}, i64 {gain.column}',
                'i64 %b, i64 %last',
            )


def _report(ir: Function, finite_steps: Variable, width: int) -> None:
    """Write `finite_steps` of the arms of this block, except those beyond the last."""
    lanes = ir.array('i64', width)
    ir.store(finite_steps.kind, finite_steps, lanes, 8)
    with ir.loop(width) as lane:
        arm = ir.let(f'add i64 %b, {lane}')
        with ir.when(ir.let(f'icmp ule i64 {arm}, %last')):
            count = ir.load('i64', ir.element('i64', lanes, lane))
            ir.store('i64', count, ir.element('i64', '%finite_steps', arm))


def ensemble(form: Format) -> str:
    """Return `void @ensemble` of PARAMETERS, which runs @arms on a block of arms."""
    ir = Function(f'define void @ensemble({", ".join(PARAMETERS)})')
    with ir.loop('%until', start='%first', step=form.width) as b:
        ir.call('void', 'arms', f'i64 {b}', *COMMON)
    ir.ret()
    return str(ir)
