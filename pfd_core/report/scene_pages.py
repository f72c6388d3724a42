# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of one scene: the page scene.md, its tables and columns; writes all files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
import math
from pathlib import Path
from typing import Any

from pfd_core.model import Robot, Scene, load_robot
from pfd_core.report.cases.excitations import SETTINGS, DrivenMotion, excited_motion
from pfd_core.report.measure.scene_effects import full_scene
from pfd_core.report.measure.scene_errors import SceneRow
from pfd_core.report.measure.scene_margins import Margin
from pfd_core.report.measure.scene_needs import (
    TIMED_STEPS,
    WINDOW,
    Needs,
    scene_needs,
)
from pfd_core.report.measure.scene_search import MOST_EXHAUSTED, pareto_front
from pfd_core.report.measure.surroundings import described
from pfd_core.report.render.markdown import Columns, page, paragraph, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import listed, yes
from pfd_core.report.render.plots import save

# Rows of the table of scenes; the JSON has all.
MOST_SCENES = 40
# A joint that is a whole turn off [rad], or so many metres, has lost the motion.
DIVERGED = 2 * math.pi
DIVERGES, OVERFLOWS = 'diverges', 'overflows'
MARGINS = {
    'torque': 'its torque is up to {share} of the largest of {joint}',
    'limit': '{joint} comes to {share} of its limit',
    'stop': '{joint} comes within {value:.2g} of a stop',
    'rest': '{joint} is at rest {share} of the time',
    'held': '{joint} is held {share} of the time',
    '': '-',
}


def markdown(needs: Needs) -> str:
    """Return the whole page."""
    small, front = needs.smallest, pareto_front(needs.scenes)
    worst = f' (joint {small.joint}, {small.time:.3f} s; rms {_error(small.rms)})'
    refused = [row for row in needs.effects if row.without.refused]
    return page(
        'scene',
        needs=needs,
        machine=paragraph(f'{described(needs.machine)}.'),
        departed=_error(needs.departure),
        kept=listed(small.effects),
        gone=listed(row.name for row in needs.effects if not row.needed),
        differs=f'{_error(small.largest)}{worst if small.largest else ""}',
        bare=_bare(needs.bare),
        advice=paragraph(_advice(needs)),
        floors=table(FLOORS, needs.floors),
        timed=min(TIMED_STEPS, needs.steps),
        effects=[
            *table(EFFECTS, needs.effects),
            *(f'\nRefused without {row.name}: {row.without.refused}' for row in refused),
        ],
        off='\n\n'.join(map(paragraph, _off(needs))),
        searched=paragraph(_searched(needs)),
        scenes=table(
            {
                **SCENES,
                'within tolerance': lambda row: yes(row.largest <= needs.tolerance),
                'best': lambda row: 'best' if row in front else '',
            },
            needs.scenes[:MOST_SCENES],
        ),
    )


def _margin(margin: Margin) -> str:
    share = '' if math.isnan(margin.value) else f'{100 * margin.value:.3g} %'
    return MARGINS[margin.kind].format(share=share, value=margin.value, joint=margin.joint)


def _bare(bare: SceneRow) -> str:
    if bare.refused:
        return f'the simulation refuses the scene ({bare.refused})'
    error = _error(bare.largest)
    lost = error in (DIVERGES, OVERFLOWS)
    return f'the motion {error}' if lost else f'the difference is {error}'


def _advice(needs: Needs) -> str:
    unneeded = [row for row in needs.effects if not row.needed]
    small = [row.name for row in unneeded if row.exercised]
    silent = [row for row in needs.effects if not row.exercised]
    margins = '; '.join(f'{row.name}: {_margin(row.margin)}' for row in silent)
    times = needs.step_times
    advice = (
        f'simulate this motion with {listed(needs.smallest.effects)}: within '
        f'{needs.tolerance:g} over {needs.window:g} s, in '
        f'{times["smallest minimum"] / times["full minimum"]:.0%} of the time of the full scene.'
    )
    if small:
        advice += f' Leave out {listed(small)}, whose error is within the tolerance.'
    if silent:
        advice += (
            f' It cannot show whether you need {listed(row.name for row in silent)}, which do '
            f'not change this motion ({margins}): test with a motion that does, or keep them.'
        )
    return f'**Advice**: {advice}'


def _unless_refused(row: SceneRow, value: object) -> object:
    return '-' if row.refused else value


def _largest(row: SceneRow) -> str:
    return 'refused' if row.refused else _error(row.largest)


EFFECTS: Columns = {
    'effect': 'name',
    'operations': lambda row: _unless_refused(row.without, row.operations),
    'step without it [ns]': lambda row: (
        '-' if math.isnan(row.nanoseconds) else f'{row.nanoseconds:.0f} / {row.median:.0f}'
    ),
    'full / without': lambda row: (
        '-' if math.isnan(row.times) else f'{row.times_least:.2f} / {row.times:.2f}'
    ),
    'largest': lambda row: _largest(row.without),
    'rms': lambda row: _unless_refused(row.without, _error(row.without.rms)),
    'joint': lambda row: row.without.joint if row.without.largest else '-',
    'at [s]': lambda row: (
        f'{row.without.time:.3f}' if row.without.largest and row.without.joint else '-'
    ),
    'in this motion': lambda row: _margin(row.margin),
    'in the smallest scene': lambda row: yes(row.needed),
}
FLOORS: Columns = {'difference': 'cause', 'largest': lambda row: _error(row.largest)}
SCENES: Columns = {
    'effects': lambda row: listed(row.effects),
    'operations': 'operations',
    'largest': lambda row: _largest(row),
    'rms': lambda row: _unless_refused(row, _error(row.rms)),
}


def _off(needs: Needs) -> list[str]:
    return [
        'Not in the full scene of this robot, so without operations and error: '
        f'{listed(needs.off)}.',
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
            'removed one by one, the one with the least error per saved operation first, until '
            'none could be removed. A smaller scene, in which effects '
            'cancel each other, may have been missed.'
        )
    if refused:
        counts = Counter(row.refused for row in refused)
        reasons = '; '.join(f'{reason} ({count})' for reason, count in counts.items())
        how += f' The simulation refused {len(refused)} of {len(needs.scenes)} scenes: {reasons}.'
    cut = f' The first {MOST_SCENES}; the JSON has all.' if needs.scenes[MOST_SCENES:] else ''
    return (
        f'{how} *best* marks scenes on the Pareto front of operations and error, without '
        f'time.{cut}'
    )


def _error(value: float) -> str:
    if not math.isfinite(value):
        return OVERFLOWS
    if value > DIVERGED:
        return DIVERGES
    return f'{value:.1e}' if value else '0'


def run(
    robot: Robot,
    scene: Scene,
    motion: DrivenMotion,
    tolerance: float,
    folder: Path,
    window: float = WINDOW,
    refused: Mapping[str, str] | None = None,
) -> list[Path]:
    """Measure and write the report into a folder."""
    needs = scene_needs(robot, scene, motion, tolerance, window=window, refused=refused)
    return write(needs, folder)


def run_excited(
    robot: Robot,
    trajectory: str,
    tolerance: float,
    folder: Path,
    scene: Scene | None = None,
    window: float = WINDOW,
) -> list[Path]:
    """Write the report of a robot that follows an excitation, by default in its full scene."""
    refused: dict[str, str] = {}
    if scene is None:
        scene, refused = full_scene(robot, Scene(), SETTINGS)
    motion = excited_motion(robot, scene, trajectory)
    return run(robot, scene, motion, tolerance, folder, window, refused)


def example(folder: Path, quick: bool = False) -> list[Path]:
    """Write the report of a PUMA 560 following sines, or quickly of an arm of two joints."""
    return run_excited(load_robot('planar2' if quick else 'puma560'), 'sine', 1e-3, folder)


def write(needs: Needs, folder: Path) -> list[Path]:
    """
    Write scene.md, scene.json, scene.yaml, scene.png and scene.svg, and return their paths.

    scene.yaml is the smallest scene, as `load_scene` reads it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = save(partial(_draw, needs), folder, 'scene', (9, 6))
    shown = '\n![Error of every scene against its operations](scene.png)\n' if pictures else ''
    pages = write_page(folder, 'scene', markdown(needs) + shown, needs)
    smallest = folder / 'scene.yaml'
    smallest.write_text(needs.yaml, encoding='utf-8')
    return [*pages, smallest, *pictures]


def _draw(needs: Needs, figure: Any) -> None:
    axes = figure.subplots()
    drawn = [row for row in needs.scenes if math.isfinite(row.largest)]
    errors = [row.largest for row in drawn if row.largest > 0] + [needs.tolerance]
    # A logarithmic axis has no zero: errors of zero are at the bottom.
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
    named.sort(key=lambda item: (item[1].largest, item[1].operations))
    for k, (text, row) in enumerate([('no effect at all', needs.bare), *named]):
        if math.isfinite(row.largest):
            (x,), (y,) = at([row])
            # Above and below in turn, as neighbours may have equal errors.
            place = (6, 4) if k % 2 == 0 else (6, -12)
            axes.annotate(text, (x, y), place, textcoords='offset points', size=8)
    axes.axhline(zero, color='0.8', lw=0.8)
    left_end = ('axes fraction', 'data')
    axes.annotate('error 0', (0, zero), (3, 3), left_end, 'offset points', size=8)
    axes.set_yscale('log')
    axes.margins(x=0.15)  # for the names of the points
    axes.set_xlabel('operations of one step of the integrator, as compiled, without events')
    axes.set_ylabel(
        f'largest difference of a joint position from\nthe full scene within {needs.window:g} s '
        '[rad or m]'
    )
    axes.set_title(
        f'{needs.robot}, {needs.trajectory}: error of a scene against its cost\n'
        '(both sides with one integrator and step, whose error is excluded)',
        fontsize=10,
    )
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
