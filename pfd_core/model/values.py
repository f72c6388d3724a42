# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers and names from outside: read strictly, and cut where an error shows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
import re
import reprlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.geometry import Array

# So many names an error lists before it says how many more there are.
LISTED = 12
# Nothing about a robot is larger, and products of three such numbers are still finite.
LARGEST = 1e100
FINITE = f'finite and at most {LARGEST:g} in size'
# Decimal digits, as C and XML Schema write numbers: no digits of other scripts, no underscores,
# no hexadecimals, all of which float() or strtod() take.
_NUMBER = re.compile(r'[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')
_INFINITY = re.compile(r'[+-]?\.?inf(?:inity)?', re.IGNORECASE)
# XML's and YAML's blanks; str.split() would take some thirty more.
BLANKS = ' \t\r\n'
# repr() of a longer integer takes long, and beyond 4300 digits Python refuses it.
_PRINTED_BITS = 256


class _Shown(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        return (
            repr(x) if x.bit_length() <= _PRINTED_BITS else f'an integer of {x.bit_length()} bits'
        )


_SHOWN = _Shown()
_SHOWN.maxstring = _SHOWN.maxother = 100
_SHOWN.maxlevel = 3
_SHOWN.maxdict = _SHOWN.maxlist = _SHOWN.maxtuple = 6


def shown(value: object) -> str:
    """Return a foreign value as an error shows it: on one line, and not too long."""
    if isinstance(value, str):
        # Cut in front: repr() of a name of a megabyte is not needed to show its ends.
        keep = _SHOWN.maxstring
        value = value if len(value) <= keep else f'{value[:keep]}{value[-keep:]}'
    return ' '.join(_SHOWN.repr(value).split('\n'))


def listed(names: Iterable[object]) -> str:
    """Return the first names of many, and how many more there are."""
    items = list(names)
    more = f' and {len(items) - LISTED} more' if len(items) > LISTED else ''
    return ', '.join(shown(name) for name in items[:LISTED]) + more


def number_from_text(label: str, text: str, *, infinite: bool = False) -> float:
    """
    Return the number that a text is.

    Parameters
    ----------
    label : str
        What the number is, for errors.
    text : str
        Decimal digits with a sign, a point and an exponent, and blanks around them.
    infinite : bool
        Whether "inf", signed or not, is a number too.

    Raises
    ------
    ValueError
        If it is anything else, too large, or so small that a double is 0.

    """
    stripped = text.strip(BLANKS)
    if infinite and _INFINITY.fullmatch(stripped):
        return -math.inf if stripped.startswith('-') else math.inf
    if not _NUMBER.fullmatch(stripped):
        raise ValueError(f'{label} must be a number, got {shown(text)}')
    value = float(stripped)
    if value == 0 and re.search('[1-9]', re.split('[eE]', stripped)[0]):
        raise ValueError(f'{label} is too small for double precision, got {shown(text)}')
    return number(label, value, infinite=infinite and not math.isinf(value))


def number(label: str, value: object, *, infinite: bool = False) -> float:
    """
    Return a real number as a float.

    Python's and NumPy's integers and floats are real numbers, and so are arrays of one of them
    without a dimension; truth values, complex numbers and texts are not.

    Raises
    ------
    ValueError
        If it is no real number, NaN, infinite where that is not allowed, or too large for a
        double.

    """
    if not _is_real(value):
        raise ValueError(f'{label} must be a number, got {shown(value)}')
    result = _as_float(value)
    if math.isnan(result) or not (infinite or abs(result) <= LARGEST):
        raise ValueError(f'{label} must be {FINITE}, got {shown(value)}')
    return result


def numbers(label: str, value: Any, shape: tuple[int, ...]) -> Array:
    """
    Return a value as a new array of finite real numbers of a shape.

    Raises
    ------
    ValueError
        If an element is no real number (see `number`) or not finite, or the shape is another.

    """
    array = reals(label, value)
    if array.shape != shape:
        raise ValueError(f'{label} must have shape {shape}, got {array.shape}')
    if not (np.abs(array) <= LARGEST).all():
        raise ValueError(f'{label} must be {FINITE}, got {shown(array.tolist())}')
    return array


def reals(label: str, value: Any) -> Array:
    """
    Return a value as a new array of real numbers, of any shape, infinite ones and NaN allowed.

    Raises
    ------
    ValueError
        If an element is no real number (see `number`).

    """
    if np.ma.isMaskedArray(value):
        raise ValueError(f'{label} must not be a masked array: fill it first')
    try:
        # As objects, the elements of a list keep their types: True would become 1.0.
        array = value if isinstance(value, np.ndarray) else np.asarray(value, dtype=object)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f'{label} must be numbers, got {shown(value)}') from error
    if array.dtype.kind in 'iuf':
        with np.errstate(over='ignore'):  # a long double
            return array.astype(np.float64) + 0.0
    items = array.ravel()  # flat has an end at 32 dimensions
    if array.dtype.kind != 'O' or not all(map(_is_real, items)):
        raise ValueError(f'{label} must be numbers, got {shown(value)}')
    return (
        np.array([_as_float(item) for item in items], dtype=np.float64).reshape(array.shape) + 0.0
    )


def frozen(values: ArrayLike) -> Array:
    """Return a copy of numbers that cannot be written to, without a negative zero."""
    # Adding 0.0 copies, and turns -0.0 into 0.0: equal robots have equal bits.
    copy: Array = np.asarray(values, dtype=np.float64) + 0.0
    copy.setflags(write=False)
    return copy


class Frozen:
    """Keeps the arrays of a frozen dataclass frozen through pickle and copies."""

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the fields over; pickled and copied arrays come writable."""
        for key, value in state.items():
            kept = frozen(value) if isinstance(value, np.ndarray) else value
            object.__setattr__(self, key, kept)


def _is_real(value: object) -> bool:
    if isinstance(value, np.ndarray) and value.ndim == 0 and not np.ma.isMaskedArray(value):
        value = value[()]
    real = (int, float, np.integer, np.floating)
    return isinstance(value, real) and not isinstance(value, (bool, np.timedelta64))


def _as_float(value: Any) -> float:
    """Return a real number as a float, infinite if it is too large for one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
