# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Fill the blocks of README.md and the guides from docs/report: `python -m benchmarks.readme`.

A block lies between `<!-- NAME -->` and `<!-- /NAME -->`; links in it are from the project's root.
To add a block: a row of BLOCKS, and its two marks in a file of FILES.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
import re
import sys
from typing import Any

from benchmarks.__main__ import EXPECTED, FOLDER, page_named, stored
from benchmarks.pages import counts, derivatives, error, hard_cases, speed
from benchmarks.table import paragraph, table

WIDTH = 119
ROOT = Path(__file__).resolve().parents[1]
FILES = ('README.md', 'docs/guides/speed-and-accuracy.md')
MARKED = re.compile(r'(<!-- ([\w-]+) -->\n).*?(<!-- /\2 -->)', re.DOTALL)
# The table of results: titles, and keys of the rows of speed and error.
RESULT = {
    '': 'what',
    'pfd': 'ours',
    'fastest peer': 'peer',
    'its time': 'theirs',
    'its time over ours': 'speed-up',
}


def _table(fast: Any, controlled: Any) -> str:
    rows = speed.results_rows(fast) + error.results_rows(controlled)
    return '\n'.join(table(RESULT, rows)) + '\n'


def _sentences(fast: Any, controlled: Any) -> str:
    found = error.without_rotors(controlled[error.CONTROLLED]['runs'])
    return f'{speed.for_any_robot(fast)} {found}'


# Pages, and the function of their data that returns text.
Part = tuple[Sequence[str], Callable[..., str]]
DERIVATIVES: Part = (['derivatives'], derivatives.summary)
# Name of a block: its parts, with an empty line between two.
BLOCKS: Mapping[str, Sequence[Part]] = {
    'results': (
        (['speed', 'error'], _table),
        (['speed', 'error'], _sentences),
        (['hard-cases'], hard_cases.summary),
        DERIVATIVES,
        (['counts', 'claims'], counts.summary),
    ),
    'speed-table': ((['speed'], speed.guide_table),),
    'derivatives': (DERIVATIVES,),
}


def block(name: str) -> str:
    """Return the text of a block from the JSON of its pages."""
    texts = []
    for pages, write in BLOCKS[name]:
        files = ((page_named(x), ROOT / FOLDER / f'{x}.json') for x in pages)
        text = write(*(stored(*file)['data'] for file in files))
        # Sentences have the width of the files.
        texts.append(text if text.startswith('|') else f'{paragraph(text, WIDTH)}\n')
    return '\n'.join(texts)


def filled(name: str) -> str:
    """Return a file of FILES with its blocks filled; ValueError for an unknown block."""

    def replaced(match: re.Match[str]) -> str:
        if match[2] not in BLOCKS:
            raise ValueError(f'unknown block {match[2]!r}; the blocks are {", ".join(BLOCKS)}')
        text = block(match[2])
        links = text.replace('](docs/', '](../') if name.startswith('docs/') else text
        return f'{match[1]}{links}{match[3]}'

    return MARKED.sub(replaced, (ROOT / name).read_text(encoding='utf-8'))


def main() -> int:
    """Fill the blocks of all files; a file whose blocks lack data stays as it is."""
    status = 0
    for name in FILES:
        try:
            (ROOT / name).write_text(filled(name), encoding='utf-8')
            print(name)
        except EXPECTED as error_of_block:
            print(f'{name} was not filled: {error_of_block}', file=sys.stderr)
            status = 1
    return status


if __name__ == '__main__':
    sys.exit(main())
