# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Torques of motors that follow their command with a lag, in a linearised step.

A row of the state is a class here, which reads it at the beginning of a step and returns it at the
end, and a line of integrators.record_step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pfd_core.kernels.simulate import MOTOR_TORQUE
from pfd_core.machine.lanes import where
from pfd_core.machine.recorder import Recorder
from pfd_core.model.values import Array
from pfd_core.simulation.stages import decayed


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


def decays(lag: Array, time: float) -> Array:
    """Return the part of a torque's distance from its command that is left after a time [s]."""
    return np.array([decayed(time, float(constant)) for constant in lag])
