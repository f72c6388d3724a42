# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
dynibo as a peer: articulated bodies in Rust for any robot, called from Python, without batches.

Its gravity is fixed at 9.80665 m/s^2, so that its results are compared with Pinocchio's at that
gravity; its time does not depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.peers.pinocchio import Pinocchio
from benchmarks.peers.work import Contents, Peer, Side, Work, installed
from pfd_core.model import Robot, Scene, resolve
from pfd_core.model.urdf_writer import robot_to_urdf

GRAVITY = 9.80665
CONTENTS = Contents('Rust for any robot, as in the wheel', 'Python, out=')


class Dynibo(Peer):
    """dynibo's forward dynamics of one robot."""

    def __init__(self, robot: Robot) -> None:
        dynibo = installed('dynibo')
        with TemporaryDirectory(prefix='pfd_dynibo_') as folder:
            path = Path(folder) / 'arm.urdf'
            path.write_text(robot_to_urdf(robot), encoding='utf-8')
            self.arm = dynibo.Robot.from_urdf(str(path))
        plant = resolve(robot, Scene(gravity=(0.0, 0.0, -GRAVITY)))
        self.wanted = Pinocchio(robot).answers(plant)['Pinocchio aba']

    def _calls(self, work: Work) -> Iterator[Side]:
        out = np.empty_like(work.q)
        run, wanted = partial(self.arm.forward_dynamics, *work.arrays, out=out), self.wanted
        yield Side(
            'dynibo, out=',
            run,
            lambda: out,
            wanted=lambda: np.array(wanted(*work.arrays)),
            contents=CONTENTS,
        )
