# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first finding of a log as a pytest that fails today, and passes once it is fixed.

Of a recording the test runs the arm again, with the recorded inputs or a controller in the loop;
what no simulation computes, and the log of another arm, is tested as it was recorded.
"""

from __future__ import annotations

from importlib.machinery import PathFinder
from importlib.util import find_spec
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
from typing import NamedTuple

from pfd_ros.files import new_file
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.motion.symptoms import FAULTS, UNCOMMANDED
from pfd_ros.page.findings import NOTE, Finding
from pfd_ros.page.page import faults
from pfd_ros.page.recorded import Recorded
from pfd_ros.recording.format import LogError
from pfd_ros.testing.again import named_controller
from pfd_ros.text import one_line


class Row(NamedTuple):
    """The assertion that a kind of finding breaks, or why there is none."""

    code: str = ''
    why: str = ''
    simulated: bool = True  # whether a simulation of the arm may show it


_ABSENT = 'assert findings(run, {kind!r}, {joint!r}{robot}) == []'
# Kinds of findings of a page, then of symptoms of a joint.
ASSERTIONS: dict[str, Row] = {
    **{
        f'{item} limit': Row(f'motion.assert_no_limit_hit({item!r}, joint={{joint!r}})')
        for item in JOINT_FIELDS
    },
    **dict.fromkeys(('not finite', 'gap', 'diagnostics'), Row(_ABSENT, simulated=False)),
    **dict.fromkeys(('rejected input', 'reflex', 'watchdog'), Row(_ABSENT)),
    'failure': Row('assert not motion.stopped'),
    'event': Row(why='it is no fault'),
    **dict.fromkeys(FAULTS, Row(_ABSENT)),
    UNCOMMANDED: Row('assert motion.commanded[motion.index({joint!r})], {kind!r}'),
    **dict.fromkeys(
        ('decaying oscillation', 'offset', 'tracking', 'motion'),
        Row(why='a log holds no bound beyond which it is a fault'),
    ),
    **dict.fromkeys(
        ('end stop', 'torque limit', 'first limit'), Row(why='a limit is a finding by itself')
    ),
}


HINTS = (
    "It replays the recorded inputs; replayed(LOG, run, ['payload.mass=2']) changes the arm.",
    'It has the controller in the loop: once that is fixed, the test passes.',
)
TEST = """# {about}
# Written by `pfd report log --pytest`, which saw it fail.
# {hint}

{imports}
from pfd_ros.testing import {used}

HERE = Path(__file__).resolve().parent
LOG = HERE / {log!r}
{controller}

def test_{name}({fixture}):
    {body}
"""
# The seconds in which a test is to end.
PATIENCE = 600.0
# Pytest without the current folder on its path, as other calls of it are.
PYTEST = 'import sys; del sys.path[0]; import pytest; sys.exit(pytest.main(sys.argv[1:]))'


def write_test(run: Recorded, file: Path, controller: str = '', robot: str = '') -> list[str]:
    """Write the first finding as a new pytest, and run it; return lines about it.

    `controller` is module:function, and `robot` the robot that was named for a log without one.
    ValueError without pytest or a finding, for a controller that it cannot run, and if the test
    does not fail by the finding: nothing is written then. OSError if the file exists or cannot be
    written.
    """
    log = run.log.path
    if find_spec('pytest') is None:
        cure = shlex.join([sys.executable, '-m', 'pip', 'install', 'pytest'])
        raise ValueError(f'the test that is written is run, which needs pytest: {cure}')
    if not re.fullmatch(r'test_\w+\.py', file.name):
        raise ValueError(f'pytest collects test_*.py, got the name {file.name!r}')
    if file.exists():
        raise FileExistsError(f'{file} exists and is not overwritten; name another file')
    found = [x for x in faults(run) if x.severity != NOTE or ASSERTIONS[x.kind].code]
    if not found:
        notes = ''.join(f'; {note}' for note in run.notes)
        raise LogError(f'{log}: nothing went wrong, so there is no finding to test{notes}')
    first = found[0]
    joint = f'{first.joint}: ' if first.joint else ''
    said = one_line(f't = {first.time:.3f} s, {first.kind}: {joint}{first.text}')
    if controller and not (ASSERTIONS[first.kind].simulated and run.settings):
        raise ValueError(f'--controller: no simulation of {log} shows its first finding, {said}')
    if controller:
        named_controller(controller)
    with new_file(file, 'x', encoding='utf-8') as stream:
        stream.write(_source(run, file, first, said, controller, robot))
        stream.flush()
        failure = _failure(file)
        # In a loop, a rejected command ends the run.
        own = first.kind == 'rejected input' and 'RejectedError' in failure
        if not failure.startswith(('assert', 'AssertionError')) and not own:
            other = '; without --controller it replays the recorded commands' * bool(controller)
            raise ValueError(
                f'{file} is not written: a test of the first finding, {said}, does not fail by '
                f'it: {failure or "it passes"}{other}'
            )
    return [f'first: {said}', f'{file} fails today: {failure}', f'python -m pytest {file}']


def _source(
    run: Recorded, file: Path, first: Finding, said: str, controller: str, robot: str
) -> str:
    """Return the text of a test; of the log it has reprs, and a comment of one line."""
    log, (module, _, attribute) = run.log.path, controller.partition(':')
    code, _, simulated = ASSERTIONS[first.kind]
    simulated = simulated and bool(run.settings)
    named = str(Path(robot).resolve()) if Path(robot).is_file() else robot
    more = f', robot={named!r}' if robot and not simulated else ''
    code = code.format(kind=first.kind, joint=first.joint, robot=more)
    if simulated:
        given = ', controller=CONTROLLER' if controller else ''
        body = ["run = tmp_path / 'run.mcap'", f'motion = replayed(LOG, run{given})', code]
        body += ['assert not motion.stopped']
    else:
        begin = (
            f'motion = recorded(LOG, {first.joint!r}{more})' if 'motion' in code else 'run = LOG'
        )
        body = [begin, code]
    folder, imports, beside = file.parent.resolve(), ['from pathlib import Path'], ''
    if controller:
        called = f'import_module({module!r}).{attribute}'
        imports.insert(0, 'from importlib import import_module')
        others = [x for x in sys.path if Path(x).resolve() != Path.cwd()]
        if PathFinder.find_spec(module.partition('.')[0], others) is None:
            imports.append('import sys')
            way = os.path.relpath(Path.cwd(), folder)
            beside = f'sys.path.insert(0, str(HERE / {way!r}))\n'
    used = [name for name in ('findings', 'recorded', 'replayed') if f'{name}(' in str(body)]
    return TEST.format(
        about=f'{one_line(log.name)}: {said}',
        hint=HINTS[bool(controller)] if simulated else 'It reads the log: record it again.',
        imports='\n'.join(imports) + '\n',
        controller=f'{beside}CONTROLLER = {called}\n' if controller else '',
        used=', '.join(used),
        log=os.path.relpath(log.resolve(), folder),
        name=re.sub('[^a-z0-9]+', '_', f'{first.kind} {first.joint}'.lower()).strip('_'),
        fixture='tmp_path' if simulated else '',
        body='\n    '.join(dict.fromkeys(body)),
    )


def _failure(file: Path) -> str:
    """Run a test; return in one line how it fails, '' if it passes."""
    try:
        done = subprocess.run(
            [sys.executable, '-c', PYTEST, '-q', '-p', 'no:cacheprovider', '-rfE', str(file)],
            env={**os.environ, 'PYTHONDONTWRITEBYTECODE': '1', 'COLUMNS': '1000'},
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return f'it has not ended after {PATIENCE:g} s'
    line = re.search(r'^(?:FAILED|ERROR) .*?\.py\S*(?: - )?(.*)', done.stdout, re.MULTILINE)
    if done.returncode and line is None:
        return one_line(f'pytest ends with status {done.returncode}: {done.stderr or done.stdout}')
    return one_line(line[1]) if line else ''
