# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read-only arrays and mappings as fields of frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
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
    """Base of a frozen dataclass whose arrays and mappings stay read-only when it is copied."""

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields; a read-only view of a dict cannot be pickled itself."""
        views = {k: dict(v) for k, v in vars(self).items() if isinstance(v, MappingProxyType)}
        return vars(self) | views

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the fields over; NumPy restores pickled arrays as writable ones."""
        for key, value in state.items():
            kept = _frozen(value)
            if type(value) is dict:
                kept = MappingProxyType({name: _frozen(item) for name, item in value.items()})
            object.__setattr__(self, key, kept)


def _frozen(value: Any) -> Any:
    return frozen(value) if isinstance(value, np.ndarray) else value
