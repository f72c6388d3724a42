# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: the folder, and the same bits from any state of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

import bridge
from bridge import CACHE_VARIABLE, Frame, cache_folder, read_cache, write_cache
import numpy as np
import pytest
from zoo import random_chain, random_state

import pfd_core as pfd

ROOT = Path(__file__).resolve().parent.parent
LIFETIME = 120  # [s] of a child; far above what it takes


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def answers(kernel: pfd.Kernel) -> bytes:
    """Return the bits of one state and of a batch."""
    n = kernel.robot.n
    q, qd, tau = (np.array(x, kernel.dtype) for x in random_state(np.random.default_rng(3), n))
    rows = [np.tile(x, (9, 1)) for x in (q, qd, tau)]
    return kernel(q, qd, tau).tobytes() + kernel(*rows).tobytes()


pytestmark = pytest.mark.skipif(not hasattr(os, 'geteuid'), reason='modes are those of POSIX')


@pytest.mark.parametrize(
    ('variable', 'base', 'expected'),
    [
        ('/here', '/xdg', '/here'),
        ('~/x', '/xdg', '/home/x'),
        ('x/../y', '/xdg', f'{Path.cwd()}/x/../y'),
        (None, '/xdg', '/xdg/pfd_ros'),
        (None, 'relative', '/home/.cache/pfd_ros'),
        (None, None, '/home/.cache/pfd_ros'),
        ('', '/xdg', None),
        (' ', '/xdg', None),
    ],
)
def test_variables_name_the_folder(
    variable: str | None, base: str | None, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in ((CACHE_VARIABLE, variable), ('XDG_CACHE_HOME', base), ('HOME', '/home')):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert cache_folder() == (None if expected is None else Path(expected))


def in_place_of(make: Callable[[Path], object]) -> Callable[[Path], None]:
    """Return a function that puts something else in the place of a file."""

    def replace(path: Path) -> None:
        path.unlink()
        make(path)

    return replace


DAMAGES: dict[str, Callable[[Path], object]] = {
    'empty': lambda path: path.write_bytes(b''),
    'half': lambda path: os.truncate(path, path.stat().st_size // 2),
    'one byte more': lambda path: path.write_bytes(path.read_bytes() + b'\0'),
    'one bit': lambda path: path.write_bytes(path.read_bytes()[:-1] + b'?'),
    'of another name': lambda path: path.write_bytes(max(contents(path.parent).values())),
    'huge': lambda path: os.truncate(path, 2**40),
    'folder': in_place_of(Path.mkdir),
    'fifo': in_place_of(os.mkfifo),
    'loop': in_place_of(lambda path: path.symlink_to(path)),
    'endless': in_place_of(lambda path: path.symlink_to('/dev/zero')),
}


@pytest.mark.parametrize('damage', DAMAGES)
def test_an_entry_that_cannot_be_used_is_a_miss(folder: Path, damage: str) -> None:
    robot = pfd.load_robot('planar2')
    wanted = answers(pfd.compile_kernel(robot))
    sound = {path: read_cache(path.stem) for path in folder.iterdir()}
    assert len(sound) == 3  # roundings of two methods, and the code
    for path in sound:
        DAMAGES[damage](path)
    assert sound != {path: read_cache(path.stem) for path in sound}
    kernel = pfd.compile_kernel(robot)
    assert answers(kernel) == wanted
    assert kernel.operations


@pytest.mark.parametrize('unsafe', ['mode', 'owner'])
def test_a_folder_in_which_others_could_put_code_is_not_used(
    folder: Path, unsafe: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    write_cache('0' * 64, b'x')
    assert folder.stat().st_mode & 0o777 == 0o700
    assert [path.stat().st_mode & 0o777 for path in folder.iterdir()] == [0o600]
    assert read_cache('0' * 64) == b'x'
    if unsafe == 'mode':
        folder.chmod(0o720)
    else:
        os.chown(folder, 12345, -1) if os.geteuid() == 0 else monkeypatch.setattr(
            os, 'geteuid', lambda: 12345
        )
    for _ in range(2):
        assert read_cache('0' * 64) is None
        write_cache('1' * 64, b'x')
    assert [path.stem for path in folder.iterdir()] == ['0' * 64]
    (record,) = caplog.records
    assert str(folder) in record.message
    assert 'chmod go-w' in record.message


def test_the_least_recently_used_entries_are_removed_first_and_nothing_else(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(*bridge.target('CACHE_LIMIT'), 4000)
    names = [str(k) * 64 for k in range(5)]
    folder.mkdir(mode=0o700)
    (folder / 'notes.txt').write_bytes(bytes(10_000))
    for age, name in enumerate(names[:4]):
        write_cache(name, bytes(900))
        os.utime(folder / f'{name}.pfd', (2 + age, 2 + age))
    assert read_cache(names[0]) == bytes(900)
    write_cache(names[4], bytes(900))
    assert {path.stem for path in folder.iterdir()} == {'notes', names[0], names[3], names[4]}


CHILD = """
import json, sys
import numpy as np
import bridge
import pfd_core as pfd
emitted, emit = [], bridge.emit_object
bridge.put('emit_object', lambda *args: emitted.append(1) or emit(*args))
recorded, begin = [], bridge.Recorder_init
bridge.put('Recorder_init', lambda *args, **given: recorded.append(1) or begin(*args, **given))
robot = pfd.load_robot(sys.argv[1])
kernel = pfd.compile_kernel(robot)
rows = np.random.default_rng(1).uniform(-1, 1, (3, 9, robot.n))
first = kernel(*rows[:, 0])
print(json.dumps({
    'single': first.tobytes().hex(), 'batch': kernel(*rows).tobytes().hex(),
    'operations': kernel.operations, 'emitted': len(emitted),
    'recorded': bool(recorded), 'ir': kernel.ir, 'program': str(kernel.program),
}))
"""


def start_child(robot: str) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(ROOT), str(ROOT / 'test')])
    environment = {**os.environ, 'PYTHONPATH': path}
    command = [sys.executable, '-c', CHILD, robot]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def result(child: subprocess.Popen[str]) -> dict[str, Any]:
    text, _ = child.communicate(timeout=LIFETIME)
    assert child.returncode == 0
    found: dict[str, Any] = json.loads(text)
    return found


@pytest.mark.parametrize('scene', [pfd.Scene(), pfd.Scene(friction=[0.1, 0.1])])
def test_a_second_simulation_from_disk_records_no_program(
    folder: Path, monkeypatch: pytest.MonkeyPatch, scene: pfd.Scene
) -> None:
    robot = pfd.load_robot('planar2')
    first = pfd.Simulator(robot, scene).rollout(np.zeros((3, robot.n)))
    recorded: list[Any] = []
    # Entered for each program that is recorded.
    uncollected = bridge.recipe_uncollected
    monkeypatch.setattr(
        *bridge.target('recipe_uncollected'), lambda: recorded.append(1) or uncollected()
    )
    again = pfd.Simulator(robot, scene).rollout(np.zeros((3, robot.n)))
    assert not recorded
    assert again.q.tobytes() == first.q.tobytes()


def test_a_second_process_gets_the_same_bits_without_recording_or_compiling(folder: Path) -> None:
    fresh, kept = result(start_child('ur5')), result(start_child('ur5'))
    assert (fresh['recorded'], fresh['emitted']) == (True, 1)
    assert (kept['recorded'], kept['emitted']) == (False, 0)
    for key in ('single', 'batch', 'operations', 'ir', 'program'):
        assert kept[key] == fresh[key], key


@pytest.mark.slow
def test_two_processes_at_once_leave_one_sound_copy(folder: Path) -> None:
    children = [start_child('planar2'), start_child('planar2')]
    first, second = (result(child) for child in children)
    assert (first['single'], first['batch']) == (second['single'], second['batch'])
    written = contents(folder)
    # Roundings of two methods, and the code; nothing unfinished.
    assert len(written) == 3
    assert all(read_cache(Path(name).stem) for name in written)
    assert result(start_child('planar2'))['emitted'] == 0


@pytest.mark.slow
def test_every_robot_scene_method_and_precision_is_kept_apart(
    folder: Path, emitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(4)
    arm = random_chain(rng, 2)
    heavier = replace(arm, masses=arm.masses * 2)

    def seen(kernel: pfd.Kernel) -> tuple[str, bytes]:
        return kernel.ir, answers(kernel)

    choices: list[dict[str, Any]] = [
        {'robot': arm},
        {'robot': heavier},
        {'robot': arm, 'scene': pfd.Scene(gravity=None)},
        {'robot': arm, 'method': 'walker_orin_3'},
        {'robot': arm, 'dtype': 'float32'},
        {'robot': arm, 'refine': 1},
    ]
    monkeypatch.setenv(CACHE_VARIABLE, '')
    wanted = [seen(pfd.compile_kernel(**choice)) for choice in choices]
    torques = seen(pfd.compile_kernel(arm, quantity='inverse_dynamics'))
    # They differ at all, so that one taken for another would show.
    assert len({*wanted, torques}) == len(choices) + 1
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    for _ in range(2):
        count = len(emitted)
        assert [seen(pfd.compile_kernel(**choice)) for choice in choices] == wanted
        assert seen(pfd.compile_kernel(arm, quantity='inverse_dynamics')) == torques
    assert len(emitted) == count


def refuse(*_: object) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def in_the_way(folder: Path, _: pytest.MonkeyPatch) -> None:
    folder.write_text('not a folder')


def read_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Permissions do not hold back root, as which tests often run.
    monkeypatch.setattr(os, 'open', refuse)


def full(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'replace', refuse)


@pytest.mark.parametrize('obstacle', [in_the_way, read_only, full])
def test_where_nothing_can_be_written_kernels_work_after_one_warning(
    folder: Path,
    obstacle: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = pfd.load_robot('planar2')
    wanted = answers(pfd.compile_kernel(robot))
    for name in contents(folder):
        (folder / name).unlink()
    folder.rmdir()
    obstacle(folder, monkeypatch)
    caplog.clear()
    for _ in range(2):
        assert answers(pfd.compile_kernel(robot)) == wanted
    (record,) = caplog.records
    assert (record.name, record.levelname) == ('pfd_core', 'WARNING')
    assert f'cannot be kept in {str(folder)!r}' in record.message
    assert CACHE_VARIABLE in record.message
    assert folder.is_file() or not contents(folder)


def test_equal_robots_with_different_frames_have_kernels_of_their_own(folder: Path) -> None:
    arm = pfd.load_robot('planar2')
    one, other = (
        replace(arm, frames={'camera': Frame(link, np.eye(3), np.ones(3))}) for link in (1, 2)
    )
    assert one == other
    kernels = [pfd.compile_kernel(x, quantity='tip_pose', frame='camera') for x in (one, other)]
    first, second = (kernel([0.3, 0.4]) for kernel in kernels)
    assert np.abs(first - second).max() > 0.1
