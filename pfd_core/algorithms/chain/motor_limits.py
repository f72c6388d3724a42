# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The limits of motors that are decided once a control cycle, of inputs instead of constants.

    t = the commanded effort, within [-E, E]
    beyond the speed V of its motor a joint is driven along by at most F max(2 - |qd| / W, 0)

Real drives compute in cycles: the effort is held for the cycle, and is what a driver reports. All
limits are inputs, so that they change without a compiler. `drives` has the limits that act
continuously, as a part of a scene.
"""

from __future__ import annotations

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder

# Rows of the input `motors`, (4, n): E, F, W and V.
MOTOR_ROWS = ('effort', 'torque_speed_effort', 'torque_speed', 'speed')


def record_motor_limits(n: int) -> Program:
    """
    Return the program of the limited efforts from qd, the efforts tau and `motors`, (4, n).

    Its output is (2, n): the efforts, and |qd| / V of joints beyond V, 0 for the others.
    """
    recorder = Recorder(1, 'sequential')
    rates, efforts = (input_list(recorder, name, n) for name in ('qd', 'tau'))
    motors = input_list(recorder, 'motors', len(MOTOR_ROWS) * n)
    limited, excess = [], []
    for k in range(n):
        t, beyond = _limited(efforts[k], rates[k], motors[k::n])
        limited.append(t)
        excess.append(beyond)
    return program_with_outputs(recorder, limited=[*limited, *excess])


def _limited(t: Lanes, qd: Lanes, motor: list[Lanes]) -> tuple[Lanes, Lanes]:
    """Return the limited effort of a joint, and its speed in excess of V as a multiple of V."""
    most, full, falling, speed = motor
    constant = t.recorder.constant
    zero = constant([0.0])
    t = where(t - most, most, t)
    t = where(-most - t, -most, t)
    rate = absolute(qd)
    left = constant([2.0]) - rate / falling
    there = full * where(left, left, zero)
    driven = where(t - there, there, t)
    braking = where(-there - t, -there, t)
    fast = rate - speed
    t = where(fast, where(qd, driven, braking), t)
    return t, where(fast, rate / speed, zero)
