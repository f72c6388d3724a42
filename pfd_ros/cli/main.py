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
from typing import NoReturn

from pfd_ros.cli.terminal import Command
from pfd_ros.extras import install
from pfd_ros.node.main import Stop, stop_on_signals
from pfd_ros.text import listed, one_line

# Exit status after Ctrl-C, as in shells; and if the reader of the output closed the pipe, as after
# SIGPIPE.
INTERRUPTED, CLOSED_PIPE = 130, 141
# Of the reason why a command fails; that of xacro names files and arguments.
LONGEST_ERROR = 800
NO_ROS = 'this command needs ROS 2 (rclpy): source the setup.bash of Jazzy, or '
# The module of each command, in the order of `pfd --help`. A module has the mapping COMMANDS.
COMMANDS = {
    'demo': 'small',
    'sim': 'small',
    'init': 'small',
    'replay': 'logs',
    'info': 'logs',
    'compare': 'logs',
    'view': 'view',
    'recover': 'logs',
    'report': 'report',
    'send': 'send',
    'robots': 'small',
    'urdf': 'small',
    'doctor': 'doctor',
}


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, with control characters escaped."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and end with status 2."""
        self.exit(2, one_line(f'{self.prog}: {message}; see {self.prog} --help') + '\n')


def commands_of(words: Sequence[str]) -> dict[str, Command]:
    """Import the command of the first word, or all; none imports rclpy before it runs."""
    names = words[:1] if words and words[0] in COMMANDS else [*COMMANDS]
    modules = {name: import_module(f'pfd_ros.cli.{COMMANDS[name]}') for name in names}
    return {name: module.COMMANDS[name] for name, module in modules.items()}


def parser(commands: Mapping[str, Command]) -> argparse.ArgumentParser:
    """Return the parser of some commands, by name."""
    found = Parser(prog='pfd', description='A simulated robot arm: torques in, joint states out.')
    found.add_argument('--version', action='store_true', help='print the version')
    subparsers = found.add_subparsers(dest='command', metavar='COMMAND')
    for name, command in commands.items():
        added = subparsers.add_parser(
            name,
            help=command.help,
            description=command.help,
            epilog=f'example: {command.example}',
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.arguments(added)
    return found


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
        try:
            return _run(words, stop_on_signals() if node else None)
        finally:
            # While a full disk or a closed pipe can still be reported; the text of --help too.
            if sys.stdout is not None:
                sys.stdout.flush()
    except KeyboardInterrupt:
        status, line = INTERRUPTED, ''
    except BrokenPipeError:
        # `pfd info LOG | head -1`: the reader has what it wanted.
        status, line = CLOSED_PIPE, ''
    except (ValueError, OSError) as error:
        status, line = 1, str(error)
        if isinstance(error, OSError) and error.filename is not None and error.strerror:
            line = f'{error.filename}: {error.strerror}'
    _close_output()
    if line and sys.stderr is not None:
        print(one_line(f'pfd {words[0]}: {line}', LONGEST_ERROR), file=sys.stderr)
    return status


def _run(words: list[str], stop: Stop | None) -> int:
    commands = commands_of(words)
    # Arguments for ROS, which argparse would reject.
    cut = words.index('--ros-args') if '--ros-args' in words else len(words)
    parse = parser(commands)
    given, unknown = parse.parse_known_args(words[:cut])
    if given.version:
        import pfd_core as pfd

        print(f'pfd {pfd.__version__}')
        return 0
    if given.command is None:
        parse.error(f'no COMMAND, expected one of {", ".join(COMMANDS)}')
    given.ros_args, given.stop = [*unknown, *words[cut:]], stop  # the node names what is unknown
    if given.ros_args and given.command != 'sim':
        parse.prog += f' {given.command}'
        parse.error(f'unknown arguments {listed(given.ros_args)}')
    command = commands[given.command]
    if command.needs_ros(given) and importlib.util.find_spec('rclpy') is None:
        print(f'pfd: {NO_ROS}{install("ros")}', file=sys.stderr)
        return 1
    return command.run(given)


def _complete(line: str) -> int:
    """Answer the shell that completes a line; it has been set up by argcomplete."""
    try:
        import argcomplete
    except ImportError:
        return 1
    argcomplete.autocomplete(parser(commands_of(line.split()[1:])))
    return 0


def _close_output() -> None:
    """Flush the output; without errors at exit if it cannot be written."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (ValueError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == '__main__':
    raise SystemExit(main())
