# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots by name, from a file or from text, and scenes from a file or from text.

A scene file is YAML: a table of the fields of Scene. `null` is None, and numbers of joints are
lists in the order of the robot's joints.
"""

from __future__ import annotations

from collections.abc import Mapping
import errno
from importlib.resources import files
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

from pfd_core.forking import no_fork
from pfd_core.model.robot import Robot, lock
from pfd_core.model.scene import Scene, scene_from_yaml
from pfd_core.model.values import quote
from pfd_core.model.yaml_files import robot_from_yaml

if TYPE_CHECKING:
    from importlib.abc import Traversable

    from pfd_core.model.urdf import Urdf

PACKAGE = files('pfd_core')
# Installed, also in a zip file, the configuration lies in the package; in a checkout, next to it.
FOLDERS: tuple[Traversable, ...] = (
    PACKAGE / 'config' / 'robots',
    Path(str(PACKAGE)).parent / 'config' / 'robots',
)
# The largest URDF in circulation has 1 MB.
LARGEST_FILE = 16 * 2**20
# Writers of URDF print pi/2 as 1.570796325 or longer: so many digits mean a right angle, and only
# an exact one gives zeros, which a kernel drops. 1.5708 is taken as written.
RIGHT_ANGLE_SLACK = 1e-8
URDF, XACRO, YAML = ('.urdf', '.xml'), '.xacro', ('.yaml', '.yml')


def known_robots() -> list[str]:
    """Return the names of the robots in config/robots, sorted."""
    return sorted(_robot_files())


def load_robot(
    source: str | PathLike[str] | Urdf,
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
    source : str, path or Urdf
        A name of `known_robots`, the path of a .urdf, .xacro or .yaml file, the text of a URDF or
        YAML file, or the record of a URDF as `read_urdf` returns it. A .xacro file
        needs the package xacro; its arguments have their defaults.
    base, tip : str, optional
        First and last link of the chain in a URDF; default: the root link, and the link that the
        last joint moves. The base is fixed: links above it and other branches on it are cut
        off. Branches on a moving link keep their mass, also beyond the tip, but their joints must
        be locked.
    locked : mapping, optional
        Name of a joint -> position [rad, m] at which it becomes a fixed joint, and with it the
        joints of a URDF that mimic it.
    right_angle : float
        Angles of a URDF within this distance [rad] of a multiple of 90 degrees become exact:
        1.570796325 means pi/2, and exact zeros halve the work of a kernel. The robot's
        `snapped_joints` names the joints that this changed. Negative: angles as written.

    Raises
    ------
    ValueError
        If there is no such robot or file, it cannot be read, or it is not one serial chain of
        revolute, continuous and prismatic joints; the text names the joint or link.

    Warns
    -----
    PhysicsWarning
        If an inertia breaks the triangle rule, or in the chain of a URDF a link has no <inertial>
        and is taken as massless, or a joint has no <limit> and is taken as unlimited.

    """
    for role, name in (('base', base), ('tip', tip)):
        if name is not None and not isinstance(name, str):
            raise ValueError(f'{role} must be the name of a link or None, got {quote(name)}')
    if isinstance(source, (str, PathLike)):
        text, origin, is_urdf = _read(source)
        urdf = _parsed(text, origin) if is_urdf else None
    else:
        urdf = _checked(source)
    if urdf is not None:
        with no_fork:
            from pfd_core.model.urdf_robot import robot_from_urdf

        return robot_from_urdf(urdf, base=base, tip=tip, locked=locked, right_angle=right_angle)
    robot = robot_from_yaml(text, origin)
    for role, asked, has in (('base', base, robot.base), ('tip', tip, robot.tip)):
        if asked not in (None, has):
            raise ValueError(
                f'{role}={quote(asked)} cannot be chosen for {quote(robot.name)}: a YAML file '
                f'holds one chain, from {quote(robot.base)} to {quote(robot.tip)}'
            )
    return robot if locked is None else lock(robot, locked)


def read_urdf(source: str | PathLike[str]) -> Urdf | None:
    """
    Parse a URDF, once for `load_robot` and for its <ros2_control> blocks and mimic joints.

    Parameters
    ----------
    source : str or path
        As for `load_robot`.

    Returns
    -------
    Urdf or None
        The record of the URDF; None if the source is a robot in YAML.

    Raises
    ------
    ValueError
        If there is no such robot or file, it cannot be read, or a link or joint breaks the format.

    """
    text, origin, is_urdf = _read(source)
    return _parsed(text, origin) if is_urdf else None


def urdf_of(source: str | PathLike[str]) -> str:
    """
    Return a robot as URDF: a URDF unchanged, any other robot converted.

    Parameters
    ----------
    source : str or path
        As for `load_robot`, which reads the same robot from the URDF, to rounding.

    Raises
    ------
    ValueError
        As `load_robot`; the elements of a URDF are not checked.

    """
    text, origin, is_urdf = _read(source)
    if is_urdf:
        return text
    with no_fork:
        from pfd_core.model.urdf_writer import robot_to_urdf

    return robot_to_urdf(robot_from_yaml(text, origin))


def load_scene(source: str | PathLike[str]) -> Scene:
    """
    Return a scene from a YAML file, as `Scene.save` writes it, or from the text of one.

    Parameters
    ----------
    source : str or path
        The path of a file, or its text, which has a line break.

    Raises
    ------
    ValueError
        If there is no such file, it cannot be read, a key is unknown or occurs twice, or a value
        is refused by Scene; the text names file and field.

    """
    if isinstance(source, str) and '\n' in source:
        return scene_from_yaml(source, 'YAML text')
    if not _is_path(source):
        raise ValueError(f'source must be a path or a YAML string, got {quote(source)}')
    path = Path(source)
    if not _is_there(path):
        raise ValueError(f'no scene file {quote(str(path))} (looked in {quote(str(Path.cwd()))})')
    return scene_from_yaml(_text(path), str(path))


def _read(source: str | PathLike[str]) -> tuple[str, str, bool]:
    """Return the text of a robot, its origin, and whether it is URDF."""
    if isinstance(source, str):
        if source.lstrip().startswith('<'):
            return source, 'URDF text', True
        if '\n' in source:
            return source, 'YAML text', False
        if source in _robot_files():
            known = _robot_files()[source]
            return known.read_text('utf-8'), str(known), False
    if not _is_path(source):
        raise _unreadable(source)
    path = Path(source)
    if path.suffix not in (*URDF, XACRO, *YAML) and len(path.parts) == 1 and not _is_there(path):
        raise ValueError(
            f'unknown robot {quote(str(source))}: known are {", ".join(known_robots())}; or give '
            'the path of a .urdf, .xacro or .yaml file'
        )
    return _file(path)


def _parsed(text: str, origin: str) -> Urdf:
    with no_fork:
        from pfd_core.model.urdf import parse_urdf

    return parse_urdf(text, origin)


def _checked(source: object) -> Urdf:
    """Return a source that is no text and no path; ValueError if it is no Urdf."""
    with no_fork:
        from pfd_core.model.urdf import Urdf

    if not isinstance(source, Urdf):
        raise _unreadable(source)
    return source


def _unreadable(source: object) -> ValueError:
    return ValueError(f'source must be a name, a path or a string, got {quote(source)}')


def _is_path(source: object) -> bool:
    """Return whether a value can be the path of a file."""
    text = fspath(source) if isinstance(source, (str, PathLike)) else ''
    return isinstance(text, str) and bool(text)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long a name; a name with a zero byte
        return False


def _file(path: Path) -> tuple[str, str, bool]:
    label = quote(str(path))
    if not _is_there(path):
        raise ValueError(f'no robot file {label} (looked in {quote(str(Path.cwd()))})')
    if path.suffix not in (*URDF, XACRO, *YAML):
        raise ValueError(f'{label} must end in {", ".join((*URDF, XACRO, *YAML))}')
    text = _text(path)
    if path.suffix == XACRO:
        with no_fork:
            from pfd_core.model.xacro_files import expanded

        return expanded(path), str(path), True
    return text, str(path), path.suffix in URDF


def _text(path: Path) -> str:
    """Return the text of a file; ValueError if it cannot be read."""
    try:
        return _content(path).decode('utf-8-sig')
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise ValueError(f'cannot read {quote(str(path))}: {reason}') from error


def _content(path: Path) -> bytes:
    """Return the bytes of a regular file; OSError for a pipe, a device and a larger file."""
    if not path.is_file():
        raise OSError(errno.EINVAL, 'it is not a regular file')
    with path.open('rb') as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise OSError(errno.EFBIG, f'it is larger than {LARGEST_FILE} bytes')
    return content


def _robot_files() -> dict[str, Traversable]:
    for folder in FOLDERS:
        if folder.is_dir():
            return {
                file.name.removesuffix('.yaml'): file
                for file in folder.iterdir()
                if file.name.endswith('.yaml')
            }
    return {}
