# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pinocchio and MuJoCo as contenders, made from the numbers of our own robot.

Both sides then compute with the same angles, without the rounding of a URDF. Each peer is
installed by the extra `peers`, and skipped if absent. CasADi is in textbook.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from functools import partial
import importlib
from typing import Any

import numpy as np

from pfd_core.model import Plant, Robot
from pfd_core.report.timing import STEP_SIZE, Array, LeftOutError, Side, Work

Evaluation = Callable[[Array, Array, Array], Array]

THREADS = (1, 2)


def installed(name: str) -> Any:
    """Return a module, or raise LeftOutError with the extra that installs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise LeftOutError(
            f'{name} cannot be imported ({error}): install the extra `peers`'
        ) from error


def joint_frames(robot: Robot) -> Iterator[tuple[Array, Array, Array, Array]]:
    """
    Yield, joint by joint, how peers describe a chain: a frame that turns about its own z.

    Each is rotation (3, 3) and origin (3,) of the joint's frame in that of the joint before, and
    centre of mass (3,) and inertia about it (3, 3) of the link, in the joint's frame.
    """
    R, p = robot.base_rotation, robot.base_position
    for i in range(robot.n):
        A, a = robot.rotations[i], robot.translations[i]
        yield R, p, A @ robot.centers[i] + a, A @ robot.inertias[i] @ A.T
        R, p = A, a


def _copied(run: Callable[[], Array]) -> Array:
    return np.array(run())


class Pinocchio:
    """Pinocchio's model and dynamics of one robot; rotor inertia is off, as it is on our side."""

    def __init__(self, robot: Robot) -> None:
        pin = self.pin = installed('pinocchio')
        self.model = pin.Model()
        for i, (R, p, center, J) in enumerate(joint_frames(robot)):
            axis = (
                pin.JointModelPZ() if robot.joint_types[i] == 'prismatic' else pin.JointModelRZ()
            )
            joint = self.model.addJoint(i, axis, pin.SE3(R, p), robot.joint_names[i])
            body = pin.Inertia(float(robot.masses[i]), center, J)
            self.model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        tip = robot.frame()
        placement = pin.SE3(robot.rotations[-1], robot.translations[-1])
        placement *= pin.SE3(tip.rotation, tip.translation)
        frame = pin.Frame(robot.tip, robot.n, 0, placement, pin.FrameType.OP_FRAME)
        # The index of the tip's frame, the only one besides that of the world.
        self.tip = self.model.addFrame(frame)
        self.data = self.model.createData()

    def sides(self, work: Work) -> Iterator[Side]:
        """Return aba and crba with Cholesky; a Python loop over aba; abaInParallel."""
        return {'call': self._calls, 'rollout': self._rollouts, 'batch': self._batches}[work.kind](
            work
        )

    def evaluations(self) -> dict[str, Evaluation]:
        """Return the ways to qdd (n,) from q, qd and tau; a result may lie in Pinocchio's data."""
        pin, model, data = self.pin, self.model, self.data

        def world(q: Array, qd: Array, tau: Array) -> Array:
            result: Array = pin.aba(model, data, q, qd, tau, pin.Convention.WORLD)
            return result

        def crba(q: Array, qd: Array, tau: Array) -> Array:
            pin.crba(model, data, q)
            y = tau - pin.nonLinearEffects(model, data, q, qd)
            pin.cholesky.decompose(model, data)
            result: Array = pin.cholesky.solve(model, data, y)
            return result

        return {
            'pinocchio.aba': partial(pin.aba, model, data),
            'pinocchio.aba WORLD': world,
            'pinocchio crba + Cholesky': crba,
        }

    def _calls(self, work: Work) -> Iterator[Side]:
        for name, evaluate in self.evaluations().items():
            run = partial(evaluate, *work.arrays)
            yield Side(name, run, partial(_copied, run), reference=name == 'pinocchio.aba')

    def _rollouts(self, work: Work) -> Iterator[Side]:
        aba = partial(self.pin.aba, self.model, self.data)
        end = np.empty_like(work.q)
        h = STEP_SIZE

        def run() -> None:
            x, v, tau = work.q, work.qd, work.tau
            for _ in range(work.steps):
                a1 = aba(x, v, tau).copy()
                v2 = v + h / 2 * a1
                a2 = aba(x + h / 2 * v, v2, tau).copy()
                v3 = v + h / 2 * a2
                a3 = aba(x + h / 2 * v2, v3, tau).copy()
                v4 = v + h * a3
                a4 = aba(x + h * v3, v4, tau)
                x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
                v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            end[:] = x

        yield Side('Python loop over pinocchio.aba', run, lambda: end, reference=True)

    def _batches(self, work: Work) -> Iterator[Side]:
        columns = [np.asfortranarray(x.T) for x in work.arrays]
        # One state cannot be shared out.
        for threads in THREADS if work.units > 1 else THREADS[:1]:
            pool = self.pin.ModelPool(self.model, threads)
            out = np.empty_like(columns[0])
            yield Side(
                f'pinocchio.abaInParallel, {threads} thread{"s" * (threads > 1)}',
                partial(self.pin.abaInParallel, threads, pool, *columns, out),
                partial(np.transpose, out),
                reference=threads == 1,
                wanted=partial(self._one_by_one, work),
            )

    def _one_by_one(self, work: Work) -> Array:
        """Return aba's result: abaInParallel works in the world frame, and loses digits there."""
        aba = partial(self.pin.aba, self.model, self.data)
        return np.array([aba(*state).copy() for state in zip(*work.arrays, strict=True)])


# Every body is written with this, so that the compiler sets up for a general one; the numbers
# follow after it. So MuJoCo also takes links that its compiler would refuse to weigh.
_BODY = """<body pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2">
<inertial pos="0.1 0.2 0.3" quat="0.5 0.6 0.4 0.2" mass="1" diaginertia="0.2 0.3 0.4"/>
<joint type="{}" axis="0 0 1"/>"""


class Mujoco:
    """MuJoCo's smooth dynamics of one robot: contacts and constraints are switched off."""

    def __init__(self, robot: Robot) -> None:
        mj = self.mj = installed('mujoco')
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

    def model_of(self, plant: Plant) -> Any:
        """Return a copy of the model with the gravity, damping and rotors of a plant."""
        model = copy(self.model)
        model.opt.gravity[:] = plant.robot.base_rotation @ plant.gravity
        if plant.damping is not None:
            model.dof_damping[:] = plant.damping
        if plant.armature is not None:
            model.dof_armature[:] = plant.armature
        self.mj.mj_setConst(model, self.mj.MjData(model))
        return model

    def sides(self, work: Work) -> Iterator[Side]:
        """Return mj_forward, mj_step or, for a batch, mujoco.rollout over one step."""
        return {'call': self._calls, 'rollout': self._rollouts, 'batch': self._batches}[work.kind](
            work
        )

    def _set(self, data: Any, work: Work) -> None:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = work.q, work.qd, work.tau

    def _calls(self, work: Work) -> Iterator[Side]:
        data = self.mj.MjData(self.model)
        self._set(data, work)
        forward = partial(self.mj.mj_forward, self.model, data)
        yield Side('mujoco mj_forward, state in place', forward, lambda: data.qacc)

    def _rollouts(self, work: Work) -> Iterator[Side]:
        data = self.mj.MjData(self.model)

        def run() -> None:
            self._set(data, work)
            self.mj.mj_step(self.model, data, nstep=work.steps)

        yield Side('mujoco mj_step, RK4', run, lambda: data.qpos)

    def _batches(self, work: Work) -> Iterator[Side]:
        """One step of Euler over one second: the change of the velocity is the acceleration."""
        rollout, mj = installed('mujoco.rollout'), self.mj
        model, n = copy(self.model), self.model.nv
        model.opt.timestep, model.opt.integrator = 1.0, mj.mjtIntegrator.mjINT_EULER
        initial = np.zeros((work.units, 1 + 2 * n))
        initial[:, 1 : 1 + n], initial[:, 1 + n :] = work.q, work.qd
        state = np.empty((work.units, 1, 1 + 2 * n))
        run = partial(
            rollout.rollout,
            [model] * work.units,
            [mj.MjData(model)],
            initial,
            work.tau[:, None, :],
            control_spec=int(mj.mjtState.mjSTATE_QFRC_APPLIED),
            nstep=1,
            state=state,
            sensordata=np.empty((work.units, 1, 0)),
            skip_checks=True,
        )
        yield Side('mujoco.rollout', run, lambda: state[:, 0, 1 + n :] - work.qd)
