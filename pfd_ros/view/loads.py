# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What acts on a link: an external wrench, drawn as arrows, and a payload, drawn as a body."""

from __future__ import annotations

from collections.abc import Callable, Container
import math
from typing import Any, NamedTuple

import numpy as np
import trimesh

import pfd_core as pfd
from pfd_ros.arm import events
from pfd_ros.messages.types import INERTIA, WRENCH
from pfd_ros.text import cut
from pfd_ros.view.forms import LEAST, LONGEST, equivalent_box
from pfd_ros.view.links import Array, reach_of

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


class Load(NamedTuple):
    """Numbers in the frame of a link: of a Source."""

    frame: str
    numbers: tuple[float, ...]


class Source(NamedTuple):
    """The messages about a load: type, role, last names of the topic in other logs, and fields."""

    what: str
    type: str
    role: str
    names: tuple[str, ...]
    paths: tuple[str, ...]
    acts: Callable[[tuple[float, ...]], bool]

    def load(
        self,
        frame: str,
        numbers: tuple[float, ...],
        links: Container[str],
        say: Callable[[str], None],
    ) -> Load | None:
        """Return the load of a message, None without one; `say` why it cannot be shown."""
        if not all(map(math.isfinite, numbers)) or not self.acts(numbers):
            return None
        if frame not in links:
            say(f'{self.what} not shown: its frame {cut(frame)!r} is no link of the model')
            return None
        return Load(frame, numbers)


# Force [N] and torque [N m] at the origin of the link.
WRENCHES = Source(
    'wrench',
    WRENCH,
    events.TIP_WRENCH,
    ('external_wrench', 'tip_wrench'),
    tuple(f'wrench.{part}.{axis}' for part in ('force', 'torque') for axis in 'xyz'),
    any,
)
# Mass [kg], centre of mass [m], and xx xy xz yy yz zz about it [kg m^2].
PAYLOADS = Source(
    'payload',
    INERTIA,
    events.PAYLOAD_IN_USE,
    ('payload_in_use', 'payload'),
    tuple(
        f'inertia.{name}'
        for name in ('m', 'com.x', 'com.y', 'com.z', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
    ),
    lambda numbers: numbers[0] > 0.0,
)


class Scale(NamedTuple):
    """Force [N] and torque [N m] of an arrow of 1 m."""

    force: float
    torque: float


def scale_of(urdf: pfd.Urdf) -> Scale:
    """Return the scale of the arrows of a model, by its weight."""
    reach = reach_of(urdf)
    weight = GRAVITY * sum(link.mass for link in urdf.links.values() if link is not None)
    force = _round(weight / (WEIGHTS * reach)) if 0 < weight < math.inf else NO_MASS
    return Scale(force, _round(force * reach / TORQUE_ARM))


def _round(value: float) -> float:
    """Return the nearest of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return min((1, 2, 5, 10), key=lambda n: abs(math.log(n * power / value))) * power


class DrawnLoad:
    """A load in a page, below the node of its name; a subclass draws its numbers."""

    def __init__(self, scene: Any, name: str, reach: float) -> None:
        self._scene, self._name, self._reach = scene, name, reach
        self._shown: Load | None = None
        self._node = scene.add_frame(name, show_axes=False, visible=False)

    def show(self, load: Load | None, frame_of: Callable[[str], Array]) -> None:
        """Show a load at the frame (4, 4) of its link, or none."""
        if load is not None:
            place(self._node, frame_of(load.frame))
        if load != self._shown:
            self._shown = load
            self._node.visible = load is not None
            if load is not None:
                self._draw(np.array(load.numbers))

    def _draw(self, numbers: Array) -> None:
        raise NotImplementedError


class DrawnWrench(DrawnLoad):
    """An arrow along the force, and one with two heads along the torque."""

    def __init__(self, scene: Any, reach: float, scale: Scale) -> None:
        super().__init__(scene, '/wrench', reach)
        self._arrows = []
        for name, colour, heads, unit, size in (
            ('force', FORCE_COLOUR, 1, 'N', scale.force),
            ('torque', TORQUE_COLOUR, 2, 'N m', scale.torque),
        ):
            path, radii = f'/wrench/{name}', {'shaft_radius': SHAFT, 'head_radius': HEAD}
            radii = {key: share * reach for key, share in radii.items()}
            arrow = scene.add_arrows(path, np.zeros((heads, 2, 3)), colour, **radii)
            label = scene.add_label(f'{path}/label', '', anchor='bottom-left')
            self._arrows.append((arrow, label, unit, size))

    def _draw(self, numbers: Array) -> None:
        for (arrow, label, unit, size), vector in zip(
            self._arrows, numbers.reshape(2, 3), strict=True
        ):
            amount, end, heads = float(np.linalg.norm(vector)), vector / size, len(arrow.points)
            arrow.visible = label.visible = amount > 0
            if amount > 0:
                length = amount / size
                # A short arrow is a small head.
                arrow.head_length = head = min(HEAD_LENGTH * self._reach, length / heads)
                ends = [end * (1 - k * head / length) for k in range(heads)]
                arrow.points = np.array([[np.zeros(3), point] for point in ends], np.float32)
                label.position, label.text = end, f'{amount:.3g} {unit}, 1 m = {size:g} {unit}'


class DrawnPayload(DrawnLoad):
    """The box with its mass and inertia (a ball without inertia), its centre of mass, a label."""

    def __init__(self, scene: Any, reach: float) -> None:
        super().__init__(scene, '/payload', reach)
        mark = {'radius': CENTRE * reach, 'color': CENTRE_COLOUR}
        self._centre = scene.add_icosphere('/payload/centre', **mark)
        self._label = scene.add_label('/payload/label', '', anchor='top-right')

    def _draw(self, numbers: Array) -> None:
        (mass,), centre, inertia = np.split(numbers, (1, 4))
        look = {'color': PAYLOAD_COLOUR, 'opacity': PAYLOAD_OPACITY}
        # Each replaces the body before.
        if inertia.any():
            edges, axes = equivalent_box(mass, inertia, self._reach)
            body = self._scene.add_box('/payload/body', dimensions=tuple(edges), **look)
            place(body, np.block([[axes, centre[:, None]], [np.zeros((1, 3)), 1.0]]))
        else:
            radius = (3 * mass / (4 * np.pi * DENSITY)) ** (1 / 3)
            radius = float(np.clip(radius, LEAST * self._reach, LONGEST * self._reach))
            self._scene.add_icosphere('/payload/body', radius=radius, position=centre, **look)
        self._centre.position = self._label.position = centre
        self._label.text = f'payload {mass:.3g} kg'


def place(node: Any, frame: Array) -> None:
    """Move a node of a page to a frame (4, 4)."""
    node.position = frame[:3, 3]
    node.wxyz = trimesh.transformations.quaternion_from_matrix(frame)
