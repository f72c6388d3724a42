# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pages and their tables as Markdown, and their data as JSON.

The prose of a page is a template, texts/NAME.md. A line that is only `{name}` is a block: a table
or a section, inserted as it is, or left out together with the next empty line where it is None.
In other lines values replace `{name}`. A paragraph on one long line of the template is wrapped;
other lines stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from importlib.resources import files
import json
import math
from operator import attrgetter
from pathlib import Path
import re
from textwrap import fill
from typing import Any

WIDTH = 99
BLOCK = re.compile(r'{(\w+)}')
# A place for a value or for an attribute of it, perhaps with a format.
PLACE = re.compile(r'{(\w+)((?:\.\w+)*)(?::[^}]*)?}')
# Titles of a table, each with the field of a row, or a function of a row, that gives its cells. Of
# equal titles the second ends with a space.
Columns = Mapping[str, str | Callable[[Any], object]]
# Cells of a table by row and column.
Cells = dict[tuple[str, object], object]


def page(name: str, /, **values: Any) -> str:
    """Return the page or section of a template of texts, ended by a line break."""
    template = files('pfd_core.report') / 'texts' / f'{name}.md'
    text = template.read_text(encoding='utf-8')
    unused = sorted(values.keys() - {key for key, _ in PLACE.findall(text)})
    if unused:
        raise ValueError(f'the template {name} has no place for {", ".join(unused)}')
    lines: list[str] = []
    left_out = False
    for line in map(str.rstrip, text.splitlines()):
        block = BLOCK.fullmatch(line)
        if block:
            value = values[block[1]]
            left_out = value is None
            if not left_out:
                lines.append(value.rstrip('\n') if isinstance(value, str) else '\n'.join(value))
        elif line or not left_out:
            for key, attribute in PLACE.findall(line):
                if not attribute and not isinstance(values[key], (str, int, float)):
                    raise TypeError(f'{key} in {name} must be text, got {values[key]!r:.40}')
            filled = line.format_map(values)
            lines.append(paragraph(filled) if len(line) > WIDTH and line[0] != '-' else filled)
        else:
            left_out = False
    return '\n'.join(lines) + '\n'


def paragraph(text: str) -> str:
    """Return text in lines of a page's width."""
    return fill(text, WIDTH, break_on_hyphens=False, break_long_words=False)


def table(columns: Columns, rows: Iterable[Any]) -> list[str]:
    """Return the lines of a table of rows."""
    cells = [attrgetter(cell) if isinstance(cell, str) else cell for cell in columns.values()]
    titles = [title.rstrip() for title in columns]
    return lines_of(titles, ([cell(row) for cell in cells] for row in rows))


def lines_of(titles: Sequence[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """Return the lines of a table of cells."""
    return [_line(titles), '|---' * len(titles) + '|', *map(_line, rows)]


def grid(cells: Cells, corner: str = '') -> list[str]:
    """Return a table of cells by (row, column), in the order in which these first occur."""
    columns = list(dict.fromkeys(column for _, column in cells))
    rows = dict.fromkeys(row for row, _ in cells)
    found = ([row, *(cells.get((row, column), '-') for column in columns)] for row in rows)
    head, *lines = lines_of([corner, *columns], found)
    return [head if corner else head[:1] + head[2:], *lines]


def _line(cells: Iterable[object]) -> str:
    return '| ' + ' | '.join(map(str, cells)) + ' |'


def missed_bounds(names: Sequence[str]) -> str:
    """Return the names of what missed its bound in brackets, for a sentence; '' without."""
    return f' (missed: {"; ".join(names)})' if names else ''


def bullets(texts: Iterable[str], otherwise: str) -> str:
    """Return texts as a list, or another text if there are none."""
    return '\n'.join(f'- {text}' for text in texts) or otherwise


def write(folder: Path, name: str, text: str, data: Any) -> list[Path]:
    """Write a page and its data, NAME.md and NAME.json, into a folder, and return their paths."""
    files_of = {f'{name}.md': text, f'{name}.json': json_text(data)}
    return [write_text(folder, file, content) for file, content in files_of.items()]


def write_text(folder: Path, name: str, text: str) -> Path:
    """Write a file into a folder, which is made if it is missing, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text, encoding='utf-8')
    return path


def json_text(data: Any) -> str:
    """Return data and records as JSON; null for infinities and NaN, which JSON does not have."""

    def plain(value: Any) -> Any:
        if is_dataclass(value) and not isinstance(value, type):
            value = asdict(value)
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps(plain(data), indent=1) + '\n'
