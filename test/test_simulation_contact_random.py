# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random arms with stops and friction: an event-driven integration by another method, energy."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from contact_oracle import LONGEST, Case, Motion, TooManyEventsError
import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from zoo import Array, random_chain, slider

import pfd_core as pfd

STEP = 1e-4
DURATION = 0.05
# Errors of velocities after DURATION, of motions that are not chaotic [rad/s or m/s].
VELOCITY = 1e-6
# A motion is chaotic, for this, if an error in the initial state grows by more than this factor.
CHAOTIC = 300.0
NUDGE = 1e-8
# Truncation of RK4 in a step, over the energy of the arm.
GAIN = 1e-9
# Roundings of both methods in a motion under a constant force.
CLOSED_FORM = 1e-12
# A joint is found at its stop to the error of the cubic in a step [rad or m].
BEYOND = 1e-9

# Scenes of the measured orders: two to four joints, four to eight impacts and reversals, no joint
# that breaks away within a step.
ORDER_SEEDS = (1, 9, 14)
# Errors from 4 ms to 1 ms; the last events before an end are at other places of the steps, which
# moves the order of a single scene by half.
ORDER_STEPS = (4e-3, 2e-3, 1e-3)
ORDER_DURATION = 0.048
ORDER_SCATTER = 0.5


@dataclass
class Tally:
    """What some scenes have shown."""

    motions: int = 0
    chaotic: int = 0
    ambiguous: int = 0
    events: int = 0
    several: int = 0  # steps with more than one event, at least
    errors: list[float] = field(default_factory=list)


def random_case(rng: np.random.Generator) -> tuple[Case, pfd.Scene]:
    """Return an arm of two to six joints; tau is that of gravity at zero, and more."""
    n = int(rng.integers(2, 7))
    robot = random_chain(rng, n, 0.2)
    armature = rng.uniform(0.1, 1.0, n)
    friction = rng.uniform(0, 3, n) * (rng.random(n) < 0.6)
    gap = 10 ** rng.uniform(-2, 0, n)
    limits = rng.uniform(-0.5, 0.5, n)[:, np.newaxis] + gap[:, np.newaxis] * [-0.5, 0.5]
    restitution = np.where(rng.random(n) < 0.3, rng.integers(0, 2, n), rng.uniform(0, 1, n))
    case = Case(robot, armature, friction, limits, restitution, rng.normal(0, 10, n))
    scene = pfd.Scene(
        armature=armature, friction=friction, joint_limits=limits, restitution=restitution
    )
    return case, scene


def random_start(rng: np.random.Generator, case: Case) -> tuple[Array, Array]:
    """Return positions between the stops, some at them, and velocities, some zero."""
    lower, upper = case.limits.T
    where, n = rng.random(len(lower)), len(lower)
    q = rng.uniform(lower, upper)
    q = np.where(where < 0.1, lower, np.where(where > 0.9, upper, q))
    return q, rng.normal(0, 3, n) * (rng.random(n) < 0.7)


def energies(case: Case, run: pfd.Trajectory, q: Array, v: Array) -> Array:
    """Return kinetic and potential energy, less the work of the torques, at all steps."""
    oracle = Oracle(case.robot, case.armature)
    found = []
    for x, w in zip([q, *run.q], [v, *run.qd], strict=True):
        potential = pin.computePotentialEnergy(oracle.model, oracle.data, x)
        found.append(w @ oracle.H(x) @ w / 2 + potential - case.tau @ x)
    return np.array(found)


def compare(rng: np.random.Generator, starts: int, tally: Tally) -> None:
    """Compare the motions of one scene from some states."""
    case, scene = random_case(rng)
    lower, upper = case.limits.T
    sim = pfd.Simulator(case.robot, scene, step_size=STEP, substeps=1)
    steps = round(DURATION / STEP)
    for _ in range(starts):
        q, v = random_start(rng, case)
        sim.reset(q, v)
        run = sim.rollout(np.tile(case.tau, (steps, 1)))
        assert run.status == 'ok'
        assert (run.q >= lower - BEYOND).all()
        assert (run.q <= upper + BEYOND).all()
        energy = energies(case, run, q, v)
        assert np.diff(energy).max() <= GAIN * np.abs(energy).max()
        tally.motions += 1
        nudge = NUDGE * rng.uniform(-1, 1, (2, len(q)))
        try:
            ends, ambiguous = [], False
            for first, speed in ((q, v), (np.clip(q + nudge[0], lower, upper), v + nudge[1])):
                motion = Motion(case, first, speed)
                motion.advance(DURATION)
                ends.append(np.concatenate([motion.q, motion.v]))
                ambiguous |= motion.ambiguous
        except TooManyEventsError:
            tally.chaotic += 1
            continue
        if np.abs(ends[1] - ends[0]).max() > CHAOTIC * NUDGE:
            tally.chaotic += 1
            continue
        if ambiguous:
            tally.ambiguous += 1
            continue
        tally.events += len(motion.events)
        _, counts = np.unique(np.floor_divide(motion.events, STEP), return_counts=True)
        tally.several += int((counts > 1).sum())
        tally.errors.append(float(np.abs(run.qd[-1] - ends[0][len(q) :]).max()))


def test_both_methods_find_a_hit_in_a_hundredth_of_a_step() -> None:
    """Without its stop, a mass under 200 N would be 10 nm beyond it, for 20 us around 2.5 ms."""
    force, way, speed, duration = 200.0, 6.25e-4 - 1e-8, 0.5, 4e-3
    hit = np.sqrt(speed**2 - 2 * force * way)
    left = duration - (speed - hit) / force
    wanted = [hit * left + force * left**2 / 2, hit + force * left]
    one, stops = np.ones(1), np.array([[0.0, 1.0]])
    case = Case(slider(1, 0), 0 * one, 0 * one, stops, one, force * one)
    motion = Motion(case, way * one, -speed * one)
    motion.advance(duration)
    assert len(motion.events) == 1
    scene = pfd.Scene(gravity=None, joint_limits=stops, restitution=[1.0])
    sim = pfd.Simulator(case.robot, scene, step_size=LONGEST, substeps=1)
    sim.reset([way], [-speed])
    run = sim.rollout([[force]] * round(duration / LONGEST))
    for end in ([motion.q[0], motion.v[0]], [run.q[-1, 0], run.qd[-1, 0]]):
        assert np.abs(np.subtract(end, wanted)).max() < CLOSED_FORM


@pytest.mark.long
@pytest.mark.parametrize('seed', ORDER_SEEDS)
def test_integrators_keep_their_order_through_the_events_of_random_scenes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    case, scene = random_case(rng)
    q, v = random_start(rng, case)
    damping = rng.uniform(0.5, 3.0, case.robot.n)
    case, scene = replace(case, damping=damping), replace(scene, damping=damping)
    motion = Motion(case, q, v)
    motion.advance(ORDER_DURATION)
    assert len(motion.events) > 3
    wanted = np.concatenate([motion.q, motion.v])
    for integrator, order in (('rk4', 4), ('velocity_verlet', 2), ('imex2', 2)):
        errors = []
        for step in ORDER_STEPS:
            sim = pfd.Simulator(
                case.robot, scene, step_size=step, substeps=1, integrator=integrator
            )
            sim.reset(q, v)
            run = sim.rollout(np.tile(case.tau, (round(ORDER_DURATION / step), 1)))
            errors.append(np.abs(np.concatenate([run.q[-1], run.qd[-1]]) - wanted).max())
        found = np.log(errors[0] / errors[-1]) / np.log(ORDER_STEPS[0] / ORDER_STEPS[-1])
        assert found > order - ORDER_SCATTER


@pytest.mark.slow
def test_random_scenes_move_as_an_event_driven_integration() -> None:
    tally = Tally()
    for seed in range(2):
        compare(np.random.default_rng(seed), 3, tally)
    assert len(tally.errors) > tally.motions / 2
    assert max(tally.errors) < VELOCITY


@pytest.mark.parametrize('seed', range(50))
@pytest.mark.long
def test_a_thousand_random_scenes_move_as_an_event_driven_integration(seed: int) -> None:
    tally = Tally()
    compare(np.random.default_rng(100 + seed), 20, tally)
    assert tally.ambiguous < tally.motions / 2
    assert max(tally.errors, default=0.0) < VELOCITY


# ---- energy and range ------------------------------------------------------------------------


ENERGY_STEPS = 400
# All gains of kinetic energy in these steps of 1 ms, over the energy at the beginning: truncation
# of RK4 while friction is small, and rounding. An impact alone would add a thousandth of it.
GAINS = 1e-10
# A joint is found at its stop to the cubic's error of fourth order in the step [rad or m].
CROSSED = 1e-7


def moving_scene(rng: np.random.Generator, n: int) -> tuple[pfd.Scene, Array]:
    """Return a scene of rotors, friction and stops, some of each absent, and the stops."""
    limits = np.sort(rng.uniform(-1.5, 1.5, (n, 2)), axis=1) + np.array([0.0, 0.1])
    limits[rng.random(n) < 0.2] = [-np.inf, np.inf]
    friction = rng.uniform(0, 2, n) * (rng.random(n) < 0.7)
    scene = pfd.Scene(
        gravity=None,
        armature=rng.uniform(0.5, 2, n),
        friction=friction,
        static_friction=friction * rng.uniform(1, 2, n),
        stribeck_velocity=rng.uniform(0.1, 1, n),
        joint_limits=limits,
        restitution=rng.uniform(0, 1, n),
    )
    return scene, limits


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.slow
def test_an_arm_left_to_itself_gains_no_energy_and_passes_no_stop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, count = int(rng.integers(2, 8)), 16
    robot = random_chain(rng, n, 0.2)
    scene, limits = moving_scene(rng, n)
    lower, upper = np.where(np.isfinite(limits), limits, [-1.0, 1.0]).T
    where = rng.random((count, n))
    q = rng.uniform(lower, upper, (count, n))
    q = np.where(where < 0.1, lower, np.where(where > 0.9, upper, q))
    qd = rng.normal(0, 3, (count, n)) * (rng.random((count, n)) < 0.8)
    arms = pfd.Ensemble(robot, count, scene, step_size=1e-3, substeps=1)
    arms.reset(q, qd)
    runs = arms.rollout(steps=ENERGY_STEPS)
    assert runs.status == 'ok'
    assert (runs.q >= limits[:, 0] - CROSSED).all()
    assert (runs.q <= limits[:, 1] + CROSSED).all()
    oracle = Oracle(robot, np.asarray(scene.armature))
    for k in range(count):
        states = zip([q[k], *runs.q[k]], [qd[k], *runs.qd[k]], strict=True)
        energy = np.array([v @ oracle.H(x) @ v for x, v in states])
        assert np.maximum(np.diff(energy), 0).sum() <= GAINS * energy[0]
