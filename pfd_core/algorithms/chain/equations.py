# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What whole programs on n lanes share: their inputs and outputs, the torque, the held joints.

Inputs are `q`, `qd` and `qdd` or `tau`, (n,), and where the scene asks for them `wrench`, (6,):
force and moment exerted on the last link, in its axes, about its origin, and `free`, (n,): one
for a joint that moves and zero for one that its brake holds.
"""

from __future__ import annotations

from collections.abc import Callable

from pfd_core.algorithms.chain.base_axes import Links, Pose, links, pose
from pfd_core.algorithms.paper.newton_euler import newton_euler, wrench_in_base_axes
from pfd_core.machine.lanes import broadcast, merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Plant


def begin(plant: Plant, schedule: str) -> tuple[Recorder, Links, Pose]:
    """Return a recorder on n lanes, the links on it, and where they are at the input q."""
    recorder = Recorder(plant.robot.n, schedule)
    chain = links(recorder, plant.robot, keep_tip=plant.external_wrench)
    return recorder, chain, pose(recorder, chain, joint_input(recorder, 'q'))


def finish(recorder: Recorder, **results: Lanes) -> Program:
    """Return the program whose outputs are these rows, one element per lane."""
    n = recorder.lanes
    for name, value in results.items():
        recorder.output(name, (n,), [(value, lane) for lane in range(n)])
    return recorder.program()


def joint_input(recorder: Recorder, name: str) -> Lanes:
    """Return an input of n elements, one per lane."""
    return recorder.input(name, range(recorder.lanes))


def wrench_input(recorder: Recorder) -> LaneArray:
    """Return the six components of the wrench, on the last lane."""
    empty = [None] * (recorder.lanes - 1)
    return array([recorder.input('wrench', [*empty, k]) for k in range(6)])


def armature(recorder: Recorder, plant: Plant) -> Lanes | None:
    """Return the rotors' inertia on lanes, if the scene has any."""
    return None if plant.armature is None else recorder.constant(plant.armature)


def torque(
    recorder: Recorder,
    plant: Plant,
    chain: Links,
    at: Pose,
    qd: Lanes,
    qdd: Lanes | None,
    of_links: Callable[..., Lanes] = newton_euler,
) -> Lanes:
    """
    Return the torques of the links, of the wrench and of viscous friction.

    The torques of links and wrench are left to a function with the arguments of newton_euler.
    """
    wrench = None
    if plant.external_wrench:
        wrench = wrench_in_base_axes(recorder, at, wrench_input(recorder))
    tau = of_links(recorder, chain, at, qd, qdd, plant.gravity, wrench)
    if plant.damping is not None:
        tau = tau + recorder.constant(plant.damping) * qd
    return tau


def held_joints(
    recorder: Recorder, rows: list[Lanes], y: Lanes
) -> tuple[list[Lanes], Lanes, Lanes]:
    """
    Return the equations with the accelerations of held joints set to zero, and the input `free`.

    A held joint has nothing but its own inertia left in its equation. That may be zero, so that
    a solve takes its pivot as infinite, whose reciprocal is zero.
    """
    with recorder.section('brakes'):
        free = joint_input(recorder, 'free')
        n = recorder.lanes
        held = []
        for i in range(n):
            beyond = on(rows[i], range(i + 1, n))
            if i < n - 1:
                beyond = where(free, where(broadcast(free, i), beyond, 0.0), 0.0)
            held.append(merge(beyond, on(rows[i], [i])))
        return held, where(free, y, 0.0), free
