# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages from templates, tables of rows and cells, and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
import json
import math
from pathlib import Path
import re

import pytest

from pfd_core import report
from pfd_core.report.render.markdown import grid, json_text, page, table, write
from pfd_core.report.render.numbers import order, short, yes
from pfd_core.report.render.records import read, record_of

REPORT = Path(report.__file__).parent


@dataclass(frozen=True)
class Row:
    name: str
    value: int


@dataclass(frozen=True)
class Point:
    error: float
    parts: tuple[float, ...] = ()


@dataclass(frozen=True)
class Whole:
    points: list[Point]
    by_number: Mapping[int, Row]
    pair: tuple[int, str]
    missing: float | None


def test_a_table_has_a_field_or_a_function_of_each_row_for_a_column() -> None:
    columns = {'name': 'name', 'twice': lambda row: 2 * row.value, 'name ': 'name'}
    lines = table(columns, [Row('a', 1), Row('b', 2)])
    assert lines == ['| name | twice | name |', '|---|---|---|', '| a | 2 | a |', '| b | 4 | b |']


def test_a_grid_has_a_dash_for_a_missing_cell() -> None:
    cells = {('way', 'ur5'): '1', ('way', 'panda'): '2', ('other', 'panda'): '3'}
    assert grid(cells) == [
        '| | ur5 | panda |',
        '|---|---|---|',
        '| way | 1 | 2 |',
        '| other | - | 3 |',
    ]
    assert grid(cells, 'n')[0] == '| n | ur5 | panda |'


def test_an_absent_section_leaves_no_empty_line() -> None:
    values = {name: name.upper() for name in ('title', 'command', 'machine', 'quantity', 'call')}
    values |= {name: name.upper() for name in ('result', 'notes', 'summary', 'excluded')}
    text = page('quantity', tables=['| one |', '| two |'], **values)
    assert '\n\nSUMMARY\n\n| one |\n| two |\n\n## Excluded\n\nEXCLUDED\n' in text
    assert '\n\nSUMMARY\n\n## Excluded\n' in page('quantity', tables=None, **values)


def test_a_paragraph_on_one_line_of_a_template_is_wrapped_and_other_lines_stay() -> None:
    text = page('speed-summary', batch='batch of 64', ratios=['| ' + 'x' * 200 + ' |'])
    lines = text.splitlines()
    assert all(len(line) <= 99 for line in lines[:-1])
    assert ' '.join(lines[2:-2]).endswith('memory, over the time of the kernel.')
    assert len(lines[-1]) == 204


def test_a_value_that_a_template_lacks_is_an_error() -> None:
    with pytest.raises(KeyError, match='ratios'):
        page('speed-summary', batch='batch of 64')


def test_a_value_without_a_place_and_one_that_is_no_text_are_errors() -> None:
    with pytest.raises(ValueError, match='speed-summary has no place for extra'):
        page('speed-summary', batch='batch of 64', ratios=[], extra='')
    with pytest.raises(TypeError, match='batch in speed-summary must be text, got None'):
        page('speed-summary', batch=None, ratios=[])


def test_every_template_is_of_a_page() -> None:
    source = ''.join(path.read_text() for path in REPORT.glob('*.py'))
    named = {path.stem for path in (REPORT / 'texts').iterdir()}
    used = set(re.findall(r"\b(?:page|_page)\(\s*'([\w-]+)'", source))
    used |= set(re.findall(r"^NAME = '([\w-]+)'", source, re.MULTILINE))
    assert named == used


def test_a_page_and_its_data_are_written_and_numbers_that_are_not_finite_are_null(
    tmp_path: Path,
) -> None:
    paths = write(
        tmp_path / 'new', 'name', 'text\n', {'points': [Point(math.inf, (math.nan, 1.0))]}
    )
    assert [path.name for path in paths] == ['name.md', 'name.json']
    assert paths[0].read_text() == 'text\n'
    assert json.loads(paths[1].read_text()) == {'points': [{'error': None, 'parts': [None, 1.0]}]}
    assert json_text([]) == '[]\n'


def test_a_record_is_read_from_its_json_and_a_null_is_a_number_that_was_not_finite(
    tmp_path: Path,
) -> None:
    whole = Whole([Point(1.0, (2.0, 3.0))], {6: Row('a', 1)}, (1, 'x'), None)
    path = tmp_path / 'data.json'
    path.write_text(json_text({'quick': True, **asdict(whole)}))
    assert read(Whole, path) == whole
    assert math.isnan(record_of(Point, {'error': None}).error)
    assert record_of(list[Point], [{'error': None}], math.inf) == [Point(math.inf)]


def test_numbers_have_the_digits_that_a_reader_needs() -> None:
    assert [order(x) for x in (1.26e-9, math.inf, None)] == ['1e-09', 'lost', 'lost']
    assert [short(x) for x in (0.12345, 99.4, 1234.5, 2.5e6)] == ['0.123', '99.4', '1234', '2e+06']
    assert [yes(x) for x in (True, False, None)] == ['yes', 'no', '-']
