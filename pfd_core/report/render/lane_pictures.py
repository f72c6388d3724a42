# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pictures of work on lanes, in SVG: sums that move between lanes, and sets that processors add up.

Colours are for colour-blind readers; text in a box says the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pfd_core.report.render.svg import arrow, box, document, text

MARGIN = 20
LANE, LEVEL, HEIGHT = 96, 84, 26
DONE, DOING, IDLE = '#cfe6f5', '#ffffff', '#eeeeee'
TERM, ROW, FRAME = 62, 26, 350
PER_ROW = 2
WORKERS = ('#f6d9b8', '#cfe6f5', '#cdeee2', '#f0d4e4')


@dataclass(frozen=True)
class LaneBox:
    """Content of a lane, whether it is a final result, and the lane from which a part came."""

    words: str
    final: bool
    source: int | None


def levels_svg(title: str, levels: Sequence[tuple[str, Sequence[LaneBox]]]) -> str:
    """Return rows of lanes, one below the other, each with a heading and arrows to it."""
    lanes = len(levels[0][1])
    body = [text(MARGIN, MARGIN + 4, title, 14)]
    body += [
        text(_middle(lane), MARGIN + 32, f'lane {lane + 1}', 11, 'middle') for lane in range(lanes)
    ]
    for k, (heading, boxes) in enumerate(levels):
        y = MARGIN + 44 + k * LEVEL
        body.append(text(MARGIN + lanes * LANE + 16, y + HEIGHT / 2 + 4, heading))
        for lane, one in enumerate(boxes):
            x = _middle(lane) - LANE / 2 + 8
            body.append(box(x, y, LANE - 16, HEIGHT, DONE if one.final else DOING))
            body.append(text(_middle(lane), y + HEIGHT / 2 + 4, one.words, anchor='middle'))
            if k:
                above = y - LEVEL + HEIGHT
                body.append(arrow(_middle(lane), above, _middle(lane), y, '#bbbbbb'))
                if one.source is not None:
                    body.append(arrow(_middle(one.source) + 12, above, _middle(lane) - 12, y))
    width = MARGIN + lanes * LANE + 260
    return document(width, MARGIN + 44 + len(levels) * LEVEL, title, body)


def _middle(lane: int) -> float:
    return MARGIN + (lane + 0.5) * LANE


@dataclass(frozen=True)
class SetRow:
    """
    A set on a row.

    Attributes
    ----------
    name : str
        Its name.
    terms : tuple of str
        Its terms; a worker adds the last two.
    worker : int or None
        Index of the processor that does; None if none does.

    """

    name: str
    terms: tuple[str, ...]
    worker: int | None


def sets_svg(title: str, frames: Sequence[tuple[str, Sequence[SetRow]]]) -> str:
    """Return frames of sets side by side, each with a heading."""
    deepest = max(len(rows) for _, rows in frames)
    height = (deepest + 1) * ROW + 30
    body = [text(MARGIN, MARGIN + 4, title, 14)]
    for k, (heading, rows) in enumerate(frames):
        x, y = MARGIN + k % PER_ROW * FRAME, MARGIN + 20 + k // PER_ROW * height
        body.append(f'<g transform="translate({x} {y})">')
        body.append(text(0, 14, heading, 12))
        for line, row in enumerate(rows):
            body += _set(row, 24 + line * ROW)
        body.append('</g>')
    width = 2 * MARGIN + PER_ROW * FRAME
    rows_of_frames = -(-len(frames) // PER_ROW)
    return document(width, MARGIN + 20 + rows_of_frames * height, title, body)


def _set(row: SetRow, y: float) -> Iterator[str]:
    alone = len(row.terms) == 1
    yield text(0, y + 15, row.name)
    for k, term in enumerate(row.terms):
        x = 34 + k * TERM
        added = row.worker is not None and k >= len(row.terms) - 2
        fill = WORKERS[(row.worker or 0) % len(WORKERS)] if added else (IDLE if alone else DOING)
        yield box(x, y, TERM - 4, ROW - 6, fill)
        yield text(x + TERM / 2 - 2, y + 14, term, 10, 'middle')
    if row.worker is not None:
        x = 34 + len(row.terms) * TERM
        yield text(x + 4, y + 14, f'P{row.worker + 1} adds', 10)
