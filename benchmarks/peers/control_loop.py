# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Other libraries as simulators of an arm under a controller, the loop and the controller in C.

data/control_loop.c is compiled once for each number of joints. Each library advances the arm by
one period with constant torques:

    CasADi      the classical Runge-Kutta method, velocity Verlet and semi-implicit Euler in C
                around C that CasADi generates
    Pinocchio   the classical Runge-Kutta method in C++ around pinocchio::aba
    MuJoCo      mj_step

CasADi and Pinocchio have no dry friction: it is a ramp F v / width between -F and F. MuJoCo's
frictionloss is a soft constraint with a time constant and an impedance (solreffriction,
solimpfriction). A `Softness` sets the ramp or the constraint.

`case` is a ControlledArm of benchmarks.cases.controlled_arm.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.peers.casadi import COMPOSITE, Casadi
from benchmarks.peers.mujoco import Mujoco
from benchmarks.peers.native import C, address, built, effort_limits, torques_if_any
from benchmarks.peers.pinocchio_cpp import NAME as PINOCCHIO_CPP
from benchmarks.peers.pinocchio_cpp import PinocchioCpp
from benchmarks.table import stored_text

MUJOCO = ('MuJoCo Euler', 'MuJoCo implicitfast', 'MuJoCo RK4')
CASADI = 'CasADi RK4'
# Integrators around CasADi's C: functions of data/casadi.c.
IN_CASADI = {CASADI: 'rollout', 'CasADi Verlet': 'verlet', 'CasADi Euler': 'euler'}
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
# Run of a way, with substeps in each period or a tolerance.
Simulate = Callable[[str, float, Softness], Run]


@cache
def _library(n: int) -> ctypes.CDLL:
    """Return data/control_loop.c for n joints, compiled; LeftOutError without a compiler."""
    with built(C, f'#define N {n}\n{stored_text("control_loop.c")}') as path:
        return ctypes.CDLL(str(path))


def _run(case: Any, advance: Any, arm: Any, substeps: int) -> Run:
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
        q[:], qd[:] = case.start, 0.0
        control(advance, arm, *given)
        return answer(q, qd)

    return run


def casadi_arm(case: Any) -> Simulate:
    """Return CasADi's C of composite bodies with rotors, and integrators of IN_CASADI in C."""
    peer = Casadi(case.plant, method=COMPOSITE)

    def simulate(way: str, substeps: float, softness: Softness) -> Run:
        effects = address(torques_if_any(case.plant, softness.width))
        return _run(case, getattr(peer.library, IN_CASADI[way]), effects, int(substeps))

    return simulate


def pinocchio_arm(case: Any) -> Simulate:
    """Return Pinocchio's C++ with Runge-Kutta steps."""

    def simulate(way: str, substeps: float, softness: Softness) -> Run:
        peer = PinocchioCpp(case.plant, softness.width)
        return _run(case, peer.library.rollout, peer.arm, int(substeps))

    return simulate


def mujoco_arm(case: Any) -> Simulate:
    """Return MuJoCo's model of the arm with frictionloss, and mj_step called from C."""
    peer, plant = Mujoco(case.robot), case.plant
    mj = peer.mj
    (path,) = Path(mj.__file__).parent.glob('libmujoco.*')
    step = ctypes.cast(ctypes.CDLL(str(path)).mj_step, ctypes.c_void_p)

    def simulate(way: str, substeps: float, softness: Softness) -> Run:
        h = case.period / substeps
        model = peer.model_of(plant, way, h)
        if plant.friction is not None:
            model.opt.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
            model.dof_frictionloss[:] = plant.friction
        if softness.time_constant:
            model.dof_solref[:, 0] = softness.time_constant * h
        if softness.impedance:
            model.dof_solimp[:, :2] = softness.impedance
        data = mj.MjData(model)
        arrays = data.qpos, data.qvel, data.qfrc_applied, effort_limits(plant)
        addresses = model._address, data._address, *(x.ctypes.data for x in arrays)
        arm = (ctypes.c_void_p * 7)(step, *addresses)
        advance = _run(case, _library(case.robot.n).mujoco, arm, int(substeps))

        # The arrays whose addresses C holds live as long as this function.
        def run(held: object = arrays) -> Answer:
            mj.mj_resetData(model, data)
            data.qpos[:] = case.start
            end = advance()
            # After a warning about a number that is too large MuJoCo restarts from its initial
            # state; any other warning makes its answer invalid, too.
            return Answer('MuJoCo warning', end.q, end.qd) if data.warning.number.any() else end

        return run

    return simulate


def answer(q: Array, qd: Array) -> Answer:
    """Return the end of a run that may have overflown."""
    status = 'ok' if np.isfinite([q, qd]).all() else 'not finite'
    return Answer(status, q.copy(), qd.copy())
