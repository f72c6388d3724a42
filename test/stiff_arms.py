# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arms with stiff damping."""

from __future__ import annotations

import numpy as np

import pfd_core as pfd

START = np.array([0.1, -0.7, 0.9, 0.3, 0.2, 0.5])


def scene_of(damping: float, rotors: bool) -> pfd.Scene:
    return pfd.Scene(damping=np.full(6, damping), armature='model' if rotors else None)
