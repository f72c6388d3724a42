# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Other libraries as simulators of an arm under a controller, the loop and the controller in C.

data/control_loop.c is compiled once for each number of joints. Each library advances the arm by
one period with constant torques:

    CasADi      the classical Runge-Kutta method in C around C that CasADi generates
    Pinocchio   the same in C++ around pinocchio::aba (contenders.pinocchio_cpp)
    MuJoCo      mj_step

CasADi and Pinocchio know no dry friction: it is a ramp F v / width between -F and F. MuJoCo's
frictionloss is a soft constraint of a time constant and an impedance (solreffriction,
solimpfriction). A run is given both as a `Softness`.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfd_core.report.cases.controlled_arm import ControlledArm
from pfd_core.report.cases.robots import Array
from pfd_core.report.cases.stored import text
from pfd_core.report.contenders.casadi import articulated_body, built, compiled
from pfd_core.report.contenders.mujoco import Mujoco
from pfd_core.report.contenders.pinocchio_cpp import NAME as PINOCCHIO_CPP
from pfd_core.report.contenders.pinocchio_cpp import PinocchioCpp, joint_torques
from pfd_core.report.contenders.work import installed

MUJOCO = {
    'MuJoCo Euler': 'mjINT_EULER',
    'MuJoCo implicitfast': 'mjINT_IMPLICITFAST',
    'MuJoCo RK4': 'mjINT_RK4',
}
CASADI = 'CasADi RK4'
PINOCCHIO = f'{PINOCCHIO_CPP} RK4'


@dataclass(frozen=True)
class Softness:
    """
    How a library without dry friction approximates it.

    Attributes
    ----------
    width : float
        Velocity of the ramp [rad/s].
    time_constant : float
        MuJoCo's solreffriction, in steps; 0 for its default of 0.02 s.
    impedance : float
        MuJoCo's solimpfriction, least and largest; 0 for its default.

    """

    width: float = 0.0
    time_constant: float = 0.0
    impedance: float = 0.0

    def __str__(self) -> str:
        if self.width:
            return f'ramp of {self.width:g} rad/s'
        time = f'{self.time_constant:g} steps' if self.time_constant else '0.02 s'
        return f'time constant {time}, impedance {self.impedance or "default"}'


@dataclass(frozen=True)
class Answer:
    """End of a run: status, position and velocity (n,)."""

    status: str
    q: Array
    qd: Array


Run = Callable[[], Answer]


class ControlLoop:
    """The loop in C for one arm, with its controller and reference."""

    def __init__(self, case: ControlledArm, library: ctypes.CDLL) -> None:
        self.case = case
        self._control = library.control
        self._law = np.concatenate([case.kp, case.kd])
        self._reference = np.ascontiguousarray(np.hstack([case.taus, case.q, case.qd]))

    def run(self, advance: Any, arm: Any, substeps: int, q: Array, qd: Array) -> None:
        """Advance q and qd, (n,), over all periods; `arm` is what `advance` is given."""
        self._control(
            advance,
            arm,
            ctypes.c_longlong(self.case.periods),
            ctypes.c_longlong(substeps),
            ctypes.c_double(self.case.period / substeps),
            *(ctypes.c_void_p(x.ctypes.data) for x in (self._law, self._reference, q, qd)),
        )


def loop_library(n: int) -> ctypes.CDLL:
    """Return data/control_loop.c for n joints, compiled; LeftOutError without a compiler."""
    with built(f'#define N {n}\n{text("control_loop.c")}') as path:
        return ctypes.CDLL(str(path))


class CasadiArm:
    """CasADi's C of articulated bodies with rotors, and Runge-Kutta steps in C."""

    def __init__(self, case: ControlledArm) -> None:
        casadi = installed('casadi')
        plant, n = case.plant, case.robot.n
        given = [casadi.SX.sym(name, n) for name in ('q', 'qd', 'tau')]
        qdd = articulated_body(casadi, case.robot, *given, armature=plant.armature)
        arm = casadi.Function('arm', given, [casadi.cse(casadi.densify(qdd))])
        self.library, _ = compiled(casadi, arm, text('control_loop.c'), N=n)
        self.loop = ControlLoop(case, self.library)

    def run(self, substeps: int, softness: Softness) -> Run:
        """Return a run in steps of a part of the period."""
        case = self.loop.case
        effects = joint_effects(case, softness)
        q, qd = np.empty((2, case.robot.n))

        def run() -> Answer:
            q[:], qd[:] = case.start, 0.0
            at = ctypes.c_void_p(effects.ctypes.data)
            self.loop.run(self.library.casadi, at, substeps, q, qd)
            return answer(q, qd)

        return run


class PinocchioArm:
    """Pinocchio's C++ with Runge-Kutta steps, called from the loop in C."""

    def __init__(self, case: ControlledArm) -> None:
        self.loop = ControlLoop(case, loop_library(case.robot.n))

    def run(self, substeps: int, softness: Softness) -> Run:
        """Return a run in steps of a part of the period."""
        case = self.loop.case
        peer = PinocchioCpp(case.plant, softness.width)
        q, qd = np.empty((2, case.robot.n))

        def run() -> Answer:
            q[:], qd[:] = case.start, 0.0
            self.loop.run(peer.library.rollout, peer.arm, substeps, q, qd)
            return answer(q, qd)

        return run


class MujocoArm:
    """MuJoCo's model of the arm with frictionloss, and mj_step called from C."""

    def __init__(self, case: ControlledArm) -> None:
        self.peer = Mujoco(case.robot)
        self.library = loop_library(case.robot.n)
        self.loop = ControlLoop(case, self.library)
        (path,) = Path(self.peer.mj.__file__).parent.glob('libmujoco.*')
        self.step = ctypes.cast(ctypes.CDLL(str(path)).mj_step, ctypes.c_void_p)

    def run(self, way: str, substeps: int, softness: Softness) -> Run:
        """Return a run by an integrator of MUJOCO."""
        mj, case = self.peer.mj, self.loop.case
        plant, h = case.plant, case.period / substeps
        model = self.peer.model_of(plant)
        model.opt.timestep = h
        model.opt.integrator = getattr(mj.mjtIntegrator, MUJOCO[way])
        if plant.friction is not None:
            model.opt.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
            model.dof_frictionloss[:] = plant.friction
        if softness.time_constant:
            model.dof_solref[:, 0] = softness.time_constant * h
        if softness.impedance:
            model.dof_solimp[:, :2] = softness.impedance
        data = mj.MjData(model)
        arrays = data.qpos, data.qvel, data.qfrc_applied, limits(case)
        addresses = model._address, data._address, *(x.ctypes.data for x in arrays)
        arm = (ctypes.c_void_p * 7)(self.step, *addresses)
        q, qd = np.empty((2, case.robot.n))

        # The arrays whose addresses C holds live as long as this function.
        def run(held: object = arrays) -> Answer:
            mj.mj_resetData(model, data)
            data.qpos[:] = q[:] = case.start
            qd[:] = 0.0
            self.loop.run(self.library.mujoco, arm, substeps, q, qd)
            # After a warning about a number that is too large MuJoCo restarts from its initial
            # state; any other warning makes its answer invalid, too.
            if data.warning.number.any():
                return Answer('MuJoCo warning', q, qd)
            return answer(q, qd)

        return run


def joint_effects(case: ControlledArm, softness: Softness) -> Array:
    """Return limits, damping, friction and the width of its ramp, (4, n)."""
    found = joint_torques(case.plant, softness.width)
    off = (np.inf, 0.0, 0.0, 1.0)
    n = case.robot.n
    return np.array([np.full(n, y) if x is None else x for x, y in zip(found, off, strict=True)])


def limits(case: ControlledArm) -> Array:
    """Return the effort limits, (n,); infinite without."""
    found: Array = joint_effects(case, Softness(1.0))[0]
    return found


def answer(q: Array, qd: Array) -> Answer:
    """Return the end of a run that may have overflown."""
    status = 'ok' if np.isfinite([q, qd]).all() else 'not finite'
    return Answer(status, q.copy(), qd.copy())
