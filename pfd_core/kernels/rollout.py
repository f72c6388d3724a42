# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a simulation in native code: an integrator's step around @evaluate, in two loops.

The step is a program recorded over one lane per joint; a register of it is one vector of n
numbers here. `call` is the only operation that is spelled in this module: it hands the row of
positions and the row of velocities to @evaluate, which knows the torque of the moment.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import dataclass
from typing import Any

from pfd_core.kernels.auto import choose
from pfd_core.kernels.engine import Native
from pfd_core.kernels.evaluate import evaluate
from pfd_core.kernels.kernel import plant_of, turned_joints
from pfd_core.kernels.llvm import Format, arguments, module, spell
from pfd_core.kernels.parts import body
from pfd_core.kernels.recipe import forward
from pfd_core.machine.program import Program
from pfd_core.model import Robot, Scene

STATE = ('q', 'qd', 'qdd')


def step(program: Program, dynamics: Program, dtype: str) -> str:
    """
    Return `void @step(q, qd, qdd, held...)`, which advances the state in place.

    Parameters
    ----------
    program : Program
        An integrator's step, parallel: inputs and outputs q, qd and qdd.
    dynamics : Program
        The lowered program that @evaluate runs.
    dtype : str
        Number format.

    """
    form = Format(dtype, program.lanes)
    lines = [f'define internal void @step({_pointers(STATE)}{_held(dynamics)}) {{']
    for name in ('at.q', 'at.qd', 'at.qdd'):
        lines.append(f'  %{name} = alloca {form.type}, align 64')
    operands: list[str] = []
    for register, instruction in enumerate(program.instructions):
        args = [operands[a] for a in instruction.args]
        if instruction.op == 'constant':
            operands.append(form.constant(instruction.data[0]))
            continue
        operands.append(f'%v{register}')
        if instruction.op == 'call':
            lines += [
                f'  store {form.type} {args[0]}, ptr %at.q, align 64',
                f'  store {form.type} {args[1]}, ptr %at.qd, align 64',
                f'  call void @evaluate(ptr %at.q, ptr %at.qd{_held(dynamics)}, ptr %at.qdd)',
                f'  %v{register} = load {form.type}, ptr %at.qdd, align 64',
            ]
        else:
            lines += spell(instruction, register, args, form)
    for name, (_, places) in program.outputs.items():
        value = operands[places[0][0]]
        lines.append(f'  store {form.type} {value}, ptr %{name}, align {form.bytes}')
    return '\n'.join([*lines, '  ret void', '}'])


def rollout(dynamics: Program, dtype: str) -> str:
    """
    Return `i64 @rollout(steps, substeps, q, qd, qdd, taus, held..., out.q, out.qd, out.qdd)`.

    Each of `steps` steps holds one row of `taus` for `substeps` calls of @step, and writes the
    state it reaches. Joints whose element of `free` is zero are stopped first. The result is
    the number of steps after which the state was finite.
    """
    n = dynamics.inputs['q']
    form = Format(dtype, n)
    T, S, align = form.type, form.scalar, form.bytes
    call = f'ptr %q, ptr %qd{_held(dynamics)}'
    rows = [
        f'  %{name}.row = getelementptr {S}, ptr %out.{name}, i64 %offset\n'
        f'  %{name}.x = load {T}, ptr %{name}, align {align}\n'
        f'  store {T} %{name}.x, ptr %{name}.row, align {align}'
        for name in STATE
    ]
    stop = ''
    if 'free' in dynamics.inputs:
        stop = f"""
  %free.x = load {T}, ptr %free, align {align}
  %moves = fcmp ogt {T} %free.x, {form.constant(0.0)}
  %qd.held = load {T}, ptr %qd, align {align}
  %qd.free = select {form.flag} %moves, {T} %qd.held, {T} {form.constant(0.0)}
  store {T} %qd.free, ptr %qd, align {align}"""
    parameters = ', '.join(
        [
            'i64 %steps, i64 %substeps',
            _pointers(STATE),
            f'ptr %taus{_held(dynamics, tau=False)}',
            _pointers(tuple(f'out.{name}' for name in STATE)),
        ]
    )
    return f"""define i64 @rollout({parameters}) {{
entry:
  br label %outer
outer:
  %t = phi i64 [ 0, %entry ], [ %t.next, %finished ]
  %sound = phi i64 [ 0, %entry ], [ %sound.next, %finished ]
  %offset = mul i64 %t, {n}
  %tau = getelementptr {S}, ptr %taus, i64 %offset{stop}
  call void @evaluate({call}, ptr %qdd)
  br label %inner
inner:
  %s = phi i64 [ 0, %outer ], [ %s.next, %inner ]
  call void @step({_pointers(STATE)}{_held(dynamics)})
  %s.next = add i64 %s, 1
  %s.more = icmp ult i64 %s.next, %substeps
  br i1 %s.more, label %inner, label %finished
finished:
{chr(10).join(rows)}
  %odd.q = fsub {T} %q.x, %q.x
  %odd.qd = fsub {T} %qd.x, %qd.x
  %odd.qdd = fsub {T} %qdd.x, %qdd.x
  %odd.0 = fadd {T} %odd.q, %odd.qd
  %odd.1 = fadd {T} %odd.0, %odd.qdd
  %nan = fcmp uno {T} %odd.1, %odd.1
  %bad = {_any(form)}
  %in.order = icmp eq i64 %sound, %t
  %good = xor i1 %bad, true
  %counts = and i1 %in.order, %good
  %one = zext i1 %counts to i64
  %sound.next = add i64 %sound, %one
  %t.next = add i64 %t, 1
  %t.more = icmp ult i64 %t.next, %steps
  br i1 %t.more, label %outer, label %done
done:
  ret i64 %sound.next
}}"""


def _any(form: Format) -> str:
    if form.width == 1:
        return 'or i1 %nan, false'
    return f'call i1 @llvm.vector.reduce.or.v{form.width}i1({form.flag} %nan)'


def _pointers(names: tuple[str, ...]) -> str:
    return ', '.join(f'ptr %{name}' for name in names)


def _held(dynamics: Program, tau: bool = True) -> str:
    """Return what @evaluate takes besides q and qd, as arguments that follow others."""
    names = [name for name in arguments(dynamics) if name not in ('q', 'qd')]
    return ''.join(f', ptr %{name}' for name in names if tau or name != 'tau')


@dataclass(frozen=True)
class Rollout:
    """
    A simulation in native code.

    Attributes
    ----------
    run : callable
        The function that `rollout` describes; pointers are addresses.
    native : Native
        The code, which lives as long as this.
    method : str
        The text it was recorded from.

    """

    run: Callable[..., int]
    native: Native
    method: str


def compile_rollout(
    robot: Robot, step_program: Program, *, scene: Scene, method: str, dtype: str, refine: int
) -> Rollout:
    """Compile the simulation of a robot by an integrator's step; errors as compile_kernel."""
    plant, scene = plant_of(robot, scene, dtype)
    method = choose(plant, method, refine)
    recipe = forward(plant, method, refine, dtype)

    def text() -> str:
        dynamics, angles, form = recipe.program, turned_joints(robot), Format(dtype, 1)
        parts = [
            body(dynamics, form),
            evaluate(dynamics, form, angles),
            step(step_program, dynamics, dtype),
            rollout(dynamics, dtype),
        ]
        return module(parts, dtype, [robot.n], angles)

    native = recipe.compile(f'rollout {step_program}', text)
    pointers: list[Any] = [ctypes.c_void_p] * (2 * len(STATE) + len(recipe.inputs) - 2)
    signature = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, *pointers)
    return Rollout(signature(native.address('rollout')), native, method)
