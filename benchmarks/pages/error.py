# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speed against error: an arm under a controller, integrators, and single evaluations."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.pages import (
    error_controlled,
    error_controlled_text,
    error_evaluations,
)
from benchmarks.plots import save
from benchmarks.table import page, paragraph
from benchmarks.timing import surroundings

SIZE, WIDE = (10.0, 7.0), (14.0, 7.6)


def measure(quick: bool) -> dict[str, Any]:
    """Return the machine, and what each section measures."""
    return {
        'machine': surroundings(),
        'motions': error_controlled.measure(quick),
        'evaluations': error_evaluations.measure(quick),
    }


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    controlled, free = _split(data)
    return page(
        'error',
        machine=data['machine']['description'],
        controlled=error_controlled_text.text(controlled),
        integrators=error_controlled_text.text_of_free(free),
        evaluations=error_evaluations.text(data['evaluations']),
    )


def results_rows(data: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the row of README.md."""
    return error_controlled_text.results_rows(_split(data)[0])


def losses(data: Mapping[str, Any]) -> str:
    """Return the sentence of README.md on arms without rotors, or an empty line."""
    controlled, _ = _split(data)
    return paragraph(error_controlled_text.without_rotors(controlled['runs'])) + '\n'


def plots(data: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the picture of each section."""
    controlled, free = _split(data)
    drawn = (
        ('error', SIZE, partial(error_controlled_text.draw, controlled)),
        ('error-integrators', WIDE, partial(error_controlled_text.draw_free, free)),
        ('error-evaluations', WIDE, partial(error_evaluations.draw, data['evaluations'])),
    )
    return [file for name, size, draw in drawn for file in save(draw, folder, name, size, ['png'])]


def _split(data: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the measurements of the arm under a controller, and of the free motions."""
    free = dict(data['motions'])
    return free.pop(error_controlled.CONTROLLED), free
