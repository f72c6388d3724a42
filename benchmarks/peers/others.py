# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
MuJoCo, frax and dynibo as peers.

MuJoCo is made from the numbers of our own robot, without the rounding of a file.

frax is composite bodies and Newton-Euler in JAX, compiled for one robot by XLA. Its README
recommends JAX 0.4.30, double precision and one thread, which are set before JAX is imported.

dynibo is articulated bodies in Rust for any robot. Its gravity is fixed at 9.80665 m/s^2: it gets
the arm with all lengths scaled by the ratio of the gravities, and torques by its square, which has
the same accelerations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any
import warnings

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
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot
from pfd_core.model.urdf_writer import robot_to_urdf

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
