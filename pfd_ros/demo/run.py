# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: run the node and a controller as two processes, then check and show the log.

Recording, its page, parameters and the output of both processes are written to one folder; a later
run adds further files. The processes use a separate ROS domain, without variables of the
environment that connect to other systems.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import itertools
import json
import os
from pathlib import Path
import re
import secrets
import sys
import time
from typing import Any

import numpy as np
import yaml

import pfd_core as pfd
from pfd_ros.arm.events import STATES
from pfd_ros.demo import scenario
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.page.page import TYPES, page
from pfd_ros.recording.arrays import LogArrays, read_log
from pfd_ros.replay.compare import compare
from pfd_ros.replay.verify import verify
from pfd_ros.testing.domains import FIRST, LAST, environment, own_domain
from pfd_ros.testing.process import ChildProcess
from pfd_ros.text import one_line
from pfd_ros.view.ports import OPENED, check_page
from pfd_ros.view.process import ViewProcess

# For discovery and compilation on a busy machine, for an end, and for somebody to open a page.
START_SECONDS, STOP_SECONDS, PAGE_SECONDS, POLL_SECONDS = 60.0, 20.0, 20.0, 0.05
# The arm brakes this long after the controller ended, s; longer than delays on a busy machine.
TIMEOUT_SECONDS = 0.5
# At depth 1 a newer command may replace a waiting one; the demo counts every command.
COMMAND_DEPTH = 10
COMMANDS = 'joint_commands'
# Tolerance of the mean period, relative.
RATE_TOLERANCE = 0.01
# Largest tracking error of a working controller, rad or m; without commands the arm falls.
TRACKING_LIMIT = 0.1


def run_demo(robot_name: str, seconds: float, folder: Path, view_port: int | None = None) -> int:
    """
    Run the demo and print its results; return 0 only if all of it worked.

    Parameters
    ----------
    robot_name : str
        A robot that `pfd robots` lists.
    seconds : float
        Simulated length of the motion [s].
    folder : Path
        For the files; created if missing.
    view_port : int, optional
        Port of a page that shows the arm in 3D meanwhile, 0 for any; default no page.

    Raises
    ------
    ValueError
        If the robot is unknown or the length is not positive, or the page cannot be served.
    OSError
        If the files cannot be written.

    """
    if not 0 < seconds < float('inf'):
        raise ValueError(f'--seconds must be above 0, got {seconds!r}')
    if view_port is not None:
        check_page(view_port)
    robot = pfd.load_robot(robot_name)
    folder.mkdir(parents=True, exist_ok=True)
    names = (folder / f'arm_{number}' for number in itertools.count())
    base = next(name for name in names if not name.with_suffix('.mcap').exists())
    # A unique name, in case the domain is used by others.
    namespace = f'/pfd_demo_{secrets.token_hex(4)}'
    depth = {f'{namespace}/{COMMANDS}': {'subscription': {'depth': COMMAND_DEPTH}}}
    parameters = {
        'robot': robot_name,
        'recording': f'{base}.mcap',
        'command_timeout': TIMEOUT_SECONDS,
        'qos_overrides': depth,
        **scenario.parameters(robot, seconds),
    }
    text = yaml.safe_dump({'/**': {'ros__parameters': parameters}})
    Path(f'{base}.yaml').write_text(text, encoding='utf-8')
    print(f'{robot_name}: arm and controller for {seconds:g} s, recorded to {base}.mcap')
    # Not the domain of the environment, where an arm may be running.
    avoided = os.environ.get('ROS_DOMAIN_ID', '')
    start = secrets.randbelow(LAST - FIRST + 1)
    view = None
    with own_domain(start=start, avoided=avoided) as domain:
        env = environment(os.environ, domain)
        try:
            if view_port is not None:
                view = ViewProcess(view_port, robot_name, Path(f'{base}.view.txt'), env)
                _show_page(view, f'{namespace}/sim_arm')
            report, problems = _processes(robot_name, seconds, base, namespace, env)
            if view is not None and view.ended():
                problems.append(f'{view.ended()}, see {view.output}')
        finally:
            if view is not None:
                view.stop()
    if report is not None:
        try:
            problems += _results(base, robot, report)
        except (ValueError, OSError) as error:
            problems.append(str(error))
    for problem in problems:
        print(one_line(f'FAILED: {problem}'), file=sys.stderr)
    if not problems:
        print('everything worked')
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


def _processes(
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
    if problems:
        return None, problems
    return json.loads(output.read_text(encoding='utf-8').splitlines()[-1]), []


def _results(base: Path, robot: pfd.Robot, report: Mapping[str, int]) -> Iterator[str]:
    """Print what the log shows, write its page, and yield the problems."""
    path = base.with_suffix('.mcap')
    found = verify(path)
    print(f'replay     {found.cycles} cycles simulated again: every bit equal')
    if not found.complete:
        yield 'the recording was not closed'
    log = read_log(path, types=TYPES)
    topics = {role: topic for topic, role in log.roles.items()}
    if len(log[topics[STATES]]) < 2:
        yield 'the recording has no states'
        return
    slow = _rate(log, topics[STATES])
    off = _tracking(log, (topics[STATES], topics[COMMANDS]))
    if off > TRACKING_LIMIT and not slow:
        yield f'the arm was {off:.3g} off its motion, expected {TRACKING_LIMIT} at most'
    sent, recorded = report['sent'], len(log[topics[COMMANDS]])
    print(f'commands   sent {sent}, recorded {recorded}, lost {sent - recorded}')
    shown = page(log, robot=robot)
    shown.write(base.with_suffix('.html'))
    yield from shown.unreadable
    print(f'page       {base}.html: {shown.said}')
    print(f'look       pfd view {path}')


def _rate(log: LogArrays, topic: str) -> bool:
    """Print the rate of the states; return whether the machine is too slow for it."""
    states = log[topic]
    stamps = np.asarray(states.stamp_ns, float)
    period = float(np.median(np.diff(stamps))) / NANOSECONDS
    periods = np.diff(states.log_ns) / NANOSECONDS
    jitter = np.quantile(np.abs(periods - period), (0.5, 0.99, 1.0)) * 1e6
    rate, expected = 1 / periods.mean(), 1 / period
    print(
        f'rate       {rate:.2f} Hz of {expected:g} Hz; jitter: median {jitter[0]:.0f} us, 99 % '
        f'{jitter[1]:.0f} us, largest {jitter[2]:.0f} us'
    )
    slow = bool(rate < (1 - RATE_TOLERANCE) * expected)
    if slow:
        print('           this machine is too slow for real time now: see `pfd doctor`, clock')
    return slow


def _tracking(log: LogArrays, topics: tuple[str, str]) -> float:
    """Print how far the positions are from the reference; return the largest error, rad or m."""
    found = compare(log, log, topics=topics, lag=0.0)
    errors = [item for item in found.differences if item.field == 'position']
    print('tracking   joint                    rms      largest')
    for item in errors:
        print(f'           {item.joint:18s} {item.rms:12.3e} {item.largest:12.3e}')
    return max((item.largest for item in errors), default=np.inf)
