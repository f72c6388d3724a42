# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward and inverse dynamics as plain functions.

Each compiles a kernel for its robot and scene at the first call and caches it, so that the
second call costs microseconds. A loop should use a compiled kernel (compile_kernel).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.compile import compile_kernel, compile_spec
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.spec import KernelSpec
from pfd_core.model import Robot, Scene, given_scene

# A kernel holds about a megabyte of code: a sweep over many robots must not hold all of theirs.
CACHED_KERNELS = 128


def forward_dynamics(
    robot: Robot,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    method: str = 'pcrbm',
    scene: Scene | None = None,
    wrench: ArrayLike | None = None,
    brakes: ArrayLike | None = None,
    dtype: str = 'float64',
    refine: int = 0,
) -> NDArray[Any]:
    """
    Return the joint accelerations that torques cause.

    Parameters
    ----------
    robot : Robot
        The chain.
    q, qd, tau : array_like
        Positions [rad or m], velocities [rad/s or m/s] and torques [N m or N], (..., n).
    method : str
        A name in METHODS, or 'auto'.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    wrench : array_like, optional
        Force [N] and moment [N m] exerted on the last link, (..., 6), in its frame and about
        its origin.
    brakes : array_like of bool, optional
        Braked joints, (..., n), only if the scene has brakes; default none.
    dtype, refine
        As for compile_kernel.

    Returns
    -------
    numpy.ndarray
        qdd, (..., n) [rad/s^2 or m/s^2].

    Raises
    ------
    ValueError
        If an argument has the wrong shape or type, is unknown, or is not finite.

    """
    scene = _with_wrench(scene, wrench)
    try:
        kernel = _kernel(robot, scene, method, dtype, refine)
    except TypeError:  # an unhashable argument, which compile_kernel names
        kernel = compile_kernel(robot, method=method, scene=scene, dtype=dtype, refine=refine)
    return kernel(q, qd, tau, wrench, brakes=brakes)


def inverse_dynamics(
    robot: Robot,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    *,
    scene: Scene | None = None,
    wrench: ArrayLike | None = None,
    dtype: str = 'float64',
) -> NDArray[Any]:
    """Return the torques, (..., n), that accelerations need; arguments as forward_dynamics."""
    # Torques are computed from accelerations: brakes play no part.
    scene = replace(_with_wrench(scene, wrench), brakes=False)
    try:
        kernel = _kernel(robot, scene, 'auto', dtype, 0, 'inverse_dynamics')
    except TypeError:
        kernel = compile_kernel(robot, scene=scene, dtype=dtype, quantity='inverse_dynamics')
    return kernel(q, qd, qdd, wrench)


@lru_cache(CACHED_KERNELS, typed=True)
def _kernel(*options: Any) -> Kernel:
    """Return the kernel of the arguments of a KernelSpec; a spec takes too long for each call."""
    return compile_spec(KernelSpec(*options))


def _with_wrench(scene: Scene | None, wrench: ArrayLike | None) -> Scene:
    scene = given_scene(scene)
    return scene if wrench is None else replace(scene, external_wrench=True)
