# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Strong damping: the step with implicit damping stays accurate where explicit steps blow up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from stiff_arms import START, scene_of
from zoo import joint, link, random_chain, to_pinocchio, urdf

import pfd_core as pfd
from pfd_core.kernels.passes.schedule import LONGEST
from pfd_core.simulation.integrators import TABLE, record_step

# Error of an angle at steps of 1 ms, from 2 rad/s on. Seen up to 7e-7.
STIFF = 2e-6
# The same of a rod from 1 rad/s on, at any damping. Seen up to 4e-5, at h d / I = 4.
COASTING = 6e-5
# Inertia over damping in seconds: the next term of the quasi-static velocity.
QUASI_STATIC = 1e-3


def puma(damping: float, rotors: bool, **settings: Any) -> pfd.Simulator:
    sim = pfd.Simulator(
        pfd.load_robot('puma560'), scene_of(damping, rotors), integrator='imex2', **settings
    )
    sim.reset(q=START, qd=np.full(6, 2.0))
    return sim


@pytest.mark.parametrize(
    ('damping', 'rotors', 'duration'),
    [
        (1e-2, True, 0.2),
        (1.0, True, 0.2),
        (1e2, True, 0.2),
        (1e4, True, 0.05),
        (1e-2, False, 0.2),
        (1.0, False, 0.05),
    ],
)
@pytest.mark.slow
def test_the_error_stays_small_and_falls_with_the_square_of_the_step(
    damping: float, rotors: bool, duration: float
) -> None:
    reference = pfd.integrate(
        pfd.load_robot('puma560'),
        np.zeros(6),
        duration,
        scene=scene_of(damping, rotors),
        q=START,
        qd=np.full(6, 2.0),
        rtol=1e-10,
        dense=False,
    )
    assert reference.status == 'ok'
    errors = []
    for substeps in (1, 4, 16):
        sim = puma(damping, rotors, step_size=1e-3, substeps=substeps)
        q = sim.rollout(np.zeros((round(duration / 1e-3), 6))).q[-1]
        errors.append(np.abs(q - reference.q[-1]).max())
    assert errors[0] < STIFF
    assert math.log2(errors[1] / errors[2]) / 2 == pytest.approx(2, abs=0.2)


def test_velocities_under_a_very_strong_damping_are_quasi_static() -> None:
    # Without rotors h lambda is 3e5 here: d qd = -gravity torques, by Pinocchio.
    damping = 1e4
    sim = puma(damping, False, step_size=1e-3, substeps=1)
    trajectory = sim.rollout(np.zeros((200, 6)))
    assert trajectory.status == 'ok'
    model = to_pinocchio(sim.robot)
    data = model.createData()
    for q, qd in zip(trajectory.q[20:], trajectory.qd[20:], strict=True):
        expected = -pin.computeGeneralizedGravity(model, data, q) / damping
        np.testing.assert_allclose(qd, expected, rtol=0, atol=QUASI_STATIC * abs(expected).max())


@pytest.mark.parametrize('integrator', ['imex2', 'auto'])
@pytest.mark.parametrize('damping', [1e-2, 1.0, 1e2, 3e3, 1e4, 1e6])
def test_a_damped_rod_coasts_as_its_closed_form_says(damping: float, integrator: str) -> None:
    # Two rods of 0.5 m and 1 kg, in line: I = 2/3, qd = w0 exp(-d t / I).
    scene = pfd.Scene(gravity=None, damping=np.full(2, damping), brakes=True)
    sim = pfd.Simulator(
        pfd.load_robot('planar2'), scene, step_size=1e-3, substeps=1, integrator=integrator
    )
    sim.reset(qd=[1.0, 0.0])
    trajectory = sim.rollout(np.zeros((1000, 2)), brakes=[False, True])
    rate = damping / (2 / 3)
    expected = -np.expm1(-rate * trajectory.time) / rate
    np.testing.assert_allclose(trajectory.q[:, 0], expected, rtol=0, atol=COASTING)
    np.testing.assert_array_equal(trajectory.q[:, 1], 0.0)
    # No ringing: a trapezoidal rule would keep the velocity and change its sign.
    assert abs(trajectory.qd[-1, 0]) <= math.exp(-rate) + COASTING


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_an_ensemble_moves_by_the_bits_of_a_simulator(dtype: str) -> None:
    sim = puma(1e3, False, dtype=dtype)
    many = pfd.Ensemble(sim.robot, 5, sim.scene, integrator='imex2', dtype=dtype)
    starts = START + 0.1 * np.arange(5)[:, np.newaxis]
    many.reset(q=starts)
    runs = many.rollout(np.ones((20, 6)))
    for k, q in enumerate(starts):
        sim.reset(q=q)
        alone = sim.rollout(np.ones((20, 6)))
        np.testing.assert_array_equal(runs.q[k], alone.q)
        np.testing.assert_array_equal(runs.qd[k], alone.qd)
        np.testing.assert_array_equal(runs.qdd[k], alone.qdd)


@pytest.mark.slow
def test_functions_of_a_long_chain_are_cut_into_parts_of_their_own() -> None:
    n = 18
    robot = random_chain(np.random.default_rng(1), n)
    scene = pfd.Scene(damping=np.full(n, 5.0), armature=np.full(n, 0.1))
    sim = pfd.Simulator(robot, scene, integrator='imex2')
    assert sum(pfd.compile_kernel(robot, scene=scene).operations['compiled'].values()) > LONGEST
    end = sim.rollout(np.zeros((20, n))).q[-1]
    reference = pfd.integrate(robot, np.zeros(n), 0.02, scene=scene).q[-1]
    np.testing.assert_allclose(end, reference, rtol=0, atol=STIFF)


@pytest.mark.parametrize('name', TABLE)
def test_a_step_makes_its_evaluations_and_solves_only_with_damping(name: str) -> None:
    integrator = TABLE[name]
    for damping, solutions in ((None, 0), (np.ones(2), integrator.solutions)):
        instructions = record_step(integrator, 2, 1e-3, damping).instructions
        calls = sum(instruction.op == 'call' for instruction in instructions)
        assert calls == integrator.evaluations + solutions


# Roundings of a few substeps, beside the terms of a stage that are h lambda times as large.
STEADY = 4.0


@pytest.mark.parametrize(('dtype', 'most'), [('float64', 9e13), ('float32', 1.6e6)])
@pytest.mark.parametrize('inertia', [1e-12, 0.5])
def test_damping_is_as_accurate_as_the_number_format_carries_and_refused_beyond(
    inertia: float, dtype: str, most: float
) -> None:
    # A rod about its axis: I qdd = tau - d qd, tau / d in steady state.
    J = f'{inertia} {inertia} {inertia} 0 0 0'
    text = urdf(
        'rod', link('base'), link('arm', 1.0, J=J), joint('axis', 'continuous', 'base', 'arm')
    )
    robot, h = pfd.load_robot(text), 1e-3

    def sim(stiffness: float) -> pfd.Simulator:
        scene = pfd.Scene(gravity=None, damping=[stiffness * inertia / h])
        return pfd.Simulator(
            robot, scene, step_size=h, substeps=1, integrator='imex2', dtype=dtype
        )

    for stiffness in (1e5, most / 10, most):
        arm = sim(stiffness)
        bound = STEADY * float(np.finfo(dtype).eps) / 2 * stiffness
        for tau in np.linspace(0.3, 3.0, 20).astype(dtype):
            arm.reset()
            arm.rollout(np.full((4, 1), tau))
            steady = float(tau) / (stiffness * inertia / h)
            assert abs(float(arm.qd[0]) - steady) <= bound * steady
    for stiffness in (1.2 * most, 1e24):
        with pytest.raises(ValueError, match=r'damping of the scene decays .* keep the digits'):
            sim(stiffness)


@pytest.mark.parametrize('integrator', ['auto', 'imex2'])
@pytest.mark.parametrize('first', [1e-18, 1e-20])
def test_damping_is_refused_where_the_inertia_matrix_has_no_factors(
    first: float, integrator: str
) -> None:
    # H = [[m1 + m2, m2], [m2, m2]] of two slides on one axis: m1 + m2 = m2 in float64.
    J = '1 1 1 0 0 0'
    robot = pfd.load_robot(
        urdf(
            'slides',
            *(link('base'), link('a', first, J=J), link('b', 1.0, J=J)),
            joint('first', 'prismatic', 'base', 'a'),
            joint('second', 'prismatic', 'a', 'b'),
        )
    )
    scene = pfd.Scene(damping=[1.0, 1.0])
    with pytest.raises(ValueError, match=r'inertia matrix .* positive definite .* rotors'):
        pfd.Simulator(robot, scene, integrator=integrator)
    assert pfd.Simulator(robot, scene, integrator='rk4').integrator == 'rk4'
    with_rotors = pfd.Scene(damping=[1.0, 1.0], armature=[0.1, 0.1])
    assert pfd.Simulator(robot, with_rotors, integrator=integrator).step([0.0, 0.0]) is None
