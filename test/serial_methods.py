# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the serial methods, and of those without iterations."""

from __future__ import annotations

METHODS = (*(f'walker_orin_{k}' for k in range(1, 5)), 'articulated_body')
DIRECT = tuple(method for method in METHODS if method != 'walker_orin_4')
