# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Fill the results of README.md and the paper's guide: `python -m benchmarks.readme`.

They come from docs/report and lie between `<!-- results -->` and `<!-- /results -->`.
"""

from __future__ import annotations

from pathlib import Path
import re
import sys
from typing import Any

from benchmarks.__main__ import EXPECTED, FOLDER, page_named, stored
from benchmarks.cases import paper
from benchmarks.pages import counts, derivatives, error, hard_cases, speed
from benchmarks.table import page, paragraph, table

WIDTH = 119
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
    """Return the table and the sentences of README.md."""
    fast, simulated = _data('speed'), _data('error')
    rows = speed.results_rows(fast) + error.results_rows(simulated)
    sentences = (
        f'{speed.for_any_robot(fast)} {error.without_rotors(simulated[error.CONTROLLED]["runs"])}',
        hard_cases.summary(_data('hard-cases')),
        derivatives.summary(_data('derivatives')),
        counts.summary(_data('counts'), _data('claims')),
    )
    lines = '\n'.join(table(RESULT, rows))
    return '\n\n'.join([lines, *(paragraph(x, WIDTH) for x in sentences)])


def steps_of_pcrbm() -> str:
    """Return the paragraphs of the paper's guide: steps of PCRBM and how much faster it is."""
    data = _data('counts')

    def at_six(name: str) -> dict[tuple[str, str], Any]:
        found = (x for x in data[name] if x['n'] == paper.PRINTED_AT)
        rows = counts.with_baselines(found, data['serial'])
        return {(x['system'], x['edition']): x for x in rows}

    at, square = at_six('counts'), at_six('right_angles')['pcrbm', paper.AS_PRINTED]
    printed, corrected, own = (at['pcrbm', edition] for edition in paper.EDITIONS)
    origin = at['pcrbm_base_origin', paper.BEST_KNOWN]
    claims = [paper.TABLE['pcrbm'][kind]['printed'] for kind in paper.KINDS[:2]]
    ratios = {
        'square': (square, 'published'),
        'executed': (printed, 'published'),
        'right': (corrected, 'published'),
        'best_own': (own, 'best'),
        'origin': (origin, 'best'),
    }
    return page(
        'paper-guide',
        printed_multiplications=claims[0],
        printed_additions=claims[1],
        printed=f'{own["published"] / sum(claims):.2f}',
        published=f'{own["published"]:g}',
        best=own['best'],
        square_steps=_steps(square),
        as_printed=_steps(printed),
        corrected=_steps(corrected),
        own=_steps(own),
        unpacked=_steps(own, 'unpacked_'),
        **{name: f'{counts.speed_up(*ratio):.2f}' for name, ratio in ratios.items()},
        **{
            f'{name.removesuffix("_own")}_routed': f'{counts.speed_up(*ratio, True):.2f}'
            for name, ratio in ratios.items()
        },
    ).rstrip('\n')


def _steps(x: Any, prefix: str = '') -> str:
    """Return the steps of a row in words."""
    kinds = ('multiplications', 'additions', 'square_roots', 'routes')
    found = {kind.replace('_', ' '): x.get(prefix + kind) for kind in kinds}
    words = [f'{k} {kind.removesuffix("s") if k == 1 else kind}' for kind, k in found.items() if k]
    return f'{", ".join(words[:-1])} and {words[-1]}'


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
