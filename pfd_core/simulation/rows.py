# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rows of the state in addition to q and qd, for effects with a state.

    q_low        rounding errors of the positions, for sums that keep them
    tau_motor    torques of motors that follow their command with a lag
    unfinished   1 once a step had too many events

A row is a class here, which reads the row at the beginning of a step and returns it at the end,
and a line of integrators.record_step. It begins at zero; all else that a simulation does with its
state (rollouts, ensembles, copies, resets) uses the names of the rows.
"""

from __future__ import annotations

from decimal import Context, Decimal
from typing import Any

import numpy as np

from pfd_core.kernels.simulate import MOTOR_TORQUE
from pfd_core.machine.lanes import where
from pfd_core.machine.recorder import Recorder
from pfd_core.model.values import Array

# For constants with the same bits on every machine, unlike exp of NumPy and C.
EXACT = Context(prec=40)


class CompensatedSum:
    """
    Positions as sums q + q_low, whose second part holds the digits below q.

    q' = fl(q + y) with y = fl(dq + q_low), and q_low' = (q + y) - q' exactly: D. E. Knuth, The
    Art of Computer Programming 2, 4.2.2, theorem B. Only dq is rounded, never the sum: a slow
    joint moves on where h qd is below the last digit of q, and an hour of turning ends at the
    right angle. 7 additions a joint and step, where a plain sum has one.
    """

    name = 'q_low'

    def __init__(self, recorder: Recorder) -> None:
        self._low: Any = recorder.input(self.name, range(recorder.lanes))

    def __call__(self, q: Any, dq: Any) -> Any:
        """Return the position after a step of dq."""
        y = dq + self._low
        q_end = q + y
        added = q_end - q
        self._low = (q - (q_end - added)) + (y - added)
        return q_end

    def end(self) -> Any:
        """Return the rounding errors of the sums."""
        return self._low


class LaggedTorque:
    """
    Torques of motors that follow the command u with time constants T.

    T dtau/dt = u - tau has the solution tau(t) = u + (tau(0) - u) exp(-t/T), from which each stage
    of a step gets its torque: the lag is stable for any T, and adds no error. A motor with T = 0
    has the torque u at once.

    Attributes
    ----------
    jumps : bool
        Whether some torques jump between the end of a step and the beginning of the next.

    """

    name = MOTOR_TORQUE

    def __init__(self, recorder: Recorder, lag: Array, h: float) -> None:
        self._recorder, lanes = recorder, range(recorder.lanes)
        self._command = recorder.input('tau', lanes)
        self._begin: Any = recorder.input(self.name, lanes)
        self.jumps = not lag.all()
        if self.jumps:
            self._begin = where(recorder.constant(lag), self._begin, self._command)
        self._above = self._begin - self._command
        self._lag, self._h = lag, h
        self._torques: dict[float, Any] = {0: self._begin}

    def __call__(self, at: float) -> Any:
        """Return the torque after the part `at` of the step."""
        if at not in self._torques:
            decay = self._recorder.constant(decays(self._lag, at * self._h))
            self._torques[at] = self._command + decay * self._above
        return self._torques[at]

    def end(self) -> Any:
        """Return the torque at the end of the step."""
        return self(1)


class UnfinishedStep:
    """Flags of arms with a step of too many events, which the native step sets."""

    name = 'unfinished'

    def __init__(self, recorder: Recorder) -> None:
        self._flags: Any = recorder.input(self.name, range(recorder.lanes))

    def end(self) -> Any:
        """Return the flags, as they are."""
        return self._flags


def decays(lag: Array, time: float) -> Array:
    """Return the part of a torque's distance from its command that is left after a time [s]."""
    return np.array([_decay(time, float(constant)) for constant in lag])


def _decay(time: float, constant: float) -> float:
    """Return exp(-time / constant), rounded correctly; 0 for a constant of zero."""
    if not constant:
        return 0.0
    return float(EXACT.exp(EXACT.divide(Decimal(-time), Decimal(constant))))
