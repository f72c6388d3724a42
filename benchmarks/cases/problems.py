# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Problems: a robot in a scene with seeded states, and the functions that tables of cases name.

The numbers of problems are rounded to float32, so that one reference serves both number formats.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.cases.robots import Array, bead_on, chain, mechanism, single
from benchmarks.cases.robots import robot as robot_named
from pfd_core.algorithms.programs import record_inverse_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model import Payload, Plant, Robot, Scene, resolve, with_payload

SEED = 1987
# Seed and number of states for all makers, instead of the values in the tables.
_DRAWN: ContextVar[tuple[int, int] | None] = ContextVar('drawn', default=None)


@dataclass(frozen=True)
class Problem:
    """
    A robot in a scene, and states: q, qd and tau, (S, n) each.

    If tau holds the arm (`at_hold`), errors are relative to qdd at tau = 0.
    """

    plant: Plant
    states: dict[str, Array]
    at_hold: bool = False


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
    return Problem(resolve(robot, scene), {name: single(x) for name, x in drawn.items()})


def seeded_states(n: int, count: int) -> dict[str, Array]:
    """
    Return states (count, n), for programs that count iterations and steps.

    Positions are any angle [rad], velocities up to 2 rad/s, torques up to 5 N m, not rounded.
    """
    unit = 2 * np.random.default_rng(SEED).random((3, count, n)) - 1
    return {'q': np.pi * unit[0], 'qd': 2 * unit[1], 'tau': 5 * unit[2]}


def scene_of(plant: Plant) -> Scene:
    """Return the scene of a case's plant, for `plant.robot`; ValueError for other effects."""
    # The default first: turning gravity back into the base link's axes may round.
    for gravity in (Scene().gravity, tuple(plant.robot.base_rotation @ plant.gravity)):
        scene = Scene(
            gravity=gravity, armature=plant.armature, external_wrench=plant.external_wrench
        )
        if resolve(plant.robot, scene).digest == plant.digest:
            return scene
    raise ValueError('the plant has effects other than gravity, rotors and a wrench')


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
    return Problem(moving.plant, state | {'tau': single(tau)}, at_hold=True)
