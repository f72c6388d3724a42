# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots by name, from a file or from text, and scenes from a file or from text.

A scene file is YAML: a table of the fields of Scene, with numbers in the order of the joints.
"""

from __future__ import annotations

from codecs import lookup
from collections.abc import Mapping
from dataclasses import replace
import errno
from importlib.resources import files
from os import PathLike, fspath
from pathlib import Path
import re
from typing import TYPE_CHECKING, Any

from pfd_core.forking import load
from pfd_core.model.locking import lock, locked_positions, locks
from pfd_core.model.robot import Robot
from pfd_core.model.scene import Scene, scene_from_yaml
from pfd_core.model.values import quote, quote_all, switch
from pfd_core.model.yaml_files import is_described, robot_from_yaml

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
# Byte order marks, the longer first, and the encoding that an XML declares in its first line.
MARKS = {
    b'\xef\xbb\xbf': 'utf-8-sig',
    b'\xff\xfe\x00\x00': 'utf-32',
    b'\x00\x00\xfe\xff': 'utf-32',
    b'\xff\xfe': 'utf-16',
    b'\xfe\xff': 'utf-16',
}
DECLARATION = re.compile(
    r"""\s*<\?xml\b[^<>]*?\bencoding\s*=\s*["'](?P<encoding>[A-Za-z][\w.-]*)["']""", re.ASCII
)
LONGEST_DECLARATION = 200
MJCF = 'mujoco'  # the first element of a model of MuJoCo
# A path has one of these, or a folder, or is there; any other word is a name of a robot.
XML_SUFFIXES = {'.urdf', '.xml', '.xacro'}
SUFFIXES = {*XML_SUFFIXES, '.yaml', '.yml'}
# What precedes the first element of an XML, piece by piece, and that element.
BEFORE_ROOT = re.compile(r'\ufeff|\s*(?:<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>)', re.DOTALL)
ROOT = re.compile(r'\s*<([\w.:-]+)')
# A macro, or an expression in a file that declares its language.
MACRO, LANGUAGE, EXPRESSION = re.compile(r'<\s*xacro:'), 'xmlns:xacro', re.compile(r'\$[({]')
# Fields of a robot in YAML, whatever the suffix of its file.
IS_YAML = re.compile(r'^(robot|joints|description)\s*:', re.MULTILINE)


def known_robots(*, described: bool = False) -> list[str]:
    """
    Return the names of the robots in config/robots, sorted.

    If `described` is set, those whose links are in a description of another package, which
    `find_description` finds; otherwise those that need no other file.
    """
    described = switch('described', described)
    texts = {name: file.read_text('utf-8') for name, file in _robot_files().items()}
    return sorted(name for name, text in texts.items() if is_described(text) == described)


def find_description(name: str) -> Path | None:
    """
    Return the URDF or xacro file of another package that describes a robot by name.

    A package is where `find_package` finds it. None if no such file is on disk, or the robot has
    none; ValueError for a name that `known_robots` does not have.
    """
    file = _robot_files().get(name) if isinstance(name, str) else None
    if file is None:
        raise ValueError(f'name must be the name of a robot, got {quote(name)}')
    try:
        found: Path = load('model.described.description')(file.read_text('utf-8'), name).path
    except ValueError:
        return None
    return found


def load_robot(
    source: str | PathLike[str] | Urdf,
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float | None] | None = None,
    right_angle: float = RIGHT_ANGLE_SLACK,
    xacro: Mapping[str, object] | None = None,
) -> Robot:
    """
    Return a robot by name, from a file or from text.

    Parameters
    ----------
    source : str, path or Urdf
        A name of `known_robots`, also of one with a description on disk, the path of a URDF,
        xacro, YAML or MJCF file, the text of a URDF or YAML file, or the record of a URDF as
        `read_urdf` returns it.
    base, tip : str, optional
        First and last link of the chain in a URDF; default: the root link, and the link that the
        last joint moves, or the flange of a robot by name. The base is fixed: links above it and
        other branches on it are cut off. Gravity stays in axes of the root; joints between root
        and base are at 0 or locked. Branches on a moving link keep their mass, also beyond the
        tip; their joints are locked, nearest to 0 within their limits, and a warning names them.
        Joints that mimic joints of the chain move with them, also on branches
        (`Robot.followers`), and a warning names them.
    locked : mapping, optional
        Name of a joint, or a pattern such as 'hand_*' -> position [rad, m] at which it becomes a
        fixed joint, and with it the joints of a URDF that mimic it. None: nearest to 0 within its
        limits.
    right_angle : float
        Angles of a URDF within this distance [rad] of a multiple of 90 degrees become exact:
        1.570796325 means pi/2, and exact zeros halve the work of a kernel. The robot's
        `snapped_joints` names the joints that this changed. Results then differ by up to 1e-8
        from those of Pinocchio; -1 takes angles as written, and they agree to rounding.
    xacro : mapping, optional
        Arguments of a .xacro file: name -> text or number; default: those of the file, or of the
        robot by name. `$(find NAME)` in it is the folder of an installed package
        (AMENT_PREFIX_PATH), or else of the package.xml with that name above the file or beside
        its package.

    Raises
    ------
    ValueError
        If there is no such robot or file, it cannot be read, or it is not one serial chain of
        revolute, continuous and prismatic joints; the text names the joint or link, file and line.

    Warns
    -----
    PhysicsWarning
        If an inertia breaks the triangle rule, or in the chain of a URDF a link has no <inertial>
        and is taken as massless, an attribute is not read, or a body is larger than the whole
        arm. If a limit is taken as infinite: none is written, a velocity or effort is 0 or
        negative, or a lower end lies above the upper one.

    """
    model = _chosen(source, base, tip, xacro)
    if isinstance(model, Robot):
        return model if locked is None else lock(model, locked)
    found: Robot = load('model.urdf_robot.robot_from_urdf')(
        model, base=base, tip=tip, locked=locked, right_angle=right_angle
    )
    return found


def locked_joints(
    source: str | PathLike[str] | Urdf,
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float | None] | None = None,
    xacro: Mapping[str, object] | None = None,
) -> dict[str, float]:
    """
    Return the positions [rad, m] of the joints that `load_robot` locks, by name, for tools.

    They are those that `locked` names or matches, those that mimic these, and those that do not
    move the tip. Arguments and errors are as for `load_robot`.
    """
    model, given = _chosen(source, base, tip, xacro), {} if locked is None else locked
    if isinstance(model, Robot):
        return locks(model, given)
    at = locked_positions(model.name, given, model.joints)
    return dict(load('model.urdf_chain.find_chain')(model, base, tip, at).locked)


def read_urdf(
    source: str | PathLike[str], xacro: Mapping[str, object] | None = None
) -> Urdf | None:
    """
    Parse a URDF, once for `load_robot` and for other readers of its links and joints.

    The arguments are as for `load_robot`, and so are the errors; None if it is a robot in YAML.
    """
    model = _read(source, xacro)
    return None if isinstance(model, Robot) else model


def urdf_of(source: str | PathLike[str], xacro: Mapping[str, object] | None = None) -> str:
    """
    Return a robot as URDF: the text of a URDF unchanged, any other robot converted.

    The arguments are as for `load_robot`, which with base and tip of the robot reads the same one
    from the URDF, to rounding.
    """
    model = _read(source, xacro)
    if not isinstance(model, Robot):
        return model.text
    text: str = load('model.urdf_writer.robot_to_urdf')(model)
    return text


def load_scene(source: str | PathLike[str]) -> Scene:
    """
    Return a scene from a YAML file, as `Scene.save` writes it, or from the text of one.

    A text has a line break. ValueError, which names file and field, if there is no such file, it
    cannot be read, a key is unknown or occurs twice, or a value is refused by Scene.
    """
    if isinstance(source, str) and '\n' in source:
        return scene_from_yaml(source, 'YAML text')
    path = _path(source, 'a path or a YAML string')
    return scene_from_yaml(_text('scene', path), str(path))


def _chosen(source: Any, base: object, tip: object, xacro: Any) -> Urdf | Robot:
    """Return a model that has the links chosen as ends, if it is a robot in YAML."""
    for role, name in (('base', base), ('tip', tip)):
        if not (name is None or isinstance(name, str)):
            raise ValueError(f'{role} must be the name of a link or None, got {quote(name)}')
    if not isinstance(source, (str, PathLike)) and isinstance(source, load('model.urdf.Urdf')):
        _refuse_arguments(xacro)
        urdf: Urdf = source
        return urdf
    model = _read(source, xacro)
    if isinstance(model, Robot):
        for role, asked in (('base', base), ('tip', tip)):
            if asked not in (None, getattr(model, role)):
                raise ValueError(
                    f'{role}={quote(asked)} cannot be chosen for {quote(model.name)}: a YAML file '
                    f'holds one chain, from {quote(model.base)} to {quote(model.tip)}'
                )
    return model


def _read(source: object, xacro: Mapping[str, object] | None) -> Urdf | Robot:
    if not (xacro is None or isinstance(xacro, Mapping)):
        raise ValueError(f'xacro must be a mapping, got {quote(xacro)}')
    if isinstance(source, str):
        known = _robot_files().get(source)
        if known is not None:
            return _read_yaml(known.read_text('utf-8'), str(known), xacro)
        if source.lstrip().startswith('<'):
            _refuse_arguments(xacro)
            if _root_of(source) == MJCF:
                raise ValueError('the text is MJCF, whose files name others: give its path')
            return _parsed(source, 'URDF text')
        # A line without a key is a path, of which somebody has not cut off the end.
        if '\n' in source and (':' in source or '\n' in source.strip()):
            return _read_yaml(source, 'YAML text', xacro)
    path = _path(source, 'a name, a path or a string')
    bare = isinstance(source, str) and len(path.parts) == 1
    if bare and path.suffix.lower() not in SUFFIXES and not _is_there(path):
        raise ValueError(
            f'unknown robot {quote(str(source))}: known are {", ".join(known_robots())}, and with '
            f'a description of another package {", ".join(known_robots(described=True))}; or '
            'give the path of a URDF, xacro, YAML or MJCF file'
        )
    text = _text('robot', path)
    root = _root_of(text)
    if not root and path.suffix.lower() in XML_SUFFIXES and not IS_YAML.search(text):
        root = '<'  # the reader of XML says where it is none
    macros = MACRO.search(text) or (LANGUAGE in text and EXPRESSION.search(text))
    if path.suffix.lower() == '.xacro' or (root and macros):
        expanded = load('model.xacro_files.expanded')(path, xacro or {})
        return _parsed(expanded, str(path), lines=False)
    if not root:
        return _read_yaml(text, str(path), xacro)
    _refuse_arguments(xacro)
    if root == MJCF:
        return _parsed(load('model.mjcf.urdf_of_mjcf')(path), str(path), lines=False)
    return _parsed(text, str(path))


def _parsed(text: str, origin: str, *, lines: bool = True) -> Urdf:
    urdf: Urdf = load('model.urdf.parse_urdf')(text, origin, lines)
    return urdf


def _read_yaml(text: str, origin: str, xacro: Mapping[str, object] | None) -> Urdf | Robot:
    """Return a robot in YAML: with all its numbers, or of a description in another package."""
    if not is_described(text):
        _refuse_arguments(xacro)
        return robot_from_yaml(text, origin)
    found = load('model.described.description')(text, origin)
    model = _read(found.path, {**found.xacro, **(xacro or {})})
    if isinstance(model, Robot):
        raise ValueError(f'{quote(str(found.path))} must be a URDF, got a robot in YAML')
    urdf = load('model.described.with_numbers')(model, found, text, origin)
    label = f'{found.path}, with numbers of {Path(origin).name}'
    return replace(_parsed(urdf, label, lines=False), tip=found.tip)


def _refuse_arguments(xacro: Mapping[str, object] | None) -> None:
    if xacro:
        names = quote_all(xacro)
        raise ValueError(
            f'arguments of xacro, {names}, are for a xacro file, and the robot is none'
        )


def _root_of(text: str) -> str:
    """Return the first element of an XML, '' for other text."""
    at = 0
    while before := BEFORE_ROOT.match(text, at):
        at = before.end()
    root = ROOT.match(text, at)
    # Text that starts so is XML, whatever it is; its reader says what is wrong.
    return root[1] if root else '<' if text.lstrip().startswith('<') else ''


def _path(source: object, expected: str) -> Path:
    text = fspath(source) if isinstance(source, (str, PathLike)) else ''
    if not isinstance(text, str) or not text:
        raise ValueError(f'source must be {expected}, got {quote(source)}')
    return Path(text)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long a name; a name with a zero byte
        return False


def _text(noun: str, path: Path) -> str:
    """Return the text of a file; ValueError for what is no file, too large, or no text."""
    label = quote(str(path))
    if not _is_there(path):
        raise ValueError(f'no {noun} file {label} (looked in {quote(str(Path.cwd()))})')
    try:
        if not path.is_file():  # a pipe or a device may have no end
            raise OSError(errno.EINVAL, 'it is not a regular file')
        with path.open('rb') as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise OSError(errno.EFBIG, f'it is larger than {LARGEST_FILE} bytes')
        if content.startswith(b'version https://git-lfs'):
            raise OSError(errno.EINVAL, 'it is a Git LFS pointer: run `git lfs pull`')
        return decoded(content)
    except OSError as error:
        raise ValueError(f'cannot read {label}: {error.strerror or error}') from error
    except (UnicodeDecodeError, LookupError) as error:
        # An unknown encoding is declared in the first line.
        at = error.start if isinstance(error, UnicodeDecodeError) else 0
        line = 1 + content.count(b'\n', 0, at)
        raise ValueError(f'cannot read {label}, line {line}: {error}') from error


def decoded(content: bytes) -> str:
    """
    Return the text of bytes: by their byte order mark, the declaration of an XML, or UTF-8.

    A declaration of another encoding becomes UTF-8, in which the text is published and recorded.
    LookupError for an unknown encoding, UnicodeDecodeError for bytes that it does not have.
    """
    declared = DECLARATION.match(content[:LONGEST_DECLARATION].decode('latin-1'))
    stated = declared['encoding'] if declared else 'utf-8'
    encoding = next((name for mark, name in MARKS.items() if content.startswith(mark)), stated)
    text = content.decode(encoding)
    declared = DECLARATION.match(text[:LONGEST_DECLARATION])
    if declared is None or lookup(declared['encoding']).name == 'utf-8':
        return text
    start, end = declared.span('encoding')
    return f'{text[:start]}UTF-8{text[end:]}'


def _robot_files() -> dict[str, Traversable]:
    for folder in FOLDERS:
        if folder.is_dir():
            names = {file.name: file for file in folder.iterdir()}
            return {n.removesuffix('.yaml'): f for n, f in names.items() if n.endswith('.yaml')}
    return {}
