# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All pages of the paper that count no whole method, and paper.md, which links them all."""

from __future__ import annotations

from pathlib import Path

from pfd_core.report import array_pages, claims_pages, illustrated_pages, pcgm_pages
from pfd_core.report.render.markdown import page


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure, and write all pages into a folder, or quickly those that take seconds."""
    pages = [write(folder), *illustrated_pages.run(folder), *array_pages.run(folder)]
    return pages if quick else [*pages, *claims_pages.run(folder), *pcgm_pages.run(folder)]


def write(folder: Path) -> Path:
    """Write paper.md and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'paper.md'
    path.write_text(page('paper'), encoding='utf-8')
    return path
