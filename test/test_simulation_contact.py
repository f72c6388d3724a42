# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dry friction and joint stops against closed forms and located events of small arms."""

from __future__ import annotations

from functools import partial
from math import log, sqrt

from contact_arms import STEP, simulated, two_links
import numpy as np
import pytest
from zoo import joint, link, slider, urdf

import pfd_core as pfd

# Errors of RK4 at 1 ms with events located on its cubic output.
SLIDING = 1e-14  # constant deceleration, of which the output is exact
DAMPED = 2e-12
IMPLICIT = 4e-7  # imex2, of second order
REVERSING = 1e-10
BREAKING_AWAY = 1e-6  # caused by the motion of another joint, it waits for the end of a step
RESTING = 3e-9
STRIBECK = 1e-8  # the bend at 0.1 rad/s is passed in 25 steps
ROUNDING_OF_1500_STEPS = 2e-13


def rotor(inertia: float) -> pfd.Robot:
    """Return a single joint with a vertical axis."""
    J = f'{inertia} {inertia} {inertia} 0 0 0'
    return pfd.load_robot(
        urdf(
            'rotor',
            link('base'),
            link('wheel', 1.0, J=J),
            joint('j', 'continuous', 'base', 'wheel'),
        )
    )


def test_a_sliding_rotor_stops_where_coulomb_friction_stops_it() -> None:
    run = simulated(rotor(0.5), pfd.Scene(friction=[2.0]), [0.0], [1.0], np.zeros((400, 1)))
    assert abs(run.q[-1, 0] - 0.125) < SLIDING
    stopped = run.time > 0.25
    assert (run.qd[stopped] == 0.0).all()
    assert (run.q[stopped] == run.q[-1]).all()


def test_a_rotor_with_damping_and_friction_stops_at_the_closed_form() -> None:
    inertia, d, friction, v = 0.5, 3.0, 2.0, 5.0
    scene = pfd.Scene(friction=[friction], damping=[d])
    run = simulated(rotor(inertia), scene, [0.0], [v], np.zeros((400, 1)))
    time = inertia / d * log(1 + d * v / friction)
    angle = inertia / d * (v - friction / d * log(1 + d * v / friction))
    assert abs(run.q[-1, 0] - angle) < DAMPED
    assert run.time[np.flatnonzero(run.qd == 0.0)[0]] - time < STEP


def test_the_implicit_damping_stops_a_rotor_with_friction_at_the_closed_form() -> None:
    inertia, d, friction, v = 0.5, 3.0, 2.0, 5.0
    scene = pfd.Scene(friction=[friction], damping=[d])
    angle = inertia / d * (v - friction / d * log(1 + d * v / friction))
    errors = []
    for substeps in (1, 4):
        settings = {'integrator': 'imex2', 'substeps': substeps}
        run = simulated(rotor(inertia), scene, [0.0], [v], np.zeros((400, 1)), **settings)
        assert run.qd[-1, 0] == 0.0
        errors.append(abs(run.q[-1, 0] - angle))
    assert errors[0] < IMPLICIT
    assert errors[1] < errors[0] / 4**1.8


@pytest.mark.parametrize(('mu', 'steps'), [(0.7, 1000), (0.4, 2000)])
def test_a_mass_on_an_incline_stays_or_slides_back(mu: float, steps: int) -> None:
    g, slope = 9.81, np.pi / 6
    press, pull = g * np.cos(slope), g * np.sin(slope)
    scene = pfd.Scene(friction=[mu * press])
    rail = slider(float(np.cos(slope)), float(np.sin(slope)))
    run = simulated(rail, scene, [0.0], [1.0], np.zeros((steps, 1)))
    up = pull + mu * press
    top, turn = 1 / (2 * up), 1 / up
    down = max(pull - mu * press, 0.0)
    after = run.time - turn
    wanted = np.where(after < 0, run.time - up * run.time**2 / 2, top - down * after**2 / 2)
    assert np.abs(run.q[:, 0] - wanted).max() < ROUNDING_OF_1500_STEPS
    if down == 0.0:
        assert (run.qd[after > 0] == 0.0).all()


def test_a_dropped_mass_comes_to_rest_within_one_step_of_the_last_bounce() -> None:
    e = 0.5
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[e])
    run = simulated(slider(0, 1), scene, [1.0], [0.0], np.zeros((1500, 1)))
    rest = sqrt(2 / 9.81) * (1 + e) / (1 - e)
    first = np.flatnonzero(run.qd[:, 0] == 0.0)[0]
    assert 0 <= run.time[first] - rest < STEP
    assert abs(run.q[-1, 0]) < RESTING
    assert (run.q >= 0.0).all()
    assert (run.qd[first:] == 0.0).all()


def test_a_mass_that_bounces_without_loss_keeps_its_energy() -> None:
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[1.0])
    run = simulated(slider(0, 1), scene, [1.0], [0.0], np.zeros((1500, 1)))
    energy = run.qd**2 / 2 + 9.81 * run.q
    assert np.abs(energy / 9.81 - 1).max() < ROUNDING_OF_1500_STEPS
    assert (run.q >= 0.0).all()


# Motions of the two-link arm with all events located, extrapolated in 80-bit arithmetic.
def test_two_links_under_friction_reverse_as_the_reference() -> None:
    scene = pfd.Scene(gravity=None, friction=[1.0, 0.3])
    run = simulated(two_links(), scene, [0.0, 0.5], [0.0, 4.0], np.zeros((2000, 2)))
    assert np.abs(run.q[-1] - [3.5322760195, -0.5835954232]).max() < REVERSING
    assert np.abs(run.qd[-1] - [0.6570523694, 1.3314731382]).max() < REVERSING


def test_two_links_break_away_and_stick_as_the_reference() -> None:
    scene = pfd.Scene(gravity=None, friction=[0.5, 2.0])
    taus = np.zeros((2500, 2))
    taus[:1600, 0] = 4.0
    run = simulated(two_links(), scene, [0.0, 0.8], [0.0, 0.0], taus)
    assert np.abs(run.q[-1] - [2.1214967672, 0.7507616090]).max() < BREAKING_AWAY
    assert abs(run.qd[-1, 0] - 1.1541032554) < BREAKING_AWAY
    assert run.qd[-1, 1] == 0.0
    slips = run.time[np.flatnonzero(run.qd[:, 1])[0]]
    assert 0 <= slips - 1.1933354141 < 2 * STEP


def test_two_links_hit_their_stops_as_the_reference() -> None:
    scene = pfd.Scene(
        gravity=(0, -9.81, 0),
        friction=[0.5, 0.2],
        joint_limits=[[-1.2, 1.2], [-0.8, 0.8]],
        restitution=[0.5, 0.5],
    )
    run = simulated(two_links(), scene, [0.0, 0.5], [1.0, 0.0], np.zeros((1000, 2)))
    assert np.abs(run.q[-1] - [-1.1969429056, -0.7909938927]).max() < REVERSING
    assert np.abs(run.qd[-1] - [2.2212637060, -7.8403890917]).max() < REVERSING


def test_friction_that_falls_with_the_speed_stops_a_rotor_at_the_closed_form() -> None:
    """I v' = -Fc - (Fs - Fc)/(1 + (v/vs)^2): time to rest by partial fractions."""
    inertia, sliding, static, vs, v = 0.5, 2.0, 3.0, 0.1, 1.0
    scene = pfd.Scene(friction=[sliding], static_friction=[static], stribeck_velocity=[vs])
    run = simulated(rotor(inertia), scene, [0.0], [v], np.zeros((400, 1)))
    c = sqrt(static / sliding)
    # dt = -I (1 + u^2) / (Fc (u^2 + c^2)) vs du, u = v / vs.
    time = inertia * vs / sliding * (v / vs + (1 - c**2) / c * np.arctan(v / vs / c))
    first = np.flatnonzero(run.qd[:, 0] == 0.0)[0]
    assert 0 <= run.time[first] - time < STEP
    way = (
        inertia
        * vs**2
        / sliding
        * ((v / vs) ** 2 / 2 + (1 - c**2) / 2 * log(1 + (v / vs / c) ** 2))
    )
    assert abs(run.q[-1, 0] - way) < STRIBECK


def test_a_damped_bounce_falls_by_the_square_of_the_restitution() -> None:
    e, height = 0.8, 1.0
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[e])
    run = simulated(slider(0, 1), scene, [height], [0.0], np.zeros((1200, 1)))
    fall = sqrt(2 * height / 9.81)
    at_top = np.searchsorted(run.time, fall + e * fall)
    assert abs(run.q[at_top, 0] - height * e**2) < 9.81 * STEP**2


def test_kept_code_of_one_scene_with_friction_is_not_taken_for_that_of_another() -> None:
    # All have the same dynamics of held joints, from which their code takes its name.
    robot, ends = rotor(1.0), []
    for effects in ({}, {'effort_limits': [2.0]}, {'effort_limits': [4.0]}):
        for kind in (pfd.Simulator, partial(pfd.Ensemble, size=1)):
            sim = kind(robot, scene=pfd.Scene(gravity=None, friction=[1.0], **effects))
            sim.rollout(np.full((1000, 1), 11.0))
            ends.append(sim.qd.item())
    # The wheel turns by the motor's torque less its friction for a second.
    wanted = [10.0, 10.0, 1.0, 1.0, 3.0, 3.0]
    np.testing.assert_allclose(ends, wanted, rtol=0, atol=ROUNDING_OF_1500_STEPS)
