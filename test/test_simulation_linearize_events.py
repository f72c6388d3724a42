# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearised steps through events, against differences of the simulation on both sides.

Random arms, scenes and states: joints that slide, reverse, come to rest, are held, reach their
stop, rest at it or hit it at the beginning of the step. A column is a difference on each side, of
two sizes. Where these two differ, the difference has passed an event, or the step itself is uneven
there, and the column is compared less closely or not at all.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import pytest
from zoo import random_chain

import pfd_core as pfd

H = 1e-3
# Inertia of the rotors: a bare wrist is too quick for such a step.
ROTOR = 0.2
INTEGRATORS = ('rk4', 'velocity_verlet', 'imex2')
KINDS = ('slides', 'turns', 'reaches its stop', 'is held', 'rests at its stop', 'hits its stop')
# Differences, relative to 1 + the largest entry of a column: of rounding over the change; for each
# unit by which two of them differ; and from which there is an event between them.
EXACT, UNEVEN, PASSED = 1e-6, 10.0, 1e-3
# The same of the limit by the velocity of a joint that rests at its stop, where hops are rounded.
NEXT_TO_STOP = 1e-3
# Changes of positions and velocities, and of torques relative to gravity's. The time of an event
# is rounded in a simulation, which imex2 shows most; and a hop off a stop that is shorter than a
# part of the step is none: there velocities change by HOP.
CHANGE, HOP = {'rk4': 4e-6, 'velocity_verlet': 4e-6, 'imex2': 1e-4}, 2e-6
# Limits that differ by more are stated by the status.
KINK = 2e-4


CHAINS = 'chain of three', 'chain with a sliding joint', 'another chain'


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
    return chains | {name: pfd.load_robot(name) for name in ('ur5', 'panda', 'puma560')}


class Case:
    """An arm in a random scene, and its simulation."""

    def __init__(self, name: str, integrator: str, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, INTEGRATORS.index(integrator)])
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
        self.sim = pfd.Simulator(robot, pfd.Scene(**effects), step_size=H, **settings)
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
            q[j] -= qd[j] * H * rng.random()
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
        sizes[n : 2 * n][at_stop] = HOP
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
            exact = NEXT_TO_STOP if at_stop[c % n] and n <= c < 2 * n else EXACT
            if apart > exact + UNEVEN * rough:
                wrong.append((c, status, apart, rough))
        return wrong


CASES = [
    pytest.param(
        name,
        integrator,
        marks=[]
        if (name, integrator) in (('chain of three', 'rk4'), ('another chain', 'imex2'))
        else [pytest.mark.slow, pytest.mark.long],
    )
    for name in (*CHAINS, 'ur5', 'panda', 'puma560')
    for integrator in INTEGRATORS
]


@pytest.mark.parametrize(('name', 'integrator'), CASES)
def test_a_and_b_are_differences_of_the_simulation_through_events(
    name: str, integrator: str
) -> None:
    case, seen, wrong = Case(name, integrator, 4), Counter[str](), {}
    for k in range(36):
        kind = KINDS[k % len(KINDS)]
        columns = case.wrong_columns(case.state(kind), seen)
        if columns:
            wrong[k, kind] = columns
    assert not wrong, seen
    assert min(seen['event'] - 5, seen['one_sided']) > 2, seen
    assert seen['not compared'] < 0.1 * seen.total(), seen


# Central differences of a motion's end, whose events are rounded.
MOTION = 1e-5


def test_the_gradient_of_a_motion_through_events_is_the_product_of_its_steps() -> None:
    robot, steps, n = pfd.load_robot('planar2'), 400, 2
    scene = pfd.Scene(
        damping=[0.3, 0.2],
        friction=[0.5, 0.3],
        joint_limits=[[-0.4, 0.5], [-1.0, 1.2]],
        restitution=0.5,
    )
    sim = pfd.Simulator(robot, scene, integrator='rk4')
    times = np.arange(steps)[:, np.newaxis] * sim.step_size
    balance = pfd.compile_kernel(robot, quantity='gravity_torques')([0.2, 0.4])
    taus = balance + [9.0, 6.0] * np.cos(25 * times + [0.0, 1.0])
    begin = np.array([0.2, 0.4, 1.0, 3.0])

    def end(begin: np.ndarray, taus: np.ndarray) -> np.ndarray:
        sim.reset(begin[:n], begin[n:])
        run = sim.rollout(taus)
        return np.concatenate([run.q[-1], run.qd[-1]])

    end(begin, taus)
    sim.reset(begin[:n], begin[n:])
    run = sim.rollout(taus)
    states = np.vstack([begin, np.hstack([run.q, run.qd])[:-1]])
    many = pfd.Ensemble(robot, steps, scene, integrator='rk4')
    found = many.linearize(states[:, :n], states[:, n:], taus)
    assert (found.status == 'event').sum() >= 4
    assert not (found.status == 'one_sided').any()
    # Of a weighted sum of the end, by the state before each step and by its torque.
    weights = np.array([1.0, -2.0, 0.5, 0.3])
    by_state, by_torque = weights, np.empty_like(taus)
    for k in reversed(range(steps)):
        by_torque[k] = by_state @ found.B[k]
        by_state = by_state @ found.A[k]
    change = 1e-6
    shifts = change * np.eye(2 * n)
    wanted = [(end(begin + x, taus) - end(begin - x, taus)) @ weights for x in shifts]
    np.testing.assert_allclose(by_state, np.array(wanted) / (2 * change), rtol=MOTION)
    direction = np.random.default_rng(0).uniform(-1, 1, taus.shape)
    ends = [end(begin, taus + s * change * direction) @ weights for s in (1, -1)]
    wanted = (ends[0] - ends[1]) / (2 * change)
    np.testing.assert_allclose((by_torque * direction).sum(), wanted, rtol=MOTION)
