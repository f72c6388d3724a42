# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Values that users give, checked: numbers, integers, names; and arrays that stay as they are.

Every error names the argument, states what is expected and quotes the value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import hashlib
import math
import numbers
import operator
import re
import reprlib
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
# Lengths of the dimensions; a str names one of any length, and a leading ... means a batch.
Shape = tuple[Any, ...]

# Nothing about a robot is larger, and products of three such numbers are still finite.
LARGEST = 1e100
# The largest integer that native code and the shape of an array take.
LARGEST_INTEGER = 2**63 - 1
DTYPES = ('float64', 'float32')
_NATIVE = {name: np.dtype(name) for name in DTYPES}
# Elements of a list that NumPy converts without losing a mask, units or a bool.
_PLAIN = frozenset({float, int, np.float64})
# Python takes less time than NumPy for the joints of one arm, in some steps.
_FEW = 100
# Decimal digits, as C and XML Schema write numbers: no digits of other scripts, no underscores,
# no hexadecimals, all of which float() or strtod() take.
_NUMBER = re.compile(r'[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')
_INFINITY = re.compile(r'[+-]?\.?inf(?:inity)?', re.IGNORECASE)
# XML's and YAML's blanks; str.split() would take some thirty more.
BLANKS = ' \t\r\n'

# An error lists this many names before it says how many more there are.
MOST_NAMES = 12
# repr() of a longer integer takes long, and beyond 4300 digits Python refuses it.
_PRINTED_BITS = 256


class _Repr(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        long = x.bit_length() > _PRINTED_BITS
        return f'an integer of {x.bit_length()} bits' if long else repr(x)


_REPR = _Repr()
_REPR.maxstring = _REPR.maxother = 100
_REPR.maxlevel = 3
_REPR.maxdict = _REPR.maxlist = _REPR.maxtuple = 6


def quote(value: object) -> str:
    """Return the repr of a value on one line, cut to a few hundred characters."""
    if isinstance(value, str) and len(value) > _REPR.maxstring:
        # Cut first: repr() of a name of a megabyte is not needed to show its ends.
        value = value[: _REPR.maxstring] + value[-_REPR.maxstring :]
    return ' '.join(_REPR.repr(value).split('\n'))


def quote_all(names: Iterable[object]) -> str:
    """Return the first MOST_NAMES names, separated by commas, and the number of the others."""
    return listed([*map(quote, names)])


def listed(texts: Sequence[str], most: int = MOST_NAMES, comma: str = ', ') -> str:
    """Return the first of some texts, and the number of the others."""
    more = f' and {len(texts) - most} more' if len(texts) > most else ''
    return comma.join(texts[:most]) + more


def unused(name: str, taken: set[str]) -> str:
    """Return a name that is not taken yet, and take it."""
    while name in taken:
        name += '_'
    taken.add(name)
    return name


def real_array(
    name: str,
    value: ArrayLike,
    dtype: str = 'float64',
    shape: Shape | None = None,
    *,
    broadcast: bool = False,
    finite: bool = True,
    infinite: bool = False,
    largest: float = math.inf,
    joints: Sequence[str] = (),
) -> Array:
    """
    Return real numbers as an array of a format, without a copy if `value` is such an array.

    `shape` is one that they have, or to which they are `broadcast`, see `fit_shape`; default: any.
    ValueError if an element is complex, a bool, a string, a date, None, masked or has units, if it
    is too large for the format, or, where `finite`, NaN, infinite (unless `infinite`) or larger
    than `largest`; such an error names one of the `joints` along the last dimension.
    """
    if type(value) is np.ndarray and value.dtype is _NATIVE[dtype]:
        array = value
    else:
        array = _converted(name, value, dtype, shape == ())
    if finite:
        check_finite(name, array, largest, joints, infinite=infinite)
    return array if shape is None else fit_shape(name, array, shape, broadcast)


def real_number(name: str, value: Any, *, finite: bool = True, largest: float = math.inf) -> float:
    """Return one real number, a scalar of Python or NumPy, as a float; as `real_array`."""
    if type(value) is float and abs(value) < largest:
        return value
    return float(real_array(name, value, shape=(), finite=finite, largest=largest))


def number_from_text(name: str, text: str, *, infinite: bool = False) -> float:
    """
    Return the number in a string of decimal digits with a sign, a point and an exponent.

    ValueError for anything else, for a number above LARGEST and for one so small that a double
    is 0. If `infinite`, "inf", signed or not, and numbers above LARGEST are taken as well.
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


def switch(name: str, value: Any) -> bool:
    """Return True or False, NumPy's too; ValueError for anything else."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f'{name} must be True or False, got {quote(value)}')
    return bool(value)


def choice(name: str, value: object, choices: Iterable[str]) -> str:
    """Return one of some names; ValueError for any other value, also one of another type."""
    names = tuple(choices)
    if not isinstance(value, str) or value not in names:
        raise ValueError(f'{name} must be one of {names}, got {quote(value)}')
    return value


def check_finite(
    name: str,
    array: Array,
    largest: float = math.inf,
    joints: Sequence[str] = (),
    *,
    infinite: bool = False,
) -> None:
    """Raise ValueError for NaN, infinity or a size above `largest`; names index and joint."""
    bounded = largest < math.inf
    # The terms of a finite sum are finite.
    if array.size <= _FEW and not bounded and math.isfinite(sum(array.ravel().tolist())):
        return
    right = np.abs(array) <= largest if bounded else np.isfinite(array)
    if infinite:
        right |= np.isinf(array)
    if right.all():
        return
    rule = f'finite and at most {largest:g} in size' if bounded else 'finite'
    if infinite:
        rule = f'at most {largest:g} in size, or infinite'
    wrong, place = np.argwhere(~right).tolist(), ''
    if array.ndim:
        named = len(joints) == array.shape[-1]
        joint = f', joint {quote(joints[wrong[0][-1]])}' if named else ''
        place = f' at index {wrong[0]}{joint} ({len(wrong)} of {array.size} elements)'
    raise ValueError(f'{name} must be {rule}, got {array[tuple(wrong[0])]}{place}')


def check_least(name: str, array: Array, least: float = 0.0, *, above: bool = False) -> None:
    """Raise ValueError for a number below the least one, or, if `above`, equal to it."""
    if (array <= least if above else array < least).any():
        rule = f'be above {least:g}' if above else 'not be negative'
        raise ValueError(f'{name} must {rule}, got {quote(array.tolist())}')


def fit_shape(name: str, array: Array, shape: Shape, broadcast: bool = False) -> Array:
    """
    Return an array of a shape, or broadcast to it; ValueError for another shape.

    A str names a dimension of any length, a leading ... a batch; not so if it is broadcast.
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


def common_shape(arrays: Mapping[str, Array]) -> tuple[int, ...]:
    """Return the batch shape to which arrays are broadcast; ValueError if there is none."""
    own = {value.shape[:-1] for value in arrays.values()}
    if len(own) == 1:
        return own.pop()
    try:
        return np.broadcast_shapes(*own)
    except ValueError as error:
        shapes = ', '.join(f'{name} {value.shape}' for name, value in arrays.items())
        raise ValueError(f'the arguments must agree in their batch, got {shapes}') from error


def _converted(name: str, value: ArrayLike, dtype: str, scalar: bool) -> Array:
    """Return real numbers as an array of a format; ValueError for anything else."""
    wanted = 'a number' if scalar else 'an array of numbers'
    try:
        lost = _lost_by_conversion(value)
        array = np.zeros(()) if lost else np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged rows, endless lists
        raise ValueError(f'{name} must be {wanted}, got {quote(value)}: {error}') from error
    kind = array.dtype.kind
    if kind not in 'iuf' and not (kind == 'O' and all(map(_is_real, array.ravel()))):
        lost = quote(value) if array.ndim == 0 or kind == 'O' else str(array.dtype)
    if lost:
        raise ValueError(f'{name} must be {wanted}, got {lost}')
    try:
        with np.errstate(over='raise'):
            return array.astype(dtype, copy=False)
    except (OverflowError, FloatingPointError) as error:
        raise ValueError(f'{name} must fit {dtype}, got {quote(value)}') from error


def _lost_by_conversion(value: object) -> str:
    """Return the mask, units or bool that NumPy would silently convert to numbers, or ''."""
    if isinstance(value, (list, tuple)):
        if _PLAIN.issuperset(map(type, value)):
            return ''
        return next(filter(None, map(_lost_by_conversion, value)), '')
    if is_masked(value):
        return 'a masked array: fill its gaps'
    if isinstance(value, (bool, np.bool_)):
        return f'bool {value}'
    unit = getattr(value, 'unit', getattr(value, 'units', None))
    return '' if unit is None else f'units ({quote(unit)}): give its plain numbers in SI units'


def is_masked(value: object) -> bool:
    """Return whether a value is an array with gaps; numpy.ma would take 11 ms to import."""
    return isinstance(value, np.ndarray) and hasattr(value, 'mask')


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, (bool, np.timedelta64))


def frozen(values: ArrayLike) -> Array:
    """Return a read-only copy of numbers, with +0.0 for -0.0: equal robots have equal bits."""
    copy: Array = np.add(values, 0)
    copy.setflags(write=False)
    return copy


def digest_of(values: Mapping[str, Any]) -> str:
    """Return the SHA-256 of numbers, names and what has a digest, as 64 hexadecimal digits."""
    state = hashlib.sha256()
    for name, value in values.items():
        exact = isinstance(value, np.ndarray)
        text = value.astype('<f8').tobytes() if exact else repr(value).encode()
        state.update(f'{name}='.encode() + text)
    return state.hexdigest()


class FrozenArrays:
    """
    Base of a frozen dataclass whose arrays and mappings stay read-only when it is copied.

    Two of a class are equal when their numbers and names are, which their `digest` decides.
    """

    digest: Any

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and bool(self.digest == other.digest)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields; a read-only view of a dict cannot be pickled itself."""
        return {k: dict(v) if isinstance(v, Mapping) else v for k, v in vars(self).items()}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the fields over, read-only: NumPy restores pickled arrays as writable ones."""
        for key, value in dict(state).items():
            object.__setattr__(self, key, _read_only(value))


def _read_only(value: Any) -> Any:
    if isinstance(value, Mapping):
        return MappingProxyType({key: _read_only(item) for key, item in value.items()})
    return frozen(value) if isinstance(value, np.ndarray) else value
