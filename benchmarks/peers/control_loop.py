# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations of an arm under a controller: ours, and other libraries with the loop in C.

    ours        an Ensemble of arms with Feedback, or a Simulator of a free arm: controller, steps
                and loop in one native call. Python calls the adaptive integrator once a period
    CasADi      the classical Runge-Kutta method, velocity Verlet and semi-implicit Euler in C
                around C that CasADi generates
    Pinocchio   the classical Runge-Kutta method in C++ around pinocchio::aba
    MuJoCo      mj_step

Around other libraries data/control_loop.c has the controller and the loop; it is compiled once for
each number of joints. CasADi and Pinocchio have no dry friction: it is a ramp F v / width between
-F and F. MuJoCo's frictionloss is a soft constraint with a time constant and an impedance
(solreffriction, solimpfriction). Each library runs with several widths or constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import ctypes
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases.motions import ControlledArm
from benchmarks.cases.robots import Array
from benchmarks.peers import casadi, pinocchio
from benchmarks.peers.native import address, built, effort_limits, joint_torques
from benchmarks.peers.others import model_of
from benchmarks.peers.work import installed
from benchmarks.table import stored_text
from pfd_core.simulation.adaptive import integrate
from pfd_core.simulation.ensemble import Ensemble
from pfd_core.simulation.feedback import Feedback
from pfd_core.simulation.simulator import Simulator

# Integrators around CasADi's C: functions of data/casadi.c.
IN_CASADI = {'CasADi RK4': 'rollout', 'CasADi Verlet': 'verlet', 'CasADi Euler': 'euler'}
PINOCCHIO = 'Pinocchio C++ RK4'
MUJOCO = ('MuJoCo Euler', 'MuJoCo implicit', 'MuJoCo implicitfast', 'MuJoCo RK4')
# Widths of ramps [rad/s], and MuJoCo's constraints: time constant in steps (0 for its default of
# 0.02 s) and impedance (0 for its default).
RAMPS = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)
CONSTRAINTS = ((0.0, 0.0), (0.0, 0.9999), (2.0, 0.0), (2.0, 0.9999))
# Absolute tolerance of our adaptive integrator over the relative one.
ABSOLUTE = 1e-3


class Answer(NamedTuple):
    """End of a run: 'ok' or the reason of its failure, and the positions, (n,)."""

    status: str
    q: Array


Run = Callable[[], Answer]
# Of another library: way, steps a period, approximation of friction, and run.
Runs = Iterator[tuple[str, int, str, Run]]


def fixed(
    case: ControlledArm,
    substeps: int,
    integrator: str,
    dtype: str = 'float64',
    *,
    arms: int = 1,
) -> Run:
    """Return a run of an Ensemble of equal arms, or of a Simulator for one free arm."""
    settings: dict[str, Any] = {'step_size': case.period, 'substeps': substeps, 'dtype': dtype}
    settings |= {'integrator': integrator, 'scene': case.scene}
    start, velocity, how = case.start, case.velocity, dict[str, Any]()
    one: Any
    if case.kp.any() or arms > 1:
        one = Ensemble(case.robot, arms, **settings)
        start, velocity = (np.tile(x, (arms, 1)) for x in (start, velocity))
        # Only the last state is kept.
        how['every'] = case.periods
        how['feedback'] = Feedback(case.kp, case.kd, case.q, case.qd)
    else:
        one = Simulator(case.robot, **settings)

    def run() -> Answer:
        one.reset(start, velocity)
        status = one.rollout(case.taus, **how).status
        return _answer(one.q.reshape(-1, case.robot.n)[0], status)

    return run


def adaptive(case: ControlledArm, tolerance: float, **settings: Any) -> Run:
    """Return a run of `integrate` with further settings, called once a period."""
    settings = {'rtol': tolerance, 'atol': tolerance * ABSOLUTE, 'dense': False} | settings

    def run() -> Answer:
        q, qd = case.start, case.velocity
        for k in range(case.periods):
            how = settings | {'scene': case.scene, 'q': q, 'qd': qd}
            found = integrate(case.robot, case.torques(k, q, qd), case.period, **how)
            if found.status != 'ok':
                return _answer(q, found.status)
            q, qd = found.q[-1], found.qd[-1]
        return _answer(q)

    return run


def casadi_runs(case: ControlledArm, substeps: Sequence[int], ramps: Sequence[float]) -> Runs:
    """Yield the runs of CasADi's C of composite bodies with rotors."""
    plant = case.plant
    function = casadi.function_of(case.robot, armature=plant.armature)
    library, _ = casadi.compiled(function, integrators=True)
    for (way, name), steps, width in product(IN_CASADI.items(), substeps, ramps):
        effects, step = address(joint_torques(plant, width)), getattr(library, name)
        yield way, steps, _ramp(width), _around(case, step, effects, steps)


def pinocchio_runs(case: ControlledArm, substeps: Sequence[int], ramps: Sequence[float]) -> Runs:
    """Yield the runs of Pinocchio's C++."""
    for width in ramps:
        library, arm = pinocchio.compiled_model(case.plant, width)
        for steps in substeps:
            yield PINOCCHIO, steps, _ramp(width), _around(case, library.rollout, arm, steps)


def mujoco_runs(
    case: ControlledArm, substeps: Sequence[int], constraints: Sequence[tuple[float, float]]
) -> Runs:
    """Yield the runs of MuJoCo's model of the arm with frictionloss; C calls mj_step."""
    plant, mj = case.plant, installed('mujoco')
    (path,) = Path(mj.__file__).parent.glob('libmujoco.*')
    step = ctypes.cast(ctypes.CDLL(str(path)).mj_step, ctypes.c_void_p)
    library = _library(case.robot.n)

    def made(way: str, steps: int, constant: float, impedance: float) -> Run:
        h = case.period / steps
        model = model_of(plant, way.split()[-1], h)
        if plant.friction is not None:
            model.opt.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
            model.dof_frictionloss[:] = plant.friction
            # MuJoCo 4.0.0 has wrong accelerations with a sparse Jacobian of constraints.
            model.opt.jacobian = mj.mjtJacobian.mjJAC_DENSE
        if constant:
            model.dof_solref[:, 0] = constant * h
        if impedance:
            model.dof_solimp[:, :2] = impedance
        data = mj.MjData(model)
        arrays = data.qpos, data.qvel, data.qfrc_applied, effort_limits(plant)
        addresses = model._address, data._address, *(x.ctypes.data for x in arrays)
        advance = _around(case, library.mujoco, (ctypes.c_void_p * 7)(step, *addresses), steps)

        # The arrays whose addresses C holds live as long as this function.
        def run(held: object = arrays) -> Answer:
            mj.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = case.start, case.velocity
            end = advance()
            # After a warning about a number that is too large MuJoCo restarts from its initial
            # state; any other warning makes its answer invalid, too.
            return Answer('MuJoCo warning', end.q) if data.warning.number.any() else end

        return run

    for way, steps, (constant, impedance) in product(MUJOCO, substeps, constraints):
        time = f'{constant:g} steps' if constant else '0.02 s'
        label = f'time constant {time}, impedance {impedance or "default"}'
        yield way, steps, label, made(way, steps, constant, impedance)


def _ramp(width: float) -> str:
    return f'ramp of {width:g} rad/s'


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
        return _answer(q)

    return run


def _answer(q: Array, status: str = 'ok') -> Answer:
    """Return the end of a run that may have overflown."""
    if status == 'ok' and not np.isfinite(q).all():
        status = 'not finite'
    return Answer(status.replace('_', ' '), q.copy())
