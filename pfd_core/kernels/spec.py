# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
KernelSpec: all that decides a kernel, checked and resolved once.

A scene is reduced to the effects that a quantity depends on, so that kernels which do not differ
are compiled once. The quantities are rows of pfd_core.dynamics.quantities.QUANTITIES.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

from pfd_core.dynamics.quantities import QUANTITIES, Quantity
from pfd_core.forking import load
from pfd_core.kernels.auto import select
from pfd_core.model.effects import INPUT
from pfd_core.model.plant import INSTANT, Plant, check_joint_inertia, resolve
from pfd_core.model.robot import Robot
from pfd_core.model.scene import Scene, given_scene
from pfd_core.model.values import DTYPES, choice, integer, quote

# Forward dynamics at an instant of a step of a simulation, whose effects over time are the step's
# own.
STEP = 'step'


@dataclass(frozen=True)
class KernelSpec:
    """
    Robot, scene, method, number format, refinement and quantity of a kernel.

    Two specs are equal where their kernels are the same, so a spec can be a key of a cache.
    ValueError if a field is not one of these, or does not fit the robot.
    """

    robot: Robot
    scene: Scene  # reduced to the effects of the quantity
    method: str = 'auto'  # resolved to a name in METHODS, or the one method of the quantity
    dtype: str = 'float64'
    refine: int = 0  # steps of refinement, including a step selected by 'auto'
    quantity: str = 'forward_dynamics'  # a name in QUANTITIES, or STEP
    frame: str | None = None  # of a quantity of a frame, where None is given the tip
    inputs: Plant | None = None  # in place of the plant of the scene, with numbers that are inputs
    # The robot in its scene, with the effects at the instants at which the kernel is evaluated.
    plant: Plant = field(init=False, repr=False, compare=False)
    # Digest of the frame, '' without one: equal robots may have different frames.
    place: str = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # A step has the options of forward dynamics.
        of_step = isinstance(self.quantity, str) and self.quantity == STEP
        name = 'forward_dynamics' if of_step else self.quantity
        quantity = quantity_named(name)
        check_options(quantity, self.method, self.refine, self.frame)
        scene = reduced(self.scene, quantity)
        choice('dtype', self.dtype, DTYPES)
        plant = resolve(self.robot, scene)
        if scene.payload == INPUT:
            plant = load('dynamics.bodies.with_payload_input')(plant)
        if of_step:
            plant = plant.only(*INSTANT)
        frame, place = None, ''
        if quantity.of_frame:
            frame = self.robot.tip if self.frame is None else self.frame
            place = self.robot.frame(frame).digest
        method, refine = quantity.method, self.refine
        if not quantity.method:
            # Brakes may hold a joint without inertia, and an input may give it one.
            if not (plant.brakes or plant.links or self.inputs is not None):
                check_joint_inertia(plant)
            use = 'step' if of_step else name
            method, refine = select(plant, self.method, refine, use)
        if self.inputs is not None:
            # The method is that of the scene, whatever the inputs.
            plant = self.inputs.only(*INSTANT) if of_step else self.inputs
        names = 'scene', 'method', 'refine', 'frame', 'plant', 'place'
        resolved = scene, method, int(refine), frame, plant, place
        for key, value in zip(names, resolved, strict=True):
            object.__setattr__(self, key, value)

    def __reduce__(self) -> tuple[type[KernelSpec], tuple[Any, ...]]:
        """Be pickled as the arguments it was made from, which are checked again."""
        return KernelSpec, tuple(getattr(self, item.name) for item in fields(self) if item.init)


def quantity_named(name: str) -> Quantity:
    """Return a row of QUANTITIES; ValueError for an unknown name."""
    if not isinstance(name, str) or name not in QUANTITIES:
        raise ValueError(f'quantity must be one of {tuple(QUANTITIES)}, got {quote(name)}')
    return QUANTITIES[name]


def check_options(quantity: Quantity, method: str, refine: int, frame: str | None) -> None:
    """Raise ValueError for options that a quantity does not have."""
    name = quantity.name
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
