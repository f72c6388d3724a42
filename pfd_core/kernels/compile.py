# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiling a kernel: a robot, a scene and a method become a Kernel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from pfd_core.kernels.auto import choose
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.source import forward, inverse, plant_of
from pfd_core.model import Robot, Scene


def compile_kernel(
    robot: Robot,
    *,
    method: str = 'auto',
    scene: Scene | None = None,
    dtype: str = 'float64',
    refine: int = 0,
) -> Kernel:
    """
    Compile forward dynamics of a robot in a scene.

    Parameters
    ----------
    robot : Robot
        The chain.
    method : str
        A name in METHODS, or 'auto': the cheapest, or with `refine`, where its rounding would be
        too large for a step to mend, articulated bodies.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    dtype : {'float64', 'float32'}
        Number format of the kernel and its arrays.
    refine : int
        Steps of iterative refinement, at least 0. One takes nearly every scene to the last
        digits of the number format, for about half as much work again as the default method,
        and lets `error_estimate` say how far off the answer was without it.

    Returns
    -------
    Kernel
        qdd = kernel(q, qd, tau).

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """
    plant, scene = plant_of(robot, scene, dtype)
    method = choose(plant, method, refine)

    recreate = partial(
        compile_kernel, robot, method=method, scene=scene, dtype=dtype, refine=refine
    )

    def make(names: tuple[str, ...], with_error: Callable[[], Kernel] | None = None) -> Kernel:
        source = forward(plant, method, refine, dtype, names)
        return Kernel(robot, scene, method, dtype, source, recreate, with_error)

    return make(('qdd',), partial(make, ('qdd', 'error')) if refine else None)


def compile_inverse_kernel(
    robot: Robot, *, scene: Scene | None = None, dtype: str = 'float64'
) -> Kernel:
    """Compile inverse dynamics, tau = kernel(q, qd, qdd); arguments as in compile_kernel."""
    # A torque does not depend on which joints could be held.
    plant, scene = plant_of(robot, replace(scene or Scene(), brakes=False), dtype)
    recreate = partial(compile_inverse_kernel, robot, scene=scene, dtype=dtype)
    return Kernel(robot, scene, 'newton_euler', dtype, inverse(plant, dtype), recreate)
