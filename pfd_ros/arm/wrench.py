# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench: its rule, how long it acts, and frames that the last link carries.

In Python's own floats, in a fixed order: the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import Change, RefusedError
from pfd_ros.arm.settings import timeout_steps
from pfd_ros.arm.state import ACTED, NEXT, State
from pfd_ros.messages.numbers import decode_numbers
from pfd_ros.messages.types import WRENCH
from pfd_ros.text import cut, listed

# Far more than any arm bears, N and N m; a simulation under more would not stay finite.
LARGEST_WRENCH = 1e5
Vector = tuple[float, ...]


def rule(arm: Arm, data: bytes) -> Change:
    """Check a wrench, expressed in the frame of its header and applied at its origin."""
    stamp_ns, frame_id, numbers = decode_numbers(data, WRENCH)
    if not arm.wrenched:
        raise RefusedError('refused', 'start the arm with external_wrench:=true')
    if not all(map(math.isfinite, numbers)):
        raise RefusedError('not_finite', 'contains a number that is not finite')
    if max(map(abs, numbers)) > LARGEST_WRENCH:
        raise RefusedError('refused', f'expected {LARGEST_WRENCH:g} N and N m at most')
    since_ns = arm.state.reset_ns
    if 0 != stamp_ns < since_ns:
        raise RefusedError('stale', f'stamp {stamp_ns} ns, expected {since_ns} ns or later')
    frame = tip_frame(arm.robot, frame_id)
    return put, (wrench_at_tip(frame, numbers[:3], numbers[3:]),)


def put(arm: Arm, wrench: Vector) -> None:
    """Let a wrench act for `external_wrench_timeout`, or until it is replaced, for 0."""
    settings, state = arm.state.settings, arm.state
    steps = timeout_steps(settings.external_wrench_timeout, settings.step_size)
    state.wrench[NEXT] = wrench
    state.wrench_left = None if math.isinf(steps) else int(steps)


def clear(state: State) -> None:
    """Let no wrench act from the next step on."""
    state.wrench[NEXT], state.wrench_left = 0.0, None


def advance(state: State) -> bool:
    """Begin a step, perhaps without the wrench of the last one; return whether it is another."""
    if state.wrench_left:
        state.wrench_left -= 1
    elif state.wrench_left is not None:
        clear(state)
    acted, following = state.wrench
    if acted.tobytes() == following.tobytes():
        return False
    state.wrench[ACTED] = following
    return True


def tip_frame(robot: pfd.Robot, name: str) -> Any:
    """Return a frame that is fixed to a robot's last link; refuse another one."""
    frame = robot.frames.get(name)
    if frame is None or frame.link != robot.links:
        why = 'is not a frame of the arm' if frame is None else 'does not move with the last link'
        carried = [robot.tip, *(k for k, f in robot.frames.items() if f.link == robot.links)]
        names = listed(list(dict.fromkeys(carried)))
        raise RefusedError(
            'unknown_names', f'frame_id {cut(name)!r} {why}; expected one of {names}'
        )
    return frame


def _rotated(rotation: Sequence[Sequence[float]], vector: Sequence[float]) -> Vector:
    x, y, z = vector
    return tuple(row[0] * x + row[1] * y + row[2] * z for row in rotation)


def wrench_at_tip(frame: Any, force: Sequence[float], torque: Sequence[float]) -> Vector:
    """Return force and moment (6,) in the last link's frame and about its origin, N and N m."""
    rotation, (x, y, z) = frame.rotation.tolist(), frame.translation.tolist()
    fx, fy, fz = _rotated(rotation, force)
    mx, my, mz = _rotated(rotation, torque)
    return fx, fy, fz, mx + (y * fz - z * fy), my + (z * fx - x * fz), mz + (x * fy - y * fx)


def body_at_tip(
    frame: Any, center: Sequence[float], inertia: Sequence[float]
) -> tuple[Vector, Vector]:
    """Return centre of mass (3,) and inertia (6,) of a body in a frame in the last link's frame.

    The inertia is (xx, xy, xz, yy, yz, zz), about the centre.
    """
    rotation = frame.rotation.tolist()
    xx, xy, xz, yy, yz, zz = inertia
    # R J R^T, column by column: R J R^T = R (R J)^T, since J is symmetric.
    half = [_rotated(rotation, row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    columns = [_rotated(rotation, row) for row in zip(*half, strict=True)]
    upper = tuple(columns[i][j] for i in range(3) for j in range(i, 3))
    moved = zip(_rotated(rotation, center), frame.translation.tolist(), strict=True)
    return tuple(a + b for a, b in moved), upper
