# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs: robots, problems, motions, and the systems of the paper with their steps; no clocks."""
