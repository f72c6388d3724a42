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

    def __missing__(self, direction: str) -> Any:
        raise LinkError(f'a cell reads from {direction!r}, but only has links from {sorted(self)}')


@dataclass(frozen=True)
class Step:
    """The work of a cell in one cycle."""

    state: Any  # for the next cycle
    sent: Mapping[str, Any] = field(default_factory=dict)  # direction to item
    action: str = ''  # the computation; empty if the cell only passed items on


# A cell's program: its state (None at first) and its latches to its step.
Cell = Callable[[Any, Ports], Step]


@dataclass(frozen=True)
class Trace:
    """Record of a run of an array."""

    steps: tuple[dict[Place, Step], ...]  # of cycle t at t - 1: each cell with an item, its work
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

    def sent(self, place: Place, direction: str) -> list[Any]:
        """Return the items that a cell sent in a direction, by time."""
        own = (steps[place].sent for steps in self.steps if place in steps)
        return [items[direction] for items in own if direction in items]


class Array:
    """
    Cells by place, and the links between neighbours, one end of which at least is a cell.

    LinkError for another link. Equal links are one link: there is one latch on it.
    """

    def __init__(self, cells: Mapping[Place, Cell], links: Iterable[Link]) -> None:
        self.cells = dict(cells)
        self.links = frozenset(links)
        ends = {end(at, way) for at in self.cells for way in DIRECTIONS for end in (into, out_of)}
        for link in sorted(self.links - ends):
            raise LinkError(f'link {link} must join a cell with a neighbouring place')

    def run(self, streams: Mapping[Link, Mapping[int, Any]]) -> Trace:
        """
        Run the clock until all latches and streams are empty.

        `streams` has cycle to item for links from outside; cycles count from 1.
        """
        for link, items in streams.items():
            if link not in self.links or link.source in self.cells:
                raise LinkError(f'stream on {link}: there is no such link from outside')
            if min(items, default=1) < 1:
                raise ValueError(f'stream on {link}: cycles count from 1, got {min(items)}')
        last = max((cycle for items in streams.values() for cycle in items), default=0)
        states: dict[Place, Any] = dict.fromkeys(self.cells)
        latches: dict[Link, Any] = {}
        done: list[dict[Place, Step]] = []
        while latches or len(done) < last:
            cycle = len(done) + 1
            latches |= {link: items[cycle] for link, items in streams.items() if cycle in items}
            steps = {
                place: self.cells[place](states[place], self._ports(place, latches))
                for place in dict.fromkeys(link.target for link in latches)
            }
            states |= {place: step.state for place, step in steps.items()}
            sent = {
                self._link(place, way): item
                for place, step in steps.items()
                for way, item in step.sent.items()
            }
            latches = {link: item for link, item in sent.items() if link.target in self.cells}
            done.append(steps)
        return Trace(tuple(done), states)

    def _ports(self, place: Place, latches: Mapping[Link, Any]) -> Ports:
        links = {way: into(place, way) for way in DIRECTIONS}
        return Ports({way: latches.get(x) for way, x in links.items() if x in self.links})

    def _link(self, place: Place, direction: str) -> Link:
        links = {way: out_of(place, way) for way in DIRECTIONS}
        own = sorted(way for way, link in links.items() if link in self.links)
        if direction not in own:
            raise LinkError(f'cell {place} sends {direction!r}, but only has links to {own}')
        return links[direction]
