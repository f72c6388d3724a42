# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay LOG --publish`: the options of the node that publishes a log."""

from __future__ import annotations

import argparse
import math
from typing import Any

from pfd_ros.cli.terminal import number, pair
from pfd_ros.node.main import ignore_signals, stop_on_signals

# Of the player; and of its clock, without a number like `ros2 bag play --clock`.
RATES, CLOCK_HZ, CLOCK_RATES = (1e-3, 1e3), 40.0, (1e-3, 1e4)
# Longest offset and duration, s: a century.
LONGEST = 3.2e9
# Options without effect on other commands than --publish, with their defaults.
DEFAULTS: dict[str, Any] = {
    'rate': 1.0,
    'loop': False,
    'start_offset': 0.0,
    'duration': math.inf,
    'topics': None,
    'remap': [],
    'clock': None,
    'start_paused': False,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `--publish` and its options."""
    group = parser.add_argument_group(
        'publish the log',
        'The node `log_player` publishes the messages of a recording or of any bag (MCAP, .db3, '
        'folder of rosbag2) at their log times, but no commands unless --topics names them. It '
        'has the services ~/pause and ~/step and the parameters rate and seek_to.',
    )
    add = group.add_argument
    offset, duration = number('start offset', 0.0, LONGEST), number('duration', 1e-9, LONGEST)
    clock = f'publish the log time on /clock (default {CLOCK_HZ:g} Hz), unless the log has it'
    early = 'start S seconds after the first message; latched messages from before are sent first'
    add('--publish', action='store_true', help='publish the messages of the log')
    add('--rate', type=number('rate', *RATES), metavar='X', help='speed (default 1)')
    add('--loop', action='store_true', help='begin again at the end')
    add('--start-offset', type=offset, metavar='S', help=early)
    add('--duration', type=duration, metavar='S', help='stop after S seconds of log time')
    add('--topics', nargs='+', metavar='TOPIC', help='only these topics; may name commands')
    remap = 'publish topic A of the log on B; may be repeated'
    add('--remap', type=pair(':='), action='append', metavar='A:=B', help=remap)
    rate = number('clock', *CLOCK_RATES)
    add('--clock', nargs='?', const=CLOCK_HZ, type=rate, metavar='HZ', help=clock)
    add('--start-paused', action='store_true', help='wait for ~/pause with false')
    parser.set_defaults(**DEFAULTS)


def run(given: argparse.Namespace) -> int:
    """Publish a log; see `play` for the exit status and the errors."""
    from pfd_ros.replay.playlist import PlayOptions
    from pfd_ros.replay.publish import play

    options = PlayOptions(
        rate=given.rate,
        loop=given.loop,
        start_offset=given.start_offset,
        duration=given.duration,
        topics=given.topics,
        remaps=given.remap,
        clock_hz=given.clock,
        start_paused=given.start_paused,
    )
    try:
        return play(given.log, options, given.stop or stop_on_signals())
    finally:
        ignore_signals()
