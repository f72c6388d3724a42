# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plot of time against error of the quantities other than forward dynamics, a panel for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pfd_core.report.against_error_plots import BLACK, BLUE, ORANGE, PURPLE, SKY, VERMILLION, save
from pfd_core.report.quantity_tables import contender, least
from pfd_core.report.speed_tables import batch_name
from pfd_core.report.timing import Row

# Beginning of a contender's name: colour and marker; the first that fits is taken.
STYLES = {
    'pfd float64 refined': (BLUE, 'o'),
    'pfd float64': (SKY, 'o'),
    'pfd float32 refined': (VERMILLION, '^'),
    'pfd float32': (ORANGE, '^'),
    'pinocchio': (BLACK, 's'),
    'CasADi': (PURPLE, '*'),
}
COLUMNS = 4
# Smaller errors are drawn here.
LEAST = 1e-17


def write(rows: Sequence[Row], folder: Path, name: str) -> list[Path]:
    """Write the plot as PNG and SVG and return their paths; none without rows or matplotlib."""
    try:
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
    except ImportError:
        return []
    panels = list(dict.fromkeys((row.robot, row.quantity) for row in rows))
    if not panels:
        return []
    batch, columns = batch_name(rows), min(COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(1 + 3.3 * columns, 1.8 + 2.4 * lines), layout='constrained')
    grid = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    flat = [axes for line in grid for axes in line]
    for axes, (robot, quantity) in zip(flat, panels, strict=False):
        own = [row for row in rows if (row.robot, row.quantity) == (robot, quantity)]
        axes.set_title(f'{robot}: {quantity}', fontsize=10)
        axes.set(xscale='log', yscale='log')
        axes.minorticks_off()
        axes.grid(alpha=0.25)
        for way in dict.fromkeys(contender(row) for row in own):
            row = least(own, way, batch)
            if row is not None and row.error is not None:
                colour, marker = STYLES[_style(way)]
                axes.plot(
                    max(row.error, LEAST), row.minimum * 1e9, marker, color=colour, markersize=8
                )
    for axes in flat[len(panels) :]:
        axes.axis('off')
    for axes in grid[-1]:
        axes.set_xlabel('largest error / largest entry')
    figure.supylabel(f'time of a state, {batch} [ns]')
    figure.suptitle('Time against error, one thread. Down and left is better.')
    seen = {_style(contender(row)) for row in rows if row.error is not None}
    entries = [
        Line2D([], [], color=colour, marker=marker, linestyle='', label=label)
        for label, (colour, marker) in STYLES.items()
        if label in seen
    ]
    figure.legend(handles=entries, loc='outside lower center', ncols=6, frameon=False)
    return save(figure, folder, name)


def _style(way: str) -> str:
    return next(style for style in STYLES if way.startswith(style))
