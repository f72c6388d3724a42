# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Torques of the joints themselves, beside the torques of the links: friction and rotors.

    tau = tau of links, gravity and wrench + damping qd [+ armature qdd]

Every text takes these torques from here, on n lanes (one row for all joints) and on one
processor (a list with one number per joint). A further effect of a joint, such as Coulomb
friction, is a field of Scene and Plant (pfd_core.model), a term of `_terms` and, since it
depends on qd, is set to None in `without_joint_torques`. A sign is written with lanes.where.

In forward dynamics qdd is unknown, so that each method adds the rotors' inertia to the diagonal
of H or to the pivot of its joint.

Parallel cost: 1 multiplication and 1 addition for each effect that is on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
import operator

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.recorder import Lanes
from pfd_core.model import Plant


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
    return replace(plant, damping=None)


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
    if plant.armature is not None and qdd is not None:
        yield map(operator.mul, constants(plant.armature), qdd)
