# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the site from files that are read elsewhere too: README.md and guides.

In a page of docs/ a line such as

    <!-- section: README.md, ## Run it -->
    <!-- table: parameters -->

is replaced by that section of a file, without its heading, or by a table of site_tables. `*` is a
whole file without its title, and an empty heading the text before the first one.
Links that leave docs/ for a file with a page here lead to the page.
"""

from __future__ import annotations

import os
from pathlib import Path
import re

from site_tables import TABLES

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
SECTION = re.compile(r'^<!-- section: ([\w./]+), (.*?) ?-->$', re.MULTILINE)
TABLE = re.compile(r'^<!-- table: (\w+) -->$', re.MULTILINE)
CODE = re.compile(r'(^```.*?^```$|`[^`\n]*`)', re.MULTILINE | re.DOTALL)
LINK = re.compile(r'(?<=\]\()([^)\s#]+)')
# Files and folders, and their pages.
PAGES = {
    'README.md': 'index.md',
    'config/sim_arm.yaml': 'reference/parameters.md',
    'docs/guides': 'index.md',
    'docs/decisions': 'decisions/index.md',
    'docs/report': 'reports.md',
}


def section(text: str, heading: str) -> str:
    """Return the text under a heading; of the whole file for `*`, before the first for ''.

    Raises
    ------
    ValueError
        If the heading is missing.
    """
    _, _, body = text.partition('\n')
    if heading == '*':
        return body
    if not heading:
        return re.split(r'^## ', body, maxsplit=1, flags=re.MULTILINE)[0]
    depth = heading.partition(' ')[0]
    _, found, rest = text.partition(f'\n{heading}\n')
    if not found:
        raise ValueError(f'no heading {heading!r}')
    return re.split(rf'^#{{1,{len(depth)}}} ', rest, maxsplit=1, flags=re.MULTILINE)[0]


def relinked(text: str, origin: Path, page: Path) -> str:
    """Return a text of one file for a page: its links lead from there to pages of the site."""

    def moved(link: re.Match[str]) -> str:
        target = link[1]
        if re.match(r'\w+:', target):
            return target
        path = (origin.parent / target).resolve()
        name = path.relative_to(ROOT).as_posix()
        found = DOCS / PAGES[name] if name in PAGES else path
        return Path(os.path.relpath(found, page.parent)).as_posix()

    parts = CODE.split(text)
    # Every second part is code, except that a link's text may be code.
    return ''.join(part if k % 2 else LINK.sub(moved, part) for k, part in enumerate(parts))


def filled(app, docname: str, source: list[str]) -> None:
    """Replace the lines of a page that stand for sections and tables."""
    page = Path(app.env.doc2path(docname))

    def inserted(line: re.Match[str]) -> str:
        origin = ROOT / line[1]
        return relinked(section(origin.read_text(encoding='utf-8'), line[2]), origin, page)

    text = relinked(source[0], page, page)
    text = SECTION.sub(inserted, text)
    source[0] = TABLE.sub(lambda line: TABLES[line[1]](), text)
