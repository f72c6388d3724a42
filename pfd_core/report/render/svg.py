# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Elements of pictures in SVG: plain text, without fonts or dates of the machine.

The same picture has the same bytes everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

LINE = '#444444'
_HEAD = '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7"'
_ARROW_HEAD = f'{_HEAD} orient="auto"><path d="M0 0L8 4L0 8z" fill="{LINE}"/></marker>'


def document(width: float, height: float, title: str, body: Iterable[str]) -> str:
    """Return a picture of a size [pixels] with a title for screen readers."""
    head = f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {head} font-family="sans-serif" font-size="11">',
        f'<title>{escape(title)}</title>',
        f'<defs>{_ARROW_HEAD}</defs>',
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
        *body,
        '</svg>',
    ]
    return '\n'.join(lines) + '\n'


def text(
    x: float, y: float, words: str, size: float = 11, anchor: str = 'start', colour: str = 'black'
) -> str:
    """Return words at a place; `anchor` is 'start', 'middle' or 'end'."""
    style = f'font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"'
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(words)}</text>'


def arrow(x: float, y: float, to_x: float, to_y: float, colour: str = LINE) -> str:
    """Return an arrow between two places."""
    ends = f'x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}"'
    return f'<line {ends} stroke="{colour}" marker-end="url(#head)"/>'


def box(x: float, y: float, width: float, height: float, fill: str = 'none') -> str:
    """Return a rectangle by its upper left corner."""
    size = f'width="{width:g}" height="{height:g}"'
    return f'<rect x="{x:g}" y="{y:g}" {size} fill="{fill}" stroke="{LINE}" rx="3"/>'


def circle(x: float, y: float, radius: float) -> str:
    """Return a circle by its centre."""
    return f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="none" stroke="{LINE}"/>'
