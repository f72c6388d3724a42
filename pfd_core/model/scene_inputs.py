# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The inputs that a scene adds to positions, velocities and torques at run time, checked."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.ma import MaskedArray
from numpy.typing import ArrayLike, NDArray

from pfd_core.model.scene import Scene
from pfd_core.model.values import fit_shape, quote, real_array


def scene_inputs(
    scene: Scene,
    n: int,
    dtype: str,
    wrench: ArrayLike | None,
    brakes: ArrayLike | None,
    batch: tuple[int, ...] | None = None,
) -> dict[str, NDArray[Any]]:
    """
    Return the inputs that a scene adds to positions, velocities and torques, checked.

    Parameters
    ----------
    scene : Scene
        Which effects are on.
    n : int
        Number of joints.
    dtype : {'float64', 'float32'}
        Number format of the result.
    wrench : array_like or None
        Force [N] and moment [N m] on the last link, (..., 6); exactly if the scene has one.
    brakes : array_like of bool or None
        True for braked joints, (..., n); only if the scene has brakes. None means no joint.
    batch : tuple of int, optional
        Leading dimensions to which the inputs are broadcast; default: as given.

    Returns
    -------
    dict
        `wrench`, (..., 6), and `free`, (..., n), 1 for joints that move and 0 for braked ones;
        each only if the scene has it.

    Raises
    ------
    ValueError
        If an input is given that the scene lacks, the wrench is missing, or one has another shape
        or type.

    """
    inputs = {}
    if scene.external_wrench:
        if wrench is None:
            raise ValueError('the scene has external_wrench=True, so the call needs wrench=')
        inputs['wrench'] = _in_batch('wrench', real_array('wrench', wrench, dtype), 6, batch)
    elif wrench is not None:
        raise ValueError(
            'wrench was given, but the scene has external_wrench=False: '
            'use Scene(external_wrench=True)'
        )
    if scene.brakes:
        if brakes is None:
            inputs['free'] = _all_free((*(batch or ()), n), dtype)
        else:
            braked = _in_batch('brakes', _braked(brakes), n, batch)
            inputs['free'] = (~braked).astype(dtype)
    elif brakes is not None:
        raise ValueError('brakes were given, but the scene has none: use Scene(brakes=True)')
    return inputs


def _in_batch(
    name: str, array: NDArray[Any], size: int, batch: tuple[int, ...] | None
) -> NDArray[Any]:
    """Return an array with the leading dimensions `batch`, or as given without any."""
    if batch is not None and array.shape == (*batch, size):
        return array
    if batch is None or array.shape[-1:] != (size,):
        return fit_shape(name, array, (..., size))
    return fit_shape(name, array, (*batch, size), broadcast=True)


@lru_cache(maxsize=16)
def _all_free(shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """Return the input of joints that all move; read-only."""
    free = np.ones(shape, dtype)
    free.flags.writeable = False
    return free


def _braked(value: ArrayLike) -> NDArray[np.bool_]:
    """Return an array of bool; ValueError for numbers, as 1 could mean a joint that moves."""
    try:
        array = np.asarray(None if isinstance(value, MaskedArray) else value)
    except (TypeError, ValueError, RuntimeError):
        array = np.asarray(None)
    if array.dtype != bool:
        raise ValueError(f'brakes must be an array of bool, True for braked, got {quote(value)}')
    return array
