# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plots as files, their colours and their axes.

Colours by Okabe and Ito, which colour-blind readers can distinguish; markers differ as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.run import show_progress

BLACK, ORANGE, SKY, GREEN = '#000000', '#E69F00', '#56B4E9', '#009E73'
BLUE, VERMILLION, PURPLE, GREY = '#0072B2', '#D55E00', '#CC79A7', '#7F7F7F'
# Of this library by number format, and of other libraries: the same on all pages.
FLOAT64, FLOAT32 = BLUE, VERMILLION
PINOCCHIO, MUJOCO, CASADI = BLACK, GREY, PURPLE


def panels(
    content: Sequence[tuple[dict[str, Any], Sequence[tuple[Any, dict[str, Any]]]]],
    path: Path,
    size: tuple[float, float],
    columns: int,
) -> list[Path]:
    """
    Draw panels side by side on logarithmic axes as a PNG; return its path, [] without matplotlib.

    A panel is what `axes.set` takes, and its lines: points (x, y), and a style as of a line of
    Matplotlib. One legend in so many columns lies below. The bytes depend on the figure alone.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        show_progress(f'{path} is not drawn: pip install matplotlib')
        return []
    figure = Figure(figsize=size, layout='constrained')
    found = figure.subplots(1, len(content), squeeze=False)[0]
    for axes, (settings, lines) in zip(found, content, strict=True):
        axes.set(xscale='log', yscale='log')
        axes.minorticks_off()
        axes.grid(alpha=0.25)
        axes.set(**settings)
        for points, style in lines:
            axes.plot([x for x, _ in points], [y for _, y in points], **style)
    # One entry for the lines of equal label in several panels.
    entries = {
        label: handle
        for axes in found
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    place: dict[str, Any] = {'loc': 'outside lower center', 'fontsize': 9, 'frameon': False}
    figure.legend(entries.values(), entries, ncols=columns, columnspacing=1.2, **place)
    figure.savefig(path, dpi=110)
    return [path]
