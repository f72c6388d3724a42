# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio as a peer, called from Python, made from the numbers of our own robot.

Both sides then compute with the same angles, without the rounding of a URDF.

A function of a quantity other than forward dynamics leaves its result in Pinocchio's data or
returns it; copying it out is not timed, and neither is filling the lower triangle of a symmetric
matrix, which Pinocchio leaves at zero. Of these only inverse dynamics has a function for batches;
the others are a loop in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases.quantities import LINEAR_STEP, linear_rk4
from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.work import STEP_SIZE, Contents, Peer, Side, Work, installed, one_by_one
from pfd_core.model import Plant, Robot

Evaluation = Callable[[Array, Array, Array], Array]
Differentiation = Callable[[Array, Array, Array], tuple[Array, Array]]

THREADS = (1, 2)
# States of the largest batch in a loop in Python.
MOST_IN_PYTHON = 4096
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


class Pinocchio(Peer):
    """
    Pinocchio's model and dynamics of one robot; rotor inertia is off, as it is on our side.

    The ways are aba, and crba with Cholesky; a Python loop over aba; and abaInParallel.
    """

    def __init__(self, robot: Robot) -> None:
        pin = self.pin = installed('pinocchio')
        self.model = pin.Model()
        for i, (R, p, center, J) in enumerate(joint_frames(robot)):
            slides = robot.joint_types[i] == 'prismatic'
            axis = pin.JointModelPZ() if slides else pin.JointModelRZ()
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

        aba: Evaluation = partial(pin.aba, model, data)
        return dict(zip(EVALUATIONS.values(), (aba, world, crba), strict=True))

    def answers(self, plant: Plant) -> dict[str, Evaluation]:
        """Return the ways to qdd by their names in EVALUATIONS, from now on of this plant."""
        self.model.gravity.linear = plant.robot.base_rotation @ plant.gravity
        if plant.armature is not None:
            self.model.armature = np.array(plant.armature)
        return dict(zip(EVALUATIONS, self.evaluations().values(), strict=True))

    def one_by_one(self, work: Work) -> Array:
        """Return aba's result: abaInParallel works in the world frame, and loses digits there."""
        aba = partial(self.pin.aba, self.model, self.data)
        return np.array([aba(*state).copy() for state in zip(*work.arrays, strict=True)])

    def _calls(self, work: Work) -> Iterator[Side]:
        for name, evaluate in self.evaluations().items():
            run, contents = partial(evaluate, *work.arrays), SINGLE if 'aba' in name else SEVERAL
            result = partial(_copied, run)
            yield Side(name, run, result, name == 'pinocchio.aba', contents=contents)

    def _rollouts(self, work: Work) -> Iterator[Side]:
        aba, end, h = partial(self.pin.aba, self.model, self.data), [work.q], STEP_SIZE

        def run() -> None:
            x, v, tau = work.arrays
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
            end[0] = x

        way = 'Python loop over pinocchio.aba'
        yield Side(way, run, lambda: end[0], reference=True, contents=NUMPY_LOOP)

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
        if work.units <= MOST_IN_PYTHON:
            aba = partial(self.pin.aba, self.model, self.data)
            run = partial(one_by_one, aba, list(zip(*work.arrays, strict=True)))
            result = partial(self.one_by_one, work)
            yield Side('Python loop over pinocchio.aba', run, result, contents=PYTHON_LOOP)


def _copied(run: Callable[[], Array]) -> Array:
    return np.array(run())


def symmetric(upper: Array) -> Array:
    """Return a matrix from its upper triangle."""
    result: Array = np.triu(upper) + np.triu(upper, 1).T
    return result


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


def _jacobian(peer: Pinocchio) -> Callable[..., Any]:
    function, model, data, tip = peer.pin.computeFrameJacobian, peer.model, peer.data, peer.tip
    axes = peer.pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    return lambda q: function(model, data, q, tip, axes)


# Quantity to the name of a function of model, data and the arguments.
FUNCTIONS = {
    'inverse_dynamics': 'rnea',
    'inertia_matrix': 'crba',
    'bias_torques': 'nonLinearEffects',
    'gravity_torques': 'computeGeneralizedGravity',
    'tip_pose': 'framesForwardKinematics',
    'tip_jacobian': 'computeFrameJacobian',
    'derivatives': 'computeABADerivatives',
    'linear_step': 'computeABADerivatives and NumPy',
}
# Functions that take more, and results that differ from what a function returns.
MAKERS = {'tip_jacobian': _jacobian, 'linear_step': _linear_step}
RESULTS: dict[str, Callable[[Pinocchio, Any], Array]] = {
    'inertia_matrix': lambda peer, found: symmetric(found),
    'tip_pose': lambda peer, _: np.array(peer.data.oMf[peer.tip].homogeneous),
    'derivatives': lambda peer, found: np.hstack([*found[:2], symmetric(found[2])]),
}


class PinocchioQuantity(Peer):
    """
    Pinocchio's function of one quantity of a robot.

    The ways are a call, a loop in Python, and for inverse dynamics rneaInParallel.
    """

    def __init__(self, robot: Robot, quantity: str) -> None:
        self.quantity, self.peer = quantity, Pinocchio(robot)
        self.name = f'pinocchio.{FUNCTIONS[quantity]}'
        if quantity in MAKERS:
            self.run = MAKERS[quantity](self.peer)
        else:
            function = getattr(self.peer.pin, FUNCTIONS[quantity])
            self.run = partial(function, self.peer.model, self.peer.data)

    def _evaluate(self, *state: Array) -> Array:
        found = self.run(*state)
        result = RESULTS[self.quantity](self.peer, found) if self.quantity in RESULTS else found
        return np.array(result).ravel()

    def _calls(self, work: Work) -> Iterator[Side]:
        given = [x.copy() for x in work.arguments(self.quantity)]
        run, result = partial(self.run, *given), partial(self._evaluate, *given)
        yield Side(self.name, run, result, reference=True, contents=SINGLE)

    def _batches(self, work: Work) -> Iterator[Side]:
        given = [np.ascontiguousarray(x) for x in work.arguments(self.quantity)]
        rows = list(zip(*given, strict=True))
        run, way = partial(one_by_one, self.run, rows), f'Python loop over {self.name}'
        result = partial(np.array, [self._evaluate(*row) for row in rows])
        yield Side(way, run, result, reference=True, contents=PYTHON_LOOP)
        if self.quantity == 'inverse_dynamics':
            pin = self.peer.pin
            pool = pin.ModelPool(self.peer.model, 1)
            columns = [np.asfortranarray(x.T) for x in given]
            out = np.empty_like(columns[0])
            run = partial(pin.rneaInParallel, 1, pool, *columns, out)
            way, result = 'pinocchio.rneaInParallel, 1 thread', partial(np.transpose, out)
            yield Side(way, run, result, contents=LOOP)
