# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Models: a robot is a serial chain, and a scene is the set of effects that act on it.

    loading             load_robot: a robot by name, from a file or a string; load_scene
    yaml_files          YAML text -> dict, list and str, bounded; robots as YAML
    packages            folders of ROS packages: installed, or by their package.xml in a checkout
    described           robots by name whose links are in another package, with our numbers
    apart               programs that make a URDF of a file, in another process
    xacro_files         such a program: the package xacro, with its arguments
    mjcf                such a program: the package mujoco, of models of MuJoCo
    urdf                URDF string -> Urdf, the one record for all readers; by
    urdf_xml            its XML, bounded in size, with lines for errors, and what is read of it
    urdf_chain          the joints of a URDF that move, in a chain, and those that are locked
    urdf_robot          the links that each of them carries, welded, as a Robot
    urdf_writer         robots as URDF
    geometry            rotations, frames and rigid bodies as arrays with exact zeros and ones
    robot               Robot: the chain in the frames of Lee and Chang, checked once; its frames,
                        joints that follow others, and a payload
    limits              limits that mean none, the default start, states outside the stops, rotors
    locking             positions of locked joints; lock, a robot without them
    effects             the table of effects: fields of a scene with units, checks and values of
                        a model; torques, energies, where they act
    scene               Scene: which effects are on; scenes as YAML
    plant               Plant: a scene and a robot as numbers; resolve, which makes it of both
    values              numbers, names and arrays, checked, and as errors quote them

URDF, xacro and MJCF are read by modules that `loading` imports at the first such file.

A new effect of a joint is a record in `effects` and a field of Scene; all else follows from them,
but for effects of motors and dry friction (see the map of pfd_core).
"""
