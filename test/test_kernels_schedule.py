# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling: the same operations in a better order, and not a bit changes."""

from __future__ import annotations

import numpy as np
import pytest
from sampling import one_fast
from zoo import random_chain, random_state

import pfd_core as pfd
from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.kernels.passes.dead_code import eliminate_dead_code
from pfd_core.kernels.passes.fold import fold
from pfd_core.kernels.passes.fuse import LATENCY, fuse
from pfd_core.kernels.passes.pipeline import operations
from pfd_core.kernels.passes.schedule import (
    FREE,
    LONGEST,
    REGISTERS,
    WIDTH,
    schedule_instructions,
)
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.iteration import iterate
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import resolve

# Of the cycles that a program waits or works, at most this much is left: much of it is waiting for
# divisions, in a program that computes one link after the other.
SHARE = 0.9


def pressure(program: pfd.Program) -> list[int]:
    """Return how many computed values are alive after each instruction."""
    last: dict[int, int] = {}
    for register, instruction in enumerate(program.instructions):
        last |= dict.fromkeys(instruction.args, register)
    for output in program.outputs.values():
        last |= {register: len(program.instructions) for register, _ in output.places}
    alive: set[int] = set()
    counts = []
    for register, instruction in enumerate(program.instructions):
        alive -= {a for a in instruction.args if last[a] == register}
        if instruction.op not in FREE:
            alive.add(register)
        counts.append(len(alive))
    return counts


def in_order(program: pfd.Program) -> bool:
    """Tell whether every register is written before it is read."""
    return all(a < register for register, i in enumerate(program.instructions) for a in i.args)


def folded(name: str) -> pfd.Program:
    program = record_forward_dynamics(resolve(pfd.load_robot(name)), 'pcrbm', 'sequential')
    return eliminate_dead_code(fold(program), ['qdd'])


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda'])
def test_operations_and_bits_stay(name: str) -> None:
    program = folded(name)
    better = schedule_instructions(program)
    assert in_order(better)
    assert operations(better) == operations(program)
    assert len(better.instructions) <= len(program.instructions)
    n = program.inputs['q']
    inputs = dict(zip(('q', 'qd', 'tau'), random_state(np.random.default_rng(1), n), strict=True))
    np.testing.assert_array_equal(run(better, inputs)['qdd'], run(program, inputs)['qdd'])


def test_outputs_that_are_inputs_constants_or_negatives_are_found_again() -> None:
    recorder = Recorder(1, 'sequential')
    x, y = recorder.input('x', [0]), recorder.input('y', [0])
    values = [x, -y, recorder.constant(3.0), x * y, -(x + y), x]
    recorder.output('out', (len(values),), [(value, 0) for value in values])
    found = run(schedule_instructions(recorder.program()), {'x': [2.0], 'y': [5.0]})['out']
    np.testing.assert_array_equal(found, [2, -5, 3, 10, -7, 2])


def test_values_are_computed_when_they_are_needed() -> None:
    # The program computes 60 products first and adds them up after that.
    recorder = Recorder(1, 'sequential')
    x = [recorder.input('x', [i]) for i in range(60)]
    products = [a * a for a in x]
    total = products[0]
    for product in products[1:]:
        total = total + product
    recorder.output('out', (1,), [(total, 0)])
    program = recorder.program()
    assert max(pressure(program)) == 60
    # The next addition waits four cycles for the last one: eight products in the meantime.
    assert max(pressure(schedule_instructions(program))) <= REGISTERS + 1


def test_ready_operations_come_before_waiting_operations() -> None:
    recorder = Recorder(1, 'sequential')
    x, y = recorder.input('x', [0]), recorder.input('y', [0])
    chain = x / y
    chain = chain + x
    other = y + y
    other = other * y
    recorder.output('out', (2,), [(chain, 0), (other, 0)])
    ops = [
        i.op for i in schedule_instructions(recorder.program()).instructions if i.op not in FREE
    ]
    assert ops == ['div', 'add', 'mul', 'add']


def test_long_programs_and_loops_keep_their_order() -> None:
    def step(value: Lanes) -> tuple[tuple[Lanes], Lanes]:
        return (value * 0.5,), value - 1.0

    recorder = Recorder(1, 'sequential')
    (value,), _ = iterate(step, (recorder.input('x', [0]),), recorder.constant(1.0), 9)
    recorder.output('out', (1,), [(value, 0)])
    program = recorder.program()
    assert schedule_instructions(program) is program

    recorder = Recorder(1, 'sequential')
    value = recorder.input('x', [0])
    for _ in range(LONGEST + 1):
        value = value + value
    recorder.output('out', (1,), [(value, 0)])
    program = recorder.program()
    assert schedule_instructions(program) is program


def cycles(program: pfd.Program) -> float:
    """Return the cycles of a processor that begins WIDTH operations a cycle in their order."""
    now = 0.0
    ready: list[float] = []
    for op, args, *_ in program.instructions:
        start = max((ready[a] for a in args), default=0.0)
        if op not in FREE:
            now = start = max(now + 1 / WIDTH, start)
        ready.append(start + LATENCY.get(op, 0))
    return max(ready)


@pytest.mark.parametrize('method', one_fast(['composite_body', 'grouped_articulated_body']))
def test_a_processor_waits_less(method: str) -> None:
    skew = random_chain(np.random.default_rng(2), 6, 0.0)
    for robot in (pfd.load_robot('ur5'), pfd.load_robot('panda'), skew):
        program = record_forward_dynamics(resolve(robot), method, 'sequential')
        short = eliminate_dead_code(program, ['qdd'])
        expanded = eliminate_dead_code(fold(expand_sines(short, 'float64')))
        fused = eliminate_dead_code(fuse(expanded))
        assert cycles(schedule_instructions(fused)) < SHARE * cycles(fused)
