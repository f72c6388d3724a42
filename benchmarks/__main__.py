# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure and write the pages of docs/report: `python -m benchmarks [NAME ...]`.

Without names all pages are made, those that measure times first. NAME.json holds the
measured rows, NAME.md and pictures are derived from it; `--from-json` only derives them again.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
import json
from pathlib import Path
import sys
from typing import Any, NamedTuple

from benchmarks.run import show_progress
from benchmarks.table import json_text, write_text

FOLDER, QUICK_FOLDER = Path('docs/report'), Path('benchmarks_quick')
# Of the JSON files: pages are rendered from files of this version only.
VERSION = 2
QUICK = (
    '**Quick run** (`--quick`): few rounds, cases and states, to see that everything works. '
    'Its numbers are no results.'
)
# Errors whose message says what to do; exit status 1.
EXPECTED = (ValueError, OSError, ImportError, ArithmeticError, RuntimeError)


class Page(NamedTuple):
    """Name of its files and module, and what it shows."""

    name: str
    title: str

    @property
    def module(self) -> Any:
        """The module of this page."""
        return import_module(f'benchmarks.pages.{self.name.replace("-", "_")}')


# Pages that measure times first.
PAGES: Sequence[Page] = (
    Page('speed', 'times of forward dynamics and other quantities compared with peers'),
    Page('error', 'time against error: integrators, and an arm under a controller'),
    Page('scene', 'error without each effect of a scene'),
    Page('hard-cases', 'errors of ill-conditioned arms, and over thousands of states'),
    Page('derivatives', 'errors of derivatives and linearised steps'),
    Page('counts', 'steps of every method on emulated processors compared with the paper'),
    Page('claims', "the paper's sentences and equations, each with a verdict"),
    Page('worked-example', 'PCRBM and PCGM of a small arm, lane by lane, and pictures'),
    Page('array', 'the triangular array, cycle by cycle and with numbers'),
    Page('doubling', 'articulated bodies by recursive doubling: steps over n, and errors'),
    Page('since-1987', 'methods since 1987, networks between processors, fewer processors'),
)


def page_named(name: str) -> Page:
    """Return the page of a name; ValueError for an unknown name."""
    pages = {page.name: page for page in PAGES}
    if name not in pages:
        raise ValueError(f'unknown page {name!r}; the pages are {", ".join(pages)}')
    return pages[name]


def measured(page: Page, quick: bool) -> dict[str, Any]:
    """Return what NAME.json holds: the rows that a measurement yields now."""
    data = page.module.measure(quick)
    return {'version': VERSION, 'page': page.name, 'quick': quick, 'data': data}


def stored(page: Page, path: Path) -> dict[str, Any]:
    """Return the content of a JSON file of a page; ValueError for another version or page."""
    try:
        found = json.loads(path.read_text(encoding='utf-8'))
    except json.JSONDecodeError as error:
        raise ValueError(f'{path} is not JSON: {error}') from None
    version = found.get('version') if isinstance(found, dict) else None
    if version != VERSION:
        raise ValueError(
            f'{path} has version {version}, expected {VERSION}: measure it again with '
            f'python -m benchmarks {page.name}'
        )
    if found.get('page') != page.name:
        raise ValueError(f'{path} is of the page {found.get("page")!r}, expected {page.name!r}')
    return dict(found)


def rendered(page: Page, content: dict[str, Any]) -> str:
    """Return the Markdown of a page from the content of its JSON file."""
    text: str = page.module.text(content['data'])
    if content['quick']:
        title, _, rest = text.partition('\n')
        text = f'{title}\n\n{QUICK}\n{rest}'
    return text


def make(page: Page, folder: Path, quick: bool = False, from_json: bool = False) -> list[Path]:
    """Measure a page, or read its JSON file, write its files and return their paths."""
    path = folder / f'{page.name}.json'
    if not from_json:
        write_text(folder, path.name, json_text(measured(page, quick)))
    # Also after a measurement the page is made of what the file holds.
    content = stored(page, path)
    files = [path, write_text(folder, f'{page.name}.md', rendered(page, content))]
    plots = getattr(page.module, 'plots', None)
    return [*files, *(plots(content['data'], folder) if plots else ())]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; the status is 0 only if every page was made."""
    parser = argparse.ArgumentParser(
        prog='python -m benchmarks',
        description='Measure and write the pages of docs/report.',
        epilog='pages: ' + '; '.join(f'{page.name}: {page.title}' for page in PAGES),
    )
    parser.add_argument('names', nargs='*', metavar='NAME', help='pages; without, all')
    parser.add_argument('--quick', action='store_true', help='few rounds, to see that it works')
    parser.add_argument('--from-json', action='store_true', help='write pages from stored JSON')
    where = f'folder (default {FOLDER}, quick {QUICK_FOLDER})'
    parser.add_argument('--out', type=Path, help=where)
    given = parser.parse_args(argv)
    try:
        pages = [page_named(name) for name in given.names] or PAGES
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    folder = given.out or (QUICK_FOLDER if given.quick else FOLDER)
    failures = []
    for k, page in enumerate(sorted(pages, key=PAGES.index)):
        show_progress(f'{k + 1} of {len(pages)}: {page.name}, {page.title}')
        try:
            for path in make(page, folder, given.quick, given.from_json):
                print(path, flush=True)
        except EXPECTED as error:
            failures.append(f'{page.name} was not made: {error}')
    for line in failures:
        print(line, file=sys.stderr)
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
