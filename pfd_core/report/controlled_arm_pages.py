# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of an arm under a controller: controlled-arm.md, its JSON, plot and advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

from pfd_core.report.cases.controlled_arm import ControlledArm, stored_arm
from pfd_core.report.contenders.control_loop import IN_CASADI, MUJOCO, PINOCCHIO
from pfd_core.report.contenders.drake import DRAKE
from pfd_core.report.measure import controlled_motion
from pfd_core.report.measure.controlled_motion import (
    ADAPTIVE,
    FIXED,
    LEAVES,
    TOLERANCES,
    Advice,
    ControlledRow,
    Findings,
    Plan,
    advice,
    is_ours,
    scene_errors,
    survey,
)
from pfd_core.report.measure.surroundings import described
from pfd_core.report.render import plots
from pfd_core.report.render.markdown import Columns, bullets, lines_of, page, paragraph, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import least_and_median, order, short
from pfd_core.report.render.plots import (
    BLACK,
    FLOAT32,
    FLOAT64,
    GREY,
    ORANGE,
    logarithmic,
    save,
)

NAME = 'controlled-arm'
# Of the plot [inch].
SIZE = (10.0, 7.0)
NATIVE = 'one call of `Ensemble.rollout`: controller, steps and loop in native code'
IN_C = 'controller and loop in C; in each period {}'
RAMP, SOFT = 'ramp', 'soft constraint'
# Way: contents of its time, and its friction.
CONTENTS: Mapping[str, tuple[str, str]] = {
    **{f'pfd {integrator} {dtype}': (NATIVE, 'resolved by events') for integrator, dtype in FIXED},
    ADAPTIVE: (
        'a loop in Python: the controller in NumPy and one call of `integrate` in each period',
        'resolved by events',
    ),
    **dict.fromkeys(
        IN_CASADI,
        (IN_C.format("steps in C around CasADi's C, compiled with -O3 -march=native"), RAMP),
    ),
    PINOCCHIO: (
        IN_C.format('steps in C++ around `pinocchio::aba`, compiled with -O3 -march=native'),
        RAMP,
    ),
    **dict.fromkeys(MUJOCO, (IN_C.format('`mj_step`'), SOFT)),
    **dict.fromkeys(
        DRAKE, ("`Simulator.AdvanceTo`: controller and loop are Drake's systems in C++", RAMP)
    ),
}
# Way: colour, marker, line and name in the plot.
STYLES: Mapping[str, tuple[str, str, str, str]] = {
    'pfd rk4 float64': (FLOAT64, 'o', '-', 'pfd rk4, float64'),
    'pfd velocity_verlet float64': (FLOAT64, '>', '-.', 'pfd velocity_verlet, float64'),
    'pfd imex2 float64': (FLOAT64, 's', '--', 'pfd imex2, float64'),
    ADAPTIVE: (FLOAT64, '*', '', 'pfd dop853 (code of the reference)'),
    'pfd rk4 float32': (FLOAT32, '^', '-', 'pfd rk4, float32'),
    'pfd velocity_verlet float32': (FLOAT32, '<', '-.', 'pfd velocity_verlet, float32'),
    'pfd imex2 float32': (FLOAT32, 'v', '--', 'pfd imex2, float32'),
    'CasADi RK4': (plots.CASADI, 'P', '-', 'CasADi, RK4 in C'),
    'CasADi Verlet': (plots.CASADI, 'X', '-.', 'CasADi, Verlet in C'),
    'CasADi Euler': (plots.CASADI, 'd', ':', 'CasADi, Euler in C'),
    PINOCCHIO: (plots.PINOCCHIO, 'D', '-', 'Pinocchio, RK4 in C++'),
    'MuJoCo Euler': (plots.MUJOCO, '<', ':', 'MuJoCo Euler'),
    'MuJoCo implicitfast': (plots.MUJOCO, '>', '--', 'MuJoCo implicitfast'),
    'MuJoCo RK4': (plots.MUJOCO, 'X', '-', 'MuJoCo RK4'),
    'Drake RK3': (plots.DRAKE, 'h', '-', 'Drake RK3 (adaptive)'),
    'Drake RK5': (plots.DRAKE, 'd', '--', 'Drake RK5 (adaptive)'),
    'Drake Radau3': (plots.DRAKE, 'p', ':', 'Drake Radau3 (adaptive)'),
}
LAST_OF_OURS = 'pfd imex2 float32'
# Left end of the plot over the smallest resolved error.
LEFT = 0.2


def _without(row: ControlledRow) -> str:
    if not row.left_out:
        return 'all effects'
    names = [LEAVES[name] for name in row.left_out]
    return 'without ' + ', '.join(names[:-1]) + ' and ' * (len(names) > 1) + names[-1]


def _rows(floor: float) -> Columns:
    """Return the columns of all runs; errors below the floor are not resolved."""

    def resolved(error: float | None) -> str:
        return f'< {floor:.0e}' if error is not None and error < floor else _digits(error)

    return {
        'library, integrator, format': 'way',
        'step or tolerance': 'setting',
        'scene': _without,
        'arms': 'arms',
        'friction': lambda row: row.softness or '-',
        'time': lambda row: row.status if row.minimum is None else least_and_median(row, 1e3),
        'error': lambda row: (
            '-' if row.error is None else f'{resolved(row.error)} / {resolved(row.middle)}'
        ),
    }


def _digits(error: float | None) -> str:
    """Return an error in two digits: tolerances are powers of ten."""
    return '-' if error is None else f'{error:.1e}'


def _floor(findings: Findings) -> float:
    """Return the smallest error that the reference resolves [rad]."""
    return max(findings.reference.self_difference, findings.reference.from_fixed)


def summary(findings: Findings) -> str:
    """Return the sentences and the table of advice that README repeats."""
    rows = findings.rows
    whole = [row for row in rows if not row.left_out and row.minimum is not None]

    def longest(way: str) -> ControlledRow:
        own = (row for row in whole if row.way == way and row.arms == 1)
        return max(own, key=lambda row: row.step or 0.0)

    first, quick = longest('pfd rk4 float64'), longest('pfd velocity_verlet float64')
    alone = scene_errors(rows)
    costs = {name: _digits(alone[name,].error) for name in LEAVES}
    arms = max(row.arms for row in rows)
    return page(
        'controlled-arm-summary',
        step=first.setting,
        time=short((first.minimum or 0.0) * 1e3),
        error=order(first.error),
        quick_time=short((quick.minimum or 0.0) * 1e3),
        quick_error=order(quick.error),
        others=_others(whole),
        limits=costs['effort limits'],
        friction=costs['friction'],
        rotors=costs['armature'],
        single=order(_single(whole)),
        bare=_bare(rows, first.step),
        advice=lines_of(
            [
                'error allowed [rad]',
                'scene',
                'integrator, format, step',
                'one arm [ms]',
                f'each of {arms} arms [ms]',
                'fastest other library, one arm [ms]',
            ],
            _differing([_advised(one) for one in advice(rows, TOLERANCES)]),
        ),
        processor=f'{"virtual " * bool(findings.machine.get("virtual"))}'
        f'{findings.machine["processor"]}',
        arms=arms,
    )


def _others(whole: Sequence[ControlledRow]) -> str:
    peers = [row for row in whole if not is_ours(row)]
    if not peers:
        return 'No other library was measured.'
    nearest = min(peers, key=lambda row: row.error or 0.0)
    quick = min(peers, key=lambda row: row.minimum or 0.0)

    def at(row: ControlledRow) -> str:
        return f'in steps of {row.setting}' if row.step else f'at {row.setting}'

    return (
        f'The fastest run of another library, {quick.way} {at(quick)}, takes '
        f'{short((quick.minimum or 0) * 1e3)} ms, with {order(quick.error)} rad; the most '
        f'accurate, {nearest.way} {at(nearest)}, takes {short((nearest.minimum or 0) * 1e3)} '
        f'ms, with {order(nearest.error)} rad. In other libraries dry friction is approximated, '
        'by a steep ramp of the velocity or, in MuJoCo, a soft constraint; their errors contain '
        'that. The reference is our adaptive integrator, in which joints stick.'
    )


def _single(whole: Sequence[ControlledRow]) -> float:
    """Return the most that float32 adds to the error of an integrator in some step [rad]."""
    errors = {(row.way, row.step): row.error or 0.0 for row in whole if row.arms == 1}
    return max(
        error - errors[way.replace('float32', 'float64'), step]
        for (way, step), error in errors.items()
        if 'float32' in way and (way.replace('float32', 'float64'), step) in errors
    )


def _bare(rows: Sequence[ControlledRow], step: float | None) -> str:
    """Return a sentence on our runs without rotors in a step, with a space, or ''."""
    own = [
        row
        for row in rows
        if row.way.startswith('pfd') and row.way.endswith('float64')
        if row.left_out == ('armature',) and (row.arms, row.step) == (1, step)
    ]
    names: dict[bool, dict[str, float]] = {True: {}, False: {}}
    for row in own:
        names[row.status == 'ok'][row.way.split()[1]] = (row.minimum or 0.0) * 1e3
    if not names[False]:
        return ''
    sound = ', '.join(f'{name} does, in {short(time)} ms' for name, time in names[True].items())
    text = (
        f'Without rotor inertia, which most URDFs lack, {" and ".join(names[False])} do not '
        f'finish in steps of {own[0].setting}'
    )
    return f'{text}; {sound}. ' if sound else f'{text}. '


def _differing(rows: Sequence[list[str]]) -> list[list[str]]:
    """Drop rows equal to the next: advice for a smaller error also holds for a larger one."""
    following = [row[1:] for row in rows[1:]]
    return [row for row, after in zip_longest(rows, following) if row[1:] != after]


def _advised(one: Advice) -> list[str]:
    cells = [f'{one.tolerance:g}']
    if one.one is None or one.one.minimum is None:
        cells += ['-', 'none', '-']
    else:
        kind = one.one.way.removeprefix('pfd ').replace(' ', ', ')
        cells += [
            _without(one.one),
            f'{kind}, {one.one.setting}',
            short(one.one.minimum * 1e3),
        ]
    for row in (one.many, one.other):
        if row is None or row.minimum is None:
            cells.append('none')
            continue
        name = row.way.removeprefix('pfd ')
        missing = f', {_without(row)}' if row.left_out else ''
        cells.append(f'{short(row.minimum * 1e3)} ({name}, {row.setting}{missing})')
    return cells


def markdown(findings: Findings, case: ControlledArm) -> str:
    """Return the whole page."""
    peers = [row for row in findings.rows if not is_ours(row) and row.error is not None]
    nearest = min(peers, key=lambda row: row.error or 0.0, default=None)
    seen = {row.way for row in findings.rows}
    return page(
        NAME,
        summary=summary(findings),
        machine=paragraph(f'Measured on {described(findings.machine)}.'),
        rate=1 / case.period,
        periods=findings.periods,
        reference=findings.reference,
        floor=_floor(findings),
        nearest='none' if nearest is None else nearest.way,
        nearest_error=float('nan') if nearest is None else nearest.error or 0.0,
        contents=lines_of(
            ['library, integrator, format', 'its time contains', 'dry friction'],
            [[way, *CONTENTS[way]] for way in CONTENTS if way in seen],
        ),
        widths=', '.join(f'{width:g}' for width in findings.ramps),
        solvers='; '.join(findings.solvers),
        narrowest=min(findings.ramps[: controlled_motion.DRAKES], default=0.0),
        scenes=table(
            {
                'scene': _without,
                'worst joint [rad]': lambda row: _digits(row.error) if row.error else row.status,
                'median joint [rad]': lambda row: _digits(row.middle) if row.error else '-',
            },
            scene_errors(findings.rows).values(),
        ),
        rounding=', '.join(
            f'{one.least:.0e} to {one.largest:.0e} rad in {one.dtype}'
            for one in findings.roundings
        ),
        rows=table(_rows(_floor(findings)), findings.rows),
        excluded=bullets(findings.left_out, 'Nothing.'),
    )


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure, write the report into a folder and return its files."""
    case = stored_arm()
    findings = survey(case, controlled_motion.QUICK if quick else Plan())
    return write(findings, case, folder)


def write(findings: Findings, case: ControlledArm, folder: Path) -> list[Path]:
    """Write the page, its JSON and the plot as PNG and SVG, and return their paths."""
    return [
        *write_page(folder, NAME, markdown(findings, case), findings),
        *save(partial(_draw, findings), folder, NAME, SIZE),
    ]


def _draw(findings: Findings, figure: Any) -> None:
    """Draw bars of the error that each choice adds above, and time over error below."""
    top, axes = figure.subplots(
        2, 1, sharex=True, gridspec_kw={'height_ratios': (1, 3), 'hspace': 0.02}
    )
    floor = _floor(findings)
    bars = _bars(findings, floor)
    for k, (name, colour, low, high) in enumerate(bars):
        top.barh(-k, high - low, left=low, height=0.62, color=colour)
        axes.axvspan(low, high, color=colour, alpha=0.13, linewidth=0)
        beside, side = (low / 1.6, 'right') if low > 1e-10 else (high * 1.6, 'left')
        top.text(beside, -k, name, ha=side, va='center', fontsize=8.5)
    top.set(yticks=[], ylim=(0.6 - len(bars), 0.6))
    top.set_title(
        'A geared UR5 with friction and motor limits under a 1 kHz controller', fontsize=12
    )
    top.text(
        0.995, 0.96, 'error that each choice adds', transform=top.transAxes, ha='right', va='top',
        fontsize=8.5, color=GREY,
    )  # fmt: skip
    top.tick_params(bottom=False)
    logarithmic(axes)
    top.set_xscale('log')
    top.minorticks_off()
    whole = [row for row in findings.rows if not row.left_out and row.minimum is not None]
    many = max((row.arms for row in whole), default=1)
    for way, (colour, marker, line, name) in STYLES.items():
        for arms in sorted({row.arms for row in whole if row.way == way}):
            own = [row for row in whole if row.way == way and row.arms == arms]
            axes.plot(
                [max(row.error or 0.0, floor) for row in own],
                [(row.minimum or 0.0) * 1e3 for row in own],
                marker=marker, linestyle=line, color=colour, linewidth=1.1,
                markersize=9 if marker == '*' else 6, label=name if arms == 1 else None,
                markerfacecolor=colour if arms == 1 else 'white',
            )  # fmt: skip
        if way == LAST_OF_OURS:
            # At this place of the legend, whose columns then have one library each.
            label = f'open: each of {many} equal arms'
            axes.plot([], [], 'o', color=BLACK, markerfacecolor='white', label=label)
    axes.axhline(1e3, color=GREY, linewidth=0.9, linestyle='-.')
    axes.text(
        0.005, 1e3 * 1.08, 'real time', fontsize=8.5, color=GREY, va='bottom',
        transform=axes.get_yaxis_transform(),
    )  # fmt: skip
    axes.set_xlim(LEFT * floor, 2.0)
    axes.set_xlabel('error of the worst joint after one second [rad]      (left is better)')
    axes.set_ylabel('time of one simulated second on one thread [ms]\n(down is better)')
    figure.legend(loc='outside lower center', ncols=5, fontsize=8, frameon=False)


def _bars(findings: Findings, floor: float) -> list[tuple[str, str, float, float]]:
    """Return name, colour, left and right end of each bar [rad]."""
    bars = [
        (
            f'rounding in {one.dtype}' + ' (smaller, not resolved)' * (one.largest < floor),
            FLOAT64 if one.dtype == 'float64' else FLOAT32,
            max(one.least, LEFT * floor),
            max(one.largest, floor),
        )
        for one in findings.roundings
    ]
    whole = [row for row in findings.rows if not row.left_out and row.arms == 1]
    fixed = [f'pfd {name} float64' for name, dtype in FIXED if dtype == 'float64']
    steps = [row for row in whole if row.way in fixed and row.error is not None]
    longest = max(row.step or 0.0 for row in steps)
    ends = sorted((row.error or 0.0, row.way) for row in steps if row.step == longest)
    (least, best), (most, worst) = ends[0], ends[-1]
    names = ' to '.join(way.split()[1] for way in (best, worst))
    bars.append((f'a step of {longest * 1e3:g} ms: {names}', GREY, least, most))
    scenes = scene_errors(findings.rows)
    for name in ('effort limits', 'friction', 'armature'):
        row = scenes[name,]
        if row.error is not None and row.middle is not None:
            bars.append((f'leaving out {LEAVES[name]}', ORANGE, row.middle, row.error))
    return bars
