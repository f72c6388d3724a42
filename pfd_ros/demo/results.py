# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The results of the demo, from its recording: rate, jitter, tracking, losses, replay, plot."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import STATES
from pfd_ros.demo.bare_timer import missing_share
from pfd_ros.demo.scenario import PUSH_BEGIN, PUSH_END, motion_of, payload_mass, push_force
from pfd_ros.messages.convert import NANOSECONDS, decode_joint_state
from pfd_ros.recording.reader import Log
from pfd_ros.replay.summary import Summary
from pfd_ros.replay.verify import read

# Tolerance of the mean period, relative.
RATE_TOLERANCE = 0.01
# Largest tracking error of a working controller, rad or m; without commands the arm falls.
TRACKING_LIMIT = 0.1


@dataclass(frozen=True)
class States:
    """All recorded states: times in ns (count,), positions (count, n); messages by role."""

    logged_ns: NDArray[Any]
    stamp_ns: NDArray[Any]
    position: NDArray[Any]
    names: tuple[str, ...]
    messages: Counter[str]


def read_states(path: Path) -> States:
    """Return the states of a recording, and the number of its messages by role."""
    messages: Counter[str] = Counter()
    logged, states = [], []
    for entry in Log(path).entries():
        messages[entry.role] += 1
        if entry.role == STATES:
            logged.append(entry.log_ns)
            states.append(decode_joint_state(entry.data))
    return States(
        np.array(logged),
        np.array([state.stamp_ns for state in states]),
        np.array([state.position for state in states]),
        states[0].names if states else (),
        messages,
    )


def show_results(
    base: Path, robot: pfd.Robot, report: Mapping[str, int], woke: array[int], period: float
) -> list[str]:
    """Print the results, write the plot and return the problems.

    Parameters
    ----------
    base
        The recording's path without `.mcap`; the plot has the same name.
    robot
        The robot of the demo.
    report
        Counts of the controller: `sent` commands, motion from `start_ns` to `end_ns` in
        simulated time.
    woke, period
        Wake-up times of a bare timer loop alongside the arm, and its period, s.

    Raises
    ------
    LogError
        If the recording is damaged or does not replay to the same bits.
    """
    path = base.with_suffix('.mcap')
    states = read_states(path)
    if not len(states.position):
        return [f'{path} has no states']
    motion = motion_of(robot)
    moving = (states.stamp_ns >= report['start_ns']) & (states.stamp_ns < report['end_ns'])
    t = (states.stamp_ns[moving] - report['start_ns']) / NANOSECONDS
    wanted, shown = motion.at(t)[0], states.position[moving]
    span = int(states.logged_ns[0]), int(states.logged_ns[-1])
    bare_off = missing_share(woke, *span, period)
    late = _show_rate(states)
    if len(shown):
        late += _show_tracking(states.names, wanted, shown)
    remarks, problems = unless_busy(late, bare_off)
    if not len(shown):
        problems.append('the arm never moved')
    for remark in remarks:
        print(f'           {remark}')
    sent, recorded = report['sent'], states.messages['joint_commands']
    print(
        f'commands   sent {sent}, recorded {recorded}, lost {sent - recorded}\n'
        f'file       {path}, {path.stat().st_size / 1e6:.2f} MB, '
        f'{states.messages.total()} messages'
    )
    problems += _show_replay(read(path, verify=True))
    _plot(base.with_suffix('.png'), robot, t, wanted, shown)
    return problems


def _show_rate(states: States) -> list[str]:
    period = (states.stamp_ns[-1] - states.stamp_ns[0]) / (len(states.stamp_ns) - 1) / 1e6
    steps = np.diff(states.logged_ns) / 1e6
    off = abs(steps.mean() / period - 1)
    result = 'within' if off <= RATE_TOLERANCE else 'NOT within'
    jitter = np.abs(steps - period) * 1e3
    print(
        f'rate       {1e3 / steps.mean():.2f} Hz, mean period {steps.mean():.5f} ms, '
        f'{result} {RATE_TOLERANCE:.0%} of {period:g} ms\n'
        f'jitter     of the period: p50 {np.percentile(jitter, 50):.0f} us, '
        f'p99 {np.percentile(jitter, 99):.0f} us, max {jitter.max():.0f} us'
    )
    return [] if off <= RATE_TOLERANCE else [f'the rate is {off:.1%} off']


def unless_busy(late: list[str], bare_off: float) -> tuple[list[str], list[str]]:
    """
    Return remarks and problems: lateness on a machine that is too busy is not a problem.

    Parameters
    ----------
    late
        Findings that late steps or commands can cause: a low rate, or a joint off its motion.
    bare_off
        The share of its periods that a bare timer loop lost at the same time.
    """
    lost = f'a bare timer loop lost {bare_off:.1%} of its periods at the same time'
    if bare_off > RATE_TOLERANCE:
        return [f'{item}, but this machine is too busy: {lost}' for item in late], []
    return [], [f'{item}; {lost}' for item in late]


def _show_tracking(names: tuple[str, ...], wanted: NDArray[Any], shown: NDArray[Any]) -> list[str]:
    error = shown - wanted
    rms, most = np.sqrt((error**2).mean(axis=0)), np.abs(error).max(axis=0)
    print('tracking   joint                    rms          max')
    for name, one, other in zip(names, rms, most, strict=True):
        print(f'           {name:18s} {one:12.3e} {other:12.3e}')
    if most.max() <= TRACKING_LIMIT:
        return []
    return [f'the arm was {most.max():.3g} off its motion, expected {TRACKING_LIMIT} at most']


def _show_replay(summary: Summary) -> list[str]:
    print(f'replay     {summary.states} states, {summary.steps} steps: every bit equal')
    problems = []
    if not summary.complete:
        problems.append('the recording was not closed')
    if summary.missing:
        problems.append(f'{summary.missing} states are missing in the recording')
    return problems


def _plot(
    path: Path, robot: pfd.Robot, t: NDArray[Any], wanted: NDArray[Any], shown: NDArray[Any]
) -> None:
    """Plot commanded and simulated positions and their difference, if matplotlib is installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print("plot       none: needs matplotlib, pip install 'pfd_ros[report]'")
        return
    figure = Figure(figsize=(9, 1.3 * robot.n + 0.7), layout='constrained')
    rows = figure.subplots(robot.n, 2, sharex=True, squeeze=False)
    for i, (position, error) in enumerate(rows):
        unit = 'm' if robot.joint_types[i] == 'prismatic' else 'rad'
        position.plot(t, wanted[:, i], color='0.65', linewidth=3, label='commanded')
        position.plot(t, shown[:, i], color='C0', linewidth=1, label='simulated')
        position.set_ylabel(f'{robot.joint_names[i]}, {unit}')
        error.axhline(0.0, color='0.65', linewidth=1)
        error.plot(t, 1e3 * (shown[:, i] - wanted[:, i]), color='C3', linewidth=1)
        error.set_ylabel(f'm{unit}')
        if t.size:
            error.axvspan(PUSH_BEGIN * t[-1], PUSH_END * t[-1], color='C1', alpha=0.2, linewidth=0)
    (position, error), final = rows[0], rows[-1]
    position.set_title('position')
    position.legend(loc='upper right', fontsize='small')
    error.set_title('simulated - commanded (shaded: push)')
    for axes in final:
        axes.set_xlabel('simulated time, s')
    figure.suptitle(
        f'{robot.name}: the controller knows links and rotors; the arm also has friction, '
        f'{payload_mass(robot):.2g} kg at the tip, and a push of {push_force(robot)[0]:.2g} N',
        fontsize='medium',
    )
    figure.savefig(path, dpi=120)
    print(f'plot       {path}')
