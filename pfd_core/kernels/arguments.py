# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Arguments of a kernel: checked and converted, broadcast to one batch, as rows of states.

Arrays that need nothing of that are checked in native code (codegen.python_entry).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.forking import no_fork
from pfd_core.model import Payload, Robot, Scene, scene_inputs
from pfd_core.model.effects import INPUT
from pfd_core.model.values import real_array

# Inputs that a scene needs, by name in a call and in a program.
SCENE_INPUTS = ('wrench', 'free', 'payload')


def state_arguments(names: Sequence[str]) -> tuple[str, ...]:
    """Return the inputs of a kernel that a call takes by position: q, qd and a third one."""
    return tuple(name for name in names if name not in SCENE_INPUTS)


def checked(
    robot: Robot,
    scene: Scene,
    dtype: str,
    sizes: Mapping[str, int],
    state: Sequence[ArrayLike | None],
    wrench: ArrayLike | None,
    brakes: ArrayLike | None,
    payload: Payload | None,
) -> dict[str, NDArray[Any]]:
    """
    Return the inputs of a kernel as arrays, in its order; they may not be finite yet.

    Parameters
    ----------
    robot, scene, dtype
        As of the kernel.
    sizes : dict
        Elements of each input.
    state : sequence of array_like or None
        q, qd and the third argument of the call.
    wrench, brakes, payload
        As given to the call.

    Raises
    ------
    ValueError
        If an argument is missing, is not one of the kernel's, or has the wrong shape or type.

    """
    own = state_arguments(tuple(sizes))
    given = {name: value for name, value in zip(own, state, strict=False) if value is not None}
    count = sum(value is not None for value in state)
    if len(given) != len(own) or count != len(own):
        labels = [*own, *('q', 'qd', 'tau')[len(own) :]]
        got = ', '.join(
            name for name, value in zip(labels, state, strict=True) if value is not None
        )
        raise ValueError(f'the kernel takes {", ".join(own)}, got {got or "none of them"}')
    given |= scene_inputs(scene, robot.n, dtype, wrench, brakes)
    if payload is not None or scene.payload == INPUT:
        with no_fork:
            from pfd_core.dynamics.payload import payload_inputs

        given |= payload_inputs(robot, scene, dtype, payload)
    return {
        name: real_array(name, given[name], dtype, (..., size), finite=False)
        for name, size in sizes.items()
    }


def as_rows(value: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an input broadcast to a batch shape, with one row for each state."""
    if len(shape) == 1 and value.ndim == 2 and value.shape[:1] == shape:
        return value
    whole = np.broadcast_to(value, (*shape, value.shape[-1]))
    return whole.reshape(-1, value.shape[-1])


def new_result(
    batch: tuple[int, ...], shape: tuple[int, ...], dtype: str, like: NDArray[Any]
) -> NDArray[Any]:
    """
    Return an empty array, (*batch, *shape): each element of a batch in a column where `like` is.

    That is the layout in which native code reads and writes neighbouring states at once.
    """
    if len(batch) != 1 or not (like.ndim == 2 and like.flags.fnc):
        return np.empty((*batch, *shape), dtype)
    return np.empty((*batch, math.prod(shape)), dtype, 'F').reshape(*batch, *shape)


def check_result(out: Any, shape: tuple[int, ...], dtype: str) -> None:
    """Raise ValueError unless `out` is an array that a result can be written to."""
    array = isinstance(out, np.ndarray)
    found = f'{out.dtype} {out.shape}' if array else type(out).__name__
    if found != f'{dtype} {shape}':
        raise ValueError(f'out must be an array of {dtype} {shape}, got {found}')
    if not out.flags.writeable:
        raise ValueError('out must be writeable, got a read-only array')


def rows_in_place(out: NDArray[Any], size: int) -> NDArray[Any] | None:
    """Return a result as rows of `size` elements in the same memory; None if that cannot be."""
    rows = out.reshape(-1, size)
    return rows if np.may_share_memory(rows, out) else None
