# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The effects of a scene that are on, and the full scene of a robot.

The effects are the records of pfd_core.model.effects. An effect is on where the plant, which holds
the numbers, is another one without it: a damping of zero is off, and so is the armature "model" of
a robot that states none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from pfd_core.model import EFFECTS, Robot, Scene, resolve
from pfd_core.model.effects import FIELDS
from pfd_core.model.scene_checks import MODEL
from pfd_core.simulation.simulator import Simulator


def full_scene(
    robot: Robot, scene: Scene, settings: Mapping[str, Any]
) -> tuple[Scene, dict[str, str]]:
    """
    Return a scene with all that the robot's model states and the scene lacks.

    Parameters
    ----------
    robot : Robot
        The arm.
    scene : Scene
        The effects that are given.
    settings : mapping
        step_size, substeps, integrator and method of the simulations, as Simulator takes them.

    Returns
    -------
    Scene
        The full scene.
    dict
        Effects that the model states and that cannot be simulated with these settings, with the
        reason.

    """
    refused = {}
    for effect in EFFECTS:
        if effect.from_model and getattr(scene, effect.field) == FIELDS[effect.field].off:
            more: dict[str, Any] = {effect.field: MODEL}
            try:
                larger = replace(scene, **more)
                if effect.name in effects_on(robot, larger):
                    Simulator(robot, larger, **settings)
                    scene = larger
            except ValueError as error:
                refused[effect.name] = str(error)
    return scene, refused


def effects_on(robot: Robot, scene: Scene) -> tuple[str, ...]:
    """Return the names of the effects that act on a robot in a scene."""
    plant = resolve(robot, scene).digest
    return tuple(
        effect.name
        for effect in EFFECTS
        if resolve(robot, scene.without({effect.name})).digest != plant
    )


def spelled(scene: Scene) -> str:
    """Return the call of Scene that makes a scene, with the fields that differ from defaults."""
    default = Scene()
    given = [
        f'{field.name}={getattr(scene, field.name)!r}'
        for field in fields(Scene)
        if getattr(scene, field.name) != getattr(default, field.name)
    ]
    return f'Scene({", ".join(given)})'
