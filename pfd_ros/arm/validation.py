# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Validate each event: its bytes are decoded by source and checked by the rules for it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.actuator_command import Gains
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.changes import read_changes, validate_payload, validate_values
from pfd_ros.arm.commands import Validation, validate_array, validate_named
from pfd_ros.arm.events import MOVING, Arrival, Source, Verdict
from pfd_ros.arm.pace import Pace, validate_tick
from pfd_ros.arm.requests import validate_request, validate_state
from pfd_ros.arm.wrench import validate_wrench
from pfd_ros.messages import convert, stamped
from pfd_ros.text import one_line

INACTIVE = Validation(Verdict.REFUSED, 'the arm is inactive')


class Validator:
    """The rules for the events of one arm."""

    def __init__(self, arm: Arm, pace: Pace) -> None:
        self._arm, self._pace = arm, pace
        self._index = {name: i for i, name in enumerate(arm.robot.joint_names)}
        self._order = np.array(arm.order)
        self._locked = arm.settings.published_locks

    def validate(self, event: Arrival, gains: Gains | None) -> Validation:
        """Validate a message; `gains` are the gains of the servos."""
        source, payload, state = event.source, event.payload, self._arm.state
        if not state.pace.active and source in MOVING:
            return INACTIVE
        try:
            if source is Source.ARRAY:
                return self.validate_efforts(convert.decode_floats(payload))
            if source is Source.NAMED:
                message = convert.decode_joint_state(payload)
                state.newest_ns = message.stamp_ns
                return self._unless_tripped(
                    validate_named(message, self._index, state.since_ns, gains, self._locked)
                )
            if source is Source.SET_STATE:
                message = convert.decode_joint_state(payload)
                return validate_state(message, self._index, self._locked)
            if source is Source.PARAMETERS:
                return validate_values(read_changes(convert.decode_string(payload)), self._arm)
            if source is Source.TICK:
                return self._validate_tick(convert.decode_clock(payload))
            if source is Source.WRENCH:
                wrench, on = stamped.decode_wrench(payload), state.wrench is not None
                return validate_wrench(wrench, self._arm.robot, state.reset_ns, taken=on)
            if source is Source.PAYLOAD:
                return validate_payload(stamped.decode_inertia(payload), self._arm)
            return validate_request(convert.decode_string(payload), state.pace)
        except ValueError as error:
            return Validation(Verdict.MALFORMED, one_line(error))

    def validate_efforts(self, efforts: NDArray[Any]) -> Validation:
        """Validate a command without names, efforts in published order."""
        if not self._arm.state.pace.active:
            return INACTIVE
        return self._unless_tripped(validate_array(efforts, self._order))

    def _unless_tripped(self, validation: Validation) -> Validation:
        """Return the validation result of a command, for an arm that a reflex may have braked."""
        actuators = self._arm.state.actuators
        if actuators.tripped and validation.verdict is Verdict.ACCEPTED:
            return Validation(Verdict.REFUSED, actuators.reflex)
        return validation

    def _validate_tick(self, tick_ns: int) -> Validation:
        if not self._pace.follows_clock:
            raise ValueError('time_source is not clock')
        arm = self._arm
        return validate_tick(tick_ns, arm.stamp_ns, arm.state.pace.until_ns, arm.settings.step_ns)
