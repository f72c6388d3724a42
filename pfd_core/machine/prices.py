# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The time of the arithmetic of a run from its steps, and the choices that no step counts.

    time = t_m M + t_a A + t_d D + t_s S

for M multiplications, A additions, D divisions and S square roots. Routes take t_r each, counted
on a network (pfd_core.machine.networks). Sines, which the paper takes as given, have no weight.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_core.machine.program import Program, Steps, busy_lanes


@dataclass(frozen=True)
class Weights:
    """
    Times of one step of arithmetic, by default in units of a multiplication.

    The default is a machine that adds as fast as it multiplies, and divides and takes square roots
    in four times that.
    """

    multiplication: float = 1.0
    addition: float = 1.0
    division: float = 4.0
    square_root: float = 4.0

    def arithmetic(self, steps: Steps) -> float:
        """Return the time of a run without its routes."""
        return (
            self.multiplication * steps.multiplications
            + self.addition * steps.additions
            + self.division * steps.divisions
            + self.square_root * steps.square_roots
        )


@dataclass(frozen=True)
class Choices:
    """
    Instructions that only choose between values a lane has; they cost no step.

    Attributes
    ----------
    selects : int
        Each lane compares a value with zero and keeps one of two others.
    merges : int
        Each lane keeps one of two values, which the program fixes; nothing moves between lanes.
        A route that moves data merges in the same step and is not counted here.
    comparisons : int
        The control unit compares a value of lane 0, to repeat a loop or to end it.

    """

    selects: int = 0
    merges: int = 0
    comparisons: int = 0


def choices(program: Program, iterations: int = 1) -> Choices:
    """Return the choices of a program; its repeated part runs `iterations` times."""
    selects = merges = comparisons = 0
    times = 1
    for instruction in program.instructions:
        if instruction.op == 'loop':
            times = iterations
        elif instruction.op == 'end':
            comparisons += times
            times = 1
        elif instruction.op == 'select':
            selects += times
        elif instruction.op == 'route' and not busy_lanes(instruction):
            merges += times
    return Choices(selects, merges, comparisons)
