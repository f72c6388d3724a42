# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The shape of a peer: ways in which a program computes a quantity of one robot.

A peer is made for one robot and quantity by a function, which raises LeftOutError where it cannot
be measured. Called with the arguments of the quantity, it yields its ways of computing them. The
arguments are (n,) for a call at one state, or (B, n) for a batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import importlib
from typing import Any, NamedTuple

from numpy.typing import NDArray

from benchmarks.cases.robots import Array
from benchmarks.run import show_progress
from pfd_core.model.plant import Plant, resolve
from pfd_core.model.robot import Robot

SINE = 'float64, sine and cosine of the C library: 1 ulp, any angle'
Arguments = Sequence[Array]


class LeftOutError(ImportError):
    """A peer cannot be measured here; the message has the reason."""


class Side(NamedTuple):
    """
    A way of a peer: its name in a table, its work, and what the time of the work contains.

    `run` does the work once, without arguments. `result` returns the result of the last run,
    (size,) or (B, size), or raises LeftOutError if it is invalid. `contents` names the code of one
    state, call, loop and numbers.
    """

    way: str
    run: Callable[[], object]
    result: Callable[[], NDArray[Any]]
    contents: str = ''


Peer = Callable[[Arguments], Iterator[Side]]


def installed(name: str, how: str = "pip install '.[peers]'") -> Any:
    """Return a module, or raise LeftOutError with what installs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise LeftOutError(f'{name} cannot be imported ({error}): {how}') from error


def plant_of(robot: Robot | Plant) -> Plant:
    """Return a plant as it is, and a robot as the plant of the default scene."""
    return robot if isinstance(robot, Plant) else resolve(robot, None)


def is_batch(given: Arguments) -> bool:
    """Return whether arguments are of many states."""
    return given[0].ndim == 2


def title_of(given: Arguments) -> str:
    """Return 'call', or 'batch of B'."""
    return f'batch of {len(given[0])}' if is_batch(given) else 'call'


def made(
    makers: Mapping[str, Callable[[Robot], Peer]], robot: Robot, reasons: dict[str, str]
) -> dict[str, Peer]:
    """Return the peers of a robot; the reasons of those that are left out go to `reasons`."""
    found = {}
    for name, make in makers.items():
        show_progress(f'{robot.name}: making {name}')
        try:
            found[name] = make(robot)
        except LeftOutError as reason:
            reasons[name] = str(reason)
    return found


def valid_sides(
    peers: Mapping[str, Peer], given: Arguments, reasons: dict[str, str]
) -> list[Side]:
    """Run each way once; return those with a valid result, add the others to `reasons`."""
    found = []
    for name, peer in peers.items():
        try:
            for side in peer(given):
                side.run()
                side.result()
                found.append(side)
        except LeftOutError as reason:
            reasons[f'{name}, {title_of(given)}'] = str(reason)
    return found
