# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Problems: a robot in a scene with seeded states, quantities of them, and tables of hard problems.

A case of CASES is hard to compute, or ordinary; it states the cause of its difficulty. MECHANISMS
have unusual proportions. Their tables, data/hard_cases.yaml and data/mechanisms.yaml, name
functions of this module. The numbers of states are rounded to float32, so that one reference
serves both number formats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases.robots import Array, bead_on, chain, mechanism, single
from benchmarks.cases.robots import robot as robot_named
from benchmarks.table import stored_table
import pfd_core as pfd
from pfd_core.kernels.compile import inverse_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model.plant import Plant, resolve
from pfd_core.model.robot import Payload, Robot, with_payload
from pfd_core.model.scene import Scene
from pfd_core.paper.newton_euler import record_inverse_dynamics

# Units of rounding of the number formats.
ROUNDING = {'float64': 2.0**-53, 'float32': 2.0**-24}
FORWARD = 'forward_dynamics'
STATE = ('q', 'qd', 'tau')
MEASURED = (FORWARD, 'inverse_dynamics', 'inertia_matrix', 'bias_torques', 'derivatives')
# Quantity to the names of its arguments.
QUANTITIES = {name: pfd.QUANTITIES[name].arguments for name in MEASURED}
SEED = 1987
# Seed and number of states for all makers, instead of the values in the tables.
_DRAWN: ContextVar[tuple[int, int] | None] = ContextVar('drawn', default=None)


@dataclass(frozen=True)
class Problem:
    """
    A robot in a scene, and states: q, qd and tau, (S, n) each.

    If tau holds the arm (`at_hold`), errors are relative to qdd at tau = 0.
    """

    robot: Robot
    scene: Scene | None
    states: dict[str, Array]
    at_hold: bool = False

    @cached_property
    def plant(self) -> Plant:
        """The robot in its scene, as numbers."""
        return resolve(self.robot, self.scene)


@contextmanager
def drawing(seed: int, states: int) -> Iterator[None]:
    """Make all makers draw this number of states from this seed."""
    token = _DRAWN.set((seed, states))
    try:
        yield
    finally:
        _DRAWN.reset(token)


def problem(
    robot: Robot,
    *,
    scene: Scene | None = None,
    q: float | Sequence[float] = np.pi,
    qd: float = 1.0,
    tau: float = 1.0,
    states: int = 1,
) -> Problem:
    """Return seeded states: each of q [rad], qd, tau is uniform within +- its bound, or given."""
    seed, states = _DRAWN.get() or (SEED, states)
    unit = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, states, robot.n))
    given = np.tile(q, (states, 1)) if isinstance(q, Sequence) else q * unit[0]
    drawn = {'q': given, 'qd': qd * unit[1], 'tau': tau * unit[2]}
    return Problem(robot, scene, {name: single(x) for name, x in drawn.items()})


def seeded_states(n: int, count: int) -> dict[str, Array]:
    """
    Return states (count, n), for programs that count iterations and steps.

    Positions are any angle [rad], velocities up to 2 rad/s, torques up to 5 N m, not rounded.
    """
    unit = 2 * np.random.default_rng(SEED).random((3, count, n)) - 1
    return {'q': np.pi * unit[0], 'qd': 2 * unit[1], 'tau': 5 * unit[2]}


def random_states(robot: Robot, count: int) -> dict[str, Array]:
    """Return q, qd, qdd and the torques of that acceleration, (count, n) each."""
    rng = np.random.default_rng(SEED)
    q, qd, qdd = (
        single(reach * rng.uniform(-1, 1, (count, robot.n))) for reach in (np.pi, 1.0, 1.0)
    )
    return {'q': q, 'qd': qd, 'qdd': qdd, 'tau': single(inverse_dynamics(robot, q, qd, qdd))}


def rods(
    n: int,
    axes: str,
    masses: Mapping[int, float] | None = None,
    *,
    lengths: Sequence[float] | None = None,
    base: float = 0.0,
    bead: tuple[int, float] | None = None,
    load: float = 0.0,
    armature: Sequence[float] | None = None,
    **drawn: Any,
) -> Problem:
    """
    Return a chain with some numbers changed, at states as in `problem`.

    `base` is its distance from the origin [m], `bead` a link that is one, and its inertia
    [kg m^2], `load` a point at the tip [kg] and `armature` rotor inertias [kg m^2].
    """
    robot = chain(n, axes, masses=masses, lengths=lengths)
    if base:
        robot = replace(robot, base_position=np.array([base, 0.0, 0.0]))
    if bead:
        robot = bead_on(robot, *bead)
    if load:
        robot = with_payload(robot, Payload(load))
    scene = Scene(armature=tuple(armature)) if armature else None
    return problem(robot, scene=scene, **drawn)


def links(axes: str, reach: float = 1.0, **parts: Mapping[int, float]) -> Problem:
    """Return a mechanism of such parts, with slides up to `reach` [m] times pi out."""
    drawn = problem(mechanism(axes, **parts))
    scale = np.array([reach if letter.isupper() else 1.0 for letter in axes])
    return replace(drawn, states=drawn.states | {'q': single(drawn.states['q'] * scale)})


def arm(
    name: str,
    states: int = 1,
    *,
    load: tuple[float, ...] | None = None,
    wrench: float = 0.0,
    qd: float = 2.0,
    tau: float = 5.0,
    **drawn: Any,
) -> Problem:
    """
    Return an arm at states as in `problem`.

    `load` has mass [kg], distance of its centre from the last frame along z [m] and three equal
    moments of inertia [kg m^2]. A wrench acts on the last link: up to `wrench` [N] and [N m].
    """
    robot = robot_named(name)
    if load:
        mass, distance, inertia = (*load, 0.0)[:3]
        robot = with_payload(robot, Payload(mass, (0.0, 0.0, distance), inertia * np.eye(3)))
    scene = Scene(external_wrench=bool(wrench))
    found = problem(robot, scene=scene, qd=qd, tau=tau, states=states, **drawn)
    if not wrench:
        return found
    count = len(found.states['q'])
    unit = np.random.default_rng([SEED, count]).uniform(-1.0, 1.0, (count, 6))
    return replace(found, states=found.states | {'wrench': single(wrench * unit)})


def scaled(length: float, mass: float) -> Problem:
    """Return a chain in other units of length and mass, powers of two: the bits are the same."""
    plain, scene = chain(6, 'yz'), Scene(gravity=(0.0, 0.0, -9.8125 * length))
    units = {'translations': length, 'centers': length, 'masses': mass}
    units |= {'inertias': mass * length**2}
    robot = replace(plain, **{key: getattr(plain, key) * unit for key, unit in units.items()})
    drawn = problem(robot, scene=scene)
    return replace(drawn, states=drawn.states | {'tau': drawn.states['tau'] * mass * length**2})


def static_hold() -> Problem:
    """Return a chain in equilibrium under its torques, apart from rounding to float32."""
    moving = rods(12, 'yz', qd=0.0)
    state = {'q': moving.states['q'], 'qd': moving.states['qd']}
    program = record_inverse_dynamics(moving.plant, 'parallel')
    tau = run(program, state | {'qdd': np.zeros_like(state['q'])})['tau']
    return replace(moving, states=state | {'tau': single(tau)}, at_hold=True)


class Case(NamedTuple):
    """A named problem: the cause of its difficulty, and a function that returns the problem."""

    name: str
    cause: str
    make: Callable[[], Problem]


def _stored(table: str) -> Iterator[Case]:
    for name, row in stored_table(table).items():
        maker, *given = row['make']
        make = partial(globals()[maker], *given, **row.get('options', {}))
        yield Case(name, row['cause'], make)


CASES: Sequence[Case] = tuple(_stored('hard_cases'))
MECHANISMS: Sequence[Case] = tuple(_stored('mechanisms'))
