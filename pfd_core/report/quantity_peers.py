# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio's functions for quantities other than forward dynamics, called from Python.

A function leaves its result in Pinocchio's data or returns it; copying it out is not timed, and
neither is filling the lower triangle of a symmetric matrix, which Pinocchio leaves at zero. Only
inverse dynamics has a function for batches; the others are a loop in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pfd_core.model import Robot
from pfd_core.report.peers import Pinocchio
from pfd_core.report.quantity_kernels import LINEAR_STEP, arguments, linear_rk4
from pfd_core.report.timing import Array, Side, Work


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


def _linear_step(peer: Pinocchio) -> Callable[..., Any]:
    function, model, data = peer.pin.computeABADerivatives, peer.model, peer.data
    n = model.nv
    J = np.empty((n, 3 * n))
    by_q, by_qd, by_tau = J[:, :n], J[:, n : 2 * n], J[:, 2 * n :]
    lower = np.tril_indices(n, -1)

    def evaluate(q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        by_q[...], by_qd[...], by_tau[...] = function(model, data, q, qd, tau)
        by_tau[lower] = by_tau.T[lower]
        return data.ddq, J

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


class PinocchioQuantity:
    """Pinocchio's function of one quantity of a robot, as a contender."""

    def __init__(self, quantity: str, robot: Robot) -> None:
        self.quantity, self.peer = quantity, Pinocchio(robot)
        self.function = PINOCCHIO[quantity]
        self.run = self.function.bound_to(self.peer)

    def sides(self, work: Work) -> Iterator[Side]:
        """Return a call, a loop in Python, and for inverse dynamics rneaInParallel."""
        return self._calls(work) if work.kind == 'call' else self._batches(work)

    def _evaluate(self, *state: Array) -> Array:
        return np.array(self.function.result(self.peer, self.run(*state))).ravel()

    def _calls(self, work: Work) -> Iterator[Side]:
        given = [x.copy() for x in arguments(self.quantity, work)]
        yield Side(
            self.function.name,
            partial(self.run, *given),
            partial(self._evaluate, *given),
            reference=True,
        )

    def _batches(self, work: Work) -> Iterator[Side]:
        given = [np.ascontiguousarray(x) for x in arguments(self.quantity, work)]
        rows = list(zip(*given, strict=True))
        yield Side(
            f'Python loop over {self.function.name}',
            partial(_one_by_one, self.run, rows),
            lambda: np.array([self._evaluate(*row) for row in rows]),
            reference=True,
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
            )


def _one_by_one(evaluate: Callable[..., Any], rows: list[tuple[Array, ...]]) -> None:
    for row in rows:
        evaluate(*row)
