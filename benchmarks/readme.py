# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Fill the results of README.md from docs/report: `python -m benchmarks.readme`.

They lie between `<!-- results -->` and `<!-- /results -->`.
"""

from __future__ import annotations

from pathlib import Path
import re
import sys
from typing import Any

from benchmarks.__main__ import EXPECTED, FOLDER, page_named, stored
from benchmarks.pages import counts, derivatives, error, hard_cases, speed
from benchmarks.table import paragraph, table

WIDTH = 119
ROOT = Path(__file__).resolve().parents[1]
README = ROOT / 'README.md'
MARKED = re.compile(r'(<!-- results -->\n).*?(<!-- /results -->)', re.DOTALL)
# The table of results: titles, and keys of the rows of speed and error.
RESULT = {
    '': 'what',
    'pfd': 'ours',
    'fastest peer': 'peer',
    'its time': 'theirs',
    'its time over ours': 'speed-up',
}


def results() -> str:
    """Return the table and the sentences, from the JSON of the pages."""

    def data(name: str) -> Any:
        return stored(page_named(name), ROOT / FOLDER / f'{name}.json')['data']

    fast, simulated = data('speed'), data('error')
    rows = speed.results_rows(fast) + error.results_rows(simulated)
    sentences = (
        f'{speed.for_any_robot(fast)} {error.without_rotors(simulated[error.CONTROLLED]["runs"])}',
        hard_cases.summary(data('hard-cases')),
        derivatives.summary(data('derivatives')),
        counts.summary(data('counts'), data('claims')),
    )
    return '\n\n'.join(['\n'.join(table(RESULT, rows)), *(paragraph(x, WIDTH) for x in sentences)])


def filled() -> str:
    """Return README.md with its results filled."""
    text = README.read_text(encoding='utf-8')
    return MARKED.sub(lambda match: f'{match[1]}{results()}\n{match[2]}', text)


def main() -> int:
    """Fill README.md; without the data that it needs it stays as it is."""
    try:
        README.write_text(filled(), encoding='utf-8')
    except EXPECTED as error_of_data:
        print(f'{README.name} was not filled: {error_of_data}', file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
