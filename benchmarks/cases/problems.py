# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Problems: a robot in a scene with seeded states, and the functions that tables of cases name.

The numbers of problems are rounded to float32, so that one reference serves both number formats.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.cases.robots import (
    Array,
    chain,
    coaxial,
    mechanism,
    rescaled,
    single,
    tiny_tip,
)
from benchmarks.cases.robots import robot as robot_named
from pfd_core.algorithms.programs import record_inverse_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model import Payload, Plant, Robot, Scene, load_robot, resolve, with_payload

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
    q: float | Array = np.pi,
    qd: float = 1.0,
    tau: float = 1.0,
    states: int = 1,
) -> Problem:
    """Return seeded states: each of q [rad], qd, tau is uniform within +- its bound, or given."""
    seed, states = _DRAWN.get() or (SEED, states)
    rng = np.random.default_rng(seed)
    reach = {'q': 1.0 if isinstance(q, np.ndarray) else q, 'qd': qd, 'tau': tau}
    drawn = {name: x * rng.uniform(-1.0, 1.0, (states, robot.n)) for name, x in reach.items()}
    if isinstance(q, np.ndarray):
        drawn['q'] = np.tile(q, (states, 1))
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
    q: float = np.pi,
    qd: float = 1.0,
    states: int = 1,
) -> Problem:
    """Return a chain, perhaps with other masses [kg], at states within bounds [rad, rad/s]."""
    return problem(chain(n, axes, masses=masses), q=q, qd=qd, states=states)


def links(axes: str, **parts: Mapping[int, float]) -> Problem:
    """Return a mechanism whose parts have other numbers, as in `mechanism`."""
    return problem(mechanism(axes, **parts))


def folded(n: int) -> Problem:
    """Return a chain in which every link lies on the one before."""
    return problem(chain(n, 'y'), q=np.array([0.0] + [np.pi] * (n - 1)))


def tiny(inertia: float) -> Problem:
    """Return a chain with a bead of an inertia [kg m^2] at its tip."""
    return problem(tiny_tip(inertia))


def arm(name: str, states: int) -> Problem:
    """Return an arm at ordinary states."""
    return problem(robot_named(name), qd=2.0, tau=5.0, states=states)


def pushed(name: str, force: float, states: int) -> Problem:
    """Return an arm with a wrench on its last link, up to `force` [N] and as much moment [N m]."""
    drawn = problem(
        robot_named(name), scene=Scene(external_wrench=True), qd=2.0, tau=5.0, states=states
    )
    rng = np.random.default_rng([SEED, len(drawn.states['q'])])
    wrench = single(force * rng.uniform(-1.0, 1.0, (len(drawn.states['q']), 6)))
    return replace(drawn, states=drawn.states | {'wrench': wrench})


def payload() -> Problem:
    """Return panda with a load a million times heavier than its links."""
    load = Payload(1e6, (0.0, 0.0, 0.125), 1e3 * np.eye(3))
    return problem(load_robot('panda'), scene=Scene(payload=load))


def wrist(q5: float) -> Problem:
    """Return puma560 with a wrist that is nearly straight; q5 in rad."""
    return problem(load_robot('puma560'), q=np.array([0.3, -0.5, 0.7, 1.1, q5, -0.4]))


def far(distance: float) -> Problem:
    """Return a chain with its base at a distance [m]: the bits are the same at any."""
    return problem(replace(chain(6, 'yz'), base_position=np.array([distance, 0.0, 0.0])))


def scaled(length: float, mass: float) -> Problem:
    """Return a chain in other units of length and mass, powers of two: the bits are the same."""
    scene = Scene(gravity=(0.0, 0.0, -9.8125 * length))
    scaled_up = problem(rescaled(chain(6, 'yz'), length, mass), scene=scene)
    states = scaled_up.states | {'tau': scaled_up.states['tau'] * mass * length**2}
    return replace(scaled_up, states=states)


def collinear(inertia: float, load: float = 0.0) -> Problem:
    """Return two coaxial joints with an inertia [kg m^2] between them and a point load [kg]."""
    robot = coaxial(inertia)
    if load:
        robot = with_payload(robot, Payload(load))
    return problem(robot)


def mixed() -> Problem:
    """Return a chain of rods of 1 m and 1 kg, and of 1 mm and 1 mg."""
    lengths = np.where(np.arange(6) % 2, 2.0**-10, 1.0)
    return problem(chain(6, 'yz', lengths=lengths, masses={1: 1e-6, 3: 1e-6, 5: 1e-6}))


def rotors() -> Problem:
    """Return a chain with rotor inertias of 1e6 kg m^2 at every second joint."""
    return problem(chain(6, 'yz'), scene=Scene(armature=(1e6, 0.0, 1e6, 0.0, 1e6, 0.0)))


def static_hold() -> Problem:
    """Return a chain in equilibrium under its torques, apart from rounding to float32."""
    moving = problem(chain(12, 'yz'), qd=0.0)
    state = {'q': moving.states['q'], 'qd': moving.states['qd']}
    program = record_inverse_dynamics(moving.plant, 'parallel')
    tau = run(program, state | {'qdd': np.zeros_like(state['q'])})['tau']
    return Problem(moving.plant, state | {'tau': single(tau)}, at_hold=True)


def extended(axes: str, reach: float) -> Problem:
    """Return a mechanism whose slides are up to a distance [m] out; turns stay within pi."""
    drawn = problem(mechanism(axes))
    scale = np.array([reach if letter.isupper() else 1.0 for letter in axes])
    return Problem(drawn.plant, drawn.states | {'q': single(drawn.states['q'] * scale)})


def loaded(name: str, mass: float, distance: float) -> Problem:
    """Return an arm of config/robots with a point load [kg] on a tool of a length [m]."""
    return problem(with_payload(load_robot(name), Payload(mass, (0.0, 0.0, distance))))
