# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
XML of a URDF, bounded in size and depth: elements with their lines, and numbers in them.

An element knows which of its attributes and children were read, so that the others can be named.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from pfd_core.model.values import BLANKS, number_from_text, quote

# Published URDFs have up to 1 MB, and 4000 elements, 8 within each other.
MOST_CHARACTERS = 16 * 2**20
MOST_ELEMENTS, DEEPEST = 100_000, 100

Triple = tuple[float, float, float]


class Place(NamedTuple):
    """Where an element is: file or 'URDF text', and line, 0 if unknown."""

    source: str
    line: int

    def __str__(self) -> str:
        """Return it as the start of an error."""
        return repr(self.source)[1:-1] + (f', line {self.line}' if self.line else '')

    @property
    def short(self) -> str:
        """The line alone, to follow the name of an element."""
        return f' (line {self.line})' if self.line else ''


class PlacedElement(Element):
    """An element that knows its place, and the names of attributes and children that were read."""

    __slots__ = ('attributes', 'children', 'place')
    place: Place

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.attributes: set[str] = set()
        self.children: set[str] = set()

    def get(self, key: str, default: Any = None) -> Any:
        """Return the text of an attribute."""
        self.attributes.add(key)
        return super().get(key, default)

    def findall(self, path: str, namespaces: Any = None) -> list[Any]:
        """Return the children with a tag."""
        self.children.add(path)
        return super().findall(path, namespaces)


def error_at(element: Element, problem: str) -> ValueError:
    """Return an error that starts with the place of an element."""
    return ValueError(f'{placed(element).place}: {problem}')


def placed(element: Element) -> PlacedElement:
    """Return an element of `robot_element`."""
    assert isinstance(element, PlacedElement)
    return element


def place_of(element: Element) -> Place:
    """Return where an element is."""
    return placed(element).place


def robot_element(text: str, source: str, lines: bool) -> Element:
    """Return the <robot> of a text, without entities, which could expand to any size."""
    if len(text) > MOST_CHARACTERS:
        problem = f'the URDF has {len(text)} characters, more than the {MOST_CHARACTERS}'
        raise ValueError(f'{Place(source, 0)}: {problem} supported')
    before = text[: len(text) - len(text.lstrip())].count('\n')
    builder, parser = TreeBuilder(PlacedElement), expat.ParserCreate(namespace_separator='}')
    count = depth = 0

    def place(line: int) -> Place:
        return Place(source, before + line if lines else 0)

    def braced(name: str) -> str:
        """Return a name of a namespace as ElementTree has it."""
        return f'{{{name}' if '}' in name else name

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        names = {braced(key): value for key, value in attributes.items()}
        element = builder.start(braced(tag), names)
        element.place = place(parser.CurrentLineNumber)  # type: ignore[attr-defined]
        if count > MOST_ELEMENTS:
            problem = f'the URDF has more than the {MOST_ELEMENTS} elements supported'
            raise error_at(element, problem)
        if depth > DEEPEST:
            raise error_at(element, f'the URDF has elements more than {DEEPEST} deep')

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(braced(tag))

    def refuse(*_: object) -> None:
        raise ValueError(f'{place(parser.CurrentLineNumber)}: a URDF has no <!DOCTYPE>')

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, refuse
    try:
        parser.Parse(text.strip(), True)
    except expat.ExpatError as error:
        problem = f'not well-formed XML: {expat.ErrorString(error.code)}'
        raise ValueError(f'{place(error.lineno)}: {problem}') from error
    except UnicodeEncodeError as error:
        line = text.count('\n', 0, error.start) + 1
        raise ValueError(f'{place(line)}: not well-formed XML: {error}') from error
    root = builder.close()
    for element in root.iter():
        space, _, name = element.tag.rpartition('}')
        if 'xacro' in space:
            raise error_at(
                element,
                f'the URDF has <xacro:{quote(name)[1:-1]}>, which is not expanded: load the '
                '.xacro file, or run `xacro FILE > robot.urdf` first',
            )
    if root.tag != 'robot':
        raise error_at(root, f'a URDF starts with <robot>, this with <{quote(root.tag)[1:-1]}>')
    return root


def named(root: Element, tag: str) -> dict[str, Element]:
    """Return the elements with a tag by name; ValueError for none or the same one."""
    found: dict[str, Element] = {}
    for element in root.findall(tag):
        name = element.get('name')
        if not name:
            raise error_at(element, f'the URDF has a <{tag}> without a name')
        if name in found:
            first = place_of(found[name]).short
            raise error_at(element, f'the URDF has two {tag}s named {quote(name)}{first}')
        found[name] = element
    return found


def only(parent: Element, tag: str, label: str) -> Element | None:
    """Return the one child with a tag, or None; ValueError for two, as readers differ on them."""
    found = parent.findall(tag)
    if len(found) > 1:
        raise error_at(found[1], f'{label} has {len(found)} elements <{tag}>; it may have one')
    return found[0] if found else None


def number(element: Element, key: str, label: str, silent: float | None = None) -> float:
    """Return the number in an attribute; `silent` is that of an optional one."""
    text = element.get(key)
    where = f'{place_of(element)}: <{element.tag} {key}> of {label}'
    if text is None:
        if silent is None:
            raise ValueError(f'{where} must be a number, got none')
        return silent
    return number_from_text(where, text, infinite=element.tag == 'limit')


def triple(
    element: Element | None, key: str, label: str, silent: Triple = (0.0, 0.0, 0.0)
) -> Triple:
    """Return the three numbers in an attribute; `silent` are those of an optional one."""
    if element is None or element.get(key) is None:
        return silent
    x, y, z = numbers(element, key, label, 3)
    return x, y, z


def numbers(element: Element, key: str, label: str, count: int) -> list[float]:
    """Return so many numbers in an attribute."""
    text = element.get(key, '')
    where = f'{place_of(element)}: <{element.tag} {key}> of {label}'
    words = re.split(f'[{BLANKS}]+', text.strip(BLANKS), maxsplit=count)
    if len(words) != count:
        wanted = {3: 'three', 4: 'four'}[count]
        raise ValueError(f'{where} must be {wanted} numbers, got {quote(text)}')
    return [number_from_text(where, word) for word in words]
