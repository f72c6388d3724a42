# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long chains: the O(n) method is chosen, its kernel is cut into parts, and both are right."""

from __future__ import annotations

from typing import Any

import bridge
from bridge import (
    FEW_JOINTS,
    MANY_JOINTS,
    Optimisation,
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


def test_parts_write_results_that_are_inputs_constants_and_early_values() -> None:
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
    # A value passes from each part to the next; while it is read, another is written.
    assert all(part.program.inputs['frame'] == 2 for part in others[1:])


SLOW = pytest.mark.slow
LONG = (SLOW, pytest.mark.long)


@pytest.mark.parametrize('n', [30, *(pytest.param(n, marks=LONG) for n in (100, 200))])
def test_a_long_chain_agrees_with_pinocchio(n: int) -> None:
    rng = np.random.default_rng(n)
    kernel = pfd.compile_kernel(random_chain(rng, n))
    assert kernel.method == MANY_JOINTS
    assert '@part1.1(' in kernel.ir
    oracle = Oracle(kernel.robot)
    for _ in range(3):
        q, qd, tau = random_state(rng, n)
        tolerance = ACCELERATION * jacobi_condition(oracle.H(q))
        assert relative(kernel(q, qd, tau), oracle.qdd(q, qd, tau)) < tolerance


@pytest.mark.slow
def test_the_operations_of_the_method_for_long_chains_grow_linearly() -> None:
    counts = [
        method_cost(resolve_plant(uniform_chain_robot(n)), MANY_JOINTS) for n in (16, 24, 32)
    ]
    assert counts[2] - counts[1] == counts[1] - counts[0]


ALONE = {'use': 'step'}  # in a step, where nothing is refined
BRAKED = pfd.Scene(brakes=True)
# A robot, a scene, options, and the method and steps of refinement that they select.
SELECTED: list[tuple[pfd.Robot, pfd.Scene, Any, tuple[str, int]]] = [
    # Composite bodies for arms, articulated bodies for long chains.
    *((pfd.load_robot(name), pfd.Scene(), ALONE, (FEW_JOINTS, 0)) for name in ('ur5', 'panda')),
    (uniform_chain_robot(16), pfd.Scene(), ALONE, (MANY_JOINTS, 0)),
    (uniform_chain_robot(16), pfd.Scene(), {}, (MANY_JOINTS, 1)),
    # A requested method at any length.
    (uniform_chain_robot(20), pfd.Scene(), {'method': FEW_JOINTS}, (FEW_JOINTS, 0)),
    # Refinement of ordinary arms, and of a joint without mass that only a brake can hold.
    *(
        (pfd.load_robot(name), scene, {'refine': 1}, (FEW_JOINTS, 1))
        for name in pfd.known_robots()
        for scene in (pfd.Scene(), pfd.Scene(external_wrench=True, brakes=True))
    ),
    (without_mass(uniform_chain_robot(3), [2]), BRAKED, {'refine': 1}, (FEW_JOINTS, 1)),
    # The inertia between two joints on one axis is what is left of a diagonal of about 1: below
    # 1e-6 of it, refinement cannot correct the cancelled pivot.
    *(
        (coaxial_robot(inertia), pfd.Scene(), options, (method, options.get('refine', 0)))
        for inertia, method in ((1e-4, FEW_JOINTS), (1e-12, MANY_JOINTS), (1e-18, MANY_JOINTS))
        for options in (ALONE, {'refine': 1})
    ),
    (coaxial_robot(1e-18), pfd.Scene(), {'method': FEW_JOINTS, 'refine': 1}, (FEW_JOINTS, 1)),
]


@pytest.mark.parametrize(('robot', 'scene', 'options', 'selected'), SELECTED)
def test_the_method_follows_from_the_length_and_what_refinement_can_correct(
    robot: pfd.Robot, scene: pfd.Scene, options: Any, selected: tuple[str, int]
) -> None:
    assert select_method(resolve_plant(robot, scene), **options) == selected


@pytest.mark.parametrize('n', [8, *(pytest.param(n, marks=LONG) for n in (11, 15))])
def test_auto_counts_in_between_and_takes_the_cheaper(n: int) -> None:
    rng = np.random.default_rng(62)
    for scene in (None, pfd.Scene(armature='model')):
        plant = resolve_plant(random_chain(rng, n), scene)
        costs = {method: method_cost(plant, method) for method in (FEW_JOINTS, MANY_JOINTS)}
        method, _ = select_method(plant, use='step')
        assert costs[method] == min(costs.values())


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
