# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: the same bits, from any state of the folder."""

from __future__ import annotations

from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

import bridge
from bridge import CACHE_VARIABLE, read_cache
from cache_folders import LIFETIME, ROOT, answers, contents
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
    for key in ('single', 'batch', 'operations', 'ir'):
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


def test_a_kernel_from_disk_still_has_its_program(folder: Path) -> None:
    robot = pfd.load_robot('planar2')
    fresh, kept = pfd.compile_kernel(robot), pfd.compile_kernel(robot)
    assert kept.operations == fresh.operations
    assert str(kept.program) == str(fresh.program)
    assert kept.compile_seconds > 0


def refuse(*_: object) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def in_the_way(folder: Path, _: pytest.MonkeyPatch) -> None:
    folder.write_text('not a folder')


def read_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Permissions do not hold back root, as which tests often run.
    monkeypatch.setattr(os, 'open', refuse)


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
