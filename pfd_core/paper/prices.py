# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The time of the arithmetic of a run from its steps.

    time = t_m M + t_a A + t_d D + t_s S

for M multiplications, A additions, D divisions and S square roots. Routes take t_r each, counted
on a network (pfd_core.paper.networks). Sines, which the paper takes as given, have no weight.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_core.machine.program import Steps


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
