# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kinetic and potential energy, and gravity torques, on one processor.

The velocity of each link, base to tip, and its kinetic energy:

    w_i = R'w [+ z qd],  v_i = R'(v + w x r) {+ z qd}                [rotational], {translational}
    T = sum of w . (I w / 2 + h x v) + m v.v / 2 + rotor qd^2 / 2

The energy of a single grouped link has no physical meaning; only the sum has.

Gravity acts on first moments. With M_i and h_i mass and first moment of links i..n about the
origin of B_i, and a = -g

    h_i = h of link i + R_(i+1) h_(i+1) + M_(i+1) r_(i+1)                tip to base
    tau_i = z . (h_i x a)  [rotational],  M_i z . a  {translational}
    U = a . (R_0 (R_1 h_1 + M_1 r_1) + M_1 p_0)

p_0 and R_0 are the origin and axes of frame 0 in the frame of the base link, where U is zero for
a mass at the origin. First moments add up: no force and no moment is carried along the chain.

Potential energy is that of gravity and of the effects of the joints, such as springs. Gravity that
motor controllers compensate is subtracted: the energy has the work of the commanded torques alone.
Brakes, limits of the drives and the wrench play no part.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from typing import Any

from pfd_core.dynamics.chain import Chain, chain_of
from pfd_core.dynamics.joint_torques import stored_energies
from pfd_core.dynamics.joints import Joint, from_tip, inward, turned_back
from pfd_core.dynamics.numbers import Numbers, rotors
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, constants, cross, dot
from pfd_core.model.geometry import product
from pfd_core.model.plant import Plant
from pfd_core.model.robot import gathered, spread


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
    return chain.recorder.program(energy=energy)


def _kinetic(chain: Chain) -> Any:
    qd = chain.inputs('qd')
    energy: Any = 0.0
    w = v = array([0.0] * 3)
    rates = spread(chain.plant.robot, qd)
    for joint, rate, (m, h, J) in zip(chain.joints, rates, chain.links, strict=True):
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


def gravity_torques(recorder: Recorder, model: Plant) -> list[Lanes]:
    """Return the torques that hold a model at rest at the input q, (n,) [N m or N]."""
    chain = chain_of(model, recorder=recorder)
    a = Numbers(recorder, model).all('base_acceleration')
    felt = accumulate(chain.joints, lambda v, joint: turned_back(joint, v), initial=a)
    _, *axes = felt
    torques = [
        m * a[2] if joint.slides else h[0] * a[1] - h[1] * a[0]
        for a, (joint, (m, h)) in zip(axes[::-1], _moments(chain), strict=True)
    ]
    return gathered(model.robot, torques[::-1])


def gravity_energy(chain: Chain) -> Lanes:
    """Return the potential energy of gravity at the input q [J]."""
    *_, (base, moment) = _moments(chain)
    m, h = _plus((0.0, 0.0), _moved(base, moment))
    # Gravity of the plant is in axes of frame 0.
    robot = chain.plant.robot
    origin = product(robot.base_rotation.T, robot.base_position)
    a = Numbers(chain.recorder, chain.plant).all('base_acceleration')
    p = constants(chain.recorder, origin)
    return dot(a, h + m * p)


def _moments(chain: Chain) -> Iterator[tuple[Joint, Any]]:
    """Yield each joint with mass and first moment of all links beyond it, tip to base."""
    return from_tip(chain.joints, [(m, h) for m, h, _ in chain.bodies()], _plus, _moved)


def _moved(joint: Joint, moment: Any) -> Any:
    m, h = moment
    return m, inward(joint, h), m * joint.r


def _plus(own: Any, moved: Any) -> Any:
    return own[0] + moved[0], own[1] + moved[1] + moved[2]
