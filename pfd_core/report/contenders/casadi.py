# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Textbook algorithms written with CasADi, and the C that it generates, compiled, as a contender.

    forward dynamics   articulated bodies, table 7.1 of Featherstone, Rigid Body Dynamics
                       Algorithms, 2008, in 6-D vectors, angular part first
    inverse dynamics   recursive Newton-Euler, table 5.1 of the same book
    bias, gravity      inverse dynamics at zero acceleration, and at rest
    inertia matrix     CasADi's Jacobian of inverse dynamics by the accelerations
    pose, Jacobian     products of transforms; axes and lever arms of the joints
    derivatives        -H^-1 times CasADi's Jacobian of inverse dynamics, at the accelerations of
                       articulated bodies: a third of the operations of the Jacobian of
                       articulated bodies

CasADi knows which elements are zero, shares common sub-expressions and writes C, which the
machine's compiler translates for its processor: the usual way to generate such code today. Loops
over states and steps are in data/casadi.c. Dense matrices lie in columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import ctypes
from functools import partial
from typing import Any

import numpy as np

from pfd_core.model import Plant, Robot, resolve
from pfd_core.report.cases.quantities import FORWARD, argument_names
from pfd_core.report.cases.robots import Array, joint_frames
from pfd_core.report.cases.stored import text
from pfd_core.report.contenders.native import C, address, built, torques_if_any
from pfd_core.report.contenders.work import (
    Contender,
    Contents,
    LeftOutError,
    Side,
    Work,
    installed,
    simulation_side,
)


class _Casadi:
    """The module casadi, which is imported when it is first used."""

    def __getattr__(self, name: str) -> Any:
        return getattr(installed('casadi'), name)


casadi: Any = _Casadi()
GRAVITY = 9.81
# gcc takes 20 seconds for articulated bodies of 60 joints, and half a minute for this many
# instructions of CasADi; more than in proportion beyond.
LARGEST = 60
MOST_INSTRUCTIONS = 25_000
CODE = f'C for this robot, {C}'
BUFFER = Contents(CODE, "CasADi's buffer(), arguments set before")
LOOP = Contents(CODE, 'ctypes, once', 'C')


def _articulated_body(
    robot: Robot, q: Any, qd: Any, tau: Any, *, armature: Array | None = None
) -> Any:
    """Return the accelerations, (n,) of casadi.SX, by articulated bodies; gravity along -z."""
    SX, n = casadi.SX, robot.n
    X, S, inertia = _links(robot, q)
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
        if armature is not None:
            D[i] += float(armature[i])
        u[i] = tau[i] - S[i].T @ bias[i]
        if i > 0:
            Ia = inertia[i] - (U[i] / D[i]) @ U[i].T
            pa = bias[i] + Ia @ c[i] + U[i] * (u[i] / D[i])
            inertia[i - 1] = inertia[i - 1] + X[i].T @ Ia @ X[i]
            bias[i - 1] = bias[i - 1] + X[i].T @ pa
    a = _at_rest()
    qdd = []
    for i in range(n):
        a = X[i] @ a + c[i]
        qdd.append((u[i] - U[i].T @ a) / D[i])
        a = a + S[i] * qdd[i]
    return casadi.vertcat(*qdd)


def _inverse_dynamics(robot: Robot, q: Any, qd: Any, qdd: Any) -> Any:
    """Return the torques, (n,) of casadi.SX, by the recursive Newton-Euler algorithm."""
    X, S, inertia = _links(robot, q)
    v, a, f = casadi.SX(6, 1), _at_rest(), []
    for i in range(robot.n):
        own = S[i] * qd[i]
        v = X[i] @ v + own
        cross = _motion_cross(v)
        a = X[i] @ a + S[i] * qdd[i] + cross @ own
        f.append(inertia[i] @ a - cross.T @ inertia[i] @ v)
    tau = [casadi.SX()] * robot.n
    for i in reversed(range(robot.n)):
        tau[i] = S[i].T @ f[i]
        if i > 0:
            f[i - 1] = f[i - 1] + X[i].T @ f[i]
    return casadi.vertcat(*tau)


def _inertia_matrix(robot: Robot, q: Any) -> Any:
    qdd, still = casadi.SX.sym('qdd', robot.n), casadi.SX(robot.n, 1)
    return casadi.jacobian(_inverse_dynamics(robot, q, still, qdd), qdd)


def _bias_torques(robot: Robot, q: Any, qd: Any) -> Any:
    return _inverse_dynamics(robot, q, qd, casadi.SX(robot.n, 1))


def _gravity_torques(robot: Robot, q: Any) -> Any:
    return _bias_torques(robot, q, casadi.SX(robot.n, 1))


def _poses(robot: Robot, q: Any) -> list[tuple[Any, Any]]:
    """Return rotation and origin of each joint's frame and of the tip, in the base link's."""
    R, p = casadi.SX.eye(3), casadi.SX(3, 1)
    poses = []
    for i, (turn, shift, _, _) in enumerate(joint_frames(robot)):
        E, r = _coordinates(robot, i, turn, shift, q[i])
        R, p = R @ E.T, p + R @ r
        poses.append((R, p))
    tip = robot.frame()
    for turn, shift in (robot.rotations[-1], robot.translations[-1]), tip.placement:
        R, p = R @ _exact(turn), p + R @ _exact(shift)
    return [*poses, (R, p)]


def _tip_pose(robot: Robot, q: Any) -> Any:
    R, p = _poses(robot, q)[-1]
    return casadi.vertcat(casadi.horzcat(R, p), casadi.SX([[0, 0, 0, 1]]))


def _tip_jacobian(robot: Robot, q: Any) -> Any:
    *poses, (_, tip) = _poses(robot, q)
    columns = []
    for kind, (R, p) in zip(robot.joint_types, poses, strict=True):
        axis = R[:, 2]
        if kind == 'prismatic':
            columns.append(casadi.vertcat(axis, casadi.SX(3, 1)))
        else:
            columns.append(casadi.vertcat(casadi.cross(axis, tip - p), axis))
    return casadi.horzcat(*columns)


def _derivatives(robot: Robot, q: Any, qd: Any, tau: Any) -> Any:
    n, qdd = robot.n, casadi.SX.sym('qdd', robot.n)
    torques = _inverse_dynamics(robot, q, qd, qdd)
    D = casadi.jacobian(torques, casadi.vertcat(q, qd))
    D = casadi.substitute(D, qdd, casadi.cse(_articulated_body(robot, q, qd, tau)))
    factors = casadi.ldl(casadi.densify(casadi.jacobian(torques, qdd)), False)
    rows = casadi.horzcat(-D, casadi.SX.eye(n))
    return casadi.ldl_solve(casadi.densify(rows), *factors)


ALGORITHMS: dict[str, Callable[..., Any]] = {
    FORWARD: _articulated_body,
    'inverse_dynamics': _inverse_dynamics,
    'inertia_matrix': _inertia_matrix,
    'bias_torques': _bias_torques,
    'gravity_torques': _gravity_torques,
    'tip_pose': _tip_pose,
    'tip_jacobian': _tip_jacobian,
    'derivatives': _derivatives,
}


def _links(robot: Robot, q: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """
    Return transforms, axes and inertias as casadi.SX, a list over the joints each.

    A transform, (6, 6), takes motion vectors from the frame of the joint before. An axis, (6,),
    and an inertia, (6, 6), are in the frame that turns with the joint.
    """
    X, S, inertia = (list[Any]() for _ in range(3))
    for i, (R, p, center, J) in enumerate(joint_frames(robot)):
        E, r = _coordinates(robot, i, R, p, q[i])
        X.append(_transform(E, r))
        S.append(_exact(np.eye(6)[5 if robot.joint_types[i] == 'prismatic' else 2]))
        inertia.append(_exact(_spatial_inertia(float(robot.masses[i]), center, J)))
    return X, S, inertia


def _coordinates(robot: Robot, i: int, R: Array, p: Array, q: Any) -> tuple[Any, Any]:
    """Return rotation into the frame of joint i, and its origin, from and in the frame before."""
    E, r = _exact(R.T), _exact(p)
    if robot.joint_types[i] == 'prismatic':
        return E, r + _exact(R[:, 2]) * q
    return _turn(q) @ E, r


def _at_rest() -> Any:
    """Return the acceleration of the base equivalent to gravity along -z, (6,)."""
    return _exact(np.array([0, 0, 0, 0, 0, GRAVITY]))


def _exact(values: Array) -> Any:
    """Return numbers as SX whose zeros CasADi knows."""
    return casadi.SX(casadi.sparsify(casadi.DM(values)))


def _turn(angle: Any) -> Any:
    """Return the coordinate transform of a rotation about z, (3, 3)."""
    c, s, zero = casadi.cos(angle), casadi.sin(angle), casadi.SX(1, 1)
    return casadi.vertcat(
        casadi.horzcat(c, s, zero),
        casadi.horzcat(-s, c, zero),
        casadi.horzcat(zero, zero, casadi.SX(1)),
    )


def _transform(E: Any, r: Any) -> Any:
    """Return the transform of motion vectors to a frame at r with axes E, (6, 6)."""
    zero = casadi.SX(3, 3)
    return casadi.vertcat(casadi.horzcat(E, zero), casadi.horzcat(-E @ casadi.skew(r), E))


def _motion_cross(v: Any) -> Any:
    """Return the matrix of the product of motion vectors, (6, 6); -transposed, of forces."""
    w = casadi.skew(v[:3])
    return casadi.vertcat(
        casadi.horzcat(w, casadi.SX(3, 3)), casadi.horzcat(casadi.skew(v[3:]), w)
    )


def _spatial_inertia(mass: float, center: Array, J: Array) -> Array:
    x, y, z = center
    C = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[J - mass * C @ C, mass * C], [-mass * C, mass * np.eye(3)]])


class Casadi(Contender):
    """
    CasADi's C of one quantity of a robot, compiled and loaded.

    The ways are CasADi's own buffer() for one state, and loops in C.

    Attributes
    ----------
    library : ctypes.CDLL
        data/casadi.c around CasADi's function. `library.rollout`, of forward dynamics, is the
        native function of a simulation.

    """

    def __init__(self, robot: Robot | Plant, quantity: str = FORWARD) -> None:
        installed('casadi')
        C.path()
        if quantity not in ALGORITHMS:
            raise LeftOutError('not implemented with CasADi here')
        plant = self.plant = robot if isinstance(robot, Plant) else resolve(robot, None)
        robot, forward = plant.robot, quantity == FORWARD
        if forward and robot.n > LARGEST:
            raise LeftOutError(
                f'not measured beyond {LARGEST} joints: its C takes long to compile'
            )
        algorithm = ALGORITHMS[quantity]
        if forward:
            algorithm = partial(algorithm, armature=plant.armature)
        names = argument_names(quantity)
        given = [casadi.SX.sym(name, robot.n) for name in names]
        result = casadi.densify(algorithm(robot, *given))
        arm = casadi.Function('arm', given, [casadi.cse(result)])
        if not forward and arm.n_instructions() > MOST_INSTRUCTIONS:
            raise LeftOutError(
                f'its C has {arm.n_instructions()} instructions and takes minutes to compile'
            )
        self.quantity, self.shape = quantity, arm.size_out(0)
        self.library, self.external = _compiled(arm, robot.n, forward)
        # Arrays whose addresses native code holds.
        self.kept: list[object] = []

    def rollout(
        self, step: float, q: Array, qd: Array, taus: Array, substeps: int = 1
    ) -> partial[None]:
        """Return a call that moves q and qd, (n,), in place, as PinocchioCpp.rollout does."""
        steps = (ctypes.c_longlong(len(taus)), ctypes.c_longlong(substeps), ctypes.c_double(step))
        effects, *arrays = map(address, (torques_if_any(self.plant), q, qd, taus))
        return partial(self.library.rollout, effects, *steps, *arrays)

    def _calls(self, work: Work) -> Iterator[Side]:
        given = [np.array(x) for x in work.arguments(self.quantity)]
        out, result = self._results(1)
        buffer, evaluate = self.external.buffer()
        for k, x in enumerate(given):
            buffer.set_arg(k, x.data)
        buffer.set_res(0, out.data)
        self.kept.append((given, buffer))
        yield Side('CasADi C, buffer()', evaluate, lambda: result().ravel(), contents=BUFFER)

    def _batches(self, work: Work) -> Iterator[Side]:
        given = [np.ascontiguousarray(x) for x in work.arguments(self.quantity)]
        out, result = self._results(work.units)
        at = (ctypes.c_void_p * len(given))(*(x.ctypes.data for x in given))
        self.kept.append((given, at))
        run = partial(self.library.batch, ctypes.c_longlong(work.units), at, address(out))
        yield Side('CasADi C, loop in C', run, result, contents=LOOP)

    def _rollouts(self, work: Work) -> Iterator[Side]:
        yield simulation_side('CasADi C, RK4 in C', work, self.rollout, LOOP)

    def _results(self, states: int) -> tuple[Array, Callable[[], Array]]:
        """Return an array for results, and a function that returns them as (states, size)."""
        rows, columns = self.shape
        out = np.empty((states, columns, rows))
        self.kept.append(out)
        return out, lambda: out.transpose(0, 2, 1).reshape(states, -1)


def _compiled(arm: Any, n: int, forward: bool) -> tuple[ctypes.CDLL, Any]:
    """Return the library of CasADi's function and its loops, and CasADi's own view of it."""
    generator = casadi.CodeGenerator('arm.c')
    generator.add(arm)
    sizes = {'N': n, 'ARGUMENTS': arm.n_in(), 'ELEMENTS': arm.numel_out(0)}
    sizes |= {'SZ_ARG': arm.sz_arg(), 'SZ_RES': arm.sz_res()}
    sizes |= {'SZ_IW': arm.sz_iw() + 1, 'SZ_W': arm.sz_w() + 1}
    defines = [f'#define {name} {size}' for name, size in sizes.items()]
    defines += ['#define FORWARD'] * forward
    with built(C, '\n'.join([generator.dump(), *defines, text('casadi.c')])) as path:
        return ctypes.CDLL(str(path)), casadi.external('arm', str(path))
