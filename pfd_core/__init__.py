# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parallel forward dynamics after Lee and Chang (1987): counted, emulated and compiled."""
