# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Inverse dynamics on one processor, in joint axes, with the parameters that the robot is given by.

    tau = ID(q, qd, qdd):  f = m (a + W c),  n = J wd + w x J w + c x f,  sums of both from the tip

c is the centre of mass of a link and J its inertia about it. The motion of a link (a, w, wd, W)
is as in pfd_core.algorithms.grouped.newton_euler. Parameters are not grouped, so that the torque
of each link is accurate relative to its own terms: the residual of refinement needs that. Beside
a method with grouped parameters its angular velocities are the same expressions, recorded once.

Luh, Walker and Paul 1980.

One register holds one number; everything of link i is in axes B_i.
"""

from __future__ import annotations

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.algorithms.chain.joint_torques import plus_joint_torques
from pfd_core.algorithms.grouped.links import centered_links
from pfd_core.algorithms.grouped.newton_euler import axes_at, joint_torques, moment, motions
from pfd_core.algorithms.grouped.payload_input import last_body
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.machine.vectors import UPPER, constants, cross
from pfd_core.model import Plant


def record_link_torques(plant: Plant) -> Program:
    """Return the program of tau, (n,), from q, qd and qdd; always sequential."""
    recorder = Recorder(1, 'sequential')
    numbers, tip = centered_links(plant)
    q, qd, qdd = (input_list(recorder, name, plant.robot.n) for name in ('q', 'qd', 'qdd'))
    with recorder.section('rotations'):
        axes = [axes_at(recorder, link, q[i]) for i, link in enumerate(numbers)]
    with recorder.section('torques'):
        forces = []
        moving = motions(recorder, plant, axes, qd, qdd)
        for link, motion in zip(numbers, moving, strict=True):
            if plant.payload_input and link is numbers[-1]:
                m, center, J = last_body(recorder, plant.robot)
            else:
                center = constants(recorder, link.center)
                J = constants(recorder, [link.J[k] for k in UPPER])
                m = recorder.constant(link.m)
            f = m * (motion.a + motion.spin @ center)
            forces.append((f, moment(motion, J) + cross(center, f)))
        tau = joint_torques(recorder, plant, axes, tip, forces)
        tau = plus_joint_torques(plant, tau, qd, qdd)
    return program_with_outputs(recorder, tau=tau)
