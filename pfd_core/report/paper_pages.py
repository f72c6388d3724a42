# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pages of the paper made of tables: its claims, equations and errata; and paper.md, their index.

For claims.md and errata.md the paper is executed. `run` also writes the pages with pictures:
illustrated.md, array.md and pcgm.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
import re

from pfd_core.report import array_pages, illustrated_pages, pcgm_pages
from pfd_core.report.cases.paper import EQUATIONS, PROCEDURES, Implemented
from pfd_core.report.measure.claims import CLAIMS, Verdict, counted_verdicts, verdicts
from pfd_core.report.measure.errata import ERRATA, FEW, STATES
from pfd_core.report.render.markdown import Columns, page, table, write_text
from pfd_core.report.render.markdown import write as write_page

NUMBER = re.compile(r'(A\.)?\d+(\.[ab])?')


def _numbered(row: Implemented) -> str:
    """Return names separated by commas, numbers of equations in brackets."""
    return ', '.join(f'({name})' if NUMBER.fullmatch(name) else name for name in row.names)


CLAIM_COLUMNS: Columns = {
    'where': 'claim.place',
    'the paper says': 'claim.sentence',
    'verdict': 'verdict',
    'evidence': 'evidence',
    'note': 'claim.note',
    'test': lambda one: f'`{one.claim.test}`',
}
EQUATION_COLUMNS: Columns = {
    'name': _numbered,
    'what': 'text',
    'function': lambda one: f'`{one.function}`',
    'test': lambda one: f'`{one.test}`',
}
ERRATA_COLUMNS: Columns = {
    'place': 'place',
    'printed': 'printed',
    'wrong': 'wrong',
    'right': 'right',
    'effect': lambda erratum: erratum.effect(),
    'test': lambda erratum: f'`{erratum.test}`',
}


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure, and write all pages into a folder; quickly: only pages that take seconds."""
    index = write_text(folder, 'paper.md', page('paper'))
    pages = [index, *illustrated_pages.run(folder), *array_pages.run(folder)]
    return pages if quick else [*pages, *write_claims(folder), *pcgm_pages.run(folder)]


def claims_markdown(found: Iterable[Verdict]) -> str:
    """Return the page of the claims, equations and procedures."""
    rows = list(found)
    return page(
        'claims',
        sentences=len(rows),
        counted=counted_verdicts([one.verdict for one in rows]),
        claims=table(CLAIM_COLUMNS, rows),
        equations=table(EQUATION_COLUMNS, EQUATIONS),
        procedures=table(EQUATION_COLUMNS, PROCEDURES),
    )


def write_claims(folder: Path) -> list[Path]:
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
    return write_page(folder, 'claims', claims_markdown(found), data)


def errata_markdown() -> str:
    """Run every misprint and return the page of the errata."""
    return page('errata', states=STATES, few=FEW, errata=table(ERRATA_COLUMNS, ERRATA))


def write_errata(folder: Path) -> Path:
    """Write errata.md into a folder and return its path."""
    return write_text(folder, 'errata.md', errata_markdown())
