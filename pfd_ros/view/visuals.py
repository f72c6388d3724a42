# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The <visual> elements of a URDF: geometry, placement and colour, still without triangles.

A malformed <visual> does not keep the others from being drawn: it becomes a problem, one line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import xml.etree.ElementTree as ElementTree

import numpy as np
from numpy.typing import NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.text import cut

# Largest length [m] that is drawn, and most visuals; published robots have up to some 200.
LARGEST = 1e3
MOST_VISUALS = 2000
DEFAULT_COLOUR = (176, 180, 188)
Colour = tuple[int, int, int]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A box by its edges [m], centred."""

    size: Triple


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z [m], centred."""

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere [m], centred."""

    radius: float


@dataclass(frozen=True)
class MeshFile:
    """A mesh of a file, by its URI as written, and its scale along x, y and z."""

    uri: str
    scale: Triple


Geometry = Box | Cylinder | Sphere | MeshFile


@dataclass(frozen=True, eq=False)
class Visual:
    """
    A <visual>.

    Attributes
    ----------
    link : str
        Name of its link.
    geometry : Box, Cylinder, Sphere or MeshFile
        Its form.
    pose : ndarray, (4, 4)
        Its frame in the frame of the link.
    colour : tuple of int, or None
        Red, green and blue, 0 to 255; None if the URDF has no colour for it.

    """

    link: str
    geometry: Geometry
    pose: NDArray[np.float64]
    colour: Colour | None


def visuals_of(urdf: pfd.Urdf) -> tuple[list[Visual], list[str]]:
    """Return the visuals of a URDF, MOST_VISUALS at most, and a line for each left out."""
    root = ElementTree.fromstring(urdf.text.strip())
    found: list[Visual] = []
    problems: list[str] = []
    named: dict[str, Colour] = {}
    for material in root.findall('material'):
        try:
            colour = _colour(material)
        except ValueError as error:
            problems.append(f'material {cut(material.get("name", ""))!r}: {error}')
            continue
        if colour is not None:
            named[material.get('name', '')] = colour
    elements = [(link, item) for link in root.findall('link') for item in link.findall('visual')]
    for link, element in elements[:MOST_VISUALS]:
        name = link.get('name', '')
        try:
            found.append(_visual(name, element, named))
        except ValueError as error:
            problems.append(f'visual of link {cut(name)!r}: {error}')
    if len(elements) > MOST_VISUALS:
        problems.append(f'only the first {MOST_VISUALS} of {len(elements)} visuals are drawn')
    return found, problems


def pose_of(xyz: Triple, rpy: Triple) -> NDArray[np.float64]:
    """Return the frame of an <origin> as a matrix (4, 4)."""
    pose: NDArray[np.float64] = np.asarray(trimesh.transformations.euler_matrix(*rpy, 'sxyz'))
    pose[:3, 3] = xyz
    return pose


def _visual(link: str, element: ElementTree.Element, named: Mapping[str, Colour]) -> Visual:
    origin, material = element.find('origin'), element.find('material')
    pose = pose_of(_triple(origin, 'xyz'), _triple(origin, 'rpy'))
    colour = None
    if material is not None:
        colour = _colour(material) or named.get(material.get('name', ''))
    return Visual(link, _geometry(element.find('geometry')), pose, colour)


def _geometry(element: ElementTree.Element | None) -> Geometry:
    shape = next(iter(element), None) if element is not None else None
    if shape is None:
        raise ValueError('it has no <geometry>')
    if shape.tag == 'box':
        x, y, z = _positive(shape, _numbers(shape, 'size', 3))
        return Box((x, y, z))
    if shape.tag == 'sphere':
        return Sphere(*_positive(shape, _numbers(shape, 'radius', 1)))
    if shape.tag == 'cylinder':
        radius, length = (_numbers(shape, key, 1)[0] for key in ('radius', 'length'))
        return Cylinder(*_positive(shape, (radius, length)))
    if shape.tag == 'mesh':
        return MeshFile(shape.get('filename', ''), _triple(shape, 'scale', (1.0, 1.0, 1.0)))
    raise ValueError(
        f'<geometry> must be <box>, <cylinder>, <sphere> or <mesh>, got <{cut(str(shape.tag))}>'
    )


def _positive(element: ElementTree.Element, numbers: tuple[float, ...]) -> tuple[float, ...]:
    if min(numbers) <= 0:
        raise ValueError(f'<{element.tag}> must have positive numbers, got {numbers}')
    return numbers


def _triple(
    element: ElementTree.Element | None, key: str, silent: Triple = (0.0, 0.0, 0.0)
) -> Triple:
    if element is None or element.get(key) is None:
        return silent
    x, y, z = _numbers(element, key, 3)
    return x, y, z


def _numbers(element: ElementTree.Element, key: str, count: int) -> tuple[float, ...]:
    text = element.get(key, '')
    try:
        numbers = tuple(map(float, text.split()))
    except ValueError:
        numbers = ()
    # NaN fails the comparison.
    if len(numbers) != count or not all(abs(number) <= LARGEST for number in numbers):
        raise ValueError(
            f'<{element.tag} {key}> must be {count} numbers up to {LARGEST:g}, got {cut(text)!r}'
        )
    return numbers


def _colour(material: ElementTree.Element) -> Colour | None:
    element = material.find('color')
    if element is None:
        return None
    red, green, blue, _ = (
        round(255 * min(max(part, 0.0), 1.0)) for part in _numbers(element, 'rgba', 4)
    )
    return red, green, blue
