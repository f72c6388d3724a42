# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Gravity torques and potential energy on one processor, with grouped inertial parameters.

With M_i and h_i the mass and the first moment about the origin of B_i of the grouped links i..n,
and a = -g in the axes of each link

    h_i = h of link i + R_(i+1) h_(i+1) + M_(i+1) r_(i+1)                tip to base
    tau_i = z . (h_i x a)  [rotational],  M_i z . a  {translational}
    U = a . (R_0 (R_1 h_1 + M_1 r_1) + M_1 p_0)

p_0 and R_0 are the origin and axes of frame 0 in the frame of the base link, where U is zero for
a mass at the origin. First moments add up: no force and no moment is carried along the chain.
Effects of the joints with a potential, such as springs, come from pfd_core.model.effects.

Gravity that motor controllers compensate is subtracted, as inverse dynamics does: the torques are
the commanded ones, and the energy has the work of the commanded torques alone. Brakes, limits of
the drives and the wrench play no part.

Base parameters of pfd_core.algorithms.grouped.links. One register holds one number; everything of
link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pfd_core.algorithms.chain.drives import commanded_torques
from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.algorithms.chain.joint_torques import plus_joint_torques, stored_energies
from pfd_core.algorithms.grouped.newton_euler import Link, inward, links_at, outward
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import constants, dot
from pfd_core.model import Plant
from pfd_core.model.geometry import product


def record_gravity_torques(plant: Plant) -> Program:
    """
    Return the program of the gravity torques, (n,), from q: the commanded tau at rest.

    With the torques that joints take at rest, such as springs, without wrench.
    """
    recorder = Recorder(1, 'sequential')
    q = input_list(recorder, 'q', plant.robot.n)
    links, _ = links_at(recorder, plant, q)
    with recorder.section('gravity'):
        tau = _gravity_torques(recorder, plant, links)
        tau = plus_joint_torques(plant, tau, [recorder.constant(0.0) for _ in q])
        tau = commanded_torques(plant, tau)
    return program_with_outputs(recorder, gravity=tau)


def potential_energy(
    recorder: Recorder, plant: Plant, links: Sequence[Link], q: Sequence[Lanes]
) -> Lanes:
    """Return the potential energy of gravity and of the effects of the joints [J]."""
    energy = _gravity_energy(recorder, plant, links)
    model = plant.gravity_compensation
    if model is not None:
        energy = energy - _gravity_energy(recorder, model, links_at(recorder, model, q)[0])
    for stored in stored_energies(plant, q):
        energy = energy + stored
    return energy


def _gravity_torques(recorder: Recorder, plant: Plant, links: Sequence[Link]) -> list[Lanes]:
    a = constants(recorder, -plant.gravity)
    felt = []
    for link in links:
        a = outward(link, a)
        felt.append(a)
    tau: list[Lanes] = []
    for link, a, (m, h) in zip(links[::-1], felt[::-1], _composites(links), strict=True):
        tau.insert(0, m * a[2] if link.slides else h[0] * a[1] - h[1] * a[0])
    return tau


def _gravity_energy(recorder: Recorder, plant: Plant, links: Sequence[Link]) -> Lanes:
    *_, (m, h) = _composites(links)
    h = inward(links[0], h) + m * links[0].r
    # Gravity of the plant is in axes of frame 0.
    origin = product(plant.robot.base_rotation.T, plant.robot.base_position)
    return dot(constants(recorder, -plant.gravity), h + m * constants(recorder, origin))


def _composites(links: Sequence[Link]) -> Iterator[tuple[Lanes, LaneArray]]:
    """Yield mass and first moment of links i..n about the origin of B_i, tip to base."""
    m, h = links[-1].m, links[-1].h
    yield m, h
    for link, beyond in zip(links[-2::-1], links[:0:-1], strict=True):
        h = link.h + inward(beyond, h) + m * beyond.r
        m = link.m + m
        yield m, h
