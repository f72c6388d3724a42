# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report`: tables and plots, measured on this machine; and the page of a log."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys

import pfd_core as pfd
from pfd_core.report import pages
from pfd_core.report.cases.quantities import QUANTITIES
from pfd_core.report.measure.progress import reported
from pfd_ros.cli import log_page
from pfd_ros.cli.terminal import ended_by_signals, progress_on
from pfd_ros.text import one_line

LOG = 'one HTML page of a log: what went wrong first, and its curves; opens without network'
HELP = (
    'make tables and plots, measured on this machine, or the page of a log; '
    'without a name every page, within half an hour'
)
EXAMPLE = 'pfd report --quick'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the kinds of report, and the arguments of each."""
    _add_common_arguments(parser)
    kinds = parser.add_subparsers(dest='what', metavar='WHAT')
    shown = {name: (page.title, page.command) for name, page in pages.kinds().items()}
    for name, (text, example) in {**shown, 'log': (LOG, 'log run.mcap --out run.html')}.items():
        kind = kinds.add_parser(
            name, help=text, description=text, epilog=f'example: pfd report {example}'
        )
        if name == 'log':
            log_page.add_arguments(kind)
            continue
        if name == 'scene':
            _add_scene_arguments(kind)
        _add_common_arguments(kind, quick=name != 'scene')
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


def _add_common_arguments(parser: argparse.ArgumentParser, quick: bool = True) -> None:
    """Add the options that are allowed before and after the name of a page."""
    # A default of the page's parser would replace a value given before the name.
    parser.add_argument(
        '--out',
        type=Path,
        default=argparse.SUPPRESS,
        help=f'folder for the pages; default ./{pages.FOLDER}, quickly ./{pages.QUICK_FOLDER}',
        metavar='DIR',
    )
    if quick:
        parser.add_argument(
            '--quick',
            action='store_true',
            default=argparse.SUPPRESS,
            help='few rounds, cases and states, to see that it works; the pages say so',
        )


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
    quick = getattr(given, 'quick', False)
    if quick and given.what in ('log', 'scene'):
        raise ValueError(f'{given.what} takes no --quick')
    if given.what == 'log':
        return log_page.run(given)
    # Also SIGTERM and SIGHUP end the processes and compilers that measure.
    with ended_by_signals(), reported():
        return _measure(given, quick)


def _measure(given: argparse.Namespace, quick: bool) -> int:
    folder = getattr(given, 'out', None) or (pages.QUICK_FOLDER if quick else pages.FOLDER)
    if given.what is None:
        return _run_all(folder, quick)
    if given.what == 'speed' and given.quantity:
        from pfd_core.report import quantity_pages

        found = quantity_pages.run(folder, given.quantity, given.against_error, quick)
    elif given.what == 'scene':
        found = _run_scene(given, folder)
    else:
        command = given.what + ' --against-error' * getattr(given, 'against_error', False)
        found = pages.page_of(command).make(folder, quick)
    print('\n'.join(str(page) for page in found))
    return 0


def _run_all(folder: Path, quick: bool) -> int:
    """Make every page; status 1 if one could not be made."""
    failed = False
    for found in pages.make_all(folder, quick):
        failed |= isinstance(found, str)
        print(found if isinstance(found, Path) else one_line(found), flush=True)
    return int(failed)


def _run_scene(given: argparse.Namespace, folder: Path) -> list[Path]:
    from pfd_core.report import scene_pages
    from pfd_core.report.cases.excitations import excitation_named
    from pfd_core.report.measure.scene_effects import full_scene
    from pfd_ros.cli.recorded_motion import read_motion

    scene = None if given.scene is None else pfd.load_scene(given.scene)
    path, name, tolerance = Path(given.trajectory), given.trajectory, given.tolerance
    if path.suffix != '.mcap' and not path.is_file():
        excitation_named(name)
        if given.robot is None:
            raise ValueError(f'the trajectory {name!r} needs a --robot')
        robot = pfd.load_robot(given.robot)
        return scene_pages.run_excited(robot, name, tolerance, folder, scene, given.window)
    refused: dict[str, str] = {}
    robot, recorded, motion = read_motion(path, given.robot, progress_on(sys.stderr))
    if scene is None:
        scene, refused = full_scene(robot, recorded, motion.settings)
    else:
        # The brakes of a recording are an input, whatever the scene.
        scene = replace(scene, brakes=True)
    return scene_pages.run(robot, scene, motion, tolerance, folder, given.window, refused)
