# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view`: the arm of a log or of a running node in 3D, in a browser."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
import math
import os
from pathlib import Path
import sys
import threading
from typing import Any
import webbrowser

from pfd_ros.cli.terminal import ended_by_signals, port_number, print_lines, progress_on
from pfd_ros.text import listed, one_line
from pfd_ros.view.ports import OPENED, PORT, check_installed

HELP = 'show the arm of a log or of a running node in 3D, in a browser'
EXAMPLE = 'pfd view run.mcap --open'
# What browsers on a display need, or a browser that the user has chosen.
DISPLAYS = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the log and what is shown of it."""
    parser.add_argument(
        'log', type=Path, nargs='?', metavar='LOG', help='MCAP file, .db3 file or rosbag2 folder'
    )
    parser.add_argument(
        '--live', action='store_true', help='show a running arm, from its joint_states; needs ROS'
    )
    parser.add_argument(
        '--robot',
        metavar='ROBOT',
        help='the model, in place of the one in the log or on robot_description: a .urdf, .xacro '
        'or .yaml file, or a name that `pfd robots` lists',
    )
    parser.add_argument('--topic', metavar='TOPIC', help='the topic of joint states')
    parser.add_argument(
        '--node',
        metavar='NODE',
        help='with --live: the node of the arm, such as /left/sim_arm (default: the publisher of '
        'the joint states)',
    )
    parser.add_argument(
        '--wrench-topic',
        metavar='TOPIC',
        help="a topic of WrenchStamped to draw, in place of the arm's external wrench",
    )
    parser.add_argument(
        '--force-scale',
        type=_newtons,
        metavar='N',
        help='force of an arrow of 1 m, N (default: by the weight of the arm; the page states it)',
    )
    parser.add_argument(
        '--ghost',
        type=Path,
        metavar='LOG',
        help='a second log, shown translucent',
    )
    parser.add_argument(
        '--ghost-topic',
        metavar='TOPIC',
        help='the topic of joint states of the ghost, such as commanded positions; without '
        '--ghost a topic of the same log',
    )
    parser.add_argument(
        '--package-path',
        action='append',
        type=Path,
        default=[],
        metavar='FOLDER',
        help='a package with meshes, or a folder of packages; may be repeated',
    )
    parser.add_argument(
        '--port',
        type=port_number,
        default=PORT,
        metavar='N',
        help=f'port of the page on this computer (default {PORT}; 0: any free one)',
    )
    parser.add_argument(
        '--export',
        type=Path,
        metavar='FILE',
        help='write one .html file that plays the log without Python or a network, and end',
    )
    parser.add_argument('--open', action='store_true', help='open the page in the browser')


def run(given: argparse.Namespace) -> int:
    """Show a log or a running arm until Ctrl-C, or write a page."""
    check_installed()
    with ended_by_signals():
        return _run(given)


def _run(given: argparse.Namespace) -> int:
    if given.live:
        unused = ('log', 'ghost', 'ghost_topic', 'export')
        others = [name for name in unused if getattr(given, name)]
        if others:
            raise ValueError(f'--live shows a running arm: it takes no {listed(others)}')
        with suppress(KeyboardInterrupt):
            _live(given)
        return 0
    if given.log is None:
        raise ValueError('name a log, or show a running arm with --live')
    if given.node is not None:
        raise ValueError('--node names a running arm: it needs --live')
    return _log(given)


def _log(given: argparse.Namespace) -> int:
    from pfd_ros.view import export, logged_arm, server
    from pfd_ros.view.player import Player

    folders = tuple(given.package_path)
    content = logged_arm.content_of(
        given.log,
        given.robot,
        given.topic,
        folders,
        wrench_topic=given.wrench_topic,
        newtons=given.force_scale,
    )
    print_lines(content.lines)
    ghost = None
    if given.ghost or given.ghost_topic:
        path, robot = given.ghost or given.log, None if given.ghost else given.robot
        ghost = logged_arm.content_of(path, robot, given.ghost_topic, folders, content.seen.urdf)
        print_lines(f'ghost: {line}' for line in ghost.lines)
        if logged_arm.offset_of(content.motion, ghost.motion) is None:
            print_lines(['ghost: the logs have no time in common: both start at 0'])
    if given.export:
        size = export.export(content, ghost, given.export, progress_on(sys.stderr))
        print(f'{given.export} plays {given.log.name} in a browser ({size / 1e6:.1f} MB)')
        return 0
    with server.page(given.port, given.log.name) as page:
        player = Player(page.gui, content.motion, logged_arm.fill(page, content, ghost))
        with suppress(KeyboardInterrupt):
            _announce(server.address(page), given.log.name, given.open)
            player.run(threading.Event())
    return 0


def _live(given: argparse.Namespace) -> None:
    from pfd_ros.view import live, server
    from pfd_ros.view.live_arm import LiveArm
    from pfd_ros.view.mesh_files import MeshFolders
    from pfd_ros.view.motion import folder_of, named_model

    named = None if given.node is None else live.arm_node(given.node)
    namespace = '/' if named is None else named.namespace
    # Before anything is waited for: a port in use is an error at once.
    with server.page(given.port, 'live') as page, live.view_node(namespace) as node:
        topics = live.LiveTopics(node, given.topic, named, given.wrench_topic)
        page.on_client_connect(_report_browser())
        found = topics.model() if given.robot is None else given.robot
        urdf = named_model(found) if isinstance(found, str) else found
        folder = folder_of(None, found if isinstance(found, str) else None)
        folders = MeshFolders(folder, tuple(given.package_path))
        arm = LiveArm(page, urdf, folders, given.force_scale)
        print_lines(arm.problems)
        shown = given.node or given.topic or live.TOPIC
        _announce(server.address(page), shown, given.open)
        live.follow(topics, arm, lambda line: print_lines([line]))


def _report_browser() -> Callable[[Any], None]:
    """Return a function that reports the first browser that opens the page."""
    opened = threading.Event()

    def report(_: Any) -> None:
        if not opened.is_set():
            opened.set()
            print(OPENED, flush=True)

    return report


def _announce(url: str, shown: str, browse: bool) -> None:
    """Print the address of a page, and open it if that was asked."""
    print(f'{url} shows {one_line(shown)}; Ctrl-C ends it', flush=True)
    if not browse:
        return
    # A browser in this terminal would take it over.
    hidden = sys.platform == 'linux' and not any(os.environ.get(name) for name in DISPLAYS)
    if hidden:
        print(f'no display for --open: open {url} yourself', flush=True)
    elif not webbrowser.open(url):
        print(f'no browser was found for --open: open {url} yourself', flush=True)


def _newtons(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f'force must be above 0 N, got {text!r}')
    return value
