# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels of one state with the robot in vector registers: a lane for each joint.

    kernel = compile_lanes(robot, method='pcrbm')
    qdd = kernel(q, qd, tau)

Where other kernels are made of a sequential recording, in which every number is a scalar, these
are made of the recording on n lanes: a register of the program is one vector of n numbers (LLVM
lays it out in the registers that the processor has), a route is a shuffle. What they are for is
the measurement in docs/decisions/0006-lanes-in-a-register.md. Nothing else in this package uses
them: recurrences by recursive doubling sum in another order than sweeps do, so that their bits
are not those of the kernels that take batches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.algorithms.dynamics import METHODS, SERIAL, record_forward_dynamics
from pfd_core.kernels.conversion import as_numbers, raise_not_finite
from pfd_core.kernels.fuse import fuse
from pfd_core.kernels.lanes_fold import fold_lanes
from pfd_core.kernels.lanes_llvm import module_text
from pfd_core.kernels.lower import drop, expand
from pfd_core.kernels.python_objects import python_function, supported
from pfd_core.kernels.recipe import Recipe, plant_of, turned_joints
from pfd_core.kernels.schedule import schedule
from pfd_core.machine.program import Program
from pfd_core.model import Robot, Scene

PARALLEL = tuple(method for method in METHODS if method not in SERIAL)
RECORDINGS = ('unpacked', 'parallel')


def lower_lanes(program: Program, dtype: str, outputs: Sequence[str] | None = None) -> Program:
    """
    Return a parallel program folded, with sines expanded, additions fused and nothing unread.

    Parameters
    ----------
    program : Program
        A recording on lanes.
    dtype : {'float64', 'float32'}
        Number format the kernel computes in.
    outputs : sequence of str, optional
        The outputs to keep; default all.

    """
    lowered = drop(fold_lanes(expand(drop(fold_lanes(drop(program, outputs))), dtype)))
    return schedule(drop(fuse(lowered)))


@dataclass(frozen=True)
class LaneKernel:
    """
    Native code of one parallel method for one robot and scene, for one state at a time.

    Attributes
    ----------
    robot : Robot
        What it computes for.
    dtype : str
        Number format of its arrays, 'float64' or 'float32'.
    recipe : Recipe
        Its program, and how many operations were recorded and are compiled.
    bound : callable
        bound(q, qd, tau, ..., out) evaluates on contiguous arrays and returns the last.

    """

    robot: Robot
    dtype: str
    recipe: Recipe
    bound: Callable[..., Any]

    def __call__(self, *given: ArrayLike) -> NDArray[Any]:
        """
        Return qdd, (n,), of one state.

        Parameters
        ----------
        *given : array_like
            What `recipe.inputs` names: q, qd, tau, (n,), and where the scene has them wrench,
            (6,), and free, (n,), zero for a joint that is held.

        Raises
        ------
        ValueError
            If an argument has the wrong shape or type, is missing, or is not finite.

        """
        if len(given) != len(self.recipe.inputs):
            raise ValueError(
                f'the kernel takes {", ".join(self.recipe.inputs)}, got {len(given)} arguments'
            )
        arrays = {
            name: np.ascontiguousarray(as_numbers(name, value, size, self.dtype))
            for (name, size), value in zip(self.recipe.inputs.items(), given, strict=True)
        }
        for name, array in arrays.items():
            if array.ndim != 1:
                raise ValueError(f'{name} must be of one state, got shape {array.shape}')
        raise_not_finite(arrays)
        out = np.empty(self.recipe.elements, self.dtype)
        return self.bound(*arrays.values(), out)  # type: ignore[no-any-return]

    def bind(self, *arrays: NDArray[Any]) -> Callable[[], NDArray[Any]]:
        """Return a function without arguments that evaluates in place: inputs, then out."""
        self.bound(*arrays)
        return partial(self.bound, *arrays)


def compile_lanes(
    robot: Robot,
    *,
    method: str = 'pcrbm',
    scene: Scene | None = None,
    dtype: str = 'float64',
    recording: str = 'unpacked',
) -> LaneKernel:
    """
    Compile forward dynamics by a parallel method, with the robot on the lanes of vectors.

    Parameters
    ----------
    robot : Robot
        The chain.
    method : str
        A name in PARALLEL.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    dtype : {'float64', 'float32'}
        Number format of the kernel and its arrays.
    recording : {'unpacked', 'parallel'}
        Whether partly filled rows are left as they are or packed, as on n processors.

    Returns
    -------
    LaneKernel
        qdd = kernel(q, qd, tau).

    Raises
    ------
    ValueError
        If the method is not one of these, above all if it is serial and has no lanes; or as for
        compile_kernel.
    RuntimeError
        If this Python cannot call native code that reads its arrays.

    """
    if not supported():
        raise RuntimeError('kernels on lanes need 64-bit CPython and its arrays: use pfd.Kernel')
    if method in SERIAL:
        raise ValueError(f'{method!r} is a serial method and has no lanes: take one of {PARALLEL}')
    if method not in PARALLEL:
        raise ValueError(f'method must be one of {PARALLEL}, got {method!r}')
    if recording not in RECORDINGS:
        raise ValueError(f'recording must be one of {RECORDINGS}, got {recording!r}')
    plant, scene = plant_of(robot, scene, dtype)

    def record() -> dict[str, Program]:
        recorded = record_forward_dynamics(plant, method, recording)
        return {'recorded': recorded, 'compiled': lower_lanes(recorded, dtype, ['qdd'])}

    recipe = Recipe(record, ('lanes', plant.digest, method, recording, dtype))

    def text() -> str:
        return module_text(recipe.program, dtype, turned_joints(robot))

    return LaneKernel(
        robot, dtype, recipe, python_function(recipe.compile('lanes', text), 'bound')
    )
