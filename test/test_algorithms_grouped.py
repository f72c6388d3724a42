# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The methods with grouped parameters: pivots, and counts per joint."""

from __future__ import annotations

from bridge import (
    FORWARD_METHODS,
    eliminate_dead_code,
    fold_program,
    program_operations,
    resolve_plant,
    run_program,
    uniform_chain_robot,
)
import numpy as np
from oracle import Oracle, chains, jacobi_condition
import pytest
from tolerances import ACCELERATION
from zoo import random_state

import pfd_core as pfd

METHODS = ('composite_body', 'grouped_articulated_body')
# Operations that folding may leave, sine and cosine apart: what is promised for composite bodies,
# and what throw-away prototypes of articulated bodies took.
MOST = {
    ('composite_body', 'ur5'): 582,
    ('composite_body', 'panda'): 1300,
    ('grouped_articulated_body', 'ur5'): 676,
    ('grouped_articulated_body', 'panda'): 1458,
}


@pytest.mark.parametrize('method', METHODS)
def test_pivots_multiply_to_the_determinant_of_the_inertia_matrix(method: str) -> None:
    for rng, robot in chains(12, seed=53):
        q, qd, tau = random_state(rng, robot.n)
        program = FORWARD_METHODS[method](resolve_plant(robot), 'sequential')
        pivots = run_program(program, {'q': q, 'qd': qd, 'tau': tau})['pivots']
        H = Oracle(robot).H(q)
        assert (pivots > 0).all()
        tolerance = ACCELERATION * jacobi_condition(H)
        assert abs(np.prod(pivots) / np.linalg.det(H) - 1) < tolerance


def folded(method: str, robot: pfd.Robot) -> int:
    """Return the operations that are left, changes of sign, sine and cosine apart."""
    program = eliminate_dead_code(
        fold_program(FORWARD_METHODS[method](resolve_plant(robot), 'sequential')), ['qdd']
    )
    counts = program_operations(program)
    return sum(count for op, count in counts.items() if op not in ('sin', 'cos', 'neg'))


@pytest.mark.parametrize(('method', 'name'), list(MOST))
def test_the_arms_take_no_more_operations_than_promised(method: str, name: str) -> None:
    assert folded(method, pfd.load_robot(name)) <= MOST[method, name]


def test_a_joint_more_takes_articulated_bodies_the_same_anywhere_in_the_chain() -> None:
    counts = [
        folded('grouped_articulated_body', uniform_chain_robot(n)) for n in (5, 6, 7, 12, 13)
    ]
    assert counts[1] - counts[0] == counts[2] - counts[1] == counts[4] - counts[3]
