# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Textbook algorithms written with CasADi, and the C that it generates, compiled, as a peer.

    forward dynamics   articulated bodies, table 7.1 of Featherstone, Rigid Body Dynamics
                       Algorithms, 2008, in 6-D vectors; or composite bodies, table 6.2, in 3-D
                       vectors, with recursive Newton-Euler and L D L^T: fewer operations for the
                       arms of the pages
    inverse dynamics   recursive Newton-Euler in 3-D vectors, in the axes of the links
    bias torques       inverse dynamics at zero acceleration
    inertia matrix     composite bodies
    derivatives        -H^-1 times CasADi's Jacobian of inverse dynamics, at the accelerations of
                       composite bodies

CasADi knows which elements are zero, shares common sub-expressions and writes C, which the
machine's compiler translates for its processor: the usual way to generate such code today. Loops
over states and steps are in data/casadi.c.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import ctypes
from functools import partial
import importlib
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases.quantities import FORWARD, QUANTITIES
from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.native import OPTIMISED, address, built
from benchmarks.peers.work import SINE, Arguments, LeftOutError, Peer, Side, installed, is_batch
from benchmarks.table import stored_text
from pfd_core.model import Robot

casadi: Any = None
with suppress(ImportError):
    casadi = importlib.import_module('casadi')
GRAVITY = 9.81
# gcc takes half a minute for this many instructions of CasADi; more than in proportion beyond.
MOST_INSTRUCTIONS = 30_000
# Most joints of composite bodies: beyond 12, articulated bodies soon take fewer operations.
LONGEST = 12
ARTICULATED, COMPOSITE = 'articulated bodies', 'composite bodies'
CODE = f'C for this robot, cc {" ".join(OPTIMISED)}'


class _Link(NamedTuple):
    """
    A link as CasADi's expressions, in the frame that turns with its joint.

    `frame` and `turn` are the rotations, one after the other, into the frame of the joint before;
    `origin` lies in that frame.
    """

    turns: bool
    frame: Any
    turn: Any
    origin: Any
    mass: float
    center: Any
    inertia: Any

    def outward(self, x: Any) -> Any:
        """Return a vector of the frame before in this frame."""
        return self.turn.T @ (self.frame.T @ x)

    def inward(self, x: Any) -> Any:
        """Return a vector of this frame in the frame before."""
        return self.frame @ (self.turn @ x)


def _links(robot: Robot, q: Any) -> list[_Link]:
    found = []
    for i, (R, p, center, J) in enumerate(joint_frames(robot)):
        turns, turn, origin = robot.joint_types[i] != 'prismatic', casadi.SX.eye(3), _exact(p)
        if turns:
            turn[:2, :2] = casadi.vertcat(
                casadi.horzcat(casadi.cos(q[i]), -casadi.sin(q[i])),
                casadi.horzcat(casadi.sin(q[i]), casadi.cos(q[i])),
            )
        else:
            origin = origin + _exact(R[:, 2]) * q[i]
        body = float(robot.masses[i]), _exact(center), _exact(J)
        found.append(_Link(turns, _exact(R), turn, origin, *body))
    return found


def _exact(values: Array) -> Any:
    """Return numbers as SX whose zeros CasADi knows."""
    return casadi.SX(casadi.sparsify(casadi.DM(values)))


def _axis() -> Any:
    return _exact(np.array([0.0, 0, 1]))


def _inverse_dynamics(robot: Robot, q: Any, qd: Any, qdd: Any) -> Any:
    """Return the torques, (n,) of casadi.SX, by the recursive Newton-Euler algorithm."""
    z, cross, links = _axis(), casadi.cross, _links(robot, q)
    w, al, a = casadi.SX(3, 1), casadi.SX(3, 1), GRAVITY * z
    loads = []
    for i, link in enumerate(links):
        a = link.outward(a + cross(al, link.origin) + cross(w, cross(w, link.origin)))
        w, al = link.outward(w), link.outward(al)
        if link.turns:
            al, w = al + cross(w, z * qd[i]) + z * qdd[i], w + z * qd[i]
        else:
            a = a + 2 * cross(w, z * qd[i]) + z * qdd[i]
        c, J = link.center, link.inertia
        force = link.mass * (a + cross(al, c) + cross(w, cross(w, c)))
        loads.append((force, J @ al + cross(w, J @ w) + cross(c, force)))
    force, moment, tau = casadi.SX(3, 1), casadi.SX(3, 1), []
    for link, (own_force, own_moment) in zip(reversed(links), reversed(loads), strict=True):
        force, moment = own_force + force, own_moment + moment
        tau.append((moment if link.turns else force)[2])
        force, moment = link.inward(force), link.inward(moment)
        moment = moment + cross(link.origin, force)
    return casadi.vertcat(*reversed(tau))


def _inertia_matrix(robot: Robot, q: Any) -> Any:
    """Return the inertia matrix, (n, n) of casadi.SX, by composite bodies."""
    n, z, links, skew = robot.n, _axis(), _links(robot, q), casadi.skew
    # Of the composite bodies: mass, first moment and inertia about the joint's origin.
    m = [link.mass for link in links]
    h = [link.mass * link.center for link in links]
    J = [x.inertia - x.mass * skew(x.center) @ skew(x.center) for x in links]
    H = casadi.SX(n, n)
    for j in reversed(range(n)):
        own = links[j]
        force = casadi.cross(z, h[j]) if own.turns else m[j] * z
        moment = J[j] @ z if own.turns else casadi.cross(h[j], z)
        for i in range(j, -1, -1):
            H[i, j] = H[j, i] = (moment if links[i].turns else force)[2]
            force = links[i].inward(force)
            moment = links[i].inward(moment) + casadi.cross(links[i].origin, force)
        if j > 0:
            r, first = own.origin, own.inward(h[j])
            turned = own.frame @ (own.turn @ J[j] @ own.turn.T) @ own.frame.T
            shift = skew(r) @ skew(first) + skew(first) @ skew(r) + m[j] * skew(r) @ skew(r)
            J[j - 1] = J[j - 1] + turned - shift
            h[j - 1] = h[j - 1] + first + m[j] * r
            m[j - 1] += m[j]
    return H


def _composite_body(robot: Robot, q: Any, qd: Any, tau: Any, armature: Array | None = None) -> Any:
    """Return the accelerations, (n,) of casadi.SX, by composite bodies and L D L^T."""
    rotors = np.zeros(robot.n) if armature is None else armature
    H = _inertia_matrix(robot, q) + casadi.diag(_exact(rotors))
    return _solved(H, tau - _bias_torques(robot, q, qd))


def _solved(H: Any, right: Any) -> Any:
    """Return H^-1 right by L D L^T, without exchanges of rows."""
    factors = casadi.ldl(casadi.densify(H), False)
    return casadi.ldl_solve(casadi.densify(right), *factors)


def _articulated_body(robot: Robot, q: Any, qd: Any, tau: Any) -> Any:
    """Return the accelerations, (n,) of casadi.SX, by articulated bodies; gravity along -z."""
    SX, n = casadi.SX, robot.n
    X, S, inertia = (list[Any]() for _ in range(3))
    for link in _links(robot, q):
        # Motion vectors, angular part first, from the frame of the joint before; inertia.
        E, zero = link.turn.T @ link.frame.T, SX(3, 3)
        below = casadi.horzcat(-E @ casadi.skew(link.origin), E)
        X.append(casadi.vertcat(casadi.horzcat(E, zero), below))
        S.append(_exact(np.eye(6)[2 if link.turns else 5]))
        C, m = casadi.skew(link.center), link.mass
        above = casadi.horzcat(link.inertia - m * C @ C, m * C)
        inertia.append(casadi.vertcat(above, casadi.horzcat(-m * C, m * SX.eye(3))))
    v, c, bias = (list[Any]() for _ in range(3))
    for i in range(n):
        own = S[i] * qd[i]
        v.append(own if i == 0 else X[i] @ v[i - 1] + own)
        c.append(_motion_cross(v[i]) @ own)
        bias.append(-_motion_cross(v[i]).T @ inertia[i] @ v[i])
    U, D, u = [SX()] * n, [SX()] * n, [SX()] * n
    for i in reversed(range(n)):
        U[i] = inertia[i] @ S[i]
        D[i] = S[i].T @ U[i]
        u[i] = tau[i] - S[i].T @ bias[i]
        if i > 0:
            Ia = inertia[i] - (U[i] / D[i]) @ U[i].T
            pa = bias[i] + Ia @ c[i] + U[i] * (u[i] / D[i])
            inertia[i - 1] = inertia[i - 1] + X[i].T @ Ia @ X[i]
            bias[i - 1] = bias[i - 1] + X[i].T @ pa
    # The acceleration of the base is equivalent to gravity.
    a, qdd = _exact(np.array([0, 0, 0, 0, 0, GRAVITY])), []
    for i in range(n):
        a = X[i] @ a + c[i]
        qdd.append((u[i] - U[i].T @ a) / D[i])
        a = a + S[i] * qdd[i]
    return casadi.vertcat(*qdd)


def _motion_cross(v: Any) -> Any:
    """Return the matrix of the product of motion vectors, (6, 6); -transposed, of forces."""
    w = casadi.skew(v[:3])
    above = casadi.horzcat(w, casadi.SX(3, 3))
    return casadi.vertcat(above, casadi.horzcat(casadi.skew(v[3:]), w))


def _bias_torques(robot: Robot, q: Any, qd: Any) -> Any:
    return _inverse_dynamics(robot, q, qd, casadi.SX(robot.n, 1))


def _derivatives(robot: Robot, q: Any, qd: Any, tau: Any) -> Any:
    n, qdd = robot.n, casadi.SX.sym('qdd', robot.n)
    torques = _inverse_dynamics(robot, q, qd, qdd)
    D = casadi.jacobian(torques, casadi.vertcat(q, qd))
    D = casadi.substitute(D, qdd, casadi.cse(_composite_body(robot, q, qd, tau)))
    return _solved(_inertia_matrix(robot, q), casadi.horzcat(-D, casadi.SX.eye(n)))


ALGORITHMS = {
    'inverse_dynamics': _inverse_dynamics,
    'inertia_matrix': _inertia_matrix,
    'bias_torques': _bias_torques,
    'derivatives': _derivatives,
}


def method_of(robot: Robot) -> str:
    """Return the method of forward dynamics that takes fewer operations."""
    return COMPOSITE if robot.n <= LONGEST else ARTICULATED


def function_of(robot: Robot, quantity: str = FORWARD, armature: Array | None = None) -> Any:
    """
    Return a quantity as casadi.Function `arm`, row by row; LeftOutError if it is too large.

    Rotor inertias `armature`, (n,), are of forward dynamics by composite bodies.
    """
    installed('casadi')
    algorithm: Any = ALGORITHMS.get(quantity, _articulated_body)
    if quantity == FORWARD and method_of(robot) == COMPOSITE:
        algorithm = partial(_composite_body, armature=armature)
    given = [casadi.SX.sym(name, robot.n) for name in QUANTITIES[quantity]]
    # CasADi's matrices lie in columns.
    rows = casadi.densify(algorithm(robot, *given)).T
    arm = casadi.Function('arm', given, [casadi.cse(rows)])
    count = arm.n_instructions()
    if count > MOST_INSTRUCTIONS:
        raise LeftOutError(f'its C has {count} instructions and takes minutes to compile')
    return arm


def source_of(arm: Any) -> str:
    """Return CasADi's C of a function."""
    generator = casadi.CodeGenerator('arm.c')
    generator.add(arm)
    return str(generator.dump())


def compiled(arm: Any, integrators: bool = False) -> tuple[ctypes.CDLL, Any]:
    """Return data/casadi.c around a function, compiled, and the function as CasADi loads it."""
    sizes = {'N': arm.numel_in(0), 'ARGUMENTS': arm.n_in(), 'ELEMENTS': arm.numel_out(0)}
    sizes |= {'SZ_ARG': arm.sz_arg(), 'SZ_RES': arm.sz_res()}
    sizes |= {'SZ_IW': arm.sz_iw() + 1, 'SZ_W': arm.sz_w() + 1}
    defines = [f'#define {name} {size}' for name, size in sizes.items()]
    defines += ['#define INTEGRATORS'] * integrators
    source = '\n'.join([source_of(arm), *defines, stored_text('casadi.c')])
    with built('cc', '.c', source) as path:
        return ctypes.CDLL(path), casadi.external('arm', path)


def casadi_c(robot: Robot, quantity: str = FORWARD) -> Peer:
    """Return a quantity as a peer: CasADi's own buffer() for one state, and a loop in C."""
    arm = function_of(robot, quantity)
    size, (library, external) = arm.numel_out(0), compiled(arm)
    name = f'CasADi C {method_of(robot)}' if quantity == FORWARD else 'CasADi C'

    def sides(given: Arguments) -> Iterator[Side]:
        # The result of a side keeps what native code reads and writes.
        arrays = [np.array(x, order='C') for x in given]
        if not is_batch(given):
            out, (buffer, run) = np.empty(size), external.buffer()
            for k, x in enumerate(arrays):
                buffer.set_arg(k, x.data)
            buffer.set_res(0, out.data)
            contents = f"{CODE}; called by CasADi's buffer(), arguments set before; {SINE}"
            yield Side(f'{name}, buffer()', run, partial(_first, out, arrays, buffer), contents)
            return
        out = np.empty((len(arrays[0]), size))
        at = (ctypes.c_void_p * len(arrays))(*(x.ctypes.data for x in arrays))
        loop = partial(library.batch, ctypes.c_longlong(len(out)), at, address(out))
        contents = f'{CODE}; called by ctypes once, loop in C; {SINE}'
        yield Side(f'{name}, loop in C', loop, partial(_first, out, arrays), contents)

    return sides


def _first(out: Array, *kept: object) -> Array:
    return out
