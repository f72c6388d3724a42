# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is drawn of an arm: triangles fixed to links, from the URDF's visuals or in their place.

A link whose meshes cannot be read, and every link of a URDF without visuals, is drawn as a
skeleton: see `skeleton`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.text import cut
from pfd_ros.view.mesh_files import MeshFolders, Triangles, read_mesh
from pfd_ros.view.skeleton import skeleton_of
from pfd_ros.view.visuals import (
    DEFAULT_COLOUR,
    Box,
    Colour,
    Cylinder,
    Geometry,
    MeshFile,
    Sphere,
    Visual,
    visuals_of,
)

# Of all meshes together: what a browser draws at a few frames a second, and what is read at most.
MOST_TRIANGLES = 3_000_000
MOST_BYTES = 256 * 2**20
SKELETON_COLOUR = (214, 160, 84)
MOST_PROBLEMS = 5


@dataclass(frozen=True, eq=False)
class Shape:
    """
    Triangles fixed to a link.

    Attributes
    ----------
    link : str
        Its name.
    vertices : ndarray of float32, (V, 3)
        In the frame of the link [m].
    faces : ndarray of int32, (F, 3)
        Vertices of each triangle.
    colour : tuple of int
        Red, green and blue, 0 to 255.
    flat : bool
        Whether each triangle is shaded by itself, as edges of boxes and of STL are sharp.
    stands_in : bool
        Whether it is drawn in place of a visual that the URDF lacks or that cannot be read.

    """

    link: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    colour: Colour
    flat: bool
    stands_in: bool = False


@dataclass(frozen=True)
class Drawing:
    """The shapes of an arm, and lines on what of it is not drawn as the URDF says."""

    shapes: tuple[Shape, ...]
    problems: tuple[str, ...]


def draw(urdf: pfd.Urdf, folders: MeshFolders) -> Drawing:
    """
    Return what is drawn of a URDF.

    Parameters
    ----------
    urdf : Urdf
        The model.
    folders : MeshFolders
        Where its meshes are.

    """
    visuals, problems = visuals_of(urdf)
    shapes: list[Shape] = []
    missing: dict[str, str] = {}
    unread: set[str] = set()
    files = _Files(folders)
    for visual in visuals:
        try:
            shapes += _shapes(visual, files)
        except (ValueError, OSError) as error:
            unread.add(visual.link)
            if isinstance(visual.geometry, MeshFile):
                missing.setdefault(visual.geometry.uri, str(error))
    if missing:
        first, reason = next(iter(missing.items()))
        problems.insert(
            0,
            f'{len(missing)} of {len(files.uris(visuals))} meshes are not read, their links are '
            f'drawn as a skeleton; {cut(first, 120)!r}: {reason}',
        )
    drawn = {shape.link for shape in shapes}
    # A frame without a form among links with forms is drawn as its author wanted, not at all.
    bare = (unread if drawn or unread else set(urdf.links)) - drawn
    shapes += [
        Shape(
            solid.link,
            *_primitive(solid.geometry, solid.pose),
            SKELETON_COLOUR,
            not isinstance(solid.geometry, Sphere),
            True,
        )
        for solid in skeleton_of(urdf, bare)
    ]
    if not visuals and not problems:
        problems.append('the URDF has no visuals: the arm is drawn as a skeleton')
    more = len(problems) - MOST_PROBLEMS
    shown = problems[:MOST_PROBLEMS] + ([f'and {more} more lines like these'] if more > 0 else [])
    return Drawing(tuple(shapes), tuple(shown))


class _Files:
    """The meshes that were read, each once."""

    def __init__(self, folders: MeshFolders) -> None:
        self._folders = folders
        self._read: dict[str, list[Triangles] | str] = {}
        self._count = self._bytes = 0

    def read(self, uri: str) -> list[Triangles]:
        if uri not in self._read:
            try:
                path = self._folders.find(uri)
                self._bytes += path.stat().st_size
                if self._bytes > MOST_BYTES:
                    raise ValueError(f'the meshes have more than {MOST_BYTES >> 20} MiB together')
                self._read[uri] = read_mesh(path)
            except (ValueError, OSError) as error:
                self._read[uri] = str(error)
        found = self._read[uri]
        if isinstance(found, str):
            raise ValueError(found)
        self._count += sum(len(part.faces) for part in found)
        if self._count > MOST_TRIANGLES:
            raise ValueError(f'the meshes have more than {MOST_TRIANGLES} triangles together')
        return found

    @staticmethod
    def uris(visuals: list[Visual]) -> set[str]:
        return {v.geometry.uri for v in visuals if isinstance(v.geometry, MeshFile)}


def _shapes(visual: Visual, files: _Files) -> Iterator[Shape]:
    form = visual.geometry
    if not isinstance(form, MeshFile):
        placed = _primitive(form, visual.pose)
        flat = not isinstance(form, Sphere)
        yield Shape(visual.link, *placed, visual.colour or DEFAULT_COLOUR, flat)
        return
    flat = form.uri.lower().endswith('.stl')
    for part in files.read(form.uri):
        vertices = part.vertices * np.array(form.scale) @ visual.pose[:3, :3].T
        vertices += visual.pose[:3, 3]
        # A mirrored mesh has its inside out.
        mirrored = np.prod(form.scale) < 0
        faces = np.ascontiguousarray(part.faces[:, ::-1]) if mirrored else part.faces
        # The colour of a material counts only for meshes without colours, as in rviz.
        colour = part.colour or visual.colour or DEFAULT_COLOUR
        yield Shape(visual.link, vertices.astype(np.float32), faces, colour, flat)


def _primitive(
    form: Geometry, pose: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    if isinstance(form, Box):
        mesh = trimesh.creation.box(form.size)
    elif isinstance(form, Cylinder):
        mesh = trimesh.creation.cylinder(form.radius, form.length, sections=32)
    elif isinstance(form, MeshFile):
        raise TypeError('a mesh is no primitive')
    else:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=form.radius)
    mesh.apply_transform(pose)
    return np.array(mesh.vertices, np.float32), np.array(mesh.faces, np.int32)
