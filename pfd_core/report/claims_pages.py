# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the paper's claims, claims.md, with the index of its equations and procedures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
import re

from pfd_core.report.cases.equations import EQUATIONS, PROCEDURES
from pfd_core.report.measure.claims import CLAIMS, Verdict, verdicts
from pfd_core.report.render.markdown import Columns, page, table
from pfd_core.report.render.markdown import write as write_page

NUMBER = re.compile(r'(A\.)?\d+(\.[ab])?')
COLUMNS: Columns = {
    'where': 'claim.place',
    'the paper says': 'claim.sentence',
    'verdict': 'verdict',
    'evidence': 'evidence',
    'note': 'claim.note',
    'test': lambda one: f'`{one.claim.test}`',
}
INDEX: Columns = {
    'name': lambda one: ', '.join(_numbered(one.names)),
    'what': 'text',
    'function': lambda one: f'`{one.function}`',
    'test': lambda one: f'`{one.test}`',
}


def _numbered(names: Iterable[str]) -> Iterator[str]:
    """Yield names, numbers of equations in brackets."""
    for name in names:
        yield f'({name})' if NUMBER.fullmatch(name) else name


def markdown(found: Iterable[Verdict]) -> str:
    """Return the whole page."""
    rows = list(found)
    return page(
        'claims',
        sentences=len(rows),
        true=sum(one.verdict == 'true' for one in rows),
        false=sum(one.verdict == 'false' for one in rows),
        undecided=sum(one.verdict == 'not decided' for one in rows),
        claims=table(COLUMNS, rows),
        equations=table(INDEX, EQUATIONS),
        procedures=table(INDEX, PROCEDURES),
    )


def run(folder: Path) -> list[Path]:
    """Check every claim, and write claims.md and .json into a folder."""
    found = list(verdicts(CLAIMS))
    data = [
        {
            'place': one.claim.place,
            'sentence': one.claim.sentence,
            'verdict': one.verdict,
            'evidence': one.evidence,
            'test': one.claim.test,
        }
        for one in found
    ]
    return write_page(folder, 'claims', markdown(found), data)
