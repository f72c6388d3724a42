# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of one scene: the page scene.md, its tables and columns; writes all files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
import math
from pathlib import Path
from typing import Any

from pfd_core.model import Robot, Scene
from pfd_core.report.markdown import cells, header, json_text, paragraph
from pfd_core.report.scene_errors import SceneRow
from pfd_core.report.scene_motions import Motion
from pfd_core.report.scene_needs import TIMED_STEPS, WINDOW, Needs, scene_needs
from pfd_core.report.scene_search import MOST_EXHAUSTED, pareto_front
from pfd_core.report.timing import show_progress

# Rows of the table of scenes; the JSON has all.
MOST_SCENES = 40


def markdown(needs: Needs) -> str:
    """Return the whole page."""
    parts = [
        f'# The effects that {needs.robot} needs on {needs.trajectory}\n',
        paragraph(_origin(needs)),
        paragraph(_machine(needs.machine)),
        *map(paragraph, _truth(needs)),
        '## Smallest scene\n',
        *map(paragraph, _answer(needs)),
        f'    pfd.{needs.smallest.scene}\n',
        'The file scene.yaml has it for `pfd.load_scene`.\n',
        '## Each effect alone\n',
        paragraph(EFFECTS_TEXT.format(steps=min(TIMED_STEPS, needs.steps))),
        *_effects(needs),
        '',
        *map(paragraph, _off(needs)),
        '## Scenes\n',
        paragraph(_searched(needs)),
        *_scenes(needs),
    ]
    return '\n'.join(parts).rstrip() + '\n'


EFFECTS_TEXT = (
    'Each row is the full scene without one effect. *operations* are those that the effect adds '
    'to one step of the integrator, as compiled, if no joint rests, reverses or reaches its stop '
    'in it; the search for a held joint and the segments after an event are in the times alone. '
    'Friction and stops share some of theirs. *step without it* is the least / median time of a '
    'step over the first windows, {steps} steps or a little more, with what Python does around a '
    'window, which is in all of them; *full / without* is the ratio of the least times / the '
    'median ratio of two times taken shortly after each other. *largest* and *rms* are '
    'differences of joint positions over all joints, steps and windows, of this one effect: '
    'errors of effects do not add, so they leave out what two missing effects do together. '
    '*share* is the part of the rms in the sum of this column.'
)


def _origin(needs: Needs) -> str:
    settings = needs.settings
    return (
        f'Written by `pfd report scene --trajectory {needs.trajectory} --tolerance '
        f'{needs.tolerance:g}` for {needs.robot}. Trajectory: {needs.source}; {needs.steps} steps '
        f'of {settings["step_size"]:g} s with {settings["substeps"]} substeps, integrator '
        f'{settings["integrator"]}. Operations and errors are the same on '
        'every machine, times are those of one machine on one day.'
    )


def _machine(machine: dict[str, Any]) -> str:
    versions = ', '.join(f'{name} {number}' for name, number in machine['versions'].items())
    told = [machine['processor'], versions, f'load before the start {machine["load"]}']
    return '; '.join([*told, machine['date']]) + '.'


def _truth(needs: Needs) -> list[str]:
    """Return what an error here is, and what it leaves out."""
    return [
        f'The full scene is `pfd.{needs.full.scene}`, with {needs.full.operations} operations. It '
        'is taken for the truth: how far it lies from a real arm is left out.',
        f'An error is the difference of a joint position [rad, m for joints that slide] from that '
        f'in the full scene under the same torques, within {needs.windows} windows of at most '
        f'{needs.window:g} s: at the start of each, every scene begins at the state of the full '
        'one, and no feedback acts, so that neither chaos nor a controller decides. Longer open '
        'loops have larger errors. The error of the integrator, the same on both sides, is left '
        'out.',
        'At the ends of its windows the full scene is at most '
        f'{_error(needs.departure)} away from the states of the trajectory where those are known; '
        'that is no part of the errors below.',
    ]


def _answer(needs: Needs) -> list[str]:
    small, times = needs.smallest, needs.step_times
    gone = [row.name for row in needs.effects if not row.needed]
    worst = f' (joint {small.joint}, {small.time:.3f} s; rms {_error(small.rms)})'
    return [
        f'Within {needs.tolerance:g} of the full scene in every window: '
        f'**{_listed(small.effects)}**; left out: {_listed(gone)}. It differs by at most '
        f'{_error(small.largest)}{worst if small.largest else ""}, measured in this very scene, '
        f'without what open loops longer than {needs.window:g} s would add.',
        f'It has {small.operations} of {needs.full.operations} operations of one step of the '
        'integrator, those of events and joints at rest left out. A step takes '
        f'{times["smallest minimum"]:.0f} / {times["smallest median"]:.0f} ns (least / median) '
        f'instead of {times["full minimum"]:.0f} / {times["full median"]:.0f} ns, with what '
        'Python does around a window; the full scene takes '
        f'{times["times least"]:.2f} times as long by the least times, {times["times"]:.2f} '
        'times in the median over turns.',
        f'Without any effect the difference is {_error(needs.bare.largest)}, at '
        f'{needs.bare.operations} operations, with the same left out.',
    ]


def _effects(needs: Needs) -> list[str]:
    table = header(
        'effect | operations | step without it [ns] | full / without | largest | rms | share '
        '| joint | at [s] | in the smallest scene'
    )
    for row in needs.effects:
        one = row.without
        table.append(
            cells(
                row.name,
                '-' if one.refused else row.operations,
                '-'
                if math.isnan(row.nanoseconds)
                else f'{row.nanoseconds:.0f} / {row.median:.0f}',
                '-' if math.isnan(row.times) else f'{row.times_least:.2f} / {row.times:.2f}',
                'refused' if one.refused else _error(one.largest),
                '-' if one.refused else _error(one.rms),
                '-' if math.isnan(row.share) else f'{100 * row.share:.3g} %',
                one.joint if one.largest else '-',
                f'{one.time:.3f}' if one.largest and one.joint else '-',
                'yes' if row.needed else 'no',
            )
        )
    refused = [row for row in needs.effects if row.without.refused]
    return table + [f'\nRefused without {row.name}: {row.without.refused}' for row in refused]


def _off(needs: Needs) -> list[str]:
    return [
        'Off in the full scene for this robot, so without operations and without error here: '
        f'{_listed(needs.off)}.',
        *(
            f'The model states {name}, which are off here because the simulation refuses them: '
            f'{reason}.'
            for name, reason in needs.refused.items()
        ),
    ]


def _searched(needs: Needs) -> str:
    refused = [row for row in needs.scenes if row.refused]
    done = 'tried' if refused else 'simulated'
    how = f'All subsets of the {len(needs.effects)} effects were {done}.'
    if not needs.exhaustive:
        how = (
            f'Of more than {MOST_EXHAUSTED} effects not all subsets were simulated: effects were '
            'left out one by one, the one with the least error for the operations that it saves '
            'first, until none could be left out any more. A smaller scene, in which effects '
            'cancel each other, may have been missed.'
        )
    if refused:
        counts = Counter(row.refused for row in refused)
        reasons = '; '.join(f'{reason} ({count})' for reason, count in counts.items())
        how += f' The simulation refused {len(refused)} of {len(needs.scenes)} scenes: {reasons}.'
    cut = f' The first {MOST_SCENES}; the JSON has all.' if needs.scenes[MOST_SCENES:] else ''
    return (
        f'{how} *best* marks those than which none is both as cheap in operations and as '
        f'accurate; time is left out of that.{cut}'
    )


def _scenes(needs: Needs) -> list[str]:
    front = pareto_front(needs.scenes)
    return header('effects | operations | largest | rms | within tolerance | best') + [
        cells(
            _listed(row.effects),
            row.operations,
            'refused' if row.refused else _error(row.largest),
            '-' if row.refused else _error(row.rms),
            'yes' if row.largest <= needs.tolerance else 'no',
            'best' if row in front else '',
        )
        for row in needs.scenes[:MOST_SCENES]
    ]


def _error(value: float) -> str:
    if not math.isfinite(value):
        return 'overflows'
    return f'{value:.1e}' if value else '0'


def _listed(names: Sequence[str]) -> str:
    return ', '.join(names) or 'nothing'


def run(
    robot: Robot,
    scene: Scene,
    motion: Motion,
    tolerance: float,
    folder: Path,
    window: float = WINDOW,
    refused: Mapping[str, str] | None = None,
) -> list[Path]:
    """Measure and write the report into a folder; progress goes to a terminal."""
    needs = scene_needs(
        robot, scene, motion, tolerance, window=window, refused=refused, tell=show_progress
    )
    return write(needs, folder)


def write(needs: Needs, folder: Path) -> list[Path]:
    """
    Write scene.md, scene.json, scene.yaml, scene.png and scene.svg, and return their paths.

    scene.yaml is the smallest scene, as `load_scene` reads it.

    The plots are left out where matplotlib (extra `report`) is not installed. A number that is
    not finite is null in the JSON.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kinds = ('md', 'json', 'yaml', 'png', 'svg')
    page, data, smallest, *pictures = (folder / f'scene.{kind}' for kind in kinds)
    drawn = plot(needs, pictures)
    text = markdown(needs)
    if drawn:
        text += '\n![Error of every scene against its operations](scene.png)\n'
    page.write_text(text, encoding='utf-8')
    data.write_text(json_text(asdict(needs)), encoding='utf-8')
    smallest.write_text(needs.yaml, encoding='utf-8')
    return [page, data, smallest, *(pictures if drawn else [])]


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
