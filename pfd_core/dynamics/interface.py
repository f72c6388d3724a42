# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Inputs and outputs of whole programs.

Inputs are `q`, `qd` and `qdd` or `tau`, (n,), and where the scene needs them `wrench`, (6,):
force and moment exerted on the last link, in its axes, about its origin, and `free`, (n,): 1 for
a joint that moves and 0 for a joint that its brake holds.

On n lanes an input of n elements is one row, an element per lane; on one processor it is a list
of n numbers, each a value on the only lane.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model.plant import Plant


def input_row(recorder: Recorder, name: str) -> Lanes:
    """Return an input of n elements as one row, an element per lane."""
    return recorder.input(name, range(recorder.lanes))


def input_list(recorder: Recorder, name: str, n: int) -> list[Lanes]:
    """Return an input of n elements as n numbers on one processor."""
    return [recorder.input(name, [i]) for i in range(n)]


def free_input(recorder: Recorder, plant: Plant) -> list[Lanes] | None:
    """Return the input `free` as n numbers on one processor; None for a plant without brakes."""
    return input_list(recorder, 'free', plant.robot.n) if plant.brakes else None


def wrench_input(recorder: Recorder) -> LaneArray:
    """Return the six components of the wrench, on the last lane."""
    empty = [None] * (recorder.lanes - 1)
    return array([recorder.input('wrench', [*empty, k]) for k in range(6)])


def program_with_outputs(recorder: Recorder, **results: Any) -> Program:
    """Return the program whose outputs are rows, an element per lane, or arrays of numbers."""
    for name, value in results.items():
        if isinstance(value, Lanes):
            recorder.output(name, (recorder.lanes,), [(value, i) for i in range(recorder.lanes)])
        else:
            numbers = np.array(value, dtype=object)
            recorder.output(name, numbers.shape, [(x, 0) for x in numbers.flat])
    return recorder.program()
