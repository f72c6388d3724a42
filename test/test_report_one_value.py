# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""No count has two values: every table of the pages that has it is read, and they agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
import re

from pfd_core.report.cases.paper import TABLE
from pfd_core.report.measure.counts import BEST_KNOWN, CORRECTED, EDITIONS

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
PACKED, PLAIN = 'packed', 'one lane per link'
FORMULA = 'formula of Table 1'
# System, edition, packing, kind of operation and n.
Count = tuple[str, str, str, str, int]


def section(page: str, heading: str) -> list[list[str]]:
    """Return the rows of the first table below a heading, titles first."""
    text = (PAGES / page).read_text(encoding='utf-8').split(f'\n## {heading}\n')[1]
    rows = []
    for line in text.splitlines():
        if line.startswith('|'):
            rows.append([cell.strip() for cell in line.strip('|').split(' | ')])
        elif rows:
            break
    return [rows[0], *rows[2:]]


def edition(title: str) -> tuple[str, str]:
    """Return the system and the edition of a title; iterations are n of them."""
    name, _, rest = title.strip().partition(', ')
    rest = rest.removesuffix(', n iterations')
    return (name, rest) if rest in EDITIONS else (title.removesuffix(', n iterations'), BEST_KNOWN)


def of_the_systems() -> Iterator[tuple[Count, str]]:
    n = 6
    for title, _, mult, _, add, _, routes, *more in section('counts.md', 'n = 6')[1:]:
        if 'the fewest' in title or 'the most' in title:
            continue
        title = re.sub(r', 6 iterations( \(not converged\))?', '', title)
        system, which = edition(title)
        for kind, packed, plain in zip(
            ('mult', 'add', 'routes'), (mult, add, routes), more[:3], strict=True
        ):
            yield (system, which, PACKED, kind, n), packed
            yield (system, which, PLAIN, kind, n), plain


def of_the_claims() -> Iterator[tuple[Count, str]]:
    for row in section('counts.md', 'Compared with the paper, n = 6')[1:]:
        system, operation, formula, _, _, *editions = row
        kind = {'multiplications': 'mult', 'additions': 'add'}.get(operation)
        if kind:
            yield (system, '', FORMULA, kind, 6), formula
            cells = iter(editions)
            for which in EDITIONS:
                yield (system, which, PACKED, kind, 6), next(cells)
                yield (system, which, PLAIN, kind, 6), next(cells)


def of_the_grids() -> Iterator[tuple[Count, str]]:
    for heading, kind in (
        ('Multiplications over n, measured / formula', 'mult'),
        ('Additions over n, measured / formula', 'add'),
    ):
        titles, *rows = section('counts.md', heading)
        for title, *cells in rows:
            system, which = edition(title)
            for n, cell in zip(titles[1:], cells, strict=True):
                measured, _, formula = cell.partition(' / ')
                yield (system, which, PACKED, kind, int(n)), measured
                if formula:
                    yield (system, '', FORMULA, kind, int(n)), formula
    titles, *rows = section('counts.md', 'Routes over n, packed / one lane per link')
    for title, *cells in rows:
        system, which = edition(title)
        for n, cell in zip(titles[1:], cells, strict=True):
            packed, plain = cell.split(' / ')
            yield (system, which, PACKED, 'routes', int(n)), packed
            yield (system, which, PLAIN, 'routes', int(n)), plain


def of_pcgm() -> Iterator[tuple[Count, str]]:
    pcgm, pcrbm = TABLE['pcgm'].title, TABLE['pcrbm'].title
    heading = 'Cost at convergence and cost of n iterations'
    for row in section('pcgm.md', heading)[1:]:
        n, formula, n_iterations, *_ = row
        direct = row[7]
        for kind, *cells in zip(
            ('mult', 'add'),
            *(x.split(' / ') for x in (formula, n_iterations, direct)),
            strict=True,
        ):
            yield (pcgm, '', FORMULA, kind, int(n)), cells[0]
            yield (pcgm, CORRECTED, PLAIN, kind, int(n)), cells[1]
            # Nothing in PCGM of 1987 is packed.
            yield (pcgm, CORRECTED, PACKED, kind, int(n)), cells[1]
            yield (pcrbm, CORRECTED, PLAIN, kind, int(n)), cells[2]


def of_the_networks() -> Iterator[tuple[Count, str]]:
    for title, _, crossbar, *_ in section('networks.md', 'Time over t_r, n = 6')[1:]:
        if title.endswith('one processor') or 'median to convergence' in title:
            continue
        name, _, packing = title.rpartition(', ')
        system, which = edition(re.sub(r', 6 iterations \(not converged\)', '', name))
        yield (system, which, packing, 'routes', 6), crossbar


SOURCES = (of_the_systems, of_the_claims, of_the_grids, of_pcgm, of_the_networks)


def test_no_count_has_two_values_on_the_pages() -> None:
    values: dict[Count, set[str]] = defaultdict(set)
    places: dict[Count, set[str]] = defaultdict(set)
    for source in SOURCES:
        for count, value in source():
            if value != '-':
                values[count].add(value)
                places[count].add(source.__name__)
    several = {count: found for count, found in values.items() if len(found) > 1}
    assert not several
    # Each table has counts that another has, too: else nothing would be compared.
    for source in SOURCES:
        shared = [x for x in places.values() if source.__name__ in x and len(x) > 1]
        assert len(shared) >= 12, source.__name__


def test_the_array_at_six_joints_has_one_count_in_the_report_and_in_emulate() -> None:
    # 307 was another way to count a cycle: as a multiplication and a division at once.
    counts = dict(of_the_systems())
    title = TABLE['pcrbm_array'].title
    found = [counts[title, BEST_KNOWN, PACKED, kind, 6] for kind in ('mult', 'add')]
    grids = dict(of_the_grids())
    assert found == [grids[title, BEST_KNOWN, PACKED, kind, 6] for kind in ('mult', 'add')]
    assert '307' not in found
