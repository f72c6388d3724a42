# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
frax and dynibo as peers.

frax is composite bodies and Newton-Euler in JAX, compiled for one robot by XLA. Its README
recommends JAX 0.4.30, double precision and one thread, which are set before JAX is imported.

dynibo is articulated bodies in Rust for any robot. Its gravity is fixed at 9.80665 m/s^2: it gets
the arm with all lengths scaled by the ratio of the gravities, and torques by its square, which has
the same accelerations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any
import warnings

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.peers.work import (
    SINE,
    Arguments,
    LeftOutError,
    Peer,
    Side,
    installed,
    is_batch,
    plant_of,
)
from pfd_core.model import Robot
from pfd_core.model.urdf_writer import robot_to_urdf

LONGEST = 12
# Not in the extra `peers`: there is no jaxlib 0.4.30 for Python 3.13.
INSTALL = 'pip install frax jax==0.4.30 jaxlib==0.4.30 (Python 3.10 to 3.12)'
# frax reads no URDF whose base has no mass, which does not act.
BASE = (
    '<link name="{}"><inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
)
SETTINGS = {'JAX_ENABLE_X64': '1', 'XLA_FLAGS': '--xla_cpu_multi_thread_eigen=false'}
DYNIBO_GRAVITY = 9.80665


def frax(robot: Robot) -> Peer:
    """Return frax's forward dynamics of one robot: jitted, and mapped over a batch."""
    if robot.n > LONGEST:
        raise LeftOutError(f'not measured beyond {LONGEST} joints: XLA takes long to compile')
    if 'jax' not in sys.modules:
        # JAX reads them when it is imported.
        os.environ.update(SETTINGS)
    with warnings.catch_warnings(), TemporaryDirectory(prefix='pfd_frax_') as folder:
        # Of settings for its own processes.
        warnings.simplefilter('ignore')
        module, jax = installed('frax', INSTALL), installed('jax', INSTALL)
        path = Path(folder) / 'arm.urdf'
        urdf, base = robot_to_urdf(robot), BASE.format(robot.base)
        path.write_text(urdf.replace(f'<link name="{robot.base}" />', base), encoding='utf-8')
        arm = module.Robot(str(path))

    def forward(q: Any, qd: Any, tau: Any) -> Any:
        return arm.forward_dynamics(q, qd, tau, None)

    def sides(given: Arguments) -> Iterator[Side]:
        batch = is_batch(given)
        compiled = jax.jit(jax.vmap(forward) if batch else forward)
        values = [jax.numpy.asarray(x) for x in given]

        def run() -> Array:
            found: Array = compiled(*values).block_until_ready()
            return found

        contents = (
            "native code of XLA for this robot and processor; called from Python, JAX's arrays "
            f"set before{', once, loop of vmap' * batch}; float64, XLA's sine, any angle"
        )
        way = f'frax, jit{" and vmap" * batch}'
        yield Side(way, run, lambda: np.asarray(run()), contents)

    return sides


def dynibo(robot: Robot) -> Peer:
    """Return dynibo's forward dynamics of one robot; calls only."""
    module = installed('dynibo')
    if 'prismatic' in robot.joint_types:
        raise LeftOutError('an arm that slides cannot be scaled to the gravity of dynibo')
    scale = DYNIBO_GRAVITY / np.linalg.norm(plant_of(robot).gravity)
    scaled = replace(
        robot,
        base_position=scale * robot.base_position,
        translations=scale * robot.translations,
        centers=scale * robot.centers,
        inertias=scale**2 * robot.inertias,
    )
    with TemporaryDirectory(prefix='pfd_dynibo_') as folder:
        path = Path(folder) / 'arm.urdf'
        path.write_text(robot_to_urdf(scaled), encoding='utf-8')
        arm = module.Robot.from_urdf(str(path))

    def sides(given: Arguments) -> Iterator[Side]:
        if not is_batch(given):
            q, qd, tau = given
            out = np.empty_like(q)
            run = partial(arm.forward_dynamics, q, qd, scale**2 * tau, out=out)
            contents = f'Rust for any robot, as in the wheel; called from Python, out=; {SINE}'
            yield Side('dynibo, out=', run, partial(np.asarray, out), contents)

    return sides
