# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots as YAML: tables copied from papers, and robots stored to the last bit.

A file holds `robot` (its name), `joints` (a list), and optionally `source`, `base`, `tip` and
`frames`. Each joint has `name`, `type` and `mass` [kg]; `center` [m] and `inertia` [kg m^2],
about the centre of mass, with the elements `xx yy zz xy yz xz`, are zero by default. Its placement
is one of

    dh           {a, d, alpha_deg, theta_deg}, the standard row: turn theta + q about z, move d
                 along it, a along x, turn alpha about x. Body in the frame at the end.
    modified_dh  {a, alpha_deg, d, theta_deg}, after Craig: turn alpha about x, move a along
                 it, turn theta + q about z, move d along it. Body in the frame at the end.
    frame        {rotation, translation}: the end of the link seen from its joint at q = 0, as
                 `Robot` has them. Body in the frame at the end.

and the same one for all joints of a file. Optional for a joint: `limits` {lower, upper, velocity,
effort}; `damping`, `friction`, `armature` at the joint; `rotor` {inertia, gear_ratio, damping,
friction} at the motor, carried to the joint by the gear; `accept_unphysical_inertia`, if the
published numbers break the triangle rule.

`base` and `tip` are names of links, or {link, rotation, translation}: the placement of frame 0 in
the base link; for modified_dh also the placement of the tip in the last joint's frame.

`frames` has further frames by name, {link, rotation, translation}: fixed to link 1 to n and placed
in that frame of `Robot`, or fixed to the base link, 0, and placed in its frame.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from pfd_core.model.geometry import (
    Placement,
    cos_sin_degrees,
    product,
    rotation_x,
    rotation_z,
    symmetric,
    welded_frames,
)
from pfd_core.model.robot import JOINT_FIELDS, LIMIT_FIELDS, Frame, Robot, check_robot
from pfd_core.model.values import Array, number_from_text, quote, real_number, switch
from pfd_core.model.yaml_reader import read_yaml, table, yaml_text

ELEMENTS = {'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'yz': (1, 2), 'xz': (0, 2)}
UNLIMITED = dict.fromkeys(LIMIT_FIELDS, math.inf) | {'lower': -math.inf}
PLACED_BY = ('dh', 'modified_dh', 'frame')
ROW = ('a', 'd', 'alpha_deg', 'theta_deg')
FRAME = ('rotation', 'translation')
OPTIONAL = ('source', 'base', 'tip', 'frames')


def robot_to_yaml(robot: Robot, *, frames: bool = False) -> str:
    """
    Return a robot as YAML; `load_robot` makes the same robot of it, to the last bit.

    Frames besides base and tip are written if `frames` is set: they change no motion.
    """
    check_robot(robot)
    frames = switch('frames', frames)
    joints = []
    for i, name in enumerate(robot.joint_names):
        joint = {
            'name': name,
            'type': robot.joint_types[i],
            'frame': {
                'rotation': robot.rotations[i].tolist(),
                'translation': robot.translations[i].tolist(),
            },
            'mass': float(robot.masses[i]),
            'center': robot.centers[i].tolist(),
            'inertia': {key: float(robot.inertias[i][at]) for key, at in ELEMENTS.items()},
            'limits': {k: float(getattr(robot, at)[i]) for k, at in LIMIT_FIELDS.items()},
        }
        joint |= {k: float(getattr(robot, k)[i]) for k in ('damping', 'friction', 'armature')}
        if name in robot.accepted:
            joint['accept_unphysical_inertia'] = True
        joints.append(joint)
    base = {
        'link': robot.base,
        'rotation': robot.base_rotation.tolist(),
        'translation': robot.base_position.tolist(),
    }
    document = {'robot': robot.name, 'source': robot.source, 'base': base, 'tip': robot.tip}
    further = {
        name: {'link': frame.link} | {key: getattr(frame, key).tolist() for key in FRAME}
        for name, frame in robot.frames.items()
    }
    return yaml_text(document | {'joints': joints} | ({'frames': further} if frames else {}))


def robot_from_yaml(text: str, source: str) -> Robot:
    """
    Return the robot that a YAML text describes.

    Parameters
    ----------
    text : str
        The text, in the format of this module.
    source : str
        Origin of the text: the robot's `source` if the text has none.

    Raises
    ------
    ValueError
        If the text is no YAML, or a key is missing, unknown or has a wrong value, which is named.

    """
    document = read_yaml(text, source)
    document = table(quote(source), document, ('robot', 'joints'), OPTIONAL)
    name = document['robot']
    rows = document['joints']
    if not isinstance(rows, list):
        raise ValueError(f'joints of {quote(name)} must be a list, got {quote(rows)}')
    joints = [_joint(i, row) for i, row in enumerate(rows)]
    fields: dict[str, Any] = {key: np.array([j[key] for j in joints]) for key in JOINT_FIELDS}
    base, base_rotation, base_position = _end('base', document.get('base', 'base'))
    return Robot(
        name=name,
        joint_names=tuple(j['name'] for j in joints),
        joint_types=tuple(j['type'] for j in joints),
        base=base,
        tip=_end('tip', document.get('tip', 'tip'))[0],
        source=document.get('source', source),
        accepted=tuple(j['name'] for j in joints if j['accepted']),
        **_frames(name, joints, (base_rotation, base_position), document.get('tip', 'tip')),
        **fields,
        frames=_further_frames(document.get('frames', {})),
    )


def _further_frames(value: Any) -> dict[str, Frame]:
    if not isinstance(value, Mapping):
        raise ValueError(f'frames must be a table of frames by name, got {quote(value)}')
    found = {}
    for name, row in value.items():
        label = f'frame {quote(name)}'
        link = _number(f'link of {label}', table(label, row, ('link',), FRAME)['link'])
        if not link.is_integer():
            raise ValueError(f'link of {label} must be a whole number, got {link}')
        found[name] = Frame(int(link), *_placement(label, row))
    return found


def _frames(name: str, joints: list[dict[str, Any]], base: Placement, tip: Any) -> dict[str, Any]:
    """Return the fields of `Robot` for frames, masses, centres and inertias."""
    ways = {j['placed_by'] for j in joints}
    if len(ways) > 1:
        raise ValueError(
            f'joints of {quote(name)} must all be placed the same way, got {sorted(ways)}'
        )
    if ways == {'modified_dh'}:
        _, tip_rotation, tip_position = _end('tip', tip)
        frames = [j['frame'] for j in joints]
        R, p = frames[0]
        first = (product(base[0], R), base[1] + product(base[0], p))
        placements = [first, *frames[1:], (tip_rotation, tip_position)]
        return welded_frames(placements, [j['body'] for j in joints])
    if isinstance(tip, Mapping) and set(tip) != {'link'}:
        raise ValueError(
            f'tip of {quote(name)} must be the name of a link: its position is given by the '
            f"last joint's {next(iter(ways), 'frame')}"
        )
    return {
        'rotations': np.array([j['frame'][0] for j in joints]),
        'translations': np.array([j['frame'][1] for j in joints]),
        'masses': np.array([j['body'][0] for j in joints]),
        'centers': np.array([j['body'][1] for j in joints]),
        'inertias': np.array([j['body'][2] for j in joints]),
        'base_rotation': base[0],
        'base_position': base[1],
    }


def _joint(index: int, row: Any) -> dict[str, Any]:
    name = row.get('name', f'number {index + 1}') if isinstance(row, Mapping) else index + 1
    label = f'joint {quote(name)}'
    optional = ('center', 'inertia', 'limits', 'damping', 'friction', 'armature', 'rotor')
    row = table(
        label, row, ('name', 'type', 'mass'), (*optional, *PLACED_BY, 'accept_unphysical_inertia')
    )
    ways = [key for key in PLACED_BY if key in row]
    if len(ways) != 1:
        raise ValueError(f'{label} must have exactly one of {", ".join(PLACED_BY)}, got {ways}')
    if 'rotor' in row and 'armature' in row:
        raise ValueError(f'{label} has both rotor and armature; give one of them')
    limits = table(f'limits of {label}', row.get('limits', {}), (), tuple(LIMIT_FIELDS))
    inertia = table(f'inertia of {label}', row.get('inertia', {}), (), tuple(ELEMENTS))
    elements = [_number(f'inertia {k} of {label}', inertia.get(k, 0.0)) for k in ELEMENTS]
    return {
        'name': row['name'],
        'type': row['type'],
        'placed_by': ways[0],
        'frame': _placed(label, ways[0], row[ways[0]]),
        'body': (
            _number(f'mass of {label}', row['mass']),
            _numbers(f'center of {label}', row.get('center', [0, 0, 0]), (3,)),
            symmetric(*elements),
        ),
        'accepted': _truth(label, row),
        **{
            LIMIT_FIELDS[k]: _number(f'limit {k} of {label}', value, infinite=True)
            for k, value in (UNLIMITED | dict(limits)).items()
        },
        **_drive(label, row),
    }


def _placed(label: str, way: str, value: Any) -> Placement:
    """Return a frame in the frame before it, at q = 0."""
    place = f'{way} of {label}'
    if way == 'frame':
        return _placement(place, table(place, value, FRAME, ()))
    row = {k: _number(f'{k} in {place}', v) for k, v in table(place, value, ROW, ()).items()}
    turn = rotation_z(*cos_sin_degrees(row['theta_deg']))
    twist = rotation_x(*cos_sin_degrees(row['alpha_deg']))
    along_x, along_z = np.array([row['a'], 0.0, 0.0]), np.array([0.0, 0.0, row['d']])
    if way == 'dh':
        return product(turn, twist), along_z + product(turn, along_x)
    return product(twist, turn), along_x + product(twist, along_z)


def _drive(label: str, row: Mapping[str, Any]) -> dict[str, float]:
    """Return damping, friction and armature at the joint, including the rotor."""
    keys = ('damping', 'friction', 'armature')
    own = {k: _number(f'{k} of {label}', row.get(k, 0.0)) for k in keys}
    if 'rotor' not in row:
        return own
    motor = f'rotor of {label}'
    given = table(motor, row['rotor'], ('inertia', 'gear_ratio'), ('damping', 'friction'))
    rotor = {key: _number(f'{key} of {motor}', value) for key, value in given.items()}
    gear = abs(rotor['gear_ratio'])
    return {
        'damping': own['damping'] + rotor.get('damping', 0.0) * gear**2,
        'friction': own['friction'] + rotor.get('friction', 0.0) * gear,
        'armature': rotor['inertia'] * gear**2,
    }


def _end(role: str, value: Any) -> tuple[str, Array, Array]:
    """Return the name of an end link, and the axes and origin of the chain's frame in it."""
    if isinstance(value, str):
        return value, np.eye(3), np.zeros(3)
    end = table(role, value, ('link',), FRAME)
    return (end['link'], *_placement(role, end))


def _placement(label: str, frame: Mapping[str, Any]) -> Placement:
    rotation = frame.get('rotation', np.eye(3))
    translation = frame.get('translation', np.zeros(3))
    return (
        _numbers(f'rotation in {label}', rotation, (3, 3)),
        _numbers(f'translation in {label}', translation, (3,)),
    )


def _truth(label: str, row: Mapping[str, Any]) -> bool:
    value = row.get('accept_unphysical_inertia', 'false')
    if value not in ('true', 'True', 'false', 'False'):
        raise ValueError(
            f'accept_unphysical_inertia of {label} must be true or false, got {quote(value)}'
        )
    return value in ('true', 'True')


def _number(label: str, value: Any, *, infinite: bool = False) -> float:
    """Return a number from its text, or a default from the number itself."""
    if isinstance(value, str):
        return number_from_text(label, value, infinite=infinite)
    return real_number(label, value, finite=not infinite)


def _numbers(label: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return nested lists of texts as an array of a shape."""
    try:
        array = np.asarray(value, dtype=object)
    except ValueError:
        array = np.zeros(())
    if array.shape != shape:
        raise ValueError(f'{label} must have shape {shape}, got {quote(value)}')
    flat = [_number(label, item) for item in array.ravel()]
    return np.array(flat, dtype=np.float64).reshape(shape)
