# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Loops in C and C++ around other libraries: compilers, addresses of arrays, torques of joints.

Each source is compiled on this machine for its processor and loaded into this process. Pinocchio's
C++ takes twenty seconds of a compiler.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
from pathlib import Path
import shutil
import subprocess
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.peers.work import LeftOutError
from pfd_core.model.plant import Plant

OPTIMISED = ('-O3', '-march=native')


@contextmanager
def built(compiler: str, suffix: str, source: str, *options: str) -> Iterator[str]:
    """
    Compile a source ('.c' or '.cpp') to a shared library, which exists until the block ends.

    A loaded library needs no file. LeftOutError without the compiler, or with its first error.
    """
    if shutil.which(compiler) is None:
        raise LeftOutError(f'there is no compiler {compiler} here')
    with TemporaryDirectory(prefix='pfd_speed_') as folder:
        code, library = Path(folder) / f'arm{suffix}', str(Path(folder) / 'arm.so')
        code.write_text(source, encoding='utf-8')
        command = [compiler, *OPTIMISED, '-shared', '-fPIC', *options, str(code), '-o', library]
        done = subprocess.run([*command, '-lm'], capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or ['no message']
            first = next((line for line in lines if 'error' in line), lines[0])
            raise LeftOutError(f'{compiler} failed: {first[:200]}')
        yield library


def address(array: Array | None) -> ctypes.c_void_p | None:
    """Return the address of an array's numbers, which keeps the array; None without an array."""
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


def effort_limits(plant: Plant) -> Array:
    """Return the effort limits, (n,), infinite for a plant without limits."""
    return np.full(plant.robot.n, np.inf) if plant.effort_limits is None else plant.effort_limits


def joint_torques(plant: Plant, width: float) -> Array | None:
    """
    Return effort limits, damping, dry friction F and the width of its ramp, (4, n), if any acts.

    The ramp F v / width, between -F and F, approximates dry friction; a width is in rad/s.
    """
    if plant.effort_limits is plant.viscosity is plant.friction is None:
        return None
    zero = np.zeros(plant.robot.n)
    damping, friction = (zero if x is None else x for x in (plant.viscosity, plant.friction))
    return np.array([effort_limits(plant), damping, friction, zero + width])
