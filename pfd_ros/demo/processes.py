# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: run the node and a controller as two processes, then print the results.

Recording, parameters, the output of both processes and a plot are written to one folder; a later
run adds further files. The processes use a separate ROS domain, without variables of the
environment that connect to other systems.
"""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path
import re
import secrets
import sys
import time
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.settings import Settings
from pfd_ros.demo.bare_timer import bare_timer
from pfd_ros.demo.results import show_results
from pfd_ros.demo.scenario import disturbances, motion_of
from pfd_ros.recording.reader import LogError
from pfd_ros.testing.child_process import ChildProcess
from pfd_ros.testing.domains import FIRST, LAST, environment, own_domain
from pfd_ros.testing.node_process import parameters_of, write_parameters
from pfd_ros.view.ports import OPENED, check_page
from pfd_ros.view.process import ViewProcess

# For discovery and compilation on a busy machine.
START_SECONDS = 60.0
STOP_SECONDS = 20.0
POLL_SECONDS = 0.05
# For somebody to open the page of the view.
PAGE_SECONDS = 20.0
COMMAND_DEPTH = 10
# The arm brakes this long after the controller ended, s; longer than delays on a busy machine.
TIMEOUT_SECONDS = 0.5
# The period of the arm's steps, by default.
STEP_SECONDS = Settings().step_size


def free_name(folder: Path) -> Path:
    """Return the first of folder/arm_0, arm_1, ... that has no recording yet."""
    names = (folder / f'arm_{number}' for number in itertools.count())
    return next(name for name in names if not name.with_suffix('.mcap').exists())


def run_demo(robot_name: str, seconds: float, folder: Path, view_port: int | None = None) -> int:
    """Run the demo and print its results; return 0 only if all of it worked.

    Parameters
    ----------
    robot_name
        A robot that `pfd robots` lists.
    seconds
        Simulated length of the motion, s.
    folder
        Folder for the files; created if missing.
    view_port
        Port of a page that shows the arm in 3D meanwhile, 0 for any; None for no page.

    Raises
    ------
    ValueError
        If the robot is unknown or the length is not positive, or the page cannot be served.
    OSError
        If the files cannot be written.
    """
    if not 0 < seconds < float('inf'):
        raise ValueError(f'--seconds is {seconds!r}, expected a positive number')
    if view_port is not None:
        check_page(view_port)
    robot = pfd.load_robot(robot_name)
    folder.mkdir(parents=True, exist_ok=True)
    base = free_name(folder)
    # A unique name, in case the domain is used by others.
    namespace = f'/pfd_demo_{secrets.token_hex(4)}'
    settings = Settings(
        robot=robot_name,
        initial_positions=tuple(motion_of(robot).start.tolist()),
        recording=str(base.with_suffix('.mcap')),
        command_timeout=TIMEOUT_SECONDS,
        **disturbances(robot, seconds),
    )
    parameters = parameters_of(settings, robot.joint_names) | {
        # At depth 1 a newer command may replace a waiting one; the demo counts every command.
        'qos_overrides': {
            f'{namespace}/joint_commands': {'subscription': {'depth': COMMAND_DEPTH}}
        },
    }
    write_parameters(parameters, base.with_suffix('.yaml'))
    print(f'{robot_name}: arm and controller for {seconds:g} s, recorded to {base}.mcap')
    # Not the domain of the environment, where an arm may be running.
    avoided = os.environ.get('ROS_DOMAIN_ID', '')
    start = secrets.randbelow(LAST - FIRST + 1)
    with own_domain(start=start, avoided=avoided) as domain:
        env = environment(os.environ, domain)
        view = None
        if view_port is not None:
            view = ViewProcess(view_port, robot_name, Path(f'{base}.view.txt'), env)
        try:
            if view is not None:
                _show_page(view, f'{namespace}/sim_arm')
            with bare_timer(STEP_SECONDS) as woke:
                report, problems = _run_processes(robot_name, seconds, base, namespace, env)
            if view is not None and view.ended():
                problems.append(f'{view.ended()}, see {view.output}')
        finally:
            if view is not None:
                view.stop()
    if report is not None:
        try:
            problems += show_results(base, robot, report, woke, STEP_SECONDS)
        except (LogError, OSError) as error:
            problems.append(str(error))
    for problem in problems:
        print(f'FAILED: {problem}', file=sys.stderr)
    if not problems:
        log = base.with_suffix('.mcap')
        print(f'look       pfd report log {log}; pfd view {log}\neverything worked')
    return 1 if problems else 0


def _show_page(view: ViewProcess, node: str) -> None:
    """Start the view, print its address, and wait for a browser to open it, or for some time."""
    view.start(node)
    deadline = time.monotonic() + START_SECONDS
    while (found := re.search(r'^http://\S+', view.text(), re.MULTILINE)) is None:
        if view.ended() or time.monotonic() > deadline:
            return
        time.sleep(POLL_SECONDS)
    print(
        f'view       {found[0]}: the arm starts when a browser opens it, in {PAGE_SECONDS:g} s '
        'at the latest',
        flush=True,
    )
    deadline = time.monotonic() + PAGE_SECONDS
    while OPENED not in view.text() and not view.ended() and time.monotonic() < deadline:
        time.sleep(POLL_SECONDS)


def _run_processes(
    robot_name: str, seconds: float, base: Path, namespace: str, env: dict[str, str]
) -> tuple[dict[str, Any] | None, list[str]]:
    """Run both processes; return the controller's counts and the problems."""
    # /clock is absolute, so a namespace does not change it.
    names = ['--ros-args', '-r', f'__ns:={namespace}', '-r', '/clock:=clock']
    arm_output, output = (Path(f'{base}.{name}.txt') for name in ('sim_arm', 'controller'))
    python = [sys.executable, '-m']
    node = [*python, 'pfd_ros.node.main', *names, '--params-file', f'{base}.yaml']
    options = ['--robot', robot_name, '--seconds', str(seconds)]
    arm, controller = ChildProcess(node, arm_output, env), None
    try:
        controller = ChildProcess(
            [*python, 'pfd_ros.demo.controller', *options, *names], output, env
        )
        deadline = time.monotonic() + START_SECONDS + 4 * seconds
        # Without the arm the controller would wait forever.
        while not controller.end() and not arm.end() and time.monotonic() < deadline:
            time.sleep(POLL_SECONDS)
    finally:
        controller_status = None if controller is None else controller.stop(STOP_SECONDS)
        arm_status = arm.stop(STOP_SECONDS)
    problems = [
        f'the {name} ended with status {status}, see {path}'
        for name, status, path in (
            ('controller', controller_status, output),
            ('arm', arm_status, arm_output),
        )
        if status != 0
    ]
    report: dict[str, Any] | None = None
    if not problems:
        report = json.loads(output.read_text(encoding='utf-8').splitlines()[-1])
    return report, problems
