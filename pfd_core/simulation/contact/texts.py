# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The texts of a step with dry friction and joint stops, by the names that the step runs them."""

from __future__ import annotations

from pfd_core.machine.program import Program
from pfd_core.model import Plant
from pfd_core.simulation.contact.events import record_commit, record_cut, record_end, record_stage
from pfd_core.simulation.contact.impacts import (
    record_compression,
    record_hits,
    record_impulses,
    record_inelastic,
    record_restitution,
)
from pfd_core.simulation.contact.modes import (
    record_directions,
    record_effort,
    record_modes,
    record_pivot,
    record_watch,
)


def contact_texts(plant: Plant, dtype: str) -> dict[str, Program]:
    """Return the texts that a plant needs; none without dry friction and joint stops."""
    friction, stops = plant.friction is not None, plant.joint_limits is not None
    if not friction and not stops:
        return {}
    n = plant.robot.n
    texts = {
        'watch': record_watch(plant),
        'directions': record_directions(n),
        'modes': record_modes(plant),
        'pivot': record_pivot(n),
        **{f'stage{stage}': record_stage(n, stage) for stage in (2, 3, 4)},
        'end': record_end(plant),
        'cut': record_cut(plant, dtype),
        'commit': record_commit(n),
    }
    if friction:
        texts['effort'] = record_effort(plant)
    if stops:
        texts |= {
            'hits': record_hits(plant),
            'compression': record_compression(plant),
            'impulses': record_impulses(plant),
            'restitution': record_restitution(plant),
            'inelastic': record_inelastic(n),
        }
    return texts
