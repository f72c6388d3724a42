# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio's C++ without Python, as a contender: all loops are in data/pinocchio.cpp.

The file is compiled once in a process, with the machine's compiler for its processor, against the
headers of the installed Pinocchio. Its wheel brings those of Boost; Eigen's come with the wheel
cmeel-eigen (extra `peers`) or with a system's package, libeigen3-dev. Nothing of Pinocchio's own
shared library is linked: that one is compiled for any processor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import ctypes
from functools import cache, partial
import importlib.util
from pathlib import Path
import shutil
import subprocess
from tempfile import TemporaryDirectory
import weakref

import numpy as np

from pfd_core.model import Plant, Robot, resolve
from pfd_core.report.cases.robots import Array, joint_frames
from pfd_core.report.cases.stored import text
from pfd_core.report.contenders.work import (
    STEP_SIZE,
    Contender,
    Contents,
    LeftOutError,
    Side,
    Work,
)

NAME = 'Pinocchio C++'
COMPILER = ('g++', '-std=c++17', '-O3', '-march=native', '-DNDEBUG', '-shared', '-fPIC', '-w')
# What Pinocchio's own CMake files define, and what lets Boost ask a joint for kinds it cannot be.
DEFINES = (
    'BOOST_MPL_LIMIT_LIST_SIZE=30',
    'BOOST_MPL_LIMIT_VECTOR_SIZE=30',
    'BOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
    'BOOST_FUSION_INVOKE_MAX_ARITY=12',
    'BOOST_VARIANT_USE_RELAXED_GET_BY_DEFAULT',
)
CODE = f'C++ for any robot, {COMPILER[0]} {COMPILER[2]} {COMPILER[3]}'
SINGLE = Contents(CODE, 'ctypes')
LOOP = Contents(CODE, 'ctypes, once', 'C++')
HEADERS = ('pinocchio/algorithm/aba.hpp', 'boost/variant.hpp', 'Eigen/Core')
# Functions of data/pinocchio.cpp from states to accelerations, with their names in a table.
FUNCTIONS = {
    'aba': f'{NAME} aba',
    'aba_world': f'{NAME} aba, WORLD',
    'crba': f'{NAME} crba + Cholesky',
    'aba_refined': f'{NAME} aba refined',
}


class _Arm(ctypes.c_void_p):
    """The address of a model and its data, which live as long as this does, as in a bound call."""


class PinocchioCpp(Contender):
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
        # As in the world, in which the base is turned.
        gravity = plant.robot.base_rotation @ plant.gravity
        numbers = (rotations, origins, plant.robot.masses, centers, inertias, gravity)
        optional = (plant.inertia, *joint_torques(plant, width))
        given = [None if x is None else np.ascontiguousarray(x, float) for x in numbers + optional]
        self.arm = _Arm(self.library.make(self.n, address(kinds), *map(address, given)))
        weakref.finalize(self.arm, self.library.release, ctypes.c_void_p(self.arm.value))

    def evaluate(self, function: str, state: Sequence[Array], out: Array) -> partial[None]:
        """
        Return a call of one of FUNCTIONS, which writes the accelerations of all states to `out`.

        A state is q, qd and tau, as `out` (B, n) or (n,), contiguous, float64. The torque effects
        of a plant are left out: they belong to a rollout.
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
        return partial(self.library.rollout, self.arm, *steps, *arrays, None)

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
        taus = np.tile(work.tau, (work.steps, 1))
        q, qd = np.empty((2, self.n))
        advance = self.rollout(STEP_SIZE, q, qd, taus)

        def run() -> None:
            q[:], qd[:] = work.q, work.qd
            advance()

        yield Side(f'{NAME} aba', run, lambda: q, contents=LOOP)


def joint_torques(plant: Plant, width: float) -> tuple[Array | None, ...]:
    """Return limits, damping, friction and the velocity of its ramp, (n,); None without any."""
    limit, damping, friction = plant.effort_limits, plant.viscosity, plant.friction
    if limit is None and damping is None and friction is None:
        return None, None, None, None
    if friction is not None and not width > 0:
        raise ValueError(f'width must be positive with friction, got {width}')
    zero = np.zeros(plant.robot.n)
    return (
        zero + np.inf if limit is None else limit,
        zero if damping is None else damping,
        zero if friction is None else friction,
        zero + (width or 1.0),
    )


def checked(n: int, *arrays: Array) -> tuple[Array, ...]:
    """Return arrays whose addresses C++ may have; ValueError names what it would misread."""
    for array in arrays:
        if array.dtype != np.float64 or not array.flags.c_contiguous or array.shape[-1] != n:
            raise ValueError(
                f'arrays must be contiguous float64 (..., {n}), got {array.dtype} {array.shape}'
            )
    return arrays


def address(array: Array | None) -> ctypes.c_void_p | None:
    """Return the address of an array's numbers, which keeps the array; None without an array."""
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


@cache
def compiled_library() -> ctypes.CDLL:
    """Return data/pinocchio.cpp, compiled and loaded; LeftOutError has the reason if not."""
    path = shutil.which(COMPILER[0])
    if path is None:
        raise LeftOutError(f'there is no C++ compiler ({COMPILER[0]}) on this machine')
    folders = include_folders()
    with TemporaryDirectory(prefix='pfd_speed_') as folder:
        source, target = (Path(folder) / name for name in ('arm.cpp', 'arm.so'))
        source.write_text(text('pinocchio.cpp'), encoding='utf-8')
        defines = (f'-D{define}' for define in DEFINES)
        includes = (f'-isystem{include}' for include in folders)
        command = [path, *COMPILER[1:], *defines, *includes, str(source), '-o', str(target)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise LeftOutError(f'{COMPILER[0]} failed: {_first_error(done.stderr)}')
        library = ctypes.CDLL(str(target))
    library.make.restype = ctypes.c_void_p
    return library


def include_folders() -> list[Path]:
    """Return the folders of the headers of Pinocchio, Boost and Eigen; LeftOutError names one."""
    spec = importlib.util.find_spec('pinocchio')
    if spec is None or spec.origin is None:
        raise LeftOutError('pinocchio is not installed: install the extra `peers`')
    # PREFIX/lib/pythonX.Y/site-packages/pinocchio/__init__.py
    above = Path(spec.origin).resolve().parents
    known = [above[min(4, len(above) - 1)] / 'include', Path('/usr/include')]
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
    # Folders that the compiler searches by itself must keep their place in its order.
    return list(dict.fromkeys(folder for folder in found if folder != Path('/usr/include')))


def _first_error(message: str) -> str:
    lines = message.strip().splitlines() or ['no message']
    return next((line for line in lines if 'error' in line), lines[0])[:200]
