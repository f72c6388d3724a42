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
    error_integrators,
)
from benchmarks.plots import save
from benchmarks.table import page
from benchmarks.timing import described, surroundings

SIZE, WIDE = (10.0, 7.0), (14.0, 7.6)


def measure(quick: bool) -> dict[str, Any]:
    """Return the machine, and what each section measures."""
    return {
        'machine': surroundings(),
        'controlled': error_controlled.measure(quick),
        'integrators': error_integrators.measure(quick),
        'evaluations': error_evaluations.measure(quick),
    }


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    return page(
        'error',
        machine=described(data['machine']),
        controlled=error_controlled_text.text(data['controlled']),
        integrators=error_integrators.text(data['integrators']),
        evaluations=error_evaluations.text(data['evaluations']),
    )


def plots(data: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the picture of each section."""
    controlled = partial(error_controlled_text.draw, data['controlled'])
    integrators = partial(error_integrators.draw, data['integrators'])
    evaluations = partial(error_evaluations.draw, data['evaluations'])
    return [
        *save(controlled, folder, 'error', SIZE, ['png']),
        *save(integrators, folder, 'error-integrators', WIDE, ['png']),
        *save(evaluations, folder, 'error-evaluations', WIDE, ['png']),
    ]
