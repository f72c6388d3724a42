# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Textbook algorithms written with CasADi, and the C that it generates, compiled, as a peer.

    forward dynamics   composite bodies, table 6.2 of Featherstone, Rigid Body Dynamics Algorithms,
                       2008, in 3-D vectors, with recursive Newton-Euler and L D L^T: fewer
                       operations for the arms of the pages than articulated bodies
    inverse dynamics   recursive Newton-Euler in 3-D vectors, in the axes of the links
    bias torques       inverse dynamics at zero acceleration
    inertia matrix     composite bodies
    derivatives        -H^-1 times CasADi's Jacobian of inverse dynamics, at the accelerations of
                       composite bodies

CasADi knows which elements are zero, shares common sub-expressions and writes C, which the
machine's compiler translates for its processor: the usual way to generate such code today. Loops
over states and steps are in data/casadi.c.

What an expert does with this C: eight states at a time. `double` in the C of one state becomes a
vector type of gcc and clang, and its sines and cosines become polynomials on vectors
(data/vector_casadi.c). Each compiler that is installed is a peer, with the options of -ffast-math
and, for gcc, an earlier scheduling of instructions, which were the fastest of a dozen tried.
States lie in columns; in rows, C order, they are transposed on the way, eight at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import ctypes
from functools import partial
import importlib
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.problems import FORWARD, QUANTITIES
from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.native import OPTIMISED, address, built
from benchmarks.peers.work import SINE, Arguments, Peer, Side, installed, is_batch
from benchmarks.table import stored_text
from pfd_core.model.robot import Robot

casadi: Any = None
with suppress(ImportError):
    casadi = importlib.import_module('casadi')
GRAVITY = 9.81
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


def _bias_torques(robot: Robot, q: Any, qd: Any) -> Any:
    return _inverse_dynamics(robot, q, qd, casadi.SX(robot.n, 1))


def _derivatives(robot: Robot, q: Any, qd: Any, tau: Any) -> Any:
    n, qdd = robot.n, casadi.SX.sym('qdd', robot.n)
    torques = _inverse_dynamics(robot, q, qd, qdd)
    D = casadi.jacobian(torques, casadi.vertcat(q, qd))
    D = casadi.substitute(D, qdd, casadi.cse(_composite_body(robot, q, qd, tau)))
    return _solved(_inertia_matrix(robot, q), casadi.horzcat(-D, casadi.SX.eye(n)))


ALGORITHMS = {
    FORWARD: _composite_body,
    'inverse_dynamics': _inverse_dynamics,
    'inertia_matrix': _inertia_matrix,
    'bias_torques': _bias_torques,
    'derivatives': _derivatives,
}


def function_of(robot: Robot, quantity: str = FORWARD, **rotors: Array | None) -> Any:
    """
    Return a quantity as casadi.Function `arm`, row by row.

    Forward dynamics may have rotor inertias `armature`, (n,).
    """
    installed('casadi')
    algorithm: Any = ALGORITHMS[quantity]
    given = [casadi.SX.sym(name, robot.n) for name in QUANTITIES[quantity]]
    # CasADi's matrices lie in columns.
    rows = casadi.densify(algorithm(robot, *given, **rotors)).T
    return casadi.Function('arm', given, [casadi.cse(rows)])


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
    name = 'CasADi C composite bodies' if quantity == FORWARD else 'CasADi C'

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


# ---- eight states at a time ----

# -ffast-math itself links code that makes this whole process flush small numbers to zero.
FAST = (
    '-fassociative-math',
    '-fno-signed-zeros',
    '-fno-trapping-math',
    '-freciprocal-math',
    '-fno-math-errno',
    '-ffinite-math-only',
    '-ffp-contract=fast',
)
COMPILERS = {
    'gcc': (*FAST, '-fschedule-insns', '-fsched-pressure'),
    'clang': (*FAST, '-fapprox-func'),
}
# Largest angle [rad] and error of sine and cosine [units in the last place], which a test holds.
LARGEST_ANGLE, ULPS = 1e5, 2.0
NUMBERS = f'float64, sine and cosine by polynomials: {ULPS:g} ulp, up to {LARGEST_ANGLE:g} rad'
# Statements of CasADi's function, and what each becomes.
BODY = re.compile(r'static int casadi_f0\(.*?\)\s*\{(.*?)return 0;', re.DOTALL)
STATEMENTS = (
    (r'casadi_real ', 'Vector '),
    (r'arg\[(\d)\]\s*\?\s*arg\[\d\]\[(\d+)\]\s*:\s*0', r'*(const Unaligned *)(A\1 + \2 * stride)'),
    (r'if \(res\[0\]!=0\) res\[0\]\[(\d+)\]=(\w+);', r'*(Unaligned *)(qdd + \1 * stride) = \2;'),
    (r'=\s*(-?[\d.]+(?:e[+-]?\d+)?)\s*;', r' = \1 + (Vector){0};'),
    (r'\b(?:casadi_)?(sin|cos|sq)\(', r'vector_\1('),
)
ARGUMENTS = '#define A0 q\n#define A1 qd\n#define A2 tau\n'


def vector_source(robot: Robot) -> str:
    """Return the C of forward dynamics of eight states at a time."""
    found = BODY.search(source_of(function_of(robot)))
    assert found is not None
    body = found[1]
    for pattern, text in STATEMENTS:
        body = re.sub(pattern, text, body)
    code = stored_text('vector_casadi.c').replace('@BODY@', body)
    return f'enum {{ N = {robot.n} }};\n{ARGUMENTS}{code}'


def vector_library(robot: Robot, compiler: str) -> ctypes.CDLL:
    """Return the C compiled by one of COMPILERS: `columns`, `rows`, and `sines` for its test."""
    with built(compiler, '.c', vector_source(robot), *COMPILERS[compiler]) as path:
        return ctypes.CDLL(path)


def vector_casadi(robot: Robot, compiler: str = 'gcc') -> Peer:
    """Return the peer of one compiler: a batch in Fortran and in C order."""
    library = vector_library(robot, compiler)
    contents = (
        f'C for this robot, {compiler} {" ".join(OPTIMISED)} and parts of -ffast-math; called '
        f'by ctypes once, loop in C, eight states at a time; {NUMBERS}'
    )

    def sides(given: Arguments) -> Iterator[Side]:
        orders = ('F', np.asfortranarray, 'columns'), ('C', np.ascontiguousarray, 'rows')
        for order, laid, function in orders if is_batch(given) else ():
            arrays = [laid(x) for x in given]
            out: NDArray[np.float64] = np.empty_like(arrays[0])
            native, count = getattr(library, function), ctypes.c_longlong(len(out))
            run = partial(native, count, *map(address, (*arrays, out)))
            way = f'CasADi C on vectors, {compiler}, {order} order'
            yield Side(way, run, partial(np.asarray, out), contents)

    return sides
