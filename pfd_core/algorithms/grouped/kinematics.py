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

Lynch and Park 2017, chapter 5 (Jacobians), in axes of pfd_core.algorithms.grouped.links. One
register holds one number; everything of link i is in axes B_i, or, along parallel joints, in axes
that differ by a turn about z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs, wrench_input
from pfd_core.algorithms.chain.link_axes import planar
from pfd_core.algorithms.grouped.links import centered_links
from pfd_core.algorithms.grouped.newton_euler import Axes, axes_at, inward, moved, outward
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, constants, cross
from pfd_core.model import Frame, Plant
from pfd_core.model.geometry import product


def record_pose(plant: Plant, frame: Frame) -> Program:
    """Return the program of the homogeneous pose, (4, 4), in the base link's frame, from q."""
    recorder, links, R, e = _links_to(plant, frame)
    with recorder.section('pose'):
        links = _turned_once(links)
        x, y = R[:, 0], R[:, 1]
        for link in reversed(links):
            x, y, e = inward(link, x), inward(link, y), link.r + inward(link, e)
        R0, p0 = _base(recorder, plant, frame)
        x, y, e = R0 @ x, R0 @ y, p0 + R0 @ e
        rows = np.stack([x, y, cross(x, y), e], axis=1)
        last = constants(recorder, [[0.0, 0.0, 0.0, 1.0]])
    return _program(recorder, 'pose', np.concatenate([rows, last]))


def record_jacobian(plant: Plant, frame: Frame) -> Program:
    """Return the program of the Jacobian of a frame's origin, (6, n), linear first, from q."""
    recorder, links, _, e = _links_to(plant, frame)
    J = constants(recorder, np.zeros((6, plant.robot.n)))
    with recorder.section('jacobian'):
        links = _turned_once(links)
        levers: list[LaneArray] = []
        for link in reversed(links):
            levers.insert(0, e)
            e = link.r + inward(link, e)
        R, _ = _base(recorder, plant, frame)
        for i, (link, (x, y, _)) in enumerate(zip(links, levers, strict=True)):
            R = array([outward(link, row) for row in R])
            if link.slides:
                J[:3, i] = R[:, 2]
            else:
                J[:3, i] = x * R[:, 1] - y * R[:, 0]
                J[3:, i] = R[:, 2]
    return _program(recorder, 'jacobian', J)


def record_velocity(plant: Plant, frame: Frame) -> Program:
    """Return the program of J qd, (6,), linear first, from q and qd."""
    recorder, links, _, e = _links_to(plant, frame)
    rates = input_list(recorder, 'qd', plant.robot.n)
    with recorder.section('velocity'):
        links = _turned_once(links)
        v, w = constants(recorder, np.zeros((2, 3)))
        for link, rate in reversed(list(zip(links, rates, strict=False))):
            if link.slides:
                v = array([v[0], v[1], v[2] + rate])
            else:
                v = array([v[0] - e[1] * rate, v[1] + e[0] * rate, v[2]])
                w = array([w[0], w[1], w[2] + rate])
            v, w, e = inward(link, v), inward(link, w), link.r + inward(link, e)
        R0, _ = _base(recorder, plant, frame)
    return _program(recorder, 'velocity', np.concatenate([R0 @ v, R0 @ w]))


def record_wrench_torques(plant: Plant, frame: Frame) -> Program:
    """Return the program of J' k, (n,): torques of a wrench k on a frame, from q and wrench."""
    recorder, links, R, p = _links_to(plant, frame)
    k = wrench_input(recorder)
    tau = [recorder.constant(0.0)] * plant.robot.n
    with recorder.section('wrench'):
        f = R @ k[:3]
        n = R @ k[3:] + cross(p, f)
        for i, link in reversed(list(enumerate(links))):
            tau[i] = f[2] if link.slides else n[2]
            f, n = moved(link, f, n)
    return program_with_outputs(recorder, torques=tau)


def _links_to(plant: Plant, frame: Frame) -> tuple[Recorder, list[Axes], LaneArray, LaneArray]:
    """Return a recorder, the links to a frame at the input q, and its pose on the last one."""
    recorder = Recorder(1, 'sequential')
    q = input_list(recorder, 'q', plant.robot.n)
    numbers = centered_links(plant)[0][: frame.link]
    with recorder.section('rotations'):
        links = [axes_at(recorder, *pair) for pair in zip(numbers, q, strict=False)]
    R, p = frame.rotation, frame.translation
    if numbers:
        end = numbers[-1].end
        R, p = product(end.rotation, R), end.p + product(end.rotation, p)
    return recorder, links, constants(recorder, R), constants(recorder, p)


def _turned_once(links: Sequence[Axes]) -> list[Axes]:
    """
    Return links in other axes along parallel joints: only the last of these joints turns its axes.

    z and origins stay. Angles are added by their cosines and sines, one planar rotation a joint;
    otherwise each vector that is carried along takes one.
    """
    result = list(links)
    for i, link in enumerate(links):
        if i and link.parallel:
            c, s = result[i - 1].turn
            (c0, s0), (x, y, z) = link.turn, link.r
            result[i - 1] = replace(result[i - 1], turn=planar(c.recorder, (1.0, 0.0)))
            r = array([c * x - s * y, s * x + c * y, z])
            s = link.twist[0] * s  # seen from an axis that points the other way
            result[i] = replace(link, turn=(c * c0 - s * s0, s * c0 + c * s0), r=r)
    return result


def _base(recorder: Recorder, plant: Plant, frame: Frame) -> tuple[LaneArray, LaneArray]:
    """Return the placement of frame 0, or of a frame on the base link."""
    robot = plant.robot
    R, p = (robot.base_rotation, robot.base_position) if frame.link else (np.eye(3), np.zeros(3))
    return constants(recorder, R), constants(recorder, p)


def _program(recorder: Recorder, name: str, values: LaneArray) -> Program:
    places: Sequence[tuple[Lanes, int]] = [(value, 0) for value in values.ravel().tolist()]
    recorder.output(name, values.shape, places)
    return recorder.program()
