# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is given from outside as arrays of numbers, and what is said of that which cannot be."""

from __future__ import annotations

import numbers
import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.model.values import shown

_NATIVE = {name: np.dtype(name) for name in ('float64', 'float32')}
# Kinds of NumPy's types whose values are real numbers: integers with and without sign, floats.
_REAL = frozenset('iuf')
# Elements of a list that carry neither a mask nor units.
_PLAIN = frozenset({float, int, list, tuple, np.float64, np.ndarray})
NO_BRAKES = 'brakes were given, but the scene has none: use Scene(brakes=True)'


def integer(name: str, value: object, least: int) -> int:
    """Return an integer, NumPy's too; ValueError if it is none, a bool or below `least`."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        found = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        found = least - 1
    if found < least:
        raise ValueError(f'{name} must be an integer of at least {least}, got {shown(value)}')
    return found


def real_numbers(name: str, value: ArrayLike, dtype: str) -> NDArray[Any]:
    """
    Return real numbers as an array of a format, which may be the one that was given.

    ValueError names whatever else it is: complex, bool, text, dates, masks and units are not
    turned into numbers.
    """
    if type(value) is np.ndarray and value.dtype is _NATIVE[dtype]:
        return value
    array = _real_array(name, value)
    if array.dtype is _NATIVE[dtype]:
        return array
    try:
        with np.errstate(over='raise'):
            return array.astype(dtype)
    except (OverflowError, FloatingPointError) as error:
        raise ValueError(f'{name} must fit {dtype}, got {shown(value)}') from error


def _real_array(name: str, value: ArrayLike) -> NDArray[Any]:
    """Return real numbers as an array of whatever format they have."""
    if not isinstance(value, (list, tuple)):
        _refuse_what_means_more(name, value)
    elif not _PLAIN.issuperset(map(type, value)):
        for part in value:
            _refuse_what_means_more(name, part)
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(
            f'{name} must be an array of numbers, got {shown(value)}: {error}'
        ) from error
    if array.dtype.kind in _REAL:
        return array
    if array.dtype == object and all(_is_real(x) for x in array.flat):
        return array
    found = shown(value) if array.ndim == 0 or array.dtype == object else str(array.dtype)
    raise ValueError(f'{name} must be an array of numbers, got {found}')


def _refuse_what_means_more(name: str, value: object) -> None:
    """Raise ValueError for arrays that NumPy would silently strip of a mask or of units."""
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f'{name} must be an array of numbers, got a masked array: fill its gaps')
    unit = getattr(value, 'unit', getattr(value, 'units', None))
    if unit is not None:
        raise ValueError(
            f'{name} must be an array of numbers, got units ({shown(unit)}): '
            'give its plain numbers in SI units'
        )


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def held_mask(brakes: ArrayLike | None, size: int, dtype: str) -> NDArray[Any]:
    """
    Return 1 for joints that move and 0 for held ones, (..., size), of which None holds none.

    Only bool is taken, True for held: numbers would be read as easily the other way round.
    """
    if brakes is None:
        return np.ones(size, dtype)
    masked = isinstance(brakes, np.ma.MaskedArray)
    try:
        held = np.asarray(None if masked else brakes)
    except (TypeError, ValueError, RuntimeError):
        held = np.asarray(None)
    if held.dtype != bool:
        raise ValueError(f'brakes must be an array of bool, True for held, got {shown(brakes)}')
    if held.ndim == 0 or held.shape[-1] != size:
        raise ValueError(f'brakes must have shape ({size},) or (B, {size}), got {held.shape}')
    return (~held).astype(dtype)
