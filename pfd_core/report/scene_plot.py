# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plot of the error of every scene against its operations, with the best of each cost."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path
from typing import Any

from pfd_core.report.scene_errors import SceneRow
from pfd_core.report.scene_needs import Needs
from pfd_core.report.scene_search import pareto_front


def plot(needs: Needs, paths: Sequence[Path]) -> bool:
    """Draw the plot into files, their format by suffix; False without matplotlib."""
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(9, 6), layout='constrained')
    FigureCanvasAgg(figure)
    _draw(figure.subplots(), needs)
    for path in paths:
        # Without a date, and with names of elements that do not change from run to run.
        svg = path.suffix == '.svg'
        with rc_context({'svg.hashsalt': 'pfd'}):
            figure.savefig(path, dpi=110, metadata={'Date': None} if svg else None)
    return True


def _draw(axes: Any, needs: Needs) -> None:
    drawn = [row for row in needs.scenes if math.isfinite(row.largest)]
    errors = [row.largest for row in drawn if row.largest > 0] + [needs.tolerance]
    # A logarithmic axis has no zero: errors of zero stand at the bottom.
    zero = 10.0 ** (math.floor(math.log10(min(errors))) - 1)

    def at(rows: Sequence[SceneRow]) -> tuple[list[int], list[float]]:
        return [row.operations for row in rows], [max(row.largest, zero) for row in rows]

    axes.plot(*at(drawn), 'o', color='0.7', label='a scene')
    axes.step(*at(pareto_front(drawn)), '-', color='C0', where='post', label='best of its cost')
    singles = [row.without for row in needs.effects if math.isfinite(row.without.largest)]
    axes.plot(*at(singles), 'o', color='C1', label='full scene without one effect')
    axes.plot(*at([needs.smallest]), '*', color='C3', ms=18, label='smallest within tolerance')
    axes.plot(*at([needs.full]), 's', color='black', ms=4, label='full scene')
    axes.axhline(needs.tolerance, color='C3', lw=0.8, ls='--', label='tolerance')
    named = [(f'no {row.name}', row.without) for row in needs.effects]
    for text, row in [*named, ('no effect at all', needs.bare)]:
        if math.isfinite(row.largest):
            (x,), (y,) = at([row])
            axes.annotate(text, (x, y), (6, 4), textcoords='offset points', size=8)
    axes.axhline(zero, color='0.8', lw=0.8)
    left_end = ('axes fraction', 'data')
    axes.annotate('error 0', (0, zero), (3, 3), left_end, 'offset points', size=8)
    axes.set_yscale('log')
    axes.margins(x=0.15)  # for the names beside the points
    axes.set_xlabel('operations of one step of the integrator, as compiled, without events')
    axes.set_ylabel(
        f'largest difference of a joint position from\nthe full scene within {needs.window:g} s '
        '[rad or m]'
    )
    axes.set_title(
        f'{needs.robot}, {needs.trajectory}: error of a scene against its cost\n'
        '(both sides with one integrator and step, whose own error is left out)',
        fontsize=10,
    )
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
