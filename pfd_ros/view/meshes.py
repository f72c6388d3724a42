# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes of a URDF: from the URI to triangles, within bounds.

A URDF of a recording comes from outside. Only regular files with the suffix of a mesh are opened,
and only below the folder of the description, an installed package or a folder that the user
names. Nothing is fetched from a network, and references of a mesh to other files (textures, .mtl)
are not followed.
"""

from __future__ import annotations

from collections.abc import Iterator
import io
import os
from pathlib import Path
import re
import stat
from typing import NamedTuple
from urllib.parse import unquote, urlsplit
import warnings
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray
import trimesh

from pfd_ros.text import cut, one_line

SUFFIXES = ('.stl', '.dae', '.obj')
# Of one file, and of all together. Meshes of published robots have up to 20 MB and 200 000
# triangles; a browser draws 3 million triangles at a few frames a second.
MOST_BYTES, MOST_BYTES_TOGETHER = 32 * 2**20, 256 * 2**20
MOST_TRIANGLES, MOST_TRIANGLES_TOGETHER = 1_000_000, 3_000_000
# Groups of triangles with a name or a material: the parsers take milliseconds for each, and for
# many of them its square.
MOST_PARTS, MOST_PARTS_TOGETHER = 1000, 5000
# A node of a COLLADA file may contain another one twice, and so on: this many nodes have at most
# 2^8 copies.
MOST_INSTANCES = 16
# What counts as a part: elements of COLLADA, and the beginning of lines of the others.
ELEMENTS = frozenset(
    {
        *('instance_geometry', 'triangles', 'polylist', 'polygons', 'tristrips', 'trifans'),
        *('lines', 'linestrips', 'instance_controller'),
    }
)
LINES = {
    'obj': re.compile(rb'^\s*(?:usemtl|o|g)\b', re.M),
    'stl': re.compile(rb'^\s*solid\b', re.M),
}
# Largest coordinate [m].
FARTHEST = 1e6
OUTSIDE = (
    'it is not below the folder of the description, an installed package or a folder of '
    '--package-path'
)
Colour = tuple[int, int, int]


class Triangles(NamedTuple):
    """Vertices (V, 3) [m], faces (F, 3), and the colour in the file, or None."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    colour: Colour | None


class Meshes:
    """
    The meshes of a URDF, each file read once, within bounds for all of them together.

    Parameters
    ----------
    folder : Path or None
        Folder of the URDF, from which relative paths start; None for a URDF without a file.
    packages : tuple of Path
        Folders of packages, or folders that contain packages. They precede the packages of the
        environment (AMENT_PREFIX_PATH, ROS_PACKAGE_PATH) and those around the URDF.

    """

    def __init__(self, folder: Path | None = None, packages: tuple[Path, ...] = ()) -> None:
        self._folder, self._packages = folder and folder.absolute(), packages
        self._read: dict[str, list[Triangles] | str] = {}
        self._triangles = self._bytes = self._parts = 0

    def read(self, uri: str) -> list[Triangles]:
        """Return the triangles of package://NAME/PATH or a path, by colour; ValueError if none."""
        if uri not in self._read:
            try:
                path = self._found(uri)
                self._bytes += path.stat().st_size
                if self._bytes > MOST_BYTES_TOGETHER:
                    size = MOST_BYTES_TOGETHER >> 20
                    raise ValueError(f'the meshes have more than {size} MiB together')
                data, kind = _read(path), path.suffix.lower()[1:]
                self._parts += _checked_parts(data, kind)
                if self._parts > MOST_PARTS_TOGETHER:
                    raise ValueError(f'the meshes have more than {MOST_PARTS_TOGETHER} parts')
                self._read[uri] = _mesh(data, kind)
            except (ValueError, OSError) as error:
                self._read[uri] = str(error)
        found = self._read[uri]
        if isinstance(found, str):
            raise ValueError(found)
        self._triangles += sum(len(part.faces) for part in found)
        if self._triangles > MOST_TRIANGLES_TOGETHER:
            raise ValueError(f'the meshes have more than {MOST_TRIANGLES_TOGETHER} triangles')
        return found

    def _found(self, uri: str) -> Path:
        # A letter and a colon is a drive, not a scheme.
        scheme = re.match(r'([A-Za-z][A-Za-z0-9+.-]+):', uri)
        if not uri:
            raise ValueError('it has no filename')
        if scheme is not None and scheme[1] == 'package':
            path = self._of_package(uri.removeprefix('package:').lstrip('/'))
        elif scheme is None or scheme[1] == 'file':
            path = self._of_folder(uri if scheme is None else unquote(urlsplit(uri).path))
        else:
            raise ValueError(f'{scheme[1]}: is not read; use package:// or a path')
        if path.suffix.lower() not in SUFFIXES:
            raise ValueError(f'its suffix must be one of {", ".join(SUFFIXES)}')
        try:
            mode = path.stat().st_mode
        except (OSError, ValueError) as error:
            raise ValueError(f'there is no file {cut(str(path), 200)}') from error
        if not stat.S_ISREG(mode):
            raise ValueError(f'{cut(str(path), 200)} is not a regular file')
        return path

    def _of_folder(self, path: str) -> Path:
        if not os.path.isabs(path) and self._folder is None:
            raise ValueError('the path is relative, and the URDF has no folder: use --robot FILE')
        found = Path(os.path.abspath((self._folder or Path()) / path))
        known = (*self._packages, *self._installed(), *filter(None, [self._folder]))
        if not any(found.is_relative_to(folder.absolute()) for folder in known):
            raise ValueError(OUTSIDE)
        return found

    def _of_package(self, path: str) -> Path:
        name, _, inner = path.partition('/')
        inside = os.path.normpath(inner)
        if name in ('', '.', '..') or inside.startswith('..') or os.path.isabs(inside):
            raise ValueError('the path leaves its package')
        around = () if self._folder is None else (self._folder, *self._folder.parents)
        folders = [folder for folder in (*self._packages, *around) if folder.name == name]
        folders += [folder / name for folder in self._packages]
        folders += [folder / 'share' / name for folder in self._packages]
        folders += [folder / name for folder in (*self._installed(), *around)]
        there = [folder for folder in folders if folder.is_dir()]
        if not there:
            raise ValueError(f'package {cut(name)!r} is not found: use --package-path FOLDER')
        return next((f / inside for f in there if (f / inside).exists()), there[0] / inside)

    @staticmethod
    def _installed() -> Iterator[Path]:
        """Yield the folders that contain installed packages."""
        for variable, inner in (('AMENT_PREFIX_PATH', 'share'), ('ROS_PACKAGE_PATH', '')):
            for prefix in filter(None, os.environ.get(variable, '').split(os.pathsep)):
                yield Path(prefix, inner)


def _read(path: Path) -> bytes:
    with path.open('rb') as stream:
        data = stream.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ValueError(f'it has more than {MOST_BYTES >> 20} MiB')
    return data


def _mesh(data: bytes, kind: str) -> list[Triangles]:
    """Return the triangles of a file; of COLLADA in metres, its up axis ignored as by rviz."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            return list(_by_colour(trimesh.load_scene(io.BytesIO(data), file_type=kind), kind))
    except Exception as error:  # the parsers raise whatever a file provokes
        reason = one_line(f'{type(error).__name__}: {error}', 160)
        raise ValueError(f'it cannot be read: {reason}') from error


def _checked_parts(data: bytes, kind: str) -> int:
    """Return the number of parts; ValueError if there are many, or entities or endless copies.

    COLLADA is parsed, since an encoding or a namespace can hide all of them from a search.
    """
    parts = instances = 0

    def start(name: str, _: object) -> None:
        nonlocal parts, instances
        element = name.rpartition(' ')[2]
        parts += element in ELEMENTS
        instances += element == 'instance_node'
        if instances > MOST_INSTANCES:
            raise ValueError(f'it has more than {MOST_INSTANCES} <instance_node>')

    def declare(*_: object) -> None:
        raise ValueError('it has a <!DOCTYPE>')

    if kind in LINES:
        parts = len(LINES[kind].findall(data))
    else:
        parser = expat.ParserCreate(namespace_separator=' ')
        parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, declare
        try:
            parser.Parse(data, True)
        # Python's codecs raise LookupError for an encoding that they lack.
        except (expat.ExpatError, LookupError) as error:
            raise ValueError(f'it cannot be read: {error}') from error
    if parts > MOST_PARTS:
        raise ValueError(f'it has {parts} groups of triangles, more than {MOST_PARTS}')
    return parts


def _by_colour(scene: trimesh.Scene, kind: str) -> Iterator[Triangles]:
    by_colour: dict[Colour | None, list[trimesh.Trimesh]] = {}
    count = 0
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        count += len(mesh.faces)
        if count > MOST_TRIANGLES:
            raise ValueError(f'more than {MOST_TRIANGLES} triangles')
        placed = mesh.copy()
        units = placed.units if kind == 'dae' else None
        placed.apply_transform(pose)
        if units not in (None, 'meters'):
            placed.apply_scale(trimesh.units.unit_conversion(units, 'meters'))
        by_colour.setdefault(_colour(mesh), []).append(placed)
    if not count:
        raise ValueError('no triangles')
    for colour, meshes in by_colour.items():
        offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        vertices = np.concatenate([np.array(mesh.vertices) for mesh in meshes])
        if not np.all(np.abs(vertices) <= FARTHEST):
            raise ValueError('a vertex is not finite, or too far away')
        faces = [np.array(m.faces) + offset for m, offset in zip(meshes, offsets, strict=False)]
        joined = np.array(np.concatenate(faces), np.int32)
        yield Triangles(vertices.astype(np.float32), joined, colour)


def _colour(mesh: trimesh.Trimesh) -> Colour | None:
    """Return the main colour of a mesh, None where the file has none."""
    if not mesh.visual.defined:
        return None
    colour = getattr(mesh.visual, 'main_color', None)
    if colour is None:
        colour = mesh.visual.material.main_color
    red, green, blue = (int(part) for part in np.asarray(colour)[:3])
    return red, green, blue
