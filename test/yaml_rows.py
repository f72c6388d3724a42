# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of a robot in YAML."""

from __future__ import annotations

ROWS = """
robot: two
joints:
- {name: a, type: revolute, mass: 1, dh: {a: 0.5, d: 0.1, alpha_deg: 90, theta_deg: 30}}
- {name: b, type: prismatic, mass: 2, center: [0, 0, 1e-3],
   inertia: {xx: 1, yy: 1, zz: 1, xy: 0.1}, dh: {a: 0, d: 0.2, alpha_deg: -20, theta_deg: 90}}
"""
