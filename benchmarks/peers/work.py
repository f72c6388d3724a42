# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tasks of a measurement, and the ways in which programs do them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
import importlib
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.quantities import QUANTITIES
from benchmarks.cases.robots import Array
from pfd_core.model import Plant, Robot, resolve

# Seconds of a rollout's step. The cost of a step does not depend on it, and after long times a
# falling chain is too chaotic for two programs' results to be compared.
STEP_SIZE = 1e-5
SINE = 'float64, sine and cosine of the C library: 1 ulp, any angle'


class LeftOutError(ImportError):
    """A peer cannot be measured here; the message has the reason."""


def installed(name: str, how: str = "pip install '.[peers]'") -> Any:
    """Return a module, or raise LeftOutError with what installs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise LeftOutError(f'{name} cannot be imported ({error}): {how}') from error


def plant_of(robot: Robot | Plant) -> Plant:
    """Return a plant as it is, and a robot as the plant of the default scene."""
    return robot if isinstance(robot, Plant) else resolve(robot, None)


@dataclass(frozen=True)
class Work:
    """
    The task of every side: a quantity of states, or positions after a simulation.

    Attributes
    ----------
    kind : {'call', 'rollout', 'batch'}
        One state, the steps of a simulation with constant torques, or many states at once.
    arrays : tuple of ndarray
        Arguments of the quantity, (n,), or (B, n) for a batch. Of forward dynamics and a rollout:
        positions [rad or m], velocities and torques.
    steps : int
        Steps of a rollout of STEP_SIZE seconds, classical Runge-Kutta.

    """

    kind: str
    arrays: tuple[Array, ...]
    steps: int = 1

    @property
    def units(self) -> int:
        """Evaluations, or steps of a rollout, of one run."""
        return len(self.arrays[0]) if self.kind == 'batch' else self.steps

    @property
    def title(self) -> str:
        """Name in a table."""
        return f'batch of {self.units}' if self.kind == 'batch' else self.kind


def work_of(quantity: str, states: Mapping[str, Array], kind: str, size: int = 1) -> Work:
    """Return a quantity of the first `size` states: a batch, or one state with as many steps."""
    given = [states[name] for name in QUANTITIES[quantity]]
    if kind == 'batch':
        return Work(kind, tuple(x[:size] for x in given))
    return Work(kind, tuple(x[0] for x in given), size)


@dataclass(frozen=True)
class Side:
    """
    One way of doing a work.

    Attributes
    ----------
    way : str
        Name in a table.
    run : callable
        Does the work once, without arguments.
    result : callable
        Returns the result of the last run: entries of a quantity, (size,) or (B, size), or the
        positions after a rollout, (n,). LeftOutError if it is invalid.
    contents : str
        What the time of `run` contains: code of one state, call, loop, numbers.
    reference : bool
        Whether the times of the other sides are compared with the times of this side.

    """

    way: str
    run: Callable[[], object]
    result: Callable[[], NDArray[Any]]
    contents: str = ''
    reference: bool = False


class Peer(Protocol):
    """A program made for one robot and quantity."""

    def sides(self, work: Work) -> Iterator[Side]:
        """Yield its ways of doing a work, perhaps none."""


def valid_sides(peers: Iterable[Peer], work: Work, reasons: dict[str, str]) -> list[Side]:
    """Run each way of a work once; return those with a valid result, add others to `reasons`."""
    found = []
    for peer in peers:
        try:
            for side in peer.sides(work):
                side.run()
                side.result()
                found.append(side)
        except LeftOutError as reason:
            reasons[f'{type(peer).__name__}, {work.title}'] = str(reason)
    return found


def simulation_side(
    way: str,
    work: Work,
    rollout: Callable[[float, Array, Array, Array], Callable[[], object]],
    contents: str,
) -> Side:
    """
    Return the side of a simulation in native code.

    rollout(step, q, qd, taus) returns a call that moves q and qd, (n,), in place.
    """
    start, velocity, tau = work.arrays
    q, qd = np.empty_like(start), np.empty_like(velocity)
    advance = rollout(STEP_SIZE, q, qd, np.tile(tau, (work.steps, 1)))

    def run() -> None:
        q[:], qd[:] = start, velocity
        advance()

    return Side(way, run, lambda: q, contents)
