# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is simulated: a serial chain and the effects a scene switches on."""

from pfd_core.model.loading import known_robots, load_robot
from pfd_core.model.robot import PhysicsWarning, Robot
from pfd_core.model.robot_changes import Payload, lock, with_payload
from pfd_core.model.scene import Plant, Scene, resolve, scene_inputs
from pfd_core.model.yaml_robot import robot_to_yaml

__all__ = [
    'Payload',
    'PhysicsWarning',
    'Plant',
    'Robot',
    'Scene',
    'known_robots',
    'load_robot',
    'lock',
    'resolve',
    'robot_to_yaml',
    'scene_inputs',
    'with_payload',
]
