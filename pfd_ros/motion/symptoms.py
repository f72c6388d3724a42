# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of the motion of a joint: measures, and one line.

All take samples of one joint, once a control period. With the error e = q - target:

    oscillation    the turning points of a signal, each reversal above a share REVERSAL of the
                   largest: frequency (turns - 1) / (2 (t_last - t_first)), amplitude of the last
                   period, and growth, the slope of log amplitude over time by least squares
    divergence     the slope of log |qd| over time by least squares, if the joint moves away from
                   its target, e qd > 0, in a share MOSTLY of the samples
    driven away    a share MOSTLY of e tau, summed while the joint moves away from its target, is
                   positive, and it ends farther from there than it began, or than a share FOLLOWS
                   of the range of its reference
    offset         the mean of e over the last share TAIL, if e changes there by less than a share
                   STEADY of it, and would at its mean speed there in the time of the whole motion

VERDICTS has what is said of them, in order. Growth and divergence are measured before the first
sample at the torque limit, if there are enough, and decay over the whole motion; the second half
must have the larger or the smaller span, too. A turning point is right to half a control period,
and so are the times between two of them. Efforts are cut to their limits, so commanded efforts and
measured ones give one diagnosis.

Noise turns, too, but only an oscillation repeats itself: its changes over half a period are
opposite half a period later, and alike after a whole one, by their correlation. If the small turns
do not repeat themselves, only those above a share NOISY of the largest count.

A joint that follows a moving reference turns as often as the reference. It oscillates if its error
turns HARMONICS times as often, at a share STEADY of the speed of the reference. A joint that runs
away from its target faster than its velocity oscillates runs away. If no target is known, turns
below REFERENCE_RATE may be those of a reference, and are no oscillation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np

from pfd_ros.motion.metrics import Array

# Least reversal of a turn, as a share of the largest in the motion; the second for noisy motions.
REVERSAL, NOISY = 0.05, 0.5
# Least rise from a minimum to a later maximum of that correlation: 2 for a sine, 1/2 for noise.
REPEATS = 1.0
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
# Friction, which changes its sign with the velocity, gives an error of up to the third harmonic.
HARMONICS = 3
# A joint farther from its reference than this share of its range does not follow it.
FOLLOWS = 0.4
# Of a torque.
AWAY = ', which drives it away from the target (wrong sign?)'


class Oscillation(NamedTuple):
    """Frequency [Hz], amplitude at the end in the unit of the signal, and its growth [1/s]."""

    frequency: float
    amplitude: float
    growth: float


def turns(values: Array, share: float = REVERSAL) -> list[int]:
    """Return the samples at which a signal turns, in the order of time."""
    # A motion may be at the torque limit from its first sample on.
    span = float(np.ptp(values)) if len(values) else 0.0
    least = share * span
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
    tried = (turns(values, share) for share in (REVERSAL, NOISY))
    found = next((x for x in tried if len(x) >= FEWEST_TURNS and _repeats(values, x)), None)
    if found is None:
        return None
    at, heights = time[found], values[found]
    halves = np.abs(np.diff(heights)) / 2
    frequency = (len(found) - 1) / (2 * (at[-1] - at[0]))
    middle = (at[:-1] + at[1:]) / 2
    growth = float(np.polyfit(middle - middle[0], np.log(halves), 1)[0])
    return Oscillation(float(frequency), float(halves[-2:].mean()), growth)


def _repeats(values: Array, at: list[int]) -> bool:
    """Return whether changes over half a period are opposite half a period later, then alike.

    Of noise they are uncorrelated but for the one sample that two of them share: -1/2, and then 0.
    """
    half = max(1, round((at[-1] - at[0]) / (len(at) - 1)))
    change = values[half:] - values[:-half]
    lags = range(1, min(5 * half // 2 + 2, len(change)), 1 + half // 16)
    norms = [np.linalg.norm(change[k:]) * np.linalg.norm(change[:-k]) for k in lags]
    alike = [change[k:] @ change[:-k] / norm for k, norm in zip(lags, norms, strict=True) if norm]
    return bool((alike - np.minimum.accumulate(alike) > REPEATS).any())


def divergence(time: Array, error: Array, qd: Array) -> float | None:
    """Return the rate at which a joint leaves its target, 1/s; None if it does not."""
    moving = np.flatnonzero(qd)
    if len(moving) < FEWEST_SAMPLES or np.mean(error[moving] * qd[moving] > 0.0) < MOSTLY:
        return None
    growth = float(np.polyfit(time[moving] - time[0], np.log(np.abs(qd[moving])), 1)[0])
    return growth if growth > 0.0 else None


def offset(time: Array, error: Array) -> float | None:
    """Return the mean error at the end of a motion, None if it changes there."""
    tail = slice(-max(2, math.ceil(TAIL * len(error))), None)
    mean = float(error[tail].mean())
    drift = abs(float(np.polyfit(time[tail] - time[0], error[tail], 1)[0]) * (time[-1] - time[0]))
    return mean if max(np.ptp(error[tail]), drift) < STEADY * abs(mean) else None


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples (N,) of one joint, with efforts within their limits, and what it should do.

    The target is a number, a reference (N,), or None. `limits` has the lower and upper bounds of
    position, velocity and effort, and `units` their units. `period` is the time between two
    commands [s], NaN if it is not known.
    """

    time: Array
    q: Array
    qd: Array
    tau: Array
    target: float | Array | None
    limits: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    period: float

    @cached_property
    def reference(self) -> Array:
        """Target of each sample, zeros without one."""
        return np.broadcast_to(0.0 if self.target is None else self.target, self.q.shape)

    @cached_property
    def moves(self) -> bool:
        """Whether the target is a reference that moves."""
        return float(np.ptp(self.reference)) > 0.0

    @cached_property
    def error(self) -> Array:
        """Distance from the target; zeros without one."""
        return np.zeros(len(self.q)) if self.target is None else self.q - self.reference

    @cached_property
    def speed(self) -> Array:
        """Velocity of the reference."""
        still = np.zeros(len(self.q))
        return np.gradient(self.reference, self.time) if self.moves else still

    @cached_property
    def far(self) -> bool:
        """Whether it ends farther from its target than it began, or does not follow it."""
        begin = FOLLOWS * np.ptp(self.reference) if self.moves else abs(self.error[0])
        return bool(abs(self.error[-1]) > begin)

    @cached_property
    def full(self) -> Array:
        """Whether the effort is at a limit."""
        lower, upper = self.limits['effort']
        return (self.tau <= lower) | (self.tau >= upper)

    @cached_property
    def free(self) -> slice:
        """Samples before the first effort at a limit: a saturated motion has lost its rates."""
        return slice(int(np.argmax(self.full)) if self.full.any() else len(self.full))

    @cached_property
    def waves(self) -> Oscillation | None:
        """The oscillation about the target or the reference."""
        found = oscillation(self.time, self.qd - self.speed)
        if found is None or (self.target is None and found.frequency < REFERENCE_RATE):
            return None
        if self.moves:
            at = self.time[turns(self.speed)]
            turned = (len(at) - 1) / (2 * float(at[-1] - at[0])) if len(at) > 1 else 0.0
            least = STEADY * np.abs(self.speed).max()
            if found.frequency <= HARMONICS * turned or found.amplitude <= least:
                return None
        late = self.time > self.time[-1] - 1.0 / found.frequency
        drift = float((self.qd - self.speed)[late].mean())
        leaves = self.far and abs(drift) > found.amplitude and drift * self.error[-1] > 0.0
        return None if leaves else found

    @cached_property
    def early(self) -> Oscillation | None:
        """The oscillation before the first effort at a limit."""
        return oscillation(self.time[self.free], (self.qd - self.speed)[self.free])

    @property
    def change(self) -> str:
        """How the amplitude of the oscillation changes, before the first effort at a limit."""
        assert self.waves is not None
        # What decays before it and then reaches a limit has not decayed.
        early = self.early if self.early and self.early.growth > 0.0 else None
        growth, last = (early or self.waves).growth, self.free.stop if early else len(self.time)
        seconds = float(self.time[last - 1] - self.time[0])
        # Ripples on a large oscillation have a slope of their own.
        spans = [np.ptp(x) for x in np.array_split((self.qd - self.speed)[:last], 2)]
        if abs(growth) * seconds <= LEVEL or (spans[1] > spans[0]) != (growth > 0.0):
            return 'steady'
        return f'{"growing" if growth > 0 else "decaying"} by {abs(growth):.3g} /s'

    @property
    def hits(self) -> Iterator[tuple[int, str, float, float]]:
        """The first sample at or beyond each limit: its number, item, value and limit."""
        for item, values in (('position', self.q), ('velocity', self.qd), ('effort', self.tau)):
            low, high = self.limits[item]
            # NaN is beyond none.
            for k in np.flatnonzero((values <= low) | (values >= high))[:1].tolist():
                yield k, item, float(values[k]), low if values[k] <= low else high

    def said(self, item: str, value: float) -> str:
        """Return a position, velocity or effort with its unit."""
        return f'{value:.4g} {self.units[item]}'

    @property
    def off(self) -> str:
        """How far the joint is from its target at the end."""
        name, off = 'reference' if self.moves else 'target', abs(float(self.error[-1]))
        target = self.said('position', self.reference[-1])
        return f'{self.said("position", off)} from its {name} {target}'

    @property
    def kind(self) -> str:
        """What its efforts are."""
        return 'force' if self.units['effort'] == 'N' else 'torque'

    @property
    def torque(self) -> str:
        """The effort at the end, '' if it is not known."""
        last = self.said('effort', self.tau[-1])
        return f', with a {self.kind} of {last}' if np.isfinite(self.tau[-1]) else ''


def _end_stop(x: Samples) -> str:
    lower, upper = x.limits['position']
    side = int(x.q[-1] >= upper) - int(x.q[-1] <= lower)
    if not side:
        return ''
    at, bound = (x.said('position', y) for y in (x.q[-1], lower if side < 0 else upper))
    text = f'is at {"" if at == bound else f"{at}, beyond "}its position limit {bound}'
    against = x.tau[-1] * side > 0.0
    if x.target is None:
        return f'{text}{x.torque}{", against it" if against else ""}'
    return f'{text}, {x.off}{x.torque}{AWAY if against and x.error[-1] * side > 0.0 else ""}'


def _driven_away(x: Samples) -> str:
    push = np.nan_to_num(x.error * x.tau)[x.error * (x.qd - x.speed) > 0.0]
    if np.count_nonzero(push) < FEWEST_SAMPLES or not x.far:
        return ''
    if push[push > 0.0].sum() < MOSTLY * np.abs(push).sum():
        return ''
    return f'is {x.off}; its {x.kind} drives it away from the target (wrong sign?)'


def _offset(x: Samples) -> str:
    rests = None if x.target is None or x.moves else offset(x.time, x.error)
    if rests is None or (x.waves and x.waves.amplitude >= STEADY * np.abs(x.qd).max()):
        return ''
    return f'rests at {x.said("position", x.q[-1])}, {x.off}{x.torque}'


def _divergence(x: Samples) -> str:
    if x.target is None or x.moves or x.early:
        return ''
    found = divergence(x.time[x.free], x.error[x.free], x.qd[x.free])
    return f'is {x.off} and moves away from it, growing by {found:.3g} /s' if found else ''


def _oscillation(x: Samples) -> str:
    if x.waves is None:
        return ''
    share = f' ({x.waves.frequency * x.period:.2g} of the control rate)' if x.period > 0 else ''
    amplitude = f'velocity amplitude {x.said("velocity", x.waves.amplitude)}'
    return f'oscillates at {x.waves.frequency:.4g} Hz{share}, {amplitude}, {x.change}'


def _decaying(x: Samples) -> str:
    return _oscillation(x) if x.waves and 'decaying' in x.change else ''


def _tracking(x: Samples) -> str:
    worst, most = int(np.argmax(np.abs(x.error))), FOLLOWS * float(np.ptp(x.reference))
    far, at = abs(float(x.error[worst])), f'farthest at t = {x.time[worst]:.6g} s'
    follows = x.moves and far <= most
    return f'follows its reference within {x.said("position", far)}, {at}' if follows else ''


def _lost(x: Samples) -> str:
    worst, whole = int(np.argmax(np.abs(x.error))), float(np.ptp(x.reference))
    if not x.moves:
        return ''
    far = x.said('position', abs(float(x.error[worst])))
    return (
        f'does not follow its reference: {far} off at t = {x.time[worst]:.6g} s, while the '
        f'reference moves by {x.said("position", whole)}'
    )


def _motion(x: Samples) -> str:
    if x.target is None:
        return ''
    if not x.error[-1] * x.qd[-1]:
        return f'is {x.off}, with a velocity of {x.said("velocity", x.qd[-1])}'
    way = 'away from' if x.error[-1] * x.qd[-1] > 0.0 else 'to'
    return f'is {x.off} and moves {way} it at {x.said("velocity", abs(x.qd[-1]))}'


def _torque_limit(x: Samples) -> str:
    share = 100 * float(np.mean(x.full))
    limit = x.said('effort', max(x.limits['effort']))
    return f'at the torque limit {limit} for {share:.3g} % of the time' if share else ''


def _first_limit(x: Samples) -> str:
    hits = [
        (k, f'first {item} {x.said(item, value)} at or beyond its limit {x.said(item, bound)}')
        for k, item, value, bound in x.hits
    ]
    return f'{min(hits)[1]} at t = {x.time[min(hits)[0]]:.6g} s' if hits else ''


# Kind -> its text, '' if a joint does not show it; a diagnosis has the first of VERDICTS, and all
# of LIMITS.
VERDICTS: Mapping[str, Callable[[Samples], str]] = {
    'end stop': _end_stop,
    'driven away': _driven_away,
    'offset': _offset,
    'divergence': _divergence,
    'decaying oscillation': _decaying,
    'oscillation': _oscillation,
    'tracking': _tracking,
    'lost': _lost,
    'motion': _motion,
}
LIMITS: Mapping[str, Callable[[Samples], str]] = {
    'torque limit': _torque_limit,
    'first limit': _first_limit,
}
UNCOMMANDED = 'never commanded'
KINDS = (UNCOMMANDED, *VERDICTS, *LIMITS)
# Symptoms that make a page warn and a test fail.
FAULTS = (UNCOMMANDED, 'driven away', 'divergence', 'oscillation', 'lost')


def text_of(found: Mapping[str, str], *, limited: bool = True) -> str:
    """Return a diagnosis on one line, for a joint with known limits or without."""
    return '; '.join(found.values()) or 'no oscillation' + ', no limit reached' * limited


@np.errstate(all='ignore')  # a log may hold infinite numbers
def diagnosis(x: Samples, *, commanded: bool = True) -> dict[str, str]:
    """Return the symptoms of a joint, each of KINDS with its measures.

    Efforts may be beyond their limits, or NaN where they are not known; where no velocity is known
    it is that of the positions. A joint is braked until it is `commanded`.
    """
    if not commanded:
        return {UNCOMMANDED: f'{UNCOMMANDED}: braked'}
    derived = np.isnan(x.qd).all() and len(x.qd) > 1
    qd = np.gradient(x.q, x.time) if derived else x.qd
    x = replace(x, qd=qd, tau=np.clip(x.tau, *x.limits['effort']))
    first = next(((kind, text) for kind, of in VERDICTS.items() if (text := of(x))), None)
    more = ((kind, text) for kind, of in LIMITS.items() if (text := of(x)))
    return dict((*([first] if first else []), *more))
