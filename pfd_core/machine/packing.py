# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Packing: the same work on many partly filled rows of lanes, moved onto full rows.

A step of n processors costs the same whether all of them work or one. Where an algorithm has rows
of independent work that leave lanes idle (the pairs i < j of a triangle, a late level of a
recurrence), their lanes can be laid side by side: k rows with m filled lanes in all take
ceil(m / n) steps instead of k. The price is data moved between lanes, which the counts show as
routes. One processor has nothing to pack, and the schedule `unpacked` does not pack either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pfd_core.machine.lanes import each, merge
from pfd_core.machine.patterns import levels, prefix, suffix, taken
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import dot

Slot = tuple[int, int]  # a row of work, and the lane of it


def packed(function: Callable[..., Any], rows: Sequence[tuple[Any, ...]]) -> list[Any]:
    """
    Return function(*operands) for each row, with as few steps as its lanes allow.

    Parameters
    ----------
    function : callable
        Arithmetic without routes, on lane values or vectors of them.
    rows : sequence of tuple
        Operands; a row is filled where all its operands have a value.

    Returns
    -------
    list
        The results, each with a value on the lanes that its row fills.

    """
    recorder = _first(rows[0][0]).recorder
    if not recorder.packs:
        return [function(*operands) for operands in rows]
    slots = [(k, lane) for k, operands in enumerate(rows) for lane in _filled(recorder, operands)]
    results: list[Any] = [None] * len(rows)
    for start in range(0, len(slots), recorder.lanes):
        places = _places(recorder, slots[start : start + recorder.lanes])
        value = function(
            *(_gather([operands[p] for operands in rows], places) for p in range(len(rows[0])))
        )
        for k in sorted({row for row, _ in places.values()}):
            results[k] = _scatter(value, results[k], places, k)
    return results


def prefix_sum(x: LaneArray) -> LaneArray:
    """Return the sums of each component of x over lanes 0..i, on lane i: packed FOHRA."""
    return _sums(x, downward=False)


def suffix_sum(x: LaneArray) -> LaneArray:
    """Return the sums of each component of x over lanes i..n-1, on lane i: packed FOHRA."""
    return _sums(x, downward=True)


def prefix_product(R: LaneArray) -> LaneArray:
    """Return the matrix products R(0) R(1) .. R(i), (3, 3), on lane i: packed FOHRA."""
    recorder = _first(R).recorder
    if not recorder.packs:
        swept: LaneArray = prefix(lambda left, right: left @ right, R)
        return swept
    for sources in levels(recorder, downward=False):
        left = taken(R, sources)
        elements = packed(dot, [(left[i], R[:, j]) for i in range(3) for j in range(3)])
        R = np.array(
            [merge(new, old) for new, old in zip(elements, np.ravel(R), strict=True)], dtype=object
        ).reshape(3, 3)
    return R


def _sums(x: LaneArray, downward: bool) -> LaneArray:
    recorder = _first(x).recorder
    if not recorder.packs:
        swept: LaneArray = (suffix if downward else prefix)(lambda a, b: a + b, x)
        return swept
    values: LaneArray = np.ravel(x)
    for sources in levels(recorder, downward):
        sums = packed(lambda a, b: a + b, [(taken(value, sources), value) for value in values])
        values = np.array([merge(a, b) for a, b in zip(sums, values, strict=True)], dtype=object)
    return values.reshape(x.shape)


def _first(value: Any) -> Lanes:
    while not isinstance(value, Lanes):
        value = value[0]
    return value


def _filled(recorder: Recorder, operands: tuple[Any, ...]) -> list[int]:
    defined = recorder.all
    for operand in operands:
        defined &= _first(operand).defined
    return [lane for lane in range(recorder.lanes) if defined >> lane & 1]


def _places(recorder: Recorder, group: Sequence[Slot]) -> dict[int, Slot]:
    """Return which slot each lane takes: one of its own where it can."""
    places: dict[int, Slot] = {}
    homeless = [slot for slot in group if places.setdefault(slot[1], slot) != slot]
    free = (lane for lane in range(recorder.lanes) if lane not in places)
    places.update(zip(free, homeless, strict=False))
    return places


def _gather(values: Sequence[Any], places: dict[int, Slot]) -> Any:
    """Return one value whose lanes hold the elements at the given places."""

    def collect(*members: Lanes) -> Lanes:
        row: Lanes | None = None
        for k in sorted({slot[0] for slot in places.values()}):
            sources = [None] * members[k].recorder.lanes
            for lane, (which, source) in places.items():
                if which == k:
                    sources[lane] = source  # type: ignore[call-overload]
            row = members[k].recorder.route(members[k], sources, row)
        assert row is not None
        return row

    return each(collect, *values)


def _scatter(value: Any, known: Any, places: dict[int, Slot], k: int) -> Any:
    """Return the result of row k with the lanes in `places` added to those known so far."""

    def spread(x: Lanes, *before: Lanes) -> Lanes:
        sources: list[int | None] = [None] * x.recorder.lanes
        for lane, (which, target) in places.items():
            if which == k:
                sources[target] = lane
        return x.recorder.route(x, sources, before[0] if before else None)

    return each(spread, value) if known is None else each(spread, value, known)
