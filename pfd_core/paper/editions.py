# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Editions of the paper's procedures: our form, the paper's corrected form, and its misprints.

PCRBM and PCGM are recorded from one function each, for any edition. Our form has one matrix for
all terms of rotation in the bias, packed recurrences, reduced masses, L D L' without roots, and
conjugate gradients that iterate until they have converged. The paper's form has its own equations
(printed), and each misprint can be taken as printed. The source is a scan: an error may be the
authors', the printer's or the scanner's.

A new misprint is a row of MISPRINTS and a condition in the procedure that has it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from pfd_core.model.values import choice


class Misprint(NamedTuple):
    """A misprint that can be executed."""

    name: str  # its equation or step
    procedure: str  # the method of 1987 that has it
    breaks: str  # what it makes wrong
    appendix: bool = False  # whether only Appendix A prints it, where the procedure is right


CHOLESKY, STEP_6 = 'equations (11), (12)', 'step 6'
A_3, A_8 = 'equation (A.3)', 'equation (A.8)'
STEP_4, STEP_7, STEP_16 = 'step 4', 'step 7', 'step 16'
PCRBM, PCGM = 'pcrbm_1987', 'pcgm_1987'
MISPRINTS = (
    Misprint(CHOLESKY, PCRBM, 'h_ij h_kj and h_ii are printed for l_ij l_kj and l_ii'),
    Misprint(STEP_6, PCRBM, 'a translational joint has F_j and N_j of a rotational joint'),
    Misprint(A_3, PCRBM, 'the first bracket of (19) has the factor M_j for M_(j+1)', True),
    Misprint(A_8, PCRBM, '(26) depends on the type of joint j instead of joint i', True),
    Misprint(STEP_4, PCGM, 'w_0 = tau - b for any x_0, where tau - b - H x_0 is needed'),
    Misprint(STEP_7, PCGM, 'x_1 = t overwrites the iterate'),
    Misprint(STEP_16, PCGM, 'back to step 5, which repeats the inner product of step 12'),
)
# The misprints of each procedure, as it is printed and with Appendix A.
AS_PRINTED, OF_PROCEDURE = (
    {
        procedure: tuple(x.name for x in MISPRINTS if x.procedure == procedure and x.appendix <= a)
        for procedure in (PCRBM, PCGM)
    }
    for a in (False, True)
)


@dataclass(frozen=True)
class Edition:
    """
    A form of the paper's procedures.

    `printed` selects the paper's equations, which are correct without `misprints`; else our form.
    `misprints` are those that the paper's form takes as printed.
    """

    printed: bool = False
    misprints: Collection[str] = ()

    def has(self, misprint: str) -> bool:
        """Return whether a misprint is taken as printed."""
        return misprint in self.misprints


OURS, CORRECTED = Edition(), Edition(printed=True)


def edition_of(procedure: str, misprints: Collection[str]) -> Edition:
    """Return the paper's form of a procedure with some misprints; ValueError for another name."""
    for name in misprints:
        choice('misprint', name, OF_PROCEDURE[procedure])
    return Edition(printed=True, misprints=misprints)
