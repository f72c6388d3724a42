# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio as a peer, called from Python, made from the numbers of our own robot.

Both sides then compute with the same angles, without the rounding of a URDF. Copying a result out
of Pinocchio's data is not timed, and neither is filling the lower triangle of a symmetric matrix,
which Pinocchio leaves at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from benchmarks.cases.quantities import FORWARD
from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.work import SINE, STEP_SIZE, Side, Work, installed, plant_of
from pfd_core.model import Plant, Robot

THREADS = (1, 2)
# States of the largest batch in a loop in Python.
MOST_IN_PYTHON = 4096
CODE = 'C++ for any robot, as in the wheel'
# Quantity to the name of a function of model, data and the arguments, and one for batches.
FUNCTIONS = {
    FORWARD: ('aba', 'abaInParallel'),
    'inverse_dynamics': ('rnea', 'rneaInParallel'),
    'inertia_matrix': ('crba', None),
    'bias_torques': ('nonLinearEffects', None),
    'derivatives': ('computeABADerivatives', None),
}
LOOP = 'Python loop'


class Pinocchio:
    """
    Pinocchio's function of one quantity of a robot, or of a plant with its gravity and rotors.

    The ways are a call, a Python loop over it, and a function for batches where there is one.
    """

    def __init__(self, robot: Robot | Plant, quantity: str = FORWARD) -> None:
        pin, plant = installed('pinocchio'), plant_of(robot)
        arm, model = plant.robot, pin.Model()
        for i, (R, p, center, J) in enumerate(joint_frames(arm)):
            slides = arm.joint_types[i] == 'prismatic'
            axis = pin.JointModelPZ() if slides else pin.JointModelRZ()
            joint = model.addJoint(i, axis, pin.SE3(R, p), arm.joint_names[i])
            body = pin.Inertia(float(arm.masses[i]), center, J)
            model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        model.gravity.linear = arm.base_rotation @ plant.gravity
        if plant.armature is not None:
            model.armature = np.array(plant.armature)
        self.pin, self.model, self.data = pin, model, model.createData()
        self.quantity = quantity
        name, self.in_parallel = FUNCTIONS[quantity]
        self.name = f'pinocchio.{name}'
        # Its result may lie in Pinocchio's data.
        self.evaluate = partial(getattr(pin, name), model, self.data)

    def result(self, *state: Array) -> Array:
        """Return the entries of the quantity at a state, (size,)."""
        found = self.evaluate(*state)
        if self.quantity == 'inertia_matrix':
            found = _symmetric(found)
        elif self.quantity == 'derivatives':
            found = np.hstack([*found[:2], _symmetric(found[2])])
        return np.array(found).ravel()

    def wanted(self, work: Work) -> Array:
        """Return the result of a work, state by state: the reference of all peers."""
        if work.kind == 'batch':
            return np.array([self.result(*state) for state in zip(*work.arrays, strict=True)])
        return self._rollout(work) if work.kind == 'rollout' else self.result(*work.arrays)

    def acceleration_and_derivatives(self, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        """Return qdd, (n,), and d qdd / d (q, qd, tau), (n, 3n), of the quantity derivatives."""
        J = self.result(q, qd, tau).reshape(len(q), -1)
        return np.array(self.data.ddq), J

    def _rollout(self, work: Work) -> Array:
        (x, v, tau), aba, h = work.arrays, self.evaluate, STEP_SIZE
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
        return x

    def sides(self, work: Work) -> Iterator[Side]:
        """Yield the ways of a work; the first is the reference."""
        wanted, given = partial(self.wanted, work), work.arrays
        if work.kind == 'call':
            contents = f'{CODE}; called from Python; {SINE}'
            yield Side(self.name, partial(self.evaluate, *given), wanted, contents, True)
            if self.quantity == FORWARD:
                world = partial(self.evaluate, *given, self.pin.Convention.WORLD)
                yield Side(f'{self.name} WORLD', world, lambda: np.array(world()), contents)
            return
        way = f'{LOOP} over {self.name}'
        if work.kind == 'rollout':
            contents = f'{CODE}; four calls from Python a step, sums in NumPy; {SINE}'
            yield Side(way, wanted, wanted, contents, True)
            return
        if self.in_parallel:
            yield from self._parallel_sides(work, getattr(self.pin, self.in_parallel))
        if work.units <= MOST_IN_PYTHON:
            rows = list(zip(*given, strict=True))

            def run() -> None:
                for row in rows:
                    self.evaluate(*row)

            contents = f'{CODE}; called from Python for each state; {SINE}'
            yield Side(way, run, wanted, contents, not self.in_parallel)

    def _parallel_sides(self, work: Work, function: Callable[..., object]) -> Iterator[Side]:
        columns = [np.asfortranarray(x.T) for x in work.arrays]
        # One state cannot be shared out.
        for threads in THREADS if work.units > 1 else THREADS[:1]:
            out, pool = np.empty_like(columns[0]), self.pin.ModelPool(self.model, threads)
            yield Side(
                f'pinocchio.{self.in_parallel}, {threads} thread{"s" * (threads > 1)}',
                partial(function, threads, pool, *columns, out),
                partial(np.transpose, out),
                f'{CODE}; called once from Python, loop in C++; {SINE}',
                threads == 1,
            )


def _symmetric(upper: Array) -> Array:
    """Return a matrix from its upper triangle."""
    result: Array = np.triu(upper) + np.triu(upper, 1).T
    return result
