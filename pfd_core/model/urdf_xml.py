# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
XML of a URDF, bounded in size and depth: elements with their lines, and the table of what is read.

From the table follow the values of an element, their errors, and the names of all that is unread.
The inertia of rotors is in transmissions, which hold what each tool likes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
import re
from typing import Any, NamedTuple
from xml.parsers import expat

from pfd_core.model.limits import reflected_inertia
from pfd_core.model.values import BLANKS, number_from_text, quote, quote_all

# Published URDFs have up to 1 MB, and 4000 elements, 8 within each other.
MOST_CHARACTERS = 16 * 2**20
MOST_ELEMENTS, DEEPEST = 100_000, 100

Triple = tuple[float, float, float]

INERTIA_KEYS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
# The other half of the symmetric matrix, which exporters of CAD write too.
OTHER_HALF = {'iyx': 'ixy', 'izx': 'ixz', 'izy': 'iyz'}
QUATERNIONS = 'quat_xyzw'
# Name in a <joint> of what couples it to others, as models of MuJoCo have it.
EQUALITY = 'equality'
# What is read: the attributes of an element, and the elements in it.
READ = {
    'robot': ('name version', 'link joint transmission'),
    'link': ('name', 'inertial'),
    'inertial': ('', 'origin mass inertia'),
    'origin': (f'xyz rpy {QUATERNIONS}', ''),
    'mass': ('value', ''),
    'inertia': (' '.join((*INERTIA_KEYS, *OTHER_HALF)), ''),
    'joint': ('name type', f'parent child origin axis limit dynamics mimic {EQUALITY}'),
    **dict.fromkeys(('parent', 'child'), ('link', '')),
    'axis': ('xyz', ''),
    'limit': ('lower upper velocity effort', ''),
    'dynamics': ('damping friction', ''),
    'mimic': ('joint multiplier offset', ''),
    EQUALITY: ('name', ''),
    'transmission': ('name type', ''),
}
# Attributes that are texts, and that are several numbers; others are one, and these must be there.
TEXTS = {'name', 'version', 'type', 'link', 'joint'}
ROWS = {'xyz': (3, 'three'), 'rpy': (3, 'three'), QUATERNIONS: (4, 'four')}
NEEDED = {'value', *INERTIA_KEYS}
# Elements of other readers, and those in a <gazebo> that are physics of joints.
FOREIGN = {'visual', 'collision', 'contact', 'material', 'sensor', 'gazebo', 'ros2_control'}
FOREIGN |= {'safety_controller', 'calibration'}
SPRINGS = {'springStiffness', 'springReference'}

# Rotors: local name of the inertia -> local names of the ratio. The format has no element for the
# inertia of a rotor. Two extensions are read, both in the <actuator> of a <transmission> with one
# joint: Drake's <drake:rotor_inertia value> with <drake:gear_ratio value>, and <motorInertia> with
# the reduction that ROS 1 writes in the <actuator> or the <transmission>, and ROS 2 in the
# <joint>. A reduction alone is ambiguous: most files have 1 or its inverse there.
ROTORS = {
    'rotor_inertia': ('gear_ratio',),
    'motorInertia': ('mechanicalReduction', 'mechanical_reduction'),
}
# Types of transmissions that ROS has; others are of plugins.
SIMPLE = 'SimpleTransmission'
TRANSMISSIONS = ('', SIMPLE, 'DifferentialTransmission', 'FourBarLinkageTransmission')


class Place(NamedTuple):
    """Where an element is: file or 'URDF text', and line, 0 if unknown."""

    source: str
    line: int

    def __str__(self) -> str:
        """Return the place as the start of an error."""
        return repr(self.source)[1:-1] + (f', line {self.line}' if self.line else '')

    @property
    def short(self) -> str:
        """The line alone, to follow the name of an element."""
        return f' (line {self.line})' if self.line else ''


@dataclass(eq=False)
class Element:
    """An element of an XML; names in a namespace are URI}NAME."""

    tag: str
    attributes: dict[str, str]
    place: Place
    elements: list[Element] = field(default_factory=list)
    text: str = ''

    def all(self, tag: str) -> list[Element]:
        """Return the elements in it with a tag."""
        return [element for element in self.elements if element.tag == tag]

    def error(self, problem: str) -> ValueError:
        """Return an error that starts with its place."""
        return ValueError(f'{self.place}: {problem}')


def robot_element(text: str, source: str, lines: bool) -> Element:
    """Return the <robot> of a text, without entities, which could expand to any size."""
    if len(text) > MOST_CHARACTERS:
        problem = f'the URDF has {len(text)} characters, more than the {MOST_CHARACTERS}'
        raise ValueError(f'{Place(source, 0)}: {problem} supported')
    before = text[: len(text) - len(text.lstrip())].count('\n')
    parser = expat.ParserCreate(namespace_separator='}')
    count, path = 0, [Element('', {}, Place(source, 0))]

    def place(line: int) -> Place:
        return Place(source, before + line if lines else 0)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        element = Element(tag, attributes, place(parser.CurrentLineNumber))
        if count > MOST_ELEMENTS:
            raise element.error(f'the URDF has more than the {MOST_ELEMENTS} elements supported')
        if len(path) > DEEPEST:
            raise element.error(f'the URDF has elements more than {DEEPEST} deep')
        if 'xacro' in tag.rpartition('}')[0]:
            raise element.error(
                f'the URDF has <xacro:{local(tag)}>, which is not expanded: load the '
                '.xacro file, or run `xacro FILE > robot.urdf` first'
            )
        path[-1].elements.append(element)
        path.append(element)

    def data(words: str) -> None:
        path[-1].text += words

    def refuse(*_: object) -> None:
        raise ValueError(f'{place(parser.CurrentLineNumber)}: a URDF has no <!DOCTYPE>')

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: path.pop()
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = data, refuse
    parser.buffer_text = True
    try:
        parser.Parse(text.strip(), True)
    except expat.ExpatError as error:
        problem = f'not well-formed XML: {expat.ErrorString(error.code)}'
        raise ValueError(f'{place(error.lineno)}: {problem}') from error
    except UnicodeEncodeError as error:
        line = text.count('\n', 0, error.start) + 1
        raise ValueError(f'{place(line)}: not well-formed XML: {error}') from error
    (root,) = path[0].elements
    if root.tag != 'robot':
        raise root.error(f'a URDF starts with <robot>, this with <{quote(root.tag)[1:-1]}>')
    return root


def local(tag: str) -> str:
    """Return a name without its namespace, to be shown."""
    return quote(tag.rpartition('}')[2])[1:-1]


def named(root: Element, tag: str) -> dict[str, Element]:
    """Return the elements with a tag by name; ValueError for none or the same one."""
    found: dict[str, Element] = {}
    for element in root.all(tag):
        name = element.attributes.get('name')
        if not name:
            raise element.error(f'the URDF has a <{tag}> without a name')
        if name in found:
            first = found[name].place.short
            raise element.error(f'the URDF has two {tag}s named {quote(name)}{first}')
        found[name] = element
    return found


def values(element: Element, label: str) -> dict[str, Any]:
    """
    Return what READ names of an element: values, and such dicts of elements, by name.

    Each has a `place`. ValueError for no numbers, and for two elements, as readers differ on them.
    """
    tag, found = element.tag, dict[str, Any](place=element.place)
    attributes, elements = map(str.split, READ[tag])
    for key in attributes:
        text = element.attributes.get(key)
        where = f'{element.place}: <{tag} {key}> of {label}'
        if text is None:
            if key in NEEDED:
                raise ValueError(f'{where} must be a number, got none')
        elif key in TEXTS:
            found[key] = text
        elif key in ROWS:
            count, wanted = ROWS[key]
            words = re.split(f'[{BLANKS}]+', text.strip(BLANKS), maxsplit=count)
            if len(words) != count:
                raise ValueError(f'{where} must be {wanted} numbers, got {quote(text)}')
            found[key] = tuple(number_from_text(where, word) for word in words)
        else:
            found[key] = number_from_text(where, text, infinite=tag == 'limit')
    for inner in elements:
        given = element.all(inner)
        if len(given) > 1:
            raise given[1].error(f'{label} has {len(given)} elements <{inner}>; it may have one')
        if given:
            found[inner] = values(given[0], label)
    return found


def unread(
    element: Element, turned: bool, outer: str = ''
) -> Iterator[tuple[tuple[str, str], str]]:
    """
    Yield attributes and elements that nothing reads: element and name, and where they are.

    They include quaternions unless the orientations may be `turned` by them.
    """
    name = element.attributes.get('name')
    attributes, elements = map(str.split, READ[element.tag])
    place = f'{outer}<{element.tag}{"" if name is None else f" name={quote(name)}"}>'
    for key in element.attributes:
        if key not in attributes or (key == QUATERNIONS and not turned):
            yield (element.tag, key), f'{place} {local(key)}={element.place.short}'
    if element.tag == 'transmission':  # it may hold anything
        return
    for child in element.elements:
        if child.tag in elements:
            yield from unread(child, turned, f'{place} ')
            continue
        where = f'{place} <{local(child.tag)}>'
        if child.tag not in FOREIGN:
            yield (element.tag, child.tag), f'{where}{child.place.short}'
            continue
        for spring in child.elements:
            if spring.tag in SPRINGS:
                yield (child.tag, spring.tag), f'{where} <{spring.tag}>{spring.place.short}'


def armature_of(root: Element, joints: Collection[str]) -> dict[str, float]:
    """Return the armature of each joint whose transmissions state a rotor."""
    found: dict[str, float] = {}
    for transmission in root.all('transmission'):
        label = f'transmission {quote(transmission.attributes.get("name", ""))}'
        for actuator in transmission.all('actuator'):
            armature = _rotor(actuator, transmission, label)
            if armature is None:
                continue
            has = f'{label} has the inertia of a rotor, so'
            kind = _type_of(transmission)
            if kind not in ('', SIMPLE):
                raise transmission.error(f'{has} its type must be {SIMPLE}, got {quote(kind)}')
            moved = [joint.attributes.get('name', '') for joint in transmission.all('joint')]
            if len(moved) != 1 or moved[0] not in joints:
                raise transmission.error(
                    f'{has} it must have one joint of the URDF, got {quote(moved)}'
                )
            # Several motors on a joint turn together.
            found[moved[0]] = found.get(moved[0], 0.0) + armature
    return found


def unread_rotors(root: Element) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield rotors outside of an actuator and unknown types, as `urdf_xml.unread`."""
    for element in root.all('transmission'):
        name, kind = quote(element.attributes.get('name', '')), _type_of(element)
        place, line = f'<robot> <transmission name={name}>', element.place.short
        for outside in (element, *element.all('joint')):
            for key in filter(ROTORS.__contains__, dict(_values_in(outside))):
                yield ('transmission', key), f'{place} <{key}>{line}'
        if kind not in TRANSMISSIONS:
            yield ('transmission', 'type'), f'{place} of type {quote(kind)}{line}'


def _rotor(actuator: Element, transmission: Element, label: str) -> float | None:
    """Return the inertia of an actuator's rotor at its joint, or None if it states none."""
    inertias = dict(_values_in(actuator))
    key = next((key for key in ROTORS if key in inertias), None)
    if key is None:
        return None
    inertia = number_from_text(f'{actuator.place}: {key} of {label}', inertias[key])
    stated = {
        number_from_text(f'{element.place}: {name} of {label}', text)
        for element in (actuator, transmission, *transmission.all('joint'))
        for name, text in _values_in(element)
        if name in ROTORS[key]
    }
    if len(stated) > 1:
        ratios = quote_all(sorted(stated))
        raise actuator.error(f'{label} states {len(stated)} reductions, {ratios}; it may have one')
    try:
        return float(reflected_inertia([inertia], *(stated or {1.0}))[0])
    except ValueError as error:
        raise actuator.error(f'{label}: {error}') from error


def _type_of(transmission: Element) -> str:
    """Return the type of a transmission without the package of its class."""
    text = dict(_values_in(transmission)).get('type', '')
    return re.split('[/:]', transmission.attributes.get('type', text).strip())[-1]


def _values_in(element: Element) -> Iterator[tuple[str, str]]:
    """Yield the children of an element by local name: an attribute `value`, or their text."""
    for child in element.elements:
        yield child.tag.rpartition('}')[2], child.attributes.get('value', child.text)
