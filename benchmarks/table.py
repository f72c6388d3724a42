# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pages and their tables as Markdown, and their data as JSON.

The prose of a page is a template, texts/NAME.md. A line that is only `{name}` is a block: a table
or a section, inserted as it is. In other lines values replace `{name}`. A paragraph on one long
line of the template is wrapped; other lines, items of lists and rows of tables stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
import json
import math
from pathlib import Path
import re
from textwrap import fill
from typing import Any

import numpy as np
import yaml

HERE = Path(__file__).resolve().parent
WIDTH = 99
BLOCK = re.compile(r'{(\w+)}')
Row = Mapping[str, Any]
# Titles of a table, each with the key of a row, or a function of a row, that gives its cells. Of
# equal titles the second ends with a space.
Columns = Mapping[str, str | Callable[[Any], object]]
# Cells of a table by row and column.
Cells = dict[tuple[str, object], object]


def page(name: str, /, **values: Any) -> str:
    """Return the page or section of a template of texts, ended by a line break."""
    template = (HERE / 'texts' / f'{name}.md').read_text(encoding='utf-8')
    lines: list[str] = []
    for line in map(str.rstrip, template.splitlines()):
        block = BLOCK.fullmatch(line)
        if block:
            value = values[block[1]]
            lines.append(value.rstrip('\n') if isinstance(value, str) else '\n'.join(value))
        else:
            filled = line.format_map(values)
            lines.append(
                paragraph(filled) if len(line) > WIDTH and line[0] not in '-|' else filled
            )
    return '\n'.join(lines) + '\n'


def paragraph(text: str, width: int = WIDTH) -> str:
    """Return text in lines of a width, by default a page's."""
    return fill(text, width, break_on_hyphens=False, break_long_words=False)


def table(columns: Columns, rows: Iterable[Row]) -> list[str]:
    """Return the lines of a table of rows."""

    def cell(of: str | Callable[[Any], object], row: Row) -> object:
        return row[of] if isinstance(of, str) else of(row)

    titles = [title.rstrip() for title in columns]
    return lines_of(titles, ([cell(of, row) for of in columns.values()] for row in rows))


def shown(keys: str) -> Columns:
    """Return the columns of keys of a row, separated by spaces, with the values as they are."""
    return {key.replace('_', ' '): partial(_value_of, key) for key in keys.split()}


def _value_of(key: str, row: Row) -> str:
    def cell(value: object) -> str:
        return f'{value:.3g}' if isinstance(value, float) else str(value)

    value = row.get(key)
    if value is None or isinstance(value, bool):
        return {None: '-', True: 'yes', False: 'no'}[value]
    return ' / '.join(map(cell, value)) if isinstance(value, list) else cell(value)


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


def bullets(texts: Iterable[str], otherwise: str) -> str:
    """Return texts as a list, or another text if there are none."""
    return '\n'.join(f'- {text}' for text in texts) or otherwise


def result_row(what: str, cells: Sequence[tuple[str, str, str, str]]) -> dict[str, str]:
    """Return a row of README.md from one or two of (ours, peer, theirs, speed-up), as text."""
    ours, peers, theirs, ratios = zip(*cells, strict=True) if cells else ((), (), (), ())
    row = {'what': what, 'ours': ' / '.join(ours), 'speed-up': ' / '.join(ratios)}
    others = {'peer': peers, 'theirs': theirs}
    return row | {key: ' / '.join(dict.fromkeys(texts)) for key, texts in others.items()}


def order(error: float | None) -> str:
    """Return an error to one digit, 'lost' if it is None or not finite."""
    return 'lost' if error is None or not math.isfinite(error) else f'{error:.0e}'


def short(value: float | None) -> str:
    """Return a number in three digits, or all before the point, or as a power; or 'lost'."""
    if value is None or not math.isfinite(value):
        return 'lost'
    if value >= 1e6:
        return f'{value:.0e}'
    return f'{value:.0f}' if value >= 99.5 else f'{value:.3g}'


def stored_text(name: str) -> str:
    """Return a file of benchmarks/data."""
    return (HERE / 'data' / name).read_text(encoding='utf-8')


def stored_table(name: str) -> Any:
    """Return the content of benchmarks/data/NAME.yaml."""
    return yaml.load(stored_text(f'{name}.yaml'), yaml.CSafeLoader)


def write_text(folder: Path, name: str, text: str) -> Path:
    """Write a file into a folder, which is made if it is missing, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text, encoding='utf-8')
    return path


def json_text(data: Any) -> str:
    """
    Return data as JSON, a row a line.

    Infinity and NaN, which JSON does not have, become null; keys become text.
    """
    return _lines(_plain(data)) + '\n'


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _lines(value: Any, depth: int = 0) -> str:
    """Return JSON in which only containers of containers are split over lines."""
    items = value.values() if isinstance(value, dict) else value
    if not isinstance(value, (dict, list)) or not any(isinstance(x, (dict, list)) for x in items):
        return json.dumps(value, ensure_ascii=False)
    inner, outer = '\n' + ' ' * (depth + 1), '\n' + ' ' * depth
    if isinstance(value, dict):
        found = (f'{json.dumps(key)}: {_lines(item, depth + 1)}' for key, item in value.items())
        return '{' + inner + f',{inner}'.join(found) + outer + '}'
    return '[' + inner + f',{inner}'.join(_lines(x, depth + 1) for x in value) + outer + ']'
