# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Bounded iteration: a part of a program that is repeated while a number is above another.

The program has the repeated part once, between the markers `loop` and `end`; `state` reads a row
of the state at the start of an iteration, `result` reads it after the last iteration
(pfd_core.machine.operations). What follows a `leave` is not run in the last iteration that is
allowed, and rows of the state that are computed there stay as they were; kernels have no `leave`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count

from pfd_core.machine.recorder import Lanes, Recorder, lanes_of

# At this relative residual an iteration stops, by number format: the recursive residual has fallen
# to rounding. It would continue to fall where the true one has stopped.
TOLERANCE = 1e-15
TOLERANCES = {'float64': TOLERANCE, 'float32': TOLERANCE * 2.0**29}


def iterate(
    step: Callable[..., tuple[tuple[Lanes, ...], Lanes]],
    state: tuple[Lanes, ...],
    go: Lanes,
    at_most: int,
    floor: Lanes | None = None,
) -> tuple[tuple[Lanes, ...], Lanes]:
    """
    Record a part that is repeated while `go` is above `floor`, default zero, on lane 0.

    step(*state) returns the next state and the next `go`, and is recorded once; it is run at most
    `at_most` times. The control unit reads lane 0 of `go` before each iteration. A problem whose
    `go` is at the floor or below, or NaN, is finished and keeps its state while other problems of
    its batch continue.

    Returns
    -------
    state : tuple of Lanes
        State after the last iteration.
    iterations : Lanes
        Number of iterations, on every lane.

    Raises
    ------
    ValueError
        If at_most is below 1, `go` has no value on lane 0, or the next state lacks a lane.

    """
    if at_most < 1:
        raise ValueError(f'at_most must be at least 1, got {at_most}')
    recorder = go.recorder
    floor = recorder.constant(0.0) if floor is None else floor
    first = (*_registers(state), _lane0(go), _lane0(floor))
    loop = recorder.write('loop', first, at_most, recorder.all)
    following, again = step(*_rows_of(recorder, 'state', loop, state))
    for k, (before, after) in enumerate(zip(state, following, strict=True)):
        if before.defined & ~after.defined:
            raise ValueError(f'iterate: row {k} of the next state lacks lanes of the first')
    kept = [
        Lanes(recorder, after.registers, before.defined)
        for before, after in zip(state, following, strict=True)
    ]
    end = recorder.write('end', (loop, *_registers(kept), _lane0(again)), None, recorder.all)
    iterations = recorder.write('result', (end,), -1, recorder.all)
    result = _rows_of(recorder, 'result', end, state)
    return result, Lanes(recorder, (iterations,) * len(go.registers), recorder.all)


def leave_the_last(recorder: Recorder) -> None:
    """Record that the last iteration that is allowed ends here; inside the step of `iterate`."""
    recorder.write('leave', (), None, recorder.all)


def _lane0(go: Lanes) -> int:
    if not go.defined & 1:
        raise ValueError('iterate: `go` has no value on lane 0')
    return go.registers[0]


def _held(row: Lanes) -> tuple[int, ...]:
    """Return the places of the registers that hold a row: one for all lanes, or one for each."""
    return (0,) if row.recorder.parallel else lanes_of(row.defined)


def _registers(rows: Sequence[Lanes]) -> list[int]:
    return [row.registers[place] for row in rows for place in _held(row)]


def _rows_of(recorder: Recorder, op: str, marker: int, like: Sequence[Lanes]) -> tuple[Lanes, ...]:
    """Return the rows of a loop's state, `op` at its marker, on the lanes of the rows `like`."""
    rows, members = [], count()
    for row in like:
        registers = [-1] * len(row.registers)
        active = row.defined if recorder.parallel else 1
        for place in _held(row):
            registers[place] = recorder.write(op, (marker,), next(members), active)
        rows.append(Lanes(recorder, tuple(registers), row.defined))
    return tuple(rows)
