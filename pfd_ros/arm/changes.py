# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for settings that change while the arm runs.

A change travels as a text in JSON: {"real_time_factor": 0.5}, new values by the field of Settings.
Only fields with `dynamic=True` change, all of one text or none.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import json
from typing import Any

from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.effects import SettingsChange
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.setting_fields import check_joint_counts, typed
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import encode_string
from pfd_ros.text import listed

# Every dynamic setting of an arm with a hundred joints fits in.
LONGEST_CHANGES = 1 << 16
DYNAMIC = {
    field.name: str(field.type)
    for field in dataclasses.fields(Settings)
    if field.metadata['dynamic']
}


def encode_changes(values: Mapping[str, Any]) -> bytes:
    """Return the message that new values travel as."""
    return encode_string(json.dumps(dict(values)))


def read_changes(text: str) -> dict[str, Any]:
    """Return the new values of a text by field, each of the field's type.

    Raises
    ------
    ValueError
        If it is no table of values of dynamic settings.
    """
    if len(text) > LONGEST_CHANGES:
        raise ValueError(f'{len(text)} characters, expected {LONGEST_CHANGES} at most')
    try:
        told = json.loads(text)
    except RecursionError:
        raise ValueError('nested too deeply') from None
    if not isinstance(told, dict) or not told:
        raise ValueError('expected a table of values by setting')
    strange = [name for name in told if name not in DYNAMIC]
    if strange:
        raise ValueError(f'{listed(strange)} cannot change while the arm runs')
    return {name: typed(name, value, DYNAMIC[name]) for name, value in told.items()}


def changed(settings: Settings, values: Mapping[str, Any], count: int) -> Settings:
    """Return settings with new values of some fields, for an arm of `count` joints.

    Raises
    ------
    ValueError
        If a value is refused, by itself or beside the others.
    """
    found = dataclasses.replace(settings, **values)
    check_joint_counts(found, count)
    return found


def judge_changes(text: str, settings: Settings, count: int) -> Judgement:
    """Judge new values for the settings of an arm with `count` joints.

    Raises
    ------
    ValueError
        If the text is no such table.
    """
    values = read_changes(text)
    try:
        found = changed(settings, values, count)
    except ValueError as error:
        return Judgement(Verdict.REFUSED, str(error))
    return Judgement(Verdict.ACCEPTED, ', '.join(values), effect=SettingsChange(found))
