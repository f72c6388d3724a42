# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The chain of joints of a URDF that move, and the joints that are locked beside it.

Trees, loops and unsupported joints are refused by the name of the joint, with what makes a chain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import takewhile
from types import MappingProxyType
from typing import NamedTuple

from pfd_core.model.locking import how_to_lock, locked_positions, next_to_zero
from pfd_core.model.robot import JOINT_TYPES
from pfd_core.model.urdf import NOT_A_CHAIN, Joint, Mimic, Urdf
from pfd_core.model.values import MOST_NAMES, quote, quote_all, unused

NOTHING: Mapping[str, float] = MappingProxyType({})


class TreeError(ValueError):
    """
    A URDF is a tree, not a chain.

    Attributes
    ----------
    tip : str
        The end of the longest chain of joints without mimic; as `tip` it makes it a chain.
    joints : sequence of str
        The joints that make it the same chain if they are locked. Its tip is then the link that
        the last joint moves, and not one that is fixed to that, as `tip` may be.
    positions : mapping
        A position of each of them within its limits, nearest to zero or as it follows [rad, m].
    patterns : sequence of str
        Patterns and names that match these joints and none that moves the tip.

    """

    def __init__(
        self,
        text: str,
        tip: str = '',
        positions: Mapping[str, float] = NOTHING,
        patterns: Iterable[str] = (),
    ) -> None:
        super().__init__(text)
        self.tip, self.positions = tip, dict(positions)
        self.joints, self.patterns = tuple(self.positions), tuple(patterns)


class Chain(NamedTuple):
    """The part of a URDF that is simulated."""

    base: str  # the link that is fixed
    tip: str  # the link whose frame ends the chain
    held: str  # the topmost link that is rigid with the base; all other links are below it
    # That move, in series: of the chain, of branches that follow it, and of their ways back, which
    # undo the motion of a branch and lead to the link that it leaves.
    joints: list[Joint]
    ways_back: Mapping[str, Joint]  # joint by the name of the one that undoes it
    below: list[Joint]  # below the held link, each after the joint above it, on this chain alone
    carriers: Mapping[str, Joint | None]  # of a link: the moving joint, or None for the base's
    above: list[Joint]  # from the root to the held link
    locked: Mapping[str, float]  # position [rad, m] of each joint that is locked


def find_chain(
    urdf: Urdf, base: str | None, tip: str | None, locked: Mapping[str, float]
) -> Chain:
    """
    Return the chain of joints between two links, the root and the last one by default.

    The base is fixed: links above it and other branches on it are cut off. Branches on a moving
    link stay, welded to it; a joint there that could move is locked, nearest to zero within its
    limits, or as it follows another.
    """
    label, tip = quote(urdf.name), urdf.tip if tip is None else tip
    above = {joint.child: joint for joint in urdf.joints.values()}
    children: dict[str, list[Joint]] = {link: [] for link in urdf.links}
    root = _root(urdf, above, children)
    for role, link in (('base', base), ('tip', tip)):
        if link is not None and link not in urdf.links:
            raise ValueError(
                f'{role} {quote(link)} is not a link of {label}; it has {quote_all(urdf.links)}'
            )
    free = {j.name for j in urdf.joints.values() if j.kind != 'fixed' and j.name not in locked}
    # The base may be a leaf: the chain starts at the topmost link that is welded to it.
    held = base = root if base is None else base
    while held in above and above[held].name not in free:
        held = above[held].parent
    below = _below(held, children)
    carriers: dict[str, Joint | None] = {held: None}
    for joint in below:
        carriers[joint.child] = joint if joint.name in free else carriers[joint.parent]
    moving = [joint for joint in urdf.joints.values() if carriers.get(joint.child) is joint]
    if tip is None and not moving:
        raise ValueError(f'no joint moves below {quote(base)} in {label}')
    before = [carriers[joint.parent] for joint in moving]
    ends = [joint for joint in moving if joint not in before]
    movers = {link: by for link, by in carriers.items() if by}
    chosen = _advised_tip(urdf, ends, movers) if tip is None else tip
    if chosen not in carriers:
        raise ValueError(f'tip {quote(chosen)} is not below base {quote(base)} in {label}')
    chain = path_to(chosen, movers)
    if not chain:
        raise ValueError(f'no joint moves between {quote(base)} and {quote(chosen)} in {label}')
    # Branches that follow the chain are carried; other joints that it moves are locked.
    leaders = {joint.name for joint in chain if joint.mimic is None}
    led = [j for j in moving if j in chain or ((x := rule_of(urdf, j)) and x.leader in leaders)]
    rest = [joint for joint in moving if joint not in led]
    for joint in led:
        _check_kind(urdf, joint, leaders)
    if tip is None and ends[1:] and rest:
        # Others on the base are cut off where a tip is given, and must be locked where none is.
        positions = _places(urdf, rest, locked)
        raise _tree(urdf, chosen, ends, positions, [joint.name for joint in led])
    moved = {joint.child for top in led for joint in _below(top.child, children)}
    others = [joint for joint in rest if joint.child in moved]
    if others:
        return find_chain(urdf, base, tip, {**locked, **_places(urdf, others, locked)})
    joints, ways_back = _in_series(urdf, chain, led, carriers)
    # Links that are moved by none of these joints, and are no part of the base, are excluded.
    carried = {link: by for link, by in carriers.items() if by is None or by in joints}
    below = [joint for joint in below if joint.child in carried]
    to_root = path_to(held, above)
    return Chain(base, chosen, held, joints, ways_back, below, carried, to_root, locked)


def _tree(
    urdf: Urdf, tip: str, ends: list[Joint], positions: dict[str, float], moving: list[str]
) -> TreeError:
    # Followers need no advice: they follow.
    rules = {name: urdf.joints[name].mimic for name in positions}
    led = {name for name, rule in rules.items() if rule and rule.leader in positions}
    positions = {name: x for name, x in positions.items() if name not in led}
    short = _shortened([*positions], moving)
    many = len(positions) > MOST_NAMES
    return TreeError(
        f'{quote(urdf.name)} is a tree, not a chain: it ends in joints '
        f'{quote_all(j.name for j in ends)}; choose one end, such as tip={quote(tip)} (and '
        'a base, if the ends part at a link that should stand still), or lock the others, '
        + how_to_lock(dict.fromkeys(short) if many else positions)
        + (f': {len(positions)} joints, nearest to 0 within their limits' if many else ''),
        tip,
        positions,
        short,
    )


def _in_series(
    urdf: Urdf, chain: list[Joint], led: list[Joint], carriers: Mapping[str, Joint | None]
) -> tuple[list[Joint], dict[str, Joint]]:
    """Return the joints of a chain and of the branches that follow it, as one chain."""
    joints: list[Joint] = []
    ways_back: dict[str, Joint] = {}

    def walk(link_mover: Joint | None) -> None:
        beyond = [joint for joint in led if carriers[joint.parent] is link_mover]
        for joint in sorted(beyond, key=chain.__contains__):
            joints.append(joint)
            walk(joint)
            rule = joint.mimic
            if joint not in chain and rule is not None:
                name = unused(f'{joint.name}_back', {*urdf.joints})
                back = Mimic(rule.leader, -rule.multiplier, -rule.offset)
                ways_back[name] = joint
                joints.append(joint._replace(name=name, limits={}, unlimited=(), mimic=back))

    walk(None)
    return joints, ways_back


def rule_of(urdf: Urdf, joint: Joint) -> Mimic | None:
    """Return how a joint follows one that follows none; None for this one."""
    rule = joint.mimic
    while rule is not None and rule.leader in urdf.joints:
        above = urdf.joints[rule.leader].mimic
        if above is None:
            break
        offset = rule.multiplier * above.offset + rule.offset
        rule = Mimic(above.leader, rule.multiplier * above.multiplier, offset)
    return rule


def _root(urdf: Urdf, above: Mapping[str, Joint], children: dict[str, list[Joint]]) -> str:
    """Return the one link without a parent, and fill in the children; ValueError for no tree."""
    for joint in urdf.joints.values():
        for link in (joint.parent, joint.child):
            if link not in urdf.links:
                raise ValueError(
                    f'{joint.place}: joint {quote(joint.name)} names link {quote(link)}, not in '
                    'the URDF'
                )
        if above[joint.child] is not joint:
            other = above[joint.child]
            raise ValueError(
                f'{joint.place}: link {quote(joint.child)} hangs on joints {quote(joint.name)} '
                f'and {quote(other.name)}{other.place.short}: closed loops are not supported; cut '
                'one of them'
            )
        children[joint.parent].append(joint)
    roots = [name for name in urdf.links if name not in above]
    if len(roots) != 1:
        raise ValueError(
            f'{urdf.place}: a URDF must have one link without a parent, got '
            f'{quote_all(roots) or "a loop"}'
        )
    tree = {joint.name for joint in _below(roots[0], children)}
    loop = [name for name in urdf.joints if name not in tree]
    if loop:
        raise ValueError(
            f'{urdf.joints[loop[0]].place}: joints {quote_all(loop)} form a closed loop apart '
            f'from the rest of {quote(urdf.name)}'
        )
    return roots[0]


def _below(link: str, children: Mapping[str, list[Joint]]) -> list[Joint]:
    """Return the joints below a link, each after the joint above it."""
    found = list(children[link])
    for joint in found:
        found.extend(children[joint.child])
    return found


def path_to(link: str, above: Mapping[str, Joint]) -> list[Joint]:
    """Return the joints above a link, from the top on, by what is next above each link."""
    path: list[Joint] = []
    while link in above:
        path.insert(0, above[link])
        link = above[link].parent
    return path


def _advised_tip(urdf: Urdf, ends: list[Joint], movers: Mapping[str, Joint]) -> str:
    """
    Return the end of the chain of the most joints that follow none, of the chains to some ends.

    Where others have as many, or follow it, it is the link on which they part if most of the
    joints are above it, as with the fingers of a hand, or else the first one, as with two arms.
    """
    every, bodies = [path_to(end.child, movers) for end in ends], movers.items()
    heavy = {by.name for link, by in bodies if urdf.links[link] is not None or by.mimic}
    # No arm ends in links without mass: of several ends these are cut off.
    for way in every if ends[1:] else ():
        if not heavy.isdisjoint(joint.name for joint in way):
            while way[-1].name not in heavy:
                way.pop()
    leaders = {
        joint.name: rule.leader for way in every for joint in way if (rule := rule_of(urdf, joint))
    }

    def own(way: list[Joint]) -> list[Joint]:
        """Return the joints that follow none, up to one that is coupled to a joint elsewhere."""
        names = {joint.name for joint in way}
        kept = takewhile(
            lambda joint: not joint.equality and leaders.get(joint.name, joint.name) in names, way
        )
        return [joint for joint in kept if joint.name not in leaders]

    most = max(len(own(way)) for way in every)
    if not most:
        return ends[0].child  # it is refused, with the reason
    first, *others = (way for way in every if len(own(way)) == most)
    names = {joint.name for joint in first}
    led = [w for w in every if any(leaders.get(j.name) in names and j not in first for j in w)]
    for ways, least in ((others, most / 2), (led, (most + 1) / 2)):
        same = 0
        while all(same < len(way) and way[same] is first[same] for way in (first, *ways)):
            same += 1
        if same < len(first) and len(own(first[:same])) >= least:
            return first[same].parent if ways is others else first[same - 1].child
    return first[-1].child


def _check_kind(urdf: Urdf, joint: Joint, leaders: Collection[str]) -> None:
    if joint.kind in NOT_A_CHAIN:
        raise ValueError(
            f'{joint.place}: joint {quote(joint.name)} is {joint.kind}, which is not supported: '
            f'choose a base below it, such as base={quote(joint.child)}, or make it fixed'
        )
    if joint.equality:
        raise ValueError(
            f'{joint.place}: joint {quote(joint.name)} is coupled by the <equality> '
            f'{quote(joint.equality)[1:-1]}, which is not supported: lock it, or take that away'
        )
    rule = rule_of(urdf, joint)
    if rule is None:
        return
    if rule.leader not in urdf.joints or urdf.joints[rule.leader].kind not in JOINT_TYPES:
        _refuse_unled([joint])
    if rule.leader not in leaders:
        _refuse_follower(urdf, joint, rule.leader)
    if rule.multiplier == 0:
        raise ValueError(
            f'{joint.place}: joint {quote(joint.name)} mimics with a multiplier of 0, so that it '
            f'does not move: lock it, locked={{{quote(joint.name)}: {rule.offset}}}'
        )


def _refuse_unled(joints: list[Joint]) -> None:
    places = {joint.name: next_to_zero(*joint.bounds) for joint in joints}
    raise ValueError(
        f'{joints[0].place}: {quote_all(places)} mimic what is no joint that moves: mend '
        f'the <mimic>, or lock them, {how_to_lock(places)}'
    )


def _refuse_follower(urdf: Urdf, joint: Joint, leader: str) -> None:
    """Refuse a joint that mimics one that is not simulated, though it could move."""
    name, led, first = quote(leader), quote(joint.name), urdf.joints[leader]
    above = {known.child: known for known in urdf.joints.values()}
    ends = f'tip={quote(first.child)}'
    if first in path_to(joint.parent, above):
        ends = f'base={quote(first.parent)}'
    raise ValueError(
        f'{joint.place}: joint {led} mimics {name}, which is not on the chain: locked alone, it '
        f'would lose its motion, and the arm would be another one. Lock {name}, and {led} '
        f'follows, choose a chain with {name}, such as {ends}, or take the <mimic> away, if {led} '
        'has a motor of its own'
    )


def _places(urdf: Urdf, joints: Sequence[Joint], locked: Mapping[str, float]) -> dict[str, float]:
    """Return positions [rad, m] of further joints to lock: nearest to zero, or as they follow."""
    at, unled = dict(locked), []
    for joint in joints:
        if joint.kind in NOT_A_CHAIN:
            raise ValueError(
                f'{joint.place}: joint {quote(joint.name)}, off the chain, is {joint.kind}, which '
                'cannot be locked: make it fixed'
            )
        rule = rule_of(urdf, joint)
        first = joint if rule is None else urdf.joints.get(rule.leader)
        if first is None or first.kind not in JOINT_TYPES:
            unled.append(joint)
        elif first.name not in at:
            at[first.name] = next_to_zero(*first.bounds)
    if unled:
        _refuse_unled(unled)
    at = locked_positions(urdf.name, at, urdf.joints)
    return {joint.name: at[joint.name] for joint in joints}


def _shortened(names: Sequence[str], others: Iterable[str]) -> list[str]:
    """Return patterns of words that names start with and no other does; these names for none."""
    found = []
    for name in names:
        starts = [name[:k] for k in range(1, len(name)) if name[k - 1] in '_/-']
        # The first character decides where no word does.
        for start in (*starts, *(name[:k] for k in range(1, len(name)))):
            same = sum(known.startswith(start) for known in names)
            if same > 1 and not any(known.startswith(start) for known in others):
                found.append(f'{start}*')
                break
        else:
            found.append(name)
    return [*dict.fromkeys(found)]
