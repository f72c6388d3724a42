# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a URDF: triangles fixed to links, from its <visual> elements or in their place.

A malformed <visual> or mesh does not keep the others from being drawn: it becomes a line. A link
whose meshes cannot be read, and every link of a URDF without visuals, is drawn as a skeleton from
what dynamics needs: a rod from the frame of the link to each joint on it, the solid box with the
mass and the inertia of the link, or a ball at a frame that has neither.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

import numpy as np
import trimesh
from trimesh.creation import box, cylinder, icosphere

import pfd_core as pfd
from pfd_ros.text import cut
from pfd_ros.view.links import LARGEST, Array, pose_of, reach_of
from pfd_ros.view.meshes import Colour, Meshes

# Most visuals and lines about them; published robots have up to some 200.
MOST_VISUALS, MOST_PROBLEMS = 2000, 5
DEFAULT_COLOUR, SKELETON_COLOUR = (176, 180, 188), (214, 160, 84)
# Radius of a rod, and least and largest edge of a box, as parts of the reach.
ROD, LEAST, LONGEST = 0.018, 0.01, 0.6
# The primitives, their numbers as (attribute, count), and how they are made.
PRIMITIVES: dict[str, tuple[tuple[tuple[str, int], ...], Callable[..., trimesh.Trimesh]]] = {
    'box': ((('size', 3),), lambda *size: box(size)),
    'sphere': ((('radius', 1),), lambda radius: icosphere(3, radius)),
    'cylinder': (
        (('radius', 1), ('length', 1)),
        lambda radius, length: cylinder(radius, length, sections=32),
    ),
}


class Shape(NamedTuple):
    """
    Triangles fixed to a link, in its frame [m].

    `flat`: each triangle is shaded by itself, as edges of boxes and of STL are sharp.
    """

    link: str
    mesh: trimesh.Trimesh
    colour: Colour
    flat: bool


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
    turned = root.get('version', '1.0') != '1.0'
    visuals = [(link, item) for link in root.findall('link') for item in link.findall('visual')]
    for element, visual in visuals[:MOST_VISUALS]:
        link = element.get('name', '')
        try:
            shapes += _shapes(link, visual, named, meshes, turned)
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
    if len(problems) > MOST_PROBLEMS:
        more = f'and {len(problems) - MOST_PROBLEMS} more lines like these'
        problems[MOST_PROBLEMS:] = [more]
    return Drawing(tuple(shapes), tuple(problems))


def _shapes(
    link: str,
    visual: ElementTree.Element,
    named: Mapping[str, Colour | None],
    meshes: Meshes,
    turned: bool,
) -> list[Shape]:
    """Return the shapes of a visual; `turned` where a quaternion may state its axes."""
    origin, material, geometry = map(visual.find, ('origin', 'material', 'geometry'))
    pose = pose_of(*(_numbers(origin, key, 3, (0.0,) * 3) for key in ('xyz', 'rpy')))
    if turned and origin is not None and 'quat_xyzw' in origin.attrib:
        x, y, z, w = _numbers(origin, 'quat_xyzw', 4, ())
        pose[:3, :3] = trimesh.transformations.quaternion_matrix((w, x, y, z))[:3, :3]
    colour = None
    if material is not None:
        colour = _colour(material) or named.get(material.get('name', ''))
    form = next(iter(geometry), None) if geometry is not None else None
    if form is None:
        raise ValueError('it has no <geometry>')
    if form.tag != 'mesh':
        mesh = _primitive(form).apply_transform(pose)
        return [Shape(link, mesh, colour or DEFAULT_COLOUR, form.tag != 'sphere')]
    uri = form.get('filename', '')
    pose[:3, :3] *= _numbers(form, 'scale', 3, (1.0,) * 3)
    try:
        parts = meshes.read(uri)
    except ValueError as error:
        raise UnreadMeshError(uri, str(error)) from error
    # The colour of a material counts only for meshes without colours, as in rviz.
    return [
        Shape(
            link,
            mesh.copy().apply_transform(pose),
            painted or colour or DEFAULT_COLOUR,
            uri.lower().endswith('.stl'),
        )
        for mesh, painted in parts
    ]


def _primitive(form: ElementTree.Element) -> trimesh.Trimesh:
    if form.tag not in PRIMITIVES:
        expected = ', '.join(f'<{name}>' for name in PRIMITIVES)
        raise ValueError(f'<geometry> must be {expected} or <mesh>, got <{cut(str(form.tag))}>')
    keys, made = PRIMITIVES[form.tag]
    numbers = [number for key, count in keys for number in _numbers(form, key, count)]
    if min(numbers) <= 0:
        raise ValueError(f'the numbers of <{form.tag}> must be above 0, got {numbers}')
    return made(*numbers)


def _numbers(
    element: ElementTree.Element | None,
    key: str,
    count: int,
    silent: tuple[float, ...] | None = None,
) -> tuple[float, ...]:
    """Return the numbers of an attribute, `silent` where there is none."""
    text = None if element is None else element.get(key)
    if text is None and silent is not None:
        return silent
    try:
        numbers = tuple(map(float, str(text).split()))
    except ValueError:
        numbers = ()
    # NaN fails the comparison.
    if len(numbers) != count or not all(abs(number) <= LARGEST for number in numbers):
        got = cut(str(text))
        raise ValueError(f'{key} must be {count} numbers up to {LARGEST:g}, got {got!r}')
    return numbers


def _colour(material: ElementTree.Element) -> Colour | None:
    element = material.find('color')
    if element is None:
        return None
    red, green, blue, _ = (round(255 * x) for x in np.clip(_numbers(element, 'rgba', 4), 0, 1))
    return red, green, blue


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
            solids.append(box(edges, pose))
        for solid in solids or [icosphere(3, 1.5 * ROD * reach)]:
            yield Shape(link, solid, SKELETON_COLOUR, bool(solids))


def _rod(end: Array, radius: float) -> trimesh.Trimesh:
    length = float(np.linalg.norm(end))
    pose = np.asarray(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], end / length))
    pose[:3, 3] = end / 2
    return cylinder(radius, min(length, LARGEST), sections=32, transform=pose)


def equivalent_box(mass: float, inertia: Collection[float], reach: float) -> tuple[Array, Array]:
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
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return np.clip(np.sqrt(squares), LEAST * reach, LONGEST * reach), axes
