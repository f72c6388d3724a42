# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Linearised steps: against differences of the simulation, also through events."""

from __future__ import annotations

from collections import Counter
from functools import cache
import pickle
from typing import Any

import mpmath
import numpy as np
import pytest
from zoo import random_chain, scene_with, slider

import pfd_core as pfd
from pfd_core.model.effects import STEP as STEP_VALUES

# Central differences of a step in float64: u^(2/3) and its scale; of one with an event, whose
# time is rounded.
DIFFERENCES, EVENT = 1e-6, 1e-4
# Of two central differences of a smooth step, extrapolated: rounding over a change of 1e-3.
SMOOTH_STEP = 1e-9
H = 2e-3


def state(n: int, seed: int = 0, count: int | None = None) -> list[np.ndarray]:
    """Return random q, qd and tau."""
    rng = np.random.default_rng(seed)
    shape = (3, n) if count is None else (3, count, n)
    return [*rng.uniform(-1, 1, shape)]


# Turns of the joints of planar2, also beyond the range of the sine.
TURNED = np.array([1e6, -41.5])


def test_whole_turns_of_a_joint_change_no_bit_of_a_and_b() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=H, substeps=2)
    _, qd, tau = state(2, 4)
    with mpmath.workdps(40):
        turn = 2 * mpmath.pi
        rest = [float(mpmath.mpf(x) - turn * mpmath.nint(mpmath.mpf(x) / turn)) for x in TURNED]
    for found, wanted in zip(
        sim.linearize(TURNED, qd, tau), sim.linearize(rest, qd, tau), strict=True
    ):
        np.testing.assert_array_equal(found, wanted)


def differences(
    sim: pfd.Simulator, at: list[np.ndarray], step: float = 1e-6, **inputs: Any
) -> np.ndarray:
    """Return A and B, side by side, by central differences of the simulation itself."""
    n = sim.robot.n
    lags = sim.scene.motor_lag is not None
    x = np.concatenate([at[0], at[1], *([at[2]] * lags), at[2]])

    def end(x: np.ndarray) -> np.ndarray:
        motor = {'tau_motor': x[2 * n : 3 * n]} if lags else {}
        sim.reset(x[:n], x[n : 2 * n], **motor)
        sim.step(x[-n:], **inputs)
        rows = [sim.q, sim.qd]
        if lags:
            rows.append(sim.tau_motor)
        return np.concatenate(rows)

    columns = [(end(x + e) - end(x - e)) / (2 * step) for e in step * np.eye(len(x))]
    return np.array(columns).T


# A brake on a moving joint is an impact: it has a test of its own.
EFFECTS = {
    effect.name: effect.fields
    for effect in pfd.EFFECTS
    if effect.acts != STEP_VALUES and effect.name != 'brakes' and not effect.needs
}


@pytest.mark.parametrize(
    ('name', 'integrator'),
    [
        *(('damping', integrator) for integrator in ('rk4', 'velocity_verlet', 'imex2')),
        *(pytest.param(name, 'rk4', marks=pytest.mark.slow) for name in EFFECTS),
    ],
)
def test_a_and_b_are_the_derivatives_of_a_smooth_step_with_any_effect(
    name: str, integrator: str
) -> None:
    kinds = ('revolute', 'prismatic', 'revolute')
    robot = random_chain(np.random.default_rng(5), 3, joint_types=kinds)
    scene = scene_with(*EFFECTS[name], n=3, gravity=(0.3, -0.2, -9.6))
    inputs = {'wrench': np.arange(1.0, 7.0)} if scene.external_wrench else {}
    sim = pfd.Simulator(robot, scene, step_size=H, substeps=2, integrator=integrator)
    at = state(3, 3)
    at[0][1] = 20.0  # a distance, which is not wrapped
    wide, narrow = (differences(sim, at, step, **inputs) for step in (2e-3, 1e-3))
    wanted = (4 * narrow - wide) / 3
    found = np.hstack(sim.linearize(*at, **inputs))
    assert found.shape == (6, 9)
    assert np.abs(found - wanted).max() <= SMOOTH_STEP * np.abs(wanted).max()


ROUGHLY = pfd.Scene(
    damping=[0.5, 0.4],
    friction=[0.5, 0.3],
    static_friction=[2.0, 50.0],
    joint_limits=[[-1.0, 1.0], [-2.0, 2.0]],
)


def test_the_state_of_a_simulation_plays_no_part_and_stays() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), ROUGHLY)
    at = state(2, 1)
    before = sim.linearize(*at)
    sim.reset(at[1])
    sim.step(at[2])
    q, time = sim.q, sim.time
    for one in (sim, pickle.loads(pickle.dumps(sim))):
        for wanted, found in zip(before, one.linearize(*at), strict=True):
            np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(sim.q, q)
    assert sim.time == time


def test_a_and_b_of_a_step_with_too_many_events_are_nan() -> None:
    scene = pfd.Scene(joint_limits=[[0.0, 10.0]], restitution=1.0)
    sim = pfd.Simulator(slider(0.0, 1.0), scene, step_size=1.0, substeps=1, integrator='rk4')
    # A ball that bounces for ever, to this height.
    assert np.isnan(np.hstack(sim.linearize([1e-10], [0.0], [0.0]))).all()


@pytest.mark.parametrize(
    ('friction', 'at', 'status', 'most'),
    [
        # Friction holds the joint that takes the momentum.
        ([20.0, 5.0], [[0.3, 0.4], [0.0, 0.0], [0.0, 0.0]], ['held', 'held'], DIFFERENCES),
        # A brake that closes on a moving joint.
        (None, [[0.1, 0.4], [0.3, 1.0], [0.5, 0.2]], ['moving', 'event'], 1e-8),
    ],
)
def test_a_step_with_a_brake_has_the_derivative_of_the_brakes_impulse(
    friction: list[float] | None, at: list[list[float]], status: list[str], most: float
) -> None:
    scene, brakes = pfd.Scene(brakes=True, friction=friction), [False, True]
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, integrator='rk4')
    found = sim.linearize(*at, brakes=brakes)
    assert found.status.tolist() == status
    wanted = differences(sim, [np.array(x) for x in at], brakes=brakes)
    np.testing.assert_allclose(np.hstack(found), wanted, rtol=0, atol=most)


# A state without events.
SLIDING = (0.2, 0.7), (0.5, 0.5), (1.0, 0.1)
EVENTS = {
    'comes to rest': ((0.2, 0.7), (1e-3, 0.5), (-30.0, 0.1), 'event'),
    'breaks loose at the beginning': ((0.2, 0.7), (0.0, 0.5), (-90.0, 0.1), 'one_sided'),
    'reaches its stop': ((0.9999, 0.7), (3.0, 0.5), (0.0, 0.1), 'event'),
    'hits its stop at the beginning': ((1.0, 0.7), (3.0, 0.5), (0.0, 0.1), 'one_sided'),
}


@pytest.mark.parametrize('case', EVENTS)
def test_an_event_in_the_step_is_a_status_of_its_joint(case: str) -> None:
    *at, status = EVENTS[case]
    robot = pfd.load_robot('planar2')
    sim = pfd.Simulator(robot, ROUGHLY)
    found = sim.linearize(*at)
    assert found.status.tolist() == [status, 'moving']
    columns = [0, 1, 2, 3, 4, 5] if status == 'event' else [1, 3, 4, 5]
    wanted = differences(sim, [np.array(x) for x in at])[:, columns]
    np.testing.assert_allclose(np.hstack(found)[:, columns], wanted, rtol=0, atol=EVENT)
    many = pfd.Ensemble(robot, 3, ROUGHLY)
    rows = [np.stack([other, x, other]) for other, x in zip(SLIDING, at, strict=True)]
    each = many.linearize(*rows)
    np.testing.assert_array_equal(each.A[1], found.A)
    assert each.status.tolist() == [['moving'] * 2, [status, 'moving'], ['moving'] * 2]


def test_derivatives_that_do_not_fit_the_stack_are_refused() -> None:
    robot = random_chain(np.random.default_rng(1), 120, 0.0)
    with pytest.raises(ValueError, match=r'120 joints needs .* MB of the stack'):
        pfd.compile_kernel(robot, quantity='derivatives')


EVENT_STEP = 1e-3
# Inertia of the rotors: a bare wrist is too quick for such a step.
ROTOR = 0.2
IN_TURN = ('rk4', 'velocity_verlet', 'imex2')
KINDS = ('slides', 'turns', 'reaches its stop', 'is held', 'rests at its stop', 'hits its stop')
# Differences, relative to 1 + the largest entry of a column: of rounding over the change; for each
# unit by which two of them differ; and from which there is an event between them.
SMOOTH, UNEVEN, PASSED = 1e-6, 10.0, 1e-3
# The same of the limit by the velocity of a joint that rests at its stop, where hops are rounded.
NEXT_TO_STOP = 1e-3
# Changes of positions and velocities, and of torques relative to gravity's. The time of an event
# is rounded in a simulation, which imex2 shows most; and a hop off a stop that is shorter than a
# part of the step is none: there velocities change by HOP_CHANGE.
CHANGE, HOP_CHANGE = {'rk4': 4e-6, 'velocity_verlet': 4e-6, 'imex2': 1e-3}, 2e-6
# Limits that differ by more are stated by the status.
KINK = 2e-4


CHAINS = 'chain of three', 'chain with a sliding joint', 'another chain'
PAIRS = 'chain of two', 'another chain of two'


@cache
def robots() -> dict[str, pfd.Robot]:
    """Return the arms by name."""
    kinds = ('revolute', 'prismatic', 'revolute')
    chains = {
        'chain of three': random_chain(np.random.default_rng(0), 3, 0.2),
        'chain with a sliding joint': random_chain(
            np.random.default_rng(1), 3, 0.2, joint_types=kinds
        ),
        'another chain': random_chain(np.random.default_rng(2), 3, 0.2),
    }
    pairs = {
        name: random_chain(np.random.default_rng(3 + k), 2, 0.2) for k, name in enumerate(PAIRS)
    }
    return chains | {name: pfd.load_robot(name) for name in ('ur5', 'panda', 'puma560')} | pairs


class Case:
    """An arm in a random scene, and its simulation."""

    def __init__(self, name: str, integrator: str, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, IN_TURN.index(integrator)])
        self.robot = robot = robots()[name]
        n, middle = robot.n, np.full(robot.n, 0.3)
        self.gravity = pfd.compile_kernel(robot, quantity='gravity_torques')
        self.torque = 1 + np.abs(self.gravity(middle))
        inertia = ROTOR + np.diag(pfd.compile_kernel(robot, quantity='inertia_matrix')(middle))
        self.friction = rng.uniform(0.1, 0.6, n) * self.torque
        effects: dict[str, Any] = {
            'friction': self.friction,
            'static_friction': self.friction * rng.choice([1.0, 1.3]),
            'armature': np.full(n, ROTOR),
            'damping': inertia * np.exp(rng.uniform(0, 5, n)),
            'joint_limits': np.transpose([-rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 1.5, n)]),
            'restitution': float(rng.choice([0.0, 0.5, 0.8])),
        }
        more: list[dict[str, Any]] = [
            {},
            {'stribeck_velocity': rng.uniform(0.05, 0.3, n)},
            {'load_friction': rng.uniform(0.05, 0.3, n)},
            {'motor_lag': np.append(rng.choice([0.0, 0.02], n - 1), 0.003)},
            {'gravity_compensation': True, 'effort_limits': 5 * self.torque},
        ]
        effects |= more[(seed + list(robots()).index(name)) % len(more)]
        self.limits = effects['joint_limits']
        settings: dict[str, Any] = {'integrator': integrator, 'substeps': int(rng.integers(1, 3))}
        self.sim = pfd.Simulator(robot, pfd.Scene(**effects), step_size=EVENT_STEP, **settings)
        self.lags = 'motor_lag' in effects

    def state(self, kind: str) -> tuple[np.ndarray, ...]:
        """Return a random state of which one joint is of a kind, and torques."""
        rng, n = self.rng, self.robot.n
        q, qd = rng.uniform(-0.4, 0.4, n), rng.uniform(-1, 1, n)
        j, side = rng.integers(n), rng.integers(2)
        speed = rng.uniform(0.2, 1.0) * (2 * side - 1)
        if kind == 'turns':
            qd[j] = rng.uniform(-1, 1) * rng.choice([1e-2, 2e-3])
        if 'stop' in kind:
            q[j], qd[j] = self.limits[j, side], 0.0 if kind == 'rests at its stop' else speed
        if kind == 'reaches its stop':
            q[j] -= qd[j] * EVENT_STEP * rng.random()
        tau = self.gravity(q) + rng.uniform(-0.8, 0.8, n) * self.torque
        if kind == 'is held':
            qd[j] = 0.0
            tau[j] = self.gravity(q)[j] + rng.uniform(-0.3, 0.3) * self.friction[j]
        if self.sim.scene.gravity_compensation:
            tau -= self.gravity(q)
        return q, qd, tau

    def end(self, x: np.ndarray) -> np.ndarray:
        """Return the state after a step from (q, qd, tau_motor where motors lag, tau)."""
        n, sim = self.robot.n, self.sim
        motor = {'tau_motor': x[2 * n : 3 * n]} if self.lags else {}
        sim.reset(x[:n], x[n : 2 * n], **motor)
        sim.step(x[-n:])
        return np.concatenate([sim.q, sim.qd, *([sim.tau_motor] if self.lags else [])])

    def wrong_columns(self, state: tuple[np.ndarray, ...], seen: Counter[str]) -> list[Any]:
        """Return the columns that differ from the simulation, and count those compared."""
        n = self.robot.n
        found = self.sim.linearize(*state)
        columns = np.hstack(found).T
        x = np.concatenate([*state[:2], *([state[2]] * self.lags), state[2]])
        sizes = np.concatenate([np.ones(2 * n), np.tile(self.torque, 1 + self.lags)])
        sizes *= CHANGE[self.sim.integrator]
        at_stop = (state[0] == self.limits.T).any(axis=0) & (state[1] == 0)
        sizes[n : 2 * n][at_stop] = HOP_CHANGE
        begin, wrong = self.end(x), []
        for c, column in enumerate(columns):
            status = str(found.status[c % n]) if c < 2 * n else 'torque'
            scale, sides, rough = 1 + np.abs(column).max(), [], 0.0
            for change in (sizes[c], -sizes[c]):
                whole, half = (
                    (self.end(x + part * np.eye(len(x))[c]) - begin) / part
                    for part in (change, change / 2)
                )
                sides.append(2 * half - whole)
                rough = max(rough, np.abs(whole - half).max() / scale)
            if rough > PASSED:
                seen['not compared'] += 1
                continue
            kink = np.abs(sides[0] - sides[1]).max() > KINK * scale
            if kink and status != 'one_sided':
                wrong.append((c, status, 'a kink that no status states'))
                continue
            if c >= n and status in ('held', 'one_sided'):
                sides = [(sides[0] + sides[1]) / 2]
            elif kink:
                # Outwards.
                sides = [sides[int(state[0][c % n] < 0)]]
            seen[status if kink or status != 'one_sided' else 'one_sided, this column not'] += 1
            apart = max(np.abs(side - column).max() for side in sides) / scale
            exact = NEXT_TO_STOP if at_stop[c % n] and n <= c < 2 * n else SMOOTH
            if apart > exact + UNEVEN * rough:
                wrong.append((c, status, apart, rough))
        return wrong


RANDOM_CASES = [
    (PAIRS[0], 'rk4', 8),
    (PAIRS[1], 'imex2', 4),
    *(
        pytest.param(name, integrator, 4, marks=pytest.mark.long)
        for name in (*CHAINS, 'ur5', 'panda', 'puma560')
        for integrator in IN_TURN
    ),
]


@pytest.mark.filterwarnings('ignore:.*outside the stops:pfd_core.PhysicsWarning')
@pytest.mark.parametrize(('name', 'integrator', 'seed'), RANDOM_CASES)
def test_a_and_b_are_differences_of_the_simulation_through_events(
    name: str, integrator: str, seed: int
) -> None:
    case, seen, wrong = Case(name, integrator, seed), Counter[str](), {}
    for k in range(36):
        kind = KINDS[k % len(KINDS)]
        columns = case.wrong_columns(case.state(kind), seen)
        if columns:
            wrong[k, kind] = columns
    assert not wrong, seen
    assert min(seen['event'] - 5, seen['one_sided']) > 2, seen
    assert seen['not compared'] < 0.1 * seen.total(), seen
