# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots from URDF: Pinocchio reads and welds, this brings the chain to our frames."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from pfd_core.model.geometry import (
    RIGHT_ANGLE_TOLERANCE,
    Array,
    axis_rotation,
    product,
    snapped,
    welded_frames,
)
from pfd_core.model.robot import Robot
from pfd_core.model.urdf_tree import (
    RIGHT_ANGLE_SLACK,
    Chain,
    Joint,
    Tree,
    find_chain,
    read_tree,
)


def robot_from_urdf(
    text: str,
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    source: str = 'URDF text',
    right_angle: float = RIGHT_ANGLE_SLACK,
) -> Robot:
    """
    Return the chain between two links of a URDF.

    Parameters
    ----------
    text : str
        The URDF.
    base, tip : str, optional
        Links; the root and the link that the last joint moves if not given. Joints above the
        base are cut off, and so are other branches that start on the base, which stands still.
        Whatever hangs on a moving link keeps its mass, also beyond the tip.
    locked : mapping, optional
        Name of a joint -> position [rad, m] at which it is welded.
    source : str
        Where the text comes from.
    right_angle : float
        Rotations this close to a multiple of 90 degrees are taken as one [rad]; negative: none.

    Raises
    ------
    ValueError
        If the text is no URDF, or these choices leave no single chain.

    """
    tree, exact, touched = read_tree(text, right_angle)
    chain = find_chain(tree, base, tip, locked or {})
    model = _welded_model(exact, tree, chain, locked or {})
    placements, bodies = _joint_frames(model, chain)
    return Robot(
        name=tree.name,
        joint_names=tuple(joint.name for joint in chain.joints),
        joint_types=tuple(joint.kind for joint in chain.joints),
        base=chain.base,
        tip=chain.tip,
        source=source,
        squared=touched,
        **welded_frames(placements, bodies),
        **_limits(model, chain),
    )


def _welded_model(text: str, tree: Tree, chain: Chain, locked: Mapping[str, float]) -> Any:
    """Return Pinocchio's model in which only the chain's joints move."""
    import pinocchio

    try:
        model = pinocchio.buildModelFromXML(text)
    except ValueError as error:
        raise ValueError(f'{tree.name!r}: {error} (its parser wrote why to stderr)') from error
    moving = {joint.name for joint in chain.joints}
    positions = pinocchio.neutral(model)
    welded = []
    for index in range(1, model.njoints):
        name, joint = model.names[index], model.joints[index]
        if name in moving:
            continue
        welded.append(index)
        angle = float(locked.get(name, 0.0))
        if joint.nq == 2:
            # Pinocchio holds an unlimited angle as its cosine and sine.
            positions[joint.idx_q : joint.idx_q + 2] = math.cos(angle), math.sin(angle)
        elif joint.nq == 1:
            positions[joint.idx_q] = angle
    return pinocchio.buildReducedModel(model, welded, positions) if welded else model


def _joint_frames(
    model: Any, chain: Chain
) -> tuple[list[tuple[Array, Array]], list[tuple[float, Array, Array]]]:
    """Return placements and bodies of the chain in frames whose z is the joint's axis."""
    import pinocchio

    frames = [
        model.frames[model.getFrameId(link, pinocchio.FrameType.BODY)]
        for link in (chain.base, chain.tip)
    ]
    start, end = (_pair(frame.placement) for frame in frames)
    indices = [model.getJointId(joint.name) for joint in chain.joints]
    turns = [axis_rotation(joint.axis) for joint in chain.joints]
    placements = []
    # Each placement is seen from the frame before it: the base's, then each joint's.
    before = [(start[0], start[1]), *((turn, np.zeros(3)) for turn in turns)]
    after = [*(_pair(model.jointPlacements[k]) for k in indices), end]
    for (R0, p0), (R1, p1), turn in zip(before, after, [*turns, np.eye(3)], strict=True):
        placements.append((snapped(product(R0.T, R1, turn)), product(R0.T, p1 - p0)))
    length = max(float(np.abs(p).max()) for _, p in placements)
    placements = [(R, _without_dust(p, length)) for R, p in placements]
    bodies = []
    for k, turn in zip(indices, turns, strict=True):
        inertia = model.inertias[k]
        J = product(turn.T, np.array(inertia.inertia), turn)
        center = _without_dust(product(turn.T, np.array(inertia.lever)), length)
        bodies.append((float(inertia.mass), center, _without_dust(J, float(np.abs(J).max()))))
    return placements, bodies


def _pair(placement: Any) -> tuple[Array, Array]:
    return snapped(np.array(placement.rotation)), np.array(placement.translation)


def _without_dust(values: Array, scale: float) -> Array:
    """Return values with what welding rounded to nearly zero put back to zero."""
    return np.where(np.abs(values) <= RIGHT_ANGLE_TOLERANCE * scale, 0.0, values)


def _limits(model: Any, chain: Chain) -> dict[str, Any]:
    """Return limits, friction and rotor inertia of the chain's joints."""

    def of(values: Any, joint: Joint, index: str = 'idx_v') -> float:
        return float(values[getattr(model.joints[model.getJointId(joint.name)], index)])

    rotor = np.asarray(model.rotorInertia) * np.asarray(model.rotorGearRatio) ** 2
    by_velocity = {
        'velocity_limit': model.velocityLimit,
        'effort_limit': model.effortLimit,
        'damping': model.damping,
        'friction': model.friction,
        'armature': np.asarray(model.armature) + rotor,
    }
    limits = {key: np.array([of(v, j) for j in chain.joints]) for key, v in by_velocity.items()}
    for key, values, unlimited in (
        ('position_lower', model.lowerPositionLimit, -np.inf),
        ('position_upper', model.upperPositionLimit, np.inf),
    ):
        limits[key] = np.array(
            [
                unlimited if joint.kind == 'continuous' else of(values, joint, 'idx_q')
                for joint in chain.joints
            ]
        )
    return limits
