# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
frax as a peer: composite bodies and Newton-Euler in JAX, compiled for one robot by XLA.

Its README recommends JAX 0.4.30, double precision and one thread, which are set before JAX is
imported; the page states the installed version.
"""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any
import warnings

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.peers.work import Contents, LeftOutError, Peer, Side, Work, installed
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
CODE = 'native code of XLA for this robot and processor'
NUMBERS = "float64; XLA's sine, any angle"
SINGLE = Contents(CODE, "Python, JAX's arrays set before", '', NUMBERS)
LOOP = Contents(CODE, "Python, once, JAX's arrays set before", 'XLA (vmap)', NUMBERS)


class Frax(Peer):
    """frax's forward dynamics of one robot: jitted, and mapped over a batch."""

    def __init__(self, robot: Robot) -> None:
        if robot.n > LONGEST:
            raise LeftOutError(f'not measured beyond {LONGEST} joints: XLA takes long to compile')
        if 'jax' not in sys.modules:
            # JAX reads them when it is imported.
            os.environ.update(SETTINGS)
        with warnings.catch_warnings(), TemporaryDirectory(prefix='pfd_frax_') as folder:
            # Of settings for its own processes.
            warnings.simplefilter('ignore')
            frax, self.jax = installed('frax', INSTALL), installed('jax', INSTALL)
            path = Path(folder) / 'arm.urdf'
            urdf, base = robot_to_urdf(robot), BASE.format(robot.base)
            path.write_text(urdf.replace(f'<link name="{robot.base}" />', base), encoding='utf-8')
            self.robot = frax.Robot(str(path))

    def _forward(self, q: Any, qd: Any, tau: Any) -> Any:
        return self.robot.forward_dynamics(q, qd, tau, None)

    def _side(self, way: str, function: Any, work: Work, contents: Contents) -> Iterator[Side]:
        compiled, given = self.jax.jit(function), [self.jax.numpy.asarray(x) for x in work.arrays]

        def run() -> Array:
            found: Array = compiled(*given).block_until_ready()
            return found

        yield Side(way, run, lambda: np.asarray(run()), contents=contents)

    def _calls(self, work: Work) -> Iterator[Side]:
        return self._side('frax, jit', self._forward, work, SINGLE)

    def _batches(self, work: Work) -> Iterator[Side]:
        return self._side('frax, jit and vmap', self.jax.vmap(self._forward), work, LOOP)
