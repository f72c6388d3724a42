# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The call of a controller under test, and the error for an invalid answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pfd_ros.motion.metrics import Array
from pfd_ros.testing.patience import Watch
from pfd_ros.text import one_line

FLOAT = np.dtype(np.float64)
# controller(t, q, qd) -> tau, with q, qd and tau (n,) in published order; SI units, t in s.
Controller: TypeAlias = Callable[[float, Array, Array], ArrayLike]


class ControllerError(Exception):
    """A controller raised, blocks, or returned anything but a finite effort for each joint."""


def asked(controller: Controller, names: Sequence[str], t: float, q: Array, qd: Array) -> Array:
    """Return the efforts (n,) with which a controller answers a state.

    The arrays of the state are the controller's own. The efforts may still be NaN or infinite:
    the arm validates them, and `refusal` describes the error.

    Raises
    ------
    ControllerError
        If the controller raised, or its answer is not one number for each joint.
    """
    try:
        answer = controller(t, q, qd)
    except Exception as error:
        text = one_line(f'{type(error).__name__}: {error}')
        raise ControllerError(f'the controller raised at t = {t:.6g} s: {text}') from error
    if type(answer) is np.ndarray and answer.dtype is FLOAT and answer.shape == q.shape:
        return answer
    return _converted(answer, names, t)


def _converted(answer: Any, names: Sequence[str], t: float) -> Array:
    expected = f'expected {len(names)} numbers, an effort for each of {list(names)}'
    try:
        efforts = np.asarray(answer)
        if efforts.dtype.kind not in 'iuf' or efforts.shape != (len(names),):
            raise ValueError(f'an array of shape {efforts.shape} of {efforts.dtype}')
        return efforts.astype(np.float64)
    except (TypeError, ValueError):
        shape = f', of shape {answer.shape}' if isinstance(answer, np.ndarray) else ''
        raise ControllerError(
            f'the controller returned {one_line(repr(answer), 200)}{shape} at t = {t:.6g} s, '
            f'{expected}'
        ) from None


def blocked(watch: Watch, patience: float, t: float, answers: int) -> ControllerError:
    """Return the error about a controller that blocks at a state; `answers` came before."""
    return ControllerError(
        f'the controller blocks: no answer for {patience:g} s to the state at t = {t:.6g} s, '
        f'after {answers} answers; it is here:\n{watch.stack}'
    )


def raised(error: Exception, t: float, answers: int) -> ControllerError:
    """Return the error about a node that raised at a state; `answers` came before."""
    text = one_line(f'{type(error).__name__}: {error}')
    return ControllerError(f'a node raised at t = {t:.6g} s, after {answers} answers: {text}')


def refusal(efforts: Array, names: Sequence[str], t: float, detail: str) -> ControllerError:
    """Return the error about efforts that the arm did not accept."""
    wrong = np.flatnonzero(~np.isfinite(efforts)).tolist()
    if not wrong:
        return ControllerError(f'the arm refused the efforts at t = {t:.6g} s: {detail}')
    wrong_efforts = ', '.join(f'{float(efforts[j])} for joint {names[j]!r}' for j in wrong)
    return ControllerError(
        f'the controller returned {wrong_efforts} at t = {t:.6g} s, expected finite efforts'
    )
