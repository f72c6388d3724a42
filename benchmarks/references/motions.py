# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Ends of hard motions in extended precision: `python -m benchmarks.references.motions [NAME ...]`.

They are written into data/motion_references.yaml. A macro step of H seconds is taken with 1, 2,
..., k substeps by a method of low order, and the k ends are extrapolated to substeps of no length
(Hairer, Norsett, Wanner, Solving Ordinary Differential Equations, II.9 and IV.9):

    midpoint   modified midpoint in 2 j substeps, k = 12 in 34 digits: order 24
    implicit   (M + h D) (v' - v) = h (tau - bias - D v), q' = q + h v', in j substeps, k = 20 in
               50 digits: order 20 for strong damping D
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
import yaml

from benchmarks.cases.motions import ENDS, HARD, Motion
from benchmarks.table import HERE, stored_text, write_text
from pfd_core.algorithms.programs import record_terms
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model import Plant
from pfd_core.model.effects import INERTIA, JOINTS, LINKS, MOTORS

Numbers = NDArray[Any]
# State (2, n) at the end of a macro step from state, length and number of substeps.
Substeps = Callable[[Numbers, Any, int], Numbers]
# Digits that are stored.
STORED = 25
# Macro steps of the second computation, as a part of the first one's.
FEWER = 0.75


def computed(motion: Motion) -> dict[str, Any]:
    """Return the end of a motion as ENDS stores it."""
    import mpmath

    fine, coarse = (end(motion, steps)[0] for steps in (motion.steps, int(FEWER * motion.steps)))
    return {
        'self_difference': float(f'{float(max(abs(fine - coarse))):.1e}'),
        'q': [mpmath.nstr(angle, STORED, strip_zeros=False) for angle in fine],
    }


def end(motion: Motion, steps: int, columns: int | None = None) -> Numbers:
    """Return q and qd, (2, n) of mpmath.mpf, at the end of a motion without torques."""
    import mpmath

    scheme, power, most, digits = SCHEMES[motion.scheme]
    counts = [power * j for j in range(1, (columns or most) + 1)]
    length = Fraction(motion.duration) / steps
    # The first macro step may be halved, again and again.
    halved = [length / 2**k for k in range(motion.halvings, 0, -1)]
    lengths = [*(halved[:1] + halved or [length]), *[length] * (steps - 1)]
    with mpmath.workdps(digits):
        substeps = scheme(motion.plant, digits)
        state: Numbers = np.vectorize(mpmath.mpf, otypes=[object])([motion.q, motion.qd])
        for length in lengths:
            H, row = mpmath.mpf(length.numerator) / length.denominator, list[Numbers]()
            # Extrapolate to substeps of no length, for errors in powers of (1 / count)^power.
            for j, count in enumerate(counts):
                following = [substeps(state, H, count)]
                for k in range(1, j + 1):
                    ratio = mpmath.mpf(count**power) / counts[j - k] ** power
                    off = following[k - 1] - row[k - 1]
                    following.append(following[k - 1] + off / (ratio - 1))
                row = following
            state = row[-1]
    return state


def _midpoint(plant: Plant, digits: int) -> Substeps:
    program = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    torques = np.zeros(plant.robot.n)

    def slope(state: Numbers) -> Any:
        given = {'q': state[0], 'qd': state[1], 'tau': torques}
        return np.array([state[1], run(program, given, digits=digits)['qdd']])

    def substeps(state: Numbers, H: Any, count: int) -> Numbers:
        h = H / count
        before, at = state, state + h * slope(state)
        for _ in range(count - 1):
            before, at = at, before + 2 * h * slope(at)
        end: Numbers = at
        return end

    return substeps


def _implicit(plant: Plant, digits: int) -> Substeps:
    import mpmath

    if plant.viscosity is None:
        raise ValueError('an implicit reference is for a scene with damping')
    damping = plant.viscosity.astype(object)
    program = record_terms(plant.only(LINKS, INERTIA, JOINTS, MOTORS), 'sequential')

    def substeps(state: Numbers, H: Any, count: int) -> Numbers:
        h, (q, qd) = H / count, state
        for _ in range(count):
            terms = run(program, {'q': q, 'qd': qd}, digits=digits)
            matrix = terms['H'] + np.diag(h * damping)
            force = -terms['bias'] - damping * qd
            change = mpmath.lu_solve(mpmath.matrix(matrix.tolist()), mpmath.matrix(force.tolist()))
            qd = qd + h * np.array(list(change))
            q = q + h * qd
        return np.array([q, qd])

    return substeps


# Of a scheme: its substeps, the power of the length in which errors fall, columns and digits.
SCHEMES = {'midpoint': (_midpoint, 2, 12, 34), 'implicit': (_implicit, 1, 20, 50)}


def main(names: Sequence[str]) -> None:
    """Compute the ends of the named motions, or of all; the others are kept."""
    found = dict(ENDS)
    for motion in HARD:
        if not names or motion.name in names:
            found[motion.name] = computed(motion)
            print(motion.name, found[motion.name]['self_difference'], flush=True)
    head = stored_text('motion_references.yaml').partition('\n\n')[0]
    rows = {motion.name: found[motion.name] for motion in HARD if motion.name in found}
    text = yaml.safe_dump(rows, sort_keys=False)
    write_text(HERE / 'data', 'motion_references.yaml', f'{head}\n\n{text}')


if __name__ == '__main__':
    main(sys.argv[1:])
