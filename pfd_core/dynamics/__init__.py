# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Serial dynamics: the algorithms that kernels are made of, each recorded once as a program.

    methods        the table of methods of forward dynamics, by name
    quantities     the table of quantities of kernels: H, bias, energy, tip and the like

    links          parameters of a chain in joint axes, as given and grouped, as numbers
    numbers        numbers of a plant: constants, or elements of the input `p`
    bodies         numbers of links with a payload, or of arms that differ, for `p`
    parameters     what differs among the arms of an ensemble, checked
    joints         what crosses a joint: vectors, forces, bodies; sweeps over a chain of joints
    chain          the chain at the input q: joints and links, grouped or as given

    joint_torques  torques of the joints themselves, from pfd_core.model.effects
    drives         motor torques: gravity compensation, effort limits, torque-speed tables
    actuators      servos and limits of motors, which decide once a control cycle

    newton_euler   torques of links: inverse dynamics, bias, y = tau - bias
    composite      H by composite bodies or by columns, its factors L' D L, and qdd
    articulated    qdd by articulated bodies
    conjugate      qdd by conjugate gradients
    energy         kinetic and potential energy, gravity torques
    frames         pose, Jacobian and velocity of a frame, joint torques of a wrench on it

    derivatives    d inverse dynamics / d(q, qd), over composite bodies that move
    acceleration   d qdd / d(q, qd, tau): the factors D and X = H^-1, refined
    refinement     a method with steps of iterative refinement, its error estimate, and whether an
                   iterative method has converged, by the equations of motion

A new effect of a joint is a record in pfd_core.model.effects, and nothing in here changes. An
effect of the motors has its torques in `drives` as well, an effect of the links or of gravity in
`newton_euler` (on n lanes in pfd_core.paper.newton_euler). A new
method is a function and a row of `methods`, a new quantity a function and a row of `quantities`.
Modules that the tables name are imported at their first use.

Inputs of programs are `q`, `qd` and `qdd` or `tau`, (n,), and where the scene needs them `wrench`,
(6,): force and moment exerted on the last link, in its axes, about its origin, and `free`, (n,): 1
for a joint that moves and 0 for a joint that its brake holds. On n lanes an input of n elements is
one row, an element per lane; on one processor it is a list of n numbers, each in its register.
"""
