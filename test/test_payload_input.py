# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A payload as an input of compiled code: the same physics as a constant, and nothing compiled."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest
from zoo import ODD_ARM, without_mass

import pfd_core as pfd

BODY = pfd.Payload(
    2.5, (0.1, -0.02, 0.05), ((0.02, 0.001, -0.002), (0.001, 0.03, 0.003), (-0.002, 0.003, 0.025))
)
INPUT = pfd.Scene(payload='input')
# Some hundred operations in another order, over pivots a hundred times smaller than H.
ROUNDING = 1e-12
WITH_BODIES = [name for name, row in pfd.QUANTITIES.items() if 'payload' in row.effects]
STEPS = 100


HEAVY = pytest.param(ODD_ARM, 'derivatives', marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ('robot', 'quantity'),
    [
        *((ODD_ARM, quantity) for quantity in WITH_BODIES if quantity != 'derivatives'),
        HEAVY,
        ('planar2', 'derivatives'),
        ('ur5', 'forward_dynamics'),
    ],
    ids=lambda text: text if len(text) < 20 else 'odd_arm',
)
@pytest.mark.slow
def test_every_quantity_has_the_payload_of_the_call(robot: str, quantity: str) -> None:
    arm = pfd.load_robot(robot)
    state = np.random.default_rng(3).normal(size=(3, arm.n))
    state = state[: len(pfd.QUANTITIES[quantity].arguments)]
    kernel = pfd.compile_kernel(arm, scene=INPUT, quantity=quantity)
    for body in (None, BODY):
        constant = pfd.compile_kernel(arm, scene=pfd.Scene(payload=body), quantity=quantity)
        wanted = constant(*state)
        found = kernel(*state, payload=body)
        atol = ROUNDING * np.abs(wanted).max()
        np.testing.assert_allclose(found, wanted, rtol=0, atol=atol)
        bound = kernel.bind(*state, out=np.zeros(kernel.shape), payload=body)
        assert bound().tobytes() == found.tobytes()


def test_a_batch_has_the_payload_of_the_call() -> None:
    arm = pfd.load_robot('planar2')
    state = np.random.default_rng(3).normal(size=(3, 9, arm.n))
    kernel = pfd.compile_kernel(arm, scene=INPUT)
    whole = kernel(*state, payload=BODY)
    for k, row in enumerate(whole):
        assert row.tobytes() == kernel(*state[:, k], payload=BODY).tobytes()


@pytest.mark.parametrize('effects', [{}, {'contact': True}], ids=['smooth', 'contact'])
def test_a_simulation_moves_as_with_the_payload_as_a_constant(effects: dict) -> None:
    arm = pfd.load_robot('planar2')
    if effects:
        effects = {
            'joint_limits': [[-1.0, 1.0]] * arm.n,
            'restitution': 0.3,
            'friction': [0.1] * arm.n,
            'brakes': True,
            'external_wrench': True,
            'motor_lag': [0.01] * arm.n,
            'gravity_compensation': True,
        }
    q, qd, tau = np.random.default_rng(1).uniform(-0.9, 0.9, size=(3, arm.n))
    wrench = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3] if effects else None
    one, other = (
        pfd.Simulator(arm, pfd.Scene(payload=body, **effects), integrator='rk4')
        for body in ('input', BODY)
    )
    for simulator in (one, other):
        simulator.reset(q, qd)
    for _ in range(STEPS):
        one.step(tau, wrench, payload=BODY)
        other.step(tau, wrench)
    np.testing.assert_allclose(one.q, other.q, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(one.qdd, other.qdd, rtol=1e-9)
    one.reset(q, qd)
    trajectory = one.rollout(np.tile(tau, (STEPS, 1)), wrench, payload=BODY)
    np.testing.assert_allclose(trajectory.q[-1], other.q, rtol=0, atol=ROUNDING)


def test_another_payload_compiles_nothing(emitted: list[str]) -> None:
    simulator = pfd.Simulator(pfd.load_robot('planar2'), INPUT)
    kernel = pfd.compile_kernel(simulator.robot, scene=INPUT, quantity='inertia_matrix')
    simulator.step([0.0, 0.0])
    before = len(emitted)
    for k in range(50):
        body = pfd.Payload(0.1 * k, (0.0, 0.01 * k, 0.0))
        simulator.step([0.0, 0.0], payload=body)
        kernel(np.ones(2), payload=body)
    assert len(emitted) == before


def test_the_error_estimate_of_refinement_sees_the_payload() -> None:
    arm = pfd.load_robot('planar2')
    state = np.random.default_rng(4).normal(size=(3, arm.n))
    kernel = pfd.compile_kernel(arm, scene=INPUT, refine=1)
    exact = pfd.compile_kernel(arm, scene=pfd.Scene(payload=BODY), refine=1)
    qdd, error = kernel.error_estimate(*state, payload=BODY)
    np.testing.assert_allclose(qdd, exact(*state), rtol=ROUNDING)
    assert 0 <= error < ROUNDING


def test_an_arm_that_only_a_payload_gives_inertia_is_refused_without() -> None:
    arm = pfd.load_robot('planar2')
    light = without_mass(arm, [1])
    simulator = pfd.Simulator(light, INPUT)
    with pytest.raises(ValueError, match='give one of them, a payload with inertia'):
        simulator.step([0.0, 0.0])
    simulator.step([0.0, 0.0], payload=pfd.Payload(1.0, (0.1, 0.0, 0.0)))
    assert simulator.status == 'ok'


def test_functions_without_a_payload_as_an_input_refuse_it() -> None:
    arm = pfd.load_robot('planar2')
    zero = np.zeros(2)
    for call, text in (
        (lambda: pfd.compile_kernel(arm, scene=INPUT, method='pcrbm'), 'needs one of the methods'),
        (lambda: pfd.emulate(arm, zero, zero, zero, scene=INPUT), 'emulate takes a scene with'),
        (lambda: pfd.Ensemble(arm, 2, INPUT), 'an Ensemble takes a scene with'),
        (lambda: pfd.Simulator(arm, INPUT).linearize(zero, zero, zero), 'linearize takes'),
        (lambda: pfd.Simulator(arm).step(zero, payload=BODY), r"use Scene\(payload='input'\)"),
        (lambda: pfd.compile_kernel(arm)(zero, zero, zero, payload=BODY), 'takes none as an'),
        (lambda: pfd.Simulator(arm, INPUT).step(zero, payload=2.0), 'must be a Payload or None'),
        (lambda: pfd.Scene(gravity_compensation=INPUT), 'must have a Payload or None as payload'),
    ):
        with pytest.raises(ValueError, match=text):
            call()


def test_a_scene_with_a_payload_as_an_input_is_saved_and_loaded(tmp_path: Path) -> None:
    INPUT.save(tmp_path / 'scene.yaml')
    assert pfd.load_scene(tmp_path / 'scene.yaml') == INPUT


FLAT = """
import resource
import numpy as np
import pfd_core as pfd
arm = pfd.load_robot('ur5')
simulator = pfd.Simulator(arm, pfd.Scene(payload='input'))
def change(count):
    for k in range(count):
        simulator.reset()
        simulator.step(np.zeros(arm.n), payload=pfd.Payload(1e-3 * k, (1e-5 * k, 0.0, 0.1)))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(change(1000), change(9000))
"""
# kB for 9000 payloads; one compiled for each would take 108 000.
GROWTH = 2000


@pytest.mark.slow
def test_memory_stays_flat_over_ten_thousand_payloads() -> None:
    done = subprocess.run([sys.executable, '-c', FLAT], check=True, capture_output=True, text=True)
    before, after = map(int, done.stdout.split())
    assert after - before < GROWTH
