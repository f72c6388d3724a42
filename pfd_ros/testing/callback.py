# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The link of the arm to a callback of the test, controller(t, q, qd) -> tau."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from time import perf_counter
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pfd_ros.arm.events import ARRAY, Message, Verdict
from pfd_ros.messages.text_and_arrays import encode_floats
from pfd_ros.motion.metrics import Array
from pfd_ros.testing.loop import Command, ControllerError, RejectedError
from pfd_ros.testing.patience import BlockedError, Watch
from pfd_ros.text import one_line

FLOAT = np.dtype('<f8')
# controller(t, q, qd) -> tau, with q, qd and tau (n,) in published order; SI units, t in s.
Controller: TypeAlias = Callable[[float, Array, Array], ArrayLike]


class CallbackLink:
    """A controller that is called with each state; the arrays are its own."""

    silent = True

    def __init__(self, controller: Controller, names: Sequence[str], patience: float) -> None:
        self._controller, self._names, self._watch = controller, names, Watch(patience)
        numbers = np.zeros(len(names))
        self._head = encode_floats(numbers)[: -numbers.nbytes]
        self._answers, self._efforts = 0, np.empty(0)
        self.seconds, self.notes = nan, list[str]()

    def __enter__(self) -> CallbackLink:
        """Begin to watch the controller."""
        self._watch.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        """Watch no longer."""
        self._watch.__exit__()

    def answer(
        self, messages: Sequence[Message], time: float, measured: Array
    ) -> Sequence[Command]:
        """Return the command with which the controller answers a state."""
        watch, q, qd = self._watch, measured[0], measured[1]
        begun = watch.since = perf_counter()
        try:
            efforts: Any = self._controller(time, q, qd)
            watch.since = 0.0
        except BlockedError:
            pass
        except Exception as error:
            text = one_line(f'{type(error).__name__}: {error}')
            raise ControllerError(f'the controller raised at t = {time:.6g} s: {text}') from error
        self.seconds = perf_counter() - begun
        if watch.stack:
            # Also if it caught what interrupted it.
            raise ControllerError(watch.report(time, self._answers))
        if (
            type(efforts) is not np.ndarray
            or efforts.dtype is not FLOAT
            or efforts.shape != q.shape
        ):
            efforts = self._converted(efforts, time)
        # The arm checks whether they are finite.
        self._efforts = efforts
        self._answers += 1
        return ((ARRAY, self._head + efforts.tobytes()),)

    def _converted(self, answer: Any, time: float) -> Array:
        names = list(self._names)
        try:
            efforts = np.asarray(answer)
            if efforts.dtype.kind not in 'iuf' or efforts.shape != (len(names),):
                raise ValueError
            return efforts.astype(FLOAT)
        except (TypeError, ValueError):
            shape = f', of shape {answer.shape}' if isinstance(answer, np.ndarray) else ''
            raise ControllerError(
                f'the controller returned {one_line(repr(answer), 200)}{shape} at '
                f't = {time:.6g} s, expected {len(names)} numbers, an effort for each of {names}'
            ) from None

    def rejected(self, time: float, verdict: Verdict) -> Exception:
        """Return the error about efforts that the arm did not accept."""
        wrong = np.flatnonzero(~np.isfinite(self._efforts)).tolist()
        if not wrong:
            return RejectedError(
                f'the arm rejected the efforts at t = {time:.6g} s: {verdict.label}: '
                f'{verdict.detail}'
            )
        told = ', '.join(f'{self._efforts[j]} for joint {self._names[j]!r}' for j in wrong)
        return RejectedError(
            f'the controller returned {told} at t = {time:.6g} s, expected finite efforts'
        )
