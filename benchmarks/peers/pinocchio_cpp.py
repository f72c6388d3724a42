# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio's C++ without Python, as a peer: all loops are in data/pinocchio.cpp.

The file is compiled once for its processor, against the headers of the installed Pinocchio.
Pinocchio's wheel brings the headers of Boost. Eigen's headers come with the wheel cmeel-eigen
(extra `peers`) or with a system's package, libeigen3-dev. Pinocchio's own shared library, which is
compiled for any processor, is not linked.
"""

from __future__ import annotations

from collections.abc import Iterator
import ctypes
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.cases.robots import joint_frames
from benchmarks.peers.native import OPTIMISED, address, built, joint_torques
from benchmarks.peers.work import SINE, Arguments, Peer, Side, installed, is_batch, plant_of
from benchmarks.table import stored_text
from pfd_core.model import Plant, Robot

NAME = 'Pinocchio C++'
# Definitions of Pinocchio's own CMake files, and one for Boost: a variant may be queried for types
# that it does not have.
DEFINES = (
    'BOOST_MPL_LIMIT_LIST_SIZE=30',
    'BOOST_MPL_LIMIT_VECTOR_SIZE=30',
    'BOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
    'BOOST_FUSION_INVOKE_MAX_ARITY=12',
    'BOOST_VARIANT_USE_RELAXED_GET_BY_DEFAULT',
)
CODE = f'C++ for any robot, g++ {" ".join(OPTIMISED)}'
# Functions of data/pinocchio.cpp from states to accelerations, with their names in a table.
FUNCTIONS = {
    'aba': f'{NAME} aba',
    'aba_world': f'{NAME} aba, WORLD',
    'crba': f'{NAME} crba + Cholesky',
    'aba_refined': f'{NAME} aba refined',
}


def model(robot: Robot | Plant, width: float = 0.0) -> tuple[ctypes.CDLL, ctypes.c_void_p]:
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
    library, arm = model(robot)

    def sides(given: Arguments) -> Iterator[Side]:
        once = ' once, loop in C++' if is_batch(given) else ''
        arrays = [np.ascontiguousarray(x) for x in given]
        for function, name in FUNCTIONS.items():
            out = np.empty_like(arrays[0])
            count = ctypes.c_longlong(len(out) if is_batch(given) else 1)
            run = partial(getattr(library, function), arm, count, *map(address, (*arrays, out)))
            contents = f'{CODE}; called by ctypes{once}; {SINE}'
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
