# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Folders of ROS packages, wherever a package may be.

In this order: of AMENT_PREFIX_PATH, above a file that names the package, beside the package of
that file, of pip (example-robot-data), of ROS_PACKAGE_PATH, of the cache of robot_descriptions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
import os
from pathlib import Path
import sys
import xml.etree.ElementTree as ElementTree

from pfd_core.model.values import quote

MANIFEST = 'package.xml'
# A checkout, or the folder of a workspace that has several, is searched so deep and so far.
DEEPEST, MOST_FOLDERS = 3, 5000
# The prefix of packages from pip that are built by CMake, such as Pinocchio, in site-packages.
PIP_PREFIX = 'cmeel.prefix'
CACHE, CACHE_VARIABLE = '~/.cache/robot_descriptions', 'ROBOT_DESCRIPTIONS_CACHE'


def find_package(name: str, folder: str | os.PathLike[str] | None = None) -> Path | None:
    """
    Return the folder of a ROS package that a file in `folder` names; None if there is none.

    Without a folder it is an installed one, or one of ROS_PACKAGE_PATH or of a cache. Of several
    packages of that name the nearest one counts. ValueError if the name is no name of a folder, or
    `folder` is no path.
    """
    if not isinstance(name, str) or name in ('', '.', '..') or not {'/', '\0'}.isdisjoint(name):
        raise ValueError(f'name must be the name of a package, got {quote(name)}')
    if not (folder is None or isinstance(folder, (str, os.PathLike))):
        raise ValueError(f'folder must be a path, got {quote(folder)}')

    def shared(prefixes: Iterable[Path]) -> Iterator[Path]:
        return (prefix.absolute() / 'share' / name for prefix in prefixes)

    def named(packages: Iterable[Path]) -> Iterator[Path]:
        return (package for package in packages if _name(package) == name)

    installed, pip = _paths('AMENT_PREFIX_PATH'), (Path(at, PIP_PREFIX) for at in sys.path)
    places = shared(installed), named(_around(folder)), shared(pip), named(_downloaded())
    return next(filter(_is_package, chain(*places)), None)


def _around(folder: str | os.PathLike[str] | None) -> Iterator[Path]:
    """Yield the packages above a folder, and beside the package of the folder."""
    if folder is None:
        return
    start = Path(folder).absolute()
    above = [at for at in (start, *start.parents) if _is_package(at)]
    yield from above
    # Beside a package: its checkout, and the folder of the checkout.
    start = above[0].parent if above else start
    for root in (start, start.parent):
        yield from _below(root)


def _downloaded() -> Iterator[Path]:
    cache = Path(os.environ.get(CACHE_VARIABLE) or CACHE).expanduser()
    for root in (*_paths('ROS_PACKAGE_PATH'), cache):
        yield from [root.absolute()] if _is_package(root) else _below(root.absolute())


def _paths(variable: str) -> list[Path]:
    """Return the folders of an environment variable."""
    return [Path(path) for path in os.environ.get(variable, '').split(os.pathsep) if path]


def _is_package(folder: Path) -> bool:
    return (folder / MANIFEST).is_file()


def _below(root: Path) -> Iterator[Path]:
    """Yield the packages in a folder, the nearer first; a package is not searched for others."""
    level, left = [root], MOST_FOLDERS
    for _ in range(DEEPEST):
        inner = [folder for at in level for folder in _folders(at)][:left]
        left -= len(inner)
        packages = [*filter(_is_package, inner)]
        yield from packages
        level = [folder for folder in inner if folder not in {*packages}]


def _folders(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            return sorted(Path(e) for e in entries if e.name[0] != '.' and e.is_dir())
    except (OSError, ValueError):  # not ours to read; a path that no folder has
        return []


def _name(package: Path) -> str | None:
    """Return the name that a package.xml states; None if it cannot be read."""
    try:
        name = ElementTree.parse(package / MANIFEST).findtext('name')
    except (OSError, ElementTree.ParseError, LookupError, ValueError):
        return None
    return name and name.strip()
