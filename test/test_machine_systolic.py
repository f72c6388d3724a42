# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The systolic machine: one clock, two phases, neighbours only."""

from __future__ import annotations

from typing import Any

from bridge import SystolicArray, SystolicLink, SystolicLinkError, SystolicPorts, SystolicStep
import numpy as np
import pytest

FIRST = SystolicLink((1, 0), (1, 1))


def row(n: int, cell: Any) -> SystolicArray:
    """Return n cells in a row, linked from left to right, open at both ends."""
    links = [SystolicLink((1, i), (1, i + 1)) for i in range(n + 1)]
    return SystolicArray({(1, i): cell for i in range(1, n + 1)}, links)


def pass_on(state: Any, ports: SystolicPorts) -> SystolicStep:
    return SystolicStep(state, {'right': ports['left']}, 'pass')


def test_an_item_takes_one_cycle_to_each_neighbour() -> None:
    trace = row(5, pass_on).run({FIRST: {1: 'a', 2: 'b', 7: 'c'}})
    assert [(e.cycle, e.item) for e in trace.emitted] == [(5, 'a'), (6, 'b'), (11, 'c')]
    assert trace.leaving((1, 5), 'right') == ['a', 'b', 'c']
    assert trace.leaving((1, 4), 'right') == []


def test_all_latches_change_at_once_whatever_the_order_of_the_cells() -> None:
    # Each cell keeps the last item and sends the one before: a wrong order would mix cycles.
    def delay(state: Any, ports: SystolicPorts) -> SystolicStep:
        return SystolicStep(ports['left'], {} if state is None else {'right': state}, 'delay')

    items = dict(enumerate('abcdefgh', 1))
    forward = row(3, delay)
    backward = SystolicArray(dict(reversed(forward.cells.items())), forward.links)
    traces = [array.run({FIRST: items}) for array in (forward, backward)]
    assert traces[0].emitted == traces[1].emitted
    assert traces[0].states == traces[1].states == {(1, 1): 'h', (1, 2): 'g', (1, 3): 'f'}
    assert [e.item for e in traces[0].emitted] == list('abcde')


def test_two_cells_exchange_their_values() -> None:
    def exchange(outer: str, inner: str) -> Any:
        def cell(state: Any, ports: SystolicPorts) -> SystolicStep:
            if ports[outer] is not None:
                return SystolicStep(ports[outer], {inner: ports[outer]}, 'send')
            return SystolicStep(ports[inner], {}, 'take')

        return cell

    last = SystolicLink((1, 3), (1, 2))
    links = [FIRST, last, SystolicLink((1, 1), (1, 2)), SystolicLink((1, 2), (1, 1))]
    cells = {(1, 1): exchange('left', 'right'), (1, 2): exchange('right', 'left')}
    trace = SystolicArray(cells, links).run({FIRST: {1: 'a'}, last: {1: 'b'}})
    assert trace.states == {(1, 1): 'b', (1, 2): 'a'}
    assert trace.cycles == 2


def test_a_value_that_is_not_read_in_the_next_cycle_is_lost() -> None:
    def every_other(state: Any, ports: SystolicPorts) -> SystolicStep:
        turn = not state
        return SystolicStep(turn, {'right': ports['left']} if turn else {})

    trace = row(1, every_other).run({FIRST: dict(enumerate('abcd', 1))})
    assert trace.leaving((1, 1), 'right') == ['a', 'c']


def test_a_row_of_cells_evaluates_polynomials_by_horner() -> None:
    coefficients = [2.0, -3.0, 0.5, 4.0]

    def horner(coefficient: float) -> Any:
        def cell(state: Any, ports: SystolicPorts) -> SystolicStep:
            x, total = ports['left']
            return SystolicStep(state, {'right': (x, total * x + coefficient)}, 'multiply and add')

        return cell

    links = row(4, pass_on).links
    array = SystolicArray({(1, i): horner(c) for i, c in enumerate(coefficients, 1)}, links)
    points = np.linspace(-2, 2, 9)
    trace = array.run({FIRST: {t: (x, 0.0) for t, x in enumerate(points, 1)}})
    found = [total for _, total in trace.leaving((1, 4), 'right')]
    np.testing.assert_array_equal(found, np.polyval(coefficients, points))
    assert trace.cycles == 9 + 4 - 1
    assert trace.utilisation == 9 / 12


def test_cells_that_only_pass_items_on_are_not_counted() -> None:
    def silent(state: Any, ports: SystolicPorts) -> SystolicStep:
        return SystolicStep(state, {'right': ports['left']})

    links = row(3, silent).links
    array = SystolicArray({(1, 1): silent, (1, 2): pass_on, (1, 3): silent}, links)
    trace = array.run({FIRST: {1: 'a'}})
    assert trace.cycles == 2
    assert trace.actions[:2] == ({}, {(1, 2): 'pass'})
    assert trace.utilisation == pytest.approx(1 / 6)
    assert (trace.cycles_with('pass'), trace.cycles_with('divide')) == (1, 0)


def test_equal_links_have_one_latch_and_an_array_to_which_nothing_comes_does_nothing() -> None:
    array = SystolicArray({(1, 1): pass_on}, [FIRST, FIRST, SystolicLink((1, 1), (1, 2))])
    assert len(array.links) == 2
    trace = array.run({})
    assert (trace.cycles, trace.utilisation, trace.emitted) == (0, 0.0, ())


def test_a_cell_cannot_read_where_it_has_no_link() -> None:
    def peek(state: Any, ports: SystolicPorts) -> SystolicStep:
        assert ports.get('up') is None
        assert 'up' not in ports
        return SystolicStep(ports['up'])

    array = SystolicArray({(1, 1): pass_on, (1, 2): peek}, row(2, pass_on).links)
    with pytest.raises(
        SystolicLinkError, match=r"cell \(1, 2\) reads from 'up', but only has .*'left'"
    ):
        array.run({FIRST: {1: 'a'}})


@pytest.mark.parametrize(
    ('way', 'message'),
    [
        ('up', r"cell \(1, 1\) sends 'up', but only has links to \['right'\]"),
        ('north', r"cell \(1, 1\) sends 'north', but only has links to \['right'\]"),
    ],
)
def test_a_cell_cannot_send_where_it_has_no_link(way: str, message: str) -> None:
    with pytest.raises(SystolicLinkError, match=message):
        row(2, lambda state, ports: SystolicStep(state, {way: 1})).run({FIRST: {1: 'a'}})


@pytest.mark.parametrize(
    ('link', 'message'),
    [
        (SystolicLink((1, 1), (1, 3)), r'\(1, 1\) -> \(1, 3\) must join a cell with a neigh'),
        (SystolicLink((1, 1), (2, 2)), r'\(1, 1\) -> \(2, 2\) must join a cell with a neigh'),
        (SystolicLink((1, 1), (1, 1)), r'\(1, 1\) -> \(1, 1\) must join a cell with a neigh'),
        (SystolicLink((5, 5), (5, 6)), r'\(5, 5\) -> \(5, 6\) must join a cell with a neigh'),
    ],
)
def test_links_join_neighbours_and_touch_a_cell(link: SystolicLink, message: str) -> None:
    with pytest.raises(SystolicLinkError, match=message):
        SystolicArray({(1, 1): pass_on}, [FIRST, link])


@pytest.mark.parametrize(
    ('link', 'cycle', 'message'),
    [
        (SystolicLink((0, 1), (1, 1)), 1, r'stream on \(0, 1\) -> \(1, 1\): there is no such'),
        (SystolicLink((1, 1), (1, 2)), 1, r'stream on \(1, 1\) -> \(1, 2\): there is no such'),
        (FIRST, 0, 'cycles count from 1, got 0'),
    ],
)
def test_streams_enter_from_outside_from_cycle_1(
    link: SystolicLink, cycle: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        row(2, pass_on).run({link: {cycle: 'a'}})


def test_an_array_that_never_rests_is_given_up() -> None:
    links = [FIRST, SystolicLink((1, 1), (1, 2)), SystolicLink((1, 2), (1, 1))]

    def back_and_forth(state: Any, ports: SystolicPorts) -> SystolicStep:
        return SystolicStep(state, {'left' if 'right' not in ports else 'right': 1})

    with pytest.raises(ValueError, match='still busy after 50 cycles'):
        SystolicArray(dict.fromkeys([(1, 1), (1, 2)], back_and_forth), links).run(
            {FIRST: {1: 1}}, 50
        )
