# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics whose linear system the triangular array solves: its pivots and its counts.

Its physics is tested with that of all methods in test_algorithms_methods.
"""

from __future__ import annotations

from closed_forms import SIZES
import numpy as np
from oracle import Oracle, jacobi_condition, relative
import pytest
from tolerances import ACCELERATION
from zoo import random_chain, random_state, without_mass

import pfd_core as pfd
from pfd_core.algorithms.paper.pcrbm_array import SECTION
from pfd_core.algorithms.programs import FORWARD
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.machine.emulator import run
from pfd_core.model import resolve


@pytest.mark.parametrize('digits', [None, 30])
def test_an_arm_without_inertia_shows_in_the_pivots(digits: int | None) -> None:
    robot = without_mass(random_chain(np.random.default_rng(24), 3), range(3))
    inputs = {name: np.ones(3) for name in ('q', 'qd', 'tau')}
    found = run(FORWARD['pcrbm_array'](resolve(robot), 'parallel'), inputs, digits=digits)
    assert not (found['pivots'].astype(float) > 0).any()
    assert not np.isfinite(found['qdd'].astype(float)).any()


@pytest.mark.parametrize(
    ('n', 'schedule'),
    [*((n, 'parallel') for n in SIZES), *((n, 'sequential') for n in (1, 2, 6, 12))],
)
def test_the_cells_do_a_cholesky_solve_and_the_lanes_pcrbm_and_ne1(n: int, schedule: str) -> None:
    plant = resolve(random_chain(np.random.default_rng(n), n, 0.0))
    work = (n**3 - n) // 6 + n * (n - 1)
    program = FORWARD['pcrbm_array'](plant, schedule)
    cells, whole = program.count(section=SECTION), program.count()
    assert cells == pfd.Steps(work, work, n * (n - 1) // 2 + 2 * n, n)
    # Beside the cells all of PCRBM but its own solve.
    pcrbm = FORWARD['pcrbm'](plant, schedule)
    solve = [pcrbm.count(section=section) for section in ('factorisation', 'column sweep')]
    for kind in ('multiplications', 'additions', 'divisions'):
        rest = getattr(pcrbm.count(), kind) - sum(getattr(part, kind) for part in solve)
        assert getattr(whole, kind) == rest + getattr(cells, kind)
    streams = program.count(section=f'streams of the {SECTION}').routes
    elements = n * (n + 1) // 2 + n
    # h_11 and y_1 are on lane 0 anyway.
    assert streams == (elements - 2 if schedule == 'parallel' else 0)


@pytest.mark.parametrize('n', [1, 2, 6])
def test_the_sequential_program_can_be_lowered_and_keeps_its_answer(n: int) -> None:
    rng = np.random.default_rng(n)
    robot = random_chain(rng, n)
    plant = resolve(robot, pfd.Scene(brakes=True, external_wrench=True))
    program = FORWARD['pcrbm_array'](plant, 'sequential')
    short = lower(program, 'float64', ['qdd']).compiled
    q, qd, tau = random_state(rng, n)
    inputs = {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6), 'free': np.ones(n)}
    found = run(short, inputs)['qdd']
    # Sines of the kernel are its own, within two units of rounding of the library's.
    H = Oracle(robot).H(q)
    assert relative(found, run(program, inputs)['qdd']) < ACCELERATION * jacobi_condition(H)
    assert len(short.instructions) > n
