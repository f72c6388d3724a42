# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A program made shorter, and its code in parts: what each pass keeps, and what it saves."""

from __future__ import annotations

import bridge
from bridge import (
    Optimisation,
    Recorder,
    can_be_ordered,
    eliminate_dead_code,
    fold_program,
    fuse_program,
    lower_program,
    program_operations,
    run_program,
    schedule_program,
)
import numpy as np
from oracle import assert_bits_of_the_emulator
import pytest
from sampling import one_fast
from zoo import random_chain, random_state

import pfd_core as pfd

SEEDS = one_fast(range(12))
NUMBERS = (0.0, 1.0, -1.0, 2.0, -2.0, 0.5, 0.25, 3.0, -0.7)


def random_program(seed: int, results: int = 8) -> pfd.Program:
    """Return sums, products, quotients, roots and selections of inputs and constants."""
    rng = np.random.default_rng(seed)
    recorder = Recorder(1, 'sequential')
    values = [recorder.input('x', [k]) for k in range(6)]
    values += [recorder.constant(number) for number in NUMBERS]
    arity = {'add': 2, 'sub': 2, 'mul': 2, 'neg': 1, 'select': 3, 'div': 2, 'sqrt': 1}
    for op in rng.choice(list(arity), 300, p=[0.2, 0.2, 0.35, 0.1, 0.05, 0.05, 0.05]):
        operands = [values[k] for k in rng.integers(len(values), size=arity[op])]
        if op in ('div', 'sqrt'):
            # At least 1, so that nothing overflows or is not a number.
            operands[-1] = operands[-1] * operands[-1] + 1.0
        value = recorder.apply(op, *operands)
        # Products of many factors stay small.
        values.append(recorder.apply('div', value, value * value + 1.0) if op == 'mul' else value)
    recorder.output('y', (results,), [(value, 0) for value in values[-results:]])
    return recorder.program()


def result(program: pfd.Program) -> np.ndarray:
    """Return the results at some states; there is one zero."""
    x = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    return run_program(program, {'x': x[:, : program.inputs['x']]})['y'] + 0.0


def work(program: pfd.Program) -> int:
    """Return the number of operations, changes of sign apart."""
    return sum(n for op, n in program_operations(program).items() if op != 'neg')


@pytest.mark.parametrize('seed', SEEDS)
def test_folding_keeps_every_bit_and_saves_operations(seed: int) -> None:
    program = eliminate_dead_code(random_program(seed))
    folded = eliminate_dead_code(fold_program(program))
    assert np.isfinite(result(program)).all()
    assert result(folded).tobytes() == result(program).tobytes()
    assert work(folded) < work(program)


@pytest.mark.parametrize('seed', SEEDS)
def test_fusing_keeps_values_but_for_roundings_and_saves_operations(seed: int) -> None:
    program = eliminate_dead_code(fold_program(random_program(seed)))
    fused = eliminate_dead_code(fuse_program(program))
    counts, before = program_operations(fused), program_operations(program)
    assert work(program) - work(fused) == before['mul'] - counts.get('mul', 0) > 0
    x = np.random.default_rng(1).uniform(-2.0, 2.0, 6)[: program.inputs['x']]
    one, other = (run_program(p, {'x': x}, digits=60)['y'] for p in (program, fused))
    assert max(abs(one - other)) < 1e-50


@pytest.mark.parametrize('seed', SEEDS)
def test_an_order_keeps_every_bit_and_operation(seed: int) -> None:
    program = eliminate_dead_code(fuse_program(fold_program(random_program(seed))))
    ordered = schedule_program(program)
    assert can_be_ordered(program)
    assert ordered.instructions != program.instructions
    assert program_operations(ordered) == program_operations(program)
    assert result(ordered).tobytes() == result(program).tobytes()


def test_a_result_that_is_not_wanted_costs_nothing() -> None:
    recorder = Recorder(1, 'sequential')
    x = recorder.input('x', [0])
    for name, value in (('y', x * x), ('z', x / 3.0)):
        recorder.output(name, (1,), [(value, 0)])
    program = recorder.program()
    assert program_operations(lower_program(program, 'float64', ['y']).compiled) == {'mul': 1}
    with pytest.raises(ValueError, match=r"outputs must name one of \['y', 'z'\], got \['w'\]"):
        lower_program(program, 'float64', ['w'])


def test_a_parallel_program_is_refused() -> None:
    recorder = Recorder(2)
    recorder.output('y', (1,), [(recorder.input('x', [0, 1]), 0)])
    with pytest.raises(ValueError, match='recorded must be a sequential program, got 2 lanes'):
        lower_program(recorder.program(), 'float64')


# ---- code in parts ----


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> None:
    # Kernels on disk do not depend on where they were cut.
    monkeypatch.setenv('PFD_CACHE', '')
    monkeypatch.setattr(*bridge.target('GENERATE_LONGEST'), 0)
    monkeypatch.setattr(*bridge.target('GENERATE_PART'), 37)


@pytest.mark.usefixtures('cut')
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('method', ['composite_body', 'grouped_articulated_body', 'pcgm'])
@pytest.mark.slow
def test_a_kernel_in_parts_gives_the_emulators_bits(method: str, dtype: str) -> None:
    rng = np.random.default_rng(61)
    scene = pfd.Scene(external_wrench=True, brakes=True, armature='model')
    kernel = pfd.compile_kernel(random_chain(rng, 4), method=method, scene=scene, dtype=dtype)
    # A loop is never cut.
    assert ('@part1.1(' in kernel.ir) == (method != 'pcgm')
    assert_bits_of_the_emulator(kernel, rng)


@pytest.mark.slow
def test_the_code_of_a_long_program_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PFD_CACHE', '')
    states = [random_state(np.random.default_rng(k), 7) for k in range(9)]
    emit = bridge.emit_object
    results = []
    for long in (False, True):
        usual = Optimisation(long=long)
        monkeypatch.setattr(
            *bridge.target('emit_object'),
            lambda ir, target, _, usual=usual: emit(ir, target, usual),
        )
        kernel = pfd.compile_kernel(pfd.load_robot('panda'))
        batch = kernel(*(np.array(part) for part in zip(*states, strict=True)))
        results.append([batch.tobytes(), *(kernel(*state).tobytes() for state in states)])
    assert results[0] == results[1]
