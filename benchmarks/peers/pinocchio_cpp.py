# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio's C++ without Python, as a peer: all loops are in data/pinocchio.cpp.

The file is compiled once in a process, for its processor, against the headers of the installed
Pinocchio. Pinocchio's wheel brings the headers of Boost. Eigen's headers come with the wheel
cmeel-eigen (extra `peers`) or with a system's package, libeigen3-dev. Pinocchio's own shared
library, which is compiled for any processor, is not linked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import ctypes
from functools import cache, partial
import importlib.util
from pathlib import Path
import weakref

import numpy as np

from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.native import CPP, address, built, torques_if_any
from benchmarks.peers.work import (
    Contents,
    LeftOutError,
    Peer,
    Side,
    Work,
    simulation_side,
)
from benchmarks.table import stored_text
from pfd_core.model import Plant, Robot, resolve

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
CODE = f'C++ for any robot, {CPP}'
SINGLE = Contents(CODE, 'ctypes')
LOOP = Contents(CODE, 'ctypes, once', 'C++')
HEADERS = ('pinocchio/algorithm/aba.hpp', 'boost/variant.hpp', 'Eigen/Core')
# Headers that state their versions.
VERSIONS = ('pinocchio/config.hpp', 'boost/version.hpp', 'Eigen/src/Core/util/Macros.h')
SYSTEM = Path('/usr/include')
# Functions of data/pinocchio.cpp from states to accelerations, with their names in a table.
FUNCTIONS = {
    'aba': f'{NAME} aba',
    'aba_world': f'{NAME} aba, WORLD',
    'crba': f'{NAME} crba + Cholesky',
    'aba_refined': f'{NAME} aba refined',
}


class _Arm(ctypes.c_void_p):
    """The address of a model and its data, which are released with this object."""


class PinocchioCpp(Peer):
    """
    Pinocchio's C++ for one robot, or for a plant: gravity, rotors, damping, friction and limits.

    Attributes
    ----------
    library : ctypes.CDLL
        data/pinocchio.cpp, compiled. `library.rollout` is the native function of a simulation,
        whose first argument is `arm`.
    arm : ctypes.c_void_p
        The model and its data.

    """

    def __init__(self, robot: Robot | Plant, width: float = 0.0) -> None:
        """Make the model; friction rises to its full torque at a velocity of `width` [rad/s]."""
        plant = robot if isinstance(robot, Plant) else resolve(robot, None)
        self.library, self.n = compiled_library(), plant.robot.n
        frames = (np.array(x) for x in zip(*joint_frames(plant.robot), strict=True))
        rotations, origins, centers, inertias = frames
        kinds = np.array([kind == 'prismatic' for kind in plant.robot.joint_types], np.int32)
        # In the axes of the world, in which joint_frames are.
        gravity = plant.robot.base_rotation @ plant.gravity
        numbers = (rotations, origins, plant.robot.masses, centers, inertias, gravity)
        given = [
            None if x is None else np.ascontiguousarray(x, float)
            for x in (*numbers, plant.inertia, torques_if_any(plant, width))
        ]
        self.arm = _Arm(self.library.make(self.n, address(kinds), *map(address, given)))
        weakref.finalize(self.arm, self.library.release, ctypes.c_void_p(self.arm.value))

    def evaluate(self, function: str, state: Sequence[Array], out: Array) -> partial[None]:
        """
        Return a call of one of FUNCTIONS, which writes the accelerations of all states to `out`.

        `state` is q, qd and tau; these and `out` are (B, n) or (n,), contiguous, float64. Limits,
        damping and friction of a plant act in a rollout only.
        """
        count = ctypes.c_longlong(out.size // self.n)
        native = getattr(self.library, function)
        return partial(native, self.arm, count, *map(address, checked(self.n, *state, out)))

    def rollout(
        self, step: float, q: Array, qd: Array, taus: Array, substeps: int = 1
    ) -> partial[None]:
        """
        Return a call that moves q and qd, (n,), in place by the classical Runge-Kutta method.

        Torques, a row of taus (K, n), are constant over `substeps` steps of `step` seconds.
        """
        steps = (ctypes.c_longlong(len(taus)), ctypes.c_longlong(substeps), ctypes.c_double(step))
        arrays = map(address, checked(self.n, q, qd, taus))
        return partial(self.library.rollout, self.arm, *steps, *arrays)

    def _sides(self, work: Work) -> Iterator[Side]:
        given = [np.ascontiguousarray(x, float) for x in work.arrays]
        for function, name in FUNCTIONS.items():
            out = np.empty_like(given[0])
            run = self.evaluate(function, given, out)
            contents = SINGLE if work.kind == 'call' else LOOP
            yield Side(name, run, partial(np.asarray, out), contents=contents)

    def _calls(self, work: Work) -> Iterator[Side]:
        return self._sides(work)

    def _batches(self, work: Work) -> Iterator[Side]:
        return self._sides(work)

    def _rollouts(self, work: Work) -> Iterator[Side]:
        yield simulation_side(f'{NAME} aba', work, self.rollout, LOOP)


def checked(n: int, *arrays: Array) -> tuple[Array, ...]:
    """Return arrays; ValueError for an array that C++ would misread."""
    for array in arrays:
        if array.dtype != np.float64 or not array.flags.c_contiguous or array.shape[-1] != n:
            raise ValueError(
                f'arrays must be contiguous float64 (..., {n}), got {array.dtype} {array.shape}'
            )
    return arrays


@cache
def compiled_library() -> ctypes.CDLL:
    """Return data/pinocchio.cpp, compiled and loaded; LeftOutError has the reason if not."""
    options = [f'-D{define}' for define in DEFINES]
    folders = include_folders()
    options += [f'-isystem{include}' for include in folders]
    places = (folder / header for folder in (*folders, SYSTEM) for header in VERSIONS)
    versions = ''.join(place.read_text(encoding='utf-8') for place in places if place.is_file())
    with built(CPP, stored_text('pinocchio.cpp'), *options, headers=versions) as path:
        library = ctypes.CDLL(str(path))
    library.make.restype = ctypes.c_void_p
    return library


def include_folders() -> list[Path]:
    """Return the folders of the headers of Pinocchio, Boost and Eigen; LeftOutError names one."""
    spec = importlib.util.find_spec('pinocchio')
    if spec is None or spec.origin is None:
        raise LeftOutError('pinocchio is not installed: install the extra `peers`')
    # PREFIX/lib/pythonX.Y/site-packages/pinocchio/__init__.py
    above = Path(spec.origin).resolve().parents
    known = [above[min(4, len(above) - 1)] / 'include', SYSTEM]
    known += [folder / 'eigen3' for folder in known]
    found = []
    for header in HEADERS:
        folder = next((folder for folder in known if (folder / header).is_file()), None)
        if folder is None:
            raise LeftOutError(
                f'there is no header {header} in {known[0]} or {known[1]}: '
                'install the extra `peers`'
            )
        found.append(folder)
    # Folders that the compiler searches by default must keep their place in its order.
    return list(dict.fromkeys(folder for folder in found if folder != SYSTEM))
