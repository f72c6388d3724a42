# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What acts on a link in a page: an external wrench as arrows, a payload as a body."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import trimesh

import pfd_core as pfd
from pfd_ros.view.forms import LEAST, LONGEST, Array, Mesh, equivalent_box, reach_of

# As rviz draws a WrenchStamped: force and torque.
FORCE_COLOUR, TORQUE_COLOUR = (204, 51, 51), (204, 170, 20)
PAYLOAD_COLOUR, PAYLOAD_OPACITY, CENTRE_COLOUR = (0, 160, 175), 0.55, (25, 25, 25)
# Radius of the shaft of an arrow and of the mark of a centre of mass, as parts of the reach.
SHAFT, CENTRE = 0.007, 0.014
# The weight of the arm is an arrow of twice its reach [m]; a torque of reach / TORQUE_ARM times
# that force is a circle of the arrow's length.
WEIGHTS, TORQUE_ARM, GRAVITY = 2.0, 5.0, 9.81
# Newtons a metre for a URDF without masses.
NO_MASS = 100.0
# Density [kg/m^3] of the ball that stands for a payload without inertia: aluminium.
DENSITY = 2700.0
# Sides of a shaft, and circles along an arrow that turns.
SIDES, CIRCLES = 20, 40
# The angle of an arrow that turns, without its head, and the radius of its shaft over its own.
ANGLE, TURNING_SHAFT = 1.55 * np.pi, 0.045
# Width and length of heads, in radii of the shaft.
HEAD_WIDTH, HEAD_LENGTH = 2.6, 6.5


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
    """Force [N] of an arrow of 1 m, and torque [N m] of a circle with a radius of 1 m."""

    force: float
    torque: float

    def __str__(self) -> str:
        """Return the scale as a page states it."""
        return f'1 m = {self.force:g} N, radius 1 m = {self.torque:g} N m'

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
    """An external wrench: an arrow from its point of application, and an arrow that turns."""

    def __init__(self, scene: Any, reach: float, scale: Scale) -> None:
        self._scale = scale
        self._shown: Wrench | None = None
        self._turns = [np.eye(4), np.eye(4)]
        radius = SHAFT * reach
        self._head_length = HEAD_LENGTH * radius
        self._nodes = [
            scene.add_frame(f'/wrench/{name}', show_axes=False, visible=False)
            for name in ('force', 'torque')
        ]
        shaft = trimesh.creation.cylinder(radius, segment=[[0, 0, 0], [0, 0, 1]], sections=SIDES)
        head = trimesh.creation.cone(HEAD_WIDTH * radius, self._head_length, sections=SIDES)
        self._shaft, self._head = (
            scene.add_mesh_simple(
                f'/wrench/force/{name}', *arrays(mesh), color=FORCE_COLOUR, flat_shading=True
            )
            for name, mesh in (('shaft', shaft), ('head', head))
        )
        self._turn = scene.add_mesh_simple(
            '/wrench/torque/turn', *turning_arrow(), color=TORQUE_COLOUR
        )
        self._labels = [
            scene.add_label(f'/wrench/{name}/label', '', anchor='bottom-left')
            for name in ('force', 'torque')
        ]

    def show(self, frame: Array | None, wrench: Wrench | None) -> None:
        """Show a wrench at the frame (4, 4) of its link, or none."""
        if wrench != self._shown:
            self._change(wrench)
        if frame is not None:
            for node, turn in zip(self._nodes, self._turns, strict=True):
                place(node, frame @ turn)

    def _change(self, wrench: Wrench | None) -> None:
        """Give the arrows the directions, lengths and labels of another wrench."""
        self._shown = wrench
        vectors = np.zeros((2, 3)) if wrench is None else np.array([wrench.force, wrench.torque])
        newtons, newton_metres = np.linalg.norm(vectors, axis=1).tolist()
        for k, size in enumerate((newtons, newton_metres)):
            self._nodes[k].visible = size > 0
            if size > 0:
                self._turns[k] = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], vectors[k])
        if newtons > 0:
            length = newtons / self._scale.force
            # A short arrow is a small head.
            part = min(1.0, length / self._head_length)
            rest = length - part * self._head_length
            self._head.scale, self._head.position = part, (0.0, 0.0, rest)
            self._shaft.visible = rest > 0
            if rest > 0:
                self._shaft.scale = (1.0, 1.0, rest)
            self._labels[0].position = (0.0, 0.0, length)
            self._labels[0].text = f'{newtons:.3g} N, 1 m = {self._scale.force:g} N'
        if newton_metres > 0:
            radius = newton_metres / self._scale.torque
            self._turn.scale = radius
            self._labels[1].position = (radius, 0.0, 0.0)
            scale = f'radius 1 m = {self._scale.torque:g} N m'
            self._labels[1].text = f'{newton_metres:.3g} N m, {scale}'


class DrawnPayload:
    """A payload: a box with its mass and inertia (a ball without inertia), its centre, a label."""

    def __init__(self, scene: Any, reach: float) -> None:
        self._scene, self._reach = scene, reach
        self._shown: Payload | None = None
        self._node = scene.add_frame('/payload', show_axes=False, visible=False)
        ball = trimesh.creation.icosphere(subdivisions=2, radius=CENTRE * reach)
        self._centre = scene.add_mesh_simple('/payload/centre', *arrays(ball), color=CENTRE_COLOUR)
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
        axes, pose = np.eye(3), np.eye(4)
        if any(payload.inertia):
            mesh, axes = equivalent_box(payload.mass, payload.inertia, self._reach)
        else:
            radius = (3 * payload.mass / (4 * np.pi * DENSITY)) ** (1 / 3)
            radius = float(np.clip(radius, LEAST * self._reach, LONGEST * self._reach))
            mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
        pose[:3, :3], pose[:3, 3] = axes, payload.center
        # Replaces the body before.
        body = self._scene.add_mesh_simple(
            '/payload/body',
            *arrays(mesh),
            color=PAYLOAD_COLOUR,
            opacity=PAYLOAD_OPACITY,
            flat_shading=any(payload.inertia),
            side='double',
        )
        place(body, pose)
        self._centre.position = self._label.position = payload.center
        self._label.text = f'payload {payload.mass:.3g} kg'


def place(node: Any, frame: Array) -> None:
    """Move a node of a page to a frame (4, 4)."""
    node.position = frame[:3, 3]
    node.wxyz = trimesh.transformations.quaternion_from_matrix(frame)


def arrays(mesh: trimesh.Trimesh) -> Mesh:
    """Return vertices and faces of a mesh, as a page takes them."""
    return np.array(mesh.vertices, np.float32), np.array(mesh.faces, np.int32)


def turning_arrow() -> Mesh:
    """Return vertices and faces of an arrow on the circle of 1 m about z, right-handed."""
    angles = np.linspace(0.0, ANGLE, CIRCLES)
    outward = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    forward = np.array([-outward[-1, 1], outward[-1, 0], 0.0])
    tip = outward[-1] + HEAD_LENGTH * TURNING_SHAFT * forward
    # Circles of radius 0 close the ends.
    centres = np.concatenate([outward[:1], outward, outward[-1:], tip[None]])
    around = np.concatenate([outward[:1], outward, outward[-1:], outward[-1:]])
    radii = TURNING_SHAFT * np.array([0.0, *(CIRCLES * [1.0]), HEAD_WIDTH, 0.0])
    turns = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)[:, None]
    sides = np.cos(turns) * around[:, None] + np.sin(turns) * np.array([0.0, 0.0, -1.0])
    vertices = centres[:, None] + radii[:, None, None] * sides
    first = np.arange(len(centres) - 1)[:, None] * SIDES
    side = np.arange(SIDES)
    here, after = first + side, first + (side + 1) % SIDES
    faces = np.stack([[here, here], [after, after + SIDES], [after + SIDES, here + SIDES]], -1)
    return vertices.reshape(-1, 3).astype(np.float32), np.array(faces, np.int32).reshape(-1, 3)
