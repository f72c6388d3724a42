# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Folders of ROS packages, installed or in a checkout.

An installation is asked first: the prefixes of AMENT_PREFIX_PATH. Without one a package is where
its package.xml is, in a folder above a file that names it, or beside the package of that file.
"""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import xml.etree.ElementTree as ElementTree

from pfd_core.model.values import quote

MANIFEST = 'package.xml'
# A checkout, or the folder of a workspace that has several, is searched so deep and so far.
DEEPEST, MOST_FOLDERS = 3, 5000


def find_package(name: str, folder: str | os.PathLike[str]) -> Path | None:
    """
    Return the folder of a ROS package that a file in `folder` names; None if there is none.

    Of several packages of that name the nearest one counts. ValueError if the name is no name of
    a folder, or `folder` is no path.
    """
    if not isinstance(name, str) or name in ('', '.', '..') or not {'/', '\0'}.isdisjoint(name):
        raise ValueError(f'name must be the name of a package, got {quote(name)}')
    if not isinstance(folder, (str, os.PathLike)):
        raise ValueError(f'folder must be a path, got {quote(folder)}')
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        share = Path(prefix).absolute() / 'share' / name
        if (share / MANIFEST).is_file():
            return share
    start = Path(folder).absolute()
    above = [at for at in (start, *start.parents) if (at / MANIFEST).is_file()]
    # Beside a package: its checkout, and the folder of the checkout.
    start = above[0].parent if above else start
    around = (found for root in (start, start.parent) for found in _below(root))
    return next((found for found in (*above, *around) if _name(found) == name), None)


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
