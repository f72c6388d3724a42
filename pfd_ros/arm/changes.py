# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for settings that change while the arm runs.

A change travels as JSON: {"real_time_factor": 0.5}, new values by the field of Settings.
Only fields with `dynamic=True` change, all of one text or none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
import json
from typing import Any

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.commands import Validation
from pfd_ros.arm.events import PAYLOAD_IN_USE, Output, SettingsChange, Verdict
from pfd_ros.arm.plant_settings import COMPILED, PAYLOAD
from pfd_ros.arm.scene import with_own_effects
from pfd_ros.arm.setting_fields import check_joint_counts, typed
from pfd_ros.arm.settings import Settings, check_servo
from pfd_ros.arm.tip_frames import body_at_tip, tip_frame
from pfd_ros.messages.convert import encode_string
from pfd_ros.messages.stamped import InertiaMessage, encode_inertia, inertia_message
from pfd_ros.text import listed

# Every dynamic setting of an arm with a hundred joints fits in.
LONGEST_CHANGES = 1 << 16
DYNAMIC = {field.name: str(field.type) for field in fields(Settings) if field.metadata['dynamic']}


def encode_changes(values: Mapping[str, Any]) -> bytes:
    """Return the message that new values travel as."""
    return encode_string(json.dumps(dict(values)))


def read_changes(text: str) -> dict[str, Any]:
    """Return the new values of a text by field, each of the field's type.

    Raises
    ------
    ValueError
        If the text is not a JSON object of dynamic settings.
    """
    if len(text) > LONGEST_CHANGES:
        raise ValueError(f'{len(text)} characters, expected {LONGEST_CHANGES} at most')
    try:
        values = json.loads(text)
    except RecursionError:
        raise ValueError('nested too deeply') from None
    if not isinstance(values, dict) or not values:
        raise ValueError('expected a table of values by setting')
    strange = [name for name in values if name not in DYNAMIC]
    if strange:
        raise ValueError(f'{listed(strange)} cannot change while the arm runs')
    return {name: typed(name, value, DYNAMIC[name]) for name, value in values.items()}


def changed(arm: Arm, settings: Settings, values: Mapping[str, Any]) -> Settings:
    """Return settings of an arm with new values of some fields.

    Raises
    ------
    ValueError
        If a value is invalid, by itself or together with the others.
    """
    found = replace(with_own_effects(settings, values), **values)
    check_joint_counts(found, len(arm.order))
    check_servo(found)
    return found


def validate_payload(message: InertiaMessage, arm: Arm) -> Validation:
    """Validate a payload for an arm; a mass of 0 removes it."""
    try:
        values = payload_values(message, arm)
    except ValueError as error:
        return Validation(Verdict.UNKNOWN_NAMES, str(error))
    return validate_values(values, arm)


def payload_values(message: InertiaMessage, arm: Arm) -> dict[str, Any]:
    """Return the settings that describe a payload, by name.

    Raises
    ------
    ValueError
        If its frame is not fixed to the last link.
    """
    frame = tip_frame(arm.robot, message.frame_id)
    body = body_at_tip(frame, message.center, message.inertia)
    return dict(zip(PAYLOAD, (message.mass, *body), strict=True))


def validate_values(values: Mapping[str, Any], arm: Arm) -> Validation:
    """Validate new values, by field, for the settings of an arm."""
    compiled = not COMPILED.isdisjoint(values)
    if compiled and arm.failure:
        return Validation(Verdict.REFUSED, 'the simulation has stopped')
    try:
        found = changed(arm, arm.settings, values)
        plant = arm.plant_of(found) if compiled else None
    except ValueError as error:
        return Validation(Verdict.REFUSED, str(error))
    return Validation(Verdict.ACCEPTED, ', '.join(values), effect=SettingsChange(found, plant))


def payload_message(arm: Arm) -> Output | None:
    """Return the message about a payload that acted in this step for the first time."""
    state, payload = arm.state, arm.plant.payload
    if payload == state.payload or state.failure:
        return None
    state.payload, state.payload_messages = payload, state.payload_messages + 1
    message = inertia_message(arm.stamp_ns, arm.robot.tip, payload or (0.0,) * 10)
    return Output(PAYLOAD_IN_USE, state.payload_messages, encode_inertia(message))
