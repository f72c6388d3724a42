# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The one reader of numbers that users give: real numbers and integers, or a ValueError.

    real_array          real numbers as an array of a format and a shape
    real_number         one of them as a float
    number_from_text    one of them from decimal digits
    integer             an integer within bounds
    choice              one of some names
    check_finite        refuses NaN, infinities and numbers above a bound
    fit_shape           an array of a shape, or broadcast to it
    common_shape        the batch shape of several arrays

Every error names the argument, states the expectation and quotes the value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
import numbers
import operator
import re
from typing import Any

import numpy as np
from numpy.ma import MaskedArray
from numpy.typing import ArrayLike, NDArray

from pfd_core.model.error_text import quote

Array = NDArray[Any]
# Lengths of the dimensions; a str names one of any length, and a leading ... means a batch.
Shape = tuple[Any, ...]

# Nothing about a robot is larger, and products of three such numbers are still finite.
LARGEST = 1e100
# The largest integer that native code and the shape of an array take.
LARGEST_INTEGER = 2**63 - 1
DTYPES = ('float64', 'float32')
_NATIVE = {name: np.dtype(name) for name in DTYPES}
# Kinds of NumPy's types whose values are real numbers: integers with and without sign, floats.
_REAL_KINDS = frozenset('iuf')
# Elements of a list that NumPy converts without losing a mask, units or a bool.
_PLAIN = frozenset({float, int, np.float64})
# Python takes less time than NumPy for the joints of one arm.
_FEW = 16
# Decimal digits, as C and XML Schema write numbers: no digits of other scripts, no underscores,
# no hexadecimals, all of which float() or strtod() take.
_NUMBER = re.compile(r'[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')
_INFINITY = re.compile(r'[+-]?\.?inf(?:inity)?', re.IGNORECASE)
# XML's and YAML's blanks; str.split() would take some thirty more.
BLANKS = ' \t\r\n'


def real_array(
    name: str,
    value: ArrayLike,
    dtype: str = 'float64',
    shape: Shape | None = None,
    *,
    broadcast: bool = False,
    finite: bool = True,
    largest: float = math.inf,
    joints: Sequence[str] = (),
) -> Array:
    """
    Return real numbers as an array, without a copy if `value` is such an array.

    Parameters
    ----------
    name : str
        Name of the value, for errors.
    value : array_like
        Integers, floats or fractions of any width.
    dtype : {'float64', 'float32'}
        Number format of the result.
    shape : tuple, optional
        Shape of the result, see `fit_shape`; default: any.
    broadcast : bool
        Whether the numbers are broadcast to the shape.
    finite : bool
        Whether NaN and infinities are refused.
    largest : float
        Largest absolute value, where numbers must be finite.
    joints : sequence of str
        Names of the joints along the last dimension, for errors; default: no joints.

    Raises
    ------
    ValueError
        If an element is complex, a bool, a string, a date, None, masked or has units; if it is
        NaN, infinite, larger than `largest` or than the format; if the shape is another.

    """
    if type(value) is np.ndarray and value.dtype is _NATIVE[dtype]:
        array = value
    else:
        wanted = 'a number' if shape == () else 'an array of numbers'
        array = _converted(name, value, dtype, wanted)
    if finite:
        check_finite(name, array, largest, joints)
    return array if shape is None else fit_shape(name, array, shape, broadcast)


def real_number(name: str, value: Any, *, finite: bool = True, largest: float = math.inf) -> float:
    """Return one real number, a scalar of Python or NumPy, as a float; as `real_array`."""
    if type(value) is float and abs(value) < largest:
        return value
    return float(real_array(name, value, shape=(), finite=finite, largest=largest))


def number_from_text(name: str, text: str, *, infinite: bool = False) -> float:
    """
    Return the number in a string.

    Parameters
    ----------
    name : str
        Name of the number, for errors.
    text : str
        Decimal digits with a sign, a point and an exponent, and blanks around them.
    infinite : bool
        Whether "inf", signed or not, is a number too, and numbers above LARGEST.

    Raises
    ------
    ValueError
        If it is anything else, too large, or so small that a double is 0.

    """
    stripped = text.strip(BLANKS)
    if infinite and _INFINITY.fullmatch(stripped):
        return -math.inf if stripped.startswith('-') else math.inf
    if not _NUMBER.fullmatch(stripped):
        raise ValueError(f'{name} must be a number, got {quote(text)}')
    value = float(stripped)
    if value == 0 and re.search('[1-9]', re.split('[eE]', stripped)[0]):
        raise ValueError(f'{name} is too small for double precision, got {quote(text)}')
    return real_number(name, value, largest=math.inf if infinite else LARGEST)


def integer(name: str, value: object, least: int, most: float = LARGEST_INTEGER) -> int:
    """Return an integer, NumPy's too; ValueError for anything else, a bool or out of bounds."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        found = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        found = least - 1
    if found < least or found > most:
        bounds = f'from {least} to {most}' if found > most else f'of at least {least}'
        raise ValueError(f'{name} must be an integer {bounds}, got {quote(value)}')
    return found


def choice(name: str, value: object, choices: Iterable[str]) -> str:
    """Return one of some names; ValueError for any other value, also one of another type."""
    names = tuple(choices)
    if not isinstance(value, str) or value not in names:
        raise ValueError(f'{name} must be one of {names}, got {quote(value)}')
    return value


def check_finite(
    name: str, array: Array, largest: float = math.inf, joints: Sequence[str] = ()
) -> None:
    """Raise ValueError for a number not finite or above `largest`; names index and joint."""
    bounded = largest < math.inf
    few = array.size <= _FEW and not bounded
    # The terms of a finite sum are finite.
    if few and math.isfinite(sum(array.ravel().tolist())):
        return
    right = np.abs(array) <= largest if bounded else np.isfinite(array)
    if right.all():
        return
    rule = f'finite and at most {largest:g} in size' if bounded else 'finite'
    if array.ndim == 0:
        raise ValueError(f'{name} must be {rule}, got {array}')
    first, *others = np.argwhere(~right).tolist()
    named = len(joints) == array.shape[-1]
    joint = f', joint {quote(joints[first[-1]])}' if named else ''
    raise ValueError(
        f'{name} must be {rule}, got {array[tuple(first)]} at index {first}{joint} '
        f'({1 + len(others)} of {array.size} elements)'
    )


def fit_shape(name: str, array: Array, shape: Shape, broadcast: bool = False) -> Array:
    """
    Return an array of a shape, broadcast to it on demand; ValueError for another shape.

    In the shape, a str names a dimension of any length, and a leading ... means any number
    of dimensions; not so in a shape to broadcast to.
    """
    if array.shape == shape:
        return array
    wanted = [shape]
    if broadcast:
        try:
            return np.broadcast_to(array, shape)
        except ValueError:
            wanted = [shape[k:] for k in range(len(shape))]
    elif shape[:1] == (...,):
        if array.shape[1 - len(shape) :] == shape[1:]:
            return array
        wanted = [shape[1:], ('B', *shape[1:])]
    elif array.ndim == len(shape):
        pairs = zip(array.shape, shape, strict=True)
        if all(isinstance(length, str) or found == length for found, length in pairs):
            return array
    if shape == ():
        raise ValueError(f'{name} must be a number, got an array of shape {array.shape}')
    text = ' or '.join(map(str, wanted)).replace("'", '')
    raise ValueError(f'{name} must have shape {text}, got {array.shape}')


def common_shape(arrays: Mapping[str, NDArray[Any]]) -> tuple[int, ...]:
    """Return the batch shape that arrays are broadcast to; ValueError if there is none."""
    own = {value.shape[:-1] for value in arrays.values()}
    if len(own) == 1:
        return own.pop()
    try:
        return np.broadcast_shapes(*own)
    except ValueError as error:
        shapes = ', '.join(f'{name} {value.shape}' for name, value in arrays.items())
        raise ValueError(f'the arguments must agree in their batch, got {shapes}') from error


def _converted(name: str, value: ArrayLike, dtype: str, wanted: str) -> Array:
    """Return real numbers as an array of a format; ValueError for anything else."""
    try:
        lost = _lost_by_conversion(value)
        array = np.zeros(()) if lost else np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged rows, endless lists
        raise ValueError(f'{name} must be {wanted}, got {quote(value)}: {error}') from error
    kind = array.dtype.kind
    if kind not in _REAL_KINDS and not (kind == 'O' and all(map(_is_real, array.ravel()))):
        lost = quote(value) if array.ndim == 0 or kind == 'O' else str(array.dtype)
    if lost:
        raise ValueError(f'{name} must be {wanted}, got {lost}')
    if array.dtype is _NATIVE[dtype]:
        return array
    try:
        with np.errstate(over='raise'):
            return array.astype(dtype)
    except (OverflowError, FloatingPointError) as error:
        raise ValueError(f'{name} must fit {dtype}, got {quote(value)}') from error


def _lost_by_conversion(value: object) -> str:
    """Return the mask, units or bool that NumPy would silently convert to numbers, or ''."""
    if isinstance(value, (list, tuple)):
        if _PLAIN.issuperset(map(type, value)):
            return ''
        return next(filter(None, map(_lost_by_conversion, value)), '')
    if isinstance(value, MaskedArray):
        return 'a masked array: fill its gaps'
    if isinstance(value, (bool, np.bool_)):
        return f'bool {value}'
    unit = getattr(value, 'unit', getattr(value, 'units', None))
    return '' if unit is None else f'units ({quote(unit)}): give its plain numbers in SI units'


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, (bool, np.timedelta64))
