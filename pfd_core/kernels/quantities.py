# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities that a kernel can compute: their arguments, and the effects of a scene that they have.

A quantity is a row of QUANTITIES, and its algorithm one of pfd_core.algorithms. A scene is reduced
to the effects of a quantity, so that kernels which do not differ are compiled once. Which effects
those are follows from the records in pfd_core.model.effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

from pfd_core.model import EFFECTS, Effect, Scene, given_scene
from pfd_core.model.checked_numbers import integer
from pfd_core.model.effects import BRAKES, LINKS
from pfd_core.model.error_text import quote


def _fields(depends: Callable[[Effect], bool]) -> tuple[str, ...]:
    """Return the fields of Scene of the effects that a quantity depends on."""
    return tuple(field.name for effect in EFFECTS if depends(effect) for field in effect.fields)


EVERYTHING = _fields(lambda effect: True)
# Torques do not depend on which joints are braked.
UNBRAKED = _fields(lambda effect: effect.acts != BRAKES)
BODIES = _fields(lambda effect: effect.inertia)
AT_REST = _fields(lambda effect: effect.at_rest)
BIAS = _fields(
    lambda effect: (
        effect.at_rest or effect.viscosity or effect.torque is not None or effect.acts == LINKS
    )
)
ENERGY = _fields(lambda effect: effect.at_rest or effect.inertia)


@dataclass(frozen=True)
class Quantity:
    """
    A quantity of a kernel.

    Attributes
    ----------
    arguments : tuple of str
        Arguments of a call by position; a wrench is one by name.
    effects : tuple of str
        Fields of Scene that it depends on.
    method : str
        Its method; empty if there is a choice, and steps of refinement.
    of_frame : bool
        Whether it refers to a frame.
    wrench : bool
        Whether a wrench is an argument in every scene.

    """

    arguments: tuple[str, ...]
    effects: tuple[str, ...]
    method: str = ''
    of_frame: bool = False
    wrench: bool = False


QUANTITIES = {
    'forward_dynamics': Quantity(('q', 'qd', 'tau'), EVERYTHING),
    'derivatives': Quantity(('q', 'qd', 'tau'), EVERYTHING),
    'inverse_dynamics': Quantity(
        ('q', 'qd', 'qdd'),
        UNBRAKED,
        'newton_euler',
    ),
    'inertia_matrix': Quantity(('q',), BODIES, 'composite_body'),
    'bias_torques': Quantity(('q', 'qd'), BIAS, 'newton_euler'),
    'gravity_torques': Quantity(('q',), AT_REST, 'first_moments'),
    'energy': Quantity(('q', 'qd'), ENERGY, 'link_velocities'),
    'wrench_torques': Quantity(('q',), (), 'kinematics', of_frame=True, wrench=True),
    'tip_pose': Quantity(('q',), (), 'kinematics', of_frame=True),
    'tip_jacobian': Quantity(('q',), (), 'kinematics', of_frame=True),
    'tip_velocity': Quantity(('q', 'qd'), (), 'kinematics', of_frame=True),
}


def quantity_named(name: str) -> Quantity:
    """Return a row of QUANTITIES; ValueError for an unknown name."""
    if not isinstance(name, str) or name not in QUANTITIES:
        raise ValueError(f'quantity must be one of {tuple(QUANTITIES)}, got {quote(name)}')
    return QUANTITIES[name]


def check_options(name: str, method: str, refine: int, frame: str | None) -> None:
    """Raise ValueError for options that a quantity does not have."""
    quantity = quantity_named(name)
    if frame is not None and not quantity.of_frame:
        raise ValueError(f'{name} does not take a frame, got frame={quote(frame)}')
    if not quantity.method:
        return
    if method not in ('auto', quantity.method):
        raise ValueError(
            f"method must be 'auto' or {quantity.method!r} for {name}, got {quote(method)}"
        )
    if integer('refine', refine, 0):
        raise ValueError(f'refine must be 0 for {name}, which solves nothing, got {refine}')


def reduced(scene: Scene | None, quantity: Quantity) -> Scene:
    """Return a scene with the effects that a quantity has."""
    scene = given_scene(scene)
    others: dict[str, Any] = {
        item.name: item.default for item in fields(Scene) if item.name not in quantity.effects
    }
    scene = replace(scene, **others)
    return replace(scene, external_wrench=True) if quantity.wrench else scene
