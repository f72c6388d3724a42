# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Fill the results of README.md and the paper's guide: `python -m benchmarks.readme`.

They come from docs/report and lie between `<!-- results -->` and `<!-- /results -->`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import sys
from typing import Any

from benchmarks.__main__ import EXPECTED, FOLDER, page_named, stored
from benchmarks.cases import paper
from benchmarks.pages import counts, error, speed
from benchmarks.table import lines_of, page, table

ROOT = Path(__file__).resolve().parents[1]
README, GUIDE = ROOT / 'README.md', ROOT / 'docs' / 'guides' / 'paper.md'
MARKED = re.compile(r'(<!-- results -->\n).*?(<!-- /results -->)', re.DOTALL)
# The table of results: titles, and keys of the rows of speed and error.
RESULT = {
    '': 'what',
    'pfd': 'ours',
    'fastest peer': 'peer',
    'its time': 'theirs',
    'its time over ours': 'speed-up',
}


def _data(name: str) -> Any:
    """Return the rows of a page."""
    return stored(page_named(name), ROOT / FOLDER / f'{name}.json')['data']


def results() -> str:
    """Return the table of README.md."""
    rows = speed.results_rows(_data('speed')) + error.results_rows(_data('error'))
    return '\n'.join(table(RESULT, rows))


# Rows of the guide: which, the rows of counts.json, system and edition.
GUIDE_ROWS = (
    ('as printed, twists 0/90', 'right_angles', 'pcrbm', paper.AS_PRINTED),
    ('corrected (`pcrbm_1987`), twists 0/90', 'right_angles', 'pcrbm', paper.CORRECTED),
    ('as printed, skew axes', 'counts', 'pcrbm', paper.AS_PRINTED),
    ('corrected (`pcrbm_1987`), skew axes', 'counts', 'pcrbm', paper.CORRECTED),
    ('our form (`pcrbm`), skew axes', 'counts', 'pcrbm', paper.BEST_KNOWN),
    (
        'about the base origin (`pcrbm_base_origin`), skew axes',
        'counts',
        'pcrbm_base_origin',
        paper.BEST_KNOWN,
    ),
)


def steps_of_pcrbm() -> str:
    """Return the part of the paper's guide on steps of PCRBM and how much faster it is."""
    data = _data('counts')

    def at_six(name: str) -> dict[tuple[str, str], Any]:
        found = (x for x in data[name] if x['n'] == paper.PRINTED_AT)
        rows = counts.with_baselines(found, data['serial'])
        return {(x['system'], x['edition']): x for x in rows}

    known = {name: at_six(name) for name in ('right_angles', 'counts')}
    rows = [(which, known[name][system, edition]) for which, name, system, edition in GUIDE_ROWS]
    published, best = (f'{rows[0][1][over]:g}' for over in ('published', 'best'))
    columns: dict[str, Callable[[Any], str]] = {
        'PCRBM': lambda row: row[0],
        'packed': lambda row: _steps(row[1], ''),
        'one lane per link': lambda row: _steps(row[1], 'unpacked_'),
        f'times fewer than {published}': lambda row: _times(row[1], 'published'),
        f'than {best}': lambda row: _times(row[1], 'best'),
    }
    claims = [paper.TABLE['pcrbm'][kind]['printed'] for kind in paper.KINDS[:2]]
    return page(
        'paper-guide',
        printed_multiplications=claims[0],
        printed_additions=claims[1],
        printed=f'{float(published) / sum(claims):.2f}',
        published=published,
        best=best,
        rows=lines_of([*columns], ([cell(row) for cell in columns.values()] for row in rows)),
        outcome=counts.summary(data, _data('claims')),
    ).rstrip('\n')


def _steps(x: Any, prefix: str) -> str:
    """Return the steps of arithmetic of a row, and its routes."""
    return f'{", ".join(str(x[prefix + kind]) for kind in paper.KINDS)} / {x[prefix + "routes"]}'


def _times(x: Any, over: str) -> str:
    return ' / '.join(f'{counts.speed_up(x, over, routed):.2f}' for routed in (False, True))


FILLED = {README: results, GUIDE: steps_of_pcrbm}


def filled(path: Path) -> str:
    """Return a file of FILLED with its results filled."""
    text, own = path.read_text(encoding='utf-8'), FILLED[path]()
    return MARKED.sub(lambda match: f'{match[1]}{own}\n{match[2]}', text)


def main() -> int:
    """Fill the files; one without the data that it needs stays as it is."""
    status = 0
    for path in FILLED:
        try:
            path.write_text(filled(path), encoding='utf-8')
        except EXPECTED as error_of_data:
            print(f'{path.name} was not filled: {error_of_data}', file=sys.stderr)
            status = 1
    return status


if __name__ == '__main__':
    sys.exit(main())
