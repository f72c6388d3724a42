# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laws of feedback: torques computed from the state of an arm, added to the torques of a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.values import Array, real_array


@dataclass(frozen=True)
class Feedback:
    """
    A law that adds kp (q - state q) + kd (qd - state qd) to the torques of a step.

    The state is that at the beginning of the step, over which the torque is constant; B arms, n
    joints.

    Attributes
    ----------
    kp, kd : array_like
        Gains of each joint, (n,) or (B, n) [N m/rad or N/m, and the same times s].
    q, qd : array_like
        Reference of the state: (n,), (steps, n) or (B, steps, n) [rad or m, and per s].

    """

    kp: ArrayLike
    kd: ArrayLike
    q: ArrayLike
    qd: ArrayLike = 0.0


@dataclass(frozen=True)
class StateFeedback:
    """
    A law that adds gain @ (q - state q, qd - state qd) to the torques of a step.

    A linear-quadratic regulator has a gain of this form, and an iterative one a gain for each
    step of a trajectory. The state is that at the beginning of the step; B arms, n joints.

    Attributes
    ----------
    gain : array_like
        (n, 2 n), (steps, n, 2 n) or (B, steps, n, 2 n) [N m/rad or N/m, then the same times s].
    q, qd : array_like
        Reference of the state: (n,), (steps, n) or (B, steps, n) [rad or m, and per s].

    """

    gain: ArrayLike
    q: ArrayLike
    qd: ArrayLike = 0.0


Law = Feedback | StateFeedback


def record_law(law: type[Law], n: int) -> Program:
    """
    Return the control program of a law: tau from `command`, the state, and the law's arrays.

    They are `q.ref` and `qd.ref`, (n,), and `kp` and `kd`, (n,), or `gain`, (2 n^2,). Terms are
    added to the command from the left.
    """
    recorder = Recorder(1, 'sequential')

    def row(name: str, size: int = n) -> list[Any]:
        return recorder.input_list(name, size)

    torques, state = row('command'), row('q') + row('qd')
    references = row('q.ref') + row('qd.ref')
    errors = [wanted - x for wanted, x in zip(references, state, strict=True)]
    if law is Feedback:
        gains = row('kp') + row('kd')
        terms = [[gains[k] * errors[k] for k in (i, n + i)] for i in range(n)]
    else:
        gains = row('gain', 2 * n * n)
        terms = [
            [gain * error for gain, error in zip(gains[2 * n * i :], errors, strict=False)]
            for i in range(n)
        ]
    tau = [sum(own, command) for command, own in zip(torques, terms, strict=True)]
    return recorder.program(tau=tau)


def law_arrays(law: Law, size: int, steps: int, n: int, dtype: str) -> dict[str, Array]:
    """
    Return the arrays of a law, by their names in its control program.

    References are (B, steps, n), gains (B, n), a matrix (B, steps, 2 n^2); ValueError for an
    array of another shape.
    """
    if not isinstance(law, Law):
        raise ValueError(
            f'feedback must be a Feedback or a StateFeedback, got {type(law).__name__}'
        )

    def array(name: str, *shape: int) -> Array:
        return real_array(f'feedback.{name}', getattr(law, name), dtype, shape, broadcast=True)

    arrays = {f'{name}.ref': array(name, size, steps, n) for name in ('q', 'qd')}
    if isinstance(law, Feedback):
        return arrays | {name: array(name, size, n) for name in ('kp', 'kd')}
    # Rows of the table of native code have one axis: what arms or steps share stays broadcast.
    gain = array('gain', size, steps, n, 2 * n)
    once = gain[tuple(slice(None if stride else 1) for stride in gain.strides[:2])]
    flat = once.reshape(*once.shape[:2], 2 * n * n)
    return arrays | {'gain': np.broadcast_to(flat, (size, steps, 2 * n * n))}
