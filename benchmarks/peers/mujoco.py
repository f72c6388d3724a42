# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as a peer, made from the numbers of our own robot, without the rounding of a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases.robots import Array, joint_frames
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
from pfd_core.model import Plant, Robot

# Every body is compiled with these numbers, so that MuJoCo prepares for a general one, and gets
# its own numbers afterwards. So MuJoCo also takes links whose mass its compiler would refuse.
_BODY = """<body pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2">
<inertial pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2" mass="1" diaginertia="0.2 0.3 0.4"/>
<joint type="{}" axis="0 0 1"/>"""
CODE = 'C for any robot, as in the wheel'


def model_of(robot: Robot | Plant, integrator: str = 'RK4', step: float = 1e-3) -> Any:
    """Return an MjModel of a robot, or of a plant with its gravity, damping and rotors."""
    mj = installed('mujoco')
    # Warnings are counted in the data; printed, they would fill a terminal.
    mj.set_mju_user_warning(lambda message: None)
    plant = plant_of(robot)
    arm, kinds = plant.robot, {'prismatic': 'slide'}
    bodies = ''.join(_BODY.format(kinds.get(kind, 'hinge')) for kind in arm.joint_types)
    flags = '<flag contact="disable" constraint="disable"/>'
    m = mj.MjModel.from_xml_string(
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
    return m


def mujoco(robot: Robot) -> Peer:
    """Return forward dynamics: mj_forward, and the forward of mujoco.batch (3.17 or newer)."""
    mj, model = installed('mujoco'), model_of(robot)

    def sides(given: Arguments) -> Iterator[Side]:
        if is_batch(given):
            batch = installed('mujoco.batch').Batch(model, len(given[0]), nthread=1)
            for name, values in zip(('qpos', 'qvel', 'qfrc_applied'), given, strict=True):
                batch.bind(name)[:] = values
            # Of a simulation and a kind of warnings: the last information, and their number.
            result = _checked(lambda: batch.warning[..., 1].sum(axis=0), batch.bind('qacc'))
            contents = f'{CODE}; called once from Python, loop in C; {SINE}'
            yield Side('mujoco.batch, forward', batch.forward, result, contents)
            return
        data = mj.MjData(model)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = given
        result = _checked(lambda: data.warning.number, data.qacc)
        contents = f'{CODE}; called from Python, state set before; {SINE}'
        run = partial(mj.mj_forward, model, data)
        yield Side('mujoco mj_forward, state in place', run, result, contents)

    return sides


def _checked(counts: Callable[[], Any], values: Any) -> Callable[[], Array]:
    """Return a function that returns a copy of values; LeftOutError if MuJoCo has warned."""

    def result() -> Array:
        kinds, found = installed('mujoco').mjtWarning, counts()
        names = [kinds(k).name for k in range(int(kinds.mjNWARNING)) if found[k]]
        if names:
            raise LeftOutError(f'MuJoCo warned of {", ".join(names)}'.replace('mjWARN_', ''))
        return np.array(values)

    return result
