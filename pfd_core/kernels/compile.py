# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiling a kernel: a robot, a scene and a quantity become a Kernel."""

from __future__ import annotations

from functools import partial

from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.quantities import quantity_named
from pfd_core.kernels.source import forward, source_of
from pfd_core.kernels.spec import KernelSpec
from pfd_core.model import Robot, Scene, given_scene


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
        Steps of iterative refinement, at least 0, of forward dynamics; for derivatives, of the
        accelerations at which they are taken and of the inverse inertia matrix. One step reaches
        rounding level in nearly every scene. It takes about half as much work again as the
        default method, for derivatives of a UR5 as much again.
    quantity : str
        The result, and its arguments::

          'forward_dynamics'   qdd, (n,), of (q, qd, tau)
          'inverse_dynamics'   tau, (n,), of (q, qd, qdd): the commanded torques, so without
                               gravity compensated by motor controllers; ignores their limits and
                               brakes
          'derivatives'        d qdd / d (q, qd, tau), (n, 3n), of (q, qd, tau)
          'inertia_matrix'     H, (n, n), of q, with the rotors
          'bias_torques'       (n,), of (q, qd): inverse dynamics at qdd = 0
          'gravity_torques'    (n,), of q: the same at rest, without the wrench
          'energy'             (2,) [J], of (q, qd): kinetic, and potential, whose slopes are the
                               gravity torques
          'wrench_torques'     (n,), of q and wrench=: the joint torques J' k that a wrench on the
                               frame causes, in its axes, about its origin
          'tip_pose'           (4, 4), of q: homogeneous transform of the frame to the base link
          'tip_jacobian'       (6, n), of q: linear and angular velocity of the frame by qd, in
                               axes of the base link, linear first
          'tip_velocity'       (6,), of (q, qd): the Jacobian times qd
    frame : str, optional
        For the last four: a name in `robot.frames`, default the robot's tip.

    Returns
    -------
    Kernel
        qdd = kernel(q, qd, tau), for forward dynamics.

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """
    quantity_named(quantity)  # quantities of a step belong to simulations
    spec = KernelSpec(robot, given_scene(scene), method, dtype, refine, quantity, frame)
    return compile_spec(spec)


def compile_spec(spec: KernelSpec) -> Kernel:
    """Compile the kernel of a spec."""
    recreate = partial(compile_spec, spec)

    def error_alone() -> Kernel:
        return Kernel(spec, forward(spec, names=('error',)), recreate)

    return Kernel(spec, source_of(spec), recreate, error_alone)
