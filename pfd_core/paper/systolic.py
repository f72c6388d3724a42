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
OPPOSITE = {'left': 'right', 'right': 'left', 'up': 'down', 'down': 'up'}


class LinkError(ValueError):
    """A cell uses a link that the array does not have."""


class Link(NamedTuple):
    """A directed connection from one place to a neighbouring one, with a latch."""

    source: Place
    target: Place

    def direction(self) -> str:
        """Return the direction; LinkError if the ends are not neighbours."""
        way = (self.target[0] - self.source[0], self.target[1] - self.source[1])
        for name, step in DIRECTIONS.items():
            if way == step:
                return name
        raise LinkError(f'link {self} does not join neighbours: links go one place at a time')

    def __str__(self) -> str:
        return f'{self.source} -> {self.target}'


class Ports:
    """
    The latches of one cell in one cycle.

    `ports['left']` is the item that came from the left, None if nothing came, and a LinkError
    if there is no such link; `'left' in ports` is whether the link exists.
    """

    __slots__ = ('_items', '_linked', '_place')

    def __init__(
        self, place: Place, linked: frozenset[str], items: Mapping[str, Any] | None = None
    ) -> None:
        self._place = place
        self._linked = linked
        self._items = items or {}

    def __contains__(self, direction: object) -> bool:
        return direction in self._linked

    def __getitem__(self, direction: str) -> Any:
        if direction not in self._linked:
            raise LinkError(
                f'cell {self._place} reads from {direction!r}, but only has links from '
                f'{sorted(self._linked)}: declare the link, or read another one'
            )
        return self._items.get(direction)

    def get(self, direction: str) -> Any:
        """Return the item that came from a direction; None also where there is no link."""
        return self._items.get(direction)


@dataclass(frozen=True)
class Step:
    """
    The work of a cell in one cycle.

    Attributes
    ----------
    state : object
        State for the next cycle.
    sent : mapping
        Direction to the item that is put into the latch there.
    action : str
        Name of the computation or of storing; empty if the cell only passed items on.

    """

    state: Any
    sent: Mapping[str, Any] = field(default_factory=dict)
    action: str = ''


# A cell's program: its state (None at first) and its latches to its step.
Cell = Callable[[Any, Ports], Step]


class Emission(NamedTuple):
    """An item that left the array: cycle, sending cell and direction."""

    cycle: int
    place: Place
    direction: str
    item: Any


@dataclass(frozen=True)
class Trace:
    """
    Record of a run of an array.

    Attributes
    ----------
    actions : tuple of dict
        actions[t - 1] holds the place and the action of every cell that acted in cycle t.
    emitted : tuple of Emission
        Items that left the array, in order of time.
    states : dict
        State of each cell at the end.

    """

    actions: tuple[dict[Place, str], ...]
    emitted: tuple[Emission, ...]
    states: dict[Place, Any]

    @property
    def cycles(self) -> int:
        """The last cycle in which a cell acted."""
        return max((t + 1 for t, acting in enumerate(self.actions) if acting), default=0)

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
    Cells and the links between them.

    Parameters
    ----------
    cells : mapping
        Place to the cell's program.
    links : iterable of Link
        Joined neighbours, source and target; one end at least is a cell.

    Raises
    ------
    LinkError
        If a link does not join neighbours, or touches no cell.

    """

    def __init__(self, cells: Mapping[Place, Cell], links: Iterable[Link]) -> None:
        self.cells = dict(cells)
        self.links = frozenset(links)  # equal links are one link: there is one latch on it
        linked: dict[Place, set[str]] = {place: set() for place in self.cells}
        for link in self.links:
            came_from = OPPOSITE[link.direction()]
            if link.target in linked:
                linked[link.target].add(came_from)
            elif link.source not in linked:
                raise LinkError(f'link {link} touches no cell of the array')
        self._linked = {place: frozenset(found) for place, found in linked.items()}

    def run(self, streams: Mapping[Link, Mapping[int, Any]], at_most: int = 100_000) -> Trace:
        """
        Run the clock until all latches and streams are empty.

        Parameters
        ----------
        streams : mapping
            For a link from outside, cycle to item; cycles count from 1.
        at_most : int
            Largest number of cycles of a run.

        Raises
        ------
        LinkError
            If a stream or a cell uses a link that is not there.
        ValueError
            If the array is still busy after `at_most` cycles.

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
        latches: dict[Place, dict[str, Any]] = {}
        actions: list[dict[Place, str]] = []
        emitted: list[Emission] = []
        while latches or arriving:
            cycle = len(actions) + 1
            if cycle > at_most:
                raise ValueError(f'the array is still busy after {at_most} cycles')
            for link, item in arriving.pop(cycle, {}).items():
                latches.setdefault(link.target, {})[OPPOSITE[link.direction()]] = item
            steps = {
                place: self.cells[place](states[place], Ports(place, self._linked[place], items))
                for place, items in latches.items()
            }
            latches = {}
            for place, step in steps.items():
                states[place] = step.state
                for direction, item in step.sent.items():
                    target = self._target(place, direction)
                    if target in self.cells:
                        latches.setdefault(target, {})[OPPOSITE[direction]] = item
                    else:
                        emitted.append(Emission(cycle, place, direction, item))
            actions.append({place: step.action for place, step in steps.items() if step.action})
        return Trace(tuple(actions), tuple(emitted), states)

    def _target(self, place: Place, direction: str) -> Place:
        """Return the place in a direction from a cell; LinkError if no link leads there."""
        if direction not in DIRECTIONS:
            raise LinkError(f'cell {place} sends {direction!r}, expected one of {[*DIRECTIONS]}')
        up, right = DIRECTIONS[direction]
        target = (place[0] + up, place[1] + right)
        if Link(place, target) not in self.links:
            raise LinkError(f'cell {place} sends {direction}, but has no link to {target}')
        return target
