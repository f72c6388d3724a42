# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Where each equation and procedure of Lee and Chang (1987) is implemented, and what tests it.

A test checks that every equation of the paper is here, that the functions and tests exist, that
the function's module cites the equation, and that the test's file uses this module or a method
that contains it. The tables are stored in data/equations.yaml.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_core.report.cases.stored import table


@dataclass(frozen=True)
class Implemented:
    """
    An equation or procedure of the paper.

    Attributes
    ----------
    names : tuple of str
        Numbers of equations, without brackets, or the name of a procedure.
    text : str
        What it computes.
    function : str
        module:function.
    test : str
        File and function of the test.

    """

    names: tuple[str, ...]
    text: str
    function: str
    test: str


def _stored(kind: str) -> tuple[Implemented, ...]:
    rows = table('equations')[kind]
    return tuple(Implemented(**row | {'names': tuple(row['names'])}) for row in rows)


EQUATIONS, PROCEDURES = _stored('equations'), _stored('procedures')
