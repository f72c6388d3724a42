# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Answers with known digits: 50-digit arithmetic, extrapolation and closed forms."""
