# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
An example of the product's advice on a scene, with the time of a step without each effect.

Errors and operations are those that `pfd report scene` prints, the same on every machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.peers.work import Side
from benchmarks.run import show_progress
from benchmarks.table import Columns, Row, page, paragraph, short, table, yes
from benchmarks.timing import Pace, described, interleave, surroundings
import pfd_core as pfd
from pfd_ros.advice import Motion, advise, full_scene, sine
from pfd_ros.advice.motions import SETTINGS

TOLERANCE, WINDOW = 1e-3, 0.1
# Scenes differ by few percent of a step's time.
PACE, QUICK_PACE = Pace(turns=100, budget=8.0), Pace(turns=2, budget=0.1)
# Steps by which a step is timed.
TIMED_STEPS = 1000
FULL, SMALLEST = 'full scene', 'smallest found'


def measure(quick: bool) -> dict[str, Any]:
    """Return the advice on a PUMA 560 that follows sines, or quickly on an arm of two joints."""
    robot = pfd.load_robot('planar2' if quick else 'puma560')
    machine = surroundings()
    show_progress('simulating scenes')
    scene, refused = full_scene(robot, pfd.Scene(), SETTINGS)
    motion = sine(robot, scene)
    advice = advise(robot, scene, motion, TOLERANCE, WINDOW)
    scenes = {FULL: scene, SMALLEST: advice.scene}
    scenes |= {row.name: scene.without({row.name}) for row in advice.rows}
    show_progress('timing')
    times = _times(robot, scenes, motion, QUICK_PACE if quick else PACE)
    show_progress('')
    return {
        'machine': [{'machine': described(machine)}],
        'example': [
            {
                'robot': robot.name,
                'motion': motion.name,
                'steps': len(motion.taus),
                'step_size': motion.settings['step_size'],
                'tolerance': TOLERANCE,
                'window': WINDOW,
                'windows': advice.windows,
                'unseen': list(advice.unseen),
                'yaml': pfd.scene_to_yaml(advice.scene),
            }
        ],
        'effects': [row._asdict() | times.get(row.name, {}) for row in advice.rows],
        'scenes': [
            {'name': name, 'error': error, 'operations': operations} | times[name]
            for name, error, operations in zip(
                (FULL, SMALLEST), (0.0, advice.error), advice.operations, strict=True
            )
        ],
        'floors': [{'cause': cause, 'error': error} for cause, error in advice.floors.items()],
        'refused': [{'name': name, 'reason': reason} for name, reason in refused.items()],
    }


def _times(
    robot: pfd.Robot, scenes: dict[str, pfd.Scene], motion: Motion, pace: Pace
) -> dict[str, dict[str, float | None]]:
    """
    Return least and median time of a step [ns] in scenes, and the full scene's over theirs.

    They take turns in the first windows of the motion, each from the motion's state: over longer
    times the arms would come to states at which a step takes another time. Scenes that cannot be
    simulated are left out.
    """
    length = round(WINDOW / motion.settings['step_size'])
    windows = [slice(first, first + length) for first in range(0, TIMED_STEPS, length)]

    def side(name: str, simulator: pfd.Simulator) -> Side:
        def run() -> None:
            for window in windows:
                simulator.reset(motion.q[window.start], motion.qd[window.start])
                simulator.rollout(motion.taus[window])

        return Side(name, run, lambda: np.ones(1), reference=name == FULL)

    sides = []
    for name, scene in scenes.items():
        try:
            sides.append(side(name, pfd.Simulator(robot, scene, **motion.settings)))
        except ValueError:
            continue
    return {
        one.way: {'least': 1e9 * own.minimum, 'median': 1e9 * own.median, 'times': own.times}
        for one, own in zip(sides, interleave(sides, TIMED_STEPS, pace), strict=True)
    }


def _error(row: Row) -> str:
    return 'not finite' if row['error'] is None else f'{row["error"]:.1e}' if row['error'] else '0'


COMMON: Columns = {
    'largest error': _error,
    'operations': 'operations',
    'step [ns]': lambda row: (
        f'{row["least"]:.0f} / {row["median"]:.0f}' if 'least' in row else '-'
    ),
    'full scene, times as long': lambda row: short(row['times']) if row.get('times') else '-',
}
EFFECTS: Columns = {
    'without': 'name',
    **COMMON,
    'joint': lambda row: row['joint'] or '-',
    'at [s]': lambda row: '-' if row['time'] is None else f'{row["time"]:.3f}',
    'kept': lambda row: yes(row['kept']),
    'in this motion': lambda row: row['note'] or '-',
}
FLOORS: Columns = {'cause': 'cause', 'largest error': _error}


def text(data: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    (example,), (machine,) = data['example'], data['machine']
    kept, gone = (
        ', '.join(row['name'] for row in data['effects'] if row['kept'] is kept) or 'nothing'
        for kept in (True, False)
    )
    unseen = ', '.join(example['unseen'])
    refused = (f'{row["name"]} ({row["reason"]})' for row in data['refused'])
    return page(
        'scene',
        **{key: value for key, value in example.items() if key not in ('unseen', 'yaml')},
        machine=paragraph(f'{machine["machine"]}.'),
        kept=kept,
        gone=gone,
        unseen=paragraph(
            f'The motion does not test {unseen}: it is the same without. Test with a motion that '
            'needs them, or keep them.'
        )
        if unseen
        else None,
        refused=paragraph(f'Not simulated: {"; ".join(refused)}.') if data['refused'] else None,
        effects=table(EFFECTS, data['effects']),
        scenes=table({'scene': 'name', **COMMON}, data['scenes']),
        floors=table(FLOORS, data['floors']),
        yaml='\n'.join(f'    {line}' for line in example['yaml'].splitlines()),
    )
