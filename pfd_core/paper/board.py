# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Elements by name on lanes: work of which each step takes up to n elements, wherever they lie.

A Board remembers the lane and the value of each element of a matrix, a set of products, a list of
sums. A step names the elements that each lane needs, computes, and stores the results under their
names. An element on its own lane is read without a route; others are gathered
(pfd_core.paper.lanes.gather).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

from pfd_core.machine.recorder import Lanes
from pfd_core.paper.lanes import gather

Name = Hashable
Place = tuple[Lanes, int]  # a value, and the lane of the element


class Board:
    """
    The places of elements.

    Attributes
    ----------
    at : dict
        Name to (value, lane).

    """

    def __init__(self) -> None:
        self.at: dict[Name, Place] = {}

    def put(self, value: Lanes, names: Mapping[int, Name]) -> None:
        """Store the elements of a value under names, by lane."""
        self.at.update((name, (value, lane)) for lane, name in names.items())

    def row(self, names: Mapping[int, Name]) -> Lanes:
        """Return the named element on each lane."""
        return gather({lane: self.at[name] for lane, name in names.items()})

    def lane(self, name: Name) -> int:
        """Return the lane of an element."""
        return self.at[name][1]


def assigned(wishes: Sequence[Sequence[int]], n: int) -> list[int]:
    """Return one of n lanes for each item: its first wish if that is free, its next, or any."""
    chosen: dict[int, int] = {}
    free = dict.fromkeys(range(n))
    for wanted in (*zip(*wishes, strict=True), None):
        for item in range(len(wishes)):
            if item not in chosen:
                lane = next(iter(free)) if wanted is None else wanted[item]
                if lane in free:
                    chosen[item] = lane
                    del free[lane]
    return [chosen[item] for item in range(len(wishes))]
