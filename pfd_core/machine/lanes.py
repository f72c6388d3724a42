# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The one traced type: a number per lane, whose arithmetic is recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pfd_core.machine.recorder import Recorder

LaneArray = NDArray[np.object_]


class Lanes:
    """
    One value per lane, while recording.

    Attributes
    ----------
    recorder : Recorder
        Where operations on this value are written.
    registers : tuple of int
        One register for all lanes (parallel) or one register per lane (sequential; where a
        lane has no value the entry is without meaning).
    defined : int
        Bit i is set when lane i has a value.

    """

    __slots__ = ('defined', 'recorder', 'registers')

    def __init__(self, recorder: Recorder, registers: tuple[int, ...], defined: int) -> None:
        self.recorder = recorder
        self.registers = registers
        self.defined = defined

    def __bool__(self) -> bool:
        raise TypeError(
            'a value over lanes has no truth while recording: '
            'use where(condition, a, b), or decide on data known before recording'
        )

    def __add__(self, other: object) -> Any:
        return self._binary('add', self, other)

    def __radd__(self, other: object) -> Any:
        return self._binary('add', other, self)

    def __sub__(self, other: object) -> Any:
        return self._binary('sub', self, other)

    def __rsub__(self, other: object) -> Any:
        return self._binary('sub', other, self)

    def __mul__(self, other: object) -> Any:
        return self._binary('mul', self, other)

    def __rmul__(self, other: object) -> Any:
        return self._binary('mul', other, self)

    def __truediv__(self, other: object) -> Any:
        return self._binary('div', self, other)

    def __rtruediv__(self, other: object) -> Any:
        return self._binary('div', other, self)

    def __neg__(self) -> Lanes:
        return self.recorder.apply('neg', self)

    def _binary(self, op: str, left: object, right: object) -> Any:
        if isinstance(left, np.ndarray) or isinstance(right, np.ndarray):
            return NotImplemented  # NumPy then does it element by element
        recorder = self.recorder
        return recorder.apply(op, recorder.lift(left), recorder.lift(right))
