# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The effects of a scene as one table (EFFECTS), each with the fields that switch it off.

Every field of Scene belongs to a row; a new field needs one row here and nothing else in the
report. An effect is on where the plant, which holds the numbers, is another one without it: a
damping of zero is off, and so is the armature "model" of a robot that states none.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from pfd_core.model import Robot, Scene, resolve
from pfd_core.model.plant import STEP_EFFECTS
from pfd_core.model.scene_checks import MODEL
from pfd_core.simulation.simulator import Simulator


@dataclass(frozen=True)
class Effect:
    """
    One effect of a scene.

    Attributes
    ----------
    name : str
        Name in tables.
    off : mapping
        Fields of Scene and their values without the effect: its own field first, then those that
        mean nothing without it.
    from_model : bool
        Whether the full scene takes the effect from the robot's model, where it is not given.

    """

    name: str
    off: Mapping[str, Any]
    from_model: bool = False


EFFECTS = (
    Effect('gravity', {'gravity': None}),
    Effect('damping', {'damping': None}, from_model=True),
    Effect('armature', {'armature': None}, from_model=True),
    Effect('payload', {'payload': None}),
    Effect('external wrench', {'external_wrench': False}),
    Effect('brakes', {'brakes': False}),
    Effect(
        'friction',
        dict.fromkeys(('friction', 'static_friction', 'stribeck_velocity')),
        from_model=True,
    ),
    Effect('static friction', dict.fromkeys(('static_friction', 'stribeck_velocity'))),
    Effect('Stribeck velocity', {'stribeck_velocity': None}),
    Effect('joint stops', {'joint_limits': None, 'restitution': 0.0}, from_model=True),
    Effect('restitution', {'restitution': 0.0}),
    Effect('springs', {'stiffness': None, 'rest_position': None}),
    Effect('effort limits', {'effort_limits': None}, from_model=True),
    Effect('torque-speed tables', {'torque_speed': None}),
    Effect('gravity compensation', {'gravity_compensation': False}),
    Effect('motor lag', {'motor_lag': None}),
)

# Effects that no function of an instant holds, but the simulation of a step.
OVER_A_STEP = frozenset(
    effect.name for effect in EFFECTS if next(iter(effect.off)) in STEP_EFFECTS
)


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
        field, off = next(iter(effect.off.items()))
        if effect.from_model and getattr(scene, field) == off:
            more: dict[str, Any] = {field: MODEL}
            try:
                larger = replace(scene, **more)
                if effect.name in effects_on(robot, larger):
                    Simulator(robot, larger, **settings)
                    scene = larger
            except ValueError as error:
                refused[effect.name] = str(error)
    return scene, refused


def without(scene: Scene, names: Collection[str]) -> Scene:
    """Return a scene without the effects of these names, and without those that depend on them."""
    changes = {
        field: off
        for effect in EFFECTS
        if effect.name in names
        for field, off in effect.off.items()
    }
    return replace(scene, **changes)


def effects_on(robot: Robot, scene: Scene) -> tuple[str, ...]:
    """Return the names of the effects that act on a robot in a scene."""
    plant = resolve(robot, scene).digest
    return tuple(
        effect.name
        for effect in EFFECTS
        if resolve(robot, without(scene, {effect.name})).digest != plant
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
