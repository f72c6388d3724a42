# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Torques of the joints themselves, beside the torques of the links: damping, springs and rotors.

    tau = tau of links, gravity and wrench
          + damping qd + stiffness (q - rest_position) [+ armature qdd]

Every text takes these torques from here, on n lanes (one row for all joints) and on one
processor (a list with one number per joint). A further effect of a joint is a field of Scene and
Plant (pfd_core.model), a term of `_terms` and, unless it multiplies qdd, a field of AT_REST.
A sign is written with lanes.where. What a motor does is in pfd_core.algorithms.chain.drives.

In forward dynamics qdd is unknown, so that each method adds the rotors' inertia to the diagonal
of H or to the pivot of its joint.

With w^2 the largest eigenvalue of H^-1 diag(stiffness), a step h of an explicit integrator needs
w h <= 0.2 for a swing that is right, which simulations demand (pfd_core.simulation.stiffness);
RK4 grows without bound from w h = 2.8 on.

Parallel cost: 1 multiplication and 1 addition for each effect that is on; 1 addition more for
springs whose rest positions are not zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.chain.drives import DRIVES
from pfd_core.algorithms.chain.interface import input_list, input_row
from pfd_core.machine.recorder import Lanes
from pfd_core.model import Plant

# Fields of Plant whose torques do not depend on qdd.
AT_REST = ('damping', 'stiffness', 'rest_position', *DRIVES)


def plus_joint_torques(
    plant: Plant, tau: Sequence[Lanes], qd: Sequence[Lanes], qdd: Sequence[Lanes] | None = None
) -> list[Lanes]:
    """
    Return tau plus the torques that the joints themselves take.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    tau, qd : sequence of Lanes
        Torques [N m or N] and velocities [rad/s or m/s]: one row over lanes, or n numbers.
    qdd : sequence of Lanes, optional
        Accelerations [rad/s^2 or m/s^2]; without them rotors are left out.

    """
    return _combined(operator.add, plant, tau, qd, qdd)


def minus_joint_torques(plant: Plant, tau: Sequence[Lanes], qd: Sequence[Lanes]) -> list[Lanes]:
    """Return tau minus the torques that the joints take at velocities qd, rotors left out."""
    return _combined(operator.sub, plant, tau, qd, None)


def without_joint_torques(plant: Plant) -> Plant:
    """Return a plant whose joints take no torque but their rotors': H qdd = tau at rest."""
    off: dict[str, Any] = dict.fromkeys(AT_REST)
    return replace(plant, **off)


def _combined(
    combine: Callable[[Lanes, Lanes], Lanes],
    plant: Plant,
    tau: Sequence[Lanes],
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes] | None,
) -> list[Lanes]:
    result = list(tau)
    for terms in _terms(plant, qd, qdd):
        result = [combine(total, term) for total, term in zip(result, terms, strict=True)]
    return result


def _terms(
    plant: Plant, qd: Sequence[Lanes], qdd: Sequence[Lanes] | None
) -> Iterator[Iterator[Lanes]]:
    """Yield the torques of each effect, in the order of `qd`; each is recorded when it is read."""

    def constants(values: NDArray[np.float64]) -> Iterator[Lanes]:
        return (qd[0].recorder.constant(row) for row in values.reshape(len(qd), -1))

    if plant.damping is not None:
        yield map(operator.mul, constants(plant.damping), qd)
    if plant.stiffness is not None and plant.rest_position is not None:
        yield map(operator.mul, constants(plant.stiffness), _stretch(plant.rest_position, qd))
    if plant.armature is not None and qdd is not None:
        yield map(operator.mul, constants(plant.armature), qdd)


def _stretch(rest: NDArray[np.float64], qd: Sequence[Lanes]) -> Iterator[Lanes]:
    """Yield q - rest in the order of `qd`."""
    recorder = qd[0].recorder
    one_row = len(qd) == 1 and recorder.lanes > 1
    q = [input_row(recorder, 'q')] if one_row else input_list(recorder, 'q', len(qd))
    for position, row in zip(q, rest.reshape(len(qd), -1), strict=True):
        yield position - recorder.constant(row) if row.any() else position
