# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tasks of a measurement, programs that do them, and the ways in which each is called."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.quantities import STATE, argument_names
from benchmarks.cases.robots import Array

# Seconds of a rollout's step. The cost of a step does not depend on it, and after long times a
# falling chain is too chaotic for two programs' results to be compared.
STEP_SIZE = 1e-5


class LeftOutError(ImportError):
    """A peer cannot be measured here; the message has the reason."""


@dataclass(frozen=True)
class Contents:
    """
    What a time contains.

    Attributes
    ----------
    code : str
        What evaluates one state: language, whether for one robot, and for which processor.
    call : str
        How it is reached from Python, and how often in one run.
    loop : str
        The language of the loop over states or steps; '' for a single state.
    numbers : str
        Number format, and error and range of sine and cosine.

    """

    code: str = ''
    call: str = ''
    loop: str = ''
    numbers: str = 'float64; C library, 1 ulp, any angle'


def installed(name: str, how: str = "pip install '.[peers]'") -> Any:
    """Return a module, or raise LeftOutError with what installs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise LeftOutError(f'{name} cannot be imported ({error}): {how}') from error


@dataclass(frozen=True)
class Work:
    """
    The task of every side: accelerations or another quantity, or positions after a simulation.

    Attributes
    ----------
    kind : {'call', 'rollout', 'batch'}
        One state, the steps of a simulation with constant torques, or many states at once.
    q, qd, tau : ndarray
        Positions [rad or m], velocities and torques, or accelerations for inverse dynamics, (n,),
        or (B, n) for a batch.
    steps : int
        Steps of a rollout of STEP_SIZE seconds, classical Runge-Kutta.

    """

    kind: str
    q: Array
    qd: Array
    tau: Array
    steps: int = 1

    @property
    def units(self) -> int:
        """Evaluations, or steps of a rollout, of one call."""
        return len(self.q) if self.kind == 'batch' else self.steps

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """Positions, velocities, and torques or accelerations."""
        return self.q, self.qd, self.tau

    @property
    def title(self) -> str:
        """Name in a table."""
        return f'batch of {self.units}' if self.kind == 'batch' else self.kind

    def arguments(self, quantity: str) -> tuple[Array, ...]:
        """Return the arguments of a quantity, whose third one is `tau`."""
        return self.arrays[: len(argument_names(quantity))]


def work_of(kind: str, quantity: str, states: Mapping[str, Array]) -> Work:
    """Return the work of a quantity: a batch of all states, or a call of the first."""
    third = 'qdd' if 'qdd' in argument_names(quantity) else 'tau'
    q, qd, last = (states[name] for name in ('q', 'qd', third))
    return Work(kind, q, qd, last) if kind == 'batch' else Work(kind, q[0], qd[0], last[0])


def named(quantity: str, work: Work, laid: Callable[[Array], Array], dtype: str) -> dict[str, Any]:
    """Return the arguments of a kernel by name, copied in an order and number format."""
    given = (laid(x).astype(dtype) for x in work.arguments(quantity))
    return dict(zip(STATE, given, strict=False))


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
        Returns the last result of `run`: accelerations, (n,) or (B, n), the positions after a
        rollout, (n,), or the entries of another quantity, (size,) or (B, size).
    reference : bool
        Whether the times of the other sides are compared with the times of this side.
    wanted : callable, optional
        Returns the result to compare with: of the reference, with all sides, if it is not its
        own; of another side, with this one.
    contents : Contents
        What the time of `run` contains.
    failure : callable, optional
        Returns, after a run, why its result is invalid, or ''.

    """

    way: str
    run: Callable[[], object]
    result: Callable[[], NDArray[np.floating]]
    reference: bool = False
    wanted: Callable[[], Array] | None = None
    contents: Contents = Contents()
    failure: Callable[[], str] | None = None


class Peer:
    """A program made for one robot, and its ways of doing a work, perhaps none."""

    def sides(self, work: Work) -> Iterator[Side]:
        """Return the ways of doing a work."""
        kinds = {'call': self._calls, 'rollout': self._rollouts, 'batch': self._batches}
        return iter(kinds[work.kind](work))

    def side(self, work: Work, way: str = '') -> Side:
        """Return the way of a name, by default the first."""
        return next(side for side in self.sides(work) if way in ('', side.way))

    def _calls(self, work: Work) -> Iterable[Side]:
        return ()

    def _rollouts(self, work: Work) -> Iterable[Side]:
        return ()

    def _batches(self, work: Work) -> Iterable[Side]:
        return ()


def valid_sides(sides: Iterable[Side], reasons: dict[str, str]) -> list[Side]:
    """Run each side once; return those whose results are valid, and add others to `reasons`."""
    found = []
    for side in sides:
        side.run()
        why = '' if side.failure is None else side.failure()
        if why:
            reasons[side.way] = f'failed: {why}'
        else:
            found.append(side)
    return found


def simulation_side(
    way: str,
    work: Work,
    rollout: Callable[[float, Array, Array, Array], Callable[[], object]],
    contents: Contents,
) -> Side:
    """
    Return the side of a simulation in native code.

    rollout(step, q, qd, taus) returns a call that moves q and qd, (n,), in place.
    """
    q, qd = np.empty_like(work.q), np.empty_like(work.qd)
    advance = rollout(STEP_SIZE, q, qd, np.tile(work.tau, (work.steps, 1)))

    def run() -> None:
        q[:], qd[:] = work.q, work.qd
        advance()

    return Side(way, run, lambda: q, contents=contents)


def one_by_one(evaluate: Callable[..., object], rows: Iterable[tuple[Array, ...]]) -> None:
    """Evaluate states in a loop in Python."""
    for row in rows:
        evaluate(*row)
