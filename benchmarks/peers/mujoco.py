# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
MuJoCo as a peer, made from the numbers of our own robot, without the rounding of a file.

It is installed by the extra `peers`, and skipped if absent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.work import STEP_SIZE, Contents, Peer, Side, Work, installed
from pfd_core.model import Plant, Robot

# Every body is compiled with these numbers, so that MuJoCo prepares for a general one, and gets
# its own numbers afterwards. So MuJoCo also takes links whose mass its compiler would refuse.
_BODY = """<body pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2">
<inertial pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2" mass="1" diaginertia="0.2 0.3 0.4"/>
<joint type="{}" axis="0 0 1"/>"""


MUJOCO = 'MuJoCo'
RK4 = 'MuJoCo RK4'
# Integrators on pages, by the names of mjtIntegrator, with their evaluations in a step.
INTEGRATORS = {
    'MuJoCo Euler': ('mjINT_EULER', 1),
    'MuJoCo implicit': ('mjINT_IMPLICIT', 1),
    'MuJoCo implicitfast': ('mjINT_IMPLICITFAST', 1),
    RK4: ('mjINT_RK4', 4),
}
CODE = 'C for any robot, as in the wheel'
SINGLE = Contents(CODE, 'Python, state set before')
LOOP = Contents(CODE, 'Python, once', 'C')


def _ignore(message: str) -> None:
    pass


class Mujoco(Peer):
    """
    MuJoCo's smooth dynamics of one robot: contacts and constraints are switched off.

    The ways are mj_forward, mj_step, and for a batch the forward of mujoco.batch (3.17 or newer).
    """

    def __init__(self, robot: Robot) -> None:
        mj = self.mj = installed('mujoco')
        # Warnings are counted in the data (`warned`); printed, they would fill a terminal.
        mj.set_mju_user_warning(_ignore)
        kinds = {'prismatic': 'slide'}
        bodies = ''.join(_BODY.format(kinds.get(kind, 'hinge')) for kind in robot.joint_types)
        flags = '<flag contact="disable" constraint="disable"/>'
        self.model = mj.MjModel.from_xml_string(
            f'<mujoco><option gravity="0 0 -9.81" timestep="{STEP_SIZE}" integrator="RK4">{flags}'
            f'</option><worldbody>{bodies}{"</body>" * robot.n}</worldbody></mujoco>'
        )
        m = self.model
        m.body_mass[1:] = robot.masses
        for i, (R, p, center, J) in enumerate(joint_frames(robot), start=1):
            moments, axes = np.linalg.eigh(J)
            axes[:, 2] *= np.linalg.det(axes)
            m.body_pos[i], m.body_ipos[i], m.body_inertia[i] = p, center, moments
            mj.mju_mat2Quat(m.body_quat[i], R.ravel())
            mj.mju_mat2Quat(m.body_iquat[i], axes.ravel())
        self.data = mj.MjData(m)
        mj.mj_setConst(m, self.data)

    def model_of(
        self, plant: Plant, integrator: str = 'MuJoCo RK4', step: float = STEP_SIZE
    ) -> Any:
        """Return a copy of the model with the gravity, damping and rotors of a plant."""
        model = copy(self.model)
        model.opt.integrator = getattr(self.mj.mjtIntegrator, INTEGRATORS[integrator][0])
        model.opt.timestep = step
        model.opt.gravity[:] = plant.robot.base_rotation @ plant.gravity
        if plant.damping is not None:
            model.dof_damping[:] = plant.damping
        if plant.armature is not None:
            model.dof_armature[:] = plant.armature
        self.mj.mj_setConst(model, self.mj.MjData(model))
        return model

    def answers(self, plant: Plant) -> dict[str, Callable[[Array, Array, Array], Array]]:
        """Return mj_forward on this plant as a way to qdd (n,) from q, qd and tau."""
        model = self.model_of(plant)
        data = self.mj.MjData(model)

        def forward(q: Array, qd: Array, tau: Array) -> Array:
            self._set(data, Work('call', q, qd, tau))
            self.mj.mj_forward(model, data)
            qacc: Array = data.qacc
            return qacc

        return {MUJOCO: forward}

    def _set(self, data: Any, work: Work) -> None:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = work.q, work.qd, work.tau

    def _calls(self, work: Work) -> Iterator[Side]:
        data = self.mj.MjData(self.model)
        self._set(data, work)
        forward = partial(self.mj.mj_forward, self.model, data)
        yield Side(
            'mujoco mj_forward, state in place',
            forward,
            lambda: data.qacc,
            contents=SINGLE,
            failure=partial(self.warned, data),
        )

    def _rollouts(self, work: Work) -> Iterator[Side]:
        data = self.mj.MjData(self.model)

        def run() -> None:
            self._set(data, work)
            self.mj.mj_step(self.model, data, nstep=work.steps)

        yield Side(
            'mujoco mj_step, RK4',
            run,
            lambda: data.qpos,
            contents=LOOP,
            failure=partial(self.warned, data),
        )

    def _batches(self, work: Work) -> Iterator[Side]:
        batch = installed('mujoco.batch').Batch(self.model, work.units, nthread=1)
        for name, values in zip(('qpos', 'qvel', 'qfrc_applied'), work.arrays, strict=True):
            batch.bind(name)[:] = values
        qacc = batch.bind('qacc')

        def warned() -> str:
            # Simulation, kind, and its last information and its number.
            return self._names(batch.warning[..., 1].sum(axis=0))

        result = partial(np.array, qacc)
        yield Side('mujoco.batch, forward', batch.forward, result, contents=LOOP, failure=warned)

    def warned(self, data: Any) -> str:
        """
        Return the warnings that MuJoCo has counted in its data, by name; '' without any.

        After a warning about a bad number in a step MuJoCo continues from its initial state: its
        result is then invalid.
        """
        return self._names(data.warning.number)

    def _names(self, counts: Any) -> str:
        kinds = self.mj.mjtWarning
        found = enumerate(counts[: int(kinds.mjNWARNING)])
        names = [kinds(k).name.removeprefix('mjWARN_') for k, count in found if count]
        return f'MuJoCo warned of {", ".join(names)}' if names else ''
