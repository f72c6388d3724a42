# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The same IR on another processor: it compiles for 64-bit ARM and gives the same bits."""

from __future__ import annotations

import ctypes
from pathlib import Path
import platform
import shutil
import struct
import subprocess

from bridge import (
    TARGET_VARIABLE,
    Target,
    compile_ir,
    emit_object,
    host_target,
    ir_inputs_of,
    ir_kernel_functions,
    simd_width,
    turned_joints,
)
import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray
import pytest
from sampling import one_fast
from zoo import random_chain, random_state

import pfd_core as pfd

ARM64 = Target('aarch64-unknown-linux-gnu')
NEON = {'float64': 2, 'float32': 4}
ELF, ELF_MACHINE, EM_AARCH64 = b'\x7fELF', 18, 183
COMPILER, LINKER = 'aarch64-linux-gnu-gcc', '-static'
EMULATORS = ('qemu-aarch64', 'qemu-aarch64-static')
LIFETIME = 120  # [s] of a compiler or an emulator; far above what it takes
STATES = 7  # whole blocks and a rest, whatever the width


def scene_of(robot: pfd.Robot) -> pfd.Scene:
    rotors, damping = robot.armature, robot.damping
    return pfd.Scene(damping=damping, armature=rotors, external_wrench=True, brakes=True)


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


def module(kernel: pfd.Kernel, width: int) -> str:
    """Return the module of a kernel without its entry from Python."""
    program, angles = kernel.program, turned_joints(kernel.robot)
    size = kernel.robot.n
    return '\n'.join(ir_kernel_functions(program, kernel.dtype, width, angles, size))


def for_arm(ir: str) -> bytes:
    """Return an object for 64-bit ARM."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        llvm.Target.from_triple(ARM64.triple)
    except RuntimeError:
        pytest.skip('this LLVM was built without 64-bit ARM')
    return emit_object(ir, ARM64)


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


@pytest.mark.parametrize('dtype', one_fast(NEON))
def test_every_module_of_a_kernel_compiles_for_64_bit_arm(dtype: str) -> None:
    robot = pfd.load_robot('planar2')
    kernel = pfd.compile_kernel(robot, scene=scene_of(robot), dtype=dtype)
    for width in (1, NEON[dtype], 2 * NEON[dtype]):
        ir = module(kernel, width)
        assert 'llvm.x86' not in ir
        code = for_arm(ir)
        assert code[:4] == ELF
        assert int.from_bytes(code[ELF_MACHINE : ELF_MACHINE + 2], 'little') == EM_AARCH64


@pytest.mark.parametrize(
    ('name', 'dtype'), [('ur5', 'float64'), ('panda', 'float32'), ('skew', 'float64')]
)
def test_arm_and_this_processor_give_the_same_bits(
    name: str, dtype: str, emulator: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(5)
    robot = random_chain(rng, 4) if name == 'skew' else pfd.load_robot(name)
    kernel = pfd.compile_kernel(robot, scene=scene_of(robot), dtype=dtype)
    arrays = states(robot, dtype)
    brakes = rng.random((STATES, robot.n)) < 0.3
    wanted = hexadecimal(kernel(*arrays, brakes=brakes))
    (tmp_path / 'main.c').write_text(MAIN)
    (tmp_path / 'kernel.o').write_bytes(for_arm(module(kernel, NEON[dtype])))
    command = [COMPILER, '-O1', LINKER, 'main.c', 'kernel.o', '-o', 'main', '-lm']
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


@pytest.mark.parametrize(
    ('target', 'widths'),
    [
        (ARM64, NEON),
        (Target('x86_64-unknown-linux-gnu'), {'float64': 2, 'float32': 4}),
        (Target('x86_64-unknown-linux-gnu', '', '+avx,+sse2'), {'float64': 4, 'float32': 8}),
        (Target('x86_64-unknown-linux-gnu', '', '+avx,-avx512f'), {'float64': 4, 'float32': 8}),
        (Target('x86_64-unknown-linux-gnu', '', '+avx,+avx512f'), {'float64': 8, 'float32': 16}),
    ],
)
def test_the_width_equals_a_vector_register_of_the_target(
    target: Target, widths: dict[str, int]
) -> None:
    assert {dtype: simd_width(dtype, target) for dtype in widths} == widths


def test_a_processor_whose_features_llvm_cannot_detect_is_named_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown() -> None:
        raise RuntimeError('failed to get host cpu features')

    monkeypatch.setattr(llvm, 'get_host_cpu_features', unknown)
    host_target.cache_clear()
    assert host_target() == Target(llvm.get_process_triple(), llvm.get_host_cpu_name(), '')
    host_target.cache_clear()


def test_ir_that_is_no_module_is_refused() -> None:
    with pytest.raises(RuntimeError, match='expected value token'):
        emit_object('define double @f(double %x) { ret double }', host_target())


@pytest.mark.skipif(platform.machine() != 'x86_64', reason='names a processor of x86')
def test_operations_that_a_processor_lacks_come_from_the_c_library(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ir = (
        'declare double @llvm.fma.f64(double, double, double)\n'
        'define double @f(double %x, double %y, double %z) {\n'
        '  %r = call double @llvm.fma.f64(double %x, double %y, double %z)\n  ret double %r\n}'
    )
    monkeypatch.setenv(TARGET_VARIABLE, 'x86-64-v2')
    native = compile_ir(ir, ['f'])
    number = ctypes.c_double
    fma = ctypes.CFUNCTYPE(number, number, number, number)(native['f'])
    # The product is 1 - 2^-104, which is one as a float64.
    assert fma(1 - 2.0**-52, 1 + 2.0**-52, -1.0) == -(2.0**-104)
    with pytest.raises(KeyError):
        native['g']
