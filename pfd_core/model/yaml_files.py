# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
YAML: any document as strings, bounded in size, and robots, from tables in papers to the last bit.

YAML 1.1 reads `no` as false, 1:30 as 90 and 1_0 as 10, and takes the last of two equal keys. Here
every scalar stays a string, which is converted where it is used, and two equal keys are an error.

A robot's file holds `robot` (its name), `joints` (a list), and optionally `source`, `base`, `tip`
and `frames`. Each joint has `name`, `type` and `mass` [kg]; `center` [m] and `inertia` [kg m^2],
about the centre of mass, with the elements `xx yy zz xy yz xz`, are zero by default. Its placement
is one of

    dh           {a, d, alpha_deg, theta_deg}, the standard row: turn theta + q about z, move d
                 along it, a along x, turn alpha about x. Body in the frame at the end.
    modified_dh  {a, alpha_deg, d, theta_deg}, after Craig: turn alpha about x, move a along
                 it, turn theta + q about z, move d along it. Body in the frame at the end.
    frame        {rotation, translation}: the end of the link seen from its joint at q = 0, as
                 `Robot` has them. Body in the frame at the end.

and the same one for all joints of a file. Optional for a joint: `limits` {lower, upper, velocity,
effort}, where a velocity or effort of 0 or below and a lower above upper mean no limit, with a
warning; `damping`, `friction`, `armature` at the joint; `rotor` {inertia, gear_ratio, damping,
friction} at the motor, carried to the joint by the gear; `accept_unphysical_inertia`, if the
published numbers break the triangle rule. A joint may instead have `follows` {joint, multiplier,
offset}: it moves with another one, at multiplier * position + offset.

`base` and `tip` are names of links, or {link, rotation, translation}: the placement of frame 0 in
the base link; for modified_dh also the placement of the tip in the last joint's frame. The base
may also have `root_rotation`: its axes in the root of the model, in which gravity is given.

`frames` has further frames by name, {link, rotation, translation}: fixed to link 1 to n and placed
in that frame of `Robot`, or fixed to the base link, 0, and placed in its frame.

A robot without `joints` has its links in another package: pfd_core.model.described.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
import re
from typing import Any, NamedTuple

import numpy as np
import yaml

from pfd_core.model.geometry import (
    AT_ORIGIN,
    Body,
    Placement,
    chain_fields,
    composed,
    cos_sin_degrees,
    rotation_x,
    rotation_z,
    symmetric,
    welded_fields,
)
from pfd_core.model.limits import Row, joint_fields, known_limits
from pfd_core.model.robot import (
    LIMIT_FIELDS,
    Frame,
    Robot,
    check_robot,
    stated,
    turned,
)
from pfd_core.model.values import Array, number_from_text, quote, real_array, real_number, switch

# Four hundred joints are stored in 330 kB.
MOST_CHARACTERS = 1_000_000
# Values of a document: an alias of lists of aliases makes many of few characters.
MOST_VALUES = 1_000_000

# The words of YAML 1.2 for none, true and false.
YAML_WORDS: dict[str, Any] = {
    **dict.fromkeys(('null', 'Null', 'NULL', '~'), None),
    **dict.fromkeys(('true', 'True', 'TRUE'), True),
    **dict.fromkeys(('false', 'False', 'FALSE'), False),
}
ELEMENTS = {'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'yz': (1, 2), 'xz': (0, 2)}
LOSSES = ('damping', 'friction', 'armature')
PLACED_BY = ('dh', 'modified_dh', 'frame')
ROW = ('a', 'd', 'alpha_deg', 'theta_deg')
FRAME = ('rotation', 'translation')
ACCEPT = 'accept_unphysical_inertia'
# A follower has none of these.
OF_MOTORS = ('limits', *LOSSES, 'rotor')
OPTIONAL = ('center', 'inertia', *OF_MOTORS, *PLACED_BY, 'follows')
# Keys at the beginning of a line.
JOINTS, DESCRIPTION = (re.compile(rf'^{key}:', re.MULTILINE) for key in ('joints', 'description'))


def read_yaml(text: str, source: str) -> Any:
    """
    Return the document of a YAML text, made of dict, list and str.

    Anchors, aliases and merge keys may be used. ValueError, which names the `source`, if it is no
    YAML, has two equal keys or is too large with its aliases expanded.
    """
    if len(text) > MOST_CHARACTERS:
        raise ValueError(
            f'{quote(source)} has {len(text)} characters; a YAML file may have {MOST_CHARACTERS}'
        )
    try:
        found = _Loader(text).get_single_data()
    except yaml.YAMLError as error:
        problem = getattr(error, 'problem', None) or getattr(error, 'reason', None) or 'unreadable'
        mark = getattr(error, 'problem_mark', None)
        line = '' if mark is None else f' in line {mark.line + 1}'
        raise ValueError(f'{quote(source)} is not YAML: {quote(problem)[1:-1]}{line}') from error
    except RecursionError as error:
        raise ValueError(f'{quote(source)} is nested too deep') from error
    count, left = 0, [found]
    while left:
        value = left.pop()
        count += 1
        if count > MOST_VALUES:
            raise ValueError(
                f'{quote(source)} has more than {MOST_VALUES} values, aliases expanded'
            )
        if isinstance(value, (list, dict)):
            left += value if isinstance(value, list) else value.values()
    return found


def is_described(text: str) -> bool:
    """Return whether a YAML text is a robot without joints, whose links are in another package."""
    return DESCRIPTION.search(text) is not None and JOINTS.search(text) is None


# Of libyaml, where PyYAML was built with it, which takes a tenth of the time.
_Base: Any = getattr(yaml, 'CBaseLoader', yaml.BaseLoader)


class _Loader(_Base):  # type: ignore[misc]
    """Makes strings, lists and tables, whatever a scalar looks like and a tag says."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Return a table; YAMLError for two equal keys."""
        found = super().construct_mapping(node, deep)
        if len(found) < len(node.value):
            (twice, _), *_ = Counter(key.value for key, _ in node.value).most_common(1)
            problem = f'key {quote(twice)} occurs more than once'
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        others = found.pop('<<', [])
        for other in others if isinstance(others, list) else [others]:
            if not isinstance(other, dict):
                raise yaml.MarkedYAMLError(problem=f'<< takes tables, got {quote(other)}')
            found = other | found
        return found


def table(
    label: str, value: Any, required: tuple[str, ...], optional: tuple[str, ...]
) -> Mapping[str, Any]:
    """Return a mapping; ValueError unless it has the required keys and no unknown one."""
    known = ', '.join(required + optional)
    if not isinstance(value, Mapping):
        raise ValueError(f'{label} must be a mapping with {known}')
    for key in required:
        if key not in value:
            raise ValueError(f'{label} has no {key!r}; it must have {", ".join(required)}')
    for key in value:
        if key not in required + optional:
            raise ValueError(f'{label} has an unknown key {quote(key)}; known keys are {known}')
    return value


def numbers(label: str, value: Any, read: Callable[[str, str], Any] = number_from_text) -> Any:
    """Return a string as a number, by `read`; also each element of a list."""
    if isinstance(value, list):
        return [numbers(label, item, read) for item in value]
    if not isinstance(value, str):
        raise ValueError(f'{label} must be a number, a list or a word, got a table')
    return read(label, value)


def yaml_text(document: Mapping[str, Any]) -> str:
    """Return a document as YAML, of whose numbers `read_yaml` gives the same floats."""
    # PyYAML writes the shortest digits that read back as the same float.
    text: str = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=99)
    return text


def robot_to_yaml(robot: Robot, *, frames: bool = False) -> str:
    """
    Return a robot as YAML; `load_robot` makes the same robot of it, to the last bit.

    Frames besides base and tip are written if `frames` is set: they change no motion.
    """
    check_robot(robot)
    frames = switch('frames', frames)
    joints = []
    for i, mover in enumerate(robot.movers):
        joint = {
            'name': mover.name,
            'type': mover.kind,
            'frame': {key: getattr(robot, f'{key}s')[i].tolist() for key in FRAME},
            'mass': float(robot.masses[i]),
            'center': robot.centers[i].tolist(),
            'inertia': {key: float(robot.inertias[i][at]) for key, at in ELEMENTS.items()},
        }
        given = stated(robot, mover.name)
        limits = {key: given.pop(key) for key in LIMIT_FIELDS if key in given}
        joint |= ({'limits': limits} if limits else {}) | given
        if mover.name not in robot.joint_names:
            rule = {'multiplier': mover.multiplier, 'offset': mover.offset}
            joint['follows'] = {'joint': mover.leader, **rule}
        if mover.name in robot.accepted:
            joint[ACCEPT] = True
        joints.append(joint)
    base = {
        'link': robot.base,
        'rotation': robot.base_rotation.tolist(),
        'translation': robot.base_position.tolist(),
    }
    if turned(robot):
        base['root_rotation'] = robot.root_rotation.tolist()
    document: dict[str, Any] = {'robot': robot.name, 'source': robot.source}
    document |= {'base': base, 'tip': robot.tip, 'joints': joints}
    if frames:
        document['frames'] = {
            name: {'link': frame.link} | {key: getattr(frame, key).tolist() for key in FRAME}
            for name, frame in robot.frames.items()
        }
    return yaml_text(document)


def robot_from_yaml(text: str, source: str) -> Robot:
    """
    Return the robot that a YAML text describes, in the format of this module.

    `source` is the origin of the text, and the robot's if the text states none. ValueError, which
    names it, for a text that is no YAML and a key that is missing, unknown or has a wrong value.
    """
    # The meshes of a description are for pictures.
    optional = ('source', 'base', 'tip', 'frames', 'description')
    document = table(quote(source), read_yaml(text, source), ('robot', 'joints'), optional)
    name, rows = document['robot'], document['joints']
    if not isinstance(rows, list):
        raise ValueError(f'joints of {quote(name)} must be a list, got {quote(rows)}')
    joints = [_joint(i, row) for i, row in enumerate(rows, 1)]
    ends: Any = document.get('base', 'base')
    root = np.eye(3)
    if isinstance(ends, Mapping) and 'root_rotation' in ends:
        ends = {**ends}
        root = _array('root_rotation in base', ends.pop('root_rotation'), (3, 3))
    (base, first), (tip, last) = _end('base', ends), _end('tip', document.get('tip', 'tip'))
    further = document.get('frames', {})
    if not isinstance(further, Mapping):
        raise ValueError(f'frames must be a table of frames by name, got {quote(further)}')
    return Robot(
        name=name,
        base=base,
        tip=tip,
        source=document.get('source', source),
        accepted=tuple(joint.row.name for joint in joints if joint.accepted),
        **_chain(name, joints, first, last),
        root_rotation=root,
        **joint_fields(name, [joint.row for joint in joints], '{}: {}.inf'),
        frames={frame: _frame(f'frame {quote(frame)}', row) for frame, row in further.items()},
    )


def _frame(label: str, row: Any) -> Frame:
    link = _number(f'link of {label}', table(label, row, ('link',), FRAME)['link'])
    if not link.is_integer():
        raise ValueError(f'link of {label} must be a whole number, got {link}')
    return Frame(int(link), *_placement(label, row))


def _chain(
    name: str, joints: list[Joint], base: Placement | None, tip: Placement | None
) -> dict[str, Any]:
    """Return the fields of `Robot` for frames, masses, centres and inertias."""
    ways = sorted({joint.way for joint in joints})
    if len(ways) > 1:
        raise ValueError(f'joints of {quote(name)} must all be placed the same way, got {ways}')
    frames, bodies = [joint.frame for joint in joints], [joint.body for joint in joints]
    start = base or AT_ORIGIN
    if ways == ['modified_dh']:
        first, *others = frames
        return welded_fields([composed(start, first), *others, tip or AT_ORIGIN], bodies)
    if tip is not None:
        raise ValueError(
            f'tip of {quote(name)} must be the name of a link: its position is given by the '
            f"last joint's {(*ways, 'frame')[0]}"
        )
    return chain_fields([start, *frames], bodies)


class Joint(NamedTuple):
    """A joint of a file, and the link that it moves."""

    row: Row
    way: str  # of PLACED_BY
    frame: Placement
    body: Body
    accepted: bool


def _joint(number: int, row: Any) -> Joint:
    name = row.get('name', f'number {number}') if isinstance(row, Mapping) else number
    label = f'joint {quote(name)}'
    row = table(label, row, ('name', 'type', 'mass'), (*OPTIONAL, ACCEPT))
    ways = [key for key in PLACED_BY if key in row]
    if len(ways) != 1:
        raise ValueError(f'{label} must have exactly one of {", ".join(PLACED_BY)}, got {ways}')
    inertia = _numbers('inertia', label, row, tuple(ELEMENTS))
    place, accepted = f'{ACCEPT} of {label}', row.get(ACCEPT, 'false')
    accepted = switch(place, numbers(place, accepted, lambda _, text: YAML_WORDS.get(text, text)))
    follows: tuple[str, float, float] | None = None
    if 'follows' in row:
        place, given = f'follows of {label}', [key for key in OF_MOTORS if key in row]
        if given:
            raise ValueError(
                f'{label} follows another one, which must have its {", ".join(given)}'
            )
        rule = table(place, row['follows'], ('joint',), ('multiplier', 'offset'))
        multiplier = _number(place, rule.get('multiplier', '1'))
        follows = rule['joint'], multiplier, _number(place, rule.get('offset', '0'))
    mass = _number(f'mass of {label}', row['mass'])
    center = _array(f'center of {label}', row.get('center', ['0'] * 3), (3,))
    known, unlimited = known_limits(_numbers('limits', label, row, tuple(LIMIT_FIELDS)))
    return Joint(
        Row(row['name'], row['type'], known | _losses(label, row), unlimited, follows),
        ways[0],
        _placed(label, ways[0], row[ways[0]]),
        (mass, center, symmetric(*(inertia.get(key, 0.0) for key in ELEMENTS))),
        accepted,
    )


def _numbers(
    part: str, label: str, row: Mapping[str, Any], known: tuple[str, ...]
) -> dict[str, float]:
    """Return a table of numbers in the row of a joint, {} without one; limits may be infinite."""
    place = f'{part} of {label}'
    read = partial(number_from_text, infinite=part == 'limits')
    items = table(place, row.get(part, {}), (), known).items()
    return {key: _number(f'{key} in {place}', value, read) for key, value in items}


def _placed(label: str, way: str, value: Any) -> Placement:
    """Return a frame in the frame before it, at q = 0."""
    place = f'{way} of {label}'
    if way == 'frame':
        return _placement(place, table(place, value, FRAME, ()))
    row = {k: _number(f'{k} in {place}', v) for k, v in table(place, value, ROW, ()).items()}
    about_z = rotation_z(*cos_sin_degrees(row['theta_deg'])), np.array([0.0, 0.0, row['d']])
    about_x = rotation_x(*cos_sin_degrees(row['alpha_deg'])), np.array([row['a'], 0.0, 0.0])
    return composed(about_z, about_x) if way == 'dh' else composed(about_x, about_z)


def _losses(label: str, row: Mapping[str, Any]) -> dict[str, float]:
    """Return damping, friction and armature at the joint, with the rotor's, as far as stated."""
    found = {key: _number(f'{key} of {label}', row[key]) for key in LOSSES if key in row}
    if 'rotor' not in row:
        return found
    if 'armature' in row:
        raise ValueError(f'{label} has both rotor and armature; give one of them')
    motor = f'rotor of {label}'
    given = table(motor, row['rotor'], ('inertia', 'gear_ratio'), ('damping', 'friction'))
    rotor = {key: _number(f'{key} of {motor}', value) for key, value in given.items()}
    gear = abs(rotor['gear_ratio'])
    found['armature'] = rotor['inertia'] * gear**2
    for key, power in (('damping', 2), ('friction', 1)):
        if key in rotor:
            found[key] = found.get(key, 0.0) + rotor[key] * gear**power
    return found


def _end(role: str, value: Any) -> tuple[str, Placement | None]:
    """Return the name of an end link, and the placement of the chain's frame in it, if given."""
    if isinstance(value, str):
        return value, None
    end = table(role, value, ('link',), FRAME)
    return end['link'], _placement(role, end) if len(end) > 1 else None


def _placement(label: str, frame: Mapping[str, Any]) -> Placement:
    R, p = AT_ORIGIN
    if 'rotation' in frame:
        R = _array(f'rotation in {label}', frame['rotation'], (3, 3))
    if 'translation' in frame:
        p = _array(f'translation in {label}', frame['translation'], (3,))
    return R, p


def _number(label: str, text: Any, read: Callable[[str, str], float] = number_from_text) -> float:
    return real_number(label, numbers(label, text, read), finite=False)


def _array(label: str, texts: Any, shape: tuple[int, ...]) -> Array:
    return real_array(label, numbers(label, texts), shape=shape)
