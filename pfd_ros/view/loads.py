# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What acts on a link in a page: an external wrench as arrows, a payload as a body."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import trimesh

import pfd_core as pfd
from pfd_ros.view.forms import LEAST, LONGEST, Array, equivalent_box, reach_of

# As rviz draws a WrenchStamped: force and torque.
FORCE_COLOUR, TORQUE_COLOUR = (204, 51, 51), (204, 170, 20)
PAYLOAD_COLOUR, PAYLOAD_OPACITY, CENTRE_COLOUR = (0, 160, 175), 0.55, (25, 25, 25)
# Radius of the shaft of an arrow, radius and length of its head, and radius of the mark of a
# centre of mass, as parts of the reach.
SHAFT, HEAD, HEAD_LENGTH, CENTRE = 0.009, 0.024, 0.06, 0.014
# The weight of the arm is an arrow of twice its reach [m]; a torque of reach / TORQUE_ARM times
# that force is an arrow of the same length.
WEIGHTS, TORQUE_ARM, GRAVITY = 2.0, 5.0, 9.81
# Newtons a metre for a URDF without masses.
NO_MASS = 100.0
# Density [kg/m^3] of the ball that stands for a payload without inertia: aluminium.
DENSITY = 2700.0


class Wrench(NamedTuple):
    """A force (3,) [N] and a torque (3,) [N m] at the origin and in the axes of a link."""

    frame: str
    force: tuple[float, ...]
    torque: tuple[float, ...]


class Payload(NamedTuple):
    """Mass [kg], centre of mass (3,) [m] in a link, and xx xy xz yy yz zz about it [kg m^2]."""

    frame: str
    mass: float
    center: tuple[float, ...]
    inertia: tuple[float, ...]


class Scale(NamedTuple):
    """Force [N] and torque [N m] of an arrow of 1 m."""

    force: float
    torque: float

    def __str__(self) -> str:
        """Return the scale as a page states it."""
        return f'1 m = {self.force:g} N, 1 m = {self.torque:g} N m'

    @classmethod
    def of(cls, urdf: pfd.Urdf) -> Scale:
        """Return the scale for a model, by its weight."""
        reach = reach_of(urdf)
        weight = GRAVITY * sum(link.mass for link in urdf.links.values() if link is not None)
        force = _round(weight / (WEIGHTS * reach)) if 0 < weight < math.inf else NO_MASS
        return cls(force, _round(force * reach / TORQUE_ARM))


def _round(value: float) -> float:
    """Return the nearest of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return min((1, 2, 5, 10), key=lambda n: abs(math.log(n * power / value))) * power


class DrawnWrench:
    """An external wrench: an arrow along the force, and one with two heads along the torque."""

    def __init__(self, scene: Any, reach: float, scale: Scale) -> None:
        self._shown: Wrench | None = None
        self._head = HEAD_LENGTH * reach
        self._node = scene.add_frame('/wrench', show_axes=False, visible=False)
        self._arrows = []
        for name, colour, heads, unit, size in (
            ('force', FORCE_COLOUR, 1, 'N', scale.force),
            ('torque', TORQUE_COLOUR, 2, 'N m', scale.torque),
        ):
            arrow = scene.add_arrows(
                f'/wrench/{name}',
                np.zeros((heads, 2, 3)),
                colour,
                shaft_radius=SHAFT * reach,
                head_radius=HEAD * reach,
            )
            label = scene.add_label(f'/wrench/{name}/label', '', anchor='bottom-left')
            self._arrows.append((arrow, label, unit, size))

    def show(self, frame: Array | None, wrench: Wrench | None) -> None:
        """Show a wrench at the frame (4, 4) of its link, or none."""
        if wrench != self._shown:
            self._shown = wrench
            self._node.visible = wrench is not None
            if wrench is not None:
                for arrow, vector in zip(self._arrows, wrench[1:], strict=True):
                    self._change(*arrow, np.array(vector))
        if frame is not None:
            place(self._node, frame)

    def _change(self, arrow: Any, label: Any, unit: str, size: float, vector: Array) -> None:
        amount, end = float(np.linalg.norm(vector)), vector / size
        arrow.visible = label.visible = amount > 0
        if amount > 0:
            length = amount / size
            # A short arrow is a small head.
            arrow.head_length = head = min(self._head, length / len(arrow.points))
            ends = [end * (1 - k * head / length) for k in range(len(arrow.points))]
            arrow.points = np.array([[np.zeros(3), point] for point in ends], np.float32)
            label.position, label.text = end, f'{amount:.3g} {unit}, 1 m = {size:g} {unit}'


class DrawnPayload:
    """A payload: a box with its mass and inertia (a ball without inertia), its centre, a label."""

    def __init__(self, scene: Any, reach: float) -> None:
        self._scene, self._reach = scene, reach
        self._shown: Payload | None = None
        self._node = scene.add_frame('/payload', show_axes=False, visible=False)
        self._centre = scene.add_icosphere(
            '/payload/centre', radius=CENTRE * reach, color=CENTRE_COLOUR
        )
        self._label = scene.add_label('/payload/label', '', anchor='top-right')

    def show(self, frame: Array | None, payload: Payload | None) -> None:
        """Show a payload at the frame (4, 4) of its link, or none."""
        if payload != self._shown:
            self._shown = payload
            self._node.visible = payload is not None
            if payload is not None:
                self._change(payload)
        if frame is not None:
            place(self._node, frame)

    def _change(self, payload: Payload) -> None:
        look = {'color': PAYLOAD_COLOUR, 'opacity': PAYLOAD_OPACITY}
        # Each replaces the body before.
        if any(payload.inertia):
            edges, axes = equivalent_box(payload.mass, payload.inertia, self._reach)
            body = self._scene.add_box('/payload/body', dimensions=edges, **look)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = axes, payload.center
            place(body, pose)
        else:
            radius = (3 * payload.mass / (4 * np.pi * DENSITY)) ** (1 / 3)
            radius = float(np.clip(radius, LEAST * self._reach, LONGEST * self._reach))
            at = payload.center
            self._scene.add_icosphere('/payload/body', radius=radius, position=at, **look)
        self._centre.position = self._label.position = payload.center
        self._label.text = f'payload {payload.mass:.3g} kg'


def place(node: Any, frame: Array) -> None:
    """Move a node of a page to a frame (4, 4)."""
    node.position = frame[:3, 3]
    node.wxyz = trimesh.transformations.quaternion_from_matrix(frame)
