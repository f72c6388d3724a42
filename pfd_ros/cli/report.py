# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report`: the HTML page of a log, its first finding as a test, and advice on a scene."""

from __future__ import annotations

import argparse
from dataclasses import replace
import math
from pathlib import Path
import sys

import pfd_core as pfd
from pfd_ros.cli.terminal import (
    ANY_LOG,
    ROBOT,
    Command,
    number,
    print_lines,
    progress_on,
    status_of,
)
from pfd_ros.files import existing, free_path, new_file
from pfd_ros.text import one_line

LOG = 'one HTML page of a log: what went wrong first, and its curves; opens without network'
SCENE = 'which effects of a scene a motion needs within a tolerance, and the error without each'
SINE = 'sine'


def _arguments(parser: argparse.ArgumentParser) -> None:
    pages = 'Pages of measurements (speed, errors, counts): python -m benchmarks, in a checkout'
    kinds = parser.add_subparsers(
        dest='what', metavar='WHAT', required=True, title='reports', description=pages
    )
    example = 'example: pfd report log run.mcap --out run.html'
    add = kinds.add_parser('log', help=LOG, description=LOG, epilog=example).add_argument
    add('log', type=Path, metavar='LOG', help=ANY_LOG)
    out = 'the page, never over an existing file; default ./NAME.html for NAME.mcap'
    add('--out', type=Path, metavar='FILE', help=out)
    limits = 'whose limits are checked, of a log without its robot and robot_description'
    add('--robot', help=f'the robot {limits}: {ROBOT}')
    add('--topic', metavar='TOPIC', help='the joint states, in place of the topic by its name')
    test = 'write the first finding as a new test_*.py that fails today, and run it; no page then'
    add('--pytest', type=Path, metavar='FILE', help=f'{test}, unless --out names one')
    callback = 'with --pytest: the test runs this (t, q, qd) -> tau in place of recorded commands'
    add('--controller', metavar='MODULE:FUNCTION', help=callback)
    for name in ('start', 'end'):
        when = f'{name} S seconds after the first message'
        add(f'--{name}', type=number(name, 0.0, math.inf), metavar='S', help=when)
    example = 'example: pfd report scene --robot puma560 --trajectory sine --tolerance 1e-3'
    add = kinds.add_parser('scene', help=SCENE, description=SCENE, epilog=example).add_argument
    add('--robot', help=f'{ROBOT}; default: the robot of the log')
    motion = f'a recording; or {SINE}: each joint follows a sine'
    add('--trajectory', required=True, metavar=f'LOG.mcap|{SINE}', help=motion)
    error = 'largest error of a joint position, rad or m'
    add('--tolerance', required=True, type=float, help=error)
    full = 'the full scene; default: all effects in the model and the settings of the log'
    add('--scene', type=Path, metavar='FILE', help=full)
    window = 'length of an open-loop window, s; default 0.1'
    add('--window', type=float, default=0.1, help=window)
    out = 'the smallest scene found, never over an existing file; default ./scene.yaml'
    add('--out', type=Path, metavar='FILE', help=out)


def _report(given: argparse.Namespace) -> int:
    """Read the log, or simulate the scenes; print the result and the path of the file."""
    if given.what == 'log' and given.controller and given.pytest is None:
        print('pfd report: --controller requires --pytest', file=sys.stderr)
        return 2
    parts = (given.start, given.end, given.topic) if given.what == 'log' else ()
    if any(x is not None for x in parts) and given.pytest:
        # Its test takes the whole log.
        print('pfd report: --pytest conflicts with --start, --end and --topic', file=sys.stderr)
        return 2
    out = given.out
    if given.what == 'scene' and out is None:
        out = free_path(Path('scene.yaml'))
    elif out is None and given.pytest is None:
        out = free_path(Path(f'{given.log.absolute().name.removesuffix(".mcap")}.html'))
    elif out is not None and out.exists():
        raise existing(out)
    return _log(given, out) if given.what == 'log' else _scene(given, out)


def _log(given: argparse.Namespace, out: Path | None) -> int:
    from pfd_ros.page.page import TYPES, page
    from pfd_ros.recording.arrays import read_log

    robot = None if given.robot is None else pfd.load_robot(given.robot)
    log = read_log(given.log, types=TYPES, unreadable='count', start=given.start, end=given.end)
    if (given.start, given.end) != (None, None) and not any(map(len, log.received_ns.values())):
        raise ValueError(f'{given.log} has no message between --start and --end; see pfd info')
    found = page(log, robot=robot, topic=given.topic)
    if out is not None:
        found.write(out)
        print_lines([found.said, *(f'note: {note}' for note in found.run.notes), out])
    if given.pytest is not None:
        from pfd_ros.testing.written import write_test

        print_lines(write_test(found.run, given.pytest, given.controller or '', given.robot or ''))
    return status_of(given, found.run.unreadable)


def _scene(given: argparse.Namespace, out: Path) -> int:
    from pfd_ros.advice import advise, full_scene, read_motion, sine
    from pfd_ros.advice.motions import SETTINGS
    from pfd_ros.advice.scene import lines

    scene = None if given.scene is None else pfd.load_scene(given.scene)
    refused: dict[str, str] = {}
    if given.trajectory == SINE:
        if given.robot is None:
            raise ValueError(f'--trajectory {SINE} needs a --robot')
        robot = pfd.load_robot(given.robot)
        if scene is None:
            scene, refused = full_scene(robot, pfd.Scene(), SETTINGS)
        motion = sine(robot, scene)
    else:
        if not Path(given.trajectory).exists():
            raise ValueError(
                f'--trajectory must be a recording (LOG.mcap) or {SINE}, got {given.trajectory!r}'
            )
        robot, recorded, motion = read_motion(given.trajectory, given.robot)
        if scene is None:
            scene, refused = full_scene(robot, recorded, motion.settings)
        else:
            # The brakes of a recording are an input, whatever the scene.
            scene = replace(scene, brakes=True)
    progress = progress_on(sys.stderr)
    advice = advise(robot, scene, motion, given.tolerance, given.window, progress)
    step = motion.settings['step_size']
    text = [
        f'{robot.name}, {motion.name}: {len(motion.taus)} steps of {step:g} s',
        f'tolerance {given.tolerance:g} rad or m, in windows of {given.window:g} s',
        *lines(advice),
        *(f'not simulated: {name}: {reason}' for name, reason in refused.items()),
    ]
    print_lines(text)
    with new_file(out, 'x', encoding='utf-8') as file:
        file.writelines(f'# {one_line(line)}\n' for line in ('smallest scene found of', *text))
        file.write(pfd.scene_to_yaml(advice.scene))
    print_lines([out])
    return 0


COMMANDS = {
    'report': Command(
        'the HTML page of a log, or advice on the effects that a simulated motion needs',
        'pfd report log run.mcap',
        _arguments,
        _report,
    )
}
