# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The numbers of a scene for one robot: `resolve` makes a plant of both.

An effect that is off, or whose numbers are all zero, or infinite for a limit, has no numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfd_core.model.effects import EFFECTS, FIELDS, MOTORS
from pfd_core.model.error_text import quote
from pfd_core.model.geometry import Array, product
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, check_robot
from pfd_core.model.robot_changes import Payload, with_payload
from pfd_core.model.scene import Scene
from pfd_core.model.scene_checks import INPUT


def given_scene(scene: Scene | None) -> Scene:
    """Return a scene, for None that of gravity alone; ValueError for anything else."""
    if scene is None:
        return Scene()
    if not isinstance(scene, Scene):
        raise ValueError(f'scene must be a Scene or None, got {quote(scene)}')
    return scene


def resolve(robot: Robot, scene: Scene | None = None) -> Plant:
    """
    Return a scene as numbers for a robot.

    Parameters
    ----------
    robot : Robot
        The chain.
    scene : Scene, optional
        Which effects are on; gravity alone if not given.

    Raises
    ------
    ValueError
        If the scene has numbers for another number of joints, a static friction below the Coulomb
        friction, or stops between which a joint cannot move.

    """
    check_robot(robot)
    scene = given_scene(scene)
    values = {key: field.resolved(robot, getattr(scene, key)) for key, field in FIELDS.items()}
    effects: dict[str, Array] = {}
    for effect in EFFECTS:
        if not effect.needs and effect.fields[0].has_numbers:
            found = effect.plant_numbers(robot, values)
            effects |= {key: array for key, array in found.items() if array is not None}
    gravity = np.zeros(3) if scene.gravity is None else np.asarray(scene.gravity)
    plant = Plant(
        robot=with_payload(robot, scene.payload) if isinstance(scene.payload, Payload) else robot,
        gravity=product(robot.base_rotation.T, gravity),
        external_wrench=scene.external_wrench,
        brakes=scene.brakes,
        payload_input=scene.payload == INPUT,
        gravity_compensation=_compensation(robot, scene),
        effects=effects,
    )
    return _without_compensated_gravity(plant)


def _without_compensated_gravity(plant: Plant) -> Plant:
    """Return a plant without gravity if its drives take exactly that away, without limits."""
    model = plant.gravity_compensation
    if model is None or any(e.acts == MOTORS and e.field in plant.effects for e in EFFECTS):
        return plant
    if plant.payload_input or model.robot != plant.robot or (model.gravity != plant.gravity).any():
        return plant
    return replace(plant, gravity=np.zeros(3), gravity_compensation=None)


def _compensation(robot: Robot, scene: Scene) -> Plant | None:
    """Return the plant whose gravity torques the drives add; None for no torques."""
    model = scene.gravity_compensation
    if model is False:
        return None
    if not isinstance(model, Scene):
        model = Scene(gravity=scene.gravity)
    plant = resolve(robot, model)
    return plant if plant.gravity.any() else None
