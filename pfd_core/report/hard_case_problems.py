# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots and states of the hard cases: chains of rods, and arms of config/robots.

Axes of chains are at right angles. A rod lies along x of its frame, from the joint that moves it
to the next. 'y' turns all joints about one horizontal direction, so that gravity acts in the
plane of the chain; 'yz' turns every second joint about the other direction at right angles to the
rods.

The numbers of chains and of all states are rounded to float32, so that one reference serves both
number formats. Those of the arms of config/robots are as published: an error in float32 includes
their rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import record_inverse_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model import Payload, Plant, Robot, Scene, load_robot, resolve, with_payload

Array = NDArray[Any]

SEED = 1987
LENGTH, RADIUS = 0.25, 0.02
# z of these axes is horizontal, and x too.
_LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def single(values: NDArray[Any]) -> Array:
    """Return numbers rounded to float32, as float64."""
    return values.astype(np.float32).astype(np.float64)


def chain(
    n: int, axes: str, *, masses: Mapping[int, float] | None = None, lengths: Array | None = None
) -> Robot:
    """
    Return n rods of 0.25 m and 1 kg.

    Parameters
    ----------
    n : int
        Joints.
    axes : {'y', 'yz'}
        Parallel, or every second one turned by a right angle.
    masses : mapping, optional
        Index of a link to its mass [kg], where it is not 1.
    lengths : ndarray, optional
        (n,) [m].

    """
    length = np.full(n, LENGTH) if lengths is None else lengths
    mass = np.ones(n)
    for index, value in (masses or {}).items():
        mass[index] = value
    along = np.stack([length, 0 * length, 0 * length], axis=-1)
    moments = np.stack([np.full(n, RADIUS**2 / 2), *[length**2 / 12 + RADIUS**2 / 4] * 2], -1)
    turns = [_LYING if k % 2 == 0 else _LYING.T for k in range(n)]
    return Robot(
        name=f'chain{n}_{axes}',
        joint_names=tuple(f'joint{k + 1}' for k in range(n)),
        joint_types=('continuous',) * n,
        rotations=np.array(turns if axes == 'yz' else [np.eye(3)] * n),
        translations=along,
        masses=single(mass),
        centers=-along / 2,
        inertias=single(mass[:, None, None] * moments[:, None, :] * np.eye(3)),
        base_rotation=_LYING,
    )


def tiny_tip(inertia: float) -> Robot:
    """Return six rods, the last one a bead of 1 g on its own axis with this inertia [kg m^2]."""
    robot = chain(6, 'yz', masses={5: 1e-3})
    changed = {key: getattr(robot, key).copy() for key in ('translations', 'centers', 'inertias')}
    changed['translations'][-1] = changed['centers'][-1] = 0.0
    changed['inertias'][-1] = single(inertia * np.eye(3))
    return replace(robot, **changed)


def coaxial(inertia: float) -> Robot:
    """Return two joints on one axis, a massless link of this inertia between, and two rods."""
    robot = chain(3, 'y', masses={0: 0.0})
    changed = {key: getattr(robot, key).copy() for key in ('translations', 'centers', 'inertias')}
    changed['translations'][0] = changed['centers'][0] = 0.0
    changed['inertias'][0] = single(inertia * np.eye(3))
    return replace(robot, **changed)


def rescaled(robot: Robot, length: float, mass: float) -> Robot:
    """Return a robot whose lengths and masses are multiplied by powers of two."""
    return replace(
        robot,
        translations=robot.translations * length,
        centers=robot.centers * length,
        masses=robot.masses * mass,
        inertias=robot.inertias * (mass * length**2),
    )


@dataclass(frozen=True)
class Problem:
    """
    A plant and states of it.

    Attributes
    ----------
    plant : Plant
        Robot and scene.
    states : dict
        q, qd and tau, (S, n) each.
    at_hold : bool
        Whether tau holds the arm, so that the error is relative to qdd at tau = 0.
    twin : callable, optional
        Makes a problem that must have the same bits of qdd.

    """

    plant: Plant
    states: dict[str, Array]
    at_hold: bool = False
    twin: Callable[[], Problem] | None = None


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
    rng = np.random.default_rng(SEED)
    drawn = {
        name: reach * rng.uniform(-1.0, 1.0, (states, robot.n))
        for name, reach in (('q', 1.0 if isinstance(q, np.ndarray) else q), ('qd', qd))
    }
    drawn['tau'] = tau * rng.uniform(-1.0, 1.0, (states, robot.n))
    if isinstance(q, np.ndarray):
        drawn['q'] = np.tile(q, (states, 1))
    rounded = {name: single(value) for name, value in drawn.items()}
    return Problem(resolve(robot, scene), rounded)


def arm(name: str, states: int) -> Problem:
    """Return an arm of config/robots at ordinary states."""
    return problem(load_robot(name), qd=2.0, tau=5.0, states=states)


def payload() -> Problem:
    """Return panda with a load a million times heavier than its links."""
    load = Payload(1e6, (0.0, 0.0, 0.125), 1e3 * np.eye(3))
    return problem(load_robot('panda'), scene=Scene(payload=load))


def wrist(q5: float) -> Problem:
    """Return puma560 with a wrist that is nearly straight; q5 in rad."""
    return problem(load_robot('puma560'), q=np.array([0.3, -0.5, 0.7, 1.1, q5, -0.4]))


def heavy_tip(n: int, axes: str) -> Problem:
    """Return a chain whose last link weighs 1e8 kg."""
    return problem(chain(n, axes, masses={n - 1: 1e8}))


def one_link(index: int, mass: float) -> Problem:
    """Return a chain of six in which one link has another mass [kg]."""
    return problem(chain(6, 'yz', masses={index: mass}))


def far(distance: float) -> Problem:
    """Return a chain with its base at a distance [m]; its twin is at the origin."""

    def at(x: float) -> Problem:
        return problem(replace(chain(6, 'yz'), base_position=np.array([x, 0.0, 0.0])))

    return replace(at(distance), twin=partial(at, 0.0))


def scaled(length: float, mass: float) -> Problem:
    """Return a chain in other units of length and mass: both powers of two, the bits stay."""
    plain = problem(chain(6, 'yz'), scene=Scene(gravity=(0.0, 0.0, -9.8125)))
    scene = Scene(gravity=(0.0, 0.0, -9.8125 * length))
    states = plain.states | {'tau': plain.states['tau'] * mass * length**2}
    plant = resolve(rescaled(plain.plant.robot, length, mass), scene)
    return Problem(plant, states, twin=lambda: plain)


def collinear(inertia: float, load: float = 0.0) -> Problem:
    """Return two coaxial joints with an inertia [kg m^2] between and a point load [kg]."""
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
    """Return a chain that its torques hold against gravity, but for rounding to float32."""
    moving = problem(chain(12, 'yz'), qd=0.0)
    state = {'q': moving.states['q'], 'qd': moving.states['qd']}
    program = record_inverse_dynamics(moving.plant, 'parallel')
    tau = run(program, state | {'qdd': np.zeros_like(state['q'])})['tau']
    return Problem(moving.plant, state | {'tau': single(tau)}, at_hold=True)
