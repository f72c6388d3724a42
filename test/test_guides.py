# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Code of guides and README runs, prints what they say, and is right by other measures."""

from __future__ import annotations

from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
import re
from typing import Any

from bridge import resolve_plant
import numpy as np
from oracle import Oracle, relative
import pinocchio as pin
import pytest
from tolerances import DYNAMICS

import pfd_core as pfd

FOLDER = Path(__file__).resolve().parent.parent / 'docs' / 'guides'
# A block of code, and the output printed below it, if there is one.
BLOCK = re.compile(r'^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?', re.MULTILINE | re.DOTALL)
# Guides of the node are run by test/ros.
GUIDES = sorted(
    path.stem for path in FOLDER.glob('*.md') if BLOCK.search(path.read_text(encoding='utf-8'))
)
# Relative difference of a start's cost from the linear model's, over the size of the start
# [rad, rad/s]: terms of third order relative to terms of second order; seen up to 0.1.
CUBIC = 0.3


def text(guide: str) -> str:
    return (FOLDER / f'{guide}.md').read_text(encoding='utf-8')


@cache
def ran(guide: str) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return the names that a guide defines, and each block's promised and true output."""
    names: dict[str, Any] = {}
    printed = []
    for code, promised in BLOCK.findall(text(guide)):
        with redirect_stdout(StringIO()) as output:
            exec(code, names)
        printed.append((promised, output.getvalue()))
    return names, printed


@pytest.mark.parametrize(
    'guide', [pytest.param(x, marks=[pytest.mark.slow] * (x == 'linear-feedback')) for x in GUIDES]
)
def test_the_code_of_a_guide_prints_the_output_shown(guide: str) -> None:
    _, printed = ran(guide)
    assert len(printed) > 3
    for promised, output in printed:
        assert output == promised


@pytest.mark.slow
def test_gains_of_the_guide_put_all_eigenvalues_inside_the_unit_circle() -> None:
    names, _ = ran('linear-feedback')
    A, B, K = names['A'], names['B'], names['K']
    assert np.abs(np.linalg.eigvals(A)).max() > 1
    moduli = np.abs(np.linalg.eigvals(A - B @ K))
    assert moduli.max() < 1
    # The slowest mode is that of the weights: 1 rad/s over 0.1 rad.
    assert -np.log(moduli.max()) / names['period'] == pytest.approx(10, rel=0.02)


@pytest.mark.parametrize('size', [1e-6, 1e-3])
@pytest.mark.slow
def test_the_cost_that_a_simulation_accumulates_is_that_of_the_linear_model(size: float) -> None:
    names, _ = ran('linear-feedback')
    x = np.random.default_rng(7).uniform(-size, size, (64, 12))
    measured, _ = names['cost'](x, names['steps'])
    np.testing.assert_allclose(measured, ((x @ names['P']) * x).sum(1), rtol=CUBIC * size)


def loaded(names: dict[str, Any]) -> tuple[Oracle, Oracle]:
    """Return Pinocchio's answers for the arm of a guide with its payload, and without."""
    plant = resolve_plant(names['robot'], names['scene'])
    return Oracle(plant.robot, plant.armature), Oracle(names['robot'], plant.armature)


def test_quantities_of_the_guide_are_pinocchios() -> None:
    names, _ = ran('model-quantities')
    oracle, _ = loaded(names)
    model, data, q, qd = oracle.model, oracle.data, names['q'], names['qd']
    assert relative(names['inertia'](q), oracle.H(q)) < DYNAMICS
    assert relative(names['bias'](q, qd), pin.nonLinearEffects(model, data, q, qd)) < DYNAMICS
    gravity = pin.computeGeneralizedGravity(model, data, q)
    assert relative(names['gravity'](q), gravity) < DYNAMICS
    tip = model.nframes - 1
    J = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)
    felt = np.linalg.inv(J @ np.linalg.inv(oracle.H(q)) @ J.T)
    # An inverse multiplies roundings by the condition.
    assert relative(names['felt'], felt) < DYNAMICS * np.linalg.cond(felt)


def test_the_readmes_quantities_are_those_of_one_equation_of_motion() -> None:
    blocks = BLOCK.findall((FOLDER.parent.parent / 'README.md').read_text(encoding='utf-8'))
    (code,) = (code for code, _ in blocks if 'linearize' in code)
    q, qd, tau = np.random.default_rng(0).uniform(-1, 1, (3, 6))
    names = {'pfd': pfd, 'q': q, 'qd': qd, 'tau': tau, 'taus': np.zeros((10, 6))}
    exec(code, names)
    robot, scene = names['robot'], names['sim'].scene
    qdd = pfd.forward_dynamics(robot, q, qd, tau, scene=scene)
    bias = pfd.compile_kernel(robot, scene=scene, quantity='bias_torques')(q, qd)
    np.testing.assert_allclose(names['H'] @ qdd + bias, tau, rtol=1e-10)
    assert (names['A'].shape, names['B'].shape) == ((12, 12), (12, 6))
