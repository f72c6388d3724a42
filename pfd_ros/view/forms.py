# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a URDF: triangles fixed to links, from its <visual> elements or in their place.

A malformed <visual> or mesh does not keep the others from being drawn: it becomes a line. A link
whose meshes cannot be read, and every link of a URDF without visuals, is drawn as a skeleton from
what dynamics needs: a rod from the frame of the link to each joint on it, the solid box with the
mass and the inertia of the link, or a ball at a frame that has neither.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
import os
from pathlib import Path
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

import numpy as np
from numpy.typing import NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.text import cut
from pfd_ros.view.meshes import Colour, Meshes

# Largest length [m] that is drawn, and most visuals; published robots have up to some 200.
LARGEST, MOST_VISUALS, MOST_PROBLEMS = 1e3, 2000, 5
DEFAULT_COLOUR, SKELETON_COLOUR = (176, 180, 188), (214, 160, 84)
# Radius of a rod, and least and largest edge of a box, as parts of the reach.
ROD, LEAST, LONGEST = 0.018, 0.01, 0.6
# Reach [m] of an arm whose frames all coincide.
NO_REACH = 1.0
Array = NDArray[np.float64]
Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]


class Shape(NamedTuple):
    """
    Triangles fixed to a link.

    `flat`: each triangle is shaded by itself, as edges of boxes and of STL are sharp. `stands_in`:
    drawn in place of a visual that the URDF lacks or that cannot be read.
    """

    link: str
    vertices: NDArray[np.float32]  # (V, 3) in the frame of the link [m]
    faces: NDArray[np.int32]  # (F, 3)
    colour: Colour
    flat: bool
    stands_in: bool = False


class Drawing(NamedTuple):
    """The shapes of an arm, and a line for what is not drawn as the URDF says."""

    shapes: tuple[Shape, ...]
    problems: tuple[str, ...]


class UnreadMeshError(ValueError):
    """A mesh that cannot be read: its URI and the reason."""


def draw(urdf: pfd.Urdf, meshes: Meshes) -> Drawing:
    """Return what is drawn of a URDF."""
    root = ElementTree.fromstring(urdf.text.strip())
    problems: list[str] = []
    named: dict[str, Colour | None] = {}
    for material in root.findall('material'):
        try:
            named[material.get('name', '')] = _colour(material)
        except ValueError as error:
            problems.append(f'material {cut(material.get("name", ""))!r}: {error}')
    shapes: list[Shape] = []
    missing: dict[str, str] = {}
    unread: set[str] = set()
    visuals = [(link, item) for link in root.findall('link') for item in link.findall('visual')]
    for element, visual in visuals[:MOST_VISUALS]:
        link = element.get('name', '')
        try:
            shapes += list(_shapes(link, visual, named, meshes))
        except UnreadMeshError as error:
            unread.add(link)
            missing.setdefault(*error.args)
        except ValueError as error:
            unread.add(link)
            problems.append(f'visual of link {cut(link)!r}: {error}')
    if missing:
        uris = {mesh.get('filename') for _, visual in visuals for mesh in visual.iter('mesh')}
        first, reason = next(iter(missing.items()))
        line = f'{len(missing)} of {len(uris)} meshes are not read, their links are drawn as a'
        problems.insert(0, f'{line} skeleton; {cut(first, 120)!r}: {reason}')
    if len(visuals) > MOST_VISUALS:
        problems.append(f'only the first {MOST_VISUALS} of {len(visuals)} visuals are drawn')
    drawn = {shape.link for shape in shapes}
    # A frame without a form among links with forms is drawn as its author wanted, not at all.
    shapes += _skeleton(urdf, (unread if drawn or unread else set(urdf.links)) - drawn)
    if not visuals and not problems:
        problems.append('the URDF has no visuals: the arm is drawn as a skeleton')
    more = len(problems) - MOST_PROBLEMS
    also = [f'and {more} more lines like these'] if more > 0 else []
    return Drawing(tuple(shapes), (*problems[:MOST_PROBLEMS], *also))


def named_model(robot: str) -> tuple[pfd.Urdf, Path | None]:
    """Return the model of a robot, as `load_robot` takes it, and the folder of its file."""
    urdf = pfd.read_urdf(robot) or parsed_urdf(pfd.urdf_of(robot), robot)
    return urdf, Path(robot).absolute().parent if os.path.isfile(robot) else None


def parsed_urdf(text: str, label: str) -> pfd.Urdf:
    """Return the model of a URDF's text; ValueError, with the label, for another text."""
    # Other text would be taken for the name of a robot or a file.
    urdf = pfd.read_urdf(text) if text.lstrip().startswith('<') else None
    if urdf is None:
        raise ValueError(f'{label} is not a URDF: it starts with {cut(text[:20])!r}')
    return urdf


def pose_of(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Array:
    """Return a frame (4, 4) from x, y, z [m] and roll, pitch, yaw [rad]."""
    pose: Array = np.asarray(trimesh.transformations.euler_matrix(*rpy, 'sxyz'))
    pose[:3, 3] = xyz
    return pose


def _shapes(
    link: str, visual: ElementTree.Element, named: Mapping[str, Colour | None], meshes: Meshes
) -> Iterator[Shape]:
    origin, material, geometry = map(visual.find, ('origin', 'material', 'geometry'))
    pose = pose_of(_triple(origin, 'xyz'), _triple(origin, 'rpy'))
    colour = None
    if material is not None:
        colour = _colour(material) or named.get(material.get('name', ''))
    form = next(iter(geometry), None) if geometry is not None else None
    if form is None:
        raise ValueError('it has no <geometry>')
    if form.tag != 'mesh':
        placed = _placed(_primitive(form), pose)
        yield Shape(link, *placed, colour or DEFAULT_COLOUR, flat=form.tag != 'sphere')
        return
    uri, scale = form.get('filename', ''), _triple(form, 'scale', (1.0, 1.0, 1.0))
    try:
        parts = meshes.read(uri)
    except ValueError as error:
        raise UnreadMeshError(uri, str(error)) from error
    for part in parts:
        vertices = part.vertices * np.array(scale) @ pose[:3, :3].T + pose[:3, 3]
        # A mirrored mesh has its inside out.
        faces = part.faces[:, ::-1] if np.prod(scale) < 0 else part.faces
        # The colour of a material counts only for meshes without colours, as in rviz.
        painted, flat = part.colour or colour or DEFAULT_COLOUR, uri.lower().endswith('.stl')
        yield Shape(link, vertices.astype(np.float32), np.ascontiguousarray(faces), painted, flat)


def _primitive(form: ElementTree.Element) -> trimesh.Trimesh:
    if form.tag == 'box':
        return trimesh.creation.box(_positive(form, 'size', 3))
    if form.tag not in ('cylinder', 'sphere'):
        expected = '<box>, <cylinder>, <sphere> or <mesh>'
        raise ValueError(f'<geometry> must be {expected}, got <{cut(str(form.tag))}>')
    (radius,) = _positive(form, 'radius', 1)
    if form.tag == 'sphere':
        return trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return trimesh.creation.cylinder(radius, *_positive(form, 'length', 1), sections=32)


def _positive(element: ElementTree.Element, key: str, count: int) -> tuple[float, ...]:
    numbers = _numbers(element, key, count)
    if min(numbers) <= 0:
        raise ValueError(f'<{element.tag} {key}> must be above 0, got {numbers}')
    return numbers


def _triple(
    element: ElementTree.Element | None,
    key: str,
    silent: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[float, float, float]:
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
    parts = [min(max(part, 0.0), 1.0) for part in _numbers(element, 'rgba', 4)]
    red, green, blue = (round(255 * part) for part in parts[:3])
    return red, green, blue


def _placed(mesh: trimesh.Trimesh, pose: Array) -> Mesh:
    mesh.apply_transform(pose)
    return np.array(mesh.vertices, np.float32), np.array(mesh.faces, np.int32)


def _skeleton(urdf: pfd.Urdf, links: Collection[str]) -> Iterator[Shape]:
    reach = reach_of(urdf)
    for link, inertial in urdf.links.items():
        if link not in links:
            continue
        ends = [joint.origin.xyz for joint in urdf.joints.values() if joint.parent == link]
        solids = [_rod(np.array(end), ROD * reach) for end in ends if any(end)]
        if inertial is not None and inertial.mass > 0:
            edges, axes = equivalent_box(inertial.mass, inertial.inertia, reach)
            pose = pose_of(*inertial.origin)
            pose[:3, :3] = pose[:3, :3] @ axes
            solids.append(_placed(trimesh.creation.box(edges), pose))
        for solid in solids:
            yield Shape(link, *solid, SKELETON_COLOUR, True, True)
        if not solids:
            ball = trimesh.creation.icosphere(subdivisions=3, radius=1.5 * ROD * reach)
            yield Shape(link, *_placed(ball, np.eye(4)), SKELETON_COLOUR, False, True)


def reach_of(urdf: pfd.Urdf) -> float:
    """Return the length [m] of the longest chain of joints, a scale for what is drawn."""
    lengths: dict[str, float] = dict.fromkeys(urdf.links, 0.0)
    for _ in urdf.links:
        changed = False
        for joint in urdf.joints.values():
            length = lengths.get(joint.parent, 0.0) + float(np.linalg.norm(joint.origin.xyz))
            if length > lengths.get(joint.child, 0.0):
                lengths[joint.child] = length
                changed = True
        if not changed:
            break
    longest = max(lengths.values())
    return min(longest, LARGEST) if longest > 0 else NO_REACH


def _rod(end: Array, radius: float) -> Mesh:
    length = float(np.linalg.norm(end))
    pose = np.asarray(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], end / length))
    pose[:3, 3] = end / 2
    rod = trimesh.creation.cylinder(radius, min(length, LARGEST), sections=32)
    return _placed(rod, pose)


def equivalent_box(
    mass: float, inertia: Collection[float], reach: float
) -> tuple[tuple[float, ...], Array]:
    """
    Return the edges of the box with a mass [kg] above 0 and an inertia, and its axes as columns.

    The inertia is xx, xy, xz, yy, yz and zz about the centre of mass [kg m^2]; edges are LEAST to
    LONGEST of the reach [m].
    """
    xx, xy, xz, yy, yz, zz = inertia
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # Of a box m (b^2 + c^2) / 12 = moment about a, and so on.
    with np.errstate(over='ignore', invalid='ignore'):
        squares = 6.0 / mass * (moments.sum() - 2 * moments)
    # A tiny mass gives infinity, or NaN.
    squares = np.nan_to_num(np.maximum(squares, 0.0))
    edges = np.clip(np.sqrt(squares), LEAST * reach, LONGEST * reach)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return tuple(edges.tolist()), axes
