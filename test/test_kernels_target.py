# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The same bits from code for other processors and for other builds of Python and NumPy."""

from __future__ import annotations

from collections.abc import Iterator
import ctypes
import json
import os
from pathlib import Path
import re
import shutil
import struct
import subprocess
import sys
from typing import Any

import bridge
from bridge import (
    Optimisation,
    Target,
    host_target,
    ir_inputs_of,
    ir_kernel_functions,
    level_target,
    missing_features,
    simd_width,
    turned_joints,
)
import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray
import pytest
from sampling import one_fast
from zoo import random_state

import pfd_core as pfd

ROOT = Path(__file__).parents[1]
ARM64 = Target('aarch64-unknown-linux-gnu')
# Levels of x86-64 by which a user names a processor.
LEVELS = ('x86-64-v2', 'x86-64-v3', 'x86-64-v4')
X86 = host_target().triple.startswith('x86_64')
HERE = host_target().cpu
on_x86 = pytest.mark.skipif(not X86, reason='the processors are of x86-64')
RUNNABLE = [cpu for cpu in LEVELS if X86 and not missing_features(cpu)]
# The files whose tests run code for every processor.
TESTED = ('test_kernels_*.py', 'test_simulation*.py', 'test_brakes_and_payloads.py')
LIFETIME = 3600  # [s] of a run of these tests; far above what it takes
# Objects of Linux, macOS and Windows.
OBJECT = re.compile(rb'\x7fELF|\xcf\xfa\xed\xfe|\x64\x86')
ELF_MACHINE, EM_AARCH64 = slice(18, 20), (183).to_bytes(2, 'little')
COMPILER, EMULATORS = 'aarch64-linux-gnu-gcc', ('qemu-aarch64', 'qemu-aarch64-static')
STATES = 7  # whole blocks and a rest, whatever the width


@pytest.fixture
def features(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, bool]]:
    """Return the features of this machine, which a test may change."""
    found = dict(llvm.get_host_cpu_features())
    monkeypatch.setattr(llvm, 'get_host_cpu_features', lambda: found)
    yield found
    host_target.cache_clear()


def test_a_name_that_is_no_level_is_refused_with_those_that_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ('x86-64-v9', 'x86-64', 'znver4', HERE, 'a"b', '+avx'):
        monkeypatch.setenv('PFD_TARGET_CPU', name)
        expected = '^PFD_TARGET_CPU must be .* one of x86-64-v2, x86-64-v3, x86-64-v4, got '
        with pytest.raises(ValueError, match=expected):
            pfd.compile_kernel(pfd.load_robot('planar2'))


def test_without_a_name_the_code_is_for_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('', ' '):
        monkeypatch.setenv('PFD_TARGET_CPU', name)
        assert bridge.current_target() == host_target()
    monkeypatch.delenv('PFD_TARGET_CPU')
    assert bridge.current_target() == host_target()


def test_a_processor_whose_features_llvm_cannot_detect_is_named_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown() -> None:
        raise RuntimeError('failed to get host cpu features')

    monkeypatch.setattr(llvm, 'get_host_cpu_features', unknown)
    host_target.cache_clear()
    assert host_target() == Target(llvm.get_process_triple(), llvm.get_host_cpu_name(), '')
    host_target.cache_clear()


def module(kernel: pfd.Kernel, width: int) -> str:
    """Return the module of a kernel without its entry from Python."""
    angles, size = turned_joints(kernel.robot), kernel.robot.n
    return '\n'.join(ir_kernel_functions(kernel.program, kernel.dtype, width, angles, size))


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32'], 'float32'))
@pytest.mark.parametrize('name', ['aarch64', *LEVELS])
def test_a_kernel_compiles_for_processors_that_this_machine_may_not_be(
    name: str, dtype: str
) -> None:
    target = for_arm() if name == 'aarch64' else level_target(name)
    scene = pfd.Scene(external_wrench=True, brakes=True)
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=scene, dtype=dtype)
    for width in (1, simd_width(dtype, target)):
        code = bridge.emit_object(module(kernel, width), target)
        assert OBJECT.match(code)
        assert (code[ELF_MACHINE] == EM_AARCH64) == (name == 'aarch64')


def for_arm() -> Target:
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
    features: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    features.update(avx512f=False, fma=False, avx2=True)
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


@on_x86
def test_code_whose_order_is_kept_leaves_the_order_of_other_code_to_llvm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), method='composite_body')
    ir, target = module(kernel, 8), level_target('x86-64-v4')
    usual, kept = Optimisation(), Optimisation(reorder=False)
    before, between, after = (
        bridge.emit_object(ir, target, choice) for choice in (usual, kept, usual)
    )
    assert after == before
    # The two differ, so that one taken for the other would show.
    assert between != before
    # The option that keeps an order is global: without a lock it would change what other threads
    # compile.
    monkeypatch.setattr(*bridge.target('LLVM_LOCK'), None)
    assert bridge.emit_object(ir, target, kept) == before


def results() -> dict[str, bytes]:
    """Return the bits of kernels, quantities, rollouts and an ensemble."""
    rng = np.random.default_rng(19)
    found = {}
    for name, method, refine, dtype in (
        ('planar2', 'auto', 1, 'float64'),
        ('planar2', 'grouped_articulated_body', 0, 'float32'),
        ('planar2', 'pcgm', 0, 'float64'),
    ):
        robot = pfd.load_robot(name)
        states = [random_state(rng, robot.n) for _ in range(19)]
        q, qd, tau = (np.array([row[k] for row in states], dtype) for k in range(3))
        q[2] *= 1e30
        kernel = pfd.compile_kernel(robot, method=method, refine=refine, dtype=dtype)
        found[method] = kernel(q, qd, tau).tobytes()
        found[f'{method}, one state'] = kernel(q[3], qd[3], tau[3]).tobytes()
    H = pfd.compile_kernel(robot, quantity='inertia_matrix')
    found['inertia_matrix'] = H(rng.normal(size=(5, 2))).tobytes()
    limits = np.tile([-0.4, 0.4], (2, 1))
    scene = pfd.Scene(friction=np.full(2, 0.2), joint_limits=limits, restitution=0.4)
    for integrator, effects in (('rk4', scene), ('velocity_verlet', None)):
        simulator = pfd.Simulator(robot, effects, integrator=integrator)
        trajectory = simulator.rollout(np.tile([5.0, -2.0], (400, 1)))
        found[integrator] = trajectory.q.tobytes() + trajectory.qd.tobytes()
    together = pfd.Ensemble(robot, 11, scene)
    together.reset(np.linspace(-0.3, 0.3, 22).reshape(11, 2), np.zeros((11, 2)))
    states = together.rollout(np.full((11, 40, 2), 3.0))
    found['ensemble'] = states.q.tobytes() + states.qd.tobytes()
    return found


@on_x86
@pytest.mark.slow
def test_another_processor_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PFD_CACHE', '')
    wanted = results()
    # It has no fused multiply-add: the C library computes it. The long test below has all levels.
    monkeypatch.setenv('PFD_TARGET_CPU', 'x86-64-v2')
    assert results() == wanted


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
    assert level_target(cpu) != host_target()
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


# ---- 64-bit ARM ------------------------------------------------------------------------------


# Reads the bytes of a number, how many arguments there are, the elements of each and all inputs
# (in hexadecimal); prints the results of a batch in C order, then those of one in Fortran order.
MAIN = """
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int64_t batch(int64_t count, int64_t *table);

static unsigned char *place(int64_t *row, int64_t state, int64_t element) {
    return (unsigned char *)row[0] + state * row[1] + element * row[2];
}

int main(void) {
    int64_t bytes, count, slots, sizes[8], given[3 * 8], table[3 * 8];
    if (scanf("%" SCNd64 " %" SCNd64 " %" SCNd64, &bytes, &count, &slots) != 3) return 2;
    for (int64_t k = 0; k < slots; k++) {
        if (scanf("%" SCNd64, &sizes[k]) != 1) return 2;
        given[3 * k] = (int64_t)calloc(count * sizes[k], bytes);
        given[3 * k + 1] = sizes[k] * bytes;
        given[3 * k + 2] = bytes;
    }
    for (int64_t k = 0; k < slots - 1; k++)
        for (int64_t i = 0; i < count * sizes[k]; i++) {
            uint64_t number;
            if (scanf("%" SCNx64, &number) != 1) return 2;
            memcpy((unsigned char *)given[3 * k] + i * bytes, &number, bytes);
        }
    for (int order = 0; order < 2; order++) {
        for (int64_t k = 0; k < slots; k++) {
            int64_t *row = &table[3 * k];
            row[0] = (int64_t)calloc(count * sizes[k], bytes);
            row[1] = order ? bytes : sizes[k] * bytes;
            row[2] = order ? count * bytes : bytes;
            for (int64_t s = 0; s < count; s++)
                for (int64_t e = 0; e < sizes[k]; e++)
                    memcpy(place(row, s, e), place(&given[3 * k], s, e), bytes);
        }
        if (batch(count, table)) return 3;
        for (int64_t s = 0; s < count; s++)
            for (int64_t e = 0; e < sizes[slots - 1]; e++) {
                uint64_t number = 0;
                memcpy(&number, place(&table[3 * (slots - 1)], s, e), bytes);
                printf("%" PRIx64 "\\n", number);
            }
    }
    return 0;
}
"""


def states(robot: pfd.Robot, dtype: str) -> list[NDArray[np.floating]]:
    """Return positions, velocities, torques and wrenches, one of them with angles far out."""
    rng = np.random.default_rng(6)
    rows = [random_state(rng, robot.n) for _ in range(STATES)]
    q, qd, tau = (np.array([row[k] for row in rows], dtype) for k in range(3))
    q[2] *= 1e30
    return [q, qd, tau, rng.normal(size=(STATES, 6)).astype(dtype)]


def hexadecimal(array: NDArray[np.floating]) -> list[str]:
    code = {'float64': 'Q', 'float32': 'I'}[array.dtype.name]
    return [f'{bits:x}' for bits in struct.unpack(f'<{array.size}{code}', array.tobytes())]


@pytest.fixture(scope='module')
def emulator() -> str:
    """Return the program that runs 64-bit ARM code."""
    found = next((path for name in EMULATORS if (path := shutil.which(name))), None)
    if found is None or shutil.which(COMPILER) is None:
        pytest.skip(f'needs {COMPILER} and one of {EMULATORS} (qemu-user)')
    return found


@pytest.mark.parametrize(('name', 'dtype'), [('ur5', 'float64'), ('panda', 'float32')])
def test_arm_and_this_processor_give_the_same_bits(
    name: str, dtype: str, emulator: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(5)
    robot = pfd.load_robot(name)
    rotors, damping = robot.armature, robot.damping
    scene = pfd.Scene(damping=damping, armature=rotors, external_wrench=True, brakes=True)
    kernel = pfd.compile_kernel(robot, scene=scene, dtype=dtype)
    arrays = states(robot, dtype)
    brakes = rng.random((STATES, robot.n)) < 0.3
    wanted = hexadecimal(kernel(*arrays, brakes=brakes))
    (tmp_path / 'main.c').write_text(MAIN)
    target = for_arm()
    code = bridge.emit_object(module(kernel, simd_width(dtype, target)), target)
    (tmp_path / 'kernel.o').write_bytes(code)
    command = [COMPILER, '-O1', '-static', 'main.c', 'kernel.o', '-o', 'main', '-lm']
    subprocess.run(command, cwd=tmp_path, check=True, timeout=LIFETIME)
    inputs = [*arrays, (1.0 - brakes).astype(dtype)]
    assert ir_inputs_of(kernel.program) == ['q', 'qd', 'tau', 'wrench', 'free']
    words = [str(np.dtype(dtype).itemsize), str(STATES), str(len(inputs) + 1)]
    words += [str(array.shape[1]) for array in inputs] + [str(robot.n)]
    words += [word for array in inputs for word in hexadecimal(array)]
    done = subprocess.run(
        [emulator, str(tmp_path / 'main')],
        input=' '.join(words),
        capture_output=True,
        text=True,
        check=True,
        timeout=LIFETIME,
    )
    assert done.stdout.split() == wanted * 2


# ---- other builds of Python and NumPy ----


CHILD = """
import json, logging, sys
import numpy as np
import pfd_core as pfd
pfd.compile_kernel  # imports the module
from bridge import kernel_objects as objects
objects.ITEMS += int(sys.argv[1])
warnings = []
logging.getLogger('pfd_core').addHandler(handler := logging.Handler())
handler.emit = lambda record: warnings.append(record.getMessage())
found = {}

def note(name, array):
    found[name] = [str(array.dtype), array.shape, np.ascontiguousarray(array).tobytes().hex()]

def refused(*arguments, **options):
    try:
        kernel(*arguments, **options)
    except ValueError as error:
        return str(error)

robot = pfd.load_robot('planar2')
rng = np.random.default_rng(1)
for dtype in ('float64', 'float32'):
    kernel = pfd.compile_kernel(robot, dtype=dtype)
    rows = rng.uniform(-1, 1, (3, 9, robot.n)).astype(dtype)
    one = rows[:, 0].copy()
    note(f'{dtype} one', kernel(*one))
    note(f'{dtype} batch', kernel(*rows))
    note(f'{dtype} columns', kernel(*(np.asfortranarray(row) for row in rows)))
    note(f'{dtype} strided', kernel(*rows[:, ::2]))
    note(f'{dtype} threads', kernel(*rows, threads=2))
    note(f'{dtype} lists', kernel(*one.tolist()))
    for name, given in (('one', one), ('batch', rows)):
        out = np.zeros_like(given[0])
        assert kernel(*given, out=out) is out
        note(f'{dtype} {name} out', out)
        bound = kernel.bind(*given, out)
        given[2] *= 0.5
        assert bound() is out
        note(f'{dtype} {name} bound', out)
        given[0].flat[1] = np.nan
        try:
            bound()
        except ValueError:
            found[f'{dtype} {name} refused'] = refused(*given)
    inverse = pfd.compile_kernel(robot, dtype=dtype, quantity='inverse_dynamics')
    note(f'{dtype} inverse', inverse(*rows[:, 1]))
scene = pfd.Scene(external_wrench=True)
kernel = pfd.compile_kernel(robot, scene=scene, refine=1)
wrench = rng.uniform(-1, 1, 6)
one = rng.uniform(-1, 1, (3, robot.n))
note('wrench', kernel(*one, wrench))
note('error', kernel.error_estimate(*one, wrench)[1])
sim = pfd.Simulator(robot)
sim.step(one[0])
note('step', sim.q)
note('rollout', sim.rollout(np.tile(one[1], (5, 1))).q)
print(json.dumps({'found': found, 'warnings': warnings}))
"""


def run(moved: int) -> dict[str, Any]:
    """Return what a process computes, and its warnings, where the items of tuples are moved."""
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}{ROOT / "test"}'}
    done = subprocess.run(
        [sys.executable, '-c', CHILD, str(moved)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=LIFETIME,
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


def test_this_build_is_as_expected() -> None:
    assert kernel_objects().supported()


@pytest.mark.parametrize(
    'field', ['type', 'data', 'ndim', 'dimensions', 'strides', 'descr', 'flags']
)
def test_every_field_of_an_array_is_checked(field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    own = kernel_objects()
    # The field is in the place of another one.
    fields = dict(own.ArrayObject._fields_)
    names = [{field: 'base', 'base': field}.get(name, name) for name in fields]
    moved = {'_fields_': [(name, fields[name]) for name in names]}
    monkeypatch.setattr(own, 'ArrayObject', type('Moved', (ctypes.Structure,), moved))
    # `__wrapped__` is the function without its cache.
    assert not own.supported.__wrapped__()


def kernel_objects() -> Any:
    """Return the module of the native call, which a kernel imports."""
    assert pfd.compile_kernel
    return bridge.kernel_objects
