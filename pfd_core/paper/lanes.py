# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Data moved between lanes.

    shift, broadcast, taken   each lane takes the value of another lane: one route a number
    collect                   each lane its own element of several values: free
    gather                    data from any lane to any lane
    Board                     elements by name, wherever they lie
    packed                    the same work on many partly filled rows, on full rows of lanes

`shift` leaves the lanes without a neighbour empty. A lane takes part in an operation when all its
operands have a value there; pfd_core.machine.lanes empties and fills lanes.

A step of n processors costs the same whether all of them work or one. Where an algorithm has rows
of independent work that leave lanes idle (the pairs i < j of a triangle, a late level of a
recurrence), their lanes can be laid side by side: k rows with m filled lanes in all take
ceil(m / n) steps instead of k. The price is data moved between lanes, which the counts show as
routes. One processor has nothing to pack, and the schedule `unpacked` does not pack either.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from pfd_core.machine.lanes import each, merge, on
from pfd_core.machine.recorder import Lanes, Recorder, lanes_of

Name = Hashable
Place = tuple[Lanes, int]  # a value, and the lane of an element
Slot = tuple[int, int]  # a row of work, and the lane of it


def recorder_of(value: Any) -> Recorder:
    """Return the recorder of a value, a vector, a matrix or a tuple of values over lanes."""
    while not isinstance(value, Lanes):
        value = value[0]
    return value.recorder


def taken(value: Any, sources: Mapping[int, int]) -> Any:
    """Return on each lane of `sources` the value of the lane that it names."""
    return each(lambda x: _routed(x, sources), value)


def _routed(value: Lanes, sources: Mapping[int, int], fill: Lanes | None = None) -> Lanes:
    return value.recorder.route(value, [*map(sources.get, range(value.recorder.lanes))], fill)


def shift(value: Any, by: int) -> Any:
    """Return the value of lane i - by on lane i; lanes without such a neighbour are empty."""
    n = recorder_of(value).lanes
    return taken(value, {i: i - by for i in range(n) if 0 <= i - by < n})


def broadcast(value: Any, lane: int) -> Any:
    """Return the value of one lane on all lanes."""
    return taken(value, dict.fromkeys(range(recorder_of(value).lanes), lane))


def collect(values: Mapping[int, Lanes]) -> Lanes:
    """Return on each lane of `values` its own element of the given value; this costs nothing."""
    groups: dict[Lanes, list[int]] = {}
    for lane, value in values.items():
        groups.setdefault(value, []).append(lane)
    first, *others = (on(value, lanes) for value, lanes in groups.items())
    result: Lanes = first
    for part in others:
        result = merge(part, result)
    return result


def gather(places: Mapping[int, Place]) -> Lanes:
    """
    Return on each lane of `places` the element that the mapping names.

    A lane can read any of its own registers, so that one route takes one element from each lane
    to all lanes that need it: as many routes as the busiest lane has elements to send.
    """
    staying = {lane: value for lane, (value, source) in places.items() if source == lane}
    result = collect(staying) if staying else None
    moving = {lane: place for lane, place in places.items() if place[1] != lane}
    while moving:
        sent: dict[int, Lanes] = {}
        for value, source in moving.values():
            sent.setdefault(source, value)
        now = {lane: source for lane, (x, source) in moving.items() if sent[source] == x}
        result = _routed(collect(sent), now, result)
        moving = {lane: place for lane, place in moving.items() if lane not in now}
    assert result is not None
    return result


class Board:
    """Elements by name: `at` has the value and the lane of each. A step reads and puts rows."""

    def __init__(self) -> None:
        self.at: dict[Name, Place] = {}

    def put(self, value: Lanes, names: Mapping[int, Name]) -> None:
        """Store the elements of a value under names, by lane."""
        self.at.update((name, (value, lane)) for lane, name in names.items())

    def row(self, names: Mapping[int, Name]) -> Lanes:
        """Return the named element on each lane; one on its own lane takes no route."""
        return gather({lane: self.at[name] for lane, name in names.items()})

    def lane(self, name: Name) -> int:
        """Return the lane of an element."""
        return self.at[name][1]


def assigned(wishes: Sequence[Sequence[int]], n: int) -> list[int]:
    """Return one of n lanes for each item: its first wish if that is free, its next, or any."""
    chosen: dict[int, int] = {}
    free = dict.fromkeys(range(n))
    for wanted in zip(*wishes, strict=True):
        for item, lane in enumerate(wanted):
            if item not in chosen and lane in free:
                chosen[item] = lane
                del free[lane]
    left = iter(free)
    return [chosen[item] if item in chosen else next(left) for item in range(len(wishes))]


def packed(
    function: Callable[..., Any], rows: Sequence[tuple[Any, ...]], packs: bool = True
) -> list[Any]:
    """
    Return function(*operands) for each row, with as few steps as its lanes allow.

    The function is arithmetic without routes, on lane values or vectors of them. A row is filled
    where all its operands have a value, and so is its result.
    """
    recorder = recorder_of(rows[0][0])
    if not (packs and recorder.packs):
        return [function(*operands) for operands in rows]
    slots = [(k, lane) for k, operands in enumerate(rows) for lane in _filled(operands)]
    results: list[Any] = [None] * len(rows)
    for start in range(0, len(slots), recorder.lanes):
        places = _places(recorder.lanes, slots[start : start + recorder.lanes])
        # Of each row in this step, the lane of its work by the lane that the step does it on.
        used = {
            k: {lane: source for lane, (row, source) in places.items() if row == k}
            for k in sorted({row for row, _ in places.values()})
        }

        def side_by_side(*members: Lanes, used: Mapping[int, Any] = used) -> Lanes:
            row: Lanes | None = None
            for k, sources in used.items():
                row = _routed(members[k], sources, row)
            assert row is not None
            return row

        value = function(*(each(side_by_side, *column) for column in zip(*rows, strict=True)))
        for k, sources in used.items():
            targets = {target: lane for lane, target in sources.items()}
            known = () if results[k] is None else (results[k],)
            results[k] = each(lambda x, *fill, by=targets: _routed(x, by, *fill), value, *known)
    return results


def _filled(operands: tuple[Any, ...]) -> tuple[int, ...]:
    """Return the lanes on which all operands have a value."""
    mask = recorder_of(operands).all
    for operand in operands:
        while not isinstance(operand, Lanes):
            operand = operand[0]
        mask &= operand.defined
    return lanes_of(mask)


def _places(lanes: int, group: Sequence[Slot]) -> dict[int, Slot]:
    """Return which slot each lane takes: one of its own where it can."""
    places: dict[int, Slot] = {}
    homeless = [slot for slot in group if places.setdefault(slot[1], slot) != slot]
    free = (lane for lane in range(lanes) if lane not in places)
    places.update(zip(free, homeless, strict=False))
    return places
