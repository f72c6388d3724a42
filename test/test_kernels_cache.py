# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: the same bits, from any state of the folder."""

from __future__ import annotations

import ctypes
from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import stat
import subprocess
import sys
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np
import pytest
from zoo import random_chain, random_state

import pfd_core as pfd
from pfd_core.kernels.compile import compile_inverse_kernel
from pfd_core.kernels.runtime import disk_cache as cache
from pfd_core.kernels.runtime import jit as engine
from pfd_core.kernels.runtime import json_cache as facts

ROOT = Path(__file__).resolve().parent.parent
LIFETIME = 120  # [s] of a child; far above what it takes
CHILD = """
import json, sys, time
start = time.perf_counter()
import numpy as np
import pfd_core as pfd
from pfd_core.kernels.runtime import jit as engine, json_cache as facts
facts.IMPORTED = 0.0  # whoever edits the package while its tests run knows what he does
facts.sources.cache_clear()
emitted, emit = [], engine.emit
engine.emit = lambda *args: emitted.append(1) or emit(*args)
robot = pfd.load_robot(sys.argv[1])
before = time.perf_counter()
kernel = pfd.compile_kernel(robot)
after = time.perf_counter()
rows = np.random.default_rng(1).uniform(-1, 1, (3, 9, robot.n))
first = kernel(*rows[:, 0])
answer = time.perf_counter()
print(json.dumps({
    'single': first.tobytes().hex(), 'batch': kernel(*rows).tobytes().hex(),
    'operations': kernel.operations, 'emitted': len(emitted),
    'recorded': 'program' in kernel._source.__dict__,
    'compile': after - before, 'answer': answer - start, 'ir': kernel.ir,
}))
"""
# Edits nothing, but lets the package believe that its source changed after the import.
EDITED = """
from pathlib import Path
from pfd_core.kernels.runtime import json_cache as facts
before = facts.sources()
facts.PACKAGE = Path('test')
assert facts.sources() == before
facts.sources.cache_clear()
assert facts.sources() != before
"""
IR = 'define double @f(double %x) {\n  %y = fmul double %x, %x\n  ret double %y\n}'
HOST = engine.Target('x86_64-unknown-linux-gnu', 'haswell', '+avx,+avx2')


def start_child(robot: str) -> subprocess.Popen[str]:
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    command = [sys.executable, '-c', CHILD, robot]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def result(child: subprocess.Popen[str]) -> dict[str, Any]:
    text, _ = child.communicate(timeout=LIFETIME)
    assert child.returncode == 0
    found: dict[str, Any] = json.loads(text)
    return found


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def answers(kernel: pfd.Kernel) -> bytes:
    """Return the bits of one state and of a batch."""
    n = kernel.robot.n
    q, qd, tau = (np.array(x, kernel.dtype) for x in random_state(np.random.default_rng(3), n))
    rows = [np.tile(x, (9, 1)) for x in (q, qd, tau)]
    return kernel(q, qd, tau).tobytes() + kernel(*rows).tobytes()


def test_a_second_process_gets_the_same_bits_without_recording_or_compiling(folder: Path) -> None:
    fresh, kept = result(start_child('ur5')), result(start_child('ur5'))
    assert (fresh['recorded'], fresh['emitted']) == (True, 2)
    assert (kept['recorded'], kept['emitted']) == (False, 0)
    for key in ('single', 'batch', 'operations', 'ir'):
        assert kept[key] == fresh[key], key
    for name, times in (('fresh', fresh), ('kept', kept)):
        print(
            f'{name}: compile_kernel {1e3 * times["compile"]:.1f} ms, from the start of the '
            f'imports to the first answer {1e3 * times["answer"]:.0f} ms'
        )


def test_two_processes_at_once_leave_one_sound_copy(folder: Path) -> None:
    children = [start_child('planar2'), start_child('planar2')]
    first, second = (result(child) for child in children)
    assert (first['single'], first['batch']) == (second['single'], second['batch'])
    written = contents(folder)
    # Facts, two texts and two objects; nothing unfinished.
    assert len(written) == 5
    assert all(cache.read(Path(name).stem) for name in written)
    assert result(start_child('planar2'))['emitted'] == 0


@pytest.mark.parametrize(
    'damage',
    [
        lambda data: b'',
        lambda data: data[: len(data) // 2],
        lambda data: data[:-1],
        lambda data: data + b'\0',
        lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
        lambda data: data.replace(cache.HEAD, b'pfd_ros cache 0\n'),
    ],
    ids=['empty', 'half', 'one byte short', 'one byte more', 'one bit', 'another format'],
)
def test_a_damaged_file_is_made_again(folder: Path, emitted: list[str], damage: Any) -> None:
    robot = pfd.load_robot('planar2')
    wanted = answers(pfd.compile_kernel(robot))
    sound = contents(folder)
    for name, data in sound.items():
        (folder / name).write_bytes(damage(data))
    before = len(emitted)
    assert answers(pfd.compile_kernel(robot)) == wanted
    assert len(emitted) == before + 2
    assert contents(folder) == sound


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
    monkeypatch.setenv(cache.VARIABLE, '')
    wanted = [seen(pfd.compile_kernel(**choice)) for choice in choices]
    torques = seen(compile_inverse_kernel(arm))
    # They differ at all, so that one taken for another would show.
    assert len({*wanted, torques}) == len(choices) + 1
    monkeypatch.setenv(cache.VARIABLE, str(folder))
    for _ in range(2):
        count = len(emitted)
        assert [seen(pfd.compile_kernel(**choice)) for choice in choices] == wanted
        assert seen(compile_inverse_kernel(arm)) == torques
    assert len(emitted) == count


def test_a_kernel_from_disk_still_has_its_program(folder: Path) -> None:
    robot = pfd.load_robot('planar2')
    fresh, kept = pfd.compile_kernel(robot), pfd.compile_kernel(robot)
    assert kept.operations == fresh.operations
    assert str(kept.program) == str(fresh.program)
    assert kept.compile_seconds > 0


def test_the_name_of_an_object_depends_on_all_that_decides_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def key(ir: str, target: engine.Target, optimisation: engine.Optimisation) -> str:
        return engine.object_key(engine.outline(ir).digest, target, optimisation)

    usual = engine.USUAL
    names = [
        key(IR, HOST, usual),
        key(IR + '\n', HOST, usual),
        key(IR, replace(HOST, cpu='skylake'), usual),
        key(IR, replace(HOST, features='+avx'), usual),
        key(IR, replace(HOST, triple='aarch64-linux-gnu'), usual),
        key(IR, HOST, replace(usual, passes=2)),
        key(IR, HOST, replace(usual, code=3)),
    ]
    monkeypatch.setattr(llvmlite, '__version__', '0.0')
    names.append(key(IR, HOST, usual))
    assert len(set(names)) == len(names)
    assert key(IR, HOST, usual) == names[-1]


def test_no_two_lists_of_texts_share_a_name() -> None:
    lists = [('ab', 'c'), ('a', 'bc'), ('abc',), ('abc', ''), ('', 'abc'), ('2:ab', 'c')]
    assert len({cache.digest(*parts) for parts in lists}) == len(lists)


def refuse(*_: object) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def in_the_way(folder: Path, _: pytest.MonkeyPatch) -> None:
    folder.write_text('not a folder')


def read_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Permissions do not hold back root, as which tests often run.
    monkeypatch.setattr('tempfile.mkstemp', refuse)


def full(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'replace', refuse)


@pytest.mark.parametrize('obstacle', [in_the_way, read_only, full])
def test_where_nothing_can_be_written_kernels_work_and_one_warning_says_so(
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
    assert cache.VARIABLE in record.message
    assert folder.is_file() or not contents(folder)


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


def test_what_was_not_used_for_longest_is_removed_first_and_nothing_else(
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


def remembered(value: int) -> int:
    """Return what one key stands for, having it made from a value if it is not known."""
    facts.sources.cache_clear()
    found = facts.get_or_compute(('key',), lambda: value, lambda kept: type(kept) is int)
    facts.sources.cache_clear()
    return found


@pytest.fixture
def package(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a source file that stands for those of this package."""
    where = tmp_path / 'package'
    where.mkdir()
    monkeypatch.setattr(facts, 'PACKAGE', where)
    (where / 'a.py').write_text('x = 1\n')
    return where / 'a.py'


def test_the_source_is_read_when_the_package_is_imported() -> None:
    command = [sys.executable, '-c', EDITED]
    done = subprocess.run(command, cwd=ROOT, check=False, timeout=LIFETIME)
    assert done.returncode == 0


def test_source_written_while_it_was_imported_is_not_trusted(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts, 'IMPORTED', 1e9)
    os.utime(package, (1e9 - 0.5, 1e9 - 0.5))
    assert [remembered(k) for k in (1, 2)] == [1, 2]


@pytest.mark.parametrize('when', [-1e9, 0.0, 4e9], ids=['before 1970', '1970', 'in the future'])
def test_source_of_any_time_is_remembered(
    package: Path, when: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts, 'IMPORTED', 1e9)
    os.utime(package, (when, when))
    assert [remembered(k) for k in (1, 2)] == [1, 1]


def test_what_is_kept_depends_on_the_source_and_on_the_versions(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert remembered(2) == 2
    package.write_text('x = 2\n')
    assert remembered(3) == 3
    package.rename(package.with_name('b.py'))
    assert remembered(4) == 4
    monkeypatch.setattr(np, '__version__', '0.0')
    assert remembered(5) == 5
    assert remembered(6) == 5


def test_a_package_without_source_remembers_nothing(package: Path) -> None:
    package.unlink()
    assert [remembered(k) for k in (1, 2)] == [1, 2]


@pytest.mark.parametrize(
    'facts',
    [
        b'',
        b'null',
        b'[' * 100_000,
        b'{"inputs": [], "elements": 2, "operations": {}}',
        b'{"inputs": {"q": 2}, "elements": 2}',
        b'{"inputs": {"q": 2}, "elements": true, "operations": {"a": {"add": 1}}}',
        b'{"inputs": {"q": "2"}, "elements": 2, "operations": {"a": {"add": 1}}}',
        b'{"inputs": {"q": -2}, "elements": 2, "operations": {"a": {"add": 1}}}',
        b'{"inputs": {"q": 2}, "elements": 2, "operations": {"a": 1}}',
        b'{"digest": "", "functions": [1]}',
        b'{"digest": "", "functions": "entry"}',
        b'\xff',
    ],
)
def test_kept_facts_of_another_shape_are_made_again(folder: Path, facts: bytes) -> None:
    robot = pfd.load_robot('planar2')
    fresh = pfd.compile_kernel(robot)
    wanted = answers(fresh)
    sound = contents(folder)
    for name in sound:
        payload = cache.read(Path(name).stem)
        if payload is not None and payload.startswith(b'{'):
            cache.write(Path(name).stem, facts)
    assert contents(folder) != sound
    kernel = pfd.compile_kernel(robot)
    assert answers(kernel) == wanted
    assert kernel.operations == fresh.operations
    assert contents(folder) == sound


def test_a_kept_method_that_does_not_exist_is_chosen_again(folder: Path) -> None:
    robot = random_chain(np.random.default_rng(2), 9)
    method = pfd.compile_kernel(robot).method
    for name, data in contents(folder).items():
        if data.endswith(json.dumps(method).encode()):
            cache.write(Path(name).stem, b'"no method"')
    assert pfd.compile_kernel(robot).method == method


HERE = engine.host().triple
FOREIGN = ('x86_64' if HERE.startswith('aarch64') else 'aarch64') + '-unknown-linux-gnu'


def object_of(ir: str, triple: str) -> bytes:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return engine.emit(ir, engine.Target(triple))


@pytest.mark.parametrize(
    'spoil',
    [
        lambda code: b'',
        lambda code: b'a text',
        lambda code: code[:16],
        lambda code: code[:64],
        lambda code: code[: len(code) // 2],
        lambda code: code[:-1],
        lambda code: code[:20] + bytes(len(code) - 20),
        lambda code: object_of(IR, FOREIGN),
        lambda code: object_of(IR, 'i686-unknown-linux-gnu'),
        lambda code: object_of(IR, 'x86_64-apple-darwin'),
        lambda code: object_of(IR, 'x86_64-pc-windows-msvc'),
        lambda code: object_of(IR.replace('@f', '@g'), HERE),
        lambda code: object_of('', HERE),
    ],
    ids=[
        *(
            'empty',
            'text',
            'magic',
            'header',
            'half',
            'one byte short',
            'zeros',
            'processor',
            '32 bits',
        ),
        *('macOS', 'Windows', 'another function', 'no function'),
    ],
)
def test_a_sound_file_that_holds_no_object_for_this_processor_is_compiled_again(
    folder: Path, emitted: list[str], spoil: Any
) -> None:
    engine.compile_ir(IR)
    ((name, sound),) = contents(folder).items()
    payload = cache.read(Path(name).stem)
    assert payload is not None
    spoilt = spoil(payload)
    cache.write(Path(name).stem, spoilt)
    assert cache.read(Path(name).stem) == spoilt
    emitted.clear()
    square = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    native = engine.compile_ir(IR)
    assert square(native.address('f'))(3.0) == 9.0
    assert emitted == [IR]
    assert contents(folder) == {name: sound}


def test_what_was_written_under_another_name_is_made_again(
    folder: Path, emitted: list[str]
) -> None:
    engine.compile_ir(IR)
    (name,) = contents(folder)
    engine.compile_ir(IR.replace('fmul', 'fadd'))
    (other,) = contents(folder).keys() - {name}
    (folder / other).replace(folder / name)
    emitted.clear()
    engine.compile_ir(IR)
    assert emitted == [IR]
