# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Models: a robot is a serial chain, and a scene is the set of effects that act on it.

    loading             load_robot: a robot by name, from a file or a string; load_scene
    yaml_files          YAML text -> dict, list and str, bounded; robots as YAML: tables from
                        papers, and robots stored exactly
    rotors              rotors behind gears: their inertia at the joint
    packages            folders of ROS packages: installed, or by their package.xml in a checkout
    described           robots by name whose links are in another package, with our numbers
    apart               programs that make a URDF of a file, in another process with a bound
    xacro_files         the URDF of a xacro file and its arguments, by the package xacro
    mjcf                the URDF of a MuJoCo model, compiled by the package mujoco
    urdf                URDF string -> Urdf, the one record for all readers
    urdf_rotors         inertia of rotors in its transmissions
    urdf_xml            its XML, bounded in size, with lines for errors; numbers in it
    urdf_chain          the joints of a URDF that move, in a chain, and those that are locked
    urdf_robot          the links that each of them carries, welded, as a Robot
    urdf_writer         robots as URDF
    geometry            rotations, frames and rigid bodies as arrays with exact zeros and ones;
                        conditions on a rotation and an inertia, with their tolerances
    robot               Robot: the chain in the frames of Lee and Chang, checked once; its frames,
                        and joints that follow others; Payload, and robots with a payload or
                        with locked joints
    effects             the table of effects: fields of a scene with units, checks and values of
                        a model; torques, energies, where they act
    scene               Scene: which effects are on; scenes as YAML
    plant               Plant: a scene and a robot as numbers; resolve, which makes it of both;
                        plant.only, the plant with some kinds of effects
    stops               the default start of a robot; the states outside its stops
    values              numbers, names and arrays, checked, and as errors quote them

URDF, xacro and MJCF are read by modules that `loading` imports at the first such file.

A new effect of a joint is a record in `effects` and a field of Scene; all else follows from them.
An effect of the motors has its torque in pfd_core.dynamics.drives as well.
"""

from pfd_core.model.effects import EFFECTS, Effect
from pfd_core.model.loading import (
    find_description,
    known_robots,
    load_robot,
    load_scene,
    locked_joints,
    read_urdf,
    urdf_of,
)
from pfd_core.model.plant import (
    INSTANT,
    Plant,
    check_instant,
    check_joint_inertia,
    has_drives,
    resolve,
)
from pfd_core.model.robot import Frame, Payload, PhysicsWarning, Robot, lock, with_payload
from pfd_core.model.rotors import estimated_armature, reflected_inertia
from pfd_core.model.scene import Scene, given_scene, scene_inputs, scene_to_yaml
from pfd_core.model.stops import outside_stops, start_positions, start_within
from pfd_core.model.yaml_files import robot_to_yaml

__all__ = [
    'EFFECTS',
    'INSTANT',
    'Effect',
    'Frame',
    'Payload',
    'PhysicsWarning',
    'Plant',
    'Robot',
    'Scene',
    'check_instant',
    'check_joint_inertia',
    'estimated_armature',
    'find_description',
    'given_scene',
    'has_drives',
    'known_robots',
    'load_robot',
    'load_scene',
    'lock',
    'locked_joints',
    'outside_stops',
    'read_urdf',
    'reflected_inertia',
    'resolve',
    'robot_to_yaml',
    'scene_inputs',
    'scene_to_yaml',
    'start_positions',
    'start_within',
    'urdf_of',
    'with_payload',
]
