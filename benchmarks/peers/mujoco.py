# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as a peer, made from the numbers of our own robot, without the rounding of a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases.robots import Array, joint_frames
from benchmarks.peers.work import SINE, STEP_SIZE, LeftOutError, Side, Work, installed, plant_of
from pfd_core.model import Plant, Robot

# Every body is compiled with these numbers, so that MuJoCo prepares for a general one, and gets
# its own numbers afterwards. So MuJoCo also takes links whose mass its compiler would refuse.
_BODY = """<body pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2">
<inertial pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2" mass="1" diaginertia="0.2 0.3 0.4"/>
<joint type="{}" axis="0 0 1"/>"""
CODE = 'C for any robot, as in the wheel'


class Mujoco:
    """
    MuJoCo's smooth dynamics of a robot, or of a plant with its gravity, damping and rotors.

    Contacts and constraints are switched off. The ways are mj_forward, mj_step, and for a batch
    the forward of mujoco.batch (3.17 or newer). `integrator` is RK4, or another of mjtIntegrator.
    """

    def __init__(
        self, robot: Robot | Plant, integrator: str = 'RK4', step: float = STEP_SIZE
    ) -> None:
        mj = self.mj = installed('mujoco')
        # Warnings are counted in the data (`warnings`); printed, they would fill a terminal.
        mj.set_mju_user_warning(lambda message: None)
        plant = plant_of(robot)
        arm, kinds = plant.robot, {'prismatic': 'slide'}
        bodies = ''.join(_BODY.format(kinds.get(kind, 'hinge')) for kind in arm.joint_types)
        flags = '<flag contact="disable" constraint="disable"/>'
        m = self.model = mj.MjModel.from_xml_string(
            f'<mujoco><option timestep="{step!r}" integrator="{integrator}">{flags}</option>'
            f'<worldbody>{bodies}{"</body>" * arm.n}</worldbody></mujoco>'
        )
        m.opt.gravity[:] = arm.base_rotation @ plant.gravity
        m.body_mass[1:] = arm.masses
        if plant.damping is not None:
            m.dof_damping[:] = plant.damping
        if plant.armature is not None:
            m.dof_armature[:] = plant.armature
        for i, (R, p, center, J) in enumerate(joint_frames(arm), start=1):
            moments, axes = np.linalg.eigh(J)
            axes[:, 2] *= np.linalg.det(axes)
            m.body_pos[i], m.body_ipos[i], m.body_inertia[i] = p, center, moments
            mj.mju_mat2Quat(m.body_quat[i], R.ravel())
            mj.mju_mat2Quat(m.body_iquat[i], axes.ravel())
        mj.mj_setConst(m, mj.MjData(m))

    def sides(self, work: Work) -> Iterator[Side]:
        """Yield the way of a work."""
        mj, model = self.mj, self.model
        once = f'{CODE}; called once from Python, loop in C; {SINE}'
        if work.kind == 'batch':
            batch = installed('mujoco.batch').Batch(model, work.units, nthread=1)
            for name, values in zip(('qpos', 'qvel', 'qfrc_applied'), work.arrays, strict=True):
                batch.bind(name)[:] = values
            qacc = batch.bind('qacc')
            # Of a simulation and a kind of warnings: the last information, and their number.
            result = self._checked(lambda: batch.warning[..., 1].sum(axis=0), qacc)
            yield Side('mujoco.batch, forward', batch.forward, result, once)
            return
        data = mj.MjData(model)

        def prepare() -> None:
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = work.arrays

        if work.kind == 'call':
            prepare()
            run, result = partial(mj.mj_forward, model, data), self._checked(data, data.qacc)
            contents = f'{CODE}; called from Python, state set before; {SINE}'
            yield Side('mujoco mj_forward, state in place', run, result, contents)
            return

        def simulate() -> None:
            prepare()
            mj.mj_step(model, data, nstep=work.steps)

        yield Side('mujoco mj_step, RK4', simulate, self._checked(data, data.qpos), once)

    def _checked(self, data: Any, values: Any) -> Callable[[], Array]:
        """
        Return a function that returns a copy of values; LeftOutError if MuJoCo has warned.

        After a warning about a bad number in a step MuJoCo continues from its initial state.
        """

        def result() -> Array:
            counts = data() if callable(data) else data.warning.number
            kinds = self.mj.mjtWarning
            found = (kinds(k).name for k in range(int(kinds.mjNWARNING)) if counts[k])
            names = ', '.join(name.removeprefix('mjWARN_') for name in found)
            if names:
                raise LeftOutError(f'MuJoCo warned of {names}')
            return np.array(values)

        return result
