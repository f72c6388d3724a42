# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of speed against error: a panel for each case, and work-precision of the integrators."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.measure.evaluations import NATIVE, PEERS, Point, TimedCase
from pfd_core.report.measure.work_precision import WAYS, MotionFacts, RunPoint
from pfd_core.report.render.plots import (
    BLACK,
    CASADI,
    FLOAT64,
    GREEN,
    GREY,
    KERNELS,
    MUJOCO,
    PINOCCHIO,
    SKY,
    logarithmic,
    mark,
    save,
)

PEER_STYLES = dict(
    zip(
        PEERS,
        (
            *((PINOCCHIO, 's'), (PINOCCHIO, 'D'), (GREEN, 'P'), (MUJOCO, 'v')),
            *((PINOCCHIO, 'x'), (GREEN, 'x'), (PINOCCHIO, '+'), (CASADI, '*')),
        ),
        strict=True,
    )
)
# One for each of work_precision.WAYS.
RUN_STYLES = dict(
    zip(
        WAYS,
        (
            (FLOAT64, 'o', '-'),
            (SKY, '^', '-'),
            (FLOAT64, 's', '--'),
            (FLOAT64, '*', ':'),
            (MUJOCO, '<', ':'),
            (MUJOCO, 'v', '-.'),
            (MUJOCO, '>', '--'),
            (MUJOCO, 'X', '-'),
            (CASADI, 'P', '-'),
            (PINOCCHIO, 'D', '-'),
        ),
        strict=True,
    )
)
# Drawn large and open: Pinocchio's RK4 has the same points.
BEHIND = {'MuJoCo RK4'}
COLUMNS = 4
# Of a figure [inch].
SIZE = (14, 7.6)
UNIT = ROUNDING['float64']
# Errors below this many kappa_s u are drawn here.
LEAST = 1e-2


def write(
    cases: Sequence[TimedCase],
    points: Sequence[Point],
    motions: Sequence[MotionFacts],
    runs: Sequence[RunPoint],
    folder: Path,
) -> list[Path]:
    """Write all plots as PNG and SVG and return their paths; none without matplotlib."""
    sizes = sorted({point.batch for point in points})
    written = []
    for size in sizes:
        name = 'speed-against-error' + ('-single' if size == 1 < sizes[-1] else '')
        own = [point for point in points if point.batch == size]
        written += save(partial(_draw_cases, cases, own, size), folder, name, SIZE)
    if runs:
        written += save(partial(_draw_motions, motions, runs), folder, 'work-precision', SIZE)
    return written


def _draw_cases(
    cases: Sequence[TimedCase], points: Sequence[Point], size: int, figure: Any
) -> None:
    points = _shown(points)
    rows = -(-(len(cases) + 1) // COLUMNS)
    panels = figure.subplots(rows, COLUMNS, squeeze=False, sharex=True, sharey=True)
    for axes, case in zip(panels.flat, cases, strict=False):
        _draw_case(axes, case, [point for point in points if point.case == case.name])
    for k, axes in enumerate(panels.flat):
        if k >= len(cases):
            axes.axis('off')
        elif k + COLUMNS >= len(cases):
            axes.tick_params(labelbottom=True)
    figure.supxlabel('relative error of the acceleration / ($\\kappa_s u$),  u = $2^{-53}$')
    figure.supylabel('time of one evaluation [ns]')
    states = 'one state in a call' if size == 1 else f'{size} states in a call'
    figure.suptitle(
        f'Forward dynamics: time against error, {states}, one thread. Down and left is better.'
    )
    _explain(panels.flat[len(cases)], points)


def _shown(points: Sequence[Point]) -> list[Point]:
    """Leave out loops in Python if the same functions are measured in C++."""
    native = any(point.way in NATIVE for point in points)
    return [point for point in points if not (native and point.loop == 'Python')]


def _draw_case(axes: Any, case: TimedCase, points: Sequence[Point]) -> None:
    """Draw the points of a case; a line leads from the default method to its refined answer."""
    axes.set_title(f'{case.name} (n = {case.n})', fontsize=10)
    logarithmic(axes)
    for dtype, u in ROUNDING.items():
        axes.axvline(u / UNIT, color=GREY, linewidth=0.8, linestyle=':')
        axes.text(
            u / UNIT, 0.99, f' {dtype}', transform=axes.get_xaxis_transform(), fontsize=7,
            color=GREY, va='top',
        )  # fmt: skip
    for point in points:
        place = _place(point)
        if place is None:
            continue
        if point.way in PEER_STYLES:
            colour, marker = PEER_STYLES[point.way]
            axes.plot(*place, marker, color=colour, markersize=8, zorder=3)
        else:
            colour, marker = KERNELS[point.dtype, point.refine]
            default = point.way == case.default(point.refine)
            axes.plot(
                *place, marker, color=colour, markersize=9 if default else 5,
                markeredgecolor=BLACK if default else colour, alpha=1 if default else 0.6,
                zorder=4 if default else 2,
            )  # fmt: skip
    for dtype in ROUNDING:
        own = [p for p in points if (p.way, p.dtype) == (case.default(p.refine), dtype)]
        ends = [place for place in map(_place, sorted(own, key=lambda p: p.refine)) if place]
        if len(ends) == len(own) == 2:
            axes.plot(*zip(*ends, strict=True), color=BLACK, linewidth=0.9, zorder=3)


def _place(point: Point) -> tuple[float, float] | None:
    """Return where a point is drawn: error over kappa_s and 2^-53, and nanoseconds."""
    if point.in_units is None:
        return None
    in_units = point.in_units * ROUNDING[point.dtype] / UNIT
    return max(in_units, LEAST), point.minimum * 1e9


def _explain(axes: Any, points: Sequence[Point]) -> None:
    seen = {point.way for point in points}
    entries = [
        mark(*style, f'pfd, {dtype}{", refined once" * refine}', markersize=7)
        for (dtype, refine), style in KERNELS.items()
    ]
    default = "pfd's default method: a line\nto its refined answer, if it differs"
    entries.append(mark('white', 'o', default, markersize=9, markeredgecolor=BLACK))
    entries += [mark(*PEER_STYLES[peer], peer, markersize=8) for peer in PEERS if peer in seen]
    axes.legend(handles=entries, loc='center', fontsize=10, frameon=False)


# Of the legend below the integrators.
LEGEND_COLUMNS = 5


def _draw_motions(motions: Sequence[MotionFacts], runs: Sequence[RunPoint], figure: Any) -> None:
    """Draw time (above) and evaluations (below) over both errors of each motion."""
    panels = figure.subplots(2, 2 * len(motions), squeeze=False, sharey='row')
    shown = [way for way in WAYS if any(run.way == way for run in runs)]
    for k, motion in enumerate(motions):
        own = [run for run in runs if run.motion == motion.name and run.status == 'ok']
        for column, error in ((2 * k, 'trajectory_error'), (2 * k + 1, 'energy_error')):
            for row, work in enumerate(('minimum', 'evaluations')):
                axes = panels[row][column]
                logarithmic(axes)
                for way in shown:
                    found = [run for run in own if run.way == way]
                    colour, marker, line = RUN_STYLES[way]
                    axes.plot(
                        [getattr(run, error) for run in found],
                        [getattr(run, work) for run in found],
                        linestyle=line, marker=marker, color=colour, label=_label(way),
                        markersize=10 if way in BEHIND else 5,
                        markerfacecolor='white' if way in BEHIND else colour,
                    )  # fmt: skip
            panels[0][column].set_title(motion.name, fontsize=10)
            unit = 'trajectory error [rad]' if column % 2 == 0 else 'energy error / peak kinetic'
            panels[1][column].set_xlabel(unit)
        for row in (0, 1):
            panels[row][2 * k].axvline(motion.self_difference, color=GREY, linestyle=':')
    panels[0][0].set_ylabel('time of a simulated second [s]')
    panels[1][0].set_ylabel('evaluations per simulated second')
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=LEGEND_COLUMNS, frameon=False)
    figure.suptitle(
        'Integrators: work against error. Down and left is better; runs that diverged are '
        'missing; dotted: self-difference of the reference.'
    )


def _label(way: str) -> str:
    """Return the name in the legend; ours have no library in theirs."""
    return way if ' ' in way else f'pfd {way}'
