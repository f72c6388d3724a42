# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The search for the first event of a segment, on the step map itself.

A segment of length R with a margin below zero has an event in it. The search repeats the segment
with other lengths r, so that an event has the accuracy of the integrator. One look follows a
segment of length r; L < R is the bracket, with all margins at or above zero at L.

    narrow   the bracket, and Newton's step: the least one of the margins that are below zero at R,
             from their slopes at r. If it is a part below `short` of the segment, the search
             ends: a Taylor step reaches it
    aim      the next r: the first root of the cubic Hermite interpolants in the bracket, in which
             roots at the beginning are no events; of the chord for a margin without slope

After COUNT looks the bracket is halved instead, and the search ends where it is used up.

Where torques may jump, a release may have no root, and a chord tells nothing of a wide bracket.
The search then ends in one of the width `short`, or, if the margin is not small there, in one used
up.

A margin below zero whose slope rises has its root further back: it fires only with a falling
slope, and the search does not end while there is one.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.recorder import Lanes
from pfd_core.simulation.dry import Law, rests
from pfd_core.simulation.flags import (
    Inputs,
    Outputs,
    Row,
    any_of,
    both,
    either,
    largest,
    negated,
    sign_of,
    smallest,
)

# No event within any segment.
FAR = 1e30
# Looks after which the bracket is halved; iterations of Newton's method on a cubic.
COUNT, NEWTON = 8.0, 6
# Roundings of a margin, and of the length of a segment, that are nothing.
ROUNDINGS, LENGTHS = 8.0, 4.0
# Part of its first size above which the margin of a release jumps in a bracket of width `short`.
LEAP = 2.0**-8
# Most looks: 52 halvings use a bracket up.
LOOKS = 70

Quotient = tuple[Lanes, Lanes]


def bracket(at: Inputs) -> Outputs:
    """Return the bracket before the first look, the whole segment, from margins at its ends."""
    (r,) = at.single('r')
    scale = [absolute(a) + absolute(b) for a, b in zip(at.g_L, at.g_R, strict=True)]
    return {'L': 0.0, 'R': r, 'span': r, 'count': 1.0, 'delta': 0.0, 'worn': 0.0, 'scale': scale}


def narrow(law: Law, at: Inputs) -> Outputs:
    """
    Return the bracket after a look, and of the end of the search.

    Inputs are the margins g, slopes d and noise at r, the same at L and R; scale, sizes of
    margins; span, the length of the segment; and count, the number of looks. Outputs are the
    bracket, `worn` if it is used up, `seek`, and at the end delta, the length of the Taylor step,
    and `fired`, the margins that are zero there.
    """
    g, d, gL, dL, gR, dR = at.g, at.d, at.g_L, at.d_L, at.g_R, at.d_R
    L, R, r, h = at.single('L', 'R', 'r', 'span')
    seek, count, delta = at.single('seek', 'count', 'delta')
    chords = _chords(law, at)
    hit = sign_of(-smallest(g))
    right, left = both(seek, hit), both(seek, negated(hit))
    R, L = where(right, r, R), where(left, r, L)
    gR, dR = _taken(right, g, gR), _taken(right, d, dR)
    gL, dL = _taken(left, g, gL), _taken(left, d, dL)
    w = R - L
    rough = [e + z * (ROUNDINGS * law.eps) for e, z in zip(at.noise, at.scale, strict=True)]

    # Newton's steps as quotients; a release takes the chord of the bracket.
    steps = [
        (where(chord, where(hit, b, a) * w, x), where(chord, a - b, -slope))
        for chord, a, b, x, slope in zip(chords, gL, gR, g, d, strict=True)
    ]
    falls = [both(sign_of(-b), sign_of(low)) for b, (_, low) in zip(gR, steps, strict=True)]
    way = _least(falls, steps)
    turned = any_of(
        [both(sign_of(-(x + e)), negated(on)) for x, e, on in zip(g, rough, falls, strict=True)]
    )
    short = both(negated(absolute(way) - h * law.short), negated(turned))
    if law.jumps:
        wide = sign_of(w - h * law.short)
        leaps = [
            both(both(chord, on), either(wide, sign_of(largest([a, -b]) - z * LEAP)))
            for chord, on, a, b, z in zip(chords, falls, gL, gR, at.scale, strict=True)
        ]
        short = both(short, negated(any_of(leaps)))
    worn = negated(w - h * (LENGTHS * law.eps))
    done = both(seek, either(short, both(worn, hit)))
    fires = [
        where(short, both(on, negated((top - way * low) - where(chord, e * w, e))), sign_of(-b))
        for chord, on, (top, low), e, b in zip(chords, falls, steps, rough, gR, strict=True)
    ]
    back = where(r + way, way, -r)

    margins = {'g.L': gL, 'd.L': dL, 'g.R': gR, 'd.R': dR, 'fired': _taken(done, fires, at.fired)}
    return margins | {
        'L': L,
        'R': R,
        'worn': worn,
        'seek': both(seek, negated(done)),
        'count': count + seek,
        'delta': where(done, where(short, back, 0.0), delta),
    }


def aim(law: Law, at: Inputs) -> Outputs:
    """Return the next r, from the bracket."""
    L, R, r, seek, count, worn = at.single('L', 'R', 'r', 'seek', 'count', 'worn')
    zero, one = at.recorder.constant(0.0), at.recorder.constant(1.0)
    w = R - L
    # The margin below zero at R whose chord has the first root; a margin that is zero at the
    # beginning of the segment has the root of its slope there, or a quarter.
    outside, margins = negated(L), (at.g_L, at.g_R, at.d_L, at.d_R)
    best = [one * 2.0, one, one, one, zero, zero, zero]
    for chord, a, b, da, db in zip(_chords(law, at), *margins, strict=True):
        begin = where(absolute(a), a, where(outside, da * w, a))
        usual = both(sign_of(begin), sign_of(-b))
        top, low = where(usual, begin, 0.25), where(usual, begin - b, 1.0)
        nearer = where(-b, best[0] * low - top * best[1], 0.0)
        row = [top, low, a, b, da, db, chord]
        best = [where(nearer, x, y) for x, y in zip(row, best, strict=True)]
    top, low, a, b, da, db, chord = best
    cubic = [a, da * w, 3.0 * (b - a) - w * (2.0 * da + db), 2.0 * (a - b) + w * (da + db)]
    for _ in range(2):
        flat = both(outside, negated(absolute(cubic[0])))
        cubic = [where(flat, x, y) for x, y in zip([*cubic[1:], zero], cubic, strict=True)]
    cubic = [where(chord, x, y) for x, y in zip([a, b - a, zero, zero], cubic, strict=True)]
    new, middle = L + w * _root(cubic, top / low), L + 0.5 * w
    new = where(new - L, where(R - new, new, middle), middle)
    new = where(worn, R, where(count - COUNT, middle, new))
    return {'r': where(seek, new, r)}


def _chords(law: Law, at: Inputs) -> Row:
    """Return for each margin whether it has no slope, that of a release."""
    zero = at.recorder.constant(0.0)
    return [
        zero if margin.stops else rests(at.unbraked[margin.joint], at.moving[margin.joint])
        for margin in law.margins
    ]


def _taken(flag: Lanes, new: Row, old: Row) -> Row:
    return [where(flag, a, b) for a, b in zip(new, old, strict=True)]


def _least(flags: Sequence[Lanes], quotients: Sequence[Quotient]) -> Lanes:
    """Return the least of the flagged quotients, whose denominators are positive."""
    one = flags[0].recorder.constant(1.0)
    top, low = one * FAR, one
    for flag, (a, b) in zip(flags, quotients, strict=True):
        nearer = where(flag, top * b - a * low, 0.0)
        top, low = where(nearer, a, top), where(nearer, b, low)
    result: Lanes = top / low
    return result


def _root(c: Row, t: Lanes) -> Lanes:
    """Return a root in [0, 1] of a cubic, above zero before it, from a start t."""
    lo, hi = (t.recorder.constant(x) for x in (0.0, 1.0))
    for _ in range(NEWTON):
        f = c[0] + t * (c[1] + t * (c[2] + t * c[3]))
        slope = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3]))
        lo, hi = where(f, t, lo), where(f, hi, t)
        new, middle = t - f / slope, 0.5 * (lo + hi)
        t = where(new - lo, where(hi - new, new, middle), middle)
    return t
