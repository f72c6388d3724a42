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
from benchmarks.table import Columns, page, paragraph, short, table, yes
from benchmarks.timing import Pace, interleave, surroundings
import pfd_core as pfd
from pfd_ros.advice import Motion, advise, full_scene, sine
from pfd_ros.advice.motions import SETTINGS
from pfd_ros.advice.scene import FULL, SMALLEST

TOLERANCE, WINDOW = 1e-3, 0.1
# Scenes differ by few percent of a step's time.
PACE, QUICK_PACE = Pace(turns=100, budget=8.0), Pace(turns=2, budget=0.1)
# Steps by which a step is timed, and steps of a window.
TIMED_STEPS, LENGTH = 1000, round(WINDOW / SETTINGS['step_size'])


def measure(quick: bool) -> dict[str, Any]:
    """Return the advice on a PUMA 560 that follows sines, or quickly on an arm of two joints."""
    robot = pfd.load_robot('planar2' if quick else 'puma560')
    machine = surroundings()
    show_progress('simulating scenes')
    scene, refused = full_scene(robot, pfd.Scene(), SETTINGS)
    motion = sine(robot, scene)
    advice = advise(robot, scene, motion, TOLERANCE, WINDOW)
    sides, rows = [], []
    for name, row in advice.rows.items():
        whole = name in (FULL, SMALLEST)
        one = {FULL: scene, SMALLEST: advice.scene}[name] if whole else scene.without({name})
        kept = None if whole else name in advice.kept
        rows.append({'name': name, **row._asdict(), 'kept': kept})
        if np.isfinite(row.error):
            sides.append(_side(name, pfd.Simulator(robot, one, **SETTINGS), motion))
    show_progress('timing')
    times = {
        side.way: {'least': 1e9 * own.minimum, 'median': 1e9 * own.median, 'times': own.times}
        for side, own in zip(
            sides, interleave(sides, TIMED_STEPS, QUICK_PACE if quick else PACE), strict=True
        )
    }
    show_progress('')
    return {
        'machine': [{'machine': machine['description']}],
        'example': [
            {
                'robot': robot.name,
                'motion': motion.name,
                'steps': len(motion.taus),
                'step_size': SETTINGS['step_size'],
                'tolerance': TOLERANCE,
                'window': WINDOW,
                'unseen': list(advice.unseen),
                'yaml': pfd.scene_to_yaml(advice.scene),
            }
        ],
        'scenes': [row | times.get(row['name'], {}) for row in rows],
        'refused': [{'name': name, 'reason': reason} for name, reason in refused.items()],
    }


def _side(name: str, simulator: pfd.Simulator, motion: Motion) -> Side:
    """
    Return the first windows of a motion, each from the motion's state.

    Over longer times the arms would come to states at which a step takes another time.
    """

    def run() -> None:
        for first in range(0, TIMED_STEPS, LENGTH):
            simulator.reset(motion.q[first], motion.qd[first])
            simulator.rollout(motion.taus[first : first + LENGTH])

    return Side(name, run, lambda: np.ones(1), reference=name == FULL)


COLUMNS: Columns = {
    'scene': lambda row: f'{"" if row["kept"] is None else "without "}{row["name"]}',
    'largest error': lambda row: 'infinite' if row['error'] is None else f'{row["error"]:.1e}',
    'at': lambda row: row['where'] or '-',
    'operations': 'operations',
    'step [ns]': lambda row: (
        f'{row["least"]:.0f} / {row["median"]:.0f}' if 'least' in row else '-'
    ),
    'full scene, times as long': lambda row: short(row['times']) if row.get('times') else '-',
    'kept': lambda row: yes(row['kept']),
}


def text(data: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    (example,), (machine,) = data['example'], data['machine']
    unseen = ', '.join(example['unseen'])
    refused = '; '.join(f'{row["name"]} ({row["reason"]})' for row in data['refused'])
    return page(
        'scene',
        **{key: value for key, value in example.items() if key not in ('unseen', 'yaml')},
        machine=paragraph(f'{machine["machine"]}.'),
        kept=', '.join(row['name'] for row in data['scenes'] if row['kept']) or 'nothing',
        unseen=paragraph(f'Left out, but not tested by the motion: {unseen}.') if unseen else None,
        refused=paragraph(f'Not simulated: {refused}.') if refused else None,
        scenes=table(COLUMNS, data['scenes']),
        yaml='\n'.join(f'    {line}' for line in example['yaml'].splitlines()),
    )
