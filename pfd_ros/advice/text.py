# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Advice as lines of text."""

from __future__ import annotations

from collections.abc import Iterator
import math

from pfd_ros.advice.scene import Advice, Row

# A joint that is a whole turn off [rad], or so many metres, has lost the motion.
DIVERGED = 2 * math.pi


def lines(advice: Advice) -> Iterator[str]:
    """Yield the table of effects, and what the smallest scene found keeps and leaves out."""
    full, small = advice.operations
    yield f'{"without":20} {"error":>9}  {"operations":>10}  kept  largest error at'
    yield from map(_line, advice.rows)
    yield f'{"full scene":20} {"0":>9}  {full:10}'
    yield f'{"smallest found":20} {_error(advice.error):>9}  {small:10}'
    yield ''
    kept, dropped = (
        ', '.join(row.name for row in advice.rows if row.kept is kept) or 'nothing'
        for kept in (True, False)
    )
    floors = ', '.join(f'{cause} {_error(error)}' for cause, error in advice.floors.items())
    yield f'keeps: {kept}'
    yield f'leaves out: {dropped}'
    yield from warnings(advice)
    yield f'errors [rad or m] that every scene has: {floors or "unknown"}'
    if advice.departure:
        yield f'the full scene departs from the motion by {_error(advice.departure)} in a window'


def warnings(advice: Advice) -> list[str]:
    """Return what to know about effects that are left out although the motion shows nothing."""
    if not advice.unseen:
        return []
    return [
        f'not tested: {", ".join(advice.unseen)}; the motion is the same without. '
        'Test with a motion that needs them, or keep them'
    ]


def _line(row: Row) -> str:
    where = f'{row.joint}, {row.time:.3f} s' if row.joint else ''
    end = '; '.join(filter(None, (where, row.note)))
    kept = 'yes' if row.kept else 'no'
    return f'{row.name:20} {_error(row.error):>9}  {row.operations:+10}  {kept:4}  {end}'.rstrip()


def _error(value: float) -> str:
    if not math.isfinite(value):
        return 'overflows'
    return 'diverges' if value > DIVERGED else f'{value:.1e}' if value else '0'
