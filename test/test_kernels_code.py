# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Native code: kept on disk, the same bits for other processors and builds of Python."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from typing import Any
from unittest.mock import Mock

import llvmlite.binding as llvm
import numpy as np
import pytest
from zoo import one_fast, random_chain, random_state, slider

import pfd_core as pfd
from pfd_core.kernels import cache, generate, native, objects, recipes
from pfd_core.model.robot import Frame

ROOT = Path(__file__).resolve().parent.parent
LIFETIME = 3600  # [s] of a process; far above what it takes


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
    for name, value in ((cache.VARIABLE, variable), ('XDG_CACHE_HOME', base), ('HOME', '/home')):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert cache.folder() == (None if expected is None else Path(expected))


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


CHILD = """
import json, sys
import numpy as np
from pfd_core.kernels import native
from pfd_core.machine.recorder import Recorder
import pfd_core as pfd
emitted, emit = [], native.emit
native.emit = lambda *args: emitted.append(1) or emit(*args)
recorded, begin = [], Recorder.__init__
Recorder.__init__ = lambda *args, **given: recorded.append(1) or begin(*args, **given)
robot = pfd.load_robot(sys.argv[1])
kernel = pfd.compile_kernel(robot)
rows = np.random.default_rng(1).uniform(-1, 1, (3, 9, robot.n))
bits = kernel(*rows[:, 0]).tobytes().hex() + kernel(*rows).tobytes().hex()
counts = bool(recorded), len(emitted)  # before the program of the kernel is recorded to be read
print(json.dumps([[bits, kernel.operations, kernel.ir, str(kernel.program)], *counts]))
"""


def test_an_entry_that_cannot_be_used_is_a_miss(folder: Path) -> None:
    robot = slider(0.0, 1.0)
    wanted = answers(pfd.compile_kernel(robot))
    sound = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert len(sound) == 2  # roundings of a method, and the code
    for damage, make in DAMAGES.items():
        entries = {name: cache.read(Path(name).stem) for name in sound}
        for name in sound:
            make(folder / name)
        assert entries != {name: cache.read(Path(name).stem) for name in sound}, damage
        kernel = pfd.compile_kernel(robot)
        assert answers(kernel) == wanted, damage
        assert kernel.operations
        shutil.rmtree(folder)
        folder.mkdir(mode=0o700)
        for name, content in sound.items():
            (folder / name).write_bytes(content)
            (folder / name).chmod(0o600)


@pytest.mark.parametrize('unsafe', ['mode', 'owner'])
def test_a_folder_in_which_others_could_put_code_is_not_used(
    folder: Path, unsafe: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    cache.write('0' * 64, b'x')
    assert folder.stat().st_mode & 0o777 == 0o700
    assert [path.stat().st_mode & 0o777 for path in folder.iterdir()] == [0o600]
    with monkeypatch.context() as patch:
        patch.setattr(os, 'utime', Mock(side_effect=OSError(errno.EROFS, 'read-only')))
        assert cache.read('0' * 64) == b'x'
    if unsafe == 'mode':
        folder.chmod(0o720)
    else:
        os.chown(folder, 12345, -1) if os.geteuid() == 0 else monkeypatch.setattr(
            os, 'geteuid', lambda: 12345
        )
    for _ in range(2):
        assert cache.read('0' * 64) is None
        cache.write('1' * 64, b'x')
    assert [path.stem for path in folder.iterdir()] == ['0' * 64]
    (record,) = caplog.records
    assert str(folder) in record.message
    assert 'chmod go-w' in record.message


def test_the_least_recently_used_entries_are_removed_first_and_nothing_else(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('pfd_core.kernels.cache.LIMIT', 4000)
    names = [str(k) * 64 for k in range(5)]
    folder.mkdir(mode=0o700)
    (folder / 'notes.txt').write_bytes(bytes(10_000))
    for age, name in enumerate(names[:4]):
        cache.write(name, bytes(900))
        os.utime(folder / f'{name}.pfd', (2 + age, 2 + age))
    assert cache.read(names[0]) == bytes(900)
    cache.write(names[4], bytes(900))
    assert {path.stem for path in folder.iterdir()} == {'notes', names[0], names[3], names[4]}


def test_what_is_made_after_an_edit_of_the_source_is_not_kept(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []

    def make() -> tuple[dict[str, Any], bytes]:
        made.append('x')
        return {}, b''

    edited = tmp_path / 'edited'
    shutil.copytree(cache.PACKAGE, edited, ignore=shutil.ignore_patterns('*.pyc'))
    with monkeypatch.context() as patch:
        patch.setattr(cache, 'PACKAGE', edited)
        patch.setattr(cache, 'FILES', cache._files())
        assert cache.kept(('before',), make) == cache.kept(('before',), make)
        assert len(made) == 1
        (edited / 'kernels' / 'cache.py').touch()
        for _ in range(2):
            cache.kept(('after',), make)
    assert len(made) == 3


def start_child(robot: str) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(ROOT), str(ROOT / 'test')])
    environment = {**os.environ, 'PYTHONPATH': path}
    command = [sys.executable, '-c', CHILD, robot]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def result(child: subprocess.Popen[str]) -> list[Any]:
    text, _ = child.communicate(timeout=LIFETIME)
    assert child.returncode == 0
    found: list[Any] = json.loads(text)
    return found


@pytest.mark.parametrize('scene', [pfd.Scene(), pfd.Scene(friction=[0.1, 0.1])])
def test_a_second_simulation_from_disk_records_no_program(
    folder: Path, monkeypatch: pytest.MonkeyPatch, scene: pfd.Scene
) -> None:
    robot = pfd.load_robot('planar2')
    first = pfd.Simulator(robot, scene).rollout(np.zeros((3, robot.n)))
    recorded: list[Any] = []
    # Entered for each program that is recorded.
    uncollected = recipes.uncollected
    monkeypatch.setattr(
        'pfd_core.kernels.recipes.uncollected', lambda: recorded.append(1) or uncollected()
    )
    again = pfd.Simulator(robot, scene).rollout(np.zeros((3, robot.n)))
    assert not recorded
    assert again.q.tobytes() == first.q.tobytes()


def test_a_second_process_gets_the_same_bits_without_recording_or_compiling(folder: Path) -> None:
    fresh, kept = result(start_child('ur5')), result(start_child('ur5'))
    assert fresh[1:] == [True, 1]
    assert kept == [fresh[0], False, 0]


@pytest.mark.slow
def test_two_processes_at_once_leave_one_sound_copy(folder: Path) -> None:
    children = [start_child('planar2'), start_child('planar2')]
    first, second = (result(child) for child in children)
    assert first[0] == second[0]
    # Roundings of two methods, and the code; nothing unfinished.
    assert len(contents(folder)) == 3
    assert all(cache.read(Path(name).stem) for name in contents(folder))


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
    monkeypatch.setenv(cache.VARIABLE, '')
    wanted = [seen(pfd.compile_kernel(**choice)) for choice in choices]
    torques = seen(pfd.compile_kernel(arm, quantity='inverse_dynamics'))
    # They differ at all, so that one taken for another would show.
    assert len({*wanted, torques}) == len(choices) + 1
    monkeypatch.setenv(cache.VARIABLE, str(folder))
    for _ in range(2):
        count = len(emitted)
        assert [seen(pfd.compile_kernel(**choice)) for choice in choices] == wanted
        assert seen(pfd.compile_kernel(arm, quantity='inverse_dynamics')) == torques
    assert len(emitted) == count


OBSTACLES: dict[str, Callable[..., object]] = {
    'a file in its place': lambda folder, patch: folder.write_text('not a folder'),
    # Permissions do not hold back root, as which tests often run.
    'read-only': lambda folder, patch: patch.setattr(os, 'open', refuse),
    'full': lambda folder, patch: patch.setattr(os, 'replace', refuse),
}


def refuse(*_: object) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


@pytest.mark.parametrize('obstacle', OBSTACLES)
def test_where_nothing_can_be_written_kernels_work_after_one_warning(
    folder: Path, obstacle: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    robot = slider(0.0, 1.0)
    wanted = answers(pfd.compile_kernel(robot))
    for name in contents(folder):
        (folder / name).unlink()
    folder.rmdir()
    OBSTACLES[obstacle](folder, monkeypatch)
    caplog.clear()
    for _ in range(2):
        assert answers(pfd.compile_kernel(robot)) == wanted
    (record,) = caplog.records
    assert (record.name, record.levelname) == ('pfd_core', 'WARNING')
    assert f'cannot be kept in {str(folder)!r}' in record.message
    assert cache.VARIABLE in record.message
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


ARM64 = native.Target('aarch64-unknown-linux-gnu')
# Levels of x86-64 by which a user names a processor.
LEVELS = ('x86-64-v2', 'x86-64-v3', 'x86-64-v4')
X86 = native.host().triple.startswith('x86_64')
HERE = native.host().cpu
on_x86 = pytest.mark.skipif(not X86, reason='the processors are of x86-64')
RUNNABLE = [cpu for cpu in LEVELS if X86 and not native.missing_features(cpu)]
# The files whose tests run code for every processor.
TESTED = (
    'test_kernels*.py',
    'test_machine.py',
    'test_simulation.py',
    'test_contact.py',
    'test_effects.py',
)
# Objects of Linux, macOS and Windows.
OBJECT = re.compile(rb'\x7fELF|\xcf\xfa\xed\xfe|\x64\x86')
ELF_MACHINE, EM_AARCH64 = slice(18, 20), (183).to_bytes(2, 'little')


def test_a_name_that_is_no_level_is_refused_with_those_that_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ('x86-64-v9', 'x86-64', 'znver4', HERE, 'a"b', '+avx'):
        monkeypatch.setenv('PFD_TARGET_CPU', name)
        expected = '^PFD_TARGET_CPU must be .* one of x86-64-v2, x86-64-v3, x86-64-v4, got '
        with pytest.raises(ValueError, match=expected):
            pfd.compile_kernel(pfd.load_robot('planar2'))


@pytest.mark.parametrize('name', ['', ' ', None])
def test_without_a_name_the_code_is_for_this_machine(
    name: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv('PFD_TARGET_CPU', raising=False)
    if name is not None:
        monkeypatch.setenv('PFD_TARGET_CPU', name)
    assert native.current() == native.host()


def test_a_processor_whose_features_llvm_cannot_detect_is_named_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown() -> None:
        raise RuntimeError('failed to get host cpu features')

    monkeypatch.setattr(llvm, 'get_host_cpu_features', unknown)
    native.host.cache_clear()
    assert native.host() == native.Target(llvm.get_process_triple(), llvm.get_host_cpu_name(), '')
    native.host.cache_clear()


def module(kernel: pfd.Kernel, width: int) -> str:
    """Return the module of a kernel without its entry from Python."""
    angles = recipes.turned_joints(kernel.robot)
    return '\n'.join(generate.kernel_functions(kernel.program, kernel.dtype, width, angles))


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32'], 'float32'))
@pytest.mark.parametrize('name', ['aarch64', *LEVELS])
def test_a_kernel_compiles_for_processors_that_this_machine_may_not_be(
    name: str, dtype: str
) -> None:
    target = for_arm() if name == 'aarch64' else native.level_target(name)
    scene = pfd.Scene(external_wrench=True, brakes=True)
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=scene, dtype=dtype)
    for width in (1, native.simd_width(dtype, target)):
        code = native.emit(module(kernel, width), target)
        assert OBJECT.match(code)
        assert (code[ELF_MACHINE] == EM_AARCH64) == (name == 'aarch64')


def for_arm() -> native.Target:
    """Return the processor of 64-bit ARM; skip the test where LLVM was built without it."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        llvm.Target.from_triple(ARM64.triple)
    except RuntimeError:
        pytest.skip('this LLVM was built without 64-bit ARM')
    return ARM64


@on_x86
def test_a_processor_with_instructions_that_this_machine_lacks_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    features = dict.fromkeys(native.LEVELS['x86-64-v4'], True) | {'avx512f': False, 'fma': False}
    monkeypatch.setattr(llvm, 'get_host_cpu_features', lambda: features)
    monkeypatch.setenv('PFD_TARGET_CPU', 'x86-64-v4')
    expected = rf'\({re.escape(HERE)}\), got .x86-64-v4., which needs fma, avx512f$'
    with pytest.raises(ValueError, match=expected):
        pfd.compile_kernel(pfd.load_robot('planar2'))


@on_x86
def test_every_processor_has_its_own_code_in_the_cache(
    folder: Path, emitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for cpu in ('', *RUNNABLE):
        monkeypatch.setenv('PFD_TARGET_CPU', cpu)
        pfd.compile_kernel(pfd.load_robot('planar2'))
    assert len(emitted) == 1 + len(RUNNABLE) > 1


def files(patterns: tuple[str, ...]) -> list[str]:
    return sorted(str(path) for pattern in patterns for path in (ROOT / 'test').glob(pattern))


@on_x86
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(LIFETIME)
@pytest.mark.parametrize('cpu', RUNNABLE)
def test_the_tests_of_kernels_and_simulation_pass_for_every_processor(
    cpu: str, tmp_path: Path
) -> None:
    assert native.level_target(cpu) != native.host()
    # Its header names the processor, which -q would leave out.
    command = (sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider')
    temporary = f'--basetemp={tmp_path / "tests"}'
    done = subprocess.run(
        [*command, temporary, f'--target-cpu={cpu}', *files(TESTED)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIFETIME,
    )
    assert done.returncode == 0, done.stdout[-10_000:]
    assert f'compiled for {cpu}' in done.stdout


# ---- other builds of Python and NumPy ----


BUILD = """
import json, logging, sys
import numpy as np
import pfd_core as pfd
pfd.compile_kernel  # imports the module
from pfd_core.kernels import objects
objects.ITEMS += int(sys.argv[1])
warnings, found = [], []
logging.getLogger('pfd_core').addHandler(handler := logging.Handler())
handler.emit = lambda record: warnings.append(record.getMessage())

def note(array):
    found.append([str(array.dtype), array.shape, np.ascontiguousarray(array).tobytes().hex()])

def refusal(call, *arguments):
    try:
        call(*arguments)
    except ValueError as error:
        return str(error)

robot = pfd.load_robot('planar2')
rng = np.random.default_rng(1)
for dtype in ('float64', 'float32'):
    kernel = pfd.compile_kernel(robot, dtype=dtype)
    rows = rng.uniform(-1, 1, (3, 9, robot.n)).astype(dtype)
    for given in (rows, [np.asfortranarray(x) for x in rows], rows[:, ::2], rows[:, 0].tolist()):
        note(kernel(*given))
    note(kernel(*rows, threads=2))
    for given in (rows[:, 0].copy(), rows):
        out = np.zeros_like(given[0])
        assert kernel(*given, out=out) is out
        bound = kernel.bind(*given, out)
        given[2] *= 0.5
        assert bound() is out
        note(out)
        given[0].flat[1] = np.nan
        found.append([refusal(bound), refusal(kernel, *given)])
    note(pfd.compile_kernel(robot, dtype=dtype, quantity='inverse_dynamics')(*rows[:, 1]))
kernel = pfd.compile_kernel(robot, scene=pfd.Scene(external_wrench=True), refine=1)
one, wrench = rng.uniform(-1, 1, (3, robot.n)), rng.uniform(-1, 1, 6)
note(kernel(*one, wrench))
note(kernel.error_estimate(*one, wrench)[1])
sim = pfd.Simulator(robot)
sim.step(one[0])
note(sim.rollout(np.tile(one[1], (5, 1))).q)
print(json.dumps({'found': found, 'warnings': warnings}))
"""


def run(moved: int) -> dict[str, Any]:
    """Return what a process computes, and its warnings, where the items of tuples are moved."""
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}{ROOT / "test"}'}
    command = [sys.executable, '-c', BUILD, str(moved)]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=LIFETIME
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_another_build_of_python_or_numpy_computes_the_same_bits() -> None:
    expected, other = run(0), run(8)
    assert other['found'] == expected['found']
    assert not expected['warnings']
    (warning,) = other['warnings']
    assert 'takes a longer way' in warning
    assert np.__version__ in warning


@pytest.mark.parametrize(
    'field', ['', 'type', 'data', 'ndim', 'dimensions', 'strides', 'descr', 'flags']
)
def test_every_field_of_an_array_is_checked(field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # The field is in the place of another one.
    fields = dict(objects.ArrayObject._fields_)
    names = [{field: 'base', 'base': field or 'base'}.get(name, name) for name in fields]
    moved = {'_fields_': [(name, fields[name]) for name in names]}
    monkeypatch.setattr(objects, 'ArrayObject', type('Moved', (ctypes.Structure,), moved))
    # `__wrapped__` is the function without its cache.
    assert objects.supported.__wrapped__() == (not field)
