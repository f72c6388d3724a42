# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why the arm rejected a command: reasons by name, and messages."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from pfd_ros.arm.actuator_command import Command
from pfd_ros.arm.commands import Validation, kinds_of
from pfd_ros.arm.events import Source, Verdict
from pfd_ros.messages.convert import decode_floats, decode_joint_state
from pfd_ros.text import did_you_mean, listed

# The names that `allow_rejected` takes, and the diagnostics of the node count.
REASONS = tuple(verdict.label for verdict in Verdict if verdict is not Verdict.ACCEPTED)
STALE = Verdict.STALE.label
# Whose text has the joints and numbers.
NOT_FINITE = frozenset({Verdict.INFINITE, Verdict.NOT_FINITE})


class Rejection(NamedTuple):
    """The name of a reason, and the names and numbers that broke the rule."""

    reason: str
    detail: str

    def __str__(self) -> str:
        return f'{self.reason}: {self.detail}'


class RejectedError(Exception):
    """A rejection that the test does not allow."""


def checked_reasons(given: Collection[str]) -> frozenset[str]:
    """Return the reasons that a test allows; ValueError if one is not known."""
    if isinstance(given, str):
        given = {given}
    for name in given:
        if name not in REASONS:
            hint = did_you_mean(str(name), REASONS, f'expected some of {list(REASONS)}')
            raise ValueError(f'allow_rejected has {name!r}: {hint}')
    return frozenset(given)


def rejection(
    source: Source, data: bytes, validation: Validation, names: Sequence[str], model: Sequence[str]
) -> Rejection | None:
    """Return why the arm rejected a command or a part of it, None if it accepted all.

    The arm accepts a message by joint name that holds a number for one of its joints. Names that
    it does not have and joints that get NaN stay without a command: a part is rejected.

    Parameters
    ----------
    source, data, validation
        The command, and its validation result.
    names, model
        The joints in published order, and in the order of the model.
    """
    if validation.verdict is not Verdict.ACCEPTED:
        detail = validation.detail
        if validation.verdict in NOT_FINITE:
            detail = _not_finite(source, data, names)
        return Rejection(validation.verdict.label, detail)
    if validation.unknown_count:
        detail = f'{listed(validation.unknown)} of {validation.unknown_count} unknown joints'
        return Rejection(Verdict.UNKNOWN_NAMES.label, detail)
    effect = validation.effect
    if isinstance(effect, Command) and source is Source.NAMED and len(effect.joints) < len(names):
        driven = {model[j] for j in effect.joints}
        named = decode_joint_state(data).names
        left = [name for name in named if name in names and name not in driven]
        if left:
            return Rejection(Verdict.ALL_NAN.label, f'NaN for {listed(left)}')
    return None


def _not_finite(source: Source, data: bytes, names: Sequence[str]) -> str:
    """Return the numbers of a command that are not finite, with their joints."""
    if source is Source.ARRAY:
        kinds = {'effort': decode_floats(data)}
    else:
        message = decode_joint_state(data)
        names, kinds = message.names, kinds_of(message)
    wrong = [
        f'{kind} of joint {names[j]!r} is {values[j]}'
        for kind, values in kinds.items()
        for j in np.flatnonzero(~np.isfinite(values)).tolist()
    ]
    return f'{", ".join(wrong[:3])}{", ..." if len(wrong) > 3 else ""}'
