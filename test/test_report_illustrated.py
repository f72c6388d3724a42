# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of recursive doubling and of Appendix C: what they show is what programs execute."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from pfd_core.algorithms.paper.set_ordering import record_literal_cholesky, set_ordering
from pfd_core.report.illustrated_pages import SETS, doubling_picture, ordering_picture, run
from pfd_core.report.measure.doubling import doubling
from pfd_core.report.render.lane_pictures import WORKERS
from pfd_core.report.render.markdown import page as page_of
from pfd_core.report.render.markdown import write_text

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
SVG = '{http://www.w3.org/2000/svg}'


def words(picture: str) -> list[str]:
    return [one.text or '' for one in ElementTree.fromstring(picture).iter(f'{SVG}text')]


@pytest.mark.parametrize('n', [2, 3, 6, 8, 9])
def test_a_level_doubles_what_a_lane_holds(n: int) -> None:
    levels = doubling(n)
    assert len(levels) == 1 + (n - 1).bit_length()
    for k, level in enumerate(levels):
        for lane, members in enumerate(level.members):
            # Lane i holds its element and the 2^k - 1 before it, as far as there are any.
            assert members == tuple(range(max(0, lane + 1 - 2**k), lane + 1))
    for k, level in enumerate(levels[1:]):
        wanted = [lane - 2**k if lane >= 2**k else None for lane in range(n)]
        assert list(level.sources) == wanted


def test_the_picture_of_doubling_ends_with_every_product_from_the_first() -> None:
    found = words(doubling_picture(6))
    assert found.count('R1') == 4  # on lane 1 from the start
    for last in range(2, 7):
        assert f'R1 .. R{last}' in found


@pytest.mark.parametrize('n', [2, 4, 6])
def test_the_program_does_the_additions_of_the_picture(n: int) -> None:
    states = set_ordering(n)
    program = record_literal_cholesky(n, 'parallel')
    added = [
        one.active.bit_count()
        for one in program.instructions
        if one.op == 'add' and one.section == 'set ordering'
    ]
    assert added == [len(state.picked) for state in states[1:]]
    found = words(ordering_picture(n))
    for k, count in enumerate(added, 1):
        assert f'Iteration {k}: {count} additions' in found
    assert sum(word.endswith(' adds') for word in found) == sum(added)


def test_the_picture_of_appendix_c_has_its_sets() -> None:
    picture = ordering_picture(SETS)
    found = words(picture)
    # Appendix C, step 6: the last two sets.
    for term in ('a_44^(3)', 'a_44^(2,0)', 'a_44^(3,0)', 'a_22^(1,0)', 'a_32^(1,0)'):
        assert term in found
    root = ElementTree.fromstring(picture)
    coloured = [one for one in root.iter(f'{SVG}rect') if one.get('fill') in WORKERS]
    assert len(coloured) == 2 * (4 + 4 + 2)


def test_the_pages_are_what_the_command_writes_now(tmp_path: Path) -> None:
    for page in (*run(tmp_path), write_text(tmp_path, 'paper.md', page_of('paper'))):
        assert page.read_text() == (PAGES / page.name).read_text(), (
            'run pfd report paper --out docs/report'
        )


def test_every_page_that_is_linked_exists() -> None:
    text = (PAGES / 'paper.md').read_text() + (PAGES / 'illustrated.md').read_text()
    links = {part.split(')')[0] for part in text.split('](')[1:]}
    assert len(links) >= 8
    for link in links:
        assert (PAGES / link).is_file(), link
