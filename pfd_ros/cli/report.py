# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report`: tables and plots, measured on this machine; and the page of a log."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys

import pfd_core as pfd
from pfd_core.report.cases.quantities import QUANTITIES
from pfd_ros.cli import log_page
from pfd_ros.cli.terminal import progress_on

REPORTS = {
    'counts': 'steps of every method compared with the paper, fewer processors, and its errata',
    'paper': 'the paper executed: its claims, PCGM to convergence, the array; some minutes',
    'speed': 'times compared with other libraries, some ten minutes',
    'hard-cases': 'errors of ill-conditioned forward dynamics, some ten minutes',
    'controlled-arm': 'time against error of a UR5 under a controller; some minutes',
    'mechanisms': 'errors of the default compared with pinocchio.aba, some minutes',
    'scene': 'cost and error of each effect of a scene, and the smallest scene within a tolerance',
    'log': 'one HTML page of a log: what went wrong first, and its curves; opens without network',
}
# Reports that can be made in a few rounds.
QUICK = ('speed', 'controlled-arm')
HELP = 'make tables and plots, measured on this machine, or the page of a log'
EXAMPLE = 'pfd report log run.mcap'
EXAMPLES = {
    'scene': 'pfd report scene --robot puma560 --trajectory sine --tolerance 1e-3',
    'log': 'pfd report log run.mcap --out run.html',
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the kinds of report, and the arguments of each."""
    kinds = parser.add_subparsers(dest='what', required=True, metavar='WHAT')
    for name, text in REPORTS.items():
        kind = kinds.add_parser(
            name,
            help=text,
            description=text,
            epilog=f'example: {EXAMPLES.get(name, f"pfd report {name}")}',
        )
        if name == 'log':
            log_page.add_arguments(kind)
            continue
        kind.add_argument(
            '--out', type=Path, help='folder for the pages; default ./pfd_report', metavar='DIR'
        )
        if name == 'scene':
            _add_scene_arguments(kind)
        if name == 'speed':
            kind.add_argument(
                '--against-error',
                action='store_true',
                help='time against error of every method, integrator and peer',
            )
            kind.add_argument(
                '--quantity',
                choices=sorted(QUANTITIES),
                metavar='NAME',
                help='one quantity and forward dynamics, for more robots: %(choices)s',
            )
        if name in QUICK:
            kind.add_argument('--quick', action='store_true', help='a few rounds only')


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--robot', help='a robot that `pfd robots` lists, or a file; default: the robot of the log'
    )
    parser.add_argument(
        '--trajectory',
        required=True,
        metavar='LOG.mcap|NAME',
        help='a recording, or the name of a motion: swing, sine, steps',
    )
    parser.add_argument(
        '--tolerance',
        required=True,
        type=float,
        help='largest error of a joint position, rad or m',
    )
    parser.add_argument(
        '--scene',
        type=Path,
        metavar='FILE',
        help='the full scene; default: all effects in the model and the settings of the log',
    )
    parser.add_argument(
        '--window', type=float, default=0.1, help='length of an open-loop window, s; default 0.1'
    )


def run(given: argparse.Namespace) -> int:
    """Measure, or read a log; write the pages and print their paths."""
    if given.what == 'log':
        return log_page.run(given)
    from pfd_core.report import (
        against_error_pages,
        controlled_arm_pages,
        counts_pages,
        hard_case_pages,
        mechanism_pages,
        paper_pages,
        quantity_pages,
        speed_pages,
    )

    folder = given.out or Path('pfd_report')
    if given.what == 'speed' and given.quantity:
        return quantity_pages.run(folder, given.quantity, given.against_error, given.quick)
    if given.what == 'speed':
        run_speed = against_error_pages.run if given.against_error else speed_pages.run
        return run_speed(folder, quick=given.quick)
    if given.what == 'controlled-arm':
        return controlled_arm_pages.run(folder, quick=given.quick)
    if given.what == 'scene':
        pages = _run_scene(given, folder)
    else:
        runs = {
            'counts': counts_pages.run,
            'hard-cases': hard_case_pages.run,
            'mechanisms': mechanism_pages.run,
            'paper': paper_pages.run,
        }
        pages = runs[given.what](folder)
    print('\n'.join(str(page) for page in pages))
    return 0


def _run_scene(given: argparse.Namespace, folder: Path) -> list[Path]:
    from pfd_core.report import scene_pages
    from pfd_core.report.cases import excitations
    from pfd_core.report.measure.scene_effects import full_scene
    from pfd_ros.cli.recorded_motion import read_motion

    scene = pfd.Scene() if given.scene is None else pfd.load_scene(given.scene)
    refused: dict[str, str] = {}
    path = Path(given.trajectory)
    if path.suffix == '.mcap' or path.is_file():
        robot, recorded, motion = read_motion(path, given.robot, progress_on(sys.stderr))
        # The brakes of a recording are an input, whatever the scene.
        scene = recorded if given.scene is None else replace(scene, brakes=True)
        if given.scene is None:
            scene, refused = full_scene(robot, scene, motion.settings)
    else:
        excitations.excitation_named(given.trajectory)
        if given.robot is None:
            raise ValueError(f'the trajectory {given.trajectory!r} needs a --robot')
        robot = pfd.load_robot(given.robot)
        if given.scene is None:
            scene, refused = full_scene(robot, scene, excitations.SETTINGS)
        motion = excitations.excited_motion(robot, scene, given.trajectory)
    return scene_pages.run(robot, scene, motion, given.tolerance, folder, given.window, refused)
