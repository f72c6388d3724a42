# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Native code of a source for one state and for batches, and the entries that Python calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from pfd_core.forking import cached_property
from pfd_core.kernels.native import Native, simd_width
from pfd_core.kernels.runtime.cpython_abi import python_function, refuse
from pfd_core.kernels.source import KernelSource


class Entries:
    """
    Native code of a source; batches are compiled on first use.

    Attributes
    ----------
    width : int
        States in a vector register.
    single : Native
        Code of one state.
    single_entry : callable
        Python's function of it, of the arguments in the order of a call and the result.

    """

    def __init__(self, source: KernelSource, dtype: str, angles: Sequence[int]) -> None:
        self._source, self._dtype, self._angles = source, dtype, angles
        self.width = simd_width(dtype)
        self.single = self._compile(1)
        self.single_entry = self._entry(self.single)

    @cached_property
    def batch(self) -> Native:
        """Code of a batch."""
        return self._compile(self.width)

    @cached_property
    def batch_entry(self) -> Callable[..., Any]:
        """Python's function of it."""
        return self._entry(self.batch)

    @property
    def bound(self) -> Callable[..., Any]:
        """Python's function of one state that raises errors itself."""
        return python_function(self.single, 'bound')

    @property
    def compile_seconds(self) -> float:
        """Time spent in the compiler so far [s]."""
        batch = self.__dict__.get('batch')
        return self.single.seconds + (batch.seconds if batch else 0.0)

    def ir(self, width: int) -> str:
        """Return the LLVM IR of a width."""
        return self._source.module(self._dtype, width, self._angles)

    def _compile(self, width: int) -> Native:
        functions = ['entry', 'bound' if width == 1 else 'batch']
        return self._source.compile(f'kernel {width}', functions, partial(self.ir, width))

    def _entry(self, native: Native) -> Callable[..., Any]:
        # An entry takes arrays in the order of a call, in which brakes have no position.
        return refuse if 'free' in self._source.inputs else python_function(native)
