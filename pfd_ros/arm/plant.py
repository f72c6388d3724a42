# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plant of settings: the scene, and the native code that simulates the robot in it.

The payload at the start is a constant of native code; another one is an input of a second program,
compiled once, where the method permits it. So the plant is a function of the settings alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
import hashlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.conventions import PLAIN
from pfd_ros.arm.events import OPTIONAL, ROLES
from pfd_ros.arm.plant_settings import (
    COMPILED,
    JOINT_EFFECTS,
    PAYLOAD,
    SCALES,
    given_effects,
    in_model_order,
    payload_numbers,
)
from pfd_ros.arm.settings import PER_JOINT, POSITION_SUMS, Settings, joint_values
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.text import cut

# With the payload at the start or another one, with gravity compensation or without. A plant is
# freed while another one is compiled, not in a step.
MOST_COMPILED = 4
# The payload of a scene whose native code takes one with each step.
INPUT = 'input'
# The kernel of the gravity torques that the drives add, where states show them.
ADDED = 'added gravity torques'
# The kernel of the torques of the external wrench, where a reflex bounds them.
EXTERNAL = 'external torques of a reflex'
# Friction of a scene, and the setting of the share that the drives compensate.
COMPENSATED = {
    'damping': 'viscous_scale',
    'friction': 'coulomb_scale',
    'static_friction': 'coulomb_scale',
}
_FIELDS = {effect.field: effect for effect in JOINT_EFFECTS}


class Plant(NamedTuple):
    """A scene with its payload, and the native code that simulates the robot in it."""

    scene: pfd.Scene
    simulator: pfd.MotorSimulator
    # Of the outputs that are quantities of the model, by role.
    kernels: Mapping[str, Any]
    # The payload as an argument of native code that takes it as an input, else nothing.
    inputs: Mapping[str, pfd.Payload | None]
    # Mass, center and inertia (xx, xy, xz, yy, yz, zz) of the payload, () without one.
    payload: tuple[float, ...]
    # Friction that the drives compensate, by field, (n,), and its stribeck_velocity.
    friction: Mapping[str, NDArray[Any]]

    @property
    def program(self) -> str:
        """Digest of the compiled programs of the plant and its outputs, the same everywhere."""
        kernels = (f'{name} {code.code_digest}' for name, code in self.kernels.items())
        lines = [self.simulator.code_digest, *kernels]
        return hashlib.sha256('\n'.join(lines).encode()).hexdigest()


class Plants:
    """The plants of a robot under the settings of a run, and those that change while it runs.

    A cache, which any thread may ask: who asks late only waits longer. ValueError for settings
    that do not go with the robot. `order` is the index in the model of each published joint.
    """

    def __init__(self, settings: Settings, robot: pfd.Robot, order: NDArray[Any]) -> None:
        self._robot, self._order = robot, order
        # Simulator and kernels by the digest of the scene.
        self._compiled: dict[str, tuple[pfd.MotorSimulator, dict[str, Any]]] = {}
        self._first = self._scene(settings)[0].payload
        self._varies = False
        self._varies = self.prepare(settings).simulator.method in pfd.PAYLOAD_METHODS

    def prepare(self, settings: Settings) -> Plant:
        """Return the plant of settings, which may be compiled now: that takes up to a second.

        A payload that is an input takes a tenth of a millisecond, but for the first.
        """
        scene, friction = self._scene(settings)
        payload = _payload_of(scene)
        compiled = self._of_code(scene)
        simulator, kernels = self._native(settings, compiled)
        inputs = {'payload': payload} if compiled.payload == INPUT else {}
        if inputs:
            simulator.prepare_payload(payload)
        numbers = () if payload is None else payload_numbers(payload)
        return Plant(scene, simulator, kernels, inputs, numbers, friction)

    def ready(self, settings: Settings) -> bool:
        """Return whether nothing has to be compiled for settings."""
        return self._of_code(self._scene(settings)[0]).digest in self._compiled

    def _scene(self, settings: Settings) -> tuple[pfd.Scene, dict[str, NDArray[Any]]]:
        """Return the scene without the friction that the drives compensate, and this friction.

        They know the friction and the velocity, so what is left is a joint with less of it.
        """
        scene = scene_of(settings, self._order)
        found = _friction(scene, settings, self._robot, self._order)
        left: dict[str, Any] = {name: x * (1.0 - share) for name, (x, share) in found.items()}
        taken = {name: x * share for name, (x, share) in found.items()}
        speed = _FIELDS['stribeck_velocity'].resolved(self._robot, scene.stribeck_velocity)
        if 'static_friction' in taken and speed is not None:
            taken['stribeck_velocity'] = speed
        return replace(scene, **left), taken

    def _of_code(self, scene: pfd.Scene) -> pfd.Scene:
        """Return a scene as native code has it, perhaps with its payload as an input."""
        varied = self._varies and scene.payload != self._first
        return replace(scene, payload=INPUT) if varied else scene

    def _native(
        self, settings: Settings, scene: pfd.Scene
    ) -> tuple[pfd.MotorSimulator, dict[str, Any]]:
        found = self._compiled.get(scene.digest)
        if found is None:
            # Outputs describe the model: without the wrench, and the gravity torques of drives.
            alone = replace(scene, external_wrench=False, gravity_compensation=False)
            chosen = [role for role in OPTIONAL if role in settings.outputs]
            wanted = {role: (alone, ROLES[role].quantity) for role in chosen}
            model = scene.gravity_compensation
            if settings.state_effort != 'command' and model:
                model = pfd.Scene(gravity=scene.gravity) if model is True else model
                wanted[ADDED] = model, 'gravity_torques'
            if any(settings.reflex_external_effort):
                wanted[EXTERNAL] = alone, 'wrench_torques'
            kernels = {
                name: pfd.compile_kernel(self._robot, scene=one, quantity=quantity)
                for name, (one, quantity) in wanted.items()
                if quantity
            }
            simulator = pfd.MotorSimulator(self._robot, scene, **simulator_settings(settings))
            found = simulator, kernels
            # The oldest go; a list, since other threads may ask meanwhile.
            for digest in list(self._compiled)[: 1 - MOST_COMPILED]:
                self._compiled.pop(digest, None)
            self._compiled[scene.digest] = found
        return found


def acceleration_kernel(robot: pfd.Robot, scene: pfd.Scene, method: str) -> Any:
    """Return the kernel of the accelerations, without brakes and the external wrench.

    Effects that act over a step, such as friction, are left out too: they have no accelerations.
    """
    over_a_step = {effect.name for effect in pfd.EFFECTS if effect.acts == 'step'}
    smooth = scene.without(over_a_step | {'brakes', 'external wrench'})
    return pfd.compile_kernel(robot, method=method, scene=smooth)


def simulator_settings(settings: Settings) -> dict[str, Any]:
    """Return the arguments of the simulator that the settings describe."""
    return {
        'step_size': settings.step_ns / NANOSECONDS,
        'substeps': settings.substeps,
        'integrator': settings.integrator,
        'method': settings.method,
        'compensated': POSITION_SUMS[settings.position_sums],
    }


def with_scene_text(settings: Settings) -> Settings:
    """Return settings with the text of the scene file that they name: the file may change."""
    if not settings.scene:
        return settings
    return replace(settings, scene=pfd.scene_to_yaml(pfd.load_scene(settings.scene)))


def scene_of(settings: Settings, order: NDArray[Any]) -> pfd.Scene:
    """Return the scene of an arm, with brakes, since joints are held until they are commanded.

    No file is read: the settings may come from a recording. ValueError if their text is no scene.
    """
    if settings.scene:
        scene = _from_text(settings.scene)
    else:
        gravity = settings.gravity if any(settings.gravity) else None
        scene = pfd.Scene(gravity=gravity, **given_effects(settings, order))
    compensated = (
        scene.gravity_compensation or settings.gravity_compensation or settings.convention != PLAIN
    )
    wrenched = scene.external_wrench or settings.external_wrench
    if any(settings.reflex_external_effort) and not wrenched:
        raise ValueError('reflex_external_effort is given, but external_wrench is false')
    if settings.load_mass:
        if not compensated:
            raise ValueError(
                f'load.mass is {settings.load_mass!r}, but nothing compensates it: set '
                'gravity_compensation or convention'
            )
        load = pfd.Payload(settings.load_mass, settings.load_center)
        model = pfd.Scene(gravity=scene.gravity) if compensated is True else compensated
        compensated = replace(model, payload=load)
    return replace(
        scene,
        brakes=True,
        external_wrench=wrenched,
        gravity_compensation=compensated,
        payload=settings.payload or scene.payload,
    )


def _friction(
    scene: pfd.Scene, settings: Settings, robot: pfd.Robot, order: NDArray[Any]
) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
    """Return the friction of a scene and the share that drives compensate, (n,), by field."""
    rows = {row.field: row for row in PER_JOINT if row.field in SCALES}
    found = dict[str, tuple[NDArray[Any], NDArray[Any]]]()
    for name, setting in COMPENSATED.items():
        shares = joint_values(rows[setting], settings, robot, order.tolist())
        if any(shares):
            numbers = _FIELDS[name].resolved(robot, getattr(scene, name))
            if name == 'static_friction' and numbers is not None:
                # Joints without a number have that of sliding.
                numbers = np.where(np.isnan(numbers), found['friction'][0], numbers)
            if numbers is not None:
                found[name] = numbers, in_model_order(shares, order)
    return found


def _from_text(text: str) -> pfd.Scene:
    if '\n' not in text:
        raise ValueError(f'scene is {cut(repr(text))}, expected the YAML of a scene')
    scene = pfd.load_scene(text)
    if scene.payload == INPUT:
        raise ValueError(
            f'payload of the scene is {INPUT!r}, expected a table of mass, center and inertia: '
            'a payload at run time comes from ~/payload or the parameters payload.*'
        )
    return scene


def with_own_effects(settings: Settings, changed: Collection[str]) -> Settings:
    """Return settings whose own fields hold the effects of the scene text that are to change."""
    if not settings.scene or COMPILED.isdisjoint(changed):
        return settings
    scene = _from_text(settings.scene)
    own: dict[str, Any] = {}
    if 'gravity_compensation' in changed:
        scene = replace(scene, gravity_compensation=False)
    if not set(PAYLOAD).isdisjoint(changed):
        payload = _payload_of(scene)
        if payload is not None and settings.payload is None:
            mass, *body = payload_numbers(payload)
            own |= zip(PAYLOAD, (mass, tuple(body[:3]), tuple(body[3:])), strict=True)
        scene = replace(scene, payload=None)
    return replace(settings, **own, scene=pfd.scene_to_yaml(scene))


def _payload_of(scene: pfd.Scene) -> pfd.Payload | None:
    """Return the payload of an arm's scene, which is never an input."""
    assert not isinstance(scene.payload, str)
    return scene.payload
