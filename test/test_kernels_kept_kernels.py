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
import subprocess
import sys
from typing import Any

import bridge
from bridge import (
    CACHE_HEAD,
    CACHE_VARIABLE,
    USUAL_OPTIMISATION,
    Optimisation,
    Target,
    compile_ir,
    host_target,
    object_key,
    outline_ir,
    read_cache,
    write_cache,
)
from cache_folders import IR, LIFETIME, ROOT, answers, contents
import llvmlite
import llvmlite.binding as llvm
import numpy as np
import pytest
from sampling import one_fast
from zoo import random_chain

import pfd_core as pfd

CHILD = """
import json, sys
import numpy as np
import bridge
import pfd_core as pfd
# Whoever edits the package while its tests run knows what he does.
bridge.put('JSON_CACHE_IMPORTED', float('inf'))
bridge.json_cache_sources.cache_clear()
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
    'recorded': bool(recorded),
    'ir': kernel.ir,
}))
"""
HOST = Target('x86_64-unknown-linux-gnu', 'haswell', '+avx,+avx2')


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
    uncollected = bridge.source_uncollected
    monkeypatch.setattr(
        *bridge.target('source_uncollected'), lambda: recorded.append(1) or uncollected()
    )
    again = pfd.Simulator(robot, scene).rollout(np.zeros((3, robot.n)))
    assert not recorded
    assert again.q.tobytes() == first.q.tobytes()


def test_a_second_process_gets_the_same_bits_without_recording_or_compiling(folder: Path) -> None:
    fresh, kept = result(start_child('ur5')), result(start_child('ur5'))
    assert (fresh['recorded'], fresh['emitted']) == (True, 2)
    assert (kept['recorded'], kept['emitted']) == (False, 0)
    for key in ('single', 'batch', 'operations', 'ir'):
        assert kept[key] == fresh[key], key


@pytest.mark.slow
def test_two_processes_at_once_leave_one_sound_copy(folder: Path) -> None:
    children = [start_child('planar2'), start_child('planar2')]
    first, second = (result(child) for child in children)
    assert (first['single'], first['batch']) == (second['single'], second['batch'])
    written = contents(folder)
    # Facts, the method of the default, two modules of IR and two objects; nothing unfinished.
    assert len(written) == 6
    assert all(read_cache(Path(name).stem) for name in written)
    assert result(start_child('planar2'))['emitted'] == 0


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    'damage',
    [
        pytest.param(lambda data: b'', id='empty', marks=SLOW),
        pytest.param(lambda data: data[: len(data) // 2], id='half', marks=SLOW),
        pytest.param(lambda data: data[:-1], id='one byte short', marks=SLOW),
        pytest.param(lambda data: data + b'\0', id='one byte more', marks=SLOW),
        pytest.param(lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:], id='one bit'),
        pytest.param(
            lambda data: data.replace(CACHE_HEAD, b'pfd_ros cache 0\n'),
            id='another format',
            marks=SLOW,
        ),
    ],
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


def test_a_kernel_from_disk_still_has_its_program(folder: Path) -> None:
    robot = pfd.load_robot('planar2')
    fresh, kept = pfd.compile_kernel(robot), pfd.compile_kernel(robot)
    assert kept.operations == fresh.operations
    assert str(kept.program) == str(fresh.program)
    assert kept.compile_seconds > 0


def test_the_name_of_an_object_depends_on_all_that_decides_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def key(ir: str, target: Target, optimisation: Optimisation) -> str:
        return object_key(outline_ir(ir).digest, target, optimisation)

    usual = USUAL_OPTIMISATION
    names = [
        key(IR, HOST, usual),
        key(IR + '\n', HOST, usual),
        key(IR, replace(HOST, cpu='skylake'), usual),
        key(IR, replace(HOST, features='+avx'), usual),
        key(IR, replace(HOST, triple='aarch64-linux-gnu'), usual),
        key(IR, HOST, replace(usual, passes=())),
        key(IR, HOST, replace(usual, pipeline=1)),
        key(IR, HOST, replace(usual, code=3)),
        key(IR, HOST, replace(usual, reorder=False)),
    ]
    monkeypatch.setattr(llvmlite, '__version__', '0.0')
    names.append(key(IR, HOST, usual))
    assert len(set(names)) == len(names)
    assert key(IR, HOST, usual) == names[-1]


HERE = host_target().triple
FOREIGN = ('x86_64' if HERE.startswith('aarch64') else 'aarch64') + '-unknown-linux-gnu'


def object_of(ir: str, triple: str) -> bytes:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return bridge.emit_object(ir, Target(triple))


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
    compile_ir(IR)
    ((name, sound),) = contents(folder).items()
    payload = read_cache(Path(name).stem)
    assert payload is not None
    spoilt = spoil(payload)
    write_cache(Path(name).stem, spoilt)
    assert read_cache(Path(name).stem) == spoilt
    emitted.clear()
    square = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    native = compile_ir(IR)
    assert square(native.address('f'))(3.0) == 9.0
    assert emitted == [IR]
    assert contents(folder) == {name: sound}


def test_what_was_written_under_another_name_is_made_again(
    folder: Path, emitted: list[str]
) -> None:
    compile_ir(IR)
    (name,) = contents(folder)
    compile_ir(IR.replace('fmul', 'fadd'))
    (other,) = contents(folder).keys() - {name}
    (folder / other).replace(folder / name)
    emitted.clear()
    compile_ir(IR)
    assert emitted == [IR]


def refuse(*_: object) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def in_the_way(folder: Path, _: pytest.MonkeyPatch) -> None:
    folder.write_text('not a folder')


def read_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Permissions do not hold back root, as which tests often run.
    real_open = os.open

    def open_to_read(path: Any, flags: int, *rest: Any, **options: Any) -> int:
        if flags & os.O_CREAT:
            refuse()
        return real_open(path, flags, *rest, **options)

    monkeypatch.setattr(os, 'open', open_to_read)


def full(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'replace', refuse)


@pytest.mark.parametrize('obstacle', one_fast([in_the_way, read_only, full], read_only))
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
