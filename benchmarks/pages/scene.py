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
from benchmarks.table import Columns, page, short, table, yes
from benchmarks.timing import Pace, surroundings, take_turns
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
    whole, refused = full_scene(robot, pfd.Scene(), SETTINGS)
    motion = sine(robot, whole)
    advice = advise(robot, whole, motion, TOLERANCE, WINDOW)
    effects = [name for name in advice.rows if name not in (FULL, SMALLEST)]
    # The first is the reference of the times.
    scenes = {FULL: whole, **{name: whole.without({name}) for name in effects}}
    scenes[SMALLEST] = advice.scene
    finite = [name for name in scenes if np.isfinite(advice.rows[name].error)]
    sides = [
        _side(name, pfd.Simulator(robot, scenes[name], **SETTINGS), motion) for name in finite
    ]
    show_progress('timing')
    rows = {name: {'name': name, **row._asdict()} for name, row in advice.rows.items()}
    for name, row in rows.items():
        row['kept'] = name in advice.kept if name in effects else None
    found = take_turns(sides, TIMED_STEPS, QUICK_PACE if quick else PACE)
    for name, times in zip(finite, found, strict=True):
        least, median = 1e9 * times.minimum, 1e9 * times.median
        rows[name] |= {'least': least, 'median': median, 'times': times.times}
    return {
        'machine': machine,
        'robot': robot.name,
        'motion': motion.name,
        'steps': len(motion.taus),
        'unseen': list(advice.unseen),
        'yaml': pfd.scene_to_yaml(advice.scene),
        'scenes': list(rows.values()),
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

    return Side(name, run, lambda: simulator.q)


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
    unseen = ', '.join(data['unseen'])
    refused = '; '.join(f'{row["name"]} ({row["reason"]})' for row in data['refused'])
    return page(
        'scene',
        **{key: data[key] for key in ('robot', 'motion', 'steps')},
        tolerance=TOLERANCE,
        window=WINDOW,
        step_size=SETTINGS['step_size'],
        machine=data['machine'],
        kept=', '.join(row['name'] for row in data['scenes'] if row['kept']) or 'nothing',
        unseen=unseen or 'none',
        refused=refused or 'none',
        scenes=table(COLUMNS, data['scenes']),
        yaml='\n'.join(f'    {line}' for line in data['yaml'].splitlines()),
    )
