# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pose, Jacobian and velocity of a frame, and the joint torques of a wrench, on one processor.

A frame is fixed to link k, at the pose (R_f, p_f) in axes B_k. Its origin seen from B_i's

    e_k = p_f,  e_(i-1) = r_i + R_i e_i                                  frame to base

and axes of the frame in the same way. Column i of the Jacobian, linear above angular:

    z x e_i, z  [rotational],  z, 0  {translational}

It is turned to the axes of the base link by R_1 .. R_i, which are made from the base outwards.
J qd is cheaper by a recursion from the frame to the base, (v, w) relative to link i - 1:

    v_(i-1) = R_i (v_i [+ z qd x e_i] {+ z qd}),  w_(i-1) = R_i (w_i [+ z qd])

and so is J' k, force and moment carried from the frame to the base.

Results are in axes of the base link, and positions are from the origin of its frame. The wrench
is in axes of the frame and about its origin, as the scene's wrench is in axes of the tip. Links
beyond the frame play no part: their columns, rates and torques are zero.

Lynch and Park 2017, chapter 5 (Jacobians), in axes B_i (pfd_core.dynamics.joints), or, along
parallel joints, in axes that differ from them by a turn about z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pfd_core.dynamics.chain import joints_at, positions
from pfd_core.dynamics.joints import (
    ABOUT_Z,
    Joint,
    along,
    force_in,
    inward,
    sum_of_angles,
    turned,
    turned_back,
    with_axis,
)
from pfd_core.dynamics.links import centered_links
from pfd_core.dynamics.numbers import wrench_input
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Recorder
from pfd_core.machine.vectors import array, constants, cross
from pfd_core.model.geometry import composed
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Frame, gathered, spread


def record_tip_pose(plant: Plant, frame: Frame) -> Program:
    """Return the program of the homogeneous pose, (4, 4), in the base link's frame, from q."""
    recorder, joints, R, e = _joints_to(plant, frame)
    with recorder.section('pose'):
        x, y = R[:, 0], R[:, 1]
        for joint in reversed(_turned_once(joints)):
            x, y, e = inward(joint, x), inward(joint, y), joint.r + inward(joint, e)
        R0, p0 = _base(recorder, plant, frame)
        x, y, e = R0 @ x, R0 @ y, p0 + R0 @ e
        rows = np.stack([x, y, cross(x, y), e], axis=1)
        pose = np.concatenate([rows, array([[0.0, 0.0, 0.0, 1.0]])])
    return recorder.program(pose=pose)


def record_tip_jacobian(plant: Plant, frame: Frame) -> Program:
    """Return the program of the Jacobian of a frame's origin, (6, n), linear first, from q."""
    recorder, joints, _, e = _joints_to(plant, frame)
    J = array([[0.0] * plant.robot.links] * 6)
    with recorder.section('jacobian'):
        joints = _turned_once(joints)
        levers: list[LaneArray] = []
        for joint in reversed(joints):
            levers.insert(0, e)
            e = joint.r + inward(joint, e)
        R, _ = _base(recorder, plant, frame)
        for i, (joint, (x, y, _)) in enumerate(zip(joints, levers, strict=True)):
            R = array([turned_back(joint, row) for row in R])
            if joint.slides:
                J[:3, i] = R[:, 2]
            else:
                J[:3, i] = x * R[:, 1] - y * R[:, 0]
                J[3:, i] = R[:, 2]
    return recorder.program(jacobian=[gathered(plant.robot, row) for row in J])


def record_tip_velocity(plant: Plant, frame: Frame) -> Program:
    """Return the program of J qd, (6,), linear first, from q and qd."""
    recorder, joints, _, e = _joints_to(plant, frame)
    rates = spread(plant.robot, recorder.input_list('qd', plant.robot.n))[: len(joints)]
    with recorder.section('velocity'):
        v = w = array([0.0] * 3)
        for joint, rate in zip(_turned_once(joints)[::-1], rates[::-1], strict=True):
            if joint.slides:
                v = with_axis(v, rate)
            else:
                v = array([v[0] - e[1] * rate, v[1] + e[0] * rate, v[2]])
                w = with_axis(w, rate)
            v, w, e = inward(joint, v), inward(joint, w), joint.r + inward(joint, e)
        R0, _ = _base(recorder, plant, frame)
    return recorder.program(velocity=np.concatenate([R0 @ v, R0 @ w]))


def record_wrench_torques(plant: Plant, frame: Frame) -> Program:
    """Return the program of J' k, (n,): torques of a wrench k on a frame, from q and wrench."""
    recorder, joints, R, p = _joints_to(plant, frame)
    k = wrench_input(recorder)
    torques: list[object] = [0.0] * plant.robot.links
    with recorder.section('wrench'):
        f = R @ k[:3]
        force = f, R @ k[3:] + cross(p, f)
        for i, joint in reversed(list(enumerate(joints))):
            torques[i] = along(joint, force)
            force = force_in(joint, force)
    return recorder.program(torques=gathered(plant.robot, torques))


def _joints_to(plant: Plant, frame: Frame) -> tuple[Recorder, list[Joint], LaneArray, LaneArray]:
    """Return a recorder, the joints to a frame at the input q, and its pose on the last link."""
    recorder = Recorder(1, 'sequential')
    q = positions(recorder, plant.robot)
    links = centered_links(plant.robot)[: frame.link]
    R, p = composed(links[-1].end, frame.placement) if links else frame.placement
    joints = joints_at(recorder, links, q[: frame.link])
    return recorder, joints, constants(recorder, R), constants(recorder, p)


def _turned_once(joints: Sequence[Joint]) -> list[Joint]:
    """
    Return joints in other axes along parallel joints: only the last of these turns its axes.

    z and origins stay. Angles are added by their cosines and sines, one planar rotation a joint;
    otherwise each vector that is carried along takes one.
    """
    result = list(joints)
    for i, joint in enumerate(joints):
        if i and joint.parallel:
            c, s = before = result[i - 1].turn
            result[i - 1] = replace(result[i - 1], turn=(1.0, 0.0))
            # Seen from an axis that may point the other way.
            turn = sum_of_angles((c, joint.twist[0] * s), joint.turn)
            result[i] = replace(joint, turn=turn, r=turned(before, ABOUT_Z, joint.r))
    return result


def _base(recorder: Recorder, plant: Plant, frame: Frame) -> tuple[LaneArray, LaneArray]:
    """Return the placement of frame 0, or of a frame on the base link."""
    robot = plant.robot
    R, p = (robot.base_rotation, robot.base_position) if frame.link else (np.eye(3), np.zeros(3))
    return constants(recorder, R), constants(recorder, p)
