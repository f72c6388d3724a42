# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Torques of links by the Newton-Euler recursion, on one processor: inverse dynamics and the bias.

    tau = H(q) qdd + bias(q, qd),        H(q) qdd = y = tau - bias - torques of the joints at qd

With W = [wd] + [w][w], so that W p is the acceleration of a point p relative to the origin of its
link, [rotational] and {translational}, base to tip:

    w_i = R'w [+ z qd],  wd_i = R'wd [+ R'w x z qd + z qdd]
    a_i = R'(a + W r) {+ 2 R'w x z qd + z qdd}
    f = m a + W h,  n = I wd + w x I w + h x a         grouped: h and I about the origin
    f = m (a + W c),  n = J wd + w x J w + c x f       as given: J about the centre of mass c

and the sums of f and n from the tip. The base is accelerated by minus gravity. Columns of H are
these torques for unit accelerations at rest; what is zero then costs nothing.

Luh, Walker and Paul 1980; base parameters Khalil and Kleinfinger 1987. Serial cost, rotational
joints of a skew chain without a wrench, multiplications and additions: the bias 96n - 95 and
86n - 92 from n = 3 on, torques of n accelerations at rest 68n - 67 and 56n - 62 from n = 2 on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from pfd_core.dynamics.chain import Chain, chain_of
from pfd_core.dynamics.drives import commanded_torques, motor_torques
from pfd_core.dynamics.energy import gravity_torques
from pfd_core.dynamics.joint_torques import minus_joint_torques, plus_joint_torques
from pfd_core.dynamics.joints import Force, along, force_in, force_sum, from_tip, turned_back
from pfd_core.dynamics.links import CENTERED, GROUPED
from pfd_core.dynamics.numbers import Numbers, wrench_input
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, constants, cross
from pfd_core.model.plant import Plant
from pfd_core.model.robot import gathered, spread


class Motion(NamedTuple):
    """Motion of a link, in its axes B_i."""

    w: LaneArray  # (3,), angular velocity [rad/s]
    wd: LaneArray  # (3,), angular acceleration [rad/s^2]
    a: LaneArray  # (3,), acceleration of the origin, minus gravity [m/s^2]
    squares: tuple[Any, ...]  # xx, xy, xz, yy, yz, zz of w w'
    W: LaneArray  # (3, 3), [wd] + [w][w]


def record_inverse_dynamics(plant: Plant) -> Program:
    """
    Return the program of the commanded tau, (n,), from q, qd and qdd.

    For the links, gravity, the wrench, damping, springs and rotors, less the gravity torques that
    motor controllers add. Brakes and motor limits are ignored.
    """
    return record_link_torques(plant, GROUPED, commanded=True)


def record_bias_torques(plant: Plant) -> Program:
    """Return the program of the bias, (n,), from q and qd: the commanded tau at qdd = 0."""
    chain = chain_of(plant)
    qd = chain.inputs('qd')
    with chain.recorder.section('torques'):
        bias = commanded_torques(plant, plus_joint_torques(plant, torques(chain, qd), qd))
    return chain.recorder.program(bias=bias)


def record_gravity_torques(plant: Plant) -> Program:
    """
    Return the program of the gravity torques, (n,), from q: the commanded tau at rest.

    With the torques that joints take at rest, such as springs, without wrench.
    """
    recorder = Recorder(1, 'sequential')
    with recorder.section('gravity'):
        tau = gravity_torques(recorder, plant)
        tau = plus_joint_torques(plant, tau, [recorder.constant(0.0) for _ in tau])
        tau = commanded_torques(plant, tau)
    return recorder.program(gravity=tau)


def record_link_torques(
    plant: Plant, parameters: str = CENTERED, commanded: bool = False
) -> Program:
    """
    Return the program of tau of the motors, or commanded, (n,), from q, qd and qdd.

    With `parameters` that are not grouped the torque of each link is accurate relative to its own
    terms: the residual of refinement needs that. Angular velocities are the same expressions.
    """
    chain = chain_of(plant, parameters)
    qd, qdd = chain.inputs('qd'), chain.inputs('qdd')
    with chain.recorder.section('torques'):
        tau = plus_joint_torques(plant, torques(chain, qd, qdd), qd, qdd)
        tau = commanded_torques(plant, tau) if commanded else tau
    return chain.recorder.program(tau=tau)


def right_side(chain: Chain) -> list[Lanes]:
    """Return y = torques of the motors - bias - torques of the joints, (n,) [N m or N]."""
    plant, recorder = chain.plant, chain.recorder
    qd = chain.inputs('qd')
    tau = motor_torques(plant, chain.inputs('tau'), qd)
    with recorder.section('bias'):
        bias = torques(chain, qd)
    with recorder.section('right-hand side'):
        y = [t - b for t, b in zip(tau, bias, strict=True)]
        return minus_joint_torques(plant, y, qd)


def torques(
    chain: Chain,
    qd: Sequence[Any],
    qdd: Sequence[Any] | None = None,
    first: int = 0,
    loads: bool = True,
) -> list[Any]:
    """
    Return the torques of rigid links, of the joints from `first` on [N m or N].

    qd and qdd, (n,) [rad/s or m/s, and per second], are values or numbers known while recording;
    without qdd these torques are the bias. Joints before `first` are at rest. Gravity and wrench
    act if `loads`. Followers move with their joints, which feel the torques of both.
    """
    robot = chain.plant.robot
    qd, qdd = spread(robot, qd), None if qdd is None else spread(robot, qdd)
    forces = [
        link_force(chain, i, motion)
        for i, motion in enumerate(motions(chain, qd, qdd, first, loads), first)
    ]
    if loads and chain.plant.external_wrench:
        forces[-1] = less_wrench(chain, forces[-1])
    sums = from_tip(chain.joints[first:], forces, force_sum, force_in)
    found = [along(joint, force) for joint, force in sums][::-1]
    return gathered(robot, found) if robot.followers else found


def motions(
    chain: Chain,
    qd: Sequence[Any],
    qdd: Sequence[Any] | None = None,
    first: int = 0,
    loads: bool = True,
) -> Iterator[Motion]:
    """Yield the motion of each link from `first` on; arguments as for `torques`."""
    zero = array([0.0] * 3)
    w, wd, a = zero, zero, zero
    if loads:
        a = Numbers(chain.recorder, chain.plant).all('base_acceleration')
    W: LaneArray | None = None  # of the link before
    for i, joint in enumerate(chain.joints[first:], first):
        w, wd = turned_back(joint, w), turned_back(joint, wd)
        a = turned_back(joint, a if W is None else a + W @ joint.r)
        if joint.slides:
            a = a + 2.0 * array([w[1] * qd[i], -(w[0] * qd[i]), 0.0])
        else:
            wd = array([wd[0] + w[1] * qd[i], wd[1] - w[0] * qd[i], wd[2]])
            w = array([w[0], w[1], w[2] + qd[i]])
        if qdd is not None:
            line = a if joint.slides else wd
            line[2] = line[2] + qdd[i]
        squares = tuple(w[j] * w[k] for j, k in UPPER)
        xx, xy, xz, yy, yz, zz = squares
        W = array(
            [
                [-(yy + zz), xy - wd[2], xz + wd[1]],
                [xy + wd[2], -(xx + zz), yz - wd[0]],
                [xz - wd[1], yz + wd[0], -(xx + yy)],
            ]
        )
        yield Motion(w, wd, a, squares, W)


def link_force(chain: Chain, i: int, motion: Motion) -> Force:
    """Return force and moment about the origin that a link needs for its motion."""
    m, v, J = chain.links[i]
    if chain.grouped:
        return m * motion.a + motion.W @ v, moment(motion, J) + cross(v, motion.a)
    f = m * (motion.a + motion.W @ v)
    return f, moment(motion, J) + cross(v, f)


def moment(motion: Motion, J: LaneArray) -> LaneArray:
    """Return J wd + w x J w for a symmetric J, (3, 3), from elements of W."""
    wd, W = motion.wd, motion.W
    _, sxy, sxz, _, syz, _ = motion.squares
    xx, xy, xz, yy, yz, zz = (J[k] for k in UPPER)
    return array(
        [
            xx * wd[0] + (zz - yy) * syz + yz * (W[1, 1] - W[2, 2]) + xz * W[1, 0] - xy * W[2, 0],
            yy * wd[1] + (xx - zz) * sxz + xz * (W[2, 2] - W[0, 0]) + xy * W[2, 1] - yz * W[0, 1],
            zz * wd[2] + (yy - xx) * sxy + xy * (W[0, 0] - W[1, 1]) + yz * W[0, 2] - xz * W[1, 2],
        ]
    )


def less_wrench(chain: Chain, force: Force) -> Force:
    """Return force and moment of the last link minus the input wrench on it."""
    k = wrench_input(chain.recorder)
    R, p = (constants(chain.recorder, x) for x in chain.tip)
    f = R @ k[:3]
    return force[0] - f, force[1] - (R @ k[3:] + cross(p, f))
