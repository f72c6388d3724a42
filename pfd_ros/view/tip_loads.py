# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What acts on the last link in a page: the external wrench as arrows, the payload as a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.messages.stamped import InertiaMessage, WrenchMessage
from pfd_ros.view import arrows
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.scene import place
from pfd_ros.view.skeleton import LEAST, LONGEST, equivalent_box, reach_of

# As rviz draws a WrenchStamped: force and torque.
FORCE_COLOUR, TORQUE_COLOUR = (204, 51, 51), (204, 170, 20)
PAYLOAD_COLOUR, PAYLOAD_OPACITY, CENTRE_COLOUR = (0, 160, 175), 0.55, (25, 25, 25)
# Radius of the shaft of an arrow and of the mark of a centre of mass, as parts of the reach.
SHAFT, CENTRE = 0.007, 0.014
# The weight of the arm is an arrow of twice its reach [m]; a torque of reach / TORQUE_ARM times
# that force is a circle of the arrow's length.
WEIGHTS, TORQUE_ARM = 2.0, 5.0
GRAVITY = 9.81
# Of an arrow that has no length yet.
UNSEEN = 1e-3
# Newtons a metre for a URDF without masses.
NO_MASS = 100.0
# Density [kg/m^3] of the ball that stands for a payload without inertia: aluminium.
DENSITY = 2700.0
WRENCH_LEGEND = 'Red arrow: external force on the last link; yellow: external torque. Scale: {}.'
PAYLOAD_LEGEND = (
    'Turquoise body: the payload, a box with its mass and inertia, or a ball without inertia; '
    'black: its centre of mass.'
)


@dataclass(frozen=True)
class Scale:
    """Force [N] of an arrow of 1 m, and torque [N m] of a circle with a radius of 1 m."""

    force: float
    torque: float

    def __str__(self) -> str:
        """Return the scale as a page states it."""
        return f'1 m = {self.force:g} N, radius 1 m = {self.torque:g} N m'


def scale_of(urdf: pfd.Urdf, force: float | None = None) -> Scale:
    """Return a force [N] of an arrow of 1 m, by default of the weight of a model, as a scale."""
    reach = reach_of(urdf)
    if force is None:
        mass = sum(link.mass for link in urdf.links.values() if link is not None)
        weight = GRAVITY * mass
        force = _round(weight / (WEIGHTS * reach)) if 0 < weight < math.inf else NO_MASS
    return Scale(force, _round(force * reach / TORQUE_ARM))


def _round(value: float) -> float:
    """Return the nearest of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return min((1, 2, 5, 10), key=lambda n: abs(math.log(n * power / value))) * power


class DrawnWrench:
    """
    An external wrench in a page: an arrow from its point of application, and one that turns.

    Parameters
    ----------
    scene : viser.SceneApi
        The page's scene.
    poses : LinkPoses
        The frames of the links.
    reach : float
        Of the arm [m].
    scale : Scale
        Of the arrows.
    first : WrenchMessage, optional
        The first wrench that will be shown. A browser shows and moves a node at once, and changes
        its size some frames later.

    """

    def __init__(
        self,
        scene: Any,
        poses: LinkPoses,
        reach: float,
        scale: Scale,
        first: WrenchMessage | None = None,
    ) -> None:
        self._poses, self._scale = poses, scale
        self._shown: WrenchMessage | None = None
        self._along_force = self._about_torque = np.eye(4)
        radius = SHAFT * reach
        self._head_length = arrows.HEAD_LENGTH * radius
        self._force = scene.add_frame('/wrench/force', show_axes=False, visible=False)
        self._torque = scene.add_frame('/wrench/torque', show_axes=False, visible=False)
        self._shaft, self._head = (
            scene.add_mesh_simple(
                f'/wrench/force/{name}', *mesh, color=FORCE_COLOUR, flat_shading=True, scale=UNSEEN
            )
            for name, mesh in (('shaft', arrows.shaft(radius)), ('head', arrows.head(radius)))
        )
        self._turn = scene.add_mesh_simple(
            '/wrench/torque/turn', *arrows.turning_arrow(), color=TORQUE_COLOUR, scale=UNSEEN
        )
        self._labels = [
            scene.add_label(f'/wrench/{name}/label', '', anchor='bottom-left')
            for name in ('force', 'torque')
        ]
        self._change(first)
        self._change(None)

    def show(self, frames: NDArray[np.float64], wrench: WrenchMessage | None) -> None:
        """Show a wrench at frames of all links (links, 4, 4); its frame must be one of them."""
        if wrench != self._shown:
            self._change(wrench)
        if wrench is None:
            return
        frame = frames[self._poses.index(wrench.frame_id)]
        for node, local in ((self._force, self._along_force), (self._torque, self._about_torque)):
            place(node, frame @ local)

    def _change(self, wrench: WrenchMessage | None) -> None:
        """Give the arrows the directions, lengths and labels of another wrench."""
        self._shown = wrench
        force, torque = np.zeros((2, 3)) if wrench is None else (wrench.force, wrench.torque)
        newtons, newton_metres = float(np.linalg.norm(force)), float(np.linalg.norm(torque))
        self._force.visible, self._torque.visible = newtons > 0, newton_metres > 0
        if newtons > 0:
            self._along_force = _along(force)
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
            self._about_torque = _along(torque)
            radius = newton_metres / self._scale.torque
            self._turn.scale = radius
            self._labels[1].position = (radius, 0.0, 0.0)
            scale = f'radius 1 m = {self._scale.torque:g} N m'
            self._labels[1].text = f'{newton_metres:.3g} N m, {scale}'


class DrawnPayload:
    """
    A payload in a page: a body with its mass and inertia, its centre of mass, and a label.

    Parameters
    ----------
    scene : viser.SceneApi
        The page's scene.
    poses : LinkPoses
        The frames of the links.
    reach : float
        Of the arm [m].

    """

    def __init__(self, scene: Any, poses: LinkPoses, reach: float) -> None:
        self._scene, self._poses, self._reach = scene, poses, reach
        self._shown: InertiaMessage | None = None
        self._node = scene.add_frame('/payload', show_axes=False, visible=False)
        self._body: Any = None
        ball = trimesh.creation.icosphere(subdivisions=2, radius=CENTRE * reach)
        self._centre = scene.add_mesh_simple(
            '/payload/centre',
            np.array(ball.vertices, np.float32),
            np.array(ball.faces, np.int32),
            color=CENTRE_COLOUR,
        )
        self._label = scene.add_label('/payload/label', '', anchor='top-right')

    def show(self, frames: NDArray[np.float64], payload: InertiaMessage | None) -> None:
        """Show a payload at frames of all links (links, 4, 4); its frame must be one of them."""
        if payload != self._shown:
            self._change(payload)
        if payload is not None:
            place(self._node, frames[self._poses.index(payload.frame_id)])

    def _change(self, payload: InertiaMessage | None) -> None:
        self._shown = payload
        self._node.visible = payload is not None
        if payload is None:
            return
        mesh, axes = payload_body(payload, self._reach)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = axes, payload.center
        # Replaces the one before.
        self._body = self._scene.add_mesh_simple(
            '/payload/body',
            np.array(mesh.vertices, np.float32),
            np.array(mesh.faces, np.int32),
            color=PAYLOAD_COLOUR,
            opacity=PAYLOAD_OPACITY,
            flat_shading=len(mesh.faces) == 12,
            side='double',
        )
        place(self._body, pose)
        self._centre.position = self._label.position = payload.center
        self._label.text = f'payload {payload.mass:.3g} kg'


def payload_body(
    payload: InertiaMessage, reach: float
) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
    """
    Return the form of a payload about its centre of mass, and its axes (3, 3) as columns.

    The form is the solid box with the mass and the inertia; without inertia a ball of DENSITY.
    """
    xx, xy, xz, yy, yz, zz = payload.inertia
    if any(payload.inertia):
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        box, axes = equivalent_box(payload.mass, inertia, reach)
        return trimesh.creation.box(box.size), axes
    radius = (3 * payload.mass / (4 * np.pi * DENSITY)) ** (1 / 3)
    radius = float(np.clip(radius, LEAST * reach, LONGEST * reach))
    return trimesh.creation.icosphere(subdivisions=3, radius=radius), np.eye(3)


def _along(vector: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transform (4, 4) that turns z along a vector (3,)."""
    return np.array(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], vector))
