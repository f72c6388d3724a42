# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The cache folder among other users, other files and other processes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import socket
import stat
import subprocess
import sys
from typing import Any

from cache_folders import IR, LIFETIME, ROOT, contents
import pytest

from pfd_core.kernels.runtime import disk_cache as cache
from pfd_core.kernels.runtime import jit as engine

pwd = pytest.importorskip('pwd', reason='users and modes are those of POSIX')


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
def test_what_belongs_to_another_user_is_not_used(
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


def test_what_belongs_to_root_is_used(
    folder: Path, emitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if os.geteuid() != 0:
        pytest.skip('needs root, to make files of root')
    engine.compile_ir(IR)
    monkeypatch.setattr(os, 'geteuid', lambda: 12345)
    emitted.clear()
    engine.compile_ir(IR)
    assert not emitted


@pytest.mark.parametrize('mask', [0o000, 0o002, 0o077])
def test_folders_and_files_are_the_users_alone_whatever_the_mask(
    tmp_path: Path, mask: int
) -> None:
    where = tmp_path / 'a' / 'b' / 'c'
    environment = {**os.environ, 'PYTHONPATH': str(ROOT), cache.VARIABLE: str(where)}
    program = f'import os; os.umask({mask}); '
    program += 'from pfd_core.kernels.runtime import disk_cache as cache; '
    program += "cache.write('0' * 64, b'x'); assert cache.read('0' * 64) == b'x'"
    subprocess.run([sys.executable, '-c', program], env=environment, check=True, timeout=LIFETIME)
    for path in (where, *where.parents[:2]):
        assert path.stat().st_mode & 0o777 == 0o700
    (entry,) = where.iterdir()
    assert entry.stat().st_mode & 0o777 == 0o600


def test_threads_that_find_the_folder_unsafe_together_say_so_once(
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


def test_processes_that_fill_and_clear_the_folder_together_all_work(folder: Path) -> None:
    race(2, 5, 20)
    assert not list(folder.glob(f'{cache.UNFINISHED}*'))


@pytest.mark.slow
@pytest.mark.long
def test_hundreds_of_processes_that_fill_and_clear_the_folder_all_work(folder: Path) -> None:
    for _ in range(5):
        race(3, 19, 20)
    assert not list(folder.glob(f'{cache.UNFINISHED}*'))
