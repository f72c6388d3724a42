# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Impacts at joint stops: velocities jump, positions stay.

    compression   v0: H v0 = H qd + p, p the impulses of the stops, 0 <= p where v0 = 0
    restitution   v = v0 + alpha H^-1 E p,  E = diag(restitution)
    alpha         min(1, sqrt(p' H^-1 p / (E p)' H^-1 E p))
    again         where a joint still moves into its stop: compression of v, E = 0

Compression is the problem of pfd_core.simulation.contact.modes with the joints at stops as
candidates; a locked joint that moves comes to rest; dry friction, whose torque is bounded, has no
impulse. After it v0' p = 0, so that the
kinetic energy falls by p' H^-1 p / 2 and rises again by alpha^2 (E p)' H^-1 E p / 2: bounded by
alpha, an impact never adds energy, whatever the coefficients (Poisson's law alone does). Locked
joints take no part: H^-1 is that of the others.

The steps are programs, between which the native code evaluates H x and H^-1 x.

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

import math

import numpy as np

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.machine.lanes import absolute, sqrt, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model import Plant
from pfd_core.simulation.contact.modes import (
    any_of,
    at_stops,
    both,
    either,
    into_stops,
    sign_of,
)


def record_hits(plant: Plant) -> Program:
    """Return the program of `hits`, (1,): whether any joint moves into its stop, or is locked."""
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, unlocked = (input_list(recorder, name, n) for name in ('q', 'qd', 'unlocked'))
    into = into_stops(plant, q, qd)
    stops = [where(unlocked[i], into[i], sign_of(absolute(qd[i]))) for i in range(n)]
    return program_with_outputs(recorder, hits=[any_of(stops)])


def record_compression(plant: Plant) -> Program:
    """
    Return the program of the beginning of a compression.

    Inputs are q, unlocked and, (1,), hits. Outputs are those of `record_modes` of
    pfd_core.simulation.contact.modes.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, unlocked = (input_list(recorder, name, n) for name in ('q', 'unlocked'))
    (hits,) = input_list(recorder, 'hits', 1)
    zeros = [recorder.constant(0.0)] * n
    at_lower, at_upper = at_stops(plant, q)
    candidate = [both(unlocked[i], either(at_lower[i], at_upper[i])) for i in range(n)]
    return program_with_outputs(
        recorder,
        direction=zeros,
        moving=[where(candidate[i], 0.0, unlocked[i]) for i in range(n)],
        candidate=candidate,
        lower=[where(at_upper[i], -math.inf, 0.0) for i in range(n)],
        upper=[where(at_lower[i], math.inf, 0.0) for i in range(n)],
        last=zeros,
        barred=zeros,
        busy=[hits],
    )


def record_impulses(plant: Plant) -> Program:
    """
    Return the program of `thrown`, E p, and `impulse`, p, (n,), after a compression.

    Inputs are torque = H v0, load = H qd, candidate and moving.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    torque, load, candidate, moving = (
        input_list(recorder, name, n) for name in ('torque', 'load', 'candidate', 'moving')
    )
    p = [where(candidate[i], where(moving[i], 0.0, torque[i] - load[i]), 0.0) for i in range(n)]
    e = _restitution(plant)
    return program_with_outputs(recorder, impulse=p, thrown=[p[i] * float(e[i]) for i in range(n)])


def record_restitution(plant: Plant) -> Program:
    """
    Return the program of the velocities after a restitution.

    Inputs are q, qd, x = v0, impulse, thrown, returned = H^-1 E p, unlocked and, (1,), hits.
    Outputs are qd, as it was without a hit, and hits, (1,): whether a joint still moves into its
    stop.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    names = ('q', 'qd', 'x', 'impulse', 'thrown', 'returned', 'unlocked')
    q, qd, v0, p, thrown, returned, unlocked = (input_list(recorder, m, n) for m in names)
    (hits,) = input_list(recorder, 'hits', 1)
    lost = sum((p[i] * (v0[i] - qd[i]) for i in range(1, n)), p[0] * (v0[0] - qd[0]))
    gained = sum((thrown[i] * returned[i] for i in range(1, n)), thrown[0] * returned[0])
    # With a joint that comes to rest by a lock `lost` may be negative: that of the stops alone.
    alpha = where(lost, where(gained - lost, sqrt(lost / gained), 1.0), 0.0)
    after = [where(hits, v0[i] + alpha * returned[i], qd[i]) for i in range(n)]
    still = [both(unlocked[i], flag) for i, flag in enumerate(into_stops(plant, q, after))]
    return program_with_outputs(recorder, qd=after, hits=[any_of(still)])


def record_inelastic(n: int) -> Program:
    """Return the program of qd after an impact without restitution: x with hits, else qd."""
    recorder = Recorder(1, 'sequential')
    x, qd = (input_list(recorder, name, n) for name in ('x', 'qd'))
    (hits,) = input_list(recorder, 'hits', 1)
    return program_with_outputs(recorder, qd=[where(hits, x[i], qd[i]) for i in range(n)])


def _restitution(plant: Plant) -> np.ndarray:
    return np.zeros(plant.robot.n) if plant.restitution is None else plant.restitution
