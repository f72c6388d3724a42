# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Advice on a scene.

It says which effects a motion needs within a tolerance, and the error without each:

    motions   motions to simulate again: of a recording, or sines
    scene     the table of effects, and the search for a smaller scene
"""

from pfd_ros.advice.motions import Motion, read_motion, sine
from pfd_ros.advice.scene import Advice, Row, advise, full_scene

__all__ = ['Advice', 'Motion', 'Row', 'advise', 'full_scene', 'read_motion', 'sine']
