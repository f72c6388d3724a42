# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Laws of feedback: torques computed from the state of an arm, added to the torques of a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.codegen.law import GAINS, JOINTS, MATRIX, NONE, REFERENCES, WHOLE
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


def law_arrays(
    law: Law | None, size: int, steps: int, n: int, dtype: str
) -> tuple[int, dict[str, Array]]:
    """
    Return the number of a law in native code, and its arrays by their names there.

    References are (B, steps, n), gains (B, n), a matrix (B, steps, 2 n^2); ValueError for an
    array of another shape.
    """
    if law is None:
        return NONE, {}
    if not isinstance(law, Law):
        raise ValueError(
            f'feedback must be a Feedback or a StateFeedback, got {type(law).__name__}'
        )

    def array(name: str, *shape: int) -> Array:
        return real_array(f'feedback.{name}', getattr(law, name), dtype, shape, broadcast=True)

    arrays = {
        place: array(name, size, steps, n)
        for name, place in zip(('q', 'qd'), REFERENCES, strict=True)
    }
    if isinstance(law, Feedback):
        return JOINTS, arrays | {name: array(name, size, n) for name in GAINS}
    return WHOLE, arrays | {MATRIX: _flattened(array(MATRIX, size, steps, n, 2 * n))}


def _flattened(matrices: Array) -> Array:
    """Return matrices (B, steps, n, m) as (B, steps, n m); broadcast dimensions stay so."""
    arms, steps = (1 if stride == 0 else None for stride in matrices.strides[:2])
    once = np.ascontiguousarray(matrices[:arms, :steps])
    flat = once.reshape(*once.shape[:2], once.shape[2] * once.shape[3])
    return np.broadcast_to(flat, (*matrices.shape[:2], flat.shape[-1]))
