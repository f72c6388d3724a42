# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The URDF of a xacro file, by the package xacro.

Where a file is expanded, `$(find NAME)` asks this project for the folder of a package: the index
that xacro asks comes with ROS. Files have the encoding that they declare, whatever the locale is.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
import io
import json
from pathlib import Path
import sys
from types import ModuleType
from typing import Any

from pfd_core.forking import no_fork
from pfd_core.model.apart import answer_of
from pfd_core.model.packages import find_package
from pfd_core.model.values import listed, quote, quote_all

GIVE = "give others by xacro={'NAME': VALUE}, or `pfd urdf FILE NAME:=VALUE --out arm.urdf`"
# Characters of a reason, and of an argument with its value; arguments in a list.
LONGEST_REASON, LONGEST_ARGUMENT, MOST_LISTED = 2000, 32, 8


def expanded(path: Path, arguments: Mapping[str, object]) -> str:
    """Return the URDF of a xacro file and its arguments; ValueError if there is none."""
    with no_fork:
        from importlib.util import find_spec

    label = quote(str(path))
    given = {name: _text(name, value) for name, value in arguments.items()}
    xacro = find_spec('xacro')
    if xacro is None or xacro.origin is None:  # None: a folder of that name
        raise ValueError(
            f'{label} needs the package xacro, which is not installed: run `pip install xacro` '
            'or `apt install ros-jazzy-xacro`'
        )
    words = str(path.absolute()), json.dumps(given)
    result = answer_of(__name__, words, 'xacro', label)
    known, reason = result['known'], result['reason']
    unknown = [name for name in given if name not in known]
    has = f'its arguments are {_listed(known)}' if known else 'it has no arguments'
    if reason:
        reason = repr(' '.join(reason.split()))[1:-1][:LONGEST_REASON]
        if known:
            none = f', {quote_all(unknown)} is none of them' if unknown else ''
            reason += f'; {has}{none}; {GIVE}'
        raise ValueError(f'xacro cannot expand {label}: {reason}')
    if unknown:
        raise ValueError(f'{label} has no argument {quote_all(unknown)}; {has}')
    text: str = result['text']
    return text


def _text(name: object, value: object) -> str:
    """Return the value of an argument as `name:=value` has it."""
    if not isinstance(name, str) or not name:
        raise ValueError(f'xacro must have names of arguments as keys, got {quote(name)}')
    if not isinstance(value, (str, int, float)):
        raise ValueError(f'xacro[{quote(name)}] must be a text or a number, got {quote(value)}')
    return str(value).lower() if isinstance(value, bool) else str(value)


def _listed(known: Mapping[str, str | None]) -> str:
    """Return arguments and short values."""
    written = {name: f'{name}:={value or ""}' for name, value in known.items()}
    names = [name if len(text) > LONGEST_ARGUMENT else text for name, text in written.items()]
    return listed([*map(quote, names)], MOST_LISTED)


class _Arguments(dict[str, str]):
    """The arguments of an expansion, and those that the file declares or reads, with defaults."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.known: dict[str, str | None] = {}

    def __contains__(self, name: object) -> bool:
        self.known.setdefault(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.known.setdefault(name)
        return super().__getitem__(name)


def answer(path: str, given: str) -> None:
    """Expand a file in this process, which ends after it, and write the result as JSON."""
    xacro: Any = import_module('xacro')
    no_value: Any = import_module('xacro.substitution_args').ArgException
    decoded: Any = import_module('pfd_core.model.loading').decoded
    xacro.open = lambda name: io.StringIO(decoded(Path(name).read_bytes()))

    sources: list[str] = []

    def find(name: str) -> str:
        # Files that are being read, the innermost first, then all others that were included.
        files = dict.fromkeys([*reversed(xacro.filestack), *xacro.all_includes, path])
        for file in files:
            found = find_package(name, Path(file).parent)
            if found is not None:
                sources.extend([str(found)] * (found.parent.name != 'share'))
                return str(found)
        raise LookupError(
            f'package {quote(name)} is not found: AMENT_PREFIX_PATH does not have it, and no '
            f'package.xml above {quote(xacro.filestack[-1])} or beside its package states that '
            'name; put it beside that package'
        )

    index = ModuleType('ament_index_python.packages')
    index.get_package_share_directory = find  # type: ignore[attr-defined]
    sys.modules['ament_index_python'] = ModuleType('ament_index_python')
    sys.modules[index.__name__] = index
    arguments, text, reason = _Arguments(json.loads(given)), '', ''
    try:
        xacro.init_stacks(path)
        for node in xacro.parse(None, path).getElementsByTagName('xacro:arg'):
            arguments.known[node.getAttribute('name')] = node.getAttribute('default')
        text = xacro.process_file(path, mappings=arguments).toxml()
    except Exception as error:  # whatever the file provokes
        cause: Any = error
        while getattr(cause, 'exc', None) is not None:
            cause = cause.exc
        # xacro prints what `find` raises twice.
        reason = str(cause) if type(cause) is LookupError else f'{type(cause).__name__}: {error}'
        if isinstance(cause, no_value):
            name, default = str(cause), arguments.known.get(str(cause)) or 'VALUE'
            reason = (
                f'argument {quote(name)} has no value where it is read; give it by xacro='
                f'{{{name!r}: {default!r}}}, or `pfd urdf FILE {name}:={default} --out arm.urdf`'
            )
        lost = isinstance(cause, FileNotFoundError) and str(cause.filename)
        gone = [folder for folder in Path(lost or '.').parents if not folder.exists()]
        named = [x for x in arguments.known if gone and arguments.get(x) == gone[-1].name]
        if named:
            others = sorted(x.name for x in gone[-1].parent.iterdir() if x.is_dir())
            reason += f'; argument {quote(named[0])} is {gone[-1].name!r}, not in {listed(others)}'
        elif lost and any(lost.startswith(source) for source in sources):
            reason += '; the sources of a package may lack what it installs: source its workspace'
        if xacro.filestack and xacro.filestack[-1] != path:
            reason += f' (in {xacro.filestack[-1]})'
    known = {name: arguments.get(name, default) for name, default in arguments.known.items()}
    sys.stdout.write(json.dumps({'text': text, 'reason': reason, 'known': known}))
