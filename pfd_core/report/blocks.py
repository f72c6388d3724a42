# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Generated blocks of README.md and the guides: every number there, from the data of the pages.

A block lies between `<!-- NAME -->` and `<!-- /NAME -->`. `python benchmarks/readme.py` fills all
of them from docs/report/*.json.

To add a block: a row of BLOCKS, and its two marks in a file of FILES.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import json
import math
from pathlib import Path
import re
from typing import Any

from pfd_core.report import (
    controlled_arm_pages,
    derivative_pages,
    distribution_pages,
    hard_case_pages,
    headlines,
)
from pfd_core.report.measure import controlled_motion, derivative_errors, errors, speed
from pfd_core.report.render.records import read, record_of

REPORT = Path('docs/report')
FILES = ('README.md', 'docs/guides/speed-and-accuracy.md')
MARKED = re.compile(r'(<!-- ([\w-]+) -->\n).*?(<!-- /\2 -->)', re.DOTALL)


def _records(kind: Any, path: Path, key: str | None, null: float = math.nan) -> Any:
    """Return the records in a list of JSON, or in the list under a key."""
    data = json.loads(path.read_text(encoding='utf-8'))
    return record_of(list[kind], data if key is None else data[key], null)


def _of_speed(write: Callable[[speed.Findings], str]) -> Callable[[Path], str]:
    return lambda folder: write(read(speed.Findings, folder / 'speed.json'))


# Each takes the folder of the pages' data. Links are from the project's root.
BLOCKS: Mapping[str, Callable[[Path], str]] = {
    'controlled-arm': lambda folder: controlled_arm_pages.summary(
        read(controlled_motion.Findings, folder / 'controlled-arm.json')
    ),
    'speed-headline': _of_speed(headlines.headline),
    'speed-table': _of_speed(headlines.guide_table),
    'speed-notes': _of_speed(headlines.guide_notes),
    'hard-cases': lambda folder: hard_case_pages.summary(
        _records(errors.Result, folder / 'hard-cases.json', 'cases')
    ),
    'derivatives': lambda folder: derivative_pages.summary(
        # Infinite errors are null in the JSON.
        _records(derivative_errors.Result, folder / 'derivatives.json', 'cases', math.inf)
    ),
    'distributions': lambda folder: distribution_pages.summary(
        read(distribution_pages.Findings, folder / 'distributions.json')
    ),
}


def filled(root: Path, name: str) -> str:
    """Return a file of FILES with its blocks filled; `root` is the project's folder."""
    inside = name.startswith('docs/')

    def block(match: re.Match[str]) -> str:
        if match[2] not in BLOCKS:
            return match[0]
        text = BLOCKS[match[2]](root / REPORT)
        links = text.replace('](docs/', '](../') if inside else text
        return f'{match[1]}{links}{match[3]}'

    return MARKED.sub(block, (root / name).read_text(encoding='utf-8'))


def fill(root: Path) -> list[Path]:
    """Fill the blocks of all files and return their paths."""
    for name in FILES:
        (root / name).write_text(filled(root, name), encoding='utf-8')
    return [root / name for name in FILES]
