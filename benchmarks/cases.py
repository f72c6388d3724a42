# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the speed benchmark compares: ours and a peer's way of doing the same work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import pfd_core as pfd

ROBOTS = ('puma560', 'ur5', 'panda')
BATCH = 4096
STEPS = 200


@dataclass(frozen=True)
class Case:
    """
    One comparison.

    Attributes
    ----------
    robot, work : str
        Which arm, and what is done.
    ours, peer : callable
        The same work, without arguments.
    units : int
        Evaluations or steps in one call of either.
    error : float
        Largest difference of the two results, relative to the largest element.

    """

    robot: str
    work: str
    ours: Callable[[], object]
    peer: Callable[[], object]
    units: int
    error: float


def pinocchio_model(robot: pfd.Robot) -> pin.Model:
    """Return the same robot in Pinocchio, with positions that are angles."""
    model = pin.Model()
    placement = pin.SE3(robot.base_rotation, robot.base_position)
    for i, kind in enumerate(robot.joint_types):
        axis = pin.JointModelPZ() if kind == 'prismatic' else pin.JointModelRZ()
        joint = model.addJoint(i, axis, placement, robot.joint_names[i])
        placement = pin.SE3(robot.rotations[i], robot.translations[i])
        body = pin.Inertia(float(robot.masses[i]), robot.centers[i], robot.inertias[i])
        model.appendBodyToJoint(joint, body, placement)
    return model


def cases(name: str) -> Iterator[Case]:
    """Yield the comparisons for one robot; rotor inertia is off on both sides."""
    robot = pfd.load_robot(name)
    model = pinocchio_model(robot)
    data = model.createData()
    kernel = pfd.compile_kernel(robot)
    rng = np.random.default_rng(1)
    states = [rng.uniform(-2, 2, (BATCH, robot.n)) for _ in range(3)]
    q, qd, tau = (x[0].copy() for x in states)
    out = np.empty(robot.n)

    def aba() -> object:
        return pin.aba(model, data, q, qd, tau)

    error = _relative(kernel(q, qd, tau), aba())
    yield Case(name, 'call', lambda: kernel(q, qd, tau), aba, 1, error)
    yield Case(name, 'call, out=', lambda: kernel(q, qd, tau, out=out), aba, 1, error)
    yield Case(name, 'bound call', kernel.bind(q, qd, tau, out), aba, 1, error)
    yield _rollout(name, robot, model, q)
    yield from _batches(name, kernel, model, states)


def _rollout(name: str, robot: pfd.Robot, model: pin.Model, q: np.ndarray) -> Case:
    """Compare native RK4 with the same RK4 in a Python loop over pinocchio.aba."""
    data = model.createData()
    sim = pfd.Simulator(robot, step_size=1e-3, substeps=1, integrator='rk4')
    taus = np.zeros((STEPS, robot.n))
    h = 1e-3

    def ours() -> np.ndarray:
        sim.reset(q)
        return sim.rollout(taus).q

    def peer() -> np.ndarray:
        x, v = q.copy(), np.zeros(robot.n)
        for tau in taus:
            a1 = pin.aba(model, data, x, v, tau).copy()
            v2 = v + h / 2 * a1
            a2 = pin.aba(model, data, x + h / 2 * v, v2, tau).copy()
            v3 = v + h / 2 * a2
            a3 = pin.aba(model, data, x + h / 2 * v2, v3, tau).copy()
            v4 = v + h * a3
            a4 = pin.aba(model, data, x + h * v3, v4, tau)
            x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        return x

    return Case(name, 'RK4 rollout', ours, peer, STEPS, _relative(ours()[-1], peer()))


def _batches(
    name: str, kernel: pfd.Kernel, model: pin.Model, states: list[np.ndarray]
) -> Iterator[Case]:
    """Compare batches in both orders of memory with abaInParallel on one thread."""
    pool = pin.ModelPool(model, 1)
    columns = [np.asfortranarray(x.T) for x in states]
    result = np.empty_like(columns[0], order='F')

    def peer() -> None:
        pin.abaInParallel(1, pool, *columns, result)

    peer()
    for order in 'CF':
        arrays = [np.asarray(x, order=order) for x in states]
        out = np.empty_like(arrays[0], order=order)
        error = _relative(kernel(*arrays), result.T)
        work = f'batch of {BATCH}, {order}-ordered'
        yield Case(name, work, lambda a=arrays, o=out: kernel(*a, out=o), peer, BATCH, error)


def _relative(found: object, wanted: object) -> float:
    wanted = np.asarray(wanted)
    return float(np.abs(np.asarray(found) - wanted).max() / np.abs(wanted).max())
