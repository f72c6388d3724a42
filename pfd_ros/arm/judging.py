# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict on each event: its bytes read by source, and judged by the rules for that source."""

from __future__ import annotations

import numpy as np

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.changes import judge_changes, judge_payload
from pfd_ros.arm.commands import Judgement, judge_array, judge_named
from pfd_ros.arm.drive import Gains
from pfd_ros.arm.events import MOVING, Arrival, Source, Verdict
from pfd_ros.arm.followed_clock import judge_tick
from pfd_ros.arm.pace import Pace
from pfd_ros.arm.requests import judge_request, judge_state
from pfd_ros.arm.wrench import judge_wrench
from pfd_ros.messages import convert, stamped
from pfd_ros.text import one_line

INACTIVE = Judgement(Verdict.REFUSED, 'the arm is inactive')


class Judge:
    """The rules for the events of one arm."""

    def __init__(self, arm: Arm, pace: Pace) -> None:
        self._arm, self._pace = arm, pace
        self._index = {name: i for i, name in enumerate(arm.robot.joint_names)}
        self._order = np.array(arm.order)
        self._locked = arm.settings.published_locks

    def judge(self, event: Arrival, gains: Gains | None) -> Judgement:
        """Return the verdict on a message and its effect; `gains` are those of the servos."""
        source, payload, state = event.source, event.payload, self._arm.state
        if not state.pace.active and source in MOVING:
            return INACTIVE
        try:
            if source is Source.ARRAY:
                return self.judge_efforts(convert.decode_floats(payload))
            if source is Source.NAMED:
                message = convert.decode_joint_state(payload)
                state.newest_ns = message.stamp_ns
                return self._unless_tripped(
                    judge_named(message, self._index, state.since_ns, gains, self._locked)
                )
            if source is Source.SET_STATE:
                message = convert.decode_joint_state(payload)
                return judge_state(message, self._index, self._locked)
            if source is Source.PARAMETERS:
                return judge_changes(convert.decode_string(payload), self._arm)
            if source is Source.TICK:
                return self._judge_tick(convert.decode_clock(payload))
            if source is Source.WRENCH:
                wrench, on = stamped.decode_wrench(payload), state.wrench is not None
                return judge_wrench(wrench, self._arm.robot, state.reset_ns, taken=on)
            if source is Source.PAYLOAD:
                return judge_payload(stamped.decode_inertia(payload), self._arm)
            return judge_request(convert.decode_string(payload), state.pace)
        except ValueError as error:
            return Judgement(Verdict.MALFORMED, one_line(error))

    def judge_efforts(self, efforts: np.ndarray) -> Judgement:
        """Return the judgement on a command without names, of efforts in published order."""
        if not self._arm.state.pace.active:
            return INACTIVE
        return self._unless_tripped(judge_array(efforts, self._order))

    def _unless_tripped(self, judgement: Judgement) -> Judgement:
        """Return the judgement on a command, for an arm that a reflex may have braked."""
        actuators = self._arm.state.actuators
        if actuators.tripped and judgement.verdict is Verdict.ACCEPTED:
            return Judgement(Verdict.REFUSED, actuators.reflex)
        return judgement

    def _judge_tick(self, tick_ns: int) -> Judgement:
        if not self._pace.follows_clock:
            raise ValueError('no clock is followed')
        arm = self._arm
        return judge_tick(tick_ns, arm.stamp_ns, arm.state.pace.until_ns, arm.settings.step_ns)
