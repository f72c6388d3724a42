# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kinetic and potential energy on one processor.

The velocity of each link, base to tip, and its kinetic energy:

    w_i = R'w [+ z qd],  v_i = R'(v + w x r) {+ z qd}                [rotational], {translational}
    T = sum of w . (I w / 2 + h x v) + m v.v / 2 + rotor qd^2 / 2

The energy of a single grouped link has no physical meaning; only the sum has.

Potential energy is that of gravity (pfd_core.dynamics.gravity) and of the effects of the joints,
such as springs. Gravity that motor controllers compensate is subtracted: the energy has the work
of the commanded torques alone. Brakes, limits of the drives and the wrench play no part.
"""

from __future__ import annotations

from typing import Any

from pfd_core.dynamics.chain import Chain, chain_of
from pfd_core.dynamics.gravity import gravity_energy
from pfd_core.dynamics.interface import program_with_outputs
from pfd_core.dynamics.joint_torques import stored_energies
from pfd_core.dynamics.joints import turned_back
from pfd_core.dynamics.numbers import rotors
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray
from pfd_core.machine.vectors import UPPER, array, cross, dot
from pfd_core.model import Plant


def record_energy(plant: Plant) -> Program:
    """
    Return the program of the energy, kinetic and potential, (2,) [J], from q and qd.

    Rotors have kinetic energy, springs and gravity potential energy, zero for gravity at the
    origin of the base link's frame. Its rate is the power of the commanded torques and the wrench
    minus that lost to damping.
    """
    chain = chain_of(plant)
    with chain.recorder.section('energy'):
        energy = [_kinetic(chain), _potential(chain)]
    return program_with_outputs(chain.recorder, energy=energy)


def _kinetic(chain: Chain) -> Any:
    qd = chain.inputs('qd')
    energy: Any = 0.0
    w = v = array([0.0] * 3)
    for joint, rate, (m, h, J) in zip(chain.joints, qd, chain.links, strict=True):
        w, v = turned_back(joint, w), turned_back(joint, v + cross(w, joint.r))
        line = v if joint.slides else w
        line[2] = line[2] + rate
        energy = energy + dot(w, _half_momentum(J, w) + cross(h, v))
        energy = energy + (0.5 * m) * dot(v, v)
    for rotor, rate in zip(rotors(chain.recorder, chain.plant), qd, strict=True):
        energy = energy + (0.5 * rotor * rate) * rate
    return energy


def _half_momentum(J: LaneArray, w: LaneArray) -> LaneArray:
    """Return a vector whose product with w is w . J w / 2, by the upper triangle of J alone."""
    xx, xy, xz, yy, yz, zz = (J[k] for k in UPPER)
    return array(
        [
            (0.5 * xx) * w[0] + xy * w[1] + xz * w[2],
            (0.5 * yy) * w[1] + yz * w[2],
            (0.5 * zz) * w[2],
        ]
    )


def _potential(chain: Chain) -> Any:
    energy = gravity_energy(chain)
    model = chain.plant.gravity_compensation
    if model is not None:
        energy = energy - gravity_energy(chain_of(model, recorder=chain.recorder))
    for stored in stored_energies(chain.plant, chain.inputs('q')):
        energy = energy + stored
    return energy
