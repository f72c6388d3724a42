# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The cache folder: its place, its owner, its size; an entry that cannot be used is a miss."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path

import bridge
from bridge import CACHE_VARIABLE, cache_folder, read_cache, write_cache
from cache_folders import answers, contents
import pytest

import pfd_core as pfd

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
