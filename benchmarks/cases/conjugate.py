# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Conjugate gradients of the paper: iterations to an error, and whether a status is right.

Every iterate is observed while the emulator runs the counted program, for the residual does not
measure its error, max|x - qdd| / max|qdd| with qdd by PCRBM. Sine and cosine are expanded into the
other operations, so that iterations and errors are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.cases.problems import ROUNDING, seeded_states
from benchmarks.cases.robots import KINDS, Array, uniform_chain, varied_chain
from benchmarks.table import Row
import pfd_core as pfd
from pfd_core.dynamics.methods import FORWARD
from pfd_core.kernels.sines import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model.plant import resolve
from pfd_core.model.robot import Robot
from pfd_core.paper.composite import record_terms
from pfd_core.paper.conjugate import record_pcgm

# Iterations of PCGM to an error: joints, states of each, and errors.
SIZES, STATES = (2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 48, 64), 100
TOLERANCES = (1e-3, 1e-6, 1e-9)
WITHIN = 1e-6  # an error after n iterations that is convergence
# Chains whose statuses are checked: each kind at each number of joints, and others.
JOINTS, MORE = range(1, 13), 300
CHAINS = [
    *((n, kind, 0) for n in JOINTS for kind in KINDS),
    *((1 + k % len(JOINTS), KINDS[1], 1 + k) for k in range(MORE)),
]
ITERATIVE = 'pcgm_1987', 'pcgm'


def errors_of_iterates(
    robot: Robot, states: Mapping[str, Array], digits: int | None = None
) -> Array:
    """
    Return the errors of x_0 = 0, x_1, ... of PCGM in each state, (iterations + 1, S).

    `states` holds q, qd and tau, (S, n); after its last iteration a state keeps its error.
    """
    plant, errors = resolve(robot), list[Array]()
    # One lane per link, as in the paper.
    direct, iterative = FORWARD['pcrbm'](plant, 'parallel'), record_pcgm(plant, 'unpacked')
    wanted = _run(direct, states, digits)['qdd']

    def observe(rows: list[Any]) -> None:
        # Rows are (lanes, states), x first.
        off = np.abs(np.broadcast_to(rows[0], wanted.T.shape).T - wanted)
        errors.append(off.max(axis=-1) / np.abs(wanted).max(axis=-1))

    _run(iterative, states, digits, observe)
    return np.array(errors)


def _run(
    program: Program,
    states: Mapping[str, Array],
    digits: int | None,
    observe: Callable[[list[Any]], None] | None = None,
) -> dict[str, Any]:
    """Run a program with this project's sine, or with so many digits."""
    if digits is None:
        program = expand_sines(program, 'float64')
    return run(program, states, digits=digits, observe=observe)


def reached_by(n: int) -> list[dict[str, Any]]:
    """
    Return the iterations of PCGM until the error is within each tolerance, and errors after n.

    A median of an even number of states is the lower of the two in the middle. ArithmeticError if
    a state does not reach a tolerance.
    """
    errors = errors_of_iterates(uniform_chain(n), seeded_states(n, STATES))
    after_n, rows = np.sort(errors[min(n, len(errors) - 1)]), []
    for tolerance in TOLERANCES:
        inside = errors <= tolerance
        if not inside.any(axis=0).all():
            raise ArithmeticError(f'PCGM does not reach {tolerance} in a state of {n} joints')
        first = np.sort(inside.argmax(axis=0))
        row = {'n': n, 'median': first[(STATES - 1) // 2], 'worst': first[-1]}
        row |= {'tolerance': tolerance, 'within_n': np.mean(inside[: n + 1].any(axis=0))}
        row |= {'error_after_n': after_n[(STATES - 1) // 2], 'worst_after_n': after_n[-1]}
        rows.append(row)
    return rows


def statuses_of(
    chain: tuple[int, str, int], methods: Sequence[str] = ITERATIVE, rotors: bool = False
) -> list[dict[str, Any]]:
    """
    Return the statuses of methods on a chain, with estimated and true error.

    `allowed` is the largest error of a right answer, `rounding` the unit of rounding times the
    condition of H, scaled to ones on its diagonal. Half of the joints may have rotors of 1e-6 to
    10 kg m^2. A method that takes no such chain has no row.
    """
    n, kind, seed = chain
    robot, rng = varied_chain(*chain), np.random.default_rng([n, seed])
    unit = rng.uniform(-1.0, 1.0, (3, n))
    state = dict(zip(('q', 'qd', 'tau'), unit * [[np.pi], [1.0], [5.0]], strict=True))
    sizes = 10.0 ** rng.uniform(-6.0, 1.0, n) * (rng.random(n) < 0.5)
    scene = pfd.Scene(armature=sizes if rotors else None)
    H = run(record_terms(resolve(robot, scene), 'unpacked'), state)['H']
    scale = np.sqrt(np.diag(H))
    rounding = ROUNDING['float64'] * np.linalg.cond(H / scale / scale[:, None])
    exact = pfd.emulate(robot, **state, scene=scene, digits=50).qdd
    rows = []
    for method in methods:
        if rotors and method == 'constraint_forces':
            continue
        found = pfd.emulate(robot, **state, scene=scene, method=method)
        error = float(abs(found.qdd - exact).max() / abs(exact).max())
        row = {'kind': kind, 'n': n, 'method': method, 'status': found.status}
        row |= {'estimate': found.error, 'allowed': found.allowed}
        rows.append(row | {'error': error, 'rounding': rounding})
    return rows


def thresholds(reached: Iterable[Row], statuses: Iterable[Row]) -> dict[str, Any]:
    """
    Return the fewest joints with a state that n iterations leave with an error above WITHIN.

    Of equal links and of varied chains; 'more' if no row has one.
    """
    equal = [x['n'] for x in reached if x['worst_after_n'] > WITHIN]
    varied = [x['n'] for x in statuses if x['method'] == ITERATIVE[0] and x['error'] > WITHIN]
    return {'equal': min(equal, default='more'), 'varied': min(varied, default='more')}


def summary(statuses: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """Yield for each form how many chains are called right, and how many right ones are not."""
    for method in ITERATIVE:
        own = [x for x in statuses if x['method'] == method]
        ok = [x for x in own if x['status'] == 'ok']
        other = [x for x in own if x['status'] != 'ok']
        yield {
            'method': method,
            'chains': len(own),
            'ok': len(ok),
            'worst': max(x['error'] / x['allowed'] for x in ok),
            'error': max(x['error'] for x in ok),
            'refused': len(other),
            'right': sum(x['error'] <= x['allowed'] for x in other),
            'small': sum(x['error'] <= WITHIN for x in other),
        }
