# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read-only arrays as fields of frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """Return a read-only copy of numbers, with +0.0 for -0.0: equal robots have equal bits."""
    # Adding 0.0 copies, and turns -0.0 into 0.0.
    copy: NDArray[np.float64] = np.asarray(values, dtype=np.float64) + 0.0
    copy.setflags(write=False)
    return copy


class FrozenArrays:
    """Base of a frozen dataclass whose arrays stay read-only when it is pickled or copied."""

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the fields over; NumPy restores pickled arrays as writable ones."""
        for key, value in state.items():
            kept = frozen(value) if isinstance(value, np.ndarray) else value
            object.__setattr__(self, key, kept)
