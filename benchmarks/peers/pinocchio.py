# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio as a peer, from Python and in C++, made from the numbers of our own robot.

Both sides then compute with the same angles, without the rounding of a URDF. From Python, copying
a result out of Pinocchio's data is not timed, and neither is filling the lower triangle of a
symmetric matrix, which Pinocchio leaves at zero.

In C++ all loops are in data/pinocchio.cpp, which is compiled once for its processor, against the
headers of the installed Pinocchio. Pinocchio's wheel brings the headers of Boost. Eigen's headers
come with the wheel cmeel-eigen (extra `peers`) or with a system's package, libeigen3-dev.
Pinocchio's own shared library, which is compiled for any processor, is not linked.
"""

from __future__ import annotations

from collections.abc import Iterator
import ctypes
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.cases.problems import FORWARD
from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.native import OPTIMISED, address, built, joint_torques
from benchmarks.peers.work import SINE, Arguments, Peer, Side, installed, is_batch, plant_of
from benchmarks.table import stored_text
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot

CODE = 'C++ for any robot, as in the wheel'
# Quantity to the name of a function of model, data and the arguments, and one for batches.
FUNCTIONS = {
    FORWARD: ('aba', 'abaInParallel'),
    'inverse_dynamics': ('rnea', 'rneaInParallel'),
    'inertia_matrix': ('crba', None),
    'bias_torques': ('nonLinearEffects', None),
    'derivatives': ('computeABADerivatives', None),
}


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
        """Yield a call, or for a batch the function of batches, or a loop over calls."""
        wanted = partial(self.results, given)
        if not is_batch(given):
            contents = f'{CODE}; called from Python; {SINE}'
            yield Side(self.name, partial(self.evaluate, *given), wanted, contents)
        elif self.in_parallel:
            columns = [np.asfortranarray(x.T) for x in given]
            out, pool = np.empty_like(columns[0]), self.pin.ModelPool(self.model, 1)
            yield Side(
                f'pinocchio.{self.in_parallel}, 1 thread',
                partial(getattr(self.pin, self.in_parallel), 1, pool, *columns, out),
                partial(np.transpose, out),
                f'{CODE}; called once from Python, loop in C++; {SINE}',
            )
        else:
            rows = list(zip(*given, strict=True))

            def run() -> None:
                for row in rows:
                    self.evaluate(*row)

            contents = f'{CODE}; called from Python for each state; {SINE}'
            yield Side(f'Python loop over {self.name}', run, wanted, contents)


def _symmetric(upper: Array) -> Array:
    """Return a matrix from its upper triangle."""
    result: Array = np.triu(upper) + np.triu(upper, 1).T
    return result


# ---- in C++ ----

CPP = 'Pinocchio C++'
# Definitions of Pinocchio's own CMake files, and one for Boost: a variant may be queried for types
# that it does not have.
DEFINES = (
    'BOOST_MPL_LIMIT_LIST_SIZE=30',
    'BOOST_MPL_LIMIT_VECTOR_SIZE=30',
    'BOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
    'BOOST_FUSION_INVOKE_MAX_ARITY=12',
    'BOOST_VARIANT_USE_RELAXED_GET_BY_DEFAULT',
)
COMPILED = f'C++ for any robot, g++ {" ".join(OPTIMISED)}'
# Functions of data/pinocchio.cpp from states to accelerations, with their names in a table.
COMPILED_FUNCTIONS = {
    'aba': f'{CPP} aba',
    'aba_world': f'{CPP} aba, WORLD',
    'crba': f'{CPP} crba + Cholesky',
}


def compiled_model(
    robot: Robot | Plant, width: float = 0.0
) -> tuple[ctypes.CDLL, ctypes.c_void_p]:
    """
    Return data/pinocchio.cpp, compiled, and a model and its data, which live until the end.

    The model has gravity, rotors, damping, friction and limits; friction rises to its full torque
    at a velocity of `width` [rad/s].
    """
    plant = plant_of(robot)
    arm = plant.robot
    frames = (np.array(x) for x in zip(*joint_frames(arm), strict=True))
    rotations, origins, centers, inertias = frames
    kinds = np.array([kind == 'prismatic' for kind in arm.joint_types], np.int32)
    # In the axes of the world, in which joint_frames are.
    gravity = arm.base_rotation @ plant.gravity
    numbers = [rotations, origins, arm.masses, centers, inertias, gravity]
    optional = [plant.inertia, joint_torques(plant, width)]
    given = [None if x is None else np.ascontiguousarray(x) for x in (*numbers, *optional)]
    library = _library()
    made = library.make(arm.n, address(kinds), *map(address, given))
    return library, ctypes.c_void_p(made)


def pinocchio_cpp(robot: Robot) -> Peer:
    """Return forward dynamics of a robot, with a way for each function."""
    library, arm = compiled_model(robot)

    def sides(given: Arguments) -> Iterator[Side]:
        once = ' once, loop in C++' if is_batch(given) else ''
        arrays = [np.ascontiguousarray(x) for x in given]
        for function, name in COMPILED_FUNCTIONS.items():
            out = np.empty_like(arrays[0])
            count = ctypes.c_longlong(len(out) if is_batch(given) else 1)
            run = partial(getattr(library, function), arm, count, *map(address, (*arrays, out)))
            contents = f'{COMPILED}; called by ctypes{once}; {SINE}'
            yield Side(name, run, partial(np.asarray, out), contents)

    return sides


@cache
def _library() -> ctypes.CDLL:
    """Return data/pinocchio.cpp, compiled and loaded; LeftOutError has the reason if not."""
    pin = installed('pinocchio')
    # PREFIX/lib/pythonX.Y/site-packages/pinocchio/__init__.py
    prefix = Path(pin.__file__).resolve().parents[4] / 'include'
    folders = (prefix, prefix / 'eigen3', Path('/usr/include/eigen3'))
    options = [f'-D{define}' for define in (*DEFINES, f'PINOCCHIO_{pin.__version__}')]
    options += [f'-isystem{folder}' for folder in folders if folder.is_dir()]
    standard = ('-std=c++17', '-DNDEBUG', '-w')
    with built('g++', '.cpp', stored_text('pinocchio.cpp'), *standard, *options) as path:
        library = ctypes.CDLL(path)
    library.make.restype = ctypes.c_void_p
    return library
