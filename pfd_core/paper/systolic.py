# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A systolic array: cells on a grid, a latch on every link between neighbours, one clock.

    cycle t, first phase     every cell with an item in its latch computes its next
                             state and the items that it sends, from the latches of cycle t - 1
    cycle t, second phase    all states and all latches change at once

A place is (row, column); the row above is row + 1. A link joins two neighbouring places, has
a direction and one latch: an item sent in cycle t is read in cycle t + 1, or lost. One end of
a link may lie outside: streams enter there, and results leave. A cell reads the latches of
its own links and no others.

This is the array of Lee and Chang 1987, section 2.6, as a machine; its cells' programs are in
pfd_core.paper.array. Items are opaque here: numbers of any kind, or values over lanes, so that
running the array records it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

Place = tuple[int, int]

DIRECTIONS = {'left': (0, -1), 'right': (0, 1), 'up': (1, 0), 'down': (-1, 0)}


class LinkError(ValueError):
    """An array, a stream or a cell uses a link that cannot be or is not there."""


class Link(NamedTuple):
    """A directed connection from one place to a neighbouring one, with a latch."""

    source: Place
    target: Place

    def __str__(self) -> str:
        return f'{self.source} -> {self.target}'


def out_of(place: Place, direction: str) -> Link:
    """Return the link that leads from a place in a direction."""
    up, right = DIRECTIONS[direction]
    return Link(place, (place[0] + up, place[1] + right))


def into(place: Place, direction: str) -> Link:
    """Return the link on which a place receives items from a direction."""
    link = out_of(place, direction)
    return Link(link.target, link.source)


class Ports(dict[str, Any]):
    """
    The latches of one cell in one cycle, by direction: the item that came, None if nothing did.

    There is a key for each link of the cell; `get` returns None without a link, too.
    """

    def __init__(self, place: Place, items: Mapping[str, Any]) -> None:
        super().__init__(items)
        self.place = place

    def __missing__(self, direction: str) -> Any:
        raise LinkError(
            f'cell {self.place} reads from {direction!r}, but only has links from {sorted(self)}: '
            'declare the link, or read another one'
        )


@dataclass(frozen=True)
class Step:
    """The work of a cell in one cycle."""

    state: Any  # for the next cycle
    sent: Mapping[str, Any] = field(default_factory=dict)  # direction to item
    action: str = ''  # the computation; empty if the cell only passed items on


# A cell's program: its state (None at first) and its latches to its step.
Cell = Callable[[Any, Ports], Step]


class Emission(NamedTuple):
    """An item that left the array."""

    cycle: int
    place: Place  # of the cell that sent it
    direction: str
    item: Any


@dataclass(frozen=True)
class Trace:
    """Record of a run of an array."""

    steps: tuple[dict[Place, Step], ...]  # of cycle t at t - 1: each cell with an item, its work
    emitted: tuple[Emission, ...]  # in order of time
    states: dict[Place, Any]  # at the end

    @property
    def actions(self) -> list[dict[Place, str]]:
        """Of cycle t at t - 1: each cell that acted, and how."""
        return [{at: x.action for at, x in steps.items() if x.action} for steps in self.steps]

    @property
    def cycles(self) -> int:
        """The last cycle in which a cell acted."""
        return max((t for t, acting in enumerate(self.actions, 1) if acting), default=0)

    @property
    def utilisation(self) -> float:
        """Share of the cells' cycles in which they acted, 0 to 1."""
        return sum(map(len, self.actions)) / max(len(self.states) * self.cycles, 1)

    def cycles_with(self, *names: str) -> int:
        """Return the number of cycles in which some cell did one of the named actions."""
        return sum(any(action in names for action in acting.values()) for acting in self.actions)

    def leaving(self, place: Place, direction: str) -> list[Any]:
        """Return the items that a cell sent out of the array in a direction, by time."""
        return [e.item for e in self.emitted if (e.place, e.direction) == (place, direction)]


class Array:
    """
    Cells by place, and the links between neighbours, one end of which at least is a cell.

    LinkError for another link. Equal links are one link: there is one latch on it.
    """

    def __init__(self, cells: Mapping[Place, Cell], links: Iterable[Link]) -> None:
        self.cells = dict(cells)
        self.links = frozenset(links)
        self._in, self._out = (
            {
                place: {
                    way: end(place, way) for way in DIRECTIONS if end(place, way) in self.links
                }
                for place in self.cells
            }
            for end in (into, out_of)
        )
        own = (found.values() for ends in (self._in, self._out) for found in ends.values())
        for link in sorted(self.links.difference(*own)):
            raise LinkError(f'link {link} must join a cell with a neighbouring place')

    def run(self, streams: Mapping[Link, Mapping[int, Any]], at_most: int = 100_000) -> Trace:
        """
        Run the clock until all latches and streams are empty.

        Parameters
        ----------
        streams : mapping
            For a link from outside, cycle to item; cycles count from 1.
        at_most : int
            Largest number of cycles of a run; ValueError if the array is busy for longer.

        """
        arriving: dict[int, dict[Link, Any]] = {}
        for link, items in streams.items():
            if link not in self.links or link.source in self.cells:
                raise LinkError(f'stream on {link}: there is no such link from outside')
            if items and min(items) < 1:
                raise ValueError(f'stream on {link}: cycles count from 1, got {min(items)}')
            for cycle, item in items.items():
                arriving.setdefault(cycle, {})[link] = item
        states: dict[Place, Any] = dict.fromkeys(self.cells)
        latches: dict[Link, Any] = {}
        done: list[dict[Place, Step]] = []
        emitted: list[Emission] = []
        while latches or arriving:
            cycle = len(done) + 1
            if cycle > at_most:
                raise ValueError(f'the array is still busy after {at_most} cycles')
            latches |= arriving.pop(cycle, {})
            steps = {
                place: self.cells[place](
                    states[place],
                    Ports(place, {way: latches.get(x) for way, x in self._in[place].items()}),
                )
                for place in dict.fromkeys(link.target for link in latches)
            }
            latches = {}
            for place, step in steps.items():
                states[place] = step.state
                for direction, item in step.sent.items():
                    link = self._sent(place, direction)
                    if link.target in self.cells:
                        latches[link] = item
                    else:
                        emitted.append(Emission(cycle, place, direction, item))
            done.append(steps)
        return Trace(tuple(done), tuple(emitted), states)

    def _sent(self, place: Place, direction: str) -> Link:
        ends = self._out[place]
        if direction not in ends:
            raise LinkError(
                f'cell {place} sends {direction!r}, but only has links to {sorted(ends)}'
            )
        return ends[direction]
