# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Inverse dynamics and the bias on one processor, with grouped inertial parameters.

    tau = H(q) qdd + bias(q, qd)

The torques are the commanded ones: for the links, gravity, the wrench, damping, springs and
rotors, minus the gravity torques that the motor controllers add. Brakes and motor
limits are ignored. The recursion is pfd_core.algorithms.grouped.newton_euler (Luh, Walker and
Paul 1980).

This program takes half the operations of pfd_core.algorithms.programs.record_inverse_dynamics
(NE1, written for n lanes), and a tenth fewer than link_torques, whose
parameters are not grouped.
"""

from __future__ import annotations

from typing import Any

from pfd_core.algorithms.chain.drives import commanded_torques
from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.algorithms.chain.joint_torques import plus_joint_torques
from pfd_core.algorithms.grouped.newton_euler import chain_torques, links_at
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model import Plant


def record_grouped_inverse_dynamics(plant: Plant) -> Program:
    """Return the program of the commanded tau, (n,), from q, qd and qdd."""
    return _record(plant, 'tau', 'q', 'qd', 'qdd')


def record_bias_torques(plant: Plant) -> Program:
    """Return the program of the bias, (n,), from q and qd: the commanded tau at qdd = 0."""
    return _record(plant, 'bias', 'q', 'qd')


def _record(plant: Plant, output: str, *inputs: str) -> Program:
    recorder = Recorder(1, 'sequential')
    q, *rates = (input_list(recorder, name, plant.robot.n) for name in inputs)
    links, tip = links_at(recorder, plant, q)
    with recorder.section('torques'):
        tau = chain_torques(recorder, plant, links, tip, *rates)
        tau = commanded_torques(plant, plus_joint_torques(plant, tau, *rates))
    results: dict[str, Any] = {output: tau}
    return program_with_outputs(recorder, **results)
