# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The time of a run from its steps, and the choices that no step counts.

    time = t_m M + t_a A + t_d D + t_s S + t_r R

for M multiplications, A additions, D divisions, S square roots and R steps of routes, counted on
the network of the machine (pfd_core.machine.networks). Sines, which the paper takes as given, have
no weight.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_core.machine.program import Program, Steps, busy_lanes


@dataclass(frozen=True)
class Weights:
    """
    Times of one step, in units of a multiplication unless the caller has another one.

    The default is a machine that adds as fast as it multiplies, and divides and takes square roots
    in four times that.
    """

    multiplication: float = 1.0
    addition: float = 1.0
    division: float = 4.0
    square_root: float = 4.0
    route: float = 1.0

    def time(self, steps: Steps) -> float:
        """Return the time of a run."""
        return self.arithmetic(steps) + self.route * steps.routes

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
