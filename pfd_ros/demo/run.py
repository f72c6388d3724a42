# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: run the node and a controller as two processes, then check and show the log.

Recording, its page, parameters and the output of both processes are written to one folder; a later
run adds further files. The processes use a separate ROS domain, without variables of the
environment that connect to other systems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib.util import find_spec
import itertools
import os
from pathlib import Path
import re
import secrets
import sys
import time

import numpy as np
import yaml

import pfd_core as pfd
from pfd_ros.arm.events import STATES
from pfd_ros.demo import scenario
from pfd_ros.extras import install
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.page.curves import Reference, commanded_positions
from pfd_ros.page.page import TYPES, page
from pfd_ros.page.recorded import Recorded
from pfd_ros.recording.arrays import LogArrays, read_log
from pfd_ros.replay.verify import verify
from pfd_ros.testing.domains import FIRST, LAST, environment, own_domain
from pfd_ros.testing.process import ChildProcess
from pfd_ros.text import one_line
from pfd_ros.view.ports import OPENED, check_page, view_process

# For discovery and compilation on a busy machine, for an end, and for somebody to open a page.
START_SECONDS, STOP_SECONDS, PAGE_SECONDS, POLL_SECONDS = 60.0, 20.0, 20.0, 0.05
# The arm brakes this long after the controller ended, s; longer than delays on a busy machine.
TIMEOUT_SECONDS = 0.5
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
    parameters = {
        'robot': robot_name,
        'recording': f'{base}.mcap',
        'command_timeout': TIMEOUT_SECONDS,
        **scenario.parameters(robot, seconds),
    }
    text = yaml.safe_dump({'/**': {'ros__parameters': parameters}})
    Path(f'{base}.yaml').write_text(text, encoding='utf-8')
    print(f'{robot_name}: arm and controller, {seconds:g} s of motion, recorded to {base}.mcap')
    problems: list[str] = []
    # Not the domain of the environment, where an arm may be running.
    avoided = os.environ.get('ROS_DOMAIN_ID', '')
    start = secrets.randbelow(LAST - FIRST + 1)
    with own_domain(start=start, avoided=avoided) as domain, ExitStack() as ends:
        env, view = environment(os.environ, domain), None
        if view_port is not None:
            output = Path(f'{base}.view.txt')
            view = view_process(f'{namespace}/sim_arm', view_port, robot_name, output, env)
            ends.callback(view.stop)
            _show_page(view)
        # /clock is absolute, so a namespace does not change it.
        ros = ['--ros-args', '-r', f'__ns:={namespace}', '-r', '/clock:=clock']
        motion = ['--robot', robot_name, '--seconds', str(seconds)]
        arm, controller = (
            ChildProcess([sys.executable, '-m', *words], Path(f'{base}.{name}.txt'), env)
            for name, words in (
                ('sim_arm', ['pfd_ros.node.main', *ros, '--params-file', f'{base}.yaml']),
                ('controller', ['pfd_ros.demo.controller', *motion, *ros]),
            )
        )
        # The kernel ends both with this process; Ctrl-C comes as an exception.
        for child in (arm, controller):
            ends.callback(child.stop, STOP_SECONDS)
        # Without the arm the controller would wait forever.
        _wait(lambda: controller.end() or arm.end(), START_SECONDS + 4 * seconds)
        for child in (controller, arm):
            status = child.stop(STOP_SECONDS)
            if status:
                problems.append(f'a process ended with status {status}, see {child.output}')
        if view is not None and view.end():
            problems.append(f'the 3D view {view.end()}, see {view.output}')
    if not problems:
        try:
            problems += _results(base, robot, seconds)
        except (ValueError, OSError) as error:
            problems.append(str(error))
    for problem in problems:
        print(one_line(f'FAILED: {problem}'), file=sys.stderr)
    if not problems:
        print('everything worked')
    return 1 if problems else 0


def _wait(done: Callable[[], object], seconds: float) -> None:
    """Return when something is done, or after some time."""
    deadline = time.monotonic() + seconds
    while not done() and time.monotonic() < deadline:
        time.sleep(POLL_SECONDS)


def _show_page(view: ChildProcess) -> None:
    """Print the address of a view, and wait for a browser to open it, or for some time."""
    _wait(lambda: 'http://' in view.text() or view.end(), START_SECONDS)
    for url in re.findall(r'^http://\S+', view.text(), re.MULTILINE):
        print(
            f'view       {url}: the arm starts when a browser opens it, in {PAGE_SECONDS:g} s '
            'at the latest',
            flush=True,
        )
        _wait(lambda: OPENED in view.text() or view.end(), PAGE_SECONDS)


def _results(base: Path, robot: pfd.Robot, seconds: float) -> Iterator[str]:
    """Print what the log shows, write its page, and yield the problems."""
    path = base.with_suffix('.mcap')
    found = verify(path)
    print(f'replay     {found.cycles} cycles simulated again: every bit equal')
    if not found.complete:
        yield 'the recording was not closed'
    log = read_log(path, types=TYPES)
    states = log.topic_of(STATES)
    if len(log[states]) < 2:
        yield 'the recording has no states'
        return
    shown = page(log)
    run = shown.run
    begin, end = run.span
    rest = 'at rest before and after it'
    print(f'           {end - begin:.3f} s: {seconds:g} s of motion, {rest}')
    slow = _rate(log, states)
    for heading, line in zip(['tracking', *[''] * robot.n], shown.joints, strict=False):
        print(f'{heading:10s} {line}')
    off = max((_error(run, item) for item in commanded_positions(run)), default=np.inf)
    if off > TRACKING_LIMIT and not slow:
        yield f'the arm was {off:.3g} off its motion, expected {TRACKING_LIMIT} at most'
    shown.write(base.with_suffix('.html'))
    yield from run.unreadable
    print(f'page       {base}.html: {shown.said}')
    # As typed here: the environment may not be active, and the view is an extra.
    typed = sys.argv[0] if Path(sys.argv[0]).name == 'pfd' else 'pfd'
    print(f'look       {typed} view {path}')
    if find_spec('viser') is None:
        print(f'           needs {install("view")}')


def _error(run: Recorded, reference: Reference) -> float:
    """Return how far the joint of a reference was from it at most."""
    (joints,), (name,) = run.joints, reference.names
    q = joints.values['position'][:, joints.names.index(name)]
    return float(np.nanmax(np.abs(q - reference.at(name, joints.time))))


def _rate(log: LogArrays, topic: str) -> bool:
    """Print the rate of the states; return whether the machine is too slow for it."""
    states = log[topic]
    assert states.stamp_ns is not None
    expected = NANOSECONDS / float(np.median(np.diff(states.stamp_ns)))
    rate = NANOSECONDS / float(np.diff(states.log_ns).mean())
    print(f'rate       {rate:.2f} Hz of {expected:g} Hz')
    slow = bool(rate < (1 - RATE_TOLERANCE) * expected)
    if slow:
        print('           this machine is too slow for real time now: see `pfd doctor`, clock')
    return slow
