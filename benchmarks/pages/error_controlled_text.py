# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text and pictures of an arm under a controller and of free motions, from the rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

from benchmarks.pages.error_controlled import ADAPTIVE, CONTENTS, FIXED, LEAVES, setting
from benchmarks.peers.control_loop import PINOCCHIO
from benchmarks.plots import CASADI, FLOAT32, FLOAT64, GREY, MUJOCO, ORANGE, logarithmic
from benchmarks.plots import PINOCCHIO as BLACK
from benchmarks.table import Columns, Row, bullets, lines_of, order, page, short, table

TOLERANCES = tuple(10.0**-k for k in (1, 2, 3, 4, 5, 6, 8, 10, 12))
# Another motion has another error: advice has a margin. Of times that differ by less than this
# part, the scene with most effects is better.
MARGIN, NEARLY = 2.0, 0.05
# Way: colour, marker and line in the plot.
STYLES: Mapping[str, tuple[str, str, str]] = {
    'pfd rk4 float64': (FLOAT64, 'o', '-'),
    'pfd velocity_verlet float64': (FLOAT64, '>', '-.'),
    'pfd imex2 float64': (FLOAT64, 's', '--'),
    ADAPTIVE: (FLOAT64, '*', ''),
    'pfd rk4 float32': (FLOAT32, '^', '-'),
    'pfd velocity_verlet float32': (FLOAT32, '<', '-.'),
    'pfd imex2 float32': (FLOAT32, 'v', '--'),
    'CasADi RK4': (CASADI, 'P', '-'),
    'CasADi Verlet': (CASADI, 'X', '-.'),
    'CasADi Euler': (CASADI, 'd', ':'),
    PINOCCHIO: (BLACK, 'D', '-'),
    'MuJoCo Euler': (MUJOCO, '<', ':'),
    'MuJoCo implicit': (MUJOCO, 'v', '-.'),
    'MuJoCo implicitfast': (MUJOCO, '>', '--'),
    'MuJoCo RK4': (MUJOCO, 'X', '-'),
}
LAST_OF_OURS = 'pfd imex2 float32'
# Left end of the plot over the smallest resolved error.
LEFT = 0.2


def is_ours(row: Row) -> bool:
    """Return whether a row is of this library."""
    return str(row['way']).startswith('pfd ')


def text(data: Mapping[str, Any]) -> str:
    """Return the section of the page."""
    facts, rows = data['reference'], data['runs']
    peers = [row for row in rows if not is_ours(row) and row['error'] is not None]
    nearest = min(peers, key=lambda row: float(row['error']), default=None)
    seen = {row['way'] for row in rows}
    floor = _floor(data)
    return page(
        'error-controlled',
        advice=_advice_table(rows),
        arms=max(row['arms'] for row in rows),
        rate=f'{facts["rate"]:g}',
        periods=facts['periods'],
        self_difference=order(facts['self_difference']),
        from_fixed=order(facts['from_fixed']),
        substeps=facts['substeps'],
        floor=order(floor),
        nearest='none'
        if nearest is None
        else f'{nearest["way"]}, within {_digits(nearest["error"])}',
        contents=lines_of(
            ['library, integrator, format', 'its time contains', 'dry friction'],
            [[way, *CONTENTS[way]] for way in CONTENTS if way in seen],
        ),
        widths=', '.join(f'{width:g}' for width in data['ramps']),
        solvers='; '.join(data['solvers']),
        scenes=table(
            {
                'scene': _without,
                'worst joint [rad]': lambda row: (
                    row['status'] if row['error'] is None else _digits(row['error'])
                ),
                'median joint [rad]': lambda row: _digits(row['middle']),
            },
            scene_errors(rows).values(),
        ),
        rounding=', '.join(
            f'{order(one["least"])} to {order(one["largest"])} rad in {one["dtype"]}'
            for one in data['roundings']
        ),
        runs=table(_columns(floor), rows),
        missing=bullets(data['missing'], 'Nothing.'),
    )


def text_of_free(data: Mapping[str, Any]) -> str:
    """Return the section of the free motions, name -> measurement."""
    sections = []
    for name, found in data.items():
        facts = found['reference']
        lines = [
            f'### {name}',
            '',
            f'{found["cause"]}; {facts["seconds"]:g} s. With another algorithm and shorter steps '
            f'the reference changes by {order(facts["self_difference"])} rad.',
            '',
            *table(_columns(_floor(found), free=True), found['runs']),
            '',
            bullets(found['missing'], ''),
        ]
        sections.append('\n'.join(lines).rstrip())
    return page('error-integrators', motions='\n\n'.join(sections))


# Errors [rad] of the row of README.md: coarse and fine for a controller's test.
COARSE_AND_FINE = (1e-3, 1e-5)


def results_rows(data: Mapping[str, Any]) -> list[dict[str, str]]:
    """
    Return the row of README.md: what, ours, peer, theirs and speed-up, as text; [] without peers.

    The fastest runs of one arm with all effects within each tolerance, with a margin of two.
    """
    whole = [row for row in data['runs'] if not row['left_out']]
    pairs = []
    for tolerance in COARSE_AND_FINE:
        ours, _, peer = (_fastest(whole, tolerance, fits) for fits in _KINDS)
        if ours is None or peer is None:
            return []
        pairs.append((ours, peer))

    def cells(cell: Callable[[Row, Row], str]) -> str:
        return ' / '.join(cell(*pair) for pair in pairs)

    within = ' / '.join(f'{tolerance:g}' for tolerance in COARSE_AND_FINE)
    return [
        {
            'what': f'a second of a UR5 under a controller, to {within} rad',
            'ours': cells(lambda ours, peer: f'{_milliseconds(ours)} ms'),
            'peer': cells(lambda ours, peer: f'{peer["way"]}'),
            'theirs': cells(lambda ours, peer: f'{_milliseconds(peer)} ms'),
            'speed-up': cells(lambda ours, peer: short(peer['minimum'] / ours['minimum'])),
        }
    ]


def _milliseconds(row: Row) -> str:
    return short(row['minimum'] * 1e3)


def _kind(row: Row) -> str:
    return str(row['way']).removeprefix('pfd ').replace(' ', ', ')


def _without(row: Row) -> str:
    if not row['left_out']:
        return 'all effects'
    names = [LEAVES[name] for name in row['left_out']]
    return 'without ' + ', '.join(names[:-1]) + ' and ' * (len(names) > 1) + names[-1]


def _digits(error: float | None) -> str:
    """Return an error in two digits: tolerances are powers of ten."""
    return '-' if error is None else f'{error:.1e}'


def _floor(data: Mapping[str, Any]) -> float:
    """Return the smallest error that the reference resolves [rad]."""
    facts = data['reference']
    # Events of the reference and of rk4 have separate code; free motions have none.
    known = ('self_difference',) if 'cause' in data else ('self_difference', 'from_fixed')
    return max(float(facts[key]) for key in known)


def _columns(floor: float, free: bool = False) -> Columns:
    """Return the columns of all runs; errors below the floor are not resolved."""

    def resolved(error: float) -> str:
        return f'< {order(floor)}' if error < floor else _digits(error)

    def times(row: Row) -> str:
        if row['minimum'] is None:
            return str(row['status'])
        return f'{_milliseconds(row)} / {short(row["median"] * 1e3)}'

    def errors(row: Row) -> str:
        if row['error'] is None:
            return '-'
        return f'{resolved(row["error"])} / {resolved(row["middle"])}'

    first: Columns = {'library, integrator, format': 'way', 'step or tolerance': setting}
    scene: Columns = {
        'scene': _without,
        'arms': 'arms',
        'friction': lambda row: row['softness'] or '-',
    }
    return {**first, **({} if free else scene), 'time': times, 'error': errors}


def scene_errors(rows: Iterable[Row]) -> dict[tuple[str, ...], Row]:
    """Return our row in the shortest steps of each scene that lacks effects."""
    found: dict[tuple[str, ...], Row] = {}
    for row in filter(is_ours, rows):
        names = tuple(row['left_out'])
        if names and (names not in found or row['step'] < found[names]['step']):
            found[names] = row
    return found


# Rows of one arm of ours, of many, and of other libraries.
_KINDS: Sequence[Callable[[Row], bool]] = (
    lambda row: is_ours(row) and row['arms'] == 1,
    lambda row: is_ours(row) and row['arms'] > 1,
    lambda row: not is_ours(row),
)


def _fastest(rows: Iterable[Row], tolerance: float, fits: Callable[[Row], bool]) -> Row | None:
    """Return the fastest row within a tolerance, with MARGIN; of nearly equal ones the fullest."""
    sound = [row for row in rows if row['minimum'] is not None and row['error'] is not None]
    timed = [row for row in sound if row['error'] * MARGIN <= tolerance and fits(row)]
    least = min((row['minimum'] for row in timed), default=0.0)
    near = [row for row in timed if row['minimum'] <= (1 + NEARLY) * least]
    return min(near, key=lambda row: (len(row['left_out']), row['minimum']), default=None)


def _advice_table(rows: Sequence[Row]) -> list[str]:
    found = []
    for tolerance in TOLERANCES:
        one, many, other = (_fastest(rows, tolerance, fits) for fits in _KINDS)
        cells = ['-', 'none', '-']
        if one is not None:
            cells = [_without(one), f'{_kind(one)}, {setting(one)}', _milliseconds(one)]
        for row in (many, other):
            if row is None:
                cells.append('none')
                continue
            lacks = f', {_without(row)}' if row['left_out'] else ''
            cells.append(f'{_milliseconds(row)} ({_kind(row)}, {setting(row)}{lacks})')
        found.append([f'{tolerance:g}', *cells])
    titles = ['error allowed [rad]', 'scene', 'integrator, format, step', 'one arm [ms]']
    titles += ['each of many arms [ms]', 'fastest other library, one arm [ms]']
    # Advice for a smaller error also holds for a larger one.
    following = [row[1:] for row in found[1:]]
    pairs = zip_longest(found, following)
    return lines_of(titles, [row for row, after in pairs if row[1:] != after])


def without_rotors(rows: Sequence[Row]) -> str:
    """Return a sentence on our runs without rotors in steps of one period, or ''."""
    own = [
        row
        for row in rows
        if is_ours(row) and row['way'].endswith('float64')
        if row['left_out'] == ['armature'] and row['arms'] == 1
    ]
    own = [row for row in own if row['step'] == own[0]['step']]
    lost = [row['way'].split()[1] for row in own if row['status'] != 'ok']
    sound = [row for row in own if row['status'] == 'ok']
    if not lost:
        return ''
    does = ', '.join(f'{row["way"].split()[1]} does, in {_milliseconds(row)} ms' for row in sound)
    return (
        f'Without rotor inertia, which most URDFs lack, {" and ".join(lost)} do not finish in '
        f'steps of {setting(own[0])}{"; " * bool(does)}{does}.'
    )


def draw(data: Mapping[str, Any], figure: Any) -> None:
    """Draw bars of the error that each choice adds above, and time over error below."""
    top, axes = figure.subplots(
        2, 1, sharex=True, gridspec_kw={'height_ratios': (1, 3), 'hspace': 0.02}
    )
    floor = _floor(data)
    bars = _bars(data, floor)
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
    _draw_runs(axes, data, floor)
    axes.axhline(1e3, color=GREY, linewidth=0.9, linestyle='-.')
    axes.text(
        0.005, 1e3 * 1.08, 'real time', fontsize=8.5, color=GREY, va='bottom',
        transform=axes.get_yaxis_transform(),
    )  # fmt: skip
    axes.set_xlim(LEFT * floor, 2.0)
    axes.set_xlabel('error of the worst joint after one second [rad]      (left is better)')
    axes.set_ylabel('time of one simulated second on one thread [ms]\n(down is better)')
    figure.legend(loc='outside lower center', ncols=4, fontsize=8, frameon=False)


def draw_free(data: Mapping[str, Any], figure: Any) -> None:
    """Draw time over error of each free motion, name -> measurement."""
    panels = figure.subplots(1, len(data), squeeze=False, sharey=True)[0]
    for axes, (name, found) in zip(panels, data.items(), strict=True):
        logarithmic(axes)
        _draw_runs(axes, found, _floor(found))
        axes.set_title(f'{name}, {found["reference"]["seconds"]:g} s', fontsize=10)
        axes.set_xlabel('error of the worst joint at the end [rad]')
    panels[0].set_ylabel('time of one simulated second on one thread [ms]')
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=5, fontsize=8, frameon=False)


def _draw_runs(axes: Any, data: Mapping[str, Any], floor: float) -> None:
    """Draw time over error of every way with all effects; open where of many arms."""
    whole = [row for row in data['runs'] if not row['left_out'] and row['minimum'] is not None]
    many = max((row['arms'] for row in whole), default=1)
    for way, (colour, marker, line) in STYLES.items():
        for arms in sorted({row['arms'] for row in whole if row['way'] == way}):
            own = [row for row in whole if row['way'] == way and row['arms'] == arms]
            axes.plot(
                [max(row['error'], floor) for row in own],
                [row['minimum'] * 1e3 for row in own],
                marker=marker, linestyle=line, color=colour, linewidth=1.1,
                markersize=9 if marker == '*' else 6, label=way if arms == 1 else None,
                markerfacecolor=colour if arms == 1 else 'white',
            )  # fmt: skip
        if way == LAST_OF_OURS and many > 1:
            # At this place of the legend, whose columns then have one library each.
            label = f'open: each of {many} equal arms'
            axes.plot([], [], 'ko', markerfacecolor='white', label=label)


def _bars(data: Mapping[str, Any], floor: float) -> list[tuple[str, str, float, float]]:
    """Return name, colour, left and right end of each bar [rad]."""
    bars = [
        (
            f'rounding in {one["dtype"]}' + ' (smaller, not resolved)' * (one['largest'] < floor),
            FLOAT64 if one['dtype'] == 'float64' else FLOAT32,
            max(one['least'], LEFT * floor),
            max(one['largest'], floor),
        )
        for one in data['roundings']
    ]
    fixed = [f'pfd {name} float64' for name, dtype in FIXED if dtype == 'float64']
    steps = [
        row
        for row in data['runs']
        if row['way'] in fixed and row['error'] is not None
        if not row['left_out'] and row['arms'] == 1
    ]
    longest = max(row['step'] for row in steps)
    ends = sorted((row['error'], row['way']) for row in steps if row['step'] == longest)
    (least, best), (most, worst) = ends[0], ends[-1]
    names = ' to '.join(way.split()[1] for way in (best, worst))
    bars.append((f'a step of {longest * 1e3:g} ms: {names}', GREY, least, most))
    scenes = scene_errors(data['runs'])
    for name in ('effort limits', 'friction', 'armature'):
        row = scenes[name,]
        if row['error'] is not None:
            bars.append((f'leaving out {LEAVES[name]}', ORANGE, row['middle'], row['error']))
    return bars
