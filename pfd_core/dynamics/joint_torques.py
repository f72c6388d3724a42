# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Torques of the effects of the joints: damping, springs, cogging, rotor inertia.

    tau = tau of links, gravity and wrench
          + viscosity qd + torque(q, qd) [+ inertia qdd]        summed over the effects

The effects are the records of pfd_core.model.effects that act on the joints. Every algorithm adds
these torques by the functions below, on n lanes (one row for all joints) and on one processor (a
list with one number per joint). Motors are in pfd_core.dynamics.drives.

In forward dynamics qdd is unknown: each method adds the inertia of the joints to the diagonal of H
or to the pivot of its joint.

Parallel cost: 1 multiplication and 1 addition for viscosity, inertia and springs each; 1 addition
more for springs whose rest positions are not zero; 2 multiplications, 2 additions and 1 sine for
cogging.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import operator
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.effects import EFFECTS, FIELDS, Effect
from pfd_core.model.plant import Plant


def plus_joint_torques(
    plant: Plant,
    tau: Sequence[Lanes],
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes] | None = None,
    combine: Callable[[Lanes, Lanes], Lanes] = operator.add,
) -> list[Lanes]:
    """
    Return tau [N m or N] plus the torques of the effects.

    Each argument is one row over lanes or n numbers. Without accelerations inertia is ignored.
    """
    result = list(tau)
    for terms in _terms(plant, qd, qdd):
        result = [combine(total, term) for total, term in zip(result, terms, strict=True)]
    return result


def minus_joint_torques(plant: Plant, tau: Sequence[Lanes], qd: Sequence[Lanes]) -> list[Lanes]:
    """Return tau minus the torques of the effects at velocities qd, without inertia."""
    return plus_joint_torques(plant, tau, qd, combine=operator.sub)


def record_joint_torques(plant: Plant) -> Program:
    """Return the program of the torques of the effects, tau, (n,), from q and qd."""
    recorder = Recorder(1, 'sequential')
    qd = recorder.input_list('qd', plant.robot.n)
    tau = plus_joint_torques(plant, [recorder.constant(0.0)] * len(qd), qd)
    return recorder.program(tau=tau)


def stored_energies(plant: Plant, q: Sequence[Lanes]) -> Iterator[Lanes]:
    """Yield the potential energy [J] of each joint and effect, from n numbers q on one lane."""
    for effect in EFFECTS:
        if effect.field in plant.effects and effect.potential is not None:
            for x, c in zip(q, _constants(effect, plant, q), strict=True):
                yield effect.potential(c, x)


def _terms(
    plant: Plant, qd: Sequence[Lanes], qdd: Sequence[Lanes] | None
) -> Iterator[Iterator[Lanes]]:
    """Yield the torques of each effect, in the order of `qd`; each is recorded when it is read."""
    recorder = qd[0].recorder
    numbers, joints = Numbers(recorder, plant), _joints(plant, qd)
    if plant.viscosity is not None:
        yield map(operator.mul, (numbers('viscosity', row) for row in joints), qd)
    for effect in EFFECTS:
        if effect.field in plant.effects and effect.torque is not None:
            row = len(qd) == 1 and recorder.lanes > 1
            q = [recorder.input_row('q')] if row else recorder.input_list('q', len(qd))
            yield map(effect.torque, _constants(effect, plant, qd), q, qd)
    if plant.inertia is not None and qdd is not None:
        yield map(operator.mul, (numbers('inertia', row) for row in joints), qdd)


def _joints(plant: Plant, like: Sequence[Lanes]) -> NDArray[np.int64]:
    """Return the joints of each entry of `like`: one row over lanes, or n numbers."""
    return np.arange(plant.robot.n).reshape(len(like), -1)


def _constants(effect: Effect, plant: Plant, like: Sequence[Lanes]) -> Iterator[Any]:
    """Yield the numbers of an effect by field, for each entry of `like`."""
    numbers = Numbers(like[0].recorder, plant)
    for joints in _joints(plant, like):
        c: dict[str, Any] = {}
        for key in effect.fields:
            given, columns = plant.effects.get(key), range(len(FIELDS[key].columns))
            if given is None or (key != effect.field and not given[joints].any()):
                c[key] = None
            elif columns:
                c[key] = tuple(numbers(key, joints, column) for column in columns)
            else:
                c[key] = numbers(key, joints)
        yield SimpleNamespace(**c)
