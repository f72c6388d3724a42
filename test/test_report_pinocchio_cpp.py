# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pinocchio's C++ is the arm that Pinocchio's Python computes, or is left out with the reason."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import shutil

import numpy as np
import pytest
import tolerances
import zoo

import pfd_core as pfd
from pfd_core.model import resolve
from pfd_core.report.cases.hard_cases import CASES
from pfd_core.report.contenders import native, pinocchio_cpp
from pfd_core.report.contenders.pinocchio import Pinocchio
from pfd_core.report.contenders.pinocchio_cpp import FUNCTIONS, PinocchioCpp
from pfd_core.report.contenders.work import LeftOutError, Work
from pfd_core.report.measure.differences import largest_difference
from pfd_core.report.measure.reference import errors, reference

pin = pytest.importorskip('pinocchio')
WITH_COMPILER = pytest.mark.skipif(
    shutil.which(native.CPP.compiler) is None, reason='needs a C++ compiler'
)


@pytest.fixture
def uncompiled() -> Iterator[None]:
    """Forget the library that a test before has compiled."""
    pinocchio_cpp.compiled_library.cache_clear()
    yield
    pinocchio_cpp.compiled_library.cache_clear()


@pytest.mark.usefixtures('uncompiled')
def test_without_a_compiler_it_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, 'which', lambda name: None)
    with pytest.raises(LeftOutError, match=r'there is no C\+\+ compiler \(g\+\+\)'):
        PinocchioCpp(pfd.load_robot('planar2'))


@pytest.mark.usefixtures('uncompiled')
def test_a_header_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, 'which', lambda name: name)
    headers = (pinocchio_cpp.HEADERS[0], 'Eigen/Absent')
    monkeypatch.setattr(pinocchio_cpp, 'HEADERS', headers)
    with pytest.raises(LeftOutError, match=r'no header Eigen/Absent in .*: install the extra'):
        PinocchioCpp(pfd.load_robot('planar2'))


@pytest.mark.usefixtures('uncompiled')
def test_the_message_of_the_compiler_is_shown(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    compiler = tmp_path / 'g++'
    compiler.write_text(
        '#!/bin/sh\necho "note: none" >&2\necho "arm.cpp:1: error: x" >&2\nexit 1\n'
    )
    compiler.chmod(0o755)
    monkeypatch.setattr(shutil, 'which', lambda name: str(compiler))
    monkeypatch.setattr(pinocchio_cpp, 'include_folders', lambda: [tmp_path])
    with pytest.raises(LeftOutError, match=r'g\+\+ failed: arm\.cpp:1: error: x'):
        PinocchioCpp(pfd.load_robot('planar2'))


@pytest.mark.parametrize(
    'array',
    [np.zeros((3, 4)), np.zeros((3, 6), np.float32), np.zeros((6, 3)).T],
    ids=['joints', 'format', 'order'],
)
def test_arrays_that_cpp_would_misread_are_refused(array: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r'contiguous float64 \(\.\.\., 6\), got'):
        pinocchio_cpp.checked(6, np.zeros(6), array)


@pytest.mark.long
@WITH_COMPILER
def test_every_function_gives_what_pinocchio_gives_in_python() -> None:
    # Joints of all kinds on odd axes, on a base that is turned.
    arm = pfd.load_robot(zoo.ODD_ARM, tip='tool')
    q, qd, tau = np.random.default_rng(3).uniform(-1, 1, (3, 5, arm.n))
    model = zoo.to_pinocchio(arm)
    states = list(zip(q, qd, tau, strict=True))
    wanted = np.array([pin.aba(model, model.createData(), *state) for state in states])
    peer = PinocchioCpp(arm)
    for work in (Work('batch', q, qd, tau), Work('call', q[0], qd[0], tau[0])):
        sides = list(peer.sides(work))
        assert [side.way for side in sides] == list(FUNCTIONS.values())
        for side in sides:
            side.run()
            rows = wanted if work.kind == 'batch' else wanted[0]
            assert largest_difference(side.result(), rows) < 10 * tolerances.DYNAMICS


@pytest.mark.long
@WITH_COMPILER
def test_a_rollout_has_rotors_limits_damping_and_a_ramp_of_friction() -> None:
    arm = pfd.load_robot('ur5')
    friction = [8.0, 8.0, 6.0, 2.0, 2.0, 2.0]
    damping = [6.0, 6.0, 4.0, 1.0, 1.0, 1.0]
    scene = pfd.Scene(damping=damping, armature='model', friction=friction, effort_limits='model')
    plant, width, h = resolve(arm, scene), 1e-2, 2.5e-4
    rng = np.random.default_rng(4)
    q, qd = rng.uniform(-1, 1, (2, 6)) * [[1.0], [0.02]]
    taus = rng.uniform(-200, 200, (20, 6))
    peer = Pinocchio(arm)
    aba = peer.answers(plant)['Pinocchio aba']

    def slope(q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        limited = np.clip(tau, -plant.effort_limits, plant.effort_limits)
        lost = np.array(damping) * qd + friction * np.clip(qd / width, -1, 1)
        return aba(q, qd, limited - lost).copy()

    x, v = q.copy(), qd.copy()
    for tau in np.repeat(taus, 4, axis=0):
        a1 = slope(x, v, tau)
        v2 = v + h / 2 * a1
        a2 = slope(x + h / 2 * v, v2, tau)
        v3 = v + h / 2 * a2
        a3 = slope(x + h / 2 * v2, v3, tau)
        v4 = v + h * a3
        a4 = slope(x + h * v3, v4, tau)
        x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    PinocchioCpp(plant, width).rollout(h, q, qd, taus, substeps=4)()
    np.testing.assert_allclose(q, x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(qd, v, rtol=0, atol=1e-12)


@pytest.mark.long
@WITH_COMPILER
def test_a_step_of_refinement_takes_digits_from_the_error_of_a_hard_case() -> None:
    (case,) = (case for case in CASES if case.name == 'payload_1e6')
    problem = case.make()
    known = reference(problem)
    peer = PinocchioCpp(problem.plant.robot)
    states = [np.ascontiguousarray(x) for x in problem.states.values()]
    found = {}
    for function in ('aba', 'aba_refined'):
        out = np.empty_like(states[0])
        peer.evaluate(function, states, out)()
        found[function] = errors(out, known).max()
    assert found['aba_refined'] < found['aba'] / 10


@pytest.mark.long
@WITH_COMPILER
def test_friction_needs_the_width_of_its_ramp() -> None:
    plant = resolve(pfd.load_robot('planar2'), pfd.Scene(friction=[1.0, 1.0]))
    with pytest.raises(ValueError, match='width must be positive'):
        PinocchioCpp(plant)
