# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign values and names as error messages show them: on one line, and cut."""

from __future__ import annotations

from collections.abc import Iterable
import reprlib

# An error message lists this many names before it says how many more there are.
MOST_NAMES = 12
# repr() of a longer integer takes long, and beyond 4300 digits Python refuses it.
_PRINTED_BITS = 256


class _Repr(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        return (
            repr(x) if x.bit_length() <= _PRINTED_BITS else f'an integer of {x.bit_length()} bits'
        )


_REPR = _Repr()
_REPR.maxstring = _REPR.maxother = 100
_REPR.maxlevel = 3
_REPR.maxdict = _REPR.maxlist = _REPR.maxtuple = 6


def quote(value: object) -> str:
    """Return the repr of a value on one line, cut to a few hundred characters."""
    if isinstance(value, str):
        # Cut in front: repr() of a name of a megabyte is not needed to show its ends.
        keep = _REPR.maxstring
        value = value if len(value) <= keep else f'{value[:keep]}{value[-keep:]}'
    return ' '.join(_REPR.repr(value).split('\n'))


def quote_all(names: Iterable[object]) -> str:
    """Return the first MOST_NAMES names, separated by commas, and the number of the others."""
    items = list(names)
    more = f' and {len(items) - MOST_NAMES} more' if len(items) > MOST_NAMES else ''
    return ', '.join(quote(name) for name in items[:MOST_NAMES]) + more
