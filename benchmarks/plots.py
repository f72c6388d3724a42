# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plots as files, their colours and their axes.

Colours by Okabe and Ito, which colour-blind readers can distinguish; markers differ as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

BLACK, ORANGE, SKY, GREEN = '#000000', '#E69F00', '#56B4E9', '#009E73'
BLUE, VERMILLION, PURPLE, GREY = '#0072B2', '#D55E00', '#CC79A7', '#7F7F7F'
# Of this library by number format, and of other libraries: the same on all pages.
FLOAT64, FLOAT32 = BLUE, VERMILLION
PINOCCHIO, MUJOCO, CASADI, OTHER = BLACK, GREY, PURPLE, '#8C510A'
# Colour and marker of our kernels by number format and steps of refinement.
KERNELS = {
    ('float64', 0): (SKY, 'o'),
    ('float64', 1): (BLUE, 'o'),
    ('float32', 0): (ORANGE, '^'),
    ('float32', 1): (VERMILLION, '^'),
}


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


def over_joints(axes: Any, ticks: list[int]) -> None:
    """Label the logarithmic axis of the number of joints."""
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_xlabel('joints n')
    axes.grid(which='both', alpha=0.25)


def mark(colour: str, marker: str, label: str, **style: Any) -> Any:
    """Return an entry of a legend; `style` as of a line of Matplotlib."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, marker=marker, linestyle='', label=label, **style)
