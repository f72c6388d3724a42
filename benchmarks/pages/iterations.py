# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Iterations of conjugate gradients: to rounding, and to an error of qdd from cold and warm starts.

The paper counts n iterations, which exact arithmetic needs at most. In double precision a state
has converged when its recursive residual has fallen to rounding. The residual does not measure the
error of an iterate, max|x - qdd| / max|qdd| with qdd by PCRBM: every iterate is observed while the
emulator runs the counted program. Sine and cosine are expanded into the other operations, so that
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
from pfd_core.dynamics.methods import FORWARD
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


def _middle(values: Array) -> Array:
    """Return the median, for an even number the lower of the two in the middle."""
    return np.asarray(np.sort(values)[(len(values) - 1) // 2])


def convergence(method: str, robot: Robot, states: int = STATES) -> dict[str, Any]:
    """Return iterations to rounding over many states; RuntimeError if one does not converge."""
    plant, given = resolve(robot), seeded_states(robot.n, states)
    wanted = _answer(FORWARD['pcrbm'](plant, 'parallel'), given)['qdd']
    whole = _answer(FORWARD[method](plant, 'parallel'), given)
    if not (whole['converged'] > 0).all():
        raise RuntimeError(f'{method} did not converge in some state of {robot.name}')
    short = _answer(FORWARD[method](plant, 'parallel', at_most=robot.n), given)['qdd']
    after_n, iterations = differences(short, wanted), whole['iterations'].ravel()
    return {
        'system': method,
        'robot': robot.name,
        'n': robot.n,
        'states': states,
        'least': int(iterations.min()),
        'median': int(_middle(iterations)),
        'most': int(iterations.max()),
        'error_after_n': _middle(after_n),
        'worst_after_n': after_n.max(),
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
        earlier = {key: states[key] + change for key, change in before.items()}
        inputs['start'] = _answer(direct, earlier)['qdd']
    errors: list[Array] = []

    def observe(rows: list[Any]) -> None:
        # Rows are (lanes, states), x first.
        errors.append(differences(np.broadcast_to(rows[0], wanted.T.shape).T, wanted))

    _answer(_variant(n, variant), inputs, observe=observe)
    return np.array(errors)


def _variant(n: int, variant: str) -> Program:
    """Return PCGM with one lane per link, as in the paper."""
    scaled, warm = VARIANTS[variant]
    return record_pcgm(resolve(uniform_chain(n)), 'unpacked', start=warm, jacobi=scaled)


def reached_by(n: int) -> list[dict[str, Any]]:
    """
    Return the iterations of each variant until the error is within each tolerance.

    `missed` states do not reach it, and count with the largest number of iterations. The cost of
    `in_n`, `in_median` and `in_worst` iterations is [multiplications, additions, square roots].
    """
    states, rows = seeded_states(n, FEWER_STATES), []
    for variant in VARIANTS:
        errors, cost = errors_of_iterates(n, variant, states), price(n, variant)
        after_n = errors[min(n, len(errors) - 1)]
        for tolerance in TOLERANCES:
            inside = errors <= tolerance
            missed = ~inside.any(axis=0)
            first = np.where(missed, default_limit(n), inside.argmax(axis=0))
            counts = {'n': n, 'median': int(_middle(first)), 'worst': int(first.max())}
            row = {
                'variant': variant,
                'tolerance': tolerance,
                'missed': missed.sum(),
                'within_n': np.mean(inside[: n + 1].any(axis=0)),
                'error_after_n': _middle(after_n),
                'worst_after_n': after_n.max(),
            }
            for name, k in counts.items():
                row[f'in_{name}'] = [cost[f'first_{x}'] + k * cost[f'each_{x}'] for x in KINDS]
            rows.append(counts | row)
    return rows


def price(n: int, variant: str) -> dict[str, int]:
    """Return the steps of a variant: `pcgm_1987`, and what the variant adds to it."""
    program = program_of(Recording('pcgm', n, CORRECTED, 'unpacked'))
    # The same sections in both, so that the rotations of the joints cancel.
    plain, changed = (_variant(n, name) for name in ('plain', variant))
    once, twice = (
        program.count(iterations=k) + changed.count(iterations=k) - plain.count(iterations=k)
        for k in (1, 2)
    )
    each = twice - once
    return flat('first_', once - each) | flat('each_', each)
