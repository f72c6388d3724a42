# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A textbook articulated-body algorithm, written with CasADi and compiled as C.

The algorithm is table 7.1 of Featherstone, Rigid Body Dynamics Algorithms, 2008, in 6-D vectors,
angular part first. CasADi knows which elements are zero, shares common sub-expressions and
writes C, which the machine's own compiler translates for its processor: the usual way to generate
such code today. A loop in C goes over the states of a batch.
"""

from __future__ import annotations

from collections.abc import Iterator
import ctypes
from functools import partial
from pathlib import Path
import shutil
import subprocess
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pfd_core.model import Robot
from pfd_core.report.peers import installed, joint_frames
from pfd_core.report.timing import STEP_SIZE, Array, LeftOutError, Side, Work

COMPILER = ('cc', '-O3', '-march=native', '-shared', '-fPIC')
GRAVITY = 9.81
# gcc takes 20 seconds for 60 joints, and more than in proportion beyond.
LARGEST = 60

# The loops around `arm`, CasADi's function of one state.
LOOPS = """
void batch(long long count, const double *q, const double *qd, const double *tau, double *qdd) {
    const double *arg[SZ_ARG];
    double *res[SZ_RES], w[SZ_W];
    casadi_int iw[SZ_IW];
    for (long long k = 0; k < count; k++) {
        arg[0] = q + k * N; arg[1] = qd + k * N; arg[2] = tau + k * N; res[0] = qdd + k * N;
        arm(arg, res, iw, w, 0);
    }
}
static void at(const double *q, const double *qd, const double *tau, double *qdd) {
    batch(1, q, qd, tau, qdd);
}
void rollout(long long steps, double h, double *q, double *qd, const double *taus) {
    double a1[N], a2[N], a3[N], a4[N], x[N], v2[N], v3[N], v4[N];
    for (long long k = 0; k < steps; k++) {
        const double *tau = taus + k * N;
        at(q, qd, tau, a1);
        for (int i = 0; i < N; i++) v2[i] = qd[i] + h / 2 * a1[i], x[i] = q[i] + h / 2 * qd[i];
        at(x, v2, tau, a2);
        for (int i = 0; i < N; i++) v3[i] = qd[i] + h / 2 * a2[i], x[i] = q[i] + h / 2 * v2[i];
        at(x, v3, tau, a3);
        for (int i = 0; i < N; i++) v4[i] = qd[i] + h * a3[i], x[i] = q[i] + h * v3[i];
        at(x, v4, tau, a4);
        for (int i = 0; i < N; i++) {
            q[i] += h / 6 * (qd[i] + 2 * v2[i] + 2 * v3[i] + v4[i]);
            qd[i] += h / 6 * (a1[i] + 2 * a2[i] + 2 * a3[i] + a4[i]);
        }
    }
}
"""


def articulated_body(casadi: Any, robot: Robot) -> Any:
    """Return the function (q, qd, tau) -> qdd of casadi.SX, each (n,); gravity along -z."""
    SX, n = casadi.SX, robot.n
    q, qd, tau = (SX.sym(name, n) for name in ('q', 'qd', 'tau'))
    X, S, inertia = links(casadi, robot, q)
    v, c, bias = (list[Any]() for _ in range(3))
    for i in range(n):
        own = S[i] * qd[i]
        v.append(own if i == 0 else X[i] @ v[i - 1] + own)
        c.append(motion_cross(casadi, v[i]) @ own)
        bias.append(-motion_cross(casadi, v[i]).T @ inertia[i] @ v[i])
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
    a = at_rest(casadi)
    qdd = []
    for i in range(n):
        a = X[i] @ a + c[i]
        qdd.append((u[i] - U[i].T @ a) / D[i])
        a = a + S[i] * qdd[i]
    return function(casadi, [q, qd, tau], casadi.vertcat(*qdd))


def links(casadi: Any, robot: Robot, q: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """
    Return, each a list over the joints, transforms, axes and inertias as casadi.SX.

    A transform, (6, 6), is that of motion vectors from the joint before; an axis is (6,), and an
    inertia (6, 6), in the frame that turns with the joint.
    """
    X, S, inertia = (list[Any]() for _ in range(3))
    for i, (R, p, center, J) in enumerate(joint_frames(robot)):
        E, r = coordinates(casadi, robot, i, R, p, q[i])
        X.append(_transform(casadi, E, r))
        S.append(exact(casadi, np.eye(6)[5 if robot.joint_types[i] == 'prismatic' else 2]))
        inertia.append(exact(casadi, _spatial_inertia(float(robot.masses[i]), center, J)))
    return X, S, inertia


def coordinates(casadi: Any, robot: Robot, i: int, R: Array, p: Array, q: Any) -> tuple[Any, Any]:
    """Return rotation into the frame of joint i, and its origin, from and in the frame before."""
    E, r = exact(casadi, R.T), exact(casadi, p)
    if robot.joint_types[i] == 'prismatic':
        return E, r + exact(casadi, R[:, 2]) * q
    return _turn(casadi, q) @ E, r


def at_rest(casadi: Any) -> Any:
    """Return the acceleration of the base equivalent to gravity along -z, (6,)."""
    return exact(casadi, np.array([0, 0, 0, 0, 0, GRAVITY]))


def function(casadi: Any, arguments: list[Any], result: Any) -> Any:
    """Return the function `arm` of a dense result, common sub-expressions shared."""
    return casadi.Function('arm', arguments, [casadi.cse(casadi.densify(result))])


def exact(casadi: Any, values: Array) -> Any:
    """Return numbers as SX whose zeros CasADi knows."""
    return casadi.SX(casadi.sparsify(casadi.DM(values)))


def _turn(casadi: Any, angle: Any) -> Any:
    """Return the coordinate transform of a rotation about z, (3, 3)."""
    c, s, zero = casadi.cos(angle), casadi.sin(angle), casadi.SX(1, 1)
    return casadi.vertcat(
        casadi.horzcat(c, s, zero),
        casadi.horzcat(-s, c, zero),
        casadi.horzcat(zero, zero, casadi.SX(1)),
    )


def _transform(casadi: Any, E: Any, r: Any) -> Any:
    """Return the transform of motion vectors to a frame at r with axes E, (6, 6)."""
    zero = casadi.SX(3, 3)
    return casadi.vertcat(casadi.horzcat(E, zero), casadi.horzcat(-E @ casadi.skew(r), E))


def motion_cross(casadi: Any, v: Any) -> Any:
    """Return the matrix of the product of motion vectors, (6, 6); -transposed, of forces."""
    w = casadi.skew(v[:3])
    return casadi.vertcat(
        casadi.horzcat(w, casadi.SX(3, 3)), casadi.horzcat(casadi.skew(v[3:]), w)
    )


def _spatial_inertia(mass: float, center: Array, J: Array) -> Array:
    x, y, z = center
    C = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[J - mass * C @ C, mass * C], [-mass * C, mass * np.eye(3)]])


class Casadi:
    """CasADi's C of the textbook algorithm for one robot, compiled and loaded."""

    def __init__(self, robot: Robot) -> None:
        casadi = installed('casadi')
        compiler()
        if robot.n > LARGEST:
            raise LeftOutError(
                f'not measured beyond {LARGEST} joints: its C takes long to compile'
            )
        # Arrays whose addresses native code holds.
        self.kept: list[object] = []
        self.library, self.external = compiled(
            casadi, articulated_body(casadi, robot), LOOPS, N=robot.n
        )

    def sides(self, work: Work) -> Iterator[Side]:
        """Return CasADi's own buffer() for one state, and the loops in C."""
        return {'call': self._calls, 'rollout': self._rollouts, 'batch': self._batches}[work.kind](
            work
        )

    def _calls(self, work: Work) -> Iterator[Side]:
        buffer, evaluate = self.external.buffer()
        held = [np.array(x) for x in (*work.arrays, np.empty_like(work.q))]
        for k, x in enumerate(held[:-1]):
            buffer.set_arg(k, x.data)
        buffer.set_res(0, held[-1].data)
        self.kept.append((buffer, held))
        yield Side('CasADi C, buffer()', evaluate, lambda: held[-1])

    def _rollouts(self, work: Work) -> Iterator[Side]:
        taus = np.tile(work.tau, (work.steps, 1))
        q, qd = np.empty_like(work.q), np.empty_like(work.qd)
        loop = self.library.rollout
        at = [ctypes.c_void_p(x.ctypes.data) for x in (q, qd, taus)]
        self.kept.append(taus)
        steps, step = ctypes.c_longlong(work.steps), ctypes.c_double(STEP_SIZE)

        def run() -> None:
            q[:], qd[:] = work.q, work.qd
            loop(steps, step, *at)

        yield Side('CasADi C, RK4 in C', run, lambda: q)

    def _batches(self, work: Work) -> Iterator[Side]:
        arrays = [np.ascontiguousarray(x) for x in work.arrays]
        arrays.append(np.empty_like(arrays[0]))
        at = [ctypes.c_void_p(x.ctypes.data) for x in arrays]
        self.kept.append(arrays)
        run = partial(self.library.batch, ctypes.c_longlong(work.units), *at)
        yield Side('CasADi C, loop in C', run, lambda: arrays[-1])


def compiler() -> str:
    """Return the path of the machine's C compiler; LeftOutError if there is none."""
    path = shutil.which(COMPILER[0])
    if path is None:
        raise LeftOutError(f'there is no C compiler ({COMPILER[0]}) on this machine')
    return path


def compiled(casadi: Any, arm: Any, loops: str, **sizes: int) -> tuple[ctypes.CDLL, Any]:
    """
    Return CasADi's function `arm` as C with loops around it, compiled and loaded, twice.

    The first is the library, the second CasADi's own view of the function. `sizes` are known to
    the C of the loops, and so are the sizes of the function's work, SZ_ARG, SZ_RES, SZ_IW and
    SZ_W. LeftOutError has the message of the compiler.
    """
    generator = casadi.CodeGenerator('arm.c')
    generator.add(arm)
    sizes |= {'SZ_ARG': arm.sz_arg(), 'SZ_RES': arm.sz_res()}
    sizes |= {'SZ_IW': arm.sz_iw() + 1, 'SZ_W': arm.sz_w() + 1}
    defines = [f'#define {name} {size}' for name, size in sizes.items()]
    # Once loaded, a library needs no file any more.
    with TemporaryDirectory(prefix='pfd_speed_') as folder:
        source, path = (Path(folder) / name for name in ('arm.c', 'arm.so'))
        source.write_text('\n'.join([generator.dump(), *defines, loops]), encoding='utf-8')
        command = [compiler(), *COMPILER[1:], str(source), '-o', str(path), '-lm']
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise LeftOutError(f'{COMPILER[0]} failed: {done.stderr.strip()[:200]}')
        return ctypes.CDLL(str(path)), casadi.external('arm', str(path))
