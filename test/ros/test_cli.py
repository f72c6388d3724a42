# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `pfd`: what each command says of good, wrong and cut logs, and its exit status."""

from __future__ import annotations

from importlib import metadata
import io
import json
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from typing import Any

from arm_messages import efforts
from packaging.requirements import Requirement
import pytest
from recordings import busy, largest_file, rewritten, simulate
from ros_processes import PATIENCE, environment

from pfd_ros.cli import doctor
from pfd_ros.cli.main import CLOSED_PIPE
from pfd_ros.cli.main import COMMANDS as PFD_COMMANDS
from pfd_ros.cli.main import commands_of as pfd_commands_of
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.cli.main import parser as pfd_parser
from pfd_ros.cli.small import COMMANDS as SMALL_COMMANDS
from pfd_ros.cli.terminal import progress_on
from pfd_ros.extras import install
from pfd_ros.testing.domains import claimed_domain

CYCLES = 60


def command(*words: str) -> tuple[int, str, str]:
    """Run a command in this process; return its status and what it printed."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, 'stdout', out)
        patch.setattr(sys, 'stderr', err)
        try:
            status = pfd_main(words)
        except SystemExit as ended:
            status = int(ended.code or 0)
    return status, out.getvalue(), err.getvalue()


def process(
    *words: str,
    cwd: Path | None = None,
    stdout: Any = subprocess.PIPE,
    program: tuple[str, ...] = ('-m', 'pfd_ros.cli.main'),
    **variables: str,
) -> Any:
    """Run a command in another process."""
    # argparse ignores errors of output that is not buffered.
    env = {k: v for k, v in environment(1).items() if k != 'PYTHONUNBUFFERED'}
    return subprocess.run(
        [sys.executable, *program, *words],
        env=env | variables,
        cwd=cwd,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=PATIENCE,
    )


@pytest.fixture(scope='module')
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording and what may become of it."""
    folder = tmp_path_factory.mktemp('logs')
    whole = folder / 'whole.mcap'
    busy(whole, CYCLES)
    busy(folder / 'other.mcap', CYCLES, payload_mass=1.0, joint_friction=(0.5, 0.0))
    chunks = rewritten(whole, folder / 'chunks.mcap', chunk=2000)
    (folder / 'cut.mcap').write_bytes(chunks.read_bytes()[: chunks.stat().st_size // 2])
    (folder / 'text.mcap').write_text('no log')
    (folder / 'empty.mcap').write_bytes(b'')
    simulate(folder / 'still.mcap', 0)
    simulate(folder / 'refused.mcap', 30, {3: [efforts(1.0)]})
    damaged = bytearray(chunks.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (folder / 'damaged.mcap').write_bytes(damaged)

    def altered(role: str, message: Any) -> Any:
        if role == 'joint_states' and message.sequence == CYCLES // 2:
            # The last bit of an effort.
            message.data = message.data[:-8] + bytes([message.data[-8] ^ 1]) + message.data[-7:]
        return message

    def ragged(role: str, message: Any) -> Any:
        if role == 'joint_states' and message.sequence == CYCLES // 2:
            message.data = message.data[:20]
        return message

    def first(name: str, values: dict[str, str]) -> dict[str, str]:
        return values | ({'format': '2'} if name == 'pfd_ros' else {})

    rewritten(whole, folder / 'altered.mcap', altered, counted=True)
    rewritten(whole, folder / 'ragged.mcap', ragged, counted=True)
    rewritten(whole, folder / 'first.mcap', metadata=first)
    return folder


# Words, status, and what is in the standard output and in the only line of the error output.
LOGS: dict[str, tuple[int, str, str]] = {
    'info whole.mcap': (0, r'/joint_states +sensor_msgs/msg/JointState +60 +every [\d.]+ ms', ''),
    'info other.mcap': (0, r'settings .* friction=\[0\.5, 0\.0\].* payload\.mass=1\.0', ''),
    'info cut.mcap': (0, r'size .*, cut off(?s:.*)settings .* damping=False.* friction=False', ''),
    'info first.mcap': (0, r'messages +\d+', ''),
    'info ragged.mcap': (1, r'messages +\d+', r'^pfd info: not read: /joint_states: '),
    'info damaged.mcap': (1, '', '^pfd info: .*damaged.mcap'),
    'info text.mcap': (1, '', '^pfd info: .*text.mcap'),
    'info empty.mcap': (1, '', '^pfd info: .*empty.mcap'),
    'info none.mcap': (1, '', r'^pfd info: none\.mcap: No such file or directory$'),
    'replay whole.mcap': (
        0,
        r'run .* 60 cycles, 0\.060 s(?s:.*)rejected +1 commands wrong_si',
        '',
    ),
    'replay cut.mcap': (0, 'cut off', ''),
    'replay first.mcap': (1, '', 'first edition of pfd_ros'),
    'replay text.mcap': (1, '', '^pfd replay: .*text.mcap'),
    'replay damaged.mcap': (1, '', '^pfd replay: .*damaged.mcap'),
    'replay whole.mcap --verify': (0, r'verified: whole.mcap: every bit equal in 60 cycles', ''),
    'replay cut.mcap --verify': (3, r'incomplete: cut.mcap: equal as far as it goes', ''),
    'replay cut.mcap --verify --allow-incomplete': (0, r'equal as far as it goes', ''),
    'replay altered.mcap --verify': (1, '', r'cycle 30, joint_states: effort\['),
    'replay damaged.mcap --verify': (1, '', '^pfd replay: .*damaged.mcap'),
    'replay first.mcap --verify': (1, '', 'first edition of pfd_ros'),
    'replay whole.mcap --what-if payload.mass=1': (0, r'whole_what_if\.mcap', ''),
    'replay whole.mcap --what-if payload.mass=1 --rounding': (0, 'rounding', ''),
    'replay cut.mcap --what-if payload.mass=1': (0, r'cut_what_if\.mcap', ''),
    'replay whole.mcap --what-if nonsense=1': (1, '', r'^pfd replay: .*nonsense'),
    'replay first.mcap --what-if payload.mass=1': (1, '', 'first edition of pfd_ros'),
    'replay damaged.mcap --what-if payload.mass=1': (1, '', '^pfd replay: .*damaged.mcap'),
    'compare whole.mcap whole.mcap': (0, 'equal', ''),
    'compare whole.mcap other.mcap': (1, 'first beyond 0', ''),
    'compare whole.mcap other.mcap --tolerance 1e9': (0, 'within 1e', ''),
    'compare whole.mcap other.mcap --tolerance 1e9 --plot a.svg': (0, 'within 1e', ''),
    'compare whole.mcap other.mcap --plot a.exe': (1, '', r'^pfd compare: .*a\.exe'),
    'replay whole.mcap --what-if payload.mass=1 --plot a.png': (0, r'whole_what_if\.mcap', ''),
    'compare whole.mcap ragged.mcap': (1, '', '^pfd compare: .*ragged.mcap'),
    'compare whole.mcap text.mcap': (1, '', '^pfd compare: .*text.mcap'),
    'compare whole.mcap whole.mcap --lag 1e9': (1, '', r'common times: .*, lag 1e\+09 s$'),
    'compare whole.mcap whole.mcap --rename shoulder=hip': (0, 'hip', ''),
    'compare whole.mcap whole.mcap --rename shoulder=elbow': (1, '', 'would have one name'),
    'compare whole.mcap whole.mcap --topics /joint_states /none': (1, '', "'/none'"),
    'recover cut.mcap': (0, r'lost (?s:.*)\d+ messages in cut\.recovered\.mcap; .*incomplete', ''),
    'recover whole.mcap': (0, r'messages in whole\.recovered\.mcap; the log was whole', ''),
    'recover damaged.mcap': (0, 'lost ', ''),
    'recover text.mcap': (1, '', '^pfd recover: .*text.mcap'),
    'report log whole.mcap': (0, r'whole\.html', ''),
    'report log cut.mcap': (0, r'cut off(?s:.*)cut\.html', ''),
    'report log first.mcap': (0, 'first edition', ''),
    'report log whole.mcap --robot ur5': (1, '', 'holds its robot, .*; robot is for other logs'),
    'report log whole.mcap --start 1e6': (1, '', 'no message between --start and --end'),
    'report log ragged.mcap': (1, r'ragged\.html', '^pfd report: not read: '),
    'report log text.mcap': (1, '', '^pfd report: .*text.mcap'),
    'view whole.mcap --export a.html': (0, r'a\.html plays whole\.mcap in a browser', ''),
    'view cut.mcap --export a.html': (0, r'cut\.mcap .*cut', ''),
    'view ragged.mcap --export a.html': (1, r'a\.html plays', r'^pfd view: not read: .*: 1 of'),
    'view text.mcap --export a.html': (1, '', '^pfd view: .*text.mcap'),
    'view whole.mcap --export a.html --topic /none': (1, '', "'/none'"),
    'view whole.mcap --export a.html --rename shoulder=hip': (
        0,
        r"not in the model: \['hip'\]",
        '',
    ),
    'view whole.mcap --export a.html --rename shoulder=a elbow=b': (1, '', r"\['a', 'b'\]"),
    'view whole.mcap --export a.html --package-path no': (1, '', r"must be a folder, got 'no'"),
    'view whole.mcap --export no/a.html': (1, '', r'^pfd view: no/a\.html: No such file'),
    'view whole.mcap --node /sim_arm --live': (1, '', r"of a log takes no \['--live', '--node'\]"),
    'view --export a.html': (1, '', r"takes no \['--export'\]|needs ROS 2"),
    **{
        f'report scene --out small.yaml --tolerance 1e-3 --trajectory {words}': (1, '', error)
        for words, error in (
            ('dance', "^pfd report: .*--trajectory.*'dance'"),
            ('sine', '--trajectory.*--robot'),
            ('whole.mcap --tolerance nan', 'tolerance'),
            ('whole.mcap --window 0', 'window'),
            ('whole.mcap --robot ur5', "(?=.*'elbow')(?=.*'ur5')"),
            ('whole.mcap --robot nobody', "'nobody'"),
            ('whole.mcap --scene nix.yaml', "'nix.yaml'"),
            ('whole.mcap --out text.mcap', r'text\.mcap.*exists'),
            ('refused.mcap', '(?=.*no torques)(?=.*30 steps)'),
            ('text.mcap', r'text\.mcap'),
            ('still.mcap', r'still\.mcap'),
        )
    },
}
# The same of commands that need ROS.
WITH_ROS: dict[str, tuple[int, str, str]] = {
    'replay empty.mcap --publish': (1, '', r'^pfd replay: .*is empty \(0 bytes\)'),
    'replay text.mcap --publish': (1, '', '^pfd replay: .*is a text'),
    'replay damaged.mcap --publish': (1, '', r'^pfd replay: .*damaged\.mcap is damaged'),
    'replay whole.mcap --publish --topics /nix': (1, '', r"has no topic \['/nix'\]"),
    'replay whole.mcap --publish --start-offset 9': (1, '', 'start offset 9 s'),
    'demo --out out --seconds 0': (1, '', '^pfd demo: --seconds must be above 0, got 0.0'),
    'demo --out out --seconds nan': (1, '', '^pfd demo: --seconds must be above 0, got nan'),
    'demo --out out --seconds inf': (1, '', '^pfd demo: --seconds must be above 0, got inf'),
    'demo --out out --robot r2d2': (1, '', "^pfd demo: unknown robot 'r2d2'"),
}


@pytest.mark.parametrize(
    'words', [*LOGS, *(pytest.param(words, marks=pytest.mark.ros) for words in WITH_ROS)]
)
def test_a_command_says_what_it_read_and_its_status_is_true(words, logs, tmp_path, monkeypatch):
    status, printed, error = (LOGS | WITH_ROS)[words]
    for path in logs.iterdir():
        shutil.copy(path, tmp_path / path.name)
    monkeypatch.chdir(tmp_path)
    before = {*tmp_path.iterdir()}
    with claimed_domain():
        found = command(*words.split())
    assert found[0] == status, found
    assert re.search(printed, found[1]), found
    assert bool(found[2]) == bool(error), found
    if error:
        (line,) = found[2].splitlines()
        assert re.search(error, line), found
        assert printed or {*tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ('words', 'keys'),
    [
        ('info whole.mcap --json', {'path', 'complete', 'begin_ns', 'topics', 'settings'}),
        ('compare whole.mcap other.mcap --json', {'within', 'lag', 'differences'}),
        ('replay whole.mcap --what-if payload.mass=1 --json', {'log', 'source'}),
    ],
)
def test_json_is_one_object_and_the_new_log_lies_in_the_current_folder(
    words, keys, logs, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    found = command(
        *words.replace('whole', f'{logs}/whole').replace('other', f'{logs}/other').split()
    )
    assert {*json.loads(found[1])} >= keys
    written = [path.name for path in tmp_path.iterdir()]
    assert written == (['whole_what_if.mcap'] if 'what-if' in words else [])


@pytest.mark.parametrize(
    'words',
    [
        'recover LOG --out here',
        'report log LOG --out here',
        'view LOG --export here',
        'replay LOG --what-if payload.mass=1 --out here',
        'urdf planar2 --out here',
    ],
)
def test_no_command_writes_over_a_file(words, logs, tmp_path):
    here = tmp_path / 'here'
    here.write_text('mine')
    done = command(*words.replace('LOG', f'{logs}/whole.mcap').replace('here', str(here)).split())
    assert done[0] == 1
    assert len(done[2].splitlines()) == 1
    assert here.read_text() == 'mine'


@pytest.mark.parametrize(
    ('words', 'name'),
    [
        ('recover LOG', 'whole.recovered{}.mcap'),
        ('report log LOG', 'whole{}.html'),
        ('replay LOG --what-if payload.mass=1', 'whole_what_if{}.mcap'),
        ('report scene --trajectory LOG --tolerance 1e-3', 'scene{}.yaml'),
    ],
)
def test_files_with_a_default_name_are_numbered(words, name, logs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(3):
        assert command(*words.replace('LOG', f'{logs}/whole.mcap').split())[0] == 0
    names = {name.format(number) for number in ('', '_2', '_3')}
    assert {path.name for path in tmp_path.iterdir()} == names


ESCAPE = '\x1b]0;title\x07\x1b[2J'


@pytest.mark.parametrize(
    'words',
    [
        'info LOG',
        'replay LOG',
        'replay LOG --verify',
        'replay LOG --what-if payload.mass=1',
        'compare LOG LOG --topics LOG LOG',
        'recover LOG',
        'report log LOG',
        'view LOG --export a.html',
        'view a --port LOG',
        'LOG',
    ],
)
def test_escapes_of_a_terminal_in_names_are_printed_as_text(words, logs, tmp_path, monkeypatch):
    name = f'{ESCAPE}.mcap'
    shutil.copy(logs / 'whole.mcap', tmp_path / name)
    monkeypatch.chdir(tmp_path)
    found = command(
        *(name if word == 'LOG' else word.replace('LOG', name) for word in words.split())
    )
    text = found[1] + found[2]
    assert '\\x1b' in text
    assert not set(text) & {'\x1b', '\x07'}


SENSELESS = """
dance | replay | replay a --ros-args | replay a --loop | replay a --rounding |
replay a --json | replay a --allow-incomplete | replay a --publish --verify |
replay a --publish --what-if | replay a --publish --rate 0 | replay a --publish --remap b |
replay a --publish --remap b:= | replay a --verify --what-if | compare a |
compare a b --rename c | report | report counts | view a --port -1 | view a --port 65536 |
send | send topic | robots more | info a --ros-args -p b:=c
"""


@pytest.mark.parametrize('words', ['', *map(str.strip, SENSELESS.split('|'))])
def test_a_command_that_makes_no_sense_is_one_line_and_status_2(words):
    status, printed, error = command(*words.split())
    assert (status, printed) == (2, '')
    assert re.fullmatch(r'pfd\b.*\n', error)


@pytest.mark.parametrize(
    ('error', 'status', 'printed'),
    [
        (KeyboardInterrupt(), 130, ''),
        (
            ValueError('not YAML:\n  line 1\n\x1b[2Jand ' + 'x' * 10_000),
            *(1, r'pfd robots: not YAML: line 1 \\x1b\[2Jand xxx.{,900}\n'),
        ),
    ],
)
def test_ctrl_c_and_long_errors_are_no_traceback_and_one_line(error, status, printed, monkeypatch):
    def fail(_):
        raise error

    monkeypatch.setitem(SMALL_COMMANDS, 'robots', SMALL_COMMANDS['robots']._replace(run=fail))
    found = command('robots')
    assert found[:2] == (status, '')
    assert re.fullmatch(printed, found[2])


@pytest.mark.parametrize('words', ['robots', 'info --help'])
def test_a_reader_that_ends_first_ends_a_command_quietly(words):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = process(*words.split(), stdout=writing)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (CLOSED_PIPE, '')


@pytest.mark.parametrize('words', ['info', 'report log'])
def test_names_that_a_terminal_cannot_show_are_escaped(words, logs, tmp_path):
    name = 'é☃' + os.fsdecode(b'\xff.mcap')
    shutil.copy(logs / 'whole.mcap', tmp_path / name)
    done = process(*words.split(), name, cwd=tmp_path, PYTHONIOENCODING='ascii')
    assert (done.returncode, done.stderr) == (0, '')
    assert r'\xe9\u2603\udcff' in done.stdout


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='no /dev/full')
def test_a_full_disk_is_one_line(logs):
    with open('/dev/full', 'w') as full:
        done = process('info', f'{logs}/whole.mcap', stdout=full)
    assert done.returncode == 1
    assert re.fullmatch('pfd info: .*No space left on device\n', done.stderr)


@pytest.mark.parametrize('size', [10, 10_000])
def test_a_file_that_a_full_disk_cuts_off_is_named_and_removed(size, tmp_path):
    path = tmp_path / 'planar2.urdf'
    with largest_file(size):
        found = command('urdf', 'planar2', '--out', str(path))
    assert (found[0], path.exists()) == ((1, False) if size == 10 else (0, True))
    assert found[2] == f'pfd urdf: {path}: File too large\n' * (size == 10)


# What is imported, and help.


def installed(text: str) -> list[str]:
    """Return what the command at the end of a text would install into this environment."""
    words = shlex.split(text[text.index(sys.executable) :])
    assert words[:4] == [sys.executable, '-m', 'pip', 'install']
    return words[4:]


def of_extra(extra: str) -> list[str]:
    """Return the requirements of an extra of setup.py, as pip reads them."""
    found = map(Requirement, metadata.requires('pfd_ros') or [])
    chosen = [x for x in found if x.marker and x.marker.evaluate({'extra': extra})]
    return [f'{x.name}{x.specifier}' for x in chosen]


WITHOUT = (
    'import sys\n'
    'sys.modules[sys.argv.pop(1)] = None\n'
    'from pfd_ros.cli.main import main\n'
    'raise SystemExit(main(sys.argv[1:]))\n'
)


@pytest.mark.parametrize(
    ('absent', 'words', 'extra'),
    [
        ('rclpy', 'sim', 'ros'),
        ('rclpy', 'replay a.mcap --publish', 'ros'),
        ('rclpy', 'view', 'ros'),
        ('rclpy', 'robots', ''),
        ('matplotlib', 'compare {0} {0} --plot a.png', 'report'),
        ('viser', 'view {0}', 'view'),
        ('pytest', 'report log {0} --pytest test_a.py', 'pytest'),
    ],
)
def test_without_a_package_the_commands_that_need_it_say_how_to_get_it(
    absent, words, extra, logs, tmp_path
):
    given = words.format(logs / 'whole.mcap').split()
    done = process(absent, *given, cwd=tmp_path, program=('-c', WITHOUT))
    assert done.returncode == int(bool(extra))
    assert not extra or installed(done.stderr) == (of_extra(extra) or [extra])
    assert 'Traceback' not in done.stderr


def test_without_metadata_an_extra_is_one_of_the_folder_with_the_sources(monkeypatch):
    monkeypatch.setattr('pfd_ros.extras.PACKAGE', 'a-package-that-nobody-has')
    folder = Path(doctor.__file__).resolve().parents[2]
    assert installed(install('view')) == [f'{folder}[view]']


@pytest.mark.parametrize(
    ('words', 'absent'),
    [
        ('sim --help', ['rclpy', 'viser', 'matplotlib', 'pfd_ros.cli.logs', 'pfd_ros.cli.view']),
        ('--help', ['rclpy', 'viser', 'trimesh', 'matplotlib', 'mcap']),
    ],
)
def test_a_command_imports_what_it_needs(words, absent):
    program = (
        'import sys\nfrom pfd_ros.cli.main import main\n'
        'try:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n'
        "print('MODULES', *sys.modules)\n"
    )
    done = process(*words.split(), program=('-c', program))
    modules = done.stdout.rpartition('MODULES')[2].split()
    assert 'pfd_ros.cli.main' in modules
    assert not {*absent} & {*modules}


@pytest.mark.parametrize('name', PFD_COMMANDS)
def test_the_help_of_a_command_has_an_example_that_its_parser_accepts(name):
    status, printed, _ = command(name, '--help')
    assert status == 0
    last = printed.rstrip().splitlines()[-1]
    assert last.startswith('example: pfd ')
    words = shlex.split(last.removeprefix('example: pfd '))
    words = words[: words.index('--ros-args')] if '--ros-args' in words else words
    assert pfd_parser(pfd_commands_of(words)).parse_args(words).command == name


# What bash does at the key TAB, with the function that argcomplete registers for pfd.
SCRIPT = """
eval "$(register-python-argcomplete pfd)"
COMP_LINE=$1 COMP_POINT=${#1} COMP_TYPE=9 COMP_WORDS=($1) COMP_CWORD=1
_python_argcomplete pfd
printf '%s\\n' "${COMPREPLY[@]}"
"""


def test_bash_completes_options_of_a_command(tmp_path):
    program = tmp_path / 'pfd'
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m pfd_ros.cli.main "$@"\n')
    program.chmod(0o755)
    path = os.pathsep.join([str(tmp_path), sysconfig.get_path('scripts'), os.environ['PATH']])
    done = subprocess.run(
        ['bash', '-c', SCRIPT, 'bash', 'pfd replay --wh'],
        env=os.environ | {'PATH': path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert done.stdout.split() == ['--what-if']


def test_progress_is_printed_on_a_terminal_alone():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    assert progress_on(io.StringIO()) is None
    assert progress_on(None) is None
    terminal = Terminal()
    draw = progress_on(terminal)
    assert draw is not None
    for part in (0.0, 0.001, 0.5, 1.0):
        draw(part)
    assert terminal.getvalue().split('\r') == ['', '  0 %', '', ' 50 %', '', '100 %', '']
