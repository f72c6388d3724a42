# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON values on disk: valid for the source of the package that computed them."""

from __future__ import annotations

import json
import os
from pathlib import Path
import py_compile
import subprocess
import sys
from typing import Any
import zipfile

from cache_folders import LIFETIME, ROOT, answers, contents
import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.kernels.runtime import disk_cache as cache
from pfd_core.kernels.runtime import json_cache as facts

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


@pytest.mark.parametrize('after', [-0.5, 1e4])
def test_source_written_when_or_after_the_package_was_imported_is_not_trusted(
    package: Path, after: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts, 'IMPORTED', 1e9)
    os.utime(package, (1e9 + after, 1e9 + after))
    assert [remembered(k) for k in (1, 2)] == [1, 2]


def test_nothing_is_kept_of_source_that_was_edited_before_a_later_import(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kept(key: str, value: int) -> int:
        return facts.get_or_compute((key,), lambda: value, lambda found: type(found) is int)

    assert [kept('before', k) for k in (1, 2)] == [1, 1]
    package.write_text('x = 2\n')
    assert [kept('edited', k) for k in (1, 2)] == [1, 1]
    monkeypatch.setitem(sys.modules, 'pfd_core.imported_later', package)  # type: ignore[misc]
    assert [kept('imported', k) for k in (1, 2)] == [1, 2]
    assert kept('before', 2) == 1


@pytest.mark.parametrize('when', [-1e9, 0.0, 4e9], ids=['before 1970', '1970', 'in the future'])
def test_source_of_any_time_is_remembered(
    package: Path, when: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts, 'IMPORTED', 1e9)
    os.utime(package, (when, when))
    assert [remembered(k) for k in (1, 2)] == [1, 1]


def test_a_cached_entry_depends_on_the_source_and_on_the_versions(
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


WRONG_FACTS = (
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
)


def test_kept_facts_of_another_shape_are_made_again(folder: Path) -> None:
    robot = pfd.load_robot('planar2')
    fresh = pfd.compile_kernel(robot)
    wanted = answers(fresh)
    sound = contents(folder)
    for wrong in WRONG_FACTS:
        for name in sound:
            payload = cache.read(Path(name).stem)
            if payload is not None and payload.startswith(b'{'):
                cache.write(Path(name).stem, wrong)
        assert contents(folder) != sound
        kernel = pfd.compile_kernel(robot)
        assert answers(kernel) == wanted, wrong
        assert kernel.operations == fresh.operations
        assert contents(folder) == sound


def test_a_kept_method_that_does_not_exist_is_chosen_again(folder: Path) -> None:
    robot = pfd.load_robot('planar2')
    method = pfd.compile_kernel(robot).method
    for name, data in contents(folder).items():
        if data.endswith(json.dumps(method).encode()):
            cache.write(Path(name).stem, b'"no method"')
    assert pfd.compile_kernel(robot).method == method


ZIPPED = """
import json, sys
import numpy as np
import pfd_core as pfd
from pfd_core.kernels import kernel
from pfd_core.kernels.runtime import jit as engine
from pfd_core.machine.recorder import Recorder
assert '.zip' in pfd.__file__, pfd.__file__
emitted, emit = [], engine.emit
engine.emit = lambda *args: emitted.append(1) or emit(*args)
recorded, begin = [], Recorder.__init__
Recorder.__init__ = lambda *args, **options: recorded.append(1) or begin(*args, **options)
made = pfd.compile_kernel(pfd.load_robot(sys.argv[1]))
rows = np.random.default_rng(1).uniform(-1, 1, (3, 9, made.robot.n))
bits = made(*rows[:, 0]).tobytes() + made(*rows).tobytes()
print(json.dumps([bits.hex(), bool(recorded), len(emitted)]))
"""


def zipped(archive: Path, robot: Path) -> list[Any]:
    environment = {**os.environ, 'PYTHONPATH': str(archive)}
    command = [sys.executable, '-c', ZIPPED, str(robot)]
    done = subprocess.run(
        command,
        env=environment,
        cwd=archive.parent,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=LIFETIME,
    )
    found: list[Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize('suffix', ['.py', pytest.param('.pyc', marks=pytest.mark.slow)])
def test_a_package_in_a_zip_file_keeps_kernels_too(
    folder: Path, tmp_path: Path, suffix: str
) -> None:
    robot = pfd.load_robot('planar2')
    (tmp_path / 'arm.yaml').write_text(pfd.robot_to_yaml(robot))
    archive = tmp_path / 'package.zip'
    with zipfile.ZipFile(archive, 'w') as file:
        for path in (ROOT / 'pfd_core').rglob('*.py'):
            if suffix == '.pyc':
                py_compile.compile(str(path), str(tmp_path / 'module'), doraise=True)
            source = tmp_path / 'module' if suffix == '.pyc' else path
            file.write(source, path.relative_to(ROOT).with_suffix(suffix))
    os.utime(archive, (1e9, 1e9))
    fresh, kept = (zipped(archive, tmp_path / 'arm.yaml') for _ in range(2))
    kernel = pfd.compile_kernel(robot)
    rows = np.random.default_rng(1).uniform(-1, 1, (3, 9, robot.n))
    bits = kernel(*rows[:, 0]).tobytes() + kernel(*rows).tobytes()
    assert fresh == [bits.hex(), True, 2]
    # Compiled modules alone do not say what source they were compiled from.
    assert kept == [bits.hex(), suffix == '.pyc', 0]
