# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long chains: the O(n) method is chosen, its kernel is cut into parts, and both are right."""

from __future__ import annotations

from dataclasses import replace

import bridge
from bridge import (
    FEW_JOINTS,
    MANY_JOINTS,
    USUAL_OPTIMISATION,
    Recorder,
    coaxial_robot,
    method_cost,
    resolve_plant,
    select_method,
    split_program,
    uniform_chain_robot,
)
import numpy as np
from oracle import Oracle, assert_bits_of_the_emulator, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION
from zoo import random_chain, random_state, without_mass

import pfd_core as pfd


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


def test_a_place_of_the_frame_is_used_again_once_it_has_been_read() -> None:
    recorder = Recorder(1, 'sequential')
    x = recorder.input('q', [0])
    for _ in range(50):
        x = x * x
    recorder.output('qdd', (1,), [(x, 0)])
    parts = split_program(recorder.program(), 5)
    assert len(parts) == 10
    # A value passes from each part to the next; while it is read, another is written.
    assert parts[0].program.inputs == {'q': 1, 'frame': 2}


def test_a_result_may_be_an_input_a_constant_or_an_early_value() -> None:
    recorder = Recorder(1, 'sequential')
    q = [recorder.input('q', [k]) for k in range(2)]
    early = q[0] + q[1]
    late = early
    for _ in range(20):
        late = late * 0.5
    values = [q[1], recorder.constant(3.0), early, late]
    recorder.output('qdd', (4,), [(value, 0) for value in values])
    *others, last = split_program(recorder.program(), 4)
    written = [
        sorted(k for array, k, _ in part.writes if array == 'out') for part in (*others, last)
    ]
    assert written == [[2], [], [], [], [], [0, 1, 3]]
    for part in (*others, last):
        assert all(register < len(part.program.instructions) for *_, register in part.writes)


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_batches_of_all_lengths_and_layouts_give_the_bits_of_single_states(dtype: str) -> None:
    rng = np.random.default_rng(62)
    scene = pfd.Scene(external_wrench=True)
    kernel = pfd.compile_kernel(random_chain(rng, 3), scene=scene, dtype=dtype)
    size = 203
    q, qd, tau = (rng.normal(size=(size, 3)).astype(dtype) for _ in range(3))
    wrench = rng.normal(size=(size, 6)).astype(dtype)
    alone = np.array([kernel(q[k], qd[k], tau[k], wrench[k]) for k in range(size)])
    for count in (1, 2, 7, 16, 17, 40, size - 6, size):
        some = [np.asfortranarray(x[:count]) for x in (q, qd, tau, wrench)]
        for given in (some, [some[0], *(np.ascontiguousarray(x) for x in some[1:])]):
            for first in range(1, 18):  # whatever the alignment of the result
                out = np.full((count + 18, 3), np.nan, dtype, order='F')
                kernel(*given, out=out[first : first + count])
                np.testing.assert_array_equal(out[first : first + count], alone[:count])
                assert np.isnan(out[[*range(first), *range(first + count, count + 18)]]).all()
    some[1][count // 2, 1] = np.inf
    with pytest.raises(
        ValueError, match=rf'qd must be finite, got inf at index \[{count // 2}, 1'
    ):
        kernel(*some)


@pytest.mark.parametrize('count', [127, 128, 129, 200, 512])
@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_columns_that_evict_each_other_give_the_bits_of_single_states(
    dtype: str, count: int
) -> None:
    rng = np.random.default_rng(63)
    kernel = pfd.compile_kernel(random_chain(rng, 3), dtype=dtype)
    # Columns of two pages at least, and arrays that begin at the same place of a page.
    pages = np.empty((12, 8192 // np.dtype(dtype).itemsize), dtype)
    pages[:9] = rng.normal(size=(9, pages.shape[1]))
    q, qd, tau, out = (pages[k : k + 3].T[:count] for k in (0, 3, 6, 9))
    pages[9:] = np.nan
    assert kernel(q, qd, tau, out=out) is out
    alone = [kernel(*(x[k].copy() for x in (q, qd, tau))) for k in range(count)]
    np.testing.assert_array_equal(out, alone)
    assert np.isnan(pages[9:, count:]).all()
    tau[count // 2, 1] = np.inf
    with pytest.raises(
        ValueError, match=rf'tau must be finite, got inf at index \[{count // 2}, 1'
    ):
        kernel(q, qd, tau, out=out)


@pytest.mark.parametrize('n', [30, 60])
@pytest.mark.slow
def test_a_long_chain_agrees_with_pinocchio(n: int) -> None:
    rng = np.random.default_rng(n)
    robot = random_chain(rng, n)
    kernel = pfd.compile_kernel(robot)
    assert kernel.method == MANY_JOINTS
    check(rng, kernel)


@pytest.mark.slow
@pytest.mark.parametrize('n', [100, pytest.param(200, marks=pytest.mark.long)])
def test_a_very_long_chain_agrees_with_pinocchio(n: int) -> None:
    rng = np.random.default_rng(n)
    check(rng, pfd.compile_kernel(random_chain(rng, n)))


def check(rng: np.random.Generator, kernel: pfd.Kernel) -> None:
    oracle = Oracle(kernel.robot)
    for _ in range(3):
        q, qd, tau = random_state(rng, kernel.robot.n)
        wanted = oracle.qdd(q, qd, tau)
        tolerance = ACCELERATION * jacobi_condition(oracle.H(q))
        assert relative(kernel(q, qd, tau), wanted) < tolerance


@pytest.mark.slow
def test_the_operations_of_the_method_for_long_chains_grow_linearly() -> None:
    counts = [
        method_cost(resolve_plant(uniform_chain_robot(n)), MANY_JOINTS) for n in (16, 24, 32)
    ]
    assert counts[2] - counts[1] == counts[1] - counts[0]


def test_auto_takes_composite_bodies_for_arms_and_articulated_bodies_for_long_chains() -> None:
    for name in ('puma560', 'ur5', 'panda'):
        plant = resolve_plant(pfd.load_robot(name))
        assert select_method(plant, use='step') == (FEW_JOINTS, 0)
    long = resolve_plant(uniform_chain_robot(16))
    assert select_method(long, use='step') == (MANY_JOINTS, 0)
    assert select_method(long) == (MANY_JOINTS, 1)


@pytest.mark.parametrize('inertia', [1e-4, 1e-12, 1e-18])
def test_auto_is_articulated_bodies_where_refinement_cannot_correct_a_cancelled_pivot(
    inertia: float,
) -> None:
    # The inertia between two joints on one axis is what is left of a diagonal of about 1.
    plant = resolve_plant(coaxial_robot(inertia))
    expected = FEW_JOINTS if inertia > 1e-6 else MANY_JOINTS
    assert select_method(plant, use='step') == (expected, 0)
    assert select_method(plant, 'auto', 1) == (expected, 1)
    assert select_method(plant, FEW_JOINTS, 1) == (FEW_JOINTS, 1)


def test_auto_refines_ordinary_arms_and_massless_joints_by_composite_bodies() -> None:
    for robot in map(pfd.load_robot, pfd.known_robots()):
        everything = pfd.Scene(armature=robot.armature, external_wrench=True, brakes=True)
        for scene in (None, everything):
            plant = resolve_plant(robot, scene)
            assert select_method(plant, 'auto', 1) == (FEW_JOINTS, 1)
    held = resolve_plant(without_mass(uniform_chain_robot(3), [2]), pfd.Scene(brakes=True))
    assert select_method(held, 'auto', 1) == (FEW_JOINTS, 1)


SLOW = pytest.mark.slow
LONG = (SLOW, pytest.mark.long)


@pytest.mark.parametrize('n', [8, pytest.param(11, marks=SLOW), pytest.param(15, marks=LONG)])
def test_auto_counts_in_between_and_takes_the_cheaper(n: int) -> None:
    rng = np.random.default_rng(62)
    for scene in (None, pfd.Scene(armature='model')):
        plant = resolve_plant(random_chain(rng, n), scene)
        costs = {method: method_cost(plant, method) for method in (FEW_JOINTS, MANY_JOINTS)}
        method, _ = select_method(plant, use='step')
        assert costs[method] == min(costs.values())


def test_a_requested_method_is_used_at_any_length() -> None:
    plant = resolve_plant(uniform_chain_robot(20))
    assert select_method(plant, FEW_JOINTS) == (FEW_JOINTS, 0)
    with pytest.raises(ValueError, match=r"method must be 'auto' or one of .* got 'fastest'"):
        select_method(plant, 'fastest')


@pytest.mark.slow
def test_the_code_of_a_long_program_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PFD_CACHE', '')
    states = [random_state(np.random.default_rng(k), 7) for k in range(9)]
    emit = bridge.emit_object
    results = []
    for long in (False, True):
        usual = replace(USUAL_OPTIMISATION, long=long)
        monkeypatch.setattr(
            *bridge.target('emit_object'),
            lambda ir, target, _, usual=usual: emit(ir, target, usual),
        )
        kernel = pfd.compile_kernel(pfd.load_robot('panda'))
        batch = kernel(*(np.array(part) for part in zip(*states, strict=True)))
        results.append([batch.tobytes(), *(kernel(*state).tobytes() for state in states)])
    assert results[0] == results[1]
