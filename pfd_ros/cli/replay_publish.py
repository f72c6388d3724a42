# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay LOG --publish`: the options of the node that publishes a log."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import math
from typing import Any

from pfd_ros.node.main import ignore_signals, stop_on_signals
from pfd_ros.recording.bags import bag_of
from pfd_ros.replay.schedule import RATES

# Without a number, like `ros2 bag play --clock`.
CLOCK_HZ = 40.0
CLOCK_RATES = (1e-3, 1e4)
# Longest offset and duration, s: a century.
LONGEST_SECONDS = 3.2e9
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
    group.add_argument('--publish', action='store_true', help='publish the messages of the log')
    group.add_argument(
        '--rate', type=_number('rate', *RATES), metavar='X', help='speed (default 1)'
    )
    group.add_argument('--loop', action='store_true', help='begin again at the end')
    group.add_argument(
        '--start-offset',
        type=_number('start offset', 0.0, LONGEST_SECONDS),
        metavar='S',
        help='start S seconds after the first message; transient local messages from before it '
        'are sent first',
    )
    group.add_argument(
        '--duration',
        type=_number('duration', 1e-9, LONGEST_SECONDS),
        metavar='S',
        help='stop after S seconds of log time',
    )
    group.add_argument(
        '--topics', nargs='+', metavar='TOPIC', help='publish only these topics; may name commands'
    )
    group.add_argument(
        '--remap',
        type=_remap,
        action='append',
        metavar='A:=B',
        help='publish topic A of the log on B; may be repeated',
    )
    group.add_argument(
        '--clock',
        nargs='?',
        const=CLOCK_HZ,
        type=_number('clock', *CLOCK_RATES),
        metavar='HZ',
        help=f'publish the log time on /clock (default {CLOCK_HZ:g} Hz), unless the log has it',
    )
    group.add_argument('--start-paused', action='store_true', help='wait for ~/pause with false')
    parser.set_defaults(**DEFAULTS)


def run(given: argparse.Namespace) -> int:
    """Publish a log; see `play` for the exit status and the errors."""
    from pfd_ros.node.log_player import PlayOptions, play  # needs rclpy

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
        return play(bag_of(given.logs), options, given.stop or stop_on_signals())
    finally:
        ignore_signals()


def conflict(given: argparse.Namespace) -> str:
    """Return why these options exclude each other, '' if they do not."""
    if given.publish:
        others = [name for name in ('verify', 'allow_incomplete') if getattr(given, name)]
        others += [] if given.what_if is None else ['what_if']
        return f'--publish and {_option(others[0])} exclude each other' if others else ''
    unused = [name for name, value in DEFAULTS.items() if getattr(given, name) != value]
    return f'{_option(unused[0])} requires --publish' if unused else ''


def _option(name: str) -> str:
    return f'--{name.replace("_", "-")}'


def _number(name: str, least: float, most: float) -> Callable[[str], float]:
    """Return a parser of a number within bounds."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f'{name} is {text!r}, expected a number from {least:g} to {most:g}'
            )
        return value

    return parse


def _remap(text: str) -> tuple[str, str]:
    name, sign, published = text.partition(':=')
    if not (name and sign and published):
        raise argparse.ArgumentTypeError(f'{text!r} is not a remapping, expected A:=B')
    return name, published
