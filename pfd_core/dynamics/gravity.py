# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Gravity torques and potential energy on one processor, by first moments.

With M_i and h_i mass and first moment of links i..n about the origin of B_i, and a = -g

    h_i = h of link i + R_(i+1) h_(i+1) + M_(i+1) r_(i+1)                tip to base
    tau_i = z . (h_i x a)  [rotational],  M_i z . a  {translational}
    U = a . (R_0 (R_1 h_1 + M_1 r_1) + M_1 p_0)

p_0 and R_0 are the origin and axes of frame 0 in the frame of the base link, where U is zero for
a mass at the origin. First moments add up: no force and no moment is carried along the chain.
These are the torques of the links; effects of the joints, such as springs, are added by callers.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from typing import Any

from pfd_core.dynamics.chain import Chain, chain_of
from pfd_core.dynamics.joints import Joint, from_tip, inward, turned_back
from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.vectors import constants, dot
from pfd_core.model import Plant
from pfd_core.model.geometry import product


def gravity_torques(recorder: Recorder, model: Plant) -> list[Lanes]:
    """Return the torques that hold a model at rest at the input q, (n,) [N m or N]."""
    chain = chain_of(model, recorder=recorder)
    a = Numbers(recorder, model).all('base_acceleration')
    felt = accumulate(chain.joints, lambda v, joint: turned_back(joint, v), initial=a)
    _, *axes = felt
    return [
        m * a[2] if joint.slides else h[0] * a[1] - h[1] * a[0]
        for a, (joint, (m, h)) in zip(axes[::-1], _moments(chain), strict=True)
    ][::-1]


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
