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
import math
from typing import Any

from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.effects import NO_EFFORT

# Rows of the input `motors`, (7, n): E, F, W, V, p, d and the largest change of w in a cycle.
MOTOR_ROWS = ('effort', 'torque_speed_effort', 'torque_speed', 'speed', 'p', 'd', 'jump')
# Rows of the input `targets`, (2, n).
TARGET_ROWS = ('position', 'velocity')
# Flags of a cycle, 1 or 0: a limit cut an effort, a joint was too fast, an effort jumped.
FLAGS = ('saturated', 'fast', 'jumped')


def record_actuators(n: int, brakes: bool = False) -> Program:
    """
    Return the program of a control cycle, which runs before a step.

    It reads q, qd, `efforts`, `motors` and `targets`; with `brakes` also free, 1 for a joint that
    its brake does not hold. What it reads from the cycle before, and writes: tau, the efforts that
    act; `wanted`, w, NaN for none and for braked joints; and `peaks`, the largest |qd| / V of
    joints beyond V. Further outputs are `acting`, the efforts that act; `counts`, the FLAGS; and
    `stop`, 1 if the w of a free joint changes by more than it may. Then all that is read again is
    as before, and `acting` is w.
    """
    recorder = Recorder(1, 'sequential')
    names = ('q', 'qd', 'efforts', 'tau', 'wanted', 'peaks')
    rows = {name: recorder.input_list(name, n) for name in names}
    motors = recorder.input_list('motors', len(MOTOR_ROWS) * n)
    targets = recorder.input_list('targets', len(TARGET_ROWS) * n)
    free = recorder.input_list('free', n) if brakes else [recorder.constant(1.0)] * n
    wanted, limited, excess = [], [], []
    stop: Any = 0.0
    cut = fast = 0.0
    for k in range(n):
        motor = dict(zip(MOTOR_ROWS, motors[k::n], strict=True))
        q, qd, before = rows['q'][k], rows['qd'][k], rows['wanted'][k]
        w = _followed(rows['efforts'][k], q, qd, targets[k::n], motor['p'], motor['d'])
        # Halves: a difference of the largest numbers would overflow.
        jump = 2.0 * absolute(0.5 * w - 0.5 * before)
        stop = where(jump - motor['jump'], where(free[k], 1.0, stop), stop)
        t, beyond = _limited(w, qd, motor)
        cut = where(w - t, 1.0, where(t - w, 1.0, cut))
        fast = where(beyond, 1.0, fast)
        wanted.append(w)
        limited.append(t)
        excess.append(beyond)

    def unless_stopped(new: Any, old: Any) -> Any:
        return where(stop, old, new)

    return recorder.program(
        tau=list(map(unless_stopped, limited, rows['tau'])),
        # The first effort of a joint that comes off its brake may be any.
        wanted=[
            unless_stopped(where(f, w, math.nan), before)
            for f, w, before in zip(free, wanted, rows['wanted'], strict=True)
        ],
        peaks=[
            unless_stopped(where(x - peak, x, peak), peak)
            for x, peak in zip(excess, rows['peaks'], strict=True)
        ],
        acting=[where(stop, w, t) for w, t in zip(wanted, limited, strict=True)],
        counts=[unless_stopped(cut, 0.0), unless_stopped(fast, 0.0), stop],
        stop=[stop],
    )


def _followed(
    tau: Lanes, q: Lanes, qd: Lanes, target: Sequence[Lanes], p: Lanes, d: Lanes
) -> Lanes:
    """Return the effort of a servo with a target, and tau without one."""
    position, velocity = target
    # NaN is not above zero.
    there, moving = absolute(position) + 1.0, absolute(velocity) + 1.0
    p, d = where(there, p, 0.0), where(there, d, where(moving, d, 0.0))
    position, velocity = where(there, position, 0.0), where(moving, velocity, 0.0)
    effort = tau + p * (position - q) + d * (velocity - qd)
    result: Lanes = where(there, effort, where(moving, effort, tau))
    return result


def _limited(t: Lanes, qd: Lanes, motor: Mapping[str, Lanes]) -> tuple[Lanes, Lanes]:
    """Return the limited effort of a joint, and its speed in excess of V as a multiple of V."""
    most, full, falling, speed = (motor[name] for name in MOTOR_ROWS[:4])
    t = where(t - most, most, t)
    t = where(-most - t, -most, t)
    rate = absolute(qd)
    left = NO_EFFORT - rate / falling
    there = full * where(left, left, 0.0)
    driven = where(t - there, there, t)
    braking = where(-there - t, -there, t)
    fast = rate - speed
    t = where(fast, where(qd, driven, braking), t)
    return t, where(fast, rate / speed, 0.0)
