# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The cache folder: place, warnings, full disks, eviction; other users, files and processes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import errno
import io
import os
from pathlib import Path
import socket
import stat
import subprocess
import sys
import time
from typing import Any

from cache_folders import IR, LIFETIME, ROOT, contents
import pytest

from pfd_core.kernels.runtime import disk_cache as cache
from pfd_core.kernels.runtime import jit as engine
from pfd_core.kernels.runtime import json_cache as facts

pwd = pytest.importorskip('pwd', reason='users and modes are those of POSIX')


def test_no_two_lists_of_strings_share_a_digest() -> None:
    lists = [('ab', 'c'), ('a', 'bc'), ('abc',), ('abc', ''), ('', 'abc'), ('2:ab', 'c')]
    assert len({cache.digest(*parts) for parts in lists}) == len(lists)


def test_the_variable_moves_the_cache_and_switches_it_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('HOME', str(tmp_path))
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'xdg'))
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / 'here'))
    assert cache.folder() == tmp_path / 'here'
    monkeypatch.delenv(cache.VARIABLE)
    assert cache.folder() == tmp_path / 'xdg' / 'pfd_ros'
    monkeypatch.setenv('XDG_CACHE_HOME', 'relative')
    assert cache.folder() == tmp_path / '.cache' / 'pfd_ros'
    monkeypatch.setenv('XDG_CACHE_HOME', '')
    assert cache.folder() == tmp_path / '.cache' / 'pfd_ros'
    monkeypatch.setenv(cache.VARIABLE, '')
    assert cache.folder() is None
    engine.compile_ir(IR)
    assert facts.get_or_compute(('key',), lambda: 1, lambda kept: True) == 1
    assert not list(tmp_path.iterdir())


def test_the_least_recently_used_entry_is_removed_first_and_nothing_else(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, 'LIMIT', 4000)
    monkeypatch.setattr(cache, 'TRIMMED', 3000)
    monkeypatch.setattr(cache, 'SLICE', 0)
    names = [cache.digest(str(k)) for k in range(5)]
    folder.mkdir(mode=0o700)
    (folder / 'notes.txt').write_bytes(bytes(10_000))
    abandoned = folder / f'{cache.UNFINISHED}0{cache.SUFFIX}'
    abandoned.write_bytes(bytes(100))
    os.utime(abandoned, (1, 1))
    for age, name in enumerate(names[:4]):
        cache.write(name, bytes(900))
        os.utime(folder / f'{name}{cache.SUFFIX}', (2 + age, 2 + age))
    assert cache.read(names[0]) == bytes(900)
    cache.write(names[4], bytes(900))
    left = {path.name for path in folder.iterdir()}
    assert left == {'notes.txt', *(f'{names[k]}{cache.SUFFIX}' for k in (0, 3, 4))}


@pytest.mark.parametrize(
    ('given', 'wanted'),
    [
        ('~/x', 'home/x'),
        ('~', 'home'),
        ('x/../y', 'work/x/../y'),
        ('.', 'work'),
        ('$HOME/x', 'work/$HOME/x'),
        ('%s{}', 'work/%s{}'),
    ],
)
def test_the_variable_may_begin_at_home_or_at_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str, wanted: str
) -> None:
    (tmp_path / 'work').mkdir()
    monkeypatch.chdir(tmp_path / 'work')
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    monkeypatch.setenv(cache.VARIABLE, given)
    assert cache.folder() == tmp_path / wanted


def test_the_variable_may_begin_at_the_home_of_a_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(cache.VARIABLE, '~root/x')
    assert cache.folder() == Path(pwd.getpwnam('root').pw_dir) / 'x'


@pytest.mark.parametrize('given', ['', ' ', '\t'])
def test_an_empty_variable_switches_the_cache_off(
    given: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(cache.VARIABLE, given)
    assert cache.folder() is None


def unknown_user(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    monkeypatch.setenv(cache.VARIABLE, '~nobody knows/x')


def no_home(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    for variable in (cache.VARIABLE, 'HOME', 'XDG_CACHE_HOME'):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(pwd, 'getpwuid', {}.__getitem__)


def no_current_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / 'gone').mkdir()
    monkeypatch.chdir(tmp_path / 'gone')
    (tmp_path / 'gone').rmdir()
    monkeypatch.setenv(cache.VARIABLE, 'x')


def not_to_be_created(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    monkeypatch.setenv(cache.VARIABLE, '/proc/nothing/x')


def home_is_no_folder(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    monkeypatch.setenv('HOME', '/dev/null')
    for variable in (cache.VARIABLE, 'XDG_CACHE_HOME'):
        monkeypatch.delenv(variable, raising=False)


@pytest.mark.parametrize(
    'missing', [unknown_user, no_home, no_current_folder, not_to_be_created, home_is_no_folder]
)
def test_without_a_folder_kernels_work_after_one_warning(
    folder: Path,
    missing: Any,
    emitted: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    missing(monkeypatch, tmp_path)
    for _ in range(2):
        engine.compile_ir(IR)
    assert emitted == [IR, IR]
    (record,) = caplog.records
    assert cache.VARIABLE in record.message
    assert not list(tmp_path.iterdir())


def no_space(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize('when', ['write', 'close'])
def test_a_full_disk_leaves_nothing_half_written(
    folder: Path, when: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Full(io.FileIO):
        def write(self, data: Any) -> int:
            written = super().write(data[: len(data) // 2])
            if when == 'write':
                no_space()
            return written

        def close(self) -> None:
            again = self.closed
            super().close()
            if when == 'close' and not again:
                no_space()

    folder.mkdir(mode=0o700)
    with monkeypatch.context() as patch:
        patch.setattr(os, 'fdopen', lambda handle, mode: Full(handle, mode))
        cache.write('0' * 64, b'x')
    assert not contents(folder)
    assert cache.read('0' * 64) is None
    (record,) = caplog.records
    assert 'No space left on device' in record.message


def test_an_entry_that_is_too_large_is_not_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, 'LARGEST', 1000)
    cache.write('0' * 64, bytes(1000))
    cache.write('1' * 64, bytes(1001))
    assert cache.read('0' * 64) == bytes(1000)
    assert [path.stem for path in folder.iterdir()] == ['0' * 64]


NOW = time.time()
LATER = 4e9  # [s] in 2096


@pytest.mark.parametrize(
    ('old', 'new'),
    [(LATER, NOW), (LATER, LATER + 1), (-1e9, NOW), (-1e9, -1e9 + 1)],
    ids=['clock was ahead', 'all ahead', 'before 1970', 'all before 1970'],
)
def test_wrong_clocks_do_not_change_the_order_of_removal(
    folder: Path, monkeypatch: pytest.MonkeyPatch, old: float, new: float
) -> None:
    monkeypatch.setattr(cache, 'LIMIT', 4000)
    monkeypatch.setattr(cache, 'TRIMMED', 3000)
    names = [cache.digest(str(k)) for k in range(5)]
    for name, when in zip(names, (new, old, new, old, new), strict=True):
        cache.write(name, bytes(900))
        os.utime(folder / f'{name}{cache.SUFFIX}', (when, when))
    monkeypatch.setattr(cache, 'SLICE', 0)
    cache.write(names[4], bytes(900))
    left = {path.stem for path in folder.iterdir()}
    assert left == {names[0], names[2], names[4]}


@pytest.mark.parametrize(
    ('age', 'stays'), [(0, True), (1800, True), (-1800, True), (7300, False), (-7300, False)]
)
def test_unfinished_files_are_removed_when_their_process_is_long_gone(
    folder: Path, age: float, stays: bool
) -> None:
    folder.mkdir(mode=0o700)
    unfinished = folder / f'{cache.UNFINISHED}0{cache.SUFFIX}'
    unfinished.touch()
    os.utime(unfinished, (time.time() - age,) * 2)
    cache.write('0' * 64, b'x')
    assert unfinished.exists() == stays


def test_entries_of_other_processes_are_counted_from_time_to_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, 'LIMIT', 10_000)
    monkeypatch.setattr(cache, 'TRIMMED', 5000)
    monkeypatch.setattr(cache, 'SLICE', 2000)
    cache.write('0' * 64, bytes(900))
    for k in range(12):
        (folder / f'{cache.digest(str(k))}{cache.SUFFIX}').write_bytes(bytes(1000))
    for k in range(3):
        cache.write(str(k) * 64, bytes(900))
    assert sum(path.stat().st_size for path in folder.iterdir()) <= 5000


# ---- other users, other files and other processes --------------------------------------------


@pytest.mark.parametrize('mode', [0o777, 0o770, 0o720, 0o702, 0o1777])
def test_a_folder_that_others_may_write_to_is_not_used(
    folder: Path, emitted: list[str], mode: int, caplog: pytest.LogCaptureFixture
) -> None:
    native = engine.compile_ir(IR)
    folder.chmod(mode)
    before = contents(folder)
    for text in (IR, IR + '\n'):
        assert engine.compile_ir(text).address('f') != native.address('f')
    assert len(emitted) == 3
    assert contents(folder) == before
    (record,) = caplog.records
    assert stat.filemode(stat.S_IFDIR | mode) in record.message
    assert repr(str(folder)) in record.message
    assert 'chmod go-w' in record.message


def test_the_folder_belongs_to_the_user_alone(folder: Path) -> None:
    engine.compile_ir(IR)
    assert folder.stat().st_mode & 0o777 == 0o700
    assert all(path.stat().st_mode & 0o777 == 0o600 for path in folder.iterdir())


def change_mode(path: Path) -> None:
    path.chmod(0o666)


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def link(path: Path) -> None:
    path.rename(path.with_suffix('.moved'))
    path.symlink_to(path.with_suffix('.moved'))


def loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path)


def unix_socket(path: Path) -> None:
    path.unlink()
    os.chdir(path.parent)  # the path of a socket is short
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path.name)


def endless(path: Path) -> None:
    path.unlink()
    path.symlink_to('/dev/zero')


def huge(path: Path) -> None:
    os.truncate(path, 2**40)


@pytest.mark.parametrize(
    'replace_it', [change_mode, fifo, directory, link, loop, unix_socket, endless, huge]
)
def test_an_entry_that_is_no_file_of_the_user_is_not_used(
    folder: Path,
    emitted: list[str],
    replace_it: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(folder.parent)
    engine.compile_ir(IR)
    (path,) = folder.iterdir()
    sound = path.read_bytes()
    try:
        replace_it(path)
    except OSError as error:
        pytest.skip(f'this file system cannot hold one: {error}')
    emitted.clear()
    assert engine.compile_ir(IR).address('f')
    assert emitted == [IR]
    if replace_it is directory:
        (record,) = caplog.records
        assert 'Is a directory' in record.message
        return
    # In its place, and nowhere else, is what was compiled again.
    assert not path.is_symlink()
    assert path.read_bytes() == sound
    assert path.stat().st_mode & 0o777 == 0o600
    assert not caplog.records


@pytest.mark.parametrize('what', ['folder', 'entry'])
def test_files_of_another_user_are_not_used(
    folder: Path, emitted: list[str], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.compile_ir(IR)
    (path,) = folder.iterdir()
    owner = os.geteuid()
    if owner == 0:
        os.chown(folder if what == 'folder' else path, 12345, -1)
    else:
        monkeypatch.setattr(os, 'geteuid', lambda: owner + 1)
    emitted.clear()
    engine.compile_ir(IR)
    assert emitted == [IR]


def test_files_of_root_are_used(
    folder: Path, emitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if os.geteuid() != 0:
        pytest.skip('needs root, to make files of root')
    engine.compile_ir(IR)
    monkeypatch.setattr(os, 'geteuid', lambda: 12345)
    emitted.clear()
    engine.compile_ir(IR)
    assert not emitted


MASKS = """
import os, sys
from pfd_core.kernels.runtime import disk_cache as cache
for mask in (0o000, 0o002, 0o077):
    os.umask(mask)
    os.environ[cache.VARIABLE] = f'{sys.argv[1]}/{mask}/b/c'
    cache.write('0' * 64, b'x')
    assert cache.read('0' * 64) == b'x'
"""


def test_folders_and_files_are_the_users_alone_whatever_the_mask(tmp_path: Path) -> None:
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    command = [sys.executable, '-c', MASKS, str(tmp_path)]
    subprocess.run(command, env=environment, check=True, timeout=LIFETIME)
    for mask in (0o000, 0o002, 0o077):
        where = tmp_path / str(mask) / 'b' / 'c'
        for path in (where, *where.parents[:2]):
            assert path.stat().st_mode & 0o777 == 0o700
        (entry,) = where.iterdir()
        assert entry.stat().st_mode & 0o777 == 0o600


def test_threads_that_find_the_folder_unsafe_together_warn_once(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    with ThreadPoolExecutor(8) as pool:
        assert not any(pool.map(cache.read, ['0' * 64] * 200))
    assert len(caplog.records) == 1


RACE = """
import os, shutil, sys
from pfd_core.kernels.runtime import disk_cache as cache, jit as engine

def fill_and_clear(turns):
    for turn in range(turns):
        name = cache.digest(str(turn % 3))
        kept = cache.read(name)
        assert kept is None or kept == name.encode() * 1000, kept[:80]
        cache.write(name, name.encode() * 1000)
        if turn % 5 == 4:
            shutil.rmtree(cache.folder(), ignore_errors=True)
    assert engine.compile_ir(sys.argv[3]).address('f')

children = []
for _ in range(int(sys.argv[1])):
    child = os.fork()
    if not child:
        children = []
        break
    children.append(child)
fill_and_clear(int(sys.argv[2]))
assert not any(os.waitpid(pid, 0)[1] for pid in children)
"""


def race(processes: int, forks: int, turns: int) -> None:
    """Let fresh processes and children of each fill and clear the folder: all are silent."""
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    command = [sys.executable, '-c', RACE, str(forks), str(turns), IR]
    output = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT, 'text': True}
    children = [subprocess.Popen(command, env=environment, **output) for _ in range(processes)]
    said = [child.communicate(timeout=LIFETIME)[0] for child in children]
    assert said == [''] * processes
    assert [child.returncode for child in children] == [0] * processes


@pytest.mark.slow
def test_processes_that_fill_and_clear_the_folder_together_all_work(folder: Path) -> None:
    race(2, 5, 20)
    assert not list(folder.glob(f'{cache.UNFINISHED}*'))


@pytest.mark.slow
@pytest.mark.long
def test_hundreds_of_processes_that_fill_and_clear_the_folder_all_work(folder: Path) -> None:
    for _ in range(5):
        race(3, 19, 20)
    assert not list(folder.glob(f'{cache.UNFINISHED}*'))
