# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio as a contender, called from Python, made from the numbers of our own robot.

Both sides then compute with the same angles, without the rounding of a URDF. Pinocchio is
installed by the extra `peers`, and skipped if absent.

A function of a quantity other than forward dynamics leaves its result in Pinocchio's data or
returns it; copying it out is not timed, and neither is filling the lower triangle of a symmetric
matrix, which Pinocchio leaves at zero. Of these only inverse dynamics has a function for batches;
the others are a loop in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pfd_core.model import Plant, Robot
from pfd_core.report.cases.quantities import LINEAR_STEP, linear_rk4
from pfd_core.report.cases.robots import Array, joint_frames
from pfd_core.report.contenders.work import (
    STEP_SIZE,
    Contender,
    Contents,
    Side,
    Work,
    installed,
    one_by_one,
)

Evaluation = Callable[[Array, Array, Array], Array]
Differentiation = Callable[[Array, Array, Array], tuple[Array, Array]]

THREADS = (1, 2)
CODE = 'C++ for any robot, as in the wheel'
SINGLE = Contents(CODE, 'Python')
SEVERAL = Contents(CODE, 'Python, four calls')
LOOP = Contents(CODE, 'Python, once', 'C++')
PYTHON_LOOP = Contents(CODE, 'Python, for each state', 'Python')
NUMPY_LOOP = Contents(CODE, 'Python, four times a step', 'Python, sums in NumPy')
# Names of the ways to accelerations on pages of errors, and in tables of times.
EVALUATIONS = {
    'Pinocchio aba': 'pinocchio.aba',
    'Pinocchio aba, WORLD': 'pinocchio.aba WORLD',
    'Pinocchio crba': 'pinocchio crba + Cholesky',
}


def _copied(run: Callable[[], Array]) -> Array:
    return np.array(run())


class Pinocchio(Contender):
    """
    Pinocchio's model and dynamics of one robot; rotor inertia is off, as it is on our side.

    The ways are aba, and crba with Cholesky; a Python loop over aba; and abaInParallel.
    """

    def __init__(self, robot: Robot) -> None:
        pin = self.pin = installed('pinocchio')
        self.model = pin.Model()
        for i, (R, p, center, J) in enumerate(joint_frames(robot)):
            axis = (
                pin.JointModelPZ() if robot.joint_types[i] == 'prismatic' else pin.JointModelRZ()
            )
            joint = self.model.addJoint(i, axis, pin.SE3(R, p), robot.joint_names[i])
            body = pin.Inertia(float(robot.masses[i]), center, J)
            self.model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        tip = robot.frame()
        placement = pin.SE3(robot.rotations[-1], robot.translations[-1])
        placement *= pin.SE3(tip.rotation, tip.translation)
        frame = pin.Frame(robot.tip, robot.n, 0, placement, pin.FrameType.OP_FRAME)
        # The index of the tip's frame, the only one besides the world's.
        self.tip = self.model.addFrame(frame)
        self.data = self.model.createData()

    def evaluations(self) -> dict[str, Evaluation]:
        """Return the ways to qdd (n,) from q, qd and tau; a result may lie in Pinocchio's data."""
        pin, model, data = self.pin, self.model, self.data

        def world(q: Array, qd: Array, tau: Array) -> Array:
            result: Array = pin.aba(model, data, q, qd, tau, pin.Convention.WORLD)
            return result

        def crba(q: Array, qd: Array, tau: Array) -> Array:
            pin.crba(model, data, q)
            y = tau - pin.nonLinearEffects(model, data, q, qd)
            pin.cholesky.decompose(model, data)
            result: Array = pin.cholesky.solve(model, data, y)
            return result

        return {
            'pinocchio.aba': partial(pin.aba, model, data),
            'pinocchio.aba WORLD': world,
            'pinocchio crba + Cholesky': crba,
        }

    def answers(self, plant: Plant) -> dict[str, Evaluation]:
        """Return the ways to qdd by their names in EVALUATIONS, from now on of this plant."""
        self.model.gravity.linear = plant.robot.base_rotation @ plant.gravity
        if plant.armature is not None:
            self.model.armature = np.array(plant.armature)
        known = self.evaluations()
        return {name: known[way] for name, way in EVALUATIONS.items()}

    def _calls(self, work: Work) -> Iterator[Side]:
        for name, evaluate in self.evaluations().items():
            run = partial(evaluate, *work.arrays)
            yield Side(
                name,
                run,
                partial(_copied, run),
                reference=name == 'pinocchio.aba',
                contents=SINGLE if 'aba' in name else SEVERAL,
            )

    def _rollouts(self, work: Work) -> Iterator[Side]:
        aba = partial(self.pin.aba, self.model, self.data)
        end = np.empty_like(work.q)
        h = STEP_SIZE

        def run() -> None:
            x, v, tau = work.q, work.qd, work.tau
            for _ in range(work.steps):
                a1 = aba(x, v, tau).copy()
                v2 = v + h / 2 * a1
                a2 = aba(x + h / 2 * v, v2, tau).copy()
                v3 = v + h / 2 * a2
                a3 = aba(x + h / 2 * v2, v3, tau).copy()
                v4 = v + h * a3
                a4 = aba(x + h * v3, v4, tau)
                x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
                v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            end[:] = x

        way = 'Python loop over pinocchio.aba'
        yield Side(way, run, lambda: end, reference=True, contents=NUMPY_LOOP)

    def _batches(self, work: Work) -> Iterator[Side]:
        columns = [np.asfortranarray(x.T) for x in work.arrays]
        # One state cannot be shared out.
        for threads in THREADS if work.units > 1 else THREADS[:1]:
            pool = self.pin.ModelPool(self.model, threads)
            out = np.empty_like(columns[0])
            yield Side(
                f'pinocchio.abaInParallel, {threads} thread{"s" * (threads > 1)}',
                partial(self.pin.abaInParallel, threads, pool, *columns, out),
                partial(np.transpose, out),
                reference=threads == 1,
                wanted=partial(self.one_by_one, work),
                contents=LOOP,
            )

    def one_by_one(self, work: Work) -> Array:
        """Return aba's result: abaInParallel works in the world frame, and loses digits there."""
        aba = partial(self.pin.aba, self.model, self.data)
        return np.array([aba(*state).copy() for state in zip(*work.arrays, strict=True)])


@dataclass(frozen=True)
class Function:
    """
    A function of Pinocchio.

    Attributes
    ----------
    name : str
        Name in a table.
    bound_to : callable
        Returns, for a peer, a function of the arguments of one state, (n,) each.
    result : callable
        Returns the quantity from a peer and the value that the function has returned.

    """

    name: str
    bound_to: Callable[[Pinocchio], Callable[..., Any]]
    result: Callable[[Pinocchio, Any], Array]


def _returned(_: Pinocchio, returned: Any) -> Array:
    return np.array(returned)


def _named(name: str, result: Callable[[Pinocchio, Any], Array] | None = None) -> Function:
    """Return the function of model, data and the arguments that has this name in Pinocchio."""
    return Function(
        f'pinocchio.{name}',
        lambda peer: partial(getattr(peer.pin, name), peer.model, peer.data),
        result or _returned,
    )


def symmetric(upper: Array) -> Array:
    """Return a matrix from its upper triangle."""
    result: Array = np.triu(upper) + np.triu(upper, 1).T
    return result


def _jacobian(peer: Pinocchio) -> Callable[..., Any]:
    pin = peer.pin
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    function, model, data, tip = pin.computeFrameJacobian, peer.model, peer.data, peer.tip
    return lambda q: function(model, data, q, tip, axes)


def _derivatives(peer: Pinocchio, returned: Any) -> Array:
    by_q, by_qd, by_tau = returned
    return np.hstack([by_q, by_qd, symmetric(by_tau)])


def acceleration_and_derivatives(peer: Pinocchio) -> Differentiation:
    """Return computeABADerivatives as qdd, (n,), and d qdd / d (q, qd, tau), (n, 3n), reused."""
    function, model, data = peer.pin.computeABADerivatives, peer.model, peer.data
    n = model.nv
    J = np.empty((n, 3 * n))
    by_q, by_qd, by_tau = J[:, :n], J[:, n : 2 * n], J[:, 2 * n :]
    lower = np.tril_indices(n, -1)

    def evaluate(q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        by_q[...], by_qd[...], by_tau[...] = function(model, data, q, qd, tau)
        by_tau[lower] = by_tau.T[lower]
        return data.ddq, J

    return evaluate


def _linear_step(peer: Pinocchio) -> Callable[..., Any]:
    evaluate = acceleration_and_derivatives(peer)
    return lambda q, qd, tau: linear_rk4(evaluate, q, qd, tau, LINEAR_STEP)


PINOCCHIO = {
    'inverse_dynamics': _named('rnea'),
    'inertia_matrix': _named('crba', lambda peer, returned: symmetric(returned)),
    'bias_torques': _named('nonLinearEffects'),
    'gravity_torques': _named('computeGeneralizedGravity'),
    'tip_pose': _named(
        'framesForwardKinematics', lambda peer, _: np.array(peer.data.oMf[peer.tip].homogeneous)
    ),
    'tip_jacobian': Function('pinocchio.computeFrameJacobian', _jacobian, _returned),
    'derivatives': _named('computeABADerivatives', _derivatives),
    'linear_step': Function('pinocchio.computeABADerivatives and NumPy', _linear_step, _returned),
}


class PinocchioQuantity(Contender):
    """
    Pinocchio's function of one quantity of a robot.

    The ways are a call, a loop in Python, and for inverse dynamics rneaInParallel.
    """

    def __init__(self, robot: Robot, quantity: str) -> None:
        self.quantity, self.peer = quantity, Pinocchio(robot)
        self.function = PINOCCHIO[quantity]
        self.run = self.function.bound_to(self.peer)

    def _evaluate(self, *state: Array) -> Array:
        return np.array(self.function.result(self.peer, self.run(*state))).ravel()

    def _calls(self, work: Work) -> Iterator[Side]:
        given = [x.copy() for x in work.arguments(self.quantity)]
        run, result = partial(self.run, *given), partial(self._evaluate, *given)
        yield Side(self.function.name, run, result, reference=True, contents=SINGLE)

    def _batches(self, work: Work) -> Iterator[Side]:
        given = [np.ascontiguousarray(x) for x in work.arguments(self.quantity)]
        rows = list(zip(*given, strict=True))
        yield Side(
            f'Python loop over {self.function.name}',
            partial(one_by_one, self.run, rows),
            lambda: np.array([self._evaluate(*row) for row in rows]),
            reference=True,
            contents=PYTHON_LOOP,
        )
        if self.quantity == 'inverse_dynamics':
            pin = self.peer.pin
            pool = pin.ModelPool(self.peer.model, 1)
            columns = [np.asfortranarray(x.T) for x in given]
            out = np.empty_like(columns[0])
            yield Side(
                'pinocchio.rneaInParallel, 1 thread',
                partial(pin.rneaInParallel, 1, pool, *columns, out),
                partial(np.transpose, out),
                contents=LOOP,
            )
