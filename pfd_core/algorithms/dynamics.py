# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whole programs: inverse dynamics, and forward dynamics by each method.

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eqs (1), (2)

    inverse_dynamics   tau from q, qd, qdd     NE1
    pcrbm              qdd from q, qd, tau     H by PCRBM, bias by NE1, H qdd = tau - bias

Inputs are `q`, `qd` and `qdd` or `tau`, (n,), and where the scene asks for them `wrench`, (6,):
force and moment exerted on the last link, in its axes, about its origin, and `free`, (n,): one
for a joint that moves and zero for one that its brake holds.
"""

from __future__ import annotations

from collections.abc import Callable

from pfd_core.algorithms.chain import Links, Pose, links, pose
from pfd_core.algorithms.cholesky import solve
from pfd_core.algorithms.newton_euler import newton_euler, wrench_in_base_axes
from pfd_core.algorithms.pcrbm import inertia_matrix
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder, broadcast, merge, on, where
from pfd_core.machine.vectors import array
from pfd_core.model import Plant


def record_inverse_dynamics(plant: Plant, schedule: str) -> Program:
    """Return the program of tau, (n,), from q, qd and qdd; a joint's brake plays no part."""
    recorder, chain, at = _begin(plant, schedule)
    qd, qdd = _joint_input(recorder, 'qd'), _joint_input(recorder, 'qdd')
    tau = _torque(recorder, plant, chain, at, qd, qdd)
    if plant.armature is not None:
        tau = tau + recorder.constant(plant.armature) * qdd
    return _finish(recorder, tau=tau)


def record_pcrbm(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd, (n,), from q, qd and tau; its pivots show whether H was sound."""
    recorder, chain, at = _begin(plant, schedule)
    qd, tau = _joint_input(recorder, 'qd'), _joint_input(recorder, 'tau')
    y = tau - _torque(recorder, plant, chain, at, qd, None)
    rows = inertia_matrix(recorder, chain, at, _armature(recorder, plant))
    if plant.brakes:
        rows, y = _held(recorder, rows, y)
    qdd, pivots = solve(recorder, rows, y)
    return _finish(recorder, qdd=qdd, pivots=pivots)


def record_terms(plant: Plant, schedule: str) -> Program:
    """Return the program of H, (n, n), and of the bias, (n,), from q and qd."""
    recorder, chain, at = _begin(plant, schedule)
    qd = _joint_input(recorder, 'qd')
    bias = _torque(recorder, plant, chain, at, qd, None)
    rows = inertia_matrix(recorder, chain, at, _armature(recorder, plant))
    n = recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    recorder.output('H', (n, n), elements)
    return _finish(recorder, bias=bias)


FORWARD: dict[str, Callable[[Plant, str], Program]] = {'pcrbm': record_pcrbm}
METHODS = tuple(FORWARD)


def record_forward_dynamics(plant: Plant, method: str, schedule: str) -> Program:
    """Return the program of a method; its outputs are `qdd` and `pivots`, (n,)."""
    if method not in FORWARD:
        raise ValueError(f'method must be one of {METHODS}, got {method!r}')
    return FORWARD[method](plant, schedule)


def _begin(plant: Plant, schedule: str) -> tuple[Recorder, Links, Pose]:
    recorder = Recorder(plant.robot.n, schedule)
    chain = links(recorder, plant.robot, keep_tip=plant.external_wrench)
    return recorder, chain, pose(recorder, chain, _joint_input(recorder, 'q'))


def _finish(recorder: Recorder, **results: Lanes) -> Program:
    n = recorder.lanes
    for name, value in results.items():
        recorder.output(name, (n,), [(value, lane) for lane in range(n)])
    return recorder.program()


def _joint_input(recorder: Recorder, name: str) -> Lanes:
    return recorder.input(name, range(recorder.lanes))


def _wrench_input(recorder: Recorder) -> LaneArray:
    """Return the six components of the wrench, on the last lane."""
    empty = [None] * (recorder.lanes - 1)
    return array([recorder.input('wrench', [*empty, k]) for k in range(6)])


def _armature(recorder: Recorder, plant: Plant) -> Lanes | None:
    return None if plant.armature is None else recorder.constant(plant.armature)


def _torque(
    recorder: Recorder, plant: Plant, chain: Links, at: Pose, qd: Lanes, qdd: Lanes | None
) -> Lanes:
    """Return the torques of the links, of the wrench and of viscous friction."""
    wrench = None
    if plant.external_wrench:
        wrench = wrench_in_base_axes(recorder, at, _wrench_input(recorder))
    tau = newton_euler(recorder, chain, at, qd, qdd, plant.gravity, wrench)
    if plant.damping is not None:
        tau = tau + recorder.constant(plant.damping) * qd
    return tau


def _held(recorder: Recorder, rows: list[Lanes], y: Lanes) -> tuple[list[Lanes], Lanes]:
    """Return the equations with the accelerations of held joints set to zero."""
    with recorder.section('brakes'):
        free = _joint_input(recorder, 'free')
        n = recorder.lanes
        held = []
        for i in range(n):
            beyond = on(rows[i], range(i + 1, n))
            if i < n - 1:
                beyond = where(free, where(broadcast(free, i), beyond, 0.0), 0.0)
            held.append(merge(beyond, on(rows[i], [i])))
        return held, where(free, y, 0.0)
