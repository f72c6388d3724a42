# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motors that follow their command with a lag, over the segments of a step.

    tau(t) = u + (tau - u) exp(-t/T)

Over a whole step the exponentials are constants. A segment that begins or ends at an event has any
length r; its exponential is the approximation

    exp(-z) = (1 - z/3) / (1 + 2 z/3 + z^2/6),   z = r/T

of third order, which falls to zero with z, so that the lag is stable for any T.

Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., IV.3 (Pade approximation).

One register holds one number.
"""

from __future__ import annotations

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant
from pfd_core.model.values import Array


def record_lag(plant: Plant, h: float, middle: float, at_middle: Array, at_end: Array) -> Program:
    """
    Return the program of the torques tau.begin, tau.mid and tau.end of a segment, (n,).

    Inputs are tau, the command, tau_motor and, (1,), rest. The exponentials of a segment of a
    whole step h after its part `middle`, and at its end, are given.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    command, motor = (input_list(recorder, name, n) for name in ('tau', 'tau_motor'))
    (rest,) = input_list(recorder, 'rest', 1)
    parts = []
    for part, exact in ((middle, at_middle), (1.0, at_end)):
        decay = _decays(plant, rest * part)
        # No segment is longer than a step.
        decay = [where(h - rest, d, float(e)) for d, e in zip(decay, exact, strict=True)]
        parts.append(_followed(plant, command, motor, decay))
    begin = _followed(plant, command, motor, [recorder.constant(1.0)] * n)
    return program_with_outputs(
        recorder, **{'tau.begin': begin, 'tau.mid': parts[0], 'tau.end': parts[1]}
    )


def record_follow(plant: Plant) -> Program:
    """
    Return the program of motor.end, (n,), the torques at the end of a segment that was cut.

    Inputs are tau, tau_motor, tau.end and, (1,), event, rest and rest.end.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    command, motor, end = (input_list(recorder, m, n) for m in ('tau', 'tau_motor', 'tau.end'))
    rest, rest_end = (input_list(recorder, name, 1)[0] for name in ('rest', 'rest.end'))
    cut = _followed(plant, command, motor, _decays(plant, rest - rest_end))
    return program_with_outputs(
        recorder, **{'motor.end': [where(rest_end, c, e) for c, e in zip(cut, end, strict=True)]}
    )


def _decays(plant: Plant, time: Lanes) -> list[Lanes]:
    """Return approximations of exp(-t/T); of a joint without a lag any number."""
    assert plant.motor_lag is not None
    result = []
    for lag in plant.motor_lag.tolist():
        z = time * (1.0 / lag) if lag else time
        result.append((1.0 - z * (1 / 3)) / (1.0 + z * (2 / 3) + z * z * (1 / 6)))
    return result


def _followed(
    plant: Plant, command: list[Lanes], motor: list[Lanes], decay: list[Lanes]
) -> list[Lanes]:
    """Return the torques of the motors; a joint without a lag has its command."""
    assert plant.motor_lag is not None
    return [
        u + d * (tau - u) if lag else u
        for u, tau, d, lag in zip(command, motor, decay, plant.motor_lag, strict=True)
    ]
