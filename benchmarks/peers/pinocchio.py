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
from benchmarks.peers.work import SINE, Arguments, Side, installed, is_batch, plant_of
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
    """Pinocchio's function of one quantity of a robot, or of a plant with gravity and rotors."""

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

    def results(self, given: Arguments) -> Array:
        """Return the quantity state by state, (size,) or (B, size): the reference of all peers."""
        if is_batch(given):
            return np.array([self.result(*state) for state in zip(*given, strict=True)])
        return self.result(*given)

    def acceleration_and_derivatives(self, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        """Return qdd, (n,), and d qdd / d (q, qd, tau), (n, 3n), of the quantity derivatives."""
        J = self.result(q, qd, tau).reshape(len(q), -1)
        return np.array(self.data.ddq), J

    def __call__(self, given: Arguments) -> Iterator[Side]:
        """Yield the ways: a call, or a loop over it, and the function for batches."""
        wanted = partial(self.results, given)
        if not is_batch(given):
            contents = f'{CODE}; called from Python; {SINE}'
            yield Side(self.name, partial(self.evaluate, *given), wanted, contents)
            if self.quantity == FORWARD:
                world = partial(self.evaluate, *given, self.pin.Convention.WORLD)
                yield Side(f'{self.name} WORLD', world, lambda: np.array(world()), contents)
            return
        if self.in_parallel:
            yield from self._parallel(given, getattr(self.pin, self.in_parallel))
        if len(given[0]) <= MOST_IN_PYTHON:
            rows = list(zip(*given, strict=True))

            def run() -> None:
                for row in rows:
                    self.evaluate(*row)

            contents = f'{CODE}; called from Python for each state; {SINE}'
            yield Side(f'{LOOP} over {self.name}', run, wanted, contents)

    def _parallel(self, given: Arguments, function: Callable[..., object]) -> Iterator[Side]:
        columns = [np.asfortranarray(x.T) for x in given]
        # One state cannot be shared out.
        for threads in THREADS if len(given[0]) > 1 else THREADS[:1]:
            out, pool = np.empty_like(columns[0]), self.pin.ModelPool(self.model, threads)
            yield Side(
                f'pinocchio.{self.in_parallel}, {threads} thread{"s" * (threads > 1)}',
                partial(function, threads, pool, *columns, out),
                partial(np.transpose, out),
                f'{CODE}; called once from Python, loop in C++; {SINE}',
            )


def _symmetric(upper: Array) -> Array:
    """Return a matrix from its upper triangle."""
    result: Array = np.triu(upper) + np.triu(upper, 1).T
    return result
