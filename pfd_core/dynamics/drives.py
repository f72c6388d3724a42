# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The drives: torques of the motors under commanded torques tau.

    t = tau + g(q)                      gravity compensation, of the model in the scene
    t in [-L_0, L(|qd|)] along qd       torque-speed table L, falling from L_0 at rest
    t in [-E, E]                        effort limits E

Both limits are one table: L is cut off at E. A driving torque is limited by L at the speed, a
braking torque by L_0 only, because back-EMF then adds to the voltage. At rest both limits are
equal, so that the torque is continuous.

Every algorithm converts the input tau into torques of motors here, before anything else, on n
lanes (one row for all joints) and on one processor (a list with one number per joint). Inverse
dynamics subtracts g and ignores the limits: `commanded_torques`.

Parallel cost: 1 addition for compensation, and the gravity torques; 2 additions for effort
limits; 3 additions for a table and 1 multiplication and 2 additions for each row after the first.
Selections are not counted. Dry friction acts behind the motors, over a step:
pfd_core.simulation.dry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from pfd_core.dynamics.energy import gravity_torques
from pfd_core.machine.lanes import absolute, merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.plant import Plant, has_drives
from pfd_core.model.values import Array

# Gravity torques of a model at the input q, in the order of tau.
Gravity = Callable[[Plant], Sequence[Lanes]]


def record_motor_torques(plant: Plant) -> Program:
    """
    Return the program of the motor torques tau, (n,), from q, qd and the commanded tau.

    A step with dry friction, which acts on the joint side of the motors, subtracts its torques
    from these and passes the difference to the plant without effects of its motors.
    """
    recorder = Recorder(1, 'sequential')
    qd, tau = (recorder.input_list(name, plant.robot.n) for name in ('qd', 'tau'))
    return recorder.program(tau=motor_torques(plant, tau, qd))


def motor_torques(
    plant: Plant, tau: Sequence[Lanes], qd: Sequence[Lanes], gravity: Gravity | None = None
) -> list[Lanes]:
    """
    Return the torques of the motors.

    Commanded torques [N m or N] and velocities [rad/s or m/s] are one row over lanes, or n
    numbers. `gravity` gives the gravity torques of a model on lanes; by default on one processor.
    """
    if not has_drives(plant):
        return list(tau)
    with tau[0].recorder.section('drives'):
        model = plant.gravity_compensation
        if model is not None:
            tau = [t + g for t, g in zip(tau, _compensated(model, tau, gravity), strict=True)]
        tables = _tables(plant)
        joints = np.arange(plant.robot.n).reshape(len(tau), -1)
        return [
            _limited(t, rate, [tables[i] for i in row])
            for t, rate, row in zip(tau, qd, joints, strict=True)
        ]


def commanded_torques(
    plant: Plant, tau: Sequence[Lanes], gravity: Gravity | None = None
) -> list[Lanes]:
    """Return the commanded torques under which motors without limits give the torques tau."""
    model = plant.gravity_compensation
    if model is None:
        return list(tau)
    with tau[0].recorder.section('drives'):
        return [t - g for t, g in zip(tau, _compensated(model, tau, gravity), strict=True)]


def _compensated(model: Plant, tau: Sequence[Lanes], gravity: Gravity | None) -> Sequence[Lanes]:
    return gravity_torques(tau[0].recorder, model) if gravity is None else gravity(model)


def _tables(plant: Plant) -> list[Array]:
    """Return for each joint its bounds, rows (speed, torque), (k, 2); no rows without bounds."""
    n, none = plant.robot.n, np.zeros((0, 2))
    efforts = np.full(n, np.inf) if plant.effort_limits is None else plant.effort_limits
    given = [none] * n if plant.torque_speed is None else plant.torque_speed
    found = []
    for rows, most in zip(given, efforts, strict=True):
        own = rows[np.isfinite(rows[:, 0])]
        table = cut_off(own, float(most)) if len(own) else np.array([[0.0, most]])
        found.append(table if np.isfinite(table).all() else none)
    return found


def cut_off(rows: Array, most: float) -> Array:
    """Return rows (speed, torque), (k, 2), of a falling table bounded by a largest torque."""
    speed, torque = rows.T
    if torque[0] <= most:
        return rows
    below = np.flatnonzero(torque < most)
    if not len(below):
        return np.array([[speed[0], most]])
    k = below[0]
    share = (torque[k - 1] - most) / (torque[k - 1] - torque[k])
    corner = [speed[k - 1] + share * (speed[k] - speed[k - 1]), most]
    # By rounding the corner may fall on the row after it.
    return np.array([corner, *rows[k:]]) if corner[0] < speed[k] else rows[k:]


def _limited(tau: Lanes, qd: Lanes, tables: Sequence[Array]) -> Lanes:
    """Return torques within the tables of the joints on each lane."""
    constant = [i for i, table in enumerate(tables) if len(table) == 1]
    falling = [i for i, table in enumerate(tables) if len(table) > 1]
    limited = tau
    if constant:
        most = _on_lanes(tables, constant)[0, 1]
        top = tau.recorder.constant(most)
        limited = merge(_clamped(on(tau, constant), most, top), limited)
    if falling:
        at = (on(tau, falling), on(qd, falling))
        limited = merge(_within(*at, _on_lanes(tables, falling)), limited)
    return limited


def _on_lanes(tables: Sequence[Array], lanes: Sequence[int]) -> Array:
    """Return the tables of some lanes, (k, 2, lanes), with rows appended that change nothing."""
    longest = max(len(tables[i]) for i in lanes)
    result = np.zeros((longest, 2, len(tables)))
    for i in lanes:
        table = tables[i]
        more = range(1, longest - len(table) + 1)
        result[:, :, i] = np.vstack([table, *(table[-1] + [k, 0.0] for k in more)])
    return result


def _clamped(t: Lanes, lower: Array, upper: Lanes) -> Lanes:
    """Return t within [-lower, upper]."""
    bottom = t.recorder.constant(-lower)
    t = where(t - upper, upper, t)
    result: Lanes = where(bottom - t, bottom, t)
    return result


def _within(t: Lanes, qd: Lanes, rows: Array) -> Lanes:
    """Return torques t within falling tables, (k, 2, lanes)."""
    constant = t.recorder.constant
    rate = absolute(qd)
    bound = constant(rows[0, 1])
    for (x, y), (following, lower) in pairwise(rows):
        # Lanes without a table have zeros.
        slope = (lower - y) / np.where(following > x, following - x, 1.0)
        beyond = rate - constant(x)
        bound = where(beyond, constant(y) + constant(slope) * beyond, bound)
    bound = where(rate - constant(rows[-1, 0]), constant(rows[-1, 1]), bound)
    along = _clamped(where(qd, t, -t), rows[0, 1], bound)
    result: Lanes = where(qd, along, -along)
    return result
