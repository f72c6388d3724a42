# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots by name, from a file, or from text."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

from pfd_core.model.edit import lock
from pfd_core.model.robot import Robot
from pfd_core.model.storage import robot_from_yaml
from pfd_core.model.urdf import robot_from_urdf
from pfd_core.model.urdf_tree import RIGHT_ANGLE_SLACK

PACKAGE = Path(__file__).resolve().parent.parent
# Installed, the configuration lies in the package; in a checkout, beside it.
FOLDERS = (PACKAGE / 'config' / 'robots', PACKAGE.parent / 'config' / 'robots')
URDF, YAML = ('.urdf', '.xml'), ('.yaml', '.yml')


def known_robots() -> list[str]:
    """Return the names of the robots that come along, sorted."""
    return sorted(_robot_files())


def load_robot(
    source: str | PathLike[str],
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    right_angle: float = RIGHT_ANGLE_SLACK,
) -> Robot:
    """
    Return a robot by name, from a file or from text.

    Parameters
    ----------
    source : str or path
        A name of `known_robots`, the path of a .urdf or .yaml file, or the text of one.
    base, tip : str, optional
        Links of a URDF between which the chain lies. Left out, the base is the root link and
        the tip the link that the last joint moves. The base stands still, so what is above it
        and what else hangs on it is left out. What hangs on a moving link keeps its mass, also
        beyond the tip, but joints there must be locked.
    locked : mapping, optional
        Name of a joint -> position [rad, m]. The joint becomes fixed, its link welded on.
    right_angle : float
        A rotation of a URDF that is this close to a multiple of 90 degrees [rad] is taken as
        exactly that, since 1.570796325 means it, and exact zeros halve the work of a kernel; the
        robot's `squared` names the joints that this changed. Negative: as written.

    Raises
    ------
    ValueError
        If there is no such robot or file, it cannot be read, or it is not one serial chain of
        revolute, continuous and prismatic joints; the text names the joint or link.

    Warns
    -----
    PhysicsWarning
        If an inertia breaks the triangle rule.

    """
    text, origin, is_urdf = _read(source)
    if is_urdf:
        return robot_from_urdf(
            text, base=base, tip=tip, locked=locked, source=origin, right_angle=right_angle
        )
    robot = robot_from_yaml(text, source=origin)
    for role, asked, has in (('base', base, robot.base), ('tip', tip, robot.tip)):
        if asked not in (None, has):
            raise ValueError(
                f'{role}={asked!r} cannot be chosen for {robot.name!r}: a YAML file holds one '
                f'chain, from {robot.base!r} to {robot.tip!r}'
            )
    return lock(robot, locked) if locked else robot


def _read(source: str | PathLike[str]) -> tuple[str, str, bool]:
    """Return the text of a robot, where it is from, and whether it is URDF."""
    if isinstance(source, str):
        if source.lstrip().startswith('<'):
            return source, 'URDF text', True
        if '\n' in source:
            return source, 'YAML text', False
        if source in _robot_files():
            return _file(_robot_files()[source])
    elif not isinstance(source, PathLike):
        raise ValueError(f'source must be a name, a path or text, got {source!r}')
    path = Path(source)
    if path.is_file():
        return _file(path)
    if path.suffix in (*URDF, *YAML) or len(path.parts) > 1:
        raise ValueError(f'no robot file {str(path)!r} (looked in {str(Path.cwd())!r})')
    raise ValueError(
        f'unknown robot {str(source)!r}: known are {", ".join(known_robots())}; or give the path '
        'of a .urdf or .yaml file'
    )


def _file(path: Path) -> tuple[str, str, bool]:
    if path.suffix == '.xacro':
        raise ValueError(f'{str(path)!r} is xacro: run `xacro {path} > robot.urdf` first')
    if path.suffix not in (*URDF, *YAML):
        raise ValueError(f'{str(path)!r} must end in {", ".join((*URDF, *YAML))}')
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f'cannot read {str(path)!r}: {error}') from error
    return text, str(path), path.suffix in URDF


def _robot_files() -> dict[str, Path]:
    """Return the files of the robots that come along, by name."""
    for folder in FOLDERS:
        if folder.is_dir():
            return {path.stem: path for path in folder.glob('*.yaml')}
    return {}
