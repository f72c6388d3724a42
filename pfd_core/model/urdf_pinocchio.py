# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Comparison of a robot from URDF with the model that Pinocchio makes of it, number by number.

Pinocchio is given a URDF of the chain alone, with other names and the numbers of urdf_reader: in
the file itself it confuses a link with a joint of the same name, and drops an inertia that its
parser cannot read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.forking import no_fork
from pfd_core.model.error_text import quote
from pfd_core.model.geometry import Array, Body, Placement, axis_rotation, product
from pfd_core.model.urdf_chain import Chain
from pfd_core.model.urdf_reader import INERTIA_KEYS, Description, Inertial, Joint, Origin

# Each side rounds a few dozen products at 1e-16, relative to the size of the robot; a misread
# number differs by far more.
AGREEMENT = 1e-11
# Pinocchio divides first moments by no less than this: the centre of a lighter body is wrong.
LIGHTEST = float(np.finfo(float).eps)


def check_with_pinocchio(
    urdf: Description,
    chain: Chain,
    locked: Mapping[str, float],
    placements: list[Placement],
    bodies: list[Body],
) -> None:
    """
    Raise ValueError if Pinocchio's numbers of a chain differ; the text names the link.

    Parameters
    ----------
    urdf, chain : Description, Chain
        The URDF, and its part that is simulated.
    locked : mapping
        Name of a joint -> position [rad, m] at which it is welded.
    placements, bodies : list of tuple
        The chain as arguments of `welded_frames`.

    """
    # Pinocchio takes a second to import, and only URDFs need it.
    with no_fork:
        import pinocchio

    joints = {joint.name: f'joint{k}' for k, joint in enumerate(chain.below)}
    links = {link: f'link{k}' for k, link in enumerate(chain.carriers)}
    text = '\n'.join(_rewritten(urdf, chain, joints, links))
    try:
        model = pinocchio.buildModelFromXML(text)
    except ValueError as error:
        problem = quote(str(error))[1:-1]
        raise ValueError(f'{quote(urdf.name)}: Pinocchio cannot load it: {problem}') from error
    positions = {joints[name]: at for name, at in locked.items() if name in joints}
    model = _reduced(pinocchio, model, positions)
    indices = [model.getJointId(joints[joint.name]) for joint in chain.joints]
    start, end = (
        _pair(model.frames[model.getFrameId(links[link], pinocchio.FrameType.BODY)].placement)
        for link in (chain.base, chain.tip)
    )
    theirs = [start, *(_pair(model.jointPlacements[index]) for index in indices), end]
    turns = [axis_rotation(joint.axis) for joint in chain.joints]
    length = max(float(np.abs(p).max()) for _, p in placements)
    for k, (R, p) in enumerate(_in_turned_frames(theirs, turns)):
        joint = chain.joints[min(k, len(turns) - 1)]
        _compare(joint, 'rotation', placements[k][0], R, AGREEMENT)
        _compare(joint, 'position', placements[k][1], p, AGREEMENT * length)
    for joint, index, turn, body in zip(chain.joints, indices, turns, bodies, strict=True):
        along, about = np.split(np.array(model.joints[index].createData().S).ravel(), 2)
        axis = along if joint.kind == 'prismatic' else about
        _compare(joint, 'axis', turn[:, 2], axis, AGREEMENT)
        _compare(joint, 'limits', _limits(joint), _limits_of(model, index, joint), 0.0)
        _compare_bodies(joint, body, model.inertias[index], turn, length)


def _compare(joint: Joint, quantity: str, ours: ArrayLike, theirs: ArrayLike, most: float) -> None:
    off = np.abs(np.asarray(ours) - np.asarray(theirs))
    if not (off <= most).all():
        raise ValueError(
            f'{quantity} of link {quote(joint.child)}, moved by joint {quote(joint.name)}: this '
            f'reader makes {quote(np.asarray(ours).tolist())} of the URDF, Pinocchio '
            f'{quote(np.asarray(theirs).tolist())}'
        )


def _compare_bodies(joint: Joint, body: Body, inertia: Any, turn: Array, length: float) -> None:
    mass, center, J = body
    _compare(joint, 'mass', mass, inertia.mass, AGREEMENT * mass)
    if mass > LIGHTEST:
        reach = max(length, float(np.abs(center).max()))
        size = max(float(np.abs(J).max()), mass * reach**2)
        lever, about = np.array(inertia.lever), np.array(inertia.inertia)
        _compare(joint, 'centre of mass', product(turn, center), lever, AGREEMENT * reach)
        _compare(joint, 'inertia', product(turn, J, turn.T), about, AGREEMENT * size)


def _in_turned_frames(frames: list[Placement], turns: list[Array]) -> Iterator[Placement]:
    """Yield Pinocchio's frames with the axes of joints turned to z, as for `welded_frames`."""
    (R0, p0), *rest = frames
    before = [(R0, p0), *((turn, np.zeros(3)) for turn in turns)]
    for (R, p), (R1, p1), turn in zip(before, rest, [*turns, np.eye(3)], strict=True):
        yield product(R.T, R1, turn), product(R.T, p1 - p)


def _pair(placement: Any) -> Placement:
    return np.array(placement.rotation), np.array(placement.translation)


def _limits(joint: Joint) -> Array:
    """Return the limits and friction of a joint, with large numbers for infinities."""
    limits = joint.limits
    ends = [0.0, 0.0] if joint.kind == 'continuous' else [limits.lower, limits.upper]
    rest = [limits.velocity, limits.effort, limits.damping, limits.friction]
    finite: Array = np.nan_to_num(np.array([*ends, *rest]))
    return finite


def _limits_of(model: Any, index: int, joint: Joint) -> Array:
    q, v = model.joints[index].idx_q, model.joints[index].idx_v
    ends = [0.0, 0.0]
    if joint.kind != 'continuous':
        ends = [model.lowerPositionLimit[q], model.upperPositionLimit[q]]
    rest = [model.velocityLimit[v], model.effortLimit[v], model.damping[v], model.friction[v]]
    finite: Array = np.nan_to_num(np.array([*ends, *rest]))
    return finite


def _reduced(pinocchio: Any, model: Any, locked: Mapping[str, float]) -> Any:
    """Return Pinocchio's model with joints welded at their positions."""
    positions = pinocchio.neutral(model)
    for name, angle in locked.items():
        joint = model.joints[model.getJointId(name)]
        # Pinocchio holds an unlimited angle as its cosine and sine.
        value = [math.cos(angle), math.sin(angle)] if joint.nq == 2 else [angle]
        positions[joint.idx_q : joint.idx_q + joint.nq] = value
    welded = [model.getJointId(name) for name in locked]
    return pinocchio.buildReducedModel(model, welded, positions) if welded else model


def _rewritten(
    urdf: Description, chain: Chain, joints: Mapping[str, str], links: Mapping[str, str]
) -> Iterator[str]:
    """Yield the lines of a URDF of the chain, with new names of links and joints."""
    yield '<robot name="chain">'
    for link, name in links.items():
        inertial = None if chain.carriers[link] is None else urdf.links[link]
        yield f'<link name="{name}">{"" if inertial is None else _inertial(inertial)}</link>'
    for joint in chain.below:
        ends = f'<parent link="{links[joint.parent]}"/><child link="{links[joint.child]}"/>'
        drive = '' if joint.kind == 'fixed' else _drive(joint)
        head = f'<joint name="{joints[joint.name]}" type="{joint.kind}">'
        yield f'{head}{ends}{_origin(joint.origin)}{drive}</joint>'
    yield '</robot>'


def _drive(joint: Joint) -> str:
    lower, upper, velocity, effort, damping, friction = map(_text, _limits(joint))
    return (
        f'<axis xyz="{_words(axis_rotation(joint.axis)[:, 2])}"/>'
        f'<limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{effort}"/>'
        f'<dynamics damping="{damping}" friction="{friction}"/>'
    )


def _inertial(inertial: Inertial) -> str:
    pairs = zip(INERTIA_KEYS, map(_text, inertial.inertia), strict=True)
    inertia = ' '.join(f'{key}="{value}"' for key, value in pairs)
    mass = f'<mass value="{_text(inertial.mass)}"/>'
    return f'<inertial>{_origin(inertial.origin)}{mass}<inertia {inertia}/></inertial>'


def _origin(origin: Origin) -> str:
    return f'<origin xyz="{_words(origin.xyz)}" rpy="{_words(origin.rpy)}"/>'


def _words(values: ArrayLike) -> str:
    return ' '.join(map(_text, np.asarray(values).tolist()))


def _text(value: float) -> str:
    """Return a number as text, 0 for a subnormal one, for which Pinocchio refuses the file."""
    return repr(float(value)) if abs(value) >= np.finfo(float).tiny else '0.0'
