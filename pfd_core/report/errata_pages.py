# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the paper's errata, errata.md, from the table in measure.errata."""

from __future__ import annotations

from pathlib import Path

from pfd_core.report.measure.errata import ERRATA, FEW, STATES
from pfd_core.report.render.markdown import Columns, page, table

COLUMNS: Columns = {
    'place': 'place',
    'printed': 'printed',
    'wrong': 'wrong',
    'right': 'right',
    'effect': lambda erratum: erratum.effect(),
    'test': lambda erratum: f'`{erratum.test}`',
}


def markdown() -> str:
    """Run every misprint and return the page."""
    return page('errata', states=STATES, few=FEW, errata=table(COLUMNS, ERRATA))


def write(folder: Path) -> Path:
    """Write errata.md into a folder and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'errata.md'
    path.write_text(markdown(), encoding='utf-8')
    return path
