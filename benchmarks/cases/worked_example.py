# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCRBM and PCGM of a planar arm of three links, with the value of every lane at every step.

The procedures are written here once more, as short as the paper prints them and corrected, from
the patterns of pfd_core.paper. Every value is an output of the program that the emulator runs. The
accelerations must be those of pfd.emulate.

The arm: link 1 hangs down, links 2 and 3 point along x; q = (-90, 90, 0) degrees. Its numbers are
chosen so that H, L, y and qdd are whole numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_core.machine.emulator import run
from pfd_core.machine.lanes import merge, on, sqrt
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder, lanes_of
from pfd_core.machine.vectors import (
    array,
    constants,
    cross,
    dot,
    parallel_axis,
    rotated_symmetric,
    symmetric_times,
)
from pfd_core.paper.chain import rows as over_lanes
from pfd_core.paper.lanes import broadcast, collect, shift, taken
from pfd_core.paper.patterns import levels, sums, total
from pfd_core.paper.solve import transposed

# Rotations between the links, and in link axes: p*_i, s_i and xx, yy, zz of J_i.
TURNS = np.array(
    [
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        np.eye(3),
    ]
)
REACH = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
CENTERS = np.array([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
MOMENTS = np.array([[0.5, 1.0, 1.0], [0.5, 1.0, 1.0], [1.0, 2.0, 2.0]])
MASSES = np.array([2.0, 1.0, 1.0])
GRAVITY = np.array([0.0, -10.0, 0.0])
STATE = {
    'q': np.array([-np.pi / 2, np.pi / 2, 0.0]),
    'qd': np.array([1.0, 1.0, -1.0]),
    'tau': np.array([56.0, 65.0, 28.0]),
}
# Of the accelerations by pfd.emulate, whose cosine of a right angle is not zero.
CLOSE = 1e-13


def arm() -> pfd.Robot:
    """Return the arm in the frames of the paper, whose axes all point along z."""
    n = len(MASSES)
    return pfd.Robot(
        name='planar3',
        joint_names=tuple(f'joint{k + 1}' for k in range(n)),
        joint_types=('revolute',) * n,
        rotations=np.array([np.eye(3)] * n),
        translations=REACH,
        masses=MASSES,
        centers=CENTERS,
        inertias=np.array([np.diag(x) for x in MOMENTS]),
    )


def emulated(method: str) -> NDArray[np.float64]:
    """Return the accelerations of the arm by a method; a wrench keeps frame n at the tip."""
    scene = pfd.Scene(gravity=GRAVITY, external_wrench=True)
    q, qd, tau = STATE.values()
    found = pfd.emulate(arm(), q, qd, tau, method=method, scene=scene, wrench=np.zeros(6))
    return np.asarray(found.qdd, dtype=np.float64)


def equation() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return H and y of the worked example."""
    rows = example('pcrbm')
    upper = np.array([x['lanes'] for x in rows if x['step'] == '8'], dtype=np.float64)
    (y,) = (x['lanes'] for x in rows if x['name'].startswith('y ='))
    return np.triu(upper) + np.triu(upper, 1).T, np.array(y, dtype=np.float64)


# ---- the procedures ----


class Notes:
    """Values over lanes by step and name, which become rows after the emulator has run."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.values: list[tuple[str, str, Any]] = []

    def __call__(self, step: str, name: str, value: Any) -> Any:
        """Keep a value, a vector or a matrix of lanes, and return it."""
        self.values.append((step, name, value))
        return value

    def rows(self, inputs: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Run the program; each row has the value on each lane, None where a lane has none."""
        filled = []
        for k, (_, _, value) in enumerate(self.values):
            elements: NDArray[Any] = np.asarray(value, dtype=object)
            mask = self.recorder.all
            for element in elements.flat:
                mask &= element.defined
            filled.append(lanes_of(mask))
            places = [(element, lane) for lane in filled[k] for element in elements.flat]
            self.recorder.output(str(k), (len(filled[k]), *elements.shape), places)
        found = run(self.recorder.program(), inputs)
        rows = []
        for k, (step, name, _) in enumerate(self.values):
            by_lane = dict(zip(filled[k], found[str(k)], strict=True))
            lanes = [by_lane.get(lane) for lane in range(self.recorder.lanes)]
            rows.append({'step': step, 'name': name, 'lanes': lanes})
        return rows


def example(method: str) -> list[dict[str, Any]]:
    """Return the rows of PCRBM or PCGM; ArithmeticError if its answer is not emulate's."""
    notes = Notes(Recorder(len(MASSES), 'unpacked'))
    {'pcrbm': pcrbm, 'pcgm': pcgm}[method](notes)
    rows = notes.rows({name: STATE[name] for name in ('qd', 'tau')})
    answer = np.array(rows[-1]['lanes'], dtype=np.float64)
    if np.abs(answer - emulated(f'{method}_1987')).max() > CLOSE * np.abs(answer).max():
        raise ArithmeticError(f'{method}: {answer} is not what pfd.emulate finds')
    return rows


def pose(note: Notes) -> tuple[LaneArray, ...]:
    """Steps 1 and 2: return z_(i-1), p*_i, s_i, and the six elements of J_i."""
    recorder = note.recorder
    R = note('1', 'R_i, given', over_lanes(recorder, TURNS))
    for k, sources in enumerate(levels(recorder, downward=False), 1):
        R = note('1', f'0R_i, (13), level {k}', array(merge(taken(R, sources) @ R, R)))
    z = merge(shift(R[:, 2], 1), constants(recorder, [0.0, 0.0, 1.0]))
    p, s = (R @ over_lanes(recorder, x) for x in (REACH, CENTERS))
    links = over_lanes(recorder, np.array([x[[0, 0, 0, 1, 1, 2]] for x in MOMENTS]))
    zero = constants(recorder, [0.0])[0]
    J = rotated_symmetric(R, array([x if k in (0, 3, 5) else zero for k, x in enumerate(links)]))
    note('2', 'z_(i-1)', z)
    note('2', 'p*_i', p)
    note('2', 's_i', s)
    note('2', 'J_i', J)
    return array(z), p, s, J


def newton_euler(
    note: Notes, step: str, z: LaneArray, p: LaneArray, s: LaneArray, J: LaneArray, qd: Lanes
) -> Lanes:
    """NE1: return the bias."""
    recorder = note.recorder
    m = recorder.constant(MASSES)
    zq = z * qd
    w = note(step, 'w_i = sum of z_(i-1) qd_i from the base', sums(zq, packs=False))
    zero = constants(recorder, [0.0] * 3)
    c = array(merge(cross(shift(w, 1), on(zq, range(1, recorder.lanes))), zero))
    wd = note(step, 'wd_i = sum of w_(i-1) x z_(i-1) qd_i', sums(c, packs=False))

    def turned(x: LaneArray) -> LaneArray:
        result: LaneArray = cross(wd, x) + cross(w, cross(w, x))
        return result

    t = merge(on(turned(p), [0]) - constants(recorder, GRAVITY), turned(p))
    t = note(step, 't_i = wd_i x p*_i + w_i x (w_i x p*_i), lane 1 minus g', array(t))
    a = note(step, 'a_i = sum of t from the base', sums(t, packs=False))
    F = note(step, 'F_i = m_i (a_i + wd_i x s_i + w_i x (w_i x s_i))', m * (a + turned(s)))
    N = symmetric_times(J, wd) + cross(w, symmetric_times(J, w))
    N = note(step, 'N_i = J_i wd_i + w_i x J_i w_i', N)
    return _carried(note, step, z, p, s, F, N, 'b_i')


def inertia_times(
    note: Notes, step: str, z: LaneArray, p: LaneArray, s: LaneArray, J: LaneArray, u: Lanes
) -> Lanes:
    """Return H u: NE1 without velocities and gravity."""
    m = note.recorder.constant(MASSES)
    wd = note(step, 'wd_i = sum of z_(i-1) u_i from the base', sums(z * u, packs=False))
    a = note(step, 'a_i = sum of wd_i x p*_i from the base', sums(cross(wd, p), packs=False))
    F = note(step, 'F_i = m_i (a_i + wd_i x s_i)', m * (a + cross(wd, s)))
    N = note(step, 'N_i = J_i wd_i', symmetric_times(J, wd))
    return _carried(note, step, z, p, s, F, N, 't_i')


def _carried(
    note: Notes,
    step: str,
    z: LaneArray,
    p: LaneArray,
    s: LaneArray,
    F: LaneArray,
    N: LaneArray,
    name: str,
) -> Lanes:
    """Carry forces and moments of the links to the joints, and return the joint torques."""
    f = note(step, 'f_i = sum of F from the tip', sums(F, downward=True, packs=False))
    own = note(step, 'own_i = N_i + s_i x F_i + p*_i x f_i', N + cross(s, F) + cross(p, f))
    n = note(step, 'n_i = sum of own from the tip', sums(own, downward=True, packs=False))
    torque: Lanes = note(step, f'{name} = z_(i-1) . n_i', dot(z, n))
    return torque


def pcrbm(note: Notes) -> None:
    """Write down PCRBM, section 2.5, step by step."""
    recorder = note.recorder
    n, m = recorder.lanes, recorder.constant(MASSES)
    z, p, s, J = pose(note)
    M = note('3', 'm_j', m)
    for k, sources in enumerate(levels(recorder, downward=True), 1):
        M = note('3', f'M_j = M_(j+1) + m_j, (15), level {k}', merge(M + taken(M, sources), M))
    beyond = on(shift(M, -1), range(n - 1))
    a = note('4', 'a_j = M_(j+1) / M_j, (17)', beyond / M)
    b = note('4', 'b_j = (m_j (s_j + p*_j) + M_(j+1) p*_j) / M_j', (m * (s + p) + beyond * p) / M)
    c = note('4', 'Y: b_j, and c_n = s_n + p*_n, (16)', array(merge(b, s + p)))
    stride = 1
    for k, sources in enumerate(levels(recorder, downward=True), 1):
        c = note(
            '4',
            f'Y <- X Y_(j+{stride}) + Y, (18), level {k}',
            array(merge(a * taken(c, sources) + c, c)),
        )
        later = [lane for lane in range(n) if lane + 2 * stride < n]
        if later:
            a = note('4', f'X <- X X_(j+{stride}), level {k}', on(a * taken(a, sources), later))
        stride *= 2
    note('4', 'c_j', c)
    u, v = array(shift(c, -1)) + p - c, on(s + p - c, range(n - 1))
    note('5', 'u_j = c_(j+1) + p*_j - c_j', u)
    note('5', 'v_j = s_j + p*_j - c_j', v)
    terms = beyond * parallel_axis(u) + J + m * parallel_axis(v)
    E = note('5', 'b_j, (19), and E_n = J_n', array(merge(terms, J)))
    for k, sources in enumerate(levels(recorder, downward=True), 1):
        E = array(merge(E + taken(E, sources), E))
        note('5', f'E_j = E_(j+1) + b_j, (20), level {k}', E)
    F = note('6', 'F_j = z_(j-1) x M_j c_j, (21)', cross(z, M * c))
    N = note('6', 'N_j = E_j z_(j-1)', symmetric_times(E, z))
    moment = note('7', 'n_jj = N_j + c_j x F_j, (23)', N + cross(c, F))
    moments = [moment]
    for i in range(n - 2, -1, -1):
        lanes = range(i + 1, n)
        term = cross(broadcast(p, i), on(F, lanes))
        note('7', f'b_{i + 1}j = p*_{i + 1} x F_j, (24)', term)
        moments.append(array(merge(on(moments[-1], lanes) + term, moment)))
        note('7', f'n_{i + 1}j = n_{i + 2}j + b_{i + 1}j, (25)', on(moments[-1], lanes))
    H = []
    for i, row in enumerate(reversed(moments)):
        element = dot(broadcast(z, i), on(row, range(i, n)))
        H.append(note('8', f'h_{i + 1}j = z_{i} . n_{i + 1}j, (26)', element))
    qd, tau = (recorder.input(name, range(n)) for name in ('qd', 'tau'))
    y = note('9', 'y = tau - b', tau - newton_euler(note, '9', z, p, s, J, qd))
    _solved(note, H, y)


def _solved(note: Notes, H: Sequence[Lanes], y: Lanes) -> None:
    """Step 10: H = L L' column by column, and both column sweeps."""
    n = len(H)
    columns: list[Lanes] = []
    roots: dict[int, Lanes] = {}
    column: Any
    for i, column in enumerate(H, 1):
        for j, other in enumerate(columns, 1):
            product = on(other, range(i - 1, n)) * broadcast(other, i - 1)
            column = note('10', f'h_k{i} - ... - l_k{j} l_{i}{j}', column - product)
        root = roots[i - 1] = sqrt(on(column, [i - 1]))
        columns.append(merge(root, column / broadcast(root, i - 1)))
        note('10', f'l_k{i}: root on lane {i}, quotients below', columns[-1])
    diagonal = collect(roots)
    below = [on(column, range(j + 1, n)) for j, column in enumerate(columns[:-1])]
    upper = transposed(below)
    x = note('10', 'x = y', y)
    for downward in (False, True):
        for j in range(n - 1, -1, -1) if downward else range(n):
            x = merge(on(x, [j]) / diagonal, x)
            note('10', f'x_{j + 1} <- x_{j + 1} / l_{j + 1}{j + 1}', x)
            left = range(j) if downward else range(j + 1, n)
            if left:
                column = upper[j] if downward else below[j]
                x = merge(on(x, left) - column * on(broadcast(x, j), left), x)
                name = f'l_{j + 1}k' if downward else f'l_k{j + 1}'
                note('10', f'x_k <- x_k - {name} x_{j + 1}', x)
    note('10', 'qdd', x)


def pcgm(note: Notes) -> None:
    """Write down PCGM, section 3, step by step: n iterations."""
    recorder = note.recorder
    n = recorder.lanes
    quiet = Notes(recorder)
    z, p, s, J = pose(quiet)
    qd, tau = (recorder.input(name, range(n)) for name in ('qd', 'tau'))
    y = tau - newton_euler(quiet, '3', z, p, s, J, qd)
    w = u = note('4', 'w_0 = u_0 = tau - b, for x_0 = 0', y)
    x = recorder.constant(0.0)
    e = note('5', "e_0 = w_0' w_0", total(w * w))
    for i in range(n):
        inner = note if i == 0 else quiet
        at = f'iteration {i + 1}'
        t = note(at, f't = H u_{i}', inertia_times(inner, 'H u', z, p, s, J, u))
        ut = note(at, f"u_{i}' t", total(u * t))
        g = note(at, f"gamma_{i} = e_{i} / u_{i}' t", e / ut)
        g = broadcast(g, 0)
        x = note(at, f'x_{i + 1} = x_{i} + gamma_{i} u_{i}', x + g * u)
        if i == n - 1:
            break
        w = note(at, f'w_{i + 1} = w_{i} - gamma_{i} t', w - g * t)
        after = note(at, f"e_{i + 1} = w_{i + 1}' w_{i + 1}", total(w * w))
        beta = note(at, f'beta_{i} = e_{i + 1} / e_{i}', after / e)
        u = note(at, f'u_{i + 1} = w_{i + 1} + beta_{i} u_{i}', w + broadcast(beta, 0) * u)
        e = after
    note('10', 'qdd', x)
