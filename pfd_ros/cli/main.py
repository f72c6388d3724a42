# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run the command of the arguments; errors become one line and an exit status.

Shells complete commands and options through argcomplete: the extra `completion`, and
`eval "$(register-python-argcomplete pfd)"`.

A command is imported when it runs, not with this module: `pfd sim` imports no other command, and a
signal during the imports, which take a second, ends it like a later one.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from importlib import import_module
import importlib.util
import io
import os
import sys
from typing import Any

from pfd_ros.node.main import Stop, stop_on_signals
from pfd_ros.text import one_line

# Exit status after Ctrl-C, as in shells.
INTERRUPTED = 130
# Exit status if the reader of the output closed the pipe, as after SIGPIPE.
CLOSED_PIPE = 141
NO_ROS = (
    'this command needs ROS 2 (rclpy), which is not installed; '
    "install it with: pip install 'pfd_ros[ros]'"
)


# The modules of this package that are commands, in the order of `pfd --help`.
COMMANDS = (
    *('demo', 'sim', 'replay', 'info', 'compare', 'view', 'recover'),
    *('report', 'robots', 'urdf', 'doctor'),
)
NEED_ROS = {'demo', 'sim'}


def commands_of(words: Sequence[str]) -> dict[str, Any]:
    """Import the command of the first word, or all; none imports rclpy before it runs."""
    names = words[:1] if words and words[0] in COMMANDS else COMMANDS
    return {name: import_module(f'pfd_ros.cli.{name}') for name in names}


def parser(commands: Mapping[str, Any]) -> argparse.ArgumentParser:
    """Return the parser of some commands, given as modules by name."""
    found = argparse.ArgumentParser(
        prog='pfd', description='A simulated robot arm: torques in, joint states out.'
    )
    subparsers = found.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, command in commands.items():
        command.add_arguments(
            subparsers.add_parser(
                name,
                help=command.HELP,
                description=command.HELP,
                epilog=f'example: {command.EXAMPLE}',
                formatter_class=argparse.RawDescriptionHelpFormatter,
            )
        )
    return found


def _complete(line: str) -> int:
    """Answer the shell that completes a line; it has been set up by argcomplete."""
    try:
        import argcomplete
    except ImportError:
        return 1
    argcomplete.autocomplete(parser(commands_of(line.split()[1:])))
    return 0


def main(args: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status, 0 only for success."""
    words = list(sys.argv[1:] if args is None else args)
    if '_ARGCOMPLETE' in os.environ:
        return _complete(os.environ.get('COMP_LINE', ''))
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Names in files and of files may have characters that a terminal has not.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        node = words[:1] == ['sim'] or (words[:1] == ['replay'] and '--publish' in words)
        return _run(words, stop_on_signals() if node else None)
    except KeyboardInterrupt:
        _close_output()
        return INTERRUPTED
    except BrokenPipeError:
        # `pfd info LOG | head -1`: the reader has what it wanted.
        _close_output()
        return CLOSED_PIPE


def _run(words: list[str], stop: Stop | None) -> int:
    commands = commands_of(words)
    # Arguments for ROS, which argparse would reject.
    cut = words.index('--ros-args') if '--ros-args' in words else len(words)
    try:
        given = parser(commands).parse_args(words[:cut])
    finally:
        # The text of --help, while a closed pipe can still be reported.
        if sys.stdout is not None:
            sys.stdout.flush()
    given.ros_args, given.stop = words[cut:], stop
    if given.ros_args and given.command != 'sim':
        print(f'pfd: {given.command} takes no --ros-args', file=sys.stderr)
        return 2
    asked = getattr(given, 'publish', False) or getattr(given, 'live', False)
    needs_ros = given.command in NEED_ROS or asked
    if needs_ros and importlib.util.find_spec('rclpy') is None:
        print(f'pfd: {NO_ROS}', file=sys.stderr)
        return 1
    try:
        status: int = commands[given.command].run(given)
        # While a full disk or a closed pipe can still be reported.
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as error:
        _close_output()
        if sys.stderr is not None:
            print(one_line(f'pfd {given.command}: {error}'), file=sys.stderr)
        return 1
    return status


def _close_output() -> None:
    """Flush the output; without errors at exit if it cannot be written."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (ValueError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == '__main__':
    raise SystemExit(main())
