# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Loops in C and C++ around other libraries: compilers, addresses of arrays, torques of joints.

Each source is compiled on this machine for its processor and loaded into this process. The disk
cache of kernels keeps what was compiled: Pinocchio's C++ takes twenty seconds of a compiler.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
from dataclasses import astuple, dataclass
import os
from pathlib import Path
import shutil
import subprocess
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.peers.work import LeftOutError
from pfd_core.kernels.runtime import disk_cache, processor
from pfd_core.model import Plant

OPTIMISED = ('-O3', '-march=native')
# Folders of headers and libraries that a compiler searches besides its own.
SEARCHED = ('CPATH', 'C_INCLUDE_PATH', 'CPLUS_INCLUDE_PATH', 'LIBRARY_PATH')


@dataclass(frozen=True)
class Language:
    """A language: its name, compiler, suffix of source files, and options of the compiler."""

    name: str
    compiler: str
    suffix: str
    options: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f'{self.compiler} {" ".join(OPTIMISED)}'

    def path(self) -> str:
        """Return the path of the compiler; LeftOutError if this machine has none."""
        found = shutil.which(self.compiler)
        if found is None:
            raise LeftOutError(f'there is no {self.name} compiler ({self.compiler}) here')
        return found


C = Language('C', 'cc', '.c')
CPP = Language('C++', 'g++', '.cpp', ('-std=c++17', '-DNDEBUG', '-w'))


@contextmanager
def built(language: Language, source: str, *options: str, headers: str = '') -> Iterator[Path]:
    """
    Compile a source to a shared library, or take it from the disk cache, until the end of a block.

    A loaded library needs no file. LeftOutError has the first error of the compiler.

    Parameters
    ----------
    language : Language
        Language of the source.
    source : str
        The source.
    *options : str
        Further options of the compiler.
    headers : str
        Versions of headers that are not the compiler's own.

    """
    command = [language.path(), *language.options, *OPTIMISED, '-shared', '-fPIC', *options]
    known = disk_cache.digest(source, headers, *command, *_identity(command[0]))
    with TemporaryDirectory(prefix='pfd_speed_') as folder:
        code, library = (Path(folder) / f'arm{suffix}' for suffix in (language.suffix, '.so'))
        kept = disk_cache.read(known)
        if kept is None:
            code.write_text(source, encoding='utf-8')
            _compile([*command, str(code), '-o', str(library), '-lm'])
            disk_cache.write(known, library.read_bytes())
        else:
            library.write_bytes(kept)
        yield library


def _identity(compiler: str) -> tuple[str, ...]:
    """Return what decides the result of a compilation for this processor, besides its command."""
    path = Path(compiler).resolve()
    state = path.stat()
    searched = (os.environ.get(name, '') for name in SEARCHED)
    file = str(path), str(state.st_size), str(state.st_mtime_ns)
    return *file, *searched, *astuple(processor.host())


def _compile(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LeftOutError(f'{Path(command[0]).name} failed: {_first_error(done.stderr)}')


def _first_error(message: str) -> str:
    lines = message.strip().splitlines() or ['no message']
    return next((line for line in lines if 'error' in line), lines[0])[:200]


def address(array: Array | None) -> ctypes.c_void_p | None:
    """Return the address of an array's numbers, which keeps the array; None without an array."""
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


def effort_limits(plant: Plant) -> Array:
    """Return the effort limits, (n,), infinite for a plant without limits."""
    return np.full(plant.robot.n, np.inf) if plant.effort_limits is None else plant.effort_limits


def joint_torques(plant: Plant, width: float) -> Array:
    """
    Return effort limits, damping, dry friction F and the width of its ramp, (4, n).

    The ramp F v / width, between -F and F, approximates dry friction. ValueError for friction
    with a width [rad/s] that is not positive.
    """
    if plant.friction is not None and not width > 0:
        raise ValueError(f'width must be positive with friction, got {width}')
    zero = np.zeros(plant.robot.n)
    damping, friction = (zero if x is None else x for x in (plant.viscosity, plant.friction))
    return np.array([effort_limits(plant), damping, friction, zero + (width or 1.0)])


def torques_if_any(plant: Plant, width: float = 0.0) -> Array | None:
    """Return `joint_torques`; None for a plant without limits, damping and friction."""
    plain = plant.effort_limits is plant.viscosity is plant.friction is None
    return None if plain else joint_torques(plant, width)
