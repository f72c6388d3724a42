# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Folders of ROS packages, installed or in a checkout.

An installation is asked first: the prefixes of AMENT_PREFIX_PATH. Without one a package is where
its package.xml is, in a folder above a file that names it, or beside the package of that file.
Then the folders of ROS_PACKAGE_PATH count, those that pip makes (example-robot-data), and the
cache of the package robot_descriptions.
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

    Without a folder it is an installed one, or one of ROS_PACKAGE_PATH or of a cache.

    Of several packages of that name the nearest one counts. ValueError if the name is no name of
    a folder, or `folder` is no path.
    """
    if not isinstance(name, str) or name in ('', '.', '..') or not {'/', '\0'}.isdisjoint(name):
        raise ValueError(f'name must be the name of a package, got {quote(name)}')
    if not (folder is None or isinstance(folder, (str, os.PathLike))):
        raise ValueError(f'folder must be a path, got {quote(folder)}')
    places = (_in_prefixes(name, _paths('AMENT_PREFIX_PATH')), _around(name, folder))
    for found in chain(*places, _in_prefixes(name, _pip_prefixes()), _downloaded(name)):
        return found
    return None


def _in_prefixes(name: str, prefixes: Iterable[Path]) -> Iterator[Path]:
    shares = (prefix / 'share' / name for prefix in prefixes)
    return (share for share in shares if (share / MANIFEST).is_file())


def _around(name: str, folder: str | os.PathLike[str] | None) -> Iterator[Path]:
    """Yield the packages of a name above a folder, and beside the package of the folder."""
    if folder is None:
        return
    start = Path(folder).absolute()
    above = [at for at in (start, *start.parents) if (at / MANIFEST).is_file()]
    # Beside a package: its checkout, and the folder of the checkout.
    start = above[0].parent if above else start
    around = (found for root in (start, start.parent) for found in _below(root))
    yield from (found for found in chain(above, around) if _name(found) == name)


def _downloaded(name: str) -> Iterator[Path]:
    cache = Path(os.environ.get(CACHE_VARIABLE) or CACHE).expanduser().absolute()
    for root in (*_paths('ROS_PACKAGE_PATH'), cache):
        at = (root,) if (root / MANIFEST).is_file() else _below(root)
        yield from (found for found in at if _name(found) == name)


def _pip_prefixes() -> Iterator[Path]:
    return (Path(folder, PIP_PREFIX).absolute() for folder in sys.path)


def _paths(variable: str) -> list[Path]:
    """Return the folders of an environment variable."""
    return [Path(p).absolute() for p in os.environ.get(variable, '').split(os.pathsep) if p]


def _below(root: Path) -> Iterator[Path]:
    """Yield the packages in a folder, the nearer first; a package is not searched for others."""
    level, left = [root], MOST_FOLDERS
    for _ in range(DEEPEST):
        inner = [folder for at in level for folder in _folders(at)][:left]
        left -= len(inner)
        packages = [folder for folder in inner if (folder / MANIFEST).is_file()]
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
