# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The actuators, which decide on efforts once a control cycle; all settings are inputs.

    w = tau + p (target position - q) + d (target velocity - qd)    of a joint with a target
    t = w within [-E, E]
    beyond the speed V of its motor a joint is driven along by at most F max(2 - |qd| / W, 0)

NaN is no target: a joint with a position alone goes to rest there, one with a velocity
alone has d only. Real drives compute in cycles: the effort is held for the cycle, and is what a
driver reports. `drives` has the limits that act continuously, as a part of a scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.effects import NO_EFFORT

# Rows of the input `motors`, (7, n): E, F, W, V, p, d and the largest change of w in a cycle.
MOTOR_ROWS = ('effort', 'torque_speed_effort', 'torque_speed', 'speed', 'p', 'd', 'jump')
# Rows of the input `targets`, (2, n), and of the output, (4, n).
TARGET_ROWS = ('position', 'velocity')
OUTPUT_ROWS = ('limited', 'excess', 'wanted', 'jump')


def record_actuators(n: int) -> Program:
    """
    Return the program of the efforts that act, from q, qd, tau, motors, targets and `before`.

    Its output is (4, n): the efforts; |qd| / V of joints beyond V, 0 for the others; w; and the
    change of w since the cycle before, (n,), NaN where `before` is NaN.
    """
    recorder = Recorder(1, 'sequential')
    q, qd, tau, before = (input_list(recorder, name, n) for name in ('q', 'qd', 'tau', 'before'))
    motors = input_list(recorder, 'motors', len(MOTOR_ROWS) * n)
    targets = input_list(recorder, 'targets', len(TARGET_ROWS) * n)
    half, two = recorder.constant([0.5]), recorder.constant([2.0])
    rows = []
    for k in range(n):
        motor = dict(zip(MOTOR_ROWS, motors[k::n], strict=True))
        wanted = _followed(tau[k], q[k], qd[k], targets[k::n], motor['p'], motor['d'])
        # Halves: a difference of the largest numbers would overflow.
        jump = two * absolute(half * wanted - half * before[k])
        rows.append((*_limited(wanted, qd[k], motor), wanted, jump))
    return program_with_outputs(
        recorder, actuators=[value for row in zip(*rows, strict=True) for value in row]
    )


def _followed(
    tau: Lanes, q: Lanes, qd: Lanes, target: Sequence[Lanes], p: Lanes, d: Lanes
) -> Lanes:
    """Return the effort of a servo with a target, and tau without one."""
    position, velocity = target
    constant = tau.recorder.constant
    zero, one = constant([0.0]), constant([1.0])
    # NaN is not above zero.
    there, moving = absolute(position) + one, absolute(velocity) + one
    p, d = where(there, p, zero), where(there, d, where(moving, d, zero))
    position, velocity = where(there, position, zero), where(moving, velocity, zero)
    effort = tau + p * (position - q) + d * (velocity - qd)
    result: Lanes = where(there, effort, where(moving, effort, tau))
    return result


def _limited(t: Lanes, qd: Lanes, motor: Mapping[str, Lanes]) -> tuple[Lanes, Lanes]:
    """Return the limited effort of a joint, and its speed in excess of V as a multiple of V."""
    most, full, falling, speed = (motor[name] for name in MOTOR_ROWS[:4])
    constant = t.recorder.constant
    zero = constant([0.0])
    t = where(t - most, most, t)
    t = where(-most - t, -most, t)
    rate = absolute(qd)
    left = constant([NO_EFFORT]) - rate / falling
    there = full * where(left, left, zero)
    driven = where(t - there, there, t)
    braking = where(-there - t, -there, t)
    fast = rate - speed
    t = where(fast, where(qd, driven, braking), t)
    return t, where(fast, rate / speed, zero)
