# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the errata: every misprint is executed, its test exists, the page is not stale."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from pfd_core.algorithms.paper import pcgm_1987, pcrbm_1987
from pfd_core.report.measure.errata import (
    ERRATA,
    Erratum,
    gravity_error,
    pcrbm_error,
    recurrence_error,
)
from pfd_core.report.paper_pages import errata_markdown

ROOT = Path(__file__).resolve().parent.parent


@cache
def functions_of(name: str) -> set[str]:
    """Return the names of the tests of a file."""
    tree = ast.parse((ROOT / 'test' / name).read_text(encoding='utf-8'))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize('erratum', ERRATA, ids=lambda erratum: erratum.place)
def test_the_test_that_an_erratum_names_exists(erratum: Erratum) -> None:
    file, test = erratum.test.split('::')
    assert test in functions_of(file)


def test_every_misprint_that_can_be_executed_is_an_erratum() -> None:
    known = {*pcrbm_1987.MISPRINTS, *pcgm_1987.MISPRINTS}
    names = {name for x in ERRATA for name in x.effect.args if name in known}
    # Step 16 changes no result: its cost is counted.
    assert names == known - {pcgm_1987.STEP_16}
    assert any(x.place == 'section 3, step 16' for x in ERRATA)


def test_the_page_is_what_the_command_writes_now() -> None:
    page = (ROOT / 'docs' / 'report' / 'errata.md').read_text(encoding='utf-8')
    assert page == errata_markdown(), 'run pfd report counts --out docs/report'


def numbers(effect: str) -> list[float]:
    """Return the errors that an effect gives: rounding is zero, NaN infinite."""
    stated = [part.split(': ')[1].split(',')[0] for part in effect.split('; ')]
    known = {'rounding': 0.0, 'NaN': float('inf')}
    return [known.get(word) if word in known else float(word) for word in stated]  # type: ignore[misc]


def test_a_misprint_of_sliding_joints_leaves_a_rotating_arm_alone() -> None:
    rotating, sliding = numbers(pcrbm_error(pcrbm_1987.STEP_6))
    assert rotating == 0 < 0.01 < sliding
    assert numbers(pcrbm_error()) == [0, 0]


def test_another_gravity_and_its_sign_change_the_accelerations() -> None:
    assert numbers(gravity_error(9.81)) == [0, 0]
    misprinted, reversed_sign = (numbers(gravity_error(g)) for g in (9.869621, -9.81))
    for little, much in zip(misprinted, reversed_sign, strict=True):
        assert 0 < little < much


def test_the_order_of_equation_3_is_wrong_for_matrices() -> None:
    assert float(recurrence_error().split('off by ')[1].split(',')[0]) > 0.1
