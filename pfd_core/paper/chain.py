# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain on n lanes.

    R_i   = Rz(q_i) A_i (rotational), A_i (translational)
    0R_i  = 0R_(i-1) R_i                                     eq. (13), FOHRA
    z_i-1 = third column of 0R_(i-1), z_0 = (0, 0, 1)        step 2, eq. (14)
    p*_i  = 0R_i (A_i' a_i)  [+ q_i z_(i-1), translational]
    s_i   = 0R_i s_i (link axes),  J_i = 0R_i J_i (link axes) 0R_i'

Lee and Chang 1987, section 2.5, steps 1 and 2. Base axes are the axes of frame 0. Lane i holds
joint and link i + 1 (the paper counts from 1): the link's frame and inertia, its joint's axis and
component i + 1 of every vector of n numbers.

Parallel cost, L = ceil(log2 n): 12 multiplications and 6 additions for R_i, which the paper takes
as given; 3 r and 2 r for the recurrence, whose levels k = 0 .. L - 1 pack 9 (n - 2^k) elements of
matrices onto n lanes, r rounds in all: at n = 6 that is 51 and 34 with 160 routes, where 27 L and
18 L with 27 routes would do without packing (81 and 54) and the paper prints 27 L - 19 = 62 and
18 L - 14 = 40, without routes; 63 and 42 for the vectors. A prismatic joint anywhere in the chain
adds 3 and 3.

The paper's counts hold for twists of 0 and 90 degrees, and its form takes them for these: five of
nine elements of R_i are then 0, 1 or -1, and R_(i-1) R_i takes at most 8 and 4, or 4 and 0 if both
twists are right angles. The paper does not say so, but a first level at this price gives item (a),
27 L - 19 and 18 L - 14. One component of p*_i is zero, so that (14) takes 60 and 39. The zero
elements differ from joint to joint. The k-th products of all processors, of whatever elements, are
one step, and so are the k-th additions: (13) takes 27 (L - 1) + m multiplications and
18 (L - 1) + a additions, m and a the most that a pair of neighbours needs; 9 L routes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product as cartesian
from operator import add, matmul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.lanes import cos, merge, on, sin
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, constants, rotated_symmetric
from pfd_core.model.geometry import product
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot
from pfd_core.model.values import Array
from pfd_core.paper import patterns
from pfd_core.paper.editions import OURS, Edition
from pfd_core.paper.lanes import collect, recorder_of, shift, taken

Structure = NDArray[np.float64]  # (n, 3, 3): 0, 1 or -1 where an element is known to be, else NaN
Element = tuple[int, int]
NINE: Sequence[Element] = tuple(cartesian(range(3), range(3)))


@dataclass(frozen=True)
class Chain:
    """A chain at the input q, on n lanes; vectors are in base axes."""

    recorder: Recorder
    plant: Plant
    rotational: tuple[int, ...]  # lanes of these joints
    translational: tuple[int, ...]
    m: Lanes  # masses [kg]
    R: LaneArray  # (3, 3), 0R_i
    z: LaneArray  # (3,), z_(i-1), the axis of joint i
    p_star: LaneArray  # (3,), from the origin of frame i-1 to the origin of frame i [m]
    s: LaneArray  # (3,), from there to the centre of mass [m]
    J: LaneArray  # (6,), inertia about the centre of mass [kg m^2]

    @property
    def rotors(self) -> Lanes | None:
        """The inertia of the rotors [kg m^2 or kg], if the scene has any."""
        inertia = self.plant.inertia
        return None if inertia is None else self.recorder.constant(inertia)

    def by_kind(self, turning: Any, sliding: Any) -> Any:
        """Return `turning` on the lanes of rotational joints and `sliding` on the others."""
        if not self.translational:
            return turning
        if not self.rotational:
            return sliding
        return merge(on(sliding, self.translational), turning)


def chain_on_lanes(plant: Plant, schedule: str, edition: Edition = OURS) -> Chain:
    """Return the chain of a plant, on a new recorder of n lanes."""
    robot = plant.robot
    recorder = Recorder(robot.n, schedule)
    A, a, s, J = link_parameters(robot, keep_tip=plant.external_wrench)
    offsets = np.array([product(A[i].T, a[i]) for i in range(robot.n)])
    # The paper's counts suppose twists of 0 and 90 degrees.
    square = bool(np.isin(robot.rotations, (-1.0, 0.0, 1.0)).all())
    squares = square and edition.printed and recorder.parallel
    known = structure_of(A, robot.turning)
    A = rows(recorder, A)
    m, s, J = recorder.constant(robot.masses), rows(recorder, s), rows(recorder, J)
    turning, sliding = (tuple(np.flatnonzero(x).tolist()) for x in (robot.turning, ~robot.turning))
    q = recorder.input_row('q')
    with recorder.section('joint rotation'):
        R = A
        if turning:
            angle = on(q, turning)
            cosine, sine = cos(angle), sin(angle)
            R = array([cosine * A[0] - sine * A[1], sine * A[0] + cosine * A[1], A[2]])
            R = array(merge(R, A))
    with recorder.section('orientation'):
        if squares:
            R = product_of_right_angles(R, known)
        else:
            R = patterns.product(R, packs=not edition.printed)
    with recorder.section('link vectors'):
        z = merge(shift(R[:, 2], 1), constants(recorder, [0.0, 0.0, 1.0]))
        p_star = times_known(R, offsets) if squares else R @ rows(recorder, offsets)
        if sliding:
            p_star = merge(p_star + z * on(q, sliding), p_star)
        s, J = R @ s, rotated_symmetric(R, J)
    return Chain(recorder, plant, turning, sliding, m, R, z, p_star, s, J)


def link_parameters(robot: Robot, keep_tip: bool) -> tuple[Array, Array, Array, Array]:
    """
    Return A, (n, 3, 3), a and s, (n, 3), and the different elements of J, (n, 6), of the links.

    Only an external wrench refers to the tip's frame. If it need not be kept, frame n is laid on
    the last joint's axis, where its offset and rotation vanish.
    """
    A, a, s, J = robot.rotations, robot.translations, robot.centers, robot.inertias
    if not keep_tip:
        A, a, s, J = A.copy(), a.copy(), s.copy(), J.copy()
        s[-1] = a[-1] + product(A[-1], s[-1])
        J[-1] = product(A[-1], J[-1], A[-1].T)
        A[-1], a[-1] = np.eye(3), 0.0
    return A, a, s, np.stack([J[:, i, k] for i, k in UPPER], axis=1)


def rows(recorder: Recorder, values: Array) -> LaneArray:
    """Return constants of the links, (n, *shape), as an array of that shape over lanes."""
    flat = [recorder.constant(row) for row in values.reshape(len(values), -1).T]
    return array(flat).reshape(values.shape[1:])


def gravity_torques(chain: Chain, model: Plant) -> list[Lanes]:
    """
    Return the torques that hold a model at rest at the input q, [N m or N], as one row.

        M_i   = sum of m_j, j >= i                       mass of links i..n, a constant
        h_i   = sum of m_j s_j + M_j p*_j, j >= i        their first moment about o_(i-1)
        tau_i = a . (z_(i-1) x h_i)  (rotational),  M_i a . z_(i-1)  (translational),  a = -g

    The model has the joints of the chain. First moments add up: no force and no moment has to be
    carried along the chain. Parallel cost, rotational joints, gravity along an axis of the base: 9
    multiplications and 3 L + 4 additions, and 9 and 6 more for a model with other centres of mass.
    """
    recorder, z = chain.recorder, chain.z
    masses, s = chain.m, chain.s
    if model.robot != chain.plant.robot:
        _, _, centers, _ = link_parameters(model.robot, keep_tip=chain.plant.external_wrench)
        masses = recorder.constant(model.robot.masses)
        s = chain.R @ rows(recorder, centers)
    carried = recorder.constant(np.cumsum(model.robot.masses[::-1])[::-1])
    h = patterns.suffix(add, masses * s + carried * chain.p_star)

    def along_gravity(component: Callable[[int, int, int], Lanes]) -> Any:
        """Return a . v for components v_k; i, j, k follow each other in a turn."""
        turns = [(g, ((k + 1) % 3, (k + 2) % 3, k)) for k, g in enumerate(model.gravity.tolist())]
        return sum((-g * component(*turn) for g, turn in turns if g), 0.0)

    tau = along_gravity(lambda i, j, k: z[i] * h[j] - z[j] * h[i])
    if chain.translational:
        lifted = on(carried, chain.translational) * z
        tau = merge(along_gravity(lambda i, j, k: lifted[k]), tau)
    return [tau]


# Twists of 0 and 90 degrees.


def structure_of(A: Array, turning: NDArray[np.bool_]) -> Structure:
    """Return the elements of R_i that are known at all joint positions, from A_i, (n, 3, 3)."""
    known = np.array(A, np.float64)
    sines = ~((A[:, :1] == 0) & (A[:, 1:2] == 0))  # a column with a sine and a cosine
    known[:, :2][np.broadcast_to(sines & turning[:, None, None], (len(A), 2, 3))] = np.nan
    return known


def product_of_right_angles(R: LaneArray, structure: Structure) -> LaneArray:
    """Return the products R(0) R(1) .. R(i), (3, 3), on lane i; R has the known elements."""
    for k, sources in enumerate(patterns.levels(recorder_of(R), downward=False)):
        left = taken(R, sources)
        R = merge(_first_level(left, R, structure) if k == 0 else matmul(left, R), R)
    return array(R)


def times_known(R: LaneArray, vectors: Array) -> LaneArray:
    """Return R v of constants v, (n, 3): each lane leaves out the products by its zeros."""
    recorder = recorder_of(R)
    result = constants(recorder, [0.0] * 3)
    tasks = {i: [int(c) for c in np.flatnonzero(v)] for i, v in enumerate(vectors)}
    for k, columns in enumerate(_side_by_side(tasks)):
        v = on(recorder.constant([vectors[i, columns.get(i, 0)] for i in tasks]), columns)
        terms = array([collect({i: R[r, c] for i, c in columns.items()}) * v for r in range(3)])
        result = array(merge(result + terms if k else terms, result))
    return result


def _first_level(left: LaneArray, right: LaneArray, structure: Structure) -> LaneArray:
    """Return R_(i-1) R_i on the lanes from 1 on; every element stays on its lane."""
    lanes = range(1, len(structure))
    terms = {i: {e: list(_terms(structure[i - 1], structure[i], e)) for e in NINE} for i in lanes}
    sides = {'left': left, '-left': -left, 'right': right, '-right': -right}
    values = {(side, e): X[e] for side, X in sides.items() for e in NINE}
    products: dict[Any, Lanes] = {}

    def value(i: int, term: Any) -> Lanes:
        return values[term] if term in values else products[i, term]

    tasks = {i: [t for own in terms[i].values() for t in own if t not in values] for i in lanes}
    for step in _side_by_side(tasks):
        row = collect({i: left[a] for i, (_, a, _) in step.items()}) * collect(
            {i: right[b] for i, (_, _, b) in step.items()}
        )
        products |= dict.fromkeys(step.items(), row)
    zero = left[0, 0].recorder.constant(0.0)
    sums = {
        (i, e): value(i, own[0]) if own else zero for i in lanes for e, own in terms[i].items()
    }
    more = {i: [(e, t) for e, own in terms[i].items() for t in own[1:]] for i in lanes}
    for step in _side_by_side(more):
        row = collect({i: sums[i, e] for i, (e, _) in step.items()}) + collect(
            {i: value(i, term) for i, (_, term) in step.items()}
        )
        sums |= {(i, e): row for i, (e, _) in step.items()}
    return array([collect({i: sums[i, e] for i in lanes}) for e in NINE]).reshape(3, 3)


def _terms(first: NDArray[Any], second: NDArray[Any], e: Element) -> Iterator[tuple[Any, ...]]:
    """Yield the names of the terms of an element of the product that are not zero."""
    r, c = e
    for k in range(3):
        a, b = first[r, k], second[k, c]
        if a == 0 or b == 0:
            continue
        if np.isnan(a) and np.isnan(b):
            yield 'product', (r, k), (k, c)
        elif np.isnan(a):
            yield ('left' if b > 0 else '-left'), (r, k)
        else:
            # The left element is 1 or -1; a known right element is in its register.
            yield ('right' if a > 0 else '-right'), (k, c)


def _side_by_side(tasks: Mapping[int, Sequence[Any]]) -> list[dict[int, Any]]:
    """Return, for each k, the k-th task of each lane that has one."""
    most = max(map(len, tasks.values()), default=0)
    return [{i: own[k] for i, own in tasks.items() if k < len(own)} for k in range(most)]
