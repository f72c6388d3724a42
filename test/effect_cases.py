# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values of every field of a scene, made from the table of effects."""

from __future__ import annotations

from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_core.model import effects

# Fields that hold something else than numbers of a rule.
OTHERS: dict[str, Any] = {
    'gravity': (0.3, -0.2, -9.6),
    'payload': pfd.Payload(1.0, (0.1, 0.05, -0.02), np.diag([0.02, 0.03, 0.04])),
    'external_wrench': True,
    'brakes': True,
    'restitution': 0.5,
    'gravity_compensation': pfd.Scene(gravity=(0.0, 0.1, -9.7)),
}


def example(effect: effects.Effect, n: int, seed: int = 1) -> Any:
    """Return a value of an effect for n joints; every number differs from the others."""
    if effect.field == 'torque_speed':
        return [[(0.2 + 0.1 * i, 6.0 + i), (4.0 + i, 1.0)] for i in range(n)]
    if effect.kind != 'per joint':
        return OTHERS[effect.field]
    rng = np.random.default_rng([seed, *effect.field.encode()])
    columns = len(effect.columns) or 1
    numbers = 0.5 + rng.uniform(0.0, 1.0, (n, columns))
    if effect.least < 0:
        # Limits between which a joint lies, or positions of either sign.
        numbers[:, 0] = -numbers[:, 0]
    if effect.field == 'static_friction':
        numbers += 1.5
    if effect.most == 1:
        numbers *= 0.1  # shares
    return numbers if effect.columns else numbers[:, 0]


def scene_with(*names: str, n: int, **others: Any) -> pfd.Scene:
    """Return a scene with these fields, and with those that they refine."""
    wanted = set(names)
    while more := {effects.FIELDS[name].needs for name in wanted} - {''} - wanted:
        wanted |= more
    values = {name: example(effects.FIELDS[name], n) for name in wanted}
    return pfd.Scene(**{'gravity': None, **values, **others})


def everything(n: int) -> pfd.Scene:
    """Return a scene of n joints with every effect of the table."""
    return scene_with(*(effect.field for effect in pfd.EFFECTS), n=n)
