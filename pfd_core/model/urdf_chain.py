# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The chain in a URDF: the joints that move, and the links that each of them carries.

Trees, loops and unsupported joints are refused here, by the name of the joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pfd_core.model.robot import JOINT_TYPES
from pfd_core.model.urdf_reader import NOT_A_CHAIN, Joint, Urdf
from pfd_core.model.values import MOST_NAMES, quote, quote_all


class TreeError(ValueError):
    """
    A URDF is a tree, not a chain.

    Attributes
    ----------
    joints : sequence of str
        The joints that make it a chain if they are locked.

    """

    def __init__(self, text: str, joints: Sequence[str] = ()) -> None:
        super().__init__(text)
        self.joints = joints


@dataclass(frozen=True)
class Chain:
    """
    The part of a URDF that is simulated.

    Attributes
    ----------
    base, tip : str
        The link that is fixed, and the link whose frame ends the chain.
    held : str
        The topmost link that is rigid with the base; all other links are below it.
    joints : tuple of Joint
        The joints that move, from the base to the tip.
    below : tuple of Joint
        All joints below the held link, each after the joint above it, without other chains on
        the base.
    carriers : mapping
        Name of a link -> the moving joint that carries it; None for links rigid with the base.

    """

    base: str
    tip: str
    held: str
    joints: tuple[Joint, ...]
    below: tuple[Joint, ...]
    carriers: Mapping[str, Joint | None]


def find_chain(
    urdf: Urdf, base: str | None, tip: str | None, locked: Mapping[str, float]
) -> Chain:
    """
    Return the chain of joints between two links.

    The base is fixed: links above it and other branches on it are cut off. Branches on a
    moving link stay, welded to it; a joint there that could move must be locked.

    Parameters
    ----------
    urdf : Urdf
        The URDF.
    base, tip : str, optional
        Links; the root, and the link that the last joint moves, if not given.
    locked : mapping
        Joints to treat as fixed.

    Raises
    ------
    ValueError
        If the links and joints are no tree, or these choices do not leave exactly one chain of
        supported joints.

    """
    above = {joint.child: joint for joint in urdf.joints.values()}
    root = _root(urdf, above)
    children: dict[str, list[Joint]] = {link: [] for link in urdf.links}
    for joint in urdf.joints.values():
        children[joint.parent].append(joint)
    _refuse_loops(urdf, _below(root, children))
    _check_links(urdf, base, tip)
    _check_locked(urdf, locked)
    free = {j.name for j in urdf.joints.values() if j.kind != 'fixed' and j.name not in locked}
    base = root if base is None else base
    # The base may be a leaf: the chain starts at the topmost link that is welded to it.
    held = base
    while held in above and above[held].name not in free:
        held = above[held].parent
    below = _below(held, children)
    carriers: dict[str, Joint | None] = {held: None}
    for joint in below:
        carriers[joint.child] = joint if joint.name in free else carriers[joint.parent]
    moving = [joint for joint in urdf.joints.values() if carriers.get(joint.child) is joint]
    tip = _last_link(urdf, base, moving, carriers) if tip is None else tip
    if tip not in carriers:
        raise ValueError(f'tip {quote(tip)} is not below base {quote(base)} in {quote(urdf.name)}')
    chain = _chain_to(tip, carriers)
    if not chain:
        raise ValueError(
            f'no joint moves between {quote(base)} and {quote(tip)} in {quote(urdf.name)}'
        )
    _refuse_branches(urdf, tip, chain, moving, carriers)
    for joint in chain:
        _check_kind(joint)
    # Links that are neither moved by the chain nor part of its base are excluded.
    own = {joint.name for joint in chain}
    carried = {
        link: carrier
        for link, carrier in carriers.items()
        if carrier is None or carrier.name in own
    }
    kept = tuple(joint for joint in below if joint.child in carried)
    return Chain(base, tip, held, tuple(chain), kept, carried)


def _root(urdf: Urdf, above: Mapping[str, Joint]) -> str:
    """Return the one link without a parent; ValueError for a loop or an unknown link."""
    for joint in urdf.joints.values():
        for link in (joint.parent, joint.child):
            if link not in urdf.links:
                raise ValueError(
                    f'joint {quote(joint.name)} names link {quote(link)}, not in the URDF'
                )
        if above[joint.child] is not joint:
            raise ValueError(
                f'link {quote(joint.child)} hangs on joints {quote(joint.name)} and '
                f'{quote(above[joint.child].name)}: closed loops are not supported; cut one of '
                'them'
            )
    roots = [name for name in urdf.links if name not in above]
    if len(roots) != 1:
        raise ValueError(
            f'a URDF must have one link without a parent, got {quote_all(roots) or "a loop"}'
        )
    return roots[0]


def _below(link: str, children: Mapping[str, list[Joint]]) -> list[Joint]:
    """Return the joints below a link, each after the joint above it."""
    found = list(children[link])
    for joint in found:
        found.extend(children[joint.child])
    return found


def _refuse_loops(urdf: Urdf, below: list[Joint]) -> None:
    if len(below) < len(urdf.joints):
        reached = {joint.name for joint in below}
        loop = [name for name in urdf.joints if name not in reached]
        raise ValueError(
            f'joints {quote_all(loop)} form a closed loop apart from the rest of '
            f'{quote(urdf.name)}'
        )


def _chain_to(tip: str, carriers: Mapping[str, Joint | None]) -> list[Joint]:
    chain: list[Joint] = []
    carrier = carriers[tip]
    while carrier is not None:
        chain.insert(0, carrier)
        carrier = carriers[carrier.parent]
    return chain


def _last_link(
    urdf: Urdf, base: str, moving: list[Joint], carriers: Mapping[str, Joint | None]
) -> str:
    """Return the link that the last joint moves; ValueError if the chain has several ends."""
    if not moving:
        raise ValueError(f'no joint moves below {quote(base)} in {quote(urdf.name)}')
    before = {id(carriers[joint.parent]) for joint in moving}
    ends = [joint for joint in moving if id(joint) not in before]
    if len(ends) > 1:
        raise TreeError(
            f'{quote(urdf.name)} is a tree, not a chain: it ends in joints '
            f'{quote_all(j.name for j in ends)}; choose one end with tip={quote(ends[0].child)} '
            '(and a base, if the ends part at a link that should stand still), or '
            f'{_how_to_lock(ends)}',
            _movable(ends),
        )
    return ends[0].child


def _refuse_branches(
    urdf: Urdf,
    tip: str,
    chain: list[Joint],
    moving: list[Joint],
    carriers: Mapping[str, Joint | None],
) -> None:
    """Raise ValueError if a joint outside the chain moves a link that the chain carries."""
    own = {joint.name for joint in chain}
    on_chain: dict[str, bool] = {}
    for joint in carriers.values():
        # Carriers are in the order from the base outwards.
        if joint is not None and joint.name not in on_chain:
            before = carriers[joint.parent]
            on_chain[joint.name] = before is not None and (
                before.name in own or on_chain[before.name]
            )
    others = [joint for joint in moving if on_chain[joint.name] and joint.name not in own]
    if others:
        raise TreeError(
            f'{quote(urdf.name)} is a tree, not a chain: {quote_all(j.name for j in others)} also '
            f'move what {quote(chain[0].name)} carries to {quote(tip)}; {_how_to_lock(others)}',
            _movable(others),
        )


def _check_links(urdf: Urdf, base: str | None, tip: str | None) -> None:
    for role, link in (('base', base), ('tip', tip)):
        if link is not None and (not isinstance(link, str) or link not in urdf.links):
            raise ValueError(
                f'{role} {quote(link)} is not a link of {quote(urdf.name)}; it has '
                f'{quote_all(urdf.links)}'
            )


def _check_locked(urdf: Urdf, locked: Mapping[str, float]) -> None:
    for name in locked:
        joint = urdf.joints.get(name)
        if joint is None or joint.kind not in JOINT_TYPES:
            kind = 'has no such joint' if joint is None else f'has it as a {joint.kind} joint'
            movable = quote_all(j.name for j in urdf.joints.values() if j.kind in JOINT_TYPES)
            raise ValueError(
                f'cannot lock {quote(name)}: {quote(urdf.name)} {kind}; joints that can be '
                f'locked: {movable}'
            )


def _check_kind(joint: Joint) -> None:
    name = quote(joint.name)
    if joint.kind in NOT_A_CHAIN:
        raise ValueError(
            f'joint {name} is {joint.kind}, which is not supported: choose a base below '
            f'it, such as base={quote(joint.child)}, or make it fixed'
        )
    if joint.mimic is not None:
        raise ValueError(
            f'joint {name} mimics {quote(joint.mimic.leader)}, which is not supported: lock it '
            f'with locked={{{name}: 0.0}}, lock the joint that it follows, or take the <mimic> '
            'away'
        )


def _movable(joints: Iterable[Joint]) -> list[str]:
    return [joint.name for joint in joints if joint.kind in JOINT_TYPES]


def _how_to_lock(joints: Iterable[Joint]) -> str:
    names = _movable(joints)
    pairs = ', '.join(f'{quote(name)}: 0.0' for name in names[:MOST_NAMES])
    return f'lock them, locked={{{pairs}{", ..." if len(names) > MOST_NAMES else ""}}}'
