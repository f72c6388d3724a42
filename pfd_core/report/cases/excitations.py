# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Trajectories that scenes are compared on: the torques of every step, and states to start from.

A motion comes from a recording, or is one of EXCITATIONS: a reference position that the arm
follows in its full scene under

    tau = ID(q, qd, qdd_ref + W^2 (q_ref - q) + 2 W (qd_ref - qd)),

inverse dynamics in that scene, but for its dry friction, with a critically damped PD law
(computed torque: J. J. Craig, Introduction to Robotics, 3rd edition, chapter 10), bounded by the
effort limits of the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import EFFECTS, Robot, Scene
from pfd_core.model.checked_numbers import Array
from pfd_core.model.effects import STEP
from pfd_core.simulation.simulator import Simulator

# Settings of the simulator for an excitation, and its length.
SETTINGS: Mapping[str, Any] = {
    'step_size': 1e-3,
    'substeps': 2,
    'integrator': 'auto',
    'method': 'auto',
}
SECONDS = 4.0
# Bandwidth W of the PD law [rad/s].
BANDWIDTH = 10.0
# Amplitude of a reference [rad or m], and its largest shares of a joint's range and velocity.
AMPLITUDE, RANGE_SHARE, VELOCITY_SHARE = 0.5, 0.25, 0.5


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """
    The torques of K steps of an arm, and S states that it passes.

    Attributes
    ----------
    name, source : str
        Name of the trajectory, and the origin of its torques, for the reader of the page.
    settings : mapping
        step_size, substeps, integrator and method, as Simulator takes them.
    taus : ndarray
        (K, n), torques of each step [N m or N].
    held : ndarray of bool
        (K, n), joints that a brake holds in each step.
    after : ndarray of int
        (S,), number of steps after which each state is passed; it rises from 0.
    q, qd : ndarray
        (S, n), positions and velocities of these states [rad or m, and per s].

    """

    name: str
    source: str
    settings: Mapping[str, Any]
    taus: Array
    held: Array
    after: Array
    q: Array
    qd: Array


Reference = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Excitation:
    """
    A reference position, for joints of any kind and number.

    Attributes
    ----------
    source : str
        The reference in words.
    peak : float
        Largest velocity of a joint per unit of amplitude [1/s].
    reference : callable
        reference(t, n) of times (K,) returns the position of each joint in units of its
        amplitude, from the middle of its range, and its derivatives, (K, n) each.

    """

    source: str
    peak: float
    reference: Callable[[Array, int], Reference]


def _sine(t: Array, n: int) -> Reference:
    w = 2 * np.pi * np.linspace(0.4, 1.0, n)
    phase = t[:, None] * w
    return np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)


def _swing(t: Array, n: int) -> Reference:
    """Return two quintic polynomials at rest at both ends, there and back, of half the time."""
    half = SECONDS / 2
    s = np.where(t < half, t, SECONDS - t)[:, None] / half
    back = np.where(t < half, 1.0, -1.0)[:, None]
    y = -1 + 2 * s**3 * (10 - 15 * s + 6 * s**2)
    yd = back * 60 * s**2 * (1 - s) ** 2 / half
    ydd = 120 * s * (1 - s) * (1 - 2 * s) / half**2
    joints = np.ones(n)
    return y * joints, yd * joints, ydd * joints


def _steps(t: Array, n: int) -> Reference:
    levels = np.array([0.0, 1.0, -1.0, 0.0])
    count = np.minimum((t / SECONDS * len(levels)).astype(int), len(levels) - 1)
    y = levels[count][:, None] * np.where(np.arange(n) % 2, -1.0, 1.0)
    return y, np.zeros_like(y), np.zeros_like(y)


EXCITATIONS: Mapping[str, Excitation] = {
    'swing': Excitation('all joints swing over at once and back, at rest at both ends', 2, _swing),
    'sine': Excitation(
        'each joint follows a sine of a different frequency, 0.4 to 1 Hz', 2 * np.pi, _sine
    ),
    # The PD law overshoots nothing: 2 W / e is its fastest answer to a jump by 2.
    'steps': Excitation(
        'the set-points jump once a second, neighbours against each other',
        2 * BANDWIDTH / np.e,
        _steps,
    ),
}


def excitation_named(name: str) -> Excitation:
    """Return an excitation of EXCITATIONS; ValueError for another name."""
    if name not in EXCITATIONS:
        raise ValueError(
            f'trajectory must be a recording (LOG.mcap) or one of {", ".join(EXCITATIONS)}, '
            f'got {name!r}'
        )
    return EXCITATIONS[name]


def excited_motion(robot: Robot, scene: Scene, name: str) -> DrivenMotion:
    """
    Return the motion of a robot in its full scene that follows an excitation.

    Raises
    ------
    ValueError
        If there is no excitation of this name, or the robot cannot be simulated in the scene.

    """
    excitation = excitation_named(name)
    simulator = Simulator(robot, scene, **SETTINGS)
    h = simulator.step_size
    count = round(SECONDS / h)
    wanted = _scaled_reference(robot, excitation, h * np.arange(count))
    wrench = np.zeros(6) if scene.external_wrench else None
    instant = scene.without({effect.name for effect in EFFECTS if effect.acts == STEP})
    inverse = compile_kernel(robot, scene=instant, quantity='inverse_dynamics')
    strongest = _unless_zero(robot.effort_limit)
    taus, q, qd = np.empty((3, count, robot.n))
    simulator.reset(wanted[0][0], wanted[1][0])
    for k, (y, yd, ydd) in enumerate(zip(*wanted, strict=True)):
        q[k], qd[k] = simulator.q, simulator.qd
        qdd = ydd + BANDWIDTH**2 * (y - q[k]) + 2 * BANDWIDTH * (yd - qd[k])
        tau = inverse(q[k], qd[k], qdd, wrench)
        taus[k] = np.clip(tau, -strongest, strongest)
        simulator.step(taus[k], wrench)
    return DrivenMotion(
        name,
        excitation.source,
        SETTINGS,
        taus,
        np.zeros((count, robot.n), bool),
        np.arange(count),
        q,
        qd,
    )


def _scaled_reference(robot: Robot, excitation: Excitation, t: Array) -> Reference:
    """Return a reference and its derivatives about the middle of the joints' ranges, (K, n)."""
    limited = np.isfinite(robot.position_lower) & np.isfinite(robot.position_upper)
    lower = np.where(limited, robot.position_lower, 0.0)
    upper = np.where(limited, robot.position_upper, 0.0)
    room = np.where(limited, RANGE_SHARE * (upper - lower), np.inf)
    fastest = VELOCITY_SHARE * _unless_zero(robot.velocity_limit) / excitation.peak
    amplitude = np.minimum(np.minimum(room, fastest), AMPLITUDE)
    y, yd, ydd = (amplitude * part for part in excitation.reference(t, robot.n))
    return (lower + upper) / 2 + y, yd, ydd


def _unless_zero(limit: Array) -> Array:
    """Return limits with infinity for zero, by which many URDFs mean that they know none."""
    return np.where(limit > 0, limit, np.inf)
