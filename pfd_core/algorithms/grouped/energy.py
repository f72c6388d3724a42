# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kinetic and potential energy on one processor, with grouped inertial parameters.

The velocity of each link, base to tip, and its kinetic energy:

    w_i = R'w [+ z qd],  v_i = R'(v + w x r) {+ z qd}                [rotational], {translational}
    T = sum of w . (I w / 2 + h x v) + m v.v / 2 + rotor qd^2 / 2

The energy of a single grouped link has no physical meaning; only the sum has. The
potential energy is from pfd_core.algorithms.grouped.gravity.

Base parameters of pfd_core.algorithms.grouped.links. One register holds one number; everything of
link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.algorithms.grouped.gravity import potential_energy
from pfd_core.algorithms.grouped.newton_euler import Link, links_at, outward
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, dot
from pfd_core.model import Plant


def record_energy(plant: Plant) -> Program:
    """
    Return the program of the energy, kinetic and potential, (2,) [J], from q and qd.

    Rotors have kinetic energy, springs and gravity potential energy, zero for gravity at the
    origin of the base link's frame. Its rate is the power of the commanded torques and the wrench
    minus that lost to damping.
    """
    recorder = Recorder(1, 'sequential')
    q, qd = (input_list(recorder, name, plant.robot.n) for name in ('q', 'qd'))
    links, _ = links_at(recorder, plant, q)
    with recorder.section('energy'):
        kinetic = _kinetic_energy(recorder, plant, links, qd)
        potential = potential_energy(recorder, plant, links, q)
    return program_with_outputs(recorder, energy=[kinetic, potential])


def _kinetic_energy(
    recorder: Recorder, plant: Plant, links: Sequence[Link], qd: Sequence[Lanes]
) -> Lanes:
    energy = zero = recorder.constant(0.0)
    w, v = array([zero] * 3), array([zero] * 3)
    for link, rate in zip(links, qd, strict=True):
        w, v = outward(link, w), outward(link, v + cross(w, link.r))
        along = v if link.slides else w
        along[2] = along[2] + rate
        energy = energy + dot(w, _half_momentum(link.inertia, w) + cross(link.h, v))
        energy = energy + (0.5 * link.m) * dot(v, v)
    if plant.inertia is not None:
        for rotor, rate in zip(plant.inertia, qd, strict=True):
            energy = energy + (0.5 * float(rotor) * rate) * rate
    return energy


def _half_momentum(inertia: LaneArray, w: LaneArray) -> LaneArray:
    """Return a vector whose product with w is w . I w / 2, by the upper triangle of I alone."""
    xx, xy, xz, yy, yz, zz = inertia
    return array(
        [
            (0.5 * xx) * w[0] + xy * w[1] + xz * w[2],
            (0.5 * yy) * w[1] + yz * w[2],
            (0.5 * zz) * w[2],
        ]
    )
