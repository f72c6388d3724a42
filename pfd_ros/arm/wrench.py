# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench: the rules for its messages, and how long one acts."""

from __future__ import annotations

import math

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.effects import WrenchChange
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.settings import Settings, timeout_steps
from pfd_ros.arm.tip_frames import tip_frame, wrench_at_tip
from pfd_ros.messages.stamped import WrenchMessage

# Far more than any arm bears, N and N m; a simulation under more would not stay finite.
LARGEST_WRENCH = 1e5


def judge_wrench(
    message: WrenchMessage, robot: pfd.Robot, since_ns: int, *, taken: bool
) -> Judgement:
    """Judge an external wrench.

    Parameters
    ----------
    message
        Force and torque, expressed in and applied at the origin of the frame of its header.
    robot
        The robot, on whose last link it acts.
    since_ns
        Simulated time of the last start or reset; messages stamped before it are left-overs.
        Stamp 0 means now.
    taken
        Whether the arm's scene has an external wrench at all.
    """
    if not taken:
        return Judgement(Verdict.REFUSED, 'start the arm with external_wrench:=true')
    numbers = (*message.force, *message.torque)
    if not all(map(math.isfinite, numbers)):
        return Judgement(Verdict.NOT_FINITE, 'holds a number that is not finite')
    if max(map(abs, numbers)) > LARGEST_WRENCH:
        return Judgement(Verdict.REFUSED, f'expected {LARGEST_WRENCH:g} N and N m at most')
    if 0 != message.stamp_ns < since_ns:
        return Judgement(
            Verdict.STALE, f'stamp {message.stamp_ns} ns, expected {since_ns} ns or later'
        )
    try:
        frame = tip_frame(robot, message.frame_id)
    except ValueError as error:
        return Judgement(Verdict.UNKNOWN_NAMES, str(error))
    wrench = wrench_at_tip(frame, message.force, message.torque)
    return Judgement(Verdict.ACCEPTED, effect=WrenchChange(wrench))


class ExternalWrench:
    """The wrench that acts on the last link, step by step."""

    def __init__(self, settings: Settings) -> None:
        self._none = np.zeros(6)
        self._step_size = settings.step_size
        self._acting, self._left = self._none, math.inf

    def put(self, change: WrenchChange, timeout: float) -> None:
        """Let a wrench act for so much simulated time, s, or until it is replaced, for 0."""
        self._acting = np.array(change.wrench)
        self._left = timeout_steps(timeout, self._step_size)

    def clear(self) -> None:
        """Let none act."""
        self._acting, self._left = self._none, math.inf

    def next(self) -> np.ndarray:
        """Return force and moment, (6,), of the next step, in the last link's frame."""
        if self._left <= 0:
            self.clear()
        self._left -= 1
        return self._acting
