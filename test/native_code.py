# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Modules of LLVM IR that tests write, as native code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bridge import Optimisation, compile_kept


def compile_ir(ir: str, functions: Sequence[str]) -> Any:
    """Return native code of a module, which has the addresses of some functions by name."""
    return compile_kept(('IR', ir), lambda: (ir, Optimisation(), {}), functions, dict)
