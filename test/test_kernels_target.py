# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Code for other processors: which can run here, and the same bits from all of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
import re
import subprocess
import sys

import bridge
from bridge import (
    USUAL_OPTIMISATION,
    compile_ir,
    host_target,
    ir_kernel_functions,
    level_target,
    missing_features,
    simd_width,
    turned_joints,
)
from fused_products import cancelling, everywhere, native, rounded
import llvmlite.binding as llvm
import numpy as np
import pytest
from sampling import one_fast
from zoo import random_state

import pfd_core as pfd

ROOT = Path(__file__).parents[1]
# States in a vector register of float64, as the manuals of the processors say.
WIDTHS = {'x86-64-v2': 2, 'x86-64-v3': 4, 'x86-64-v4': 8}
X86 = host_target().triple.startswith('x86_64')
HERE = host_target().cpu
on_x86 = pytest.mark.skipif(not X86, reason='the processors are of x86-64')
RUNNABLE = [cpu for cpu in WIDTHS if X86 and not missing_features(cpu)]
# The files whose tests run code for every processor.
TESTED = ('test_kernels_*.py', 'test_simulation*.py', 'test_brakes.py')
LIFETIME = 3600  # [s]
# Objects of Linux, macOS and Windows.
OBJECT = re.compile(rb'\x7fELF|\xcf\xfa\xed\xfe|\x64\x86')


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


def module(kernel: pfd.Kernel, width: int) -> str:
    """Return the module of a kernel without its entry from Python."""
    angles, size = turned_joints(kernel.robot), kernel.robot.n
    return '\n'.join(ir_kernel_functions(kernel.program, 'float64', width, angles, size))


@on_x86
@pytest.mark.parametrize(('cpu', 'width'), WIDTHS.items())
def test_a_kernel_compiles_for_processors_that_this_machine_may_not_be(
    cpu: str, width: int
) -> None:
    target = level_target(cpu)
    assert simd_width('float64', target) == width
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    ir = module(kernel, width)
    assert OBJECT.match(bridge.emit_object(ir, target))


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
        compile_ir('define i64 @own() {\n  ret i64 7\n}', ['own'])
    assert len(emitted) == 1 + len(RUNNABLE) > 1


@on_x86
def test_code_whose_order_is_kept_leaves_the_order_of_other_code_to_llvm() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), method='composite_body')
    ir = module(kernel, 8)
    target = level_target('x86-64-v4')
    usual, kept = USUAL_OPTIMISATION, replace(USUAL_OPTIMISATION, reorder=False)
    before, between, after = (
        bridge.emit_object(ir, target, choice) for choice in (usual, kept, usual)
    )
    assert after == before
    # The two differ, so that one taken for the other would show.
    assert between != before


@on_x86
def test_without_llvmlites_lock_llvm_orders_all_code(monkeypatch: pytest.MonkeyPatch) -> None:
    # The option that keeps an order is global: it would change what other threads compile.
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), method='composite_body')
    ir = module(kernel, 8)
    target = level_target('x86-64-v4')
    monkeypatch.setattr(*bridge.target('LLVM_LOCK'), None)
    kept = replace(USUAL_OPTIMISATION, reorder=False)
    assert bridge.emit_object(ir, target, kept) == bridge.emit_object(
        ir, target, USUAL_OPTIMISATION
    )


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


@on_x86
@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_a_multiply_add_is_rounded_once_on_a_processor_without_one(
    dtype: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('PFD_TARGET_CPU', 'x86-64-v2')
    assert '+fma' not in bridge.current_target().features.split(',')
    function = native(dtype)
    for kind in (cancelling, everywhere):
        for a, b, c in zip(*kind(dtype, 300, np.random.default_rng(3)), strict=True):
            exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
            assert function(a, b, c) == rounded(exact, dtype)


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


@on_x86
@pytest.mark.slow
def test_the_option_of_the_tests_refuses_a_processor_that_cannot_be(tmp_path: Path) -> None:
    command = (sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider')
    done = subprocess.run(
        [*command, '--target-cpu=x86-64-v9', '--collect-only', files(('test_brakes.py',))[0]],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIFETIME,
    )
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert 'ERROR: PFD_TARGET_CPU must be' in done.stderr
