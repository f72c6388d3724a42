# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plot of the step counts over n, measured and as claimed by the paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pfd_core.report.counts import KINDS, Row


def plot(rows: Sequence[Row], path: Path) -> bool:
    """Draw multiplications and additions over n, formulas dashed; False without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(12, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    for axes, kind in zip(figure.subplots(1, 2), KINDS[:2], strict=True):
        for k, system in enumerate(dict.fromkeys(row.system for row in rows)):
            own = [row for row in rows if row.system == system]
            n = [row.n for row in own]
            color = f'C{k}' if k < 10 else 'black'
            axes.loglog(
                n,
                [row.cells[kind].measured for row in own],
                color=color,
                marker='.',
                label=own[0].title + (', n trips' if own[0].trips else ''),
            )
            if own[0].cells[kind].claimed is not None:
                axes.loglog(
                    n,
                    [row.cells[kind].claimed for row in own],
                    color=color,
                    linestyle='--',
                    lw=0.8,
                )
        ticks = [2**k for k in range(1, 7)]
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.minorticks_off()
        axes.set_xlabel('joints n')
        axes.set_title(f'{kind} without routes: measured, and formula of Table 1 (dashed)')
        axes.grid(which='both', alpha=0.25)
    figure.axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    return True
