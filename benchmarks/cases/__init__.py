# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs: robots, problems and motions; no measurement."""
