# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Iterations of conjugate gradients: to rounding, and to an error of qdd from cold and warm starts.

The paper counts n iterations, which exact arithmetic needs at most. In double precision a state
has converged when its recursive residual has fallen to the first one times TOLERANCE of
pfd_core.algorithms.paper.pcgm, which is rounding. The residual does not measure the error of an
iterate, max|x - qdd| / max|qdd| with qdd by PCRBM: every iterate is observed while the emulator
runs the counted program. Sine and cosine are expanded into the other operations, so that
iterations and errors are the same on every machine.

    plain       the paper's: x_0 = 0, no preconditioner
    scaled      residuals divided by the diagonal of H, which composite bodies give (Jacobi)
    warm        x_0 is qdd one cycle of CYCLE earlier, at q - qd CYCLE, qd - qdd CYCLE, same torque
    both        scaled, from the warm start
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.cases.paper import CORRECTED, KINDS, Recording, flat, program_of
from benchmarks.cases.problems import seeded_states
from benchmarks.cases.robots import Array, uniform_chain
from benchmarks.timing import differences
from pfd_core.algorithms.paper.pcgm import default_limit, record_pcgm
from pfd_core.algorithms.programs import FORWARD
from pfd_core.kernels.sines import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Robot, resolve

# Robots of which iterations to rounding are counted, and states of each.
CHAINS, ARMS, STATES = (2, 3, 4, 5, 6, 8, 12, 16, 24), ('puma560', 'ur5', 'panda'), 1000
# Iterations of PCGM to an error: joints, states, and errors.
SIZES, FEWER_STATES = (2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 48, 64), 100
TOLERANCES = (1e-3, 1e-6, 1e-9)
CYCLE = 1e-3  # age of a warm start [s]
# Whether residuals are scaled by the diagonal of H, and whether the start is warm.
VARIANTS = {
    'plain': (False, False),
    'scaled': (True, False),
    'warm': (False, True),
    'both': (True, True),
}


def _answer(program: Program, states: dict[str, Array], **how: Any) -> dict[str, Array]:
    return run(expand_sines(program, 'float64'), states, **how)


def convergence(method: str, robot: Robot, states: int = STATES) -> dict[str, Any]:
    """Return iterations to rounding over many states; RuntimeError if one does not converge."""
    plant, n = resolve(robot), robot.n
    given = seeded_states(n, states)
    wanted = _answer(FORWARD['pcrbm'](plant, 'parallel'), given)['qdd']
    whole = _answer(FORWARD[method](plant, 'parallel'), given)
    if not (whole['converged'] > 0).all():
        raise RuntimeError(f'{method} did not converge in some state of {robot.name}')
    short = _answer(FORWARD[method](plant, 'parallel', at_most=n), given)['qdd']
    after_n = np.sort(differences(short, wanted))
    iterations = np.sort(whole['iterations'].ravel()).astype(int)
    middle = (states - 1) // 2
    return {
        'system': method,
        'robot': robot.name,
        'n': n,
        'states': states,
        'least': int(iterations[0]),
        'median': int(iterations[middle]),
        'most': int(iterations[-1]),
        'error_after_n': after_n[middle],
        'worst_after_n': after_n[-1],
        'worst_converged': differences(whole['qdd'], wanted).max(),
    }


def errors_of_iterates(n: int, variant: str, states: dict[str, Array]) -> Array:
    """
    Return the errors of x_0, x_1, ... of each state, (iterations + 1, states).

    `states` holds q, qd and tau, (states, n); after its last iteration a state keeps its error.
    """
    direct = FORWARD['pcrbm'](resolve(uniform_chain(n)), 'parallel')
    wanted = _answer(direct, states)['qdd']
    inputs = dict(states)
    if VARIANTS[variant][1]:
        before = {'q': -CYCLE * states['qd'], 'qd': -CYCLE * wanted, 'tau': 0.0}
        inputs['start'] = _answer(direct, {key: states[key] + before[key] for key in before})[
            'qdd'
        ]
    errors: list[Array] = []

    def observe(rows: list[Any]) -> None:
        # Rows are (lanes, states), x first.
        errors.append(differences(np.broadcast_to(rows[0], wanted.T.shape).T, wanted))

    _answer(pcgm_variant(n, variant), inputs, observe=observe)
    return np.array(errors)


def pcgm_variant(n: int, variant: str) -> Program:
    """Return PCGM with one lane per link, as in the paper."""
    scaled, warm = VARIANTS[variant]
    return record_pcgm(resolve(uniform_chain(n)), 'unpacked', start=warm, jacobi=scaled)


def reached_by(n: int) -> list[dict[str, Any]]:
    """
    Return the iterations of each variant until the error is within each tolerance.

    `missed` states do not reach it, and count with the largest number of iterations. The cost of
    `in_n`, `in_median` and `in_worst` iterations is [multiplications, additions, square roots].
    """
    states, middle = seeded_states(n, FEWER_STATES), (FEWER_STATES - 1) // 2
    rows = []
    for variant in VARIANTS:
        errors, cost = errors_of_iterates(n, variant, states), price(n, variant)
        after_n = np.sort(errors[min(n, len(errors) - 1)])
        for tolerance in TOLERANCES:
            inside = errors <= tolerance
            missed = ~inside.any(axis=0)
            first = np.sort(np.where(missed, default_limit(n), inside.argmax(axis=0)))
            counts = {'n': n, 'median': int(first[middle]), 'worst': int(first[-1])}
            rows.append(
                {
                    **counts,
                    'variant': variant,
                    'tolerance': tolerance,
                    'missed': missed.sum(),
                    'within_n': np.mean(inside[: n + 1].any(axis=0)),
                    'error_after_n': after_n[middle],
                    'worst_after_n': after_n[-1],
                    **{
                        f'in_{name}': [cost[f'first_{x}'] + k * cost[f'each_{x}'] for x in KINDS]
                        for name, k in counts.items()
                    },
                }
            )
    return rows


def price(n: int, variant: str) -> dict[str, Any]:
    """Return the steps of a variant: `pcgm_1987`, and what the variant adds to it."""
    program = program_of(Recording('pcgm', n, CORRECTED, 'unpacked'))
    once, twice = (program.count(iterations=k) for k in (1, 2))
    if variant != 'plain':
        # The same sections in both, so that the rotations of the joints cancel.
        plain, changed = (pcgm_variant(n, name) for name in ('plain', variant))
        once += changed.count(iterations=1) - plain.count(iterations=1)
        twice += changed.count(iterations=2) - plain.count(iterations=2)
    repeated = twice - once
    first = flat('first_', once - repeated)
    return {'n': n, 'variant': variant, **first, **flat('each_', repeated)}
