# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward and inverse dynamics as plain functions.

Each compiles a kernel for its robot and scene at the first call and keeps it, so that the
second call costs microseconds. Who calls in a loop keeps the kernel (compile_kernel).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.kernel import Kernel, compile_inverse_kernel, compile_kernel
from pfd_core.model import Robot, Scene

# A kernel holds about a megabyte of code; somebody who sweeps over robots should not keep all.
KEPT = 64
_kernels: OrderedDict[tuple[Any, ...], Kernel] = OrderedDict()


def forward_dynamics(
    robot: Robot,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    method: str = 'pcrbm',
    scene: Scene | None = None,
    wrench: ArrayLike | None = None,
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
    dtype, refine
        As for compile_kernel.

    Returns
    -------
    numpy.ndarray
        qdd, (..., n) [rad/s^2 or m/s^2].

    Raises
    ------
    ValueError
        If an argument has the wrong shape, is unknown, or is not finite.

    """
    scene = _with_wrench(scene, wrench)

    def make() -> Kernel:
        return compile_kernel(robot, method=method, scene=scene, dtype=dtype, refine=refine)

    kernel = _kept(('forward', method, dtype, refine), robot, scene, make)
    return _call(kernel, q, qd, tau, wrench)


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
    # A torque does not depend on which joints could be held.
    scene = replace(_with_wrench(scene, wrench), brakes=False)

    def make() -> Kernel:
        return compile_inverse_kernel(robot, scene=scene, dtype=dtype)

    kernel = _kept(('inverse', dtype), robot, scene, make)
    return _call(kernel, q, qd, qdd, wrench)


def _with_wrench(scene: Scene | None, wrench: ArrayLike | None) -> Scene:
    scene = Scene() if scene is None else scene
    return scene if wrench is None else replace(scene, external_wrench=True)


def _kept(kind: tuple[Any, ...], robot: Robot, scene: Scene, make: Callable[[], Kernel]) -> Kernel:
    """Return the kernel made before for the same robot, scene and settings, or a new one."""
    key = (*kind, robot, scene)
    kernel = _kernels.get(key)
    if kernel is None:
        kernel = _kernels[key] = make()
        if len(_kernels) > KEPT:
            _kernels.popitem(last=False)
    else:
        _kernels.move_to_end(key)
    return kernel


def _call(
    kernel: Kernel, q: ArrayLike, qd: ArrayLike, third: ArrayLike, wrench: ArrayLike | None
) -> NDArray[Any]:
    brakes = np.zeros(kernel.robot.n, dtype=bool) if kernel.scene.brakes else None
    return kernel(q, qd, third, wrench, brakes=brakes)
