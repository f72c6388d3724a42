# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plots as files, their colours and their axes.

Colours by Okabe and Ito, which colour-blind readers can distinguish; markers differ as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

BLACK, ORANGE, SKY, GREEN = '#000000', '#E69F00', '#56B4E9', '#009E73'
BLUE, VERMILLION, PURPLE, GREY = '#0072B2', '#D55E00', '#CC79A7', '#7F7F7F'
# Of this library by number format, and of other libraries: the same on all pages.
FLOAT64, FLOAT32 = BLUE, VERMILLION
PINOCCHIO, MUJOCO, CASADI = BLACK, GREY, PURPLE


def save(
    draw: Callable[[Any], None],
    folder: Path,
    name: str,
    size: tuple[float, float],
    kinds: Iterable[str] = ('png', 'svg'),
) -> list[Path]:
    """
    Draw into a figure, write it in each format and return the paths; none without matplotlib.

    The bytes depend on the figure alone.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError:
        return []
    figure = Figure(figsize=size, layout='constrained')
    draw(figure)
    paths = [folder / f'{name}.{kind}' for kind in kinds]
    # A salt and no date: the same numbers give the same file.
    with rc_context({'svg.hashsalt': name, 'svg.fonttype': 'none'}):
        # The layout takes as long as the drawing: once for all formats.
        figure.draw_without_rendering()
        figure.set_layout_engine('none')
        for path in paths:
            figure.savefig(path, dpi=110, metadata={'Date': None} if path.suffix == '.svg' else {})
    return paths


def logarithmic(axes: Any) -> None:
    """Make both axes logarithmic, with a faint grid."""
    axes.set(xscale='log', yscale='log')
    axes.minorticks_off()
    axes.grid(alpha=0.25)


def panels(
    content: Sequence[tuple[dict[str, Any], Sequence[tuple[Any, dict[str, Any]]]]],
    figure: Any,
    *,
    columns: int,
) -> Any:
    """
    Draw panels of lines side by side on logarithmic axes, with one legend below; return the axes.

    A panel is what `axes.set` takes, and its lines: points (x, y), and a style as of a line of
    Matplotlib.
    """
    found = figure.subplots(1, len(content), squeeze=False)[0]
    for axes, (settings, lines) in zip(found, content, strict=True):
        logarithmic(axes)
        axes.set(**settings)
        for points, style in lines:
            axes.plot([x for x, _ in points], [y for _, y in points], **style)
    handles, labels = found[0].get_legend_handles_labels()
    place = {'loc': 'outside lower center', 'fontsize': 9, 'frameon': False}
    figure.legend(handles, labels, ncols=columns, columnspacing=1.2, **place)
    return found


def over_joints(axes: Any, ticks: list[int]) -> None:
    """Label the logarithmic axis of the number of joints."""
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_xlabel('joints n')
    axes.grid(which='both', alpha=0.25)


# ---- elements of pictures in SVG: plain text, the same bytes everywhere ----

LINE = '#444444'


def svg(width: float, height: float, title: str, body: Iterable[str]) -> str:
    """Return a picture of a size [pixels] with a title for screen readers."""
    size = f'width="{width:g}" height="{height:g}"'
    head = f'<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" fill="{LINE}" orient="auto"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {width:g} {height:g}"',
        f' font-family="sans-serif"><title>{escape(title)}</title>',
        f'<defs>{head} markerWidth="7" markerHeight="7"><path d="M0 0L8 4L0 8z"/></marker></defs>',
        f'<rect {size} fill="white"/>',
        *body,
        '</svg>',
    ]
    return '\n'.join(lines) + '\n'


def words(
    x: float, y: float, text: object, size: float = 11, anchor: str = 'start', colour: str = BLACK
) -> str:
    """Return text at a place; `anchor` is 'start', 'middle' or 'end'."""
    style = f'font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"'
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(str(text))}</text>'


def arrow(x: float, y: float, to_x: float, to_y: float, colour: str = LINE) -> str:
    """Return an arrow between two places."""
    ends = f'x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}"'
    return f'<line {ends} stroke="{colour}" marker-end="url(#head)"/>'


def box(
    x: float, y: float, width: float, height: float, fill: str = 'none', colour: str = LINE
) -> str:
    """Return a rectangle by its centre."""
    place = f'x="{x - width / 2:g}" y="{y - height / 2:g}" width="{width:g}" height="{height:g}"'
    return f'<rect {place} fill="{fill}" stroke="{colour}" rx="2"/>'


def circle(x: float, y: float, radius: float, fill: str = 'none', colour: str = LINE) -> str:
    """Return a circle by its centre."""
    return f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}" stroke="{colour}"/>'
