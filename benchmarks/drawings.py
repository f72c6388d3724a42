# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Drawings as SVG files: boxes, circles, texts and arrows. The bytes depend on what is drawn alone.

Lengths are in pixels from the upper left corner.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import escape

INK, FAINT, PAPER = '#222222', '#888888', '#ffffff'
HEAD = (
    '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" fill="{0}" orient="auto" '
    'markerWidth="6" markerHeight="6"><path d="M0 0L8 4L0 8z"/></marker></defs>'
)


class Drawing:
    """A drawing of a width and height, with a title that screen readers read."""

    def __init__(self, width: float, height: float, title: str) -> None:
        self.lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
            f'viewBox="0 0 {width:g} {height:g}" font-family="sans-serif">'
            f'<title>{escape(title)}</title>',
            HEAD.format(FAINT),
            f'<rect width="{width:g}" height="{height:g}" fill="{PAPER}"/>',
        ]

    def box(
        self, x: float, y: float, width: float, height: float, fill: str, edge: str = 'none'
    ) -> None:
        """Draw a rectangle."""
        self.lines.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill="{fill}" '
            f'stroke="{edge}"/>'
        )

    def boxes(
        self, corners: Iterable[tuple[float, float, float]], height: float, fill: str
    ) -> None:
        """Draw rectangles of one height and colour, each by its corner (x, y) and width."""
        path = ''.join(f'M{x:g} {y:g}h{wide:g}v{height:g}h{-wide:g}z' for x, y, wide in corners)
        self.lines.append(f'<path d="{path}" fill="{fill}"/>')

    def circle(self, x: float, y: float, radius: float, fill: str, edge: str = 'none') -> None:
        """Draw a circle around a point."""
        self.lines.append(
            f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}" stroke="{edge}"/>'
        )

    def text(
        self,
        x: float,
        y: float,
        text: object,
        size: float = 12,
        anchor: str = 'middle',
        fill: str = INK,
        bold: bool = False,
    ) -> None:
        """Write a line of text, whose baseline is at y."""
        weight = ' font-weight="bold"' if bold else ''
        self.lines.append(
            f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" text-anchor="{anchor}" '
            f'fill="{fill}"{weight}>{escape(str(text))}</text>'
        )

    def arrow(self, x: float, y: float, to_x: float, to_y: float, color: str = FAINT) -> None:
        """Draw an arrow from one point to another."""
        self.lines.append(
            f'<line x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}" stroke="{color}" '
            'marker-end="url(#head)"/>'
        )

    def save(self, folder: Path, name: str) -> Path:
        """Write the drawing and return its path."""
        path = folder / name
        path.write_text('\n'.join([*self.lines, '</svg>']) + '\n', encoding='utf-8')
        return path
