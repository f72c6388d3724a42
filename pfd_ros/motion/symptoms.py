# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of the motion of a joint: measures, and one line.

All take samples of one joint, once a control period. With the error e = q - target:

    oscillation    the turning points of a signal, each reversal above a share REVERSAL of the
                   largest: frequency (turns - 1) / (2 (t_last - t_first)), amplitude of the last
                   period, and growth, the slope of log amplitude over time by least squares
    divergence     the slope of log |qd| over time by least squares, if the joint moves away from
                   its target, e qd > 0, in a share MOSTLY of the samples
    offset         the mean of e over the last share TAIL, if e changes there by less than a share
                   STEADY of it

Growth and divergence are measured before the first sample at the torque limit, if there are
enough. A turning point is right to half a control period, and so are the times between two of
them. Efforts are cut to their limits, so commanded efforts and measured ones give one diagnosis.

A joint that follows a moving reference turns as often as the reference. It oscillates if its error
turns more than twice as often, at a share STEADY of the speed of the reference. If no target is
known, turns below REFERENCE_RATE may be those of a reference, and are no oscillation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from pfd_ros.motion.metrics import Array, first_beyond

# Least reversal of a turn, as a share of the largest in the motion: noise is smaller.
REVERSAL = 0.05
# A signal whose samples differ by a smaller share of the largest one is constant.
CONSTANT = 1e-9
# Fewest turns of an oscillation: two periods. A step has two.
FEWEST_TURNS = 5
# Of a divergence: its fewest samples, and the share of them that move away.
FEWEST_SAMPLES = 5
MOSTLY = 0.9
# Share of the samples at the end of a motion, and most change of a steady error there.
TAIL = 0.1
STEADY = 0.1
# An amplitude is steady if its logarithm changes by less than this.
LEVEL = 1.0
# Arms are seldom asked to turn more often than this [Hz].
REFERENCE_RATE = 5.0


# Kinds of symptoms, in the order of a diagnosis.
KINDS = (
    *('never commanded', 'offset', 'divergence', 'oscillation', 'decaying oscillation'),
    *('tracking', 'motion', 'torque limit', 'first limit'),
)


class Oscillation(NamedTuple):
    """Frequency [Hz], amplitude at the end in the unit of the signal, and its growth [1/s]."""

    frequency: float
    amplitude: float
    growth: float


def turns(values: Array) -> list[int]:
    """Return the samples at which a signal turns, in the order of time."""
    # A motion may be at the torque limit from its first sample on.
    span = float(np.ptp(values)) if len(values) else 0.0
    least = REVERSAL * span
    found: list[int] = []
    if not span > CONSTANT * float(np.abs(values).max(initial=0.0)):
        return found
    low = high = 0
    rising = 0
    for k, value in enumerate(values.tolist()):
        high = k if value > values[high] else high
        low = k if value < values[low] else low
        if rising >= 0 and values[high] - value > least:
            found.append(high)
            rising, low = -1, k
        elif rising <= 0 and value - values[low] > least:
            found.append(low)
            rising, high = 1, k
    # A motion begins at its first sample, and does not turn there.
    return found[found[:1] == [0] :]


def oscillation(time: Array, values: Array) -> Oscillation | None:
    """Return the oscillation of a signal, None without two periods of it."""
    found = turns(values)
    if len(found) < FEWEST_TURNS:
        return None
    at, heights = time[found], values[found]
    halves = np.abs(np.diff(heights)) / 2
    frequency = (len(found) - 1) / (2 * (at[-1] - at[0]))
    middle = (at[:-1] + at[1:]) / 2
    growth = float(np.polyfit(middle - middle[0], np.log(halves), 1)[0])
    return Oscillation(float(frequency), float(halves[-2:].mean()), growth)


def divergence(time: Array, error: Array, qd: Array) -> float | None:
    """Return the rate at which a joint leaves its target, 1/s; None if it does not."""
    moving = np.flatnonzero(qd)
    if len(moving) < FEWEST_SAMPLES or np.mean(error[moving] * qd[moving] > 0.0) < MOSTLY:
        return None
    growth = float(np.polyfit(time[moving] - time[0], np.log(np.abs(qd[moving])), 1)[0])
    return growth if growth > 0.0 else None


def offset(error: Array) -> float | None:
    """Return the mean error at the end of a motion, None if it changes there."""
    tail = error[-max(2, math.ceil(TAIL * len(error))) :]
    mean = float(tail.mean())
    return mean if np.ptp(tail) < STEADY * abs(mean) else None


def text_of(found: Mapping[str, str], *, limited: bool = True) -> str:
    """Return a diagnosis on one line, for a joint with known limits or without."""
    return '; '.join(found.values()) or 'no oscillation' + ', no limit reached' * limited


def diagnosis(
    time: Array,
    q: Array,
    qd: Array,
    tau: Array,
    *,
    target: float | Array | None,
    limits: Sequence[tuple[str, Array, float, float]],
    period: float,
    commanded: bool = True,
) -> dict[str, str]:
    """Return the symptoms of one joint by its samples (N,), each of KINDS with its measures.

    The target is a position, a reference (N,), or None. `limits` has of each limit its name, the
    samples that it bounds, and the bounds; `period` is the control period [s]. A joint is braked
    until it is `commanded`.
    """
    if not commanded:
        return {'never commanded': 'never commanded: braked'}
    lower, upper = next(bounds[2:] for bounds in limits if bounds[0] == 'effort')
    tau = np.clip(tau, lower, upper)
    first_full = first_beyond(tau, lower, upper)
    # A saturated motion has lost the rates of the loop.
    free = slice(first_full)
    reference = np.broadcast_to(0.0 if target is None else target, q.shape)
    moves = float(np.ptp(reference)) > 0.0
    speed: Array = np.gradient(reference, time) if moves else np.zeros(len(qd))
    error = None if target is None else q - reference
    waves, early = oscillation(time, qd - speed), oscillation(time[free], (qd - speed)[free])
    if waves is not None and target is None and waves.frequency < REFERENCE_RATE:
        waves = None
    elif waves is not None and moves:
        turned = len(turns(speed)) / (2 * float(time[-1] - time[0]))
        if waves.frequency <= 2 * turned or waves.amplitude <= STEADY * np.abs(speed).max():
            waves = None
    rests = None if moves or error is None else offset(error)
    leaves = None if moves or error is None else divergence(time[free], error[free], qd[free])
    found: dict[str, str] = {}
    if rests is not None and (waves is None or waves.amplitude < STEADY * np.abs(qd).max()):
        side = 'above' if rests > 0 else 'below'
        text = f'rests {abs(rests):.4g} {side} its target with a torque of {tau[-1]:.4g}'
        found['offset'] = text
    elif leaves is not None and early is None:
        found['divergence'] = f'moves away from its target, growing by {leaves:.3g} /s'
    elif waves is not None:
        growth, seconds = waves.growth, float(time[-1] - time[0])
        if early is not None and first_full is not None:
            growth, seconds = early.growth, float(time[first_full] - time[0])
        text = _wave_text(waves, 1.0 / period, growth, seconds)
        found['decaying oscillation' if 'decaying' in text else 'oscillation'] = text
    elif error is not None and moves:
        worst = int(np.argmax(np.abs(error)))
        far = f'{abs(error[worst]):.4g}, farthest at t = {time[worst]:.6g} s'
        found['tracking'] = f'follows its reference within {far}'
    elif error is not None:
        way = 'away from' if error[-1] * qd[-1] > 0.0 else 'to'
        found['motion'] = f'still moves {way} its target at {abs(qd[-1]):.3g} /s'
    share = float(np.mean(np.abs(tau) >= upper))
    if share:
        text = f'at the torque limit {upper:.4g} for {100 * share:.3g} % of the time'
        found['torque limit'] = text
    hits = [
        (k, f'{kind} {values[k]:.4g} at or beyond its limit {bound:.4g} at t = {time[k]:.6g} s')
        for kind, given, low, high in limits
        for values in [tau if kind == 'effort' else given]
        if (k := first_beyond(values, low, high)) is not None
        for bound in [low if values[k] <= low else high]
    ]
    if hits:
        found['first limit'] = f'first {min(hits)[1]}'
    return found


def _wave_text(waves: Oscillation, rate: float, growth: float, seconds: float) -> str:
    change = 'steady'
    if abs(growth) * seconds > LEVEL:
        change = f'{"growing" if growth > 0 else "decaying"} by {abs(growth):.3g} /s'
    return (
        f'oscillates at {waves.frequency:.4g} Hz ({waves.frequency / rate:.2g} of the control '
        f'rate), velocity amplitude {waves.amplitude:.3g}, {change}'
    )
