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
from urllib.parse import unquote, urlsplit
import warnings
from xml.parsers import expat

import numpy as np
import trimesh

import pfd_core as pfd
from pfd_ros.text import cut, one_line

SUFFIXES = ('.stl', '.dae', '.obj')
# Of all meshes together; a browser draws 3 million triangles at a few frames a second. Parts are
# groups of triangles with a name or a material: the parsers take milliseconds for each.
MOST_BYTES, MOST_TRIANGLES, MOST_PARTS = 256 * 2**20, 3_000_000, 5000
# A node of a COLLADA file may contain another one twice, and so on: this many nodes have at most
# 2^8 copies.
MOST_INSTANCES = 16
# What counts as a part: elements of COLLADA, and the beginning of lines of the others.
ELEMENTS = (
    *('instance_geometry', 'triangles', 'polylist', 'polygons', 'tristrips', 'trifans'),
    *('lines', 'linestrips', 'instance_controller'),
)
LINES = {'obj': rb'^\s*(?:usemtl|o|g)\b', 'stl': rb'^\s*solid\b'}
# Largest coordinate [m].
FARTHEST = 1e6
OUTSIDE = (
    'it is not below the folder of the description, an installed package or a folder of '
    '--package-path'
)
Colour = tuple[int, int, int]
# Triangles [m], and their colour in the file.
Painted = tuple[trimesh.Trimesh, Colour | None]


class Meshes:
    """The meshes of a URDF, each file read once, within bounds for all of them together.

    Relative paths start from the folder of the URDF, None for a URDF without a file. `packages`
    are folders of packages, or folders that contain packages. They precede what `pfd.find_package`
    finds, the packages of ROS_PACKAGE_PATH, and folders around the URDF with a package's name.
    """

    def __init__(self, folder: Path | None = None, packages: tuple[Path, ...] = ()) -> None:
        self._folder = folder and folder.absolute()
        self._packages = tuple(path.absolute() for path in packages)
        self._found_packages: dict[str, Path | None] = {}
        self._read: dict[str, list[Painted] | str] = {}
        self._left = {'bytes': MOST_BYTES, 'triangles': MOST_TRIANGLES, 'parts': MOST_PARTS}

    def read(self, uri: str) -> list[Painted]:
        """Return the triangles of package://NAME/PATH or a path, by colour; ValueError if none."""
        if uri not in self._read:
            try:
                path = self._found(uri)
                data, kind = path.read_bytes(), path.suffix.lower()[1:]
                self._take('parts', _parts(data, kind))
                self._read[uri] = list(_by_colour(data, kind))
            except ValueError as error:
                self._read[uri] = str(error)
            except OSError as error:
                self._read[uri] = f'it cannot be read: {error.strerror}'
        found = self._read[uri]
        if isinstance(found, str):
            raise ValueError(found)
        self._take('triangles', sum(len(mesh.faces) for mesh, _ in found))
        return found

    def _take(self, what: str, count: int) -> None:
        self._left[what] -= count
        if self._left[what] < 0:
            most = {'bytes': MOST_BYTES, 'triangles': MOST_TRIANGLES, 'parts': MOST_PARTS}[what]
            raise ValueError(f'the meshes have more than {most} {what}')

    def _found(self, uri: str) -> Path:
        # A letter and a colon is a drive, not a scheme.
        scheme, rest = re.findall(r'^(?:([A-Za-z][A-Za-z0-9+.-]+):)?((?s:.*))$', uri)[0]
        if not uri:
            raise ValueError('it has no filename')
        if scheme == 'package':
            path = self._of_package(rest.lstrip('/'))
        elif scheme in ('', 'file'):
            path = self._of_folder(unquote(urlsplit(uri).path) if scheme else uri)
        else:
            raise ValueError(f'{scheme}: is not read; use package:// or a path')
        if path.suffix.lower() not in SUFFIXES:
            raise ValueError(f'its suffix must be one of {", ".join(SUFFIXES)}')
        # False also for a name that no file can have.
        if not path.is_file():
            raise ValueError(f'{cut(str(path), 200)} is not a regular file')
        self._take('bytes', path.stat().st_size)
        return path

    def _of_folder(self, path: str) -> Path:
        if not os.path.isabs(path) and self._folder is None:
            raise ValueError('the path is relative, and the URDF has no folder: use --robot FILE')
        found = Path(os.path.abspath((self._folder or Path()) / path))
        known = (*self._packages, *_installed(), *filter(None, [self._folder]))
        if not any(found.is_relative_to(folder) for folder in known):
            raise ValueError(OUTSIDE)
        return found

    def _of_package(self, path: str) -> Path:
        name, _, inner = path.partition('/')
        inside = os.path.normpath(inner)
        if name in ('', '.', '..') or inside.startswith('..') or os.path.isabs(inside):
            raise ValueError('the path leaves its package')
        around = () if self._folder is None else (self._folder, *self._folder.parents)
        folders = [folder for folder in self._packages if folder.name == name]
        for prefix in self._packages:
            folders += [prefix / name, prefix / 'share' / name]
        if name not in self._found_packages:
            self._found_packages[name] = pfd.find_package(name, self._folder)
        folders += filter(None, [self._found_packages[name]])
        folders += [folder for folder in around if folder.name == name]
        folders += [folder / name for folder in (*_installed(), *around)]
        there = [folder for folder in folders if folder.is_dir()]
        if not there:
            raise ValueError(f'package {cut(name)!r} is not found: use --package-path FOLDER')
        return next((f / inside for f in there if (f / inside).exists()), there[0] / inside)


def _installed() -> Iterator[Path]:
    """Yield the folders that contain installed packages."""
    for variable, inner in (('AMENT_PREFIX_PATH', 'share'), ('ROS_PACKAGE_PATH', '')):
        for prefix in filter(None, os.environ.get(variable, '').split(os.pathsep)):
            yield Path(prefix, inner).absolute()


def _parts(data: bytes, kind: str) -> int:
    """Return the number of parts; ValueError if there are entities or endless copies.

    COLLADA is parsed, since an encoding or a namespace can hide all of them from a search.
    """
    if kind in LINES:
        return len(re.findall(LINES[kind], data, re.M))
    names: list[str] = []

    def declare(*_: object) -> None:
        raise ValueError('it has a <!DOCTYPE>')

    parser = expat.ParserCreate(namespace_separator=' ')
    parser.StartElementHandler = lambda name, _: names.append(name.rpartition(' ')[2])
    parser.StartDoctypeDeclHandler = declare
    try:
        parser.Parse(data, True)
    # Python's codecs raise LookupError for an encoding that they lack.
    except (expat.ExpatError, LookupError) as error:
        raise ValueError(f'it cannot be read: {error}') from error
    if names.count('instance_node') > MOST_INSTANCES:
        raise ValueError(f'it has more than {MOST_INSTANCES} <instance_node>')
    return sum(map(names.count, ELEMENTS))


def _by_colour(data: bytes, kind: str) -> Iterator[Painted]:
    """Yield the triangles of a file; of COLLADA in metres, its up axis ignored as by rviz."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind)
    except Exception as error:  # the parsers raise whatever a file provokes
        reason = one_line(f'{type(error).__name__}: {error}', 160)
        raise ValueError(f'it cannot be read: {reason}') from error
    by_colour: dict[Colour | None, list[trimesh.Trimesh]] = {}
    count = 0
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        count += len(mesh.faces)
        if count > MOST_TRIANGLES:
            raise ValueError(f'it has more than {MOST_TRIANGLES} triangles')
        placed = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        placed.apply_transform(pose)
        if kind == 'dae' and mesh.units not in (None, 'meters'):
            placed.apply_scale(trimesh.units.unit_conversion(mesh.units, 'meters'))
        by_colour.setdefault(_colour(mesh), []).append(placed)
    if not count:
        raise ValueError('no triangles')
    for colour, meshes in by_colour.items():
        whole = trimesh.util.concatenate(meshes)
        if not np.all(np.abs(whole.vertices) <= FARTHEST):
            raise ValueError('a vertex is not finite, or too far away')
        yield whole, colour


def _colour(mesh: trimesh.Trimesh) -> Colour | None:
    """Return the main colour of a mesh, None where the file has none."""
    if not mesh.visual.defined:
        return None
    colour = getattr(mesh.visual, 'main_color', None)
    if colour is None:
        colour = mesh.visual.material.main_color
    red, green, blue = (int(part) for part in np.asarray(colour)[:3])
    return red, green, blue
