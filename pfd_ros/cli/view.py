# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view`: the arm of a log or of a running node in 3D, in a browser."""

from __future__ import annotations

import argparse
from contextlib import suppress
import os
from pathlib import Path
import sys
import threading
from typing import Any
import webbrowser

from pfd_ros.cli.terminal import (
    ANY_LOG,
    ROBOT,
    Command,
    add_port,
    add_rename,
    ended_by_signals,
    print_lines,
    progress_on,
    status_of,
)
from pfd_ros.text import listed
from pfd_ros.view.ports import OPENED, check_page

# What browsers on a display need, or a browser that the user has chosen.
DISPLAYS = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
# Options of a log, and of a running arm.
OF_LOG, OF_NODE = ('ghost', 'ghost_topic', 'export', 'rename'), ('live', 'node')


def _arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add('log', type=Path, nargs='?', metavar='LOG', help=ANY_LOG)
    add('--live', action='store_true', help='show a running arm, as without LOG; needs ROS')
    add('--node', metavar='NODE', help='the running arm (default /sim_arm), such as /left/sim_arm')
    model = f'the model, in place of the one in the log or on robot_description: {ROBOT}'
    add('--robot', metavar='ROBOT', help=model)
    add('--topic', metavar='TOPIC', help='the topic of joint states')
    wrench = "a topic of WrenchStamped to draw, in place of the arm's external wrench"
    add('--wrench-topic', metavar='TOPIC', help=wrench)
    add('--ghost', type=Path, metavar='LOG', help='a second log, shown translucent')
    ghost = (
        'the topic of joint states of the ghost, such as commanded positions; without --ghost a '
        'topic of the same log'
    )
    add('--ghost-topic', metavar='TOPIC', help=ghost)
    add_rename(parser)
    packages = 'a package with meshes, or a folder of packages; may be repeated'
    add('--package-path', action='append', default=[], type=Path, metavar='FOLDER', help=packages)
    add_port(parser)
    page = 'write one .html file that plays the log without Python or a network, and end'
    add('--export', type=Path, metavar='FILE', help=page)
    add('--open', action='store_true', help='open the page in the browser')


def _run(given: argparse.Namespace) -> int:
    """Show a log or a running arm until Ctrl-C, or write a page."""
    kind, others = ('a log', OF_NODE) if given.log else ('a running arm', OF_LOG)
    unused = [f'--{name.replace("_", "-")}' for name in others if getattr(given, name)]
    if unused:
        raise ValueError(f'the view of {kind} takes no {listed(unused)}')
    for folder in given.package_path:
        if not folder.is_dir():
            raise ValueError(f'--package-path must be a folder, got {str(folder)!r}')
    check_page(0 if given.export else given.port)
    with ended_by_signals():
        if given.log:
            return _log(given)
        with suppress(KeyboardInterrupt):
            _live(given)
        return 0


def _log(given: argparse.Namespace) -> int:
    from pfd_ros.view.logged import ShownLog
    from pfd_ros.view.page import Player, address, export, page

    packages, rename = tuple(given.package_path), dict(given.rename)
    shown = ShownLog(given.log, given.robot, given.topic, packages, rename, given.wrench_topic)
    print_lines(shown.problems)
    ghost, unreadable = None, shown.unreadable
    if given.ghost or given.ghost_topic:
        path, robot = given.ghost or given.log, None if given.ghost else given.robot
        ghost = ShownLog(path, robot, given.ghost_topic, packages, rename, other=shown.urdf)
        print_lines(f'ghost: {line}' for line in ghost.problems)
        unreadable += [f'ghost: {line}' for line in ghost.unreadable]
        if shown.offset(ghost) is None:
            print_lines(['ghost: the logs have no time in common: both start at 0'])

    status = status_of(given, unreadable)

    def fill(server: Any) -> Any:
        return shown.fill(server, ghost)

    if given.export:
        size = export(given.export, float(shown.time[-1]), fill, progress_on(sys.stderr))
        print_lines([f'{given.export} plays {given.log.name} in a browser ({size / 1e6:.1f} MB)'])
    else:
        with page(given.port, given.log.name) as server:
            player = Player(server.gui, shown.time, fill(server))
            with suppress(KeyboardInterrupt):
                _announce(address(server), given.log.name, given.open)
                player.run(threading.Event())
    return status


def _live(given: argparse.Namespace) -> None:
    from pfd_ros.view import live
    from pfd_ros.view.arm import Stage
    from pfd_ros.view.forms import draw
    from pfd_ros.view.links import named_model
    from pfd_ros.view.meshes import Meshes
    from pfd_ros.view.page import address, page

    arm = given.node or live.NODE
    arm = arm if arm.startswith('/') else f'/{arm}'
    # The page first: a port in use is an error at once.
    with page(given.port, 'live') as server, live.view_node(arm) as node:
        topics = live.topics_of(node, arm, given.topic, given.wrench_topic)
        server.on_client_connect(lambda _: _say(OPENED))
        named = given.robot and named_model(given.robot)
        urdf, folder = named or live.model_of(node, arm, topics)
        drawing = draw(urdf, Meshes(folder, tuple(given.package_path)))
        print_lines(drawing.problems)
        stage = Stage(server, urdf, drawing)
        stage.look()
        stage.show([0.0] * len(stage.joints))
        _announce(address(server), given.topic or arm, given.open)
        live.follow(node, topics, stage, _say)


def _announce(url: str, shown: str, browse: bool) -> None:
    """Print the address of a page, and open it if that was requested."""
    _say(f'{url} shows {shown}; Ctrl-C ends it')
    # A browser in this terminal would take it over.
    hidden = sys.platform == 'linux' and not any(os.environ.get(name) for name in DISPLAYS)
    if browse and (hidden or not webbrowser.open(url)):
        why = 'no display' if hidden else 'no browser was found'
        _say(f'{why} for --open: open {url} yourself')


def _say(line: str) -> None:
    """Print a line at once, for the process that reads it."""
    print_lines([line])
    sys.stdout.flush()


COMMANDS = {
    'view': Command(
        'show the arm of a log or of a running node in 3D, in a browser',
        'pfd view run.mcap --open',
        _arguments,
        _run,
        lambda given: given.log is None,
    )
}
