# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for requests, and for states to set.

A request is JSON: {"request": "step", "count": 5}.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
import json
from typing import Any

import numpy as np

from pfd_ros.arm.commands import Validation, named_values_rule, too_far
from pfd_ros.arm.events import MOST_STEPS, Request, StateChange, Verdict
from pfd_ros.arm.state import PaceState
from pfd_ros.messages.convert import JointMessage, encode_string
from pfd_ros.text import NAME_COUNT, cut, listed

# pause, resume: stop or continue simulated time. step: a number of steps while paused. reset:
# initial state, braked. deactivate: braked and no steps until activated. clear_wrench: no external
# wrench.
REQUESTS = ('pause', 'resume', 'step', 'reset', 'activate', 'deactivate', 'clear_wrench')
# A request is far shorter.
LONGEST_REQUEST = 1000


def encode_request(request: Request) -> bytes:
    """Return the message of a request."""
    values: dict[str, Any] = {'request': request.name}
    if request.name == 'step':
        values['count'] = request.count
    return encode_string(json.dumps(values))


def validate_request(text: str, pace: PaceState) -> Validation:
    """Validate a request to an arm of this pace.

    Raises
    ------
    ValueError
        If the text is not a request.
    """
    if len(text) > LONGEST_REQUEST:
        raise ValueError(f'{len(text)} characters, expected {LONGEST_REQUEST} at most')
    values = json.loads(text)
    if not isinstance(values, dict) or values.get('request') not in REQUESTS:
        raise ValueError(f'request is {cut(text)!r}, expected one of {list(REQUESTS)}')
    name = values.pop('request')
    count = values.pop('count', 1) if name == 'step' else 1
    if values:
        raise ValueError(f'request {name!r} does not take {listed([str(key) for key in values])}')
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_STEPS:
        raise ValueError(f'count is {cut(repr(count))}, expected 1 to {MOST_STEPS}')
    if name in ('step', 'reset') and not pace.active:
        return Validation(Verdict.REFUSED, f'{name}: the arm is inactive')
    if name == 'step' and not pace.paused:
        return Validation(Verdict.REFUSED, 'step: the arm is not paused')
    return Validation(Verdict.ACCEPTED, name, effect=Request(name, count))


def validate_state(
    message: JointMessage, index: Mapping[str, int], locked: Collection[str] = ()
) -> Validation:
    """Validate a state to jump to; see `commands.validate_named` for the parameters.

    With NaN or an empty array a position is unchanged and a velocity is zero. Locked joints stay
    where they are. Efforts and stamp are ignored, so a message of joint_states can be sent back
    unchanged.
    """
    if not message.names:
        return Validation(Verdict.NO_NAMES, 'no joint names')
    broken = named_values_rule(message)
    if broken is not None:
        return broken
    if not len(message.position):
        return Validation(
            Verdict.MALFORMED, 'no positions; expected a position for each joint that is named'
        )
    velocity = message.velocity if len(message.velocity) else np.zeros(len(message.names))
    strange = [name for name in message.names if name not in index and name not in locked]
    if strange:
        # Unlike a command, a state must not name unknown joints.
        return Validation(
            Verdict.UNKNOWN_NAMES,
            f'unknown joints {listed(strange)}',
            unknown=tuple(cut(name) for name in strange[:NAME_COUNT]),
            unknown_count=len(strange),
        )
    far = too_far(message.position, velocity)
    if far is not None:
        return far
    given = [
        (index[name], q, qd if qd == qd else 0.0)
        for name, q, qd in zip(
            message.names, message.position.tolist(), velocity.tolist(), strict=True
        )
        if name in index and q == q
    ]
    if not given:
        return Validation(Verdict.ALL_NAN, 'no position for any moving joint')
    return Validation(Verdict.ACCEPTED, '', effect=StateChange(*zip(*given, strict=True)))
