# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An example of the product's advice on a scene: what `pfd report scene` prints."""

from __future__ import annotations

from typing import Any

from benchmarks.table import Columns, page, table, yes
import pfd_core as pfd
from pfd_ros.advice import advise, full_scene, sine
from pfd_ros.advice.motions import SETTINGS
from pfd_ros.advice.scene import FULL, SMALLEST

TOLERANCE, WINDOW = 1e-3, 0.1


def measure(quick: bool) -> dict[str, Any]:
    """Return the advice on a PUMA 560 that follows sines, or quickly on an arm of two joints."""
    robot = pfd.load_robot('planar2' if quick else 'puma560')
    scene, refused = full_scene(robot, pfd.Scene(), SETTINGS)
    motion = sine(robot, scene)
    advice = advise(robot, scene, motion, TOLERANCE, WINDOW)
    rows = [
        {
            'name': name,
            **row._asdict(),
            'kept': None if name in (FULL, SMALLEST) else name in advice.kept,
        }
        for name, row in advice.rows.items()
    ]
    return {
        'robot': robot.name,
        'motion': motion.name,
        'steps': len(motion.taus),
        'unseen': list(advice.unseen),
        'yaml': pfd.scene_to_yaml(advice.scene),
        'scenes': rows,
        'refused': '; '.join(f'{name} ({why})' for name, why in refused.items()) or 'none',
    }


COLUMNS: Columns = {
    'scene': lambda row: f'{"" if row["kept"] is None else "without "}{row["name"]}',
    'largest error': lambda row: 'infinite' if row['error'] is None else f'{row["error"]:.1e}',
    'at': lambda row: row['where'] or '-',
    'operations': 'operations',
    'kept': lambda row: yes(row['kept']),
}


def text(data: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    return page(
        'scene',
        **{key: data[key] for key in ('robot', 'motion', 'steps')},
        tolerance=TOLERANCE,
        window=WINDOW,
        step_size=SETTINGS['step_size'],
        kept=', '.join(row['name'] for row in data['scenes'] if row['kept']) or 'nothing',
        unseen=', '.join(data['unseen']) or 'none',
        refused=data['refused'],
        scenes=table(COLUMNS, data['scenes']),
        yaml='\n'.join(f'    {line}' for line in data['yaml'].splitlines()),
    )
