# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The shape of a URDF: which links and joints it has, and which chain of them is meant.

Whatever makes a file no serial chain is found here and named, before any number is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math
import xml.etree.ElementTree as ElementTree

# Writers of URDF print pi/2 as 1.570796325 or longer; with that many digits a right angle is
# meant, and only an exact one leaves zeros for a kernel to drop. 1.5708 is taken as written.
RIGHT_ANGLE_SLACK = 1e-8
MOVING = ('revolute', 'continuous', 'prismatic')
NOT_A_CHAIN = ('floating', 'planar')
INERTIA_KEYS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
# So many names an error lists before it says how many more there are.
LISTED = 12


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF; `mimics` names the joint it follows, if any."""

    name: str
    kind: str
    parent: str
    child: str
    axis: tuple[float, ...]
    mimics: str | None


@dataclass(frozen=True)
class Tree:
    """A URDF: its links, and whether each has an <inertial>; its joints, by their child link."""

    name: str
    root: str
    links: Mapping[str, bool]
    joints: Mapping[str, Joint]


@dataclass(frozen=True)
class Chain:
    """The part of a tree that is simulated: its moving joints from the base to the tip."""

    base: str
    tip: str
    joints: tuple[Joint, ...]


def read_tree(text: str, slack: float = RIGHT_ANGLE_SLACK) -> tuple[Tree, str, tuple[str, ...]]:
    """
    Return the shape of a URDF, its text with right angles made exact, and the joints touched.

    An angle within `slack` [rad] of a multiple of pi/2 is one; none is where slack is negative.

    Raises
    ------
    ValueError
        If it is not XML, not a <robot>, or its links and joints do not form a tree.

    """
    try:
        root = ElementTree.fromstring(text.strip())
    except ElementTree.ParseError as error:
        raise ValueError(f'the URDF is not well-formed XML: {error}') from error
    if root.tag != 'robot':
        raise ValueError(f'a URDF starts with <robot>, this text with <{root.tag}>')
    links = {_name(link): _has_inertial(link) for link in root.findall('link')}
    joints: dict[str, Joint] = {}
    for element in root.findall('joint'):
        joint = _joint(element)
        for link_name in (joint.parent, joint.child):
            if link_name not in links:
                raise ValueError(f'joint {joint.name!r} names link {link_name!r}, not in the URDF')
        if joint.child in joints:
            raise ValueError(
                f'link {joint.child!r} hangs on joints {joints[joint.child].name!r} and '
                f'{joint.name!r}: closed loops are not supported; cut one of them'
            )
        joints[joint.child] = joint
    if not links:
        raise ValueError('the URDF has no <link>; if it is xacro, expand it first')
    roots = [name for name in links if name not in joints]
    if len(roots) != 1:
        raise ValueError(
            f'a URDF must have one link without a parent, got {_listed(roots) or "a loop"}'
        )
    touched = tuple(
        _name(joint)
        for joint in root.findall('joint')
        if any(_square(origin, slack) for origin in joint.iter('origin'))
    )
    for origin in root.iter('origin'):
        _square(origin, slack)
    tree = Tree(root.get('name') or 'robot', roots[0], links, joints)
    return tree, ElementTree.tostring(root, encoding='unicode'), touched


def find_chain(
    tree: Tree, base: str | None, tip: str | None, locked: Mapping[str, float]
) -> Chain:
    """
    Return the chain of joints that is meant.

    The base is held still: what is above it is cut off, and so is what else hangs on it. What
    hangs on a moving link stays, welded on; a joint there that could move must be locked.

    Parameters
    ----------
    tree : Tree
        The URDF.
    base, tip : str, optional
        Links; the root, and the link that the last joint moves, if not given.
    locked : mapping
        Joints to treat as fixed.

    Raises
    ------
    ValueError
        If these do not leave exactly one chain of supported joints.

    """
    _check_links(tree, base, tip)
    _check_locked(tree, locked)
    base = base or tree.root
    free = [j for j in tree.joints.values() if j.kind != 'fixed' and j.name not in locked]
    # The base may be a leaf: what matters is the link at the top of all that is welded to it.
    above = [base, *_links_above(tree, base)]
    held = next(k for k in above if k not in tree.joints or tree.joints[k] in free)
    below = [j for j in free if held in _links_above(tree, j.child)]
    tip = _last_link(tree, base, below) if tip is None else tip
    if held not in (tip, *_links_above(tree, tip)):
        raise ValueError(f'tip {tip!r} is not below base {base!r} in {tree.name!r}')
    chain = [j for j in reversed(_joints_above(tree, tip)) if j in below]
    if not chain:
        raise ValueError(f'no joint moves between {base!r} and {tip!r} in {tree.name!r}')
    moved = {joint.child for joint in chain}
    astray = [j for j in below if j not in chain and moved & set(_links_above(tree, j.child))]
    if astray:
        raise ValueError(
            f'{tree.name!r} is a tree, not a chain: {_listed(j.name for j in astray)} also move '
            f'what {chain[0].name!r} carries to {tip!r}; {_how_to_lock(astray)}'
        )
    for joint in chain:
        _check_kind(joint)
        _check_weighed(tree, joint, free)
    return Chain(base, tip, tuple(chain))


def _last_link(tree: Tree, base: str, below: list[Joint]) -> str:
    """Return the link moved by the last joint, if there is one such joint."""
    if not below:
        raise ValueError(f'no joint moves below {base!r} in {tree.name!r}')
    carriers = {link for joint in below for link in _links_above(tree, joint.child)}
    ends = [joint for joint in below if joint.child not in carriers]
    if len(ends) > 1:
        raise ValueError(
            f'{tree.name!r} is a tree, not a chain: it ends in joints '
            f'{_listed(j.name for j in ends)}; choose one end with tip={ends[0].child!r} (and a '
            f'base, if the ends part at a link that should stand still), or {_how_to_lock(ends)}'
        )
    return ends[0].child


def _joints_above(tree: Tree, link: str) -> list[Joint]:
    """Return the joints from a link up to the root."""
    found: list[Joint] = []
    while link in tree.joints:
        joint = tree.joints[link]
        if joint in found:
            raise ValueError(f'joint {joint.name!r} is part of a closed loop; cut it')
        found.append(joint)
        link = joint.parent
    return found


def _links_above(tree: Tree, link: str) -> list[str]:
    return [joint.parent for joint in _joints_above(tree, link)]


def _check_links(tree: Tree, base: str | None, tip: str | None) -> None:
    for role, link in (('base', base), ('tip', tip)):
        if link is not None and link not in tree.links:
            raise ValueError(
                f'{role} {link!r} is not a link of {tree.name!r}; it has {_listed(tree.links)}'
            )


def _check_locked(tree: Tree, locked: Mapping[str, float]) -> None:
    by_name = {joint.name: joint for joint in tree.joints.values()}
    for name, position in locked.items():
        joint = by_name.get(name)
        if joint is None or joint.kind not in MOVING:
            kind = 'has no such joint' if joint is None else f'has it as a {joint.kind} joint'
            movable = _listed(j.name for j in by_name.values() if j.kind in MOVING)
            raise ValueError(
                f'cannot lock {name!r}: {tree.name!r} {kind}; joints that can be locked: {movable}'
            )
        if not isinstance(position, (int, float)) or not math.isfinite(position):
            raise ValueError(f'joint {name!r} must be locked at a finite number, got {position!r}')


def _check_kind(joint: Joint) -> None:
    if joint.kind in NOT_A_CHAIN:
        raise ValueError(
            f'joint {joint.name!r} is {joint.kind}, which is not supported: choose a base below '
            f'it, such as base={joint.child!r}, or make it fixed'
        )
    if joint.mimics is not None:
        raise ValueError(
            f'joint {joint.name!r} mimics {joint.mimics!r}, which is not supported: lock it with '
            f'locked={{{joint.name!r}: 0.0}} or take the <mimic> away'
        )


def _check_weighed(tree: Tree, joint: Joint, free: list[Joint]) -> None:
    """Raise ValueError if nothing that moves with a joint's link has an <inertial>."""
    apart = {other.child for other in free}
    for link, weighed in tree.links.items():
        path = [link, *_links_above(tree, link)]
        if weighed and joint.child in path:
            between = path[: path.index(joint.child)]
            if not apart & set(between):
                return
    raise ValueError(
        f'link {joint.child!r}, moved by joint {joint.name!r}, has no <inertial>, nor has '
        'anything fixed to it: give it one (mass 0 if a link further out carries the mass)'
    )


def _has_inertial(link: ElementTree.Element) -> bool:
    """Return whether a link has an <inertial>, which the parser must be able to read."""
    inertial = link.find('inertial')
    if inertial is None:
        return False
    # The parser would drop an unreadable one and carry on without the link's mass.
    for tag, keys in (('mass', ('value',)), ('inertia', INERTIA_KEYS)):
        element = inertial.find(tag)
        for key in keys:
            text = None if element is None else element.get(key)
            _number(f'<{tag} {key}> of link {link.get("name")!r}', text)
    return True


def _number(label: str, text: str | None) -> float:
    try:
        value = float(text or 'missing')
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f'{label} must be a finite number, got {text!r}')
    return value


def _name(element: ElementTree.Element) -> str:
    name = element.get('name')
    if not name:
        raise ValueError(f'the URDF has a <{element.tag}> without a name')
    return name


def _joint(element: ElementTree.Element) -> Joint:
    name, kind = _name(element), element.get('type', '')
    if kind not in (*MOVING, *NOT_A_CHAIN, 'fixed'):
        raise ValueError(
            f'joint {name!r} has type {kind!r}; known types are {_listed((*MOVING, "fixed"))}'
        )
    ends = [element.find('parent'), element.find('child')]
    parent, child = ('' if end is None else end.get('link', '') for end in ends)
    written = element.find('axis')
    text = '1 0 0' if written is None else written.get('xyz', '1 0 0')
    axis = tuple(_number(f'<axis> of joint {name!r}', item) for item in text.split())
    if kind in MOVING and (len(axis) != 3 or not any(axis)):
        raise ValueError(
            f'<axis> of joint {name!r} must be three numbers, not all 0, got {text!r}'
        )
    limit = element.find('limit')
    if kind in ('revolute', 'prismatic') and limit is None:
        raise ValueError(
            f'joint {name!r} is {kind} and must have a <limit>; or make it continuous'
        )
    mimic = element.find('mimic')
    return Joint(name, kind, parent, child, axis, None if mimic is None else mimic.get('joint'))


def _square(origin: ElementTree.Element, slack: float) -> bool:
    """Make the right angles of an <origin> exact, and tell whether that changed a number."""
    written = origin.attrib.get('rpy', '').split()
    exact = [_right_angle(angle, slack) for angle in written]
    if exact == written:
        return False
    origin.set('rpy', ' '.join(exact))
    return [float(angle) for angle in exact] != [float(angle) for angle in written]


def _right_angle(text: str, slack: float) -> str:
    """Return an angle [rad] as text, made exact if it is nearly a multiple of pi/2."""
    try:
        angle = float(text)
    except ValueError:
        return text
    if not math.isfinite(angle):
        return text
    exact = round(angle / (math.pi / 2)) * (math.pi / 2)
    return repr(exact) if abs(angle - exact) <= slack else text


def _how_to_lock(joints: Iterable[Joint]) -> str:
    names = [joint.name for joint in joints if joint.kind in MOVING]
    pairs = ', '.join(f'{name!r}: 0.0' for name in names[:LISTED])
    return f'lock them, locked={{{pairs}{", ..." if len(names) > LISTED else ""}}}'


def _listed(names: Iterable[str]) -> str:
    items = list(names)
    more = f' and {len(items) - LISTED} more' if len(items) > LISTED else ''
    return ', '.join(map(repr, items[:LISTED])) + more
