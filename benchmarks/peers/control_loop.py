# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulators of an arm under a controller: ours, and other libraries with the loop in C.

    ours        an Ensemble of arms with Feedback, or a Simulator of a free arm: controller, steps
                and loop in one native call. Python calls the adaptive integrator once a period
    CasADi      the classical Runge-Kutta method, velocity Verlet and semi-implicit Euler in C
                around C that CasADi generates
    Pinocchio   the classical Runge-Kutta method in C++ around pinocchio::aba
    MuJoCo      mj_step

Around other libraries data/control_loop.c has the controller and the loop; it is compiled once for
each number of joints. CasADi and Pinocchio have no dry friction: it is a ramp F v / width between
-F and F. MuJoCo's frictionloss is a soft constraint with a time constant and an impedance
(solreffriction, solimpfriction). A `Softness` sets the ramp or the constraint.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.controlled_arm import ControlledArm
from benchmarks.cases.robots import Array
from benchmarks.peers.casadi import COMPOSITE, Casadi
from benchmarks.peers.mujoco import Mujoco
from benchmarks.peers.native import address, built, effort_limits, joint_torques
from benchmarks.peers.pinocchio_cpp import PinocchioCpp
from benchmarks.table import stored_text
from pfd_core.model import Scene
from pfd_core.simulation.adaptive import integrate
from pfd_core.simulation.ensemble import Ensemble
from pfd_core.simulation.feedback import Feedback
from pfd_core.simulation.simulator import Simulator

# Integrators around CasADi's C: functions of data/casadi.c.
IN_CASADI = {'CasADi RK4': 'rollout', 'CasADi Verlet': 'verlet', 'CasADi Euler': 'euler'}
PINOCCHIO = 'Pinocchio C++ RK4'
MUJOCO = ('MuJoCo Euler', 'MuJoCo implicit', 'MuJoCo implicitfast', 'MuJoCo RK4')
# Absolute tolerance of our adaptive integrator over the relative one.
ABSOLUTE = 1e-3


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
    """End of a run: 'ok' or the reason of its failure, and the positions, (n,)."""

    status: str
    q: Array


Run = Callable[[], Answer]
# The run of a way in a number of substeps a period.
Simulate = Callable[[str, int, Softness], Run]


def fixed(
    case: ControlledArm,
    scene: Scene,
    substeps: int,
    integrator: str,
    dtype: str,
    method: str = 'auto',
    *,
    arms: int = 1,
) -> Run:
    """
    Return a run of an Ensemble of equal arms, or of a Simulator for one free arm.

    ValueError for an unknown setting.
    """
    settings: dict[str, Any] = {
        'step_size': case.period,
        'substeps': substeps,
        'integrator': integrator,
        'dtype': dtype,
        'method': method,
    }
    if arms == 1 and not (case.kp.any() or case.kd.any()):
        one = Simulator(case.robot, scene, **settings)

        def run_one() -> Answer:
            one.reset(case.start, case.velocity)
            status = one.rollout(case.taus).status
            return _answer(one.q) if status == 'ok' else _failed(status, one.q)

        return run_one
    arm = Ensemble(case.robot, arms, scene, **settings)
    law = Feedback(case.kp, case.kd, case.q, case.qd)
    start, velocity = (np.tile(x, (arms, 1)) for x in (case.start, case.velocity))

    def run() -> Answer:
        arm.reset(start, velocity)
        # Only the last state is kept.
        status = arm.rollout(case.taus, feedback=law, every=case.periods).status
        return _answer(arm.q[0]) if status == 'ok' else _failed(status, arm.q[0])

    return run


def adaptive(case: ControlledArm, tolerance: float, **settings: Any) -> Run:
    """Return a run of `integrate` with further settings, called once a period."""
    settings = {'rtol': tolerance, 'atol': tolerance * ABSOLUTE, 'dense': False} | settings

    def run() -> Answer:
        q, qd = case.start, case.velocity
        for k in range(case.periods):
            tau = case.torques(k, q, qd)
            found = integrate(
                case.robot, tau, case.period, scene=case.scene, q=q, qd=qd, **settings
            )
            if found.status != 'ok':
                return _failed(found.status, q)
            q, qd = found.q[-1], found.qd[-1]
        return _answer(q)

    return run


def casadi_arm(case: ControlledArm) -> Simulate:
    """Return CasADi's C of composite bodies with rotors, and integrators of IN_CASADI in C."""
    peer = Casadi(case.plant, method=COMPOSITE)

    def simulate(way: str, substeps: int, softness: Softness) -> Run:
        effects = address(joint_torques(case.plant, softness.width))
        return _around(case, getattr(peer.library, IN_CASADI[way]), effects, substeps)

    return simulate


def pinocchio_arm(case: ControlledArm) -> Simulate:
    """Return Pinocchio's C++ with Runge-Kutta steps."""

    def simulate(way: str, substeps: int, softness: Softness) -> Run:
        peer = PinocchioCpp(case.plant, softness.width)
        return _around(case, peer.library.rollout, peer.arm, substeps)

    return simulate


def mujoco_arm(case: ControlledArm) -> Simulate:
    """Return MuJoCo's model of the arm with frictionloss, and mj_step called from C."""
    plant, mj = case.plant, Mujoco(case.robot).mj
    (path,) = Path(mj.__file__).parent.glob('libmujoco.*')
    step = ctypes.cast(ctypes.CDLL(str(path)).mj_step, ctypes.c_void_p)

    def simulate(way: str, substeps: int, softness: Softness) -> Run:
        h = case.period / substeps
        model = Mujoco(plant, way.split()[-1], h).model
        if plant.friction is not None:
            model.opt.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
            model.dof_frictionloss[:] = plant.friction
            # MuJoCo 4.0.0 has wrong accelerations with a sparse Jacobian of constraints.
            model.opt.jacobian = mj.mjtJacobian.mjJAC_DENSE
        if softness.time_constant:
            model.dof_solref[:, 0] = softness.time_constant * h
        if softness.impedance:
            model.dof_solimp[:, :2] = softness.impedance
        data = mj.MjData(model)
        arrays = data.qpos, data.qvel, data.qfrc_applied, effort_limits(plant)
        addresses = model._address, data._address, *(x.ctypes.data for x in arrays)
        arm = (ctypes.c_void_p * 7)(step, *addresses)
        advance = _around(case, _library(case.robot.n).mujoco, arm, substeps)

        # The arrays whose addresses C holds live as long as this function.
        def run(held: object = arrays) -> Answer:
            mj.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = case.start, case.velocity
            end = advance()
            # After a warning about a number that is too large MuJoCo restarts from its initial
            # state; any other warning makes its answer invalid, too.
            return Answer('MuJoCo warning', end.q) if data.warning.number.any() else end

        return run

    return simulate


@cache
def _library(n: int) -> ctypes.CDLL:
    """Return data/control_loop.c for n joints, compiled; LeftOutError without a compiler."""
    with built('cc', '.c', f'#define N {n}\n{stored_text("control_loop.c")}') as path:
        return ctypes.CDLL(path)


def _around(case: ControlledArm, advance: Any, arm: Any, substeps: int) -> Run:
    """Return a run of data/control_loop.c around a library's function."""
    q, qd = np.empty((2, case.robot.n))
    law = np.concatenate([case.kp, case.kd])
    reference = np.ascontiguousarray(np.hstack([case.taus, case.q, case.qd]))
    given = (
        ctypes.c_longlong(case.periods),
        ctypes.c_longlong(substeps),
        ctypes.c_double(case.period / substeps),
        *map(address, (law, reference, q, qd)),
    )
    control = _library(case.robot.n).control

    def run() -> Answer:
        q[:], qd[:] = case.start, case.velocity
        control(advance, arm, *given)
        return _answer(q, qd)

    return run


def _answer(*state: Array) -> Answer:
    """Return the end of a run that may have overflown."""
    return Answer('ok' if np.isfinite(state).all() else 'not finite', state[0].copy())


def _failed(status: str, q: Array) -> Answer:
    return Answer(status.replace('_', ' '), q.copy())
