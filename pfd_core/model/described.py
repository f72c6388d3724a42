# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots by name whose links are in another package: its file on disk, and numbers that it lacks.

Such a robot is a YAML file without `joints`. It holds `robot` (its name), `source`, and

    description  a list; the first one that is on disk counts. Each is {package, path, tip, xacro}:
                 a ROS package, a file in it, the link that is the tip, and arguments of xacro
    get          a list of ways to get a description, for the error without any
    numbers      armature, friction, damping, lower, upper, velocity, effort: lists with one number
                 a joint, from the base to the tip, which replace those of the description

A file with `joints` may have a `description`, too: of its meshes, with the same joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
import math
from pathlib import Path
import re
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

from pfd_core.model.packages import find_package
from pfd_core.model.robot import JOINT_TYPES, LIMIT_FIELDS, STATED
from pfd_core.model.urdf import Urdf
from pfd_core.model.urdf_chain import path_to
from pfd_core.model.urdf_writer import add_rotor, all_written
from pfd_core.model.values import number_from_text, quote, real_array
from pfd_core.model.yaml_files import numbers, read_yaml, table

# Ends of the range of a joint without one.
ENDS = {'lower': -math.inf, 'upper': math.inf}
KEYS, SUFFIXES = ('package', 'path', 'tip'), ('.urdf', '.xacro', '.xml')


class Description(NamedTuple):
    """A file of a package."""

    package: str
    folder: Path  # of the package
    path: Path
    tip: str
    xacro: Mapping[str, str]


def description(text: str, source: str) -> Description:
    """Return the description of a robot; ValueError, with ways to get one, if none is on disk."""
    document = read_yaml(text, source)
    if not isinstance(document, Mapping):
        raise ValueError(f'{quote(source)} must be a mapping, got {quote(document)}')
    missing = []
    for row in document.get('description', ()):
        given = table(f'description of {quote(source)}', row, KEYS, ('xacro',))
        xacro = given.get('xacro', {})
        if not isinstance(xacro, Mapping) or not all(isinstance(given[key], str) for key in KEYS):
            raise ValueError(f'description of {quote(source)} must have words, got {quote(row)}')
        name, path = given['package'], given['path']
        if not path.endswith(SUFFIXES):
            raise ValueError(
                f'path in the description of {quote(source)} must end in one of '
                f'{", ".join(SUFFIXES)}, got {quote(path)}'
            )
        package = find_package(name)
        if package is not None and (package / path).is_file():
            return Description(name, package, package / path, given['tip'], xacro)
        missing.append(f'{name} ({path})' if package is None else f'{path} in {package}')
    ways = '; or '.join(map(str, document.get('get', ())))
    raise ValueError(
        f'no description of {quote(document.get("robot"))} is on disk: no package '
        f'{", no package ".join(missing)}. Get one: {ways}. Or give the path of a URDF or xacro '
        'file in place of the name'
    )


def with_numbers(urdf: Urdf, found: Description, text: str, source: str) -> str:
    """
    Return the URDF of a description with the name and the numbers of a robot in YAML.

    Meshes in its package are named by the package, as others may read the text elsewhere.
    ValueError, which names the source, for wrong numbers.
    """
    rest = ('source', 'get', 'numbers')
    document = table(quote(source), read_yaml(text, source), ('robot', 'description'), rest)
    above = path_to(found.tip, {joint.child: joint for joint in urdf.joints.values()})
    joints = [x.name for x in above if x.kind in JOINT_TYPES and x.mimic is None]
    root = ElementTree.fromstring(urdf.text.strip())
    root.set('name', str(document['robot']))
    elements = {joint.get('name'): joint for joint in root.findall('joint')}
    label = f'numbers of {quote(source)}'
    read = partial(number_from_text, infinite=True)
    for key, column in table(label, document.get('numbers', {}), (), tuple(STATED)).items():
        values = numbers(f'{key} in {label}', column, read)
        row = real_array(f'{key} in {label}', values, shape=(len(joints),), infinite=True)
        for joint, value in zip(joints, row.tolist(), strict=True):
            if key == 'armature':
                for old in root.findall('transmission'):
                    if joint in (moved.get('name') for moved in old.findall('joint')):
                        root.remove(old)
                add_rotor(root, joint, value)
                continue
            tag = 'limit' if key in LIMIT_FIELDS else 'dynamics'
            element = elements[joint].find(tag)
            if element is None:
                element = ElementTree.SubElement(elements[joint], tag)
            element.attrib.update(all_written({key: value}))
            turning = elements[joint].get('type') == 'continuous'
            if key in ENDS and turning and math.isfinite(value):
                # It has no range in a URDF, whose reader would ignore these numbers.
                elements[joint].set('type', 'revolute')
                element.attrib.update(all_written(ENDS | {key: value}))
    for mesh in root.iter('mesh'):
        path = re.sub('^file:/*', '/', mesh.get('filename', ''))
        if path.startswith(f'{found.folder}/'):
            mesh.set('filename', f'package://{found.package}{path[len(str(found.folder)) :]}')
    return ElementTree.tostring(root, encoding='unicode')
