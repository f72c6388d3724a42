# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is simulated: a serial chain and the effects a scene switches on."""

from pfd_core.model.edit import Payload, lock, with_payload
from pfd_core.model.robot import PhysicsWarning, Robot
from pfd_core.model.scene import Plant, Scene, resolve

__all__ = [
    'Payload',
    'PhysicsWarning',
    'Plant',
    'Robot',
    'Scene',
    'lock',
    'resolve',
    'with_payload',
]
