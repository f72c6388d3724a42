# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The programs of a step with dry friction and joint stops, by name."""

from __future__ import annotations

from pfd_core.machine.program import Program
from pfd_core.model import Plant
from pfd_core.model.values import Array
from pfd_core.simulation.contact.dense_events import dense_event_programs
from pfd_core.simulation.contact.events import (
    record_commit,
    record_cut,
    record_end,
    record_unfinished,
)
from pfd_core.simulation.contact.impacts import (
    record_compression,
    record_hits,
    record_impulses,
    record_inelastic,
    record_restitution,
    record_settling,
)
from pfd_core.simulation.contact.lag import record_follow, record_lag
from pfd_core.simulation.contact.modes import (
    record_directions,
    record_drive,
    record_effort,
    record_modes,
    record_pivot,
    record_watch,
)
from pfd_core.simulation.contact.schemes import Scheme


def has_contact(plant: Plant) -> bool:
    """Return whether a plant has dry friction or joint stops."""
    return plant.friction is not None or plant.joint_limits is not None


def contact_programs(
    plant: Plant,
    scheme: Scheme,
    dtype: str,
    h: float,
    compensated: bool,
    decays: tuple[Array, Array] | None,
) -> dict[str, Program]:
    """
    Return the programs that a plant with dry friction or joint stops needs.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    scheme : Scheme
        The integrator between events.
    dtype : str
        Number format.
    h : float
        Size of a step [s].
    compensated : bool
        Whether positions have the row q_low.
    decays : tuple of ndarray or None
        exp(-t/T) after the part `scheme.middle` of a step and after a step, (n,); None without a
        lag of motors.

    """
    n = plant.robot.n
    programs = {
        **_mode_programs(plant, scheme.sticks),
        **scheme.programs(plant),
        'end': record_end(plant, scheme),
        'cut': record_cut(plant, scheme, dtype),
        'commit': record_commit(n, compensated, plant.motor_lag is not None),
        'unfinished': record_unfinished(n),
    }
    if decays is not None:
        programs['lag'] = record_lag(plant, h, scheme.middle, *decays)
        programs['follow'] = record_follow(plant)
    if scheme.implicit:
        programs['drive'] = record_drive(plant)
    return programs | _event_programs(plant, dtype)


def adaptive_contact_programs(plant: Plant) -> dict[str, Program]:
    """Return the programs of events in adaptive steps, in float64."""
    shared = _mode_programs(plant, sticks=True) | _event_programs(plant, 'float64')
    return shared | dense_event_programs(plant)


def _mode_programs(plant: Plant, sticks: bool) -> dict[str, Program]:
    """Return the programs of the modes in which a segment begins."""
    n = plant.robot.n
    return {
        'watch': record_watch(plant),
        'directions': record_directions(n),
        'modes': record_modes(plant, sticks),
        'pivot': record_pivot(n),
    }


def _event_programs(plant: Plant, dtype: str) -> dict[str, Program]:
    """Return the programs of friction and of impacts that the plant needs."""
    n = plant.robot.n
    programs: dict[str, Program] = {}
    if plant.friction is not None:
        programs['effort'] = record_effort(plant)
    if plant.joint_limits is not None:
        programs |= {
            'hits': record_hits(plant, dtype),
            'compression': record_compression(plant),
            'impulses': record_impulses(plant),
            'restitution': record_restitution(plant),
            'settling': record_settling(n),
            'inelastic': record_inelastic(n),
        }
    return programs
