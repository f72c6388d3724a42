# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiling a kernel: a robot, a scene and a quantity become a Kernel.

    compile_kernel                         a kernel, for loops
    forward_dynamics, inverse_dynamics     plain functions that keep the kernels they compile
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.recipes import recipe_of
from pfd_core.kernels.spec import KernelSpec, quantity_named
from pfd_core.model.robot import Robot
from pfd_core.model.scene import Scene, given_scene

# A kernel holds about a megabyte of code: a sweep over many robots must not hold all of theirs.
CACHED_KERNELS = 128


def compile_kernel(
    robot: Robot,
    *,
    method: str = 'auto',
    scene: Scene | None = None,
    dtype: str = 'float64',
    refine: int = 0,
    quantity: str = 'forward_dynamics',
    frame: str | None = None,
) -> Kernel:
    """
    Compile forward dynamics of a robot in a scene, or another quantity.

    Parameters
    ----------
    robot : Robot
        The chain.
    method : str
        A name in METHODS, or 'auto': for forward dynamics and its derivatives the cheapest method
        with small rounding errors on this robot, or a method with a step of refinement
        (`kernel.method`, `kernel.spec.refine`). Other quantities have one method.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity. A quantity ignores the effects
        that it does not depend on.
    dtype : {'float64', 'float32'}
        Number format of the kernel and its arrays.
    refine : int
        Steps of iterative refinement, 0 to 16, of forward dynamics; for derivatives, of the
        accelerations at which they are taken and of the inverse inertia matrix. One step reaches
        rounding level in nearly every scene. It takes about half as much work again as the
        default method, for derivatives of a UR5 as much again.
    quantity : str
        A name in QUANTITIES, whose rows state the result, its shape and the arguments of a call.
    frame : str, optional
        For a quantity of a frame: a name in `robot.frames`, default the robot's tip.

    Returns
    -------
    Kernel
        qdd = kernel(q, qd, tau), for forward dynamics.

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """
    quantity_named(quantity)  # a spec may also be of a step, for simulations
    spec = KernelSpec(robot, given_scene(scene), method, dtype, refine, quantity, frame)
    return compile_spec(spec)


def compile_spec(spec: KernelSpec) -> Kernel:
    """Compile the kernel of a spec."""
    return Kernel(spec, recipe_of(spec), partial(compile_spec, spec))


def forward_dynamics(
    robot: Robot,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    method: str = 'auto',
    scene: Scene | None = None,
    wrench: ArrayLike | None = None,
    brakes: ArrayLike | None = None,
    dtype: str = 'float64',
    refine: int = 0,
) -> NDArray[Any]:
    """
    Return the joint accelerations that torques cause.

    Its kernel is compiled at the first call for a robot and a scene. A loop should use a compiled
    kernel (compile_kernel): that saves looking it up.

    Parameters
    ----------
    robot : Robot
        The chain.
    q, qd, tau : array_like
        Positions [rad or m], velocities [rad/s or m/s] and torques [N m or N], (..., n).
    wrench : array_like, optional
        Force [N] and moment [N m] exerted on the last link, (..., 6), in its frame and about
        its origin.
    brakes : array_like of bool, optional
        Braked joints, (..., n), only if the scene has brakes; default none.
    method, scene, dtype, refine
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
    kernel = _kernel(robot, given_scene(scene, wrench), method, dtype, refine)
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
    scene = given_scene(scene, wrench)
    if scene.brakes:  # torques are computed from accelerations: brakes play no part
        scene = replace(scene, brakes=False)
    return _kernel(robot, scene, 'auto', dtype, 0, 'inverse_dynamics')(q, qd, qdd, wrench)


def _kernel(*options: Any) -> Kernel:
    """Return the kernel of the arguments of a KernelSpec; a spec takes too long for each call."""
    try:
        return _kept_kernel(*options)
    except TypeError:  # an argument that has no hash, which the spec names
        return compile_spec(KernelSpec(*options))


@lru_cache(CACHED_KERNELS, typed=True)
def _kept_kernel(*options: Any) -> Kernel:
    return compile_spec(KernelSpec(*options))
