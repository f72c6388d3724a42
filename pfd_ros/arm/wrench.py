# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench: the rules for its messages, and how long one acts."""

from __future__ import annotations

import math

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.commands import Validation
from pfd_ros.arm.events import Verdict, WrenchChange
from pfd_ros.arm.settings import Settings, timeout_steps
from pfd_ros.arm.state import WrenchState
from pfd_ros.arm.tip_frames import tip_frame, wrench_at_tip
from pfd_ros.messages.stamped import WrenchMessage

# Far more than any arm bears, N and N m; a simulation under more would not stay finite.
LARGEST_WRENCH = 1e5


def validate_wrench(
    message: WrenchMessage, robot: pfd.Robot, since_ns: int, *, taken: bool
) -> Validation:
    """Validate an external wrench.

    Parameters
    ----------
    message
        Force and torque, expressed in and applied at the origin of the frame of its header.
    robot
        The robot, on whose last link it acts.
    since_ns
        Simulated time of the last start or reset; messages stamped before it are stale.
        Stamp 0 means now.
    taken
        Whether the arm's scene has an external wrench at all.
    """
    if not taken:
        return Validation(Verdict.REFUSED, 'start the arm with external_wrench:=true')
    if not all(map(math.isfinite, message.numbers)):
        return Validation(Verdict.NOT_FINITE, 'contains a number that is not finite')
    if max(map(abs, message.numbers)) > LARGEST_WRENCH:
        return Validation(Verdict.REFUSED, f'expected {LARGEST_WRENCH:g} N and N m at most')
    if 0 != message.stamp_ns < since_ns:
        return Validation(
            Verdict.STALE, f'stamp {message.stamp_ns} ns, expected {since_ns} ns or later'
        )
    try:
        frame = tip_frame(robot, message.frame_id)
    except ValueError as error:
        return Validation(Verdict.UNKNOWN_NAMES, str(error))
    wrench = wrench_at_tip(frame, message.force, message.torque)
    return Validation(Verdict.ACCEPTED, effect=WrenchChange(wrench))


def put(state: WrenchState, change: WrenchChange, settings: Settings) -> None:
    """Let a wrench act for `external_wrench_timeout`, or until it is replaced, for 0."""
    steps = timeout_steps(settings.external_wrench_timeout, settings.step_size)
    state.next = np.array(change.wrench)
    state.left = None if math.isinf(steps) else int(steps)


def clear(state: WrenchState) -> None:
    """Let no wrench act from the next step on."""
    state.next, state.left = np.zeros(6), None


def advance(state: WrenchState, steps: int = 1) -> None:
    """Begin the last of `steps` steps; a wrench whose time has ended is removed."""
    if state.left is not None:
        if state.left < steps:
            clear(state)
        else:
            state.left -= steps
    state.acting = state.next
