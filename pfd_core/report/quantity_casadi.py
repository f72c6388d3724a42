# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities other than forward dynamics as C that CasADi generates, from textbook algorithms.

    inverse dynamics   recursive Newton-Euler, table 5.1 of Featherstone 2008; the bias and gravity
                       torques are those at zero acceleration, and at rest
    inertia matrix     CasADi's Jacobian of inverse dynamics by the accelerations
    pose, Jacobian     products of transforms; axes and lever arms of the joints
    derivatives        -H^-1 times CasADi's Jacobian of inverse dynamics, at the accelerations of
                       articulated bodies (textbook): a third of the operations of the Jacobian of
                       these accelerations themselves

Dense matrices lie in columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import ctypes
from functools import partial
from typing import Any

import numpy as np

from pfd_core.model import Robot
from pfd_core.report.peers import installed, joint_frames
from pfd_core.report.quantity_kernels import argument_names, arguments
from pfd_core.report.textbook import (
    articulated_body,
    at_rest,
    compiled,
    compiler,
    coordinates,
    exact,
    function,
    links,
    motion_cross,
)
from pfd_core.report.timing import Array, LeftOutError, Side, Work

# gcc takes half a minute for this many instructions of CasADi, and more than in proportion beyond.
MOST_INSTRUCTIONS = 25_000

# The loop around `arm`, CasADi's function of one state.
LOOP = """
void batch(long long count, const double **in, double *out) {
    const double *arg[SZ_ARG];
    double *res[SZ_RES], w[SZ_W];
    casadi_int iw[SZ_IW];
    for (long long k = 0; k < count; k++) {
        for (int i = 0; i < ARGUMENTS; i++) arg[i] = in[i] + k * N;
        res[0] = out + k * ELEMENTS;
        arm(arg, res, iw, w, 0);
    }
}
"""


def inverse_dynamics(casadi: Any, robot: Robot, q: Any, qd: Any, qdd: Any) -> Any:
    """Return the torques, (n,) of casadi.SX, by the recursive Newton-Euler algorithm."""
    X, S, inertia = links(casadi, robot, q)
    v, a, f = casadi.SX(6, 1), at_rest(casadi), []
    for i in range(robot.n):
        own = S[i] * qd[i]
        v = X[i] @ v + own
        cross = motion_cross(casadi, v)
        a = X[i] @ a + S[i] * qdd[i] + cross @ own
        f.append(inertia[i] @ a - cross.T @ inertia[i] @ v)
    tau = [casadi.SX()] * robot.n
    for i in reversed(range(robot.n)):
        tau[i] = S[i].T @ f[i]
        if i > 0:
            f[i - 1] = f[i - 1] + X[i].T @ f[i]
    return casadi.vertcat(*tau)


def _inertia_matrix(casadi: Any, robot: Robot, q: Any) -> Any:
    qdd, still = casadi.SX.sym('qdd', robot.n), casadi.SX(robot.n, 1)
    return casadi.jacobian(inverse_dynamics(casadi, robot, q, still, qdd), qdd)


def _bias_torques(casadi: Any, robot: Robot, q: Any, qd: Any) -> Any:
    return inverse_dynamics(casadi, robot, q, qd, casadi.SX(robot.n, 1))


def _gravity_torques(casadi: Any, robot: Robot, q: Any) -> Any:
    return _bias_torques(casadi, robot, q, casadi.SX(robot.n, 1))


def _poses(casadi: Any, robot: Robot, q: Any) -> list[tuple[Any, Any]]:
    """Return rotation and origin of each joint's frame and of the tip, in the base link's."""
    R, p = casadi.SX.eye(3), casadi.SX(3, 1)
    poses = []
    for i, (turn, shift, _, _) in enumerate(joint_frames(robot)):
        E, r = coordinates(casadi, robot, i, turn, shift, q[i])
        R, p = R @ E.T, p + R @ r
        poses.append((R, p))
    tip = robot.frame()
    for turn, shift in (robot.rotations[-1], robot.translations[-1]), tip.placement:
        R, p = R @ exact(casadi, turn), p + R @ exact(casadi, shift)
    return [*poses, (R, p)]


def _tip_pose(casadi: Any, robot: Robot, q: Any) -> Any:
    R, p = _poses(casadi, robot, q)[-1]
    return casadi.vertcat(casadi.horzcat(R, p), casadi.SX([[0, 0, 0, 1]]))


def _tip_jacobian(casadi: Any, robot: Robot, q: Any) -> Any:
    *poses, (_, tip) = _poses(casadi, robot, q)
    columns = []
    for kind, (R, p) in zip(robot.joint_types, poses, strict=True):
        axis = R[:, 2]
        if kind == 'prismatic':
            columns.append(casadi.vertcat(axis, casadi.SX(3, 1)))
        else:
            columns.append(casadi.vertcat(casadi.cross(axis, tip - p), axis))
    return casadi.horzcat(*columns)


def _derivatives(casadi: Any, robot: Robot, q: Any, qd: Any, tau: Any) -> Any:
    n, qdd = robot.n, casadi.SX.sym('qdd', robot.n)
    torques = inverse_dynamics(casadi, robot, q, qd, qdd)
    D = casadi.jacobian(torques, casadi.vertcat(q, qd))
    D = casadi.substitute(D, qdd, articulated_body(casadi, robot)(q, qd, tau))
    factors = casadi.ldl(casadi.densify(casadi.jacobian(torques, qdd)), False)
    rows = casadi.horzcat(-D, casadi.SX.eye(n))
    return casadi.ldl_solve(casadi.densify(rows), *factors)


TEXTS: dict[str, Callable[..., Any]] = {
    'inverse_dynamics': inverse_dynamics,
    'inertia_matrix': _inertia_matrix,
    'bias_torques': _bias_torques,
    'gravity_torques': _gravity_torques,
    'tip_pose': _tip_pose,
    'tip_jacobian': _tip_jacobian,
    'derivatives': _derivatives,
}


class CasadiQuantity:
    """CasADi's C of one quantity of a robot, compiled and loaded, as a contender."""

    def __init__(self, quantity: str, robot: Robot) -> None:
        casadi = installed('casadi')
        compiler()
        if quantity not in TEXTS:
            raise LeftOutError('not implemented with CasADi here')
        names = argument_names(quantity)
        given = [casadi.SX.sym(name, robot.n) for name in names]
        arm = function(casadi, given, TEXTS[quantity](casadi, robot, *given))
        if arm.n_instructions() > MOST_INSTRUCTIONS:
            raise LeftOutError(
                f'its C has {arm.n_instructions()} instructions and takes minutes to compile'
            )
        self.quantity, self.shape = quantity, arm.size_out(0)
        sizes = {'N': robot.n, 'ARGUMENTS': len(names), 'ELEMENTS': arm.numel_out(0)}
        self.library, self.external = compiled(casadi, arm, LOOP, **sizes)
        # Arrays whose addresses native code holds.
        self.kept: list[object] = []

    def sides(self, work: Work) -> Iterator[Side]:
        """Return CasADi's own buffer() for one state, and the loop in C for a batch."""
        rows, columns = self.shape
        given = [np.ascontiguousarray(x) for x in arguments(self.quantity, work)]
        states = work.units if work.kind == 'batch' else 1
        out = np.empty((states, columns, rows))
        self.kept += [given, out]

        def result() -> Array:
            flat: Array = out.transpose(0, 2, 1).reshape(states, -1)
            return flat if work.kind == 'batch' else flat.ravel()

        if work.kind == 'call':
            given = [x.copy() for x in given]
            buffer, evaluate = self.external.buffer()
            for k, x in enumerate(given):
                buffer.set_arg(k, x.data)
            buffer.set_res(0, out.data)
            self.kept += [given, buffer]
            yield Side('CasADi C, buffer()', evaluate, result)
        else:
            at = (ctypes.c_void_p * len(given))(*(x.ctypes.data for x in given))
            self.kept.append(at)
            count, target = ctypes.c_longlong(states), ctypes.c_void_p(out.ctypes.data)
            yield Side(
                'CasADi C, loop in C', partial(self.library.batch, count, at, target), result
            )
