# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The equations of motion on n lanes, for the methods with a lane for each link.

    H(q) qdd = y,   y = torques of the motors - bias - torques of the joints at q, qd

Lee and Chang 1987, eqs (2.a), (2.b), where joints have no torques besides the motors'.
Link torques and bias are computed by a function that the caller chooses, newton_euler of the
paper or another with the same arguments. Lane i holds joint and link i + 1.
"""

from __future__ import annotations

from collections.abc import Callable

from pfd_core.algorithms.chain.base_axes import (
    Links,
    Pose,
    Recurrence,
    chain_on_lanes,
    wrench_in_base_axes,
)
from pfd_core.algorithms.chain.gravity import gravity_torques_on_lanes
from pfd_core.dynamics.drives import Gravity, motor_torques
from pfd_core.dynamics.interface import input_row, wrench_input
from pfd_core.dynamics.joint_torques import plus_joint_torques
from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant
from pfd_core.paper.lanes import broadcast
from pfd_core.paper.patterns import prefix_product

# Torques of links, gravity and wrench: (recorder, links, pose, qd, qdd, gravity, wrench).
LinkTorques = Callable[..., Lanes]


def forward_equations(
    plant: Plant,
    schedule: str,
    link_torques: LinkTorques,
    orientation: Recurrence = prefix_product,
) -> tuple[Recorder, Links, Pose, Lanes]:
    """
    Return a recorder on n lanes, the links, their pose at the input q, and y [N m or N].

    `orientation` as for pfd_core.algorithms.chain.base_axes.pose.
    """
    recorder, chain, at = chain_on_lanes(plant, schedule, orientation)
    qd, tau = input_row(recorder, 'qd'), input_row(recorder, 'tau')
    (tau,) = motor_torques(plant, [tau], [qd], compensation(plant, chain, at))
    bias = torques(plant, chain, at, qd, None, link_torques)
    with recorder.section('right-hand side'):
        return recorder, chain, at, tau - bias


def compensation(plant: Plant, chain: Links, at: Pose) -> Gravity:
    """Return the gravity torques of a model as a function of it, for links and their pose."""
    return lambda model: [gravity_torques_on_lanes(chain, at, plant, model)]


def torques(
    plant: Plant, chain: Links, at: Pose, qd: Lanes, qdd: Lanes | None, link_torques: LinkTorques
) -> Lanes:
    """Return the torques of links, gravity, wrench and joints; without qdd the bias."""
    recorder = qd.recorder
    wrench = None
    if plant.external_wrench:
        wrench = wrench_in_base_axes(at, wrench_input(recorder))
    tau = link_torques(recorder, chain, at, qd, qdd, plant.gravity, wrench)
    (tau,) = plus_joint_torques(plant, [tau], [qd], None if qdd is None else [qdd])
    return tau


def armature(recorder: Recorder, plant: Plant) -> Lanes | None:
    """Return the rotors' inertia on lanes, if the scene has any."""
    return None if plant.inertia is None else recorder.constant(plant.inertia)


def held_joints(rows: list[Lanes], y: Lanes) -> tuple[list[Lanes], Lanes, Lanes]:
    """
    Return H and y with the accelerations of braked joints set to zero, and the input `free`.

    Of a braked joint's equation the diagonal element remains. It may be zero, so that a solve
    takes its pivot as infinite, whose reciprocal is zero.
    """
    recorder = y.recorder
    with recorder.section('brakes'):
        free = input_row(recorder, 'free')
        n = recorder.lanes
        held = []
        for i in range(n):
            beyond = on(rows[i], range(i + 1, n))
            if i < n - 1:
                beyond = where(free, where(broadcast(free, i), beyond, 0.0), 0.0)
            held.append(merge(beyond, on(rows[i], [i])))
        return held, where(free, y, 0.0), free
