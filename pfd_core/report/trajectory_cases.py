# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motions that are hard to integrate, as one table (MOTIONS), and the bounds of their runs (CHECKS).

No motor acts on the arms. Each motion has a reference in extended precision at its end
(trajectory_references), with the way in which it was computed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from pfd_core.model import Robot, Scene, load_robot
from pfd_core.report.extrapolation import Extrapolation
from pfd_core.report.hard_case_problems import Array, heavy_tip

# Order 24 in 34 digits, and order 20 in 50 digits for any damping.
MIDPOINT, IMPLICIT = Extrapolation('midpoint', 12, 34), Extrapolation('implicit', 20, 50)


@dataclass(frozen=True)
class Motion:
    """
    A free motion.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why the motion is hard.
    arm : callable
        Makes the robot.
    scene : Scene
        Gravity, damping and rotor inertia.
    q, qd : tuple of float
        State at the start [rad, rad/s].
    duration : float
        Time of the reference [s].
    steps : int
        Macro steps of the reference.
    halvings : int
        Times that the first macro step is halved, for a motion that damping stops at once.
    way : Extrapolation
        Scheme of the reference.

    """

    name: str
    cause: str
    arm: Callable[[], Robot] = field(repr=False)
    scene: Scene
    q: tuple[float, ...]
    qd: tuple[float, ...]
    duration: float
    steps: int
    halvings: int = 0
    way: Extrapolation = MIDPOINT


@dataclass(frozen=True)
class Check:
    """
    A run of a motion, and its bound.

    Attributes
    ----------
    motion, integrator : str
        Name in MOTIONS, and name of an integrator.
    step : float
        Step [s], or the relative tolerance of an adaptive integrator.
    quantity : {'angle', 'energy'}
        Largest error of an angle at the time of the reference [rad]; or largest error of the
        energy up to `duration` over the peak kinetic energy.
    bound : float
        Largest value allowed.
    duration : float, optional
        Time of the run [s]; default: that of the reference.
    dtype : {'float64', 'float32'}
        Number format of a run in fixed steps.

    """

    motion: str
    integrator: str
    step: float
    quantity: str
    bound: float
    duration: float | None = None
    dtype: str = 'float64'


# TheRobotStudio, SO-ARM100, Simulation/SO100/so100.urdf (Apache-2.0): origin and rotation of each
# joint, its axis; mass, centre of mass and moments of inertia of its link.
_SO100 = """
shoulder_pan  0 -0.0452 0.0165   1.57079 0 0  0 1 0
    0.119226  -9.07886e-05 0.0590972 0.031089  5.94278e-05 5.89975e-05 3.13712e-05
shoulder_lift 0 0.1025 0.0306    -1.8 0 0     1 0 0
    0.162409  -1.72052e-05 0.0701802 0.00310545  0.000213312 0.000167164 7.01522e-05
elbow_flex    0 0.11257 0.028    1.57079 0 0  1 0 0
    0.147968  -0.00339604 0.00137796 0.0768007  0.000138803 0.000107748 4.84242e-05
wrist_flex    0 0.0052 0.1349    -1 0 0       1 0 0
    0.0661321 -0.00852653 -0.0352279 -2.34622e-05  3.45403e-05 2.39041e-05 1.94704e-05
wrist_roll    0 -0.0601 0        0 1.57079 0  0 1 0
    0.0929859 0.00552377 -0.0280167 0.000483583  5.03136e-05 4.64098e-05 2.72961e-05
gripper       -0.0202 -0.0244 0  0 3.14158 0  0 0 1
    0.0202444 -0.00161745 -0.0303473 0.000449646  1.11265e-05 8.99651e-06 2.99548e-06
"""


def so100() -> Robot:
    """Return the SO-100, an arm of 0.6 kg, whose jaw has an inertia of 3e-6 kg m^2."""
    words = _SO100.split()
    parts, parent = ['<link name="base"/>'], 'base'
    for at in range(0, len(words), 17):
        name, *numbers = words[at : at + 17]
        origin, turn, axis, center, moments = (
            ' '.join(numbers[k : k + 3]) for k in (0, 3, 6, 10, 13)
        )
        xx, yy, zz = moments.split()
        parts.append(
            f'<link name="{name}_link"><inertial><mass value="{numbers[9]}"/>'
            f'<origin xyz="{center}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" '
            f'iyz="0"/></inertial></link><joint name="{name}" type="continuous">'
            f'<origin xyz="{origin}" rpy="{turn}"/><axis xyz="{axis}"/><parent link="{parent}"/>'
            f'<child link="{name}_link"/></joint>'
        )
        parent = f'{name}_link'
    return load_robot(f'<robot name="so100">{"".join(parts)}</robot>')


def _planar() -> Robot:
    return load_robot('planar2')


def _puma() -> Robot:
    return load_robot('puma560')


def _heavy() -> Robot:
    return heavy_tip(12, 'y').plant.robot


def _start(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values[0])


_REST2, _REST6 = (0.0,) * 2, (0.0,) * 6
_RAISED = (0.125, -0.75, 0.875, 0.25, 0.1875, 0.5)
_HEAVY = heavy_tip(12, 'y').states
# Damping [N m s/rad], with rotor inertia or without, and macro steps, halvings and scheme.
_DAMPED = (
    (1e-2, True, 16, 0, MIDPOINT),
    (1.0, True, 16, 0, MIDPOINT),
    (1e2, True, 20, 10, IMPLICIT),
    (1e4, True, 12, 16, IMPLICIT),
    (1e-2, False, 256, 0, MIDPOINT),
    (1.0, False, 20, 12, IMPLICIT),
    (1e2, False, 20, 20, IMPLICIT),
    (1e4, False, 12, 26, IMPLICIT),
)


def _damped_name(damping: float, rotors: bool) -> str:
    return f'puma560_damped_{damping:g}{"" if rotors else "_no_rotors"}'


MOTIONS: Sequence[Motion] = (
    Motion(
        'planar2_swing',
        'none: a double pendulum',
        _planar,
        Scene(),
        (-1.0, 0.25),
        _REST2,
        4.0,
        128,
    ),
    Motion(
        'planar2_fall',
        'chaotic: a difference grows a million times in ten seconds',
        _planar,
        Scene(),
        _REST2,
        _REST2,
        4.0,
        512,
    ),
    Motion(
        'puma560_fall',
        'none: rotors make the wrist heavy',
        _puma,
        Scene(armature='model'),
        _RAISED,
        _REST6,
        4.0,
        64,
    ),
    Motion(
        'puma560_fall_no_rotors',
        'the light wrist turns at 35 rad/s',
        _puma,
        Scene(),
        _RAISED,
        _REST6,
        1.0,
        64,
    ),
    Motion(
        'so100_fall',
        "a light wrist and jaw: one of three arms with six joints on which Newton's Featherstone "
        'solver diverged within 0.03 to 0.27 s, without contacts or motors '
        '(newton-physics/newton, issue 4269)',
        so100,
        Scene(),
        _REST6,
        _REST6,
        0.125,
        16,
    ),
    Motion(
        'so100_spin',
        'the same motion for longer: the wrist turns at 167 rad/s',
        so100,
        Scene(),
        _REST6,
        _REST6,
        0.5,
        512,
    ),
    Motion(
        'heavy_tip_1e8_planar_n12',
        'formulation stiffness: rounding errors of qdd look like fast motion to an adaptive step',
        _heavy,
        Scene(),
        _start(_HEAVY['q']),
        _start(_HEAVY['qd']),
        0.25,
        128,
    ),
    *(
        Motion(
            _damped_name(damping, rotors),
            'strong damping: explicit steps must be shorter than 3 H / D',
            _puma,
            Scene(damping=(damping,) * 6, armature='model' if rotors else None),
            _RAISED,
            (2.0,) * 6,
            1.0,
            steps,
            halvings,
            way,
        )
        for damping, rotors, steps, halvings, way in _DAMPED
    ),
)

# Bounds were set before these motions were measured, except for the SO-100 and dop853.
CHECKS: Sequence[Check] = (
    *(
        Check(motion, integrator, 1e-3, 'energy', bound, 60.0)
        for motion in ('planar2_swing', 'puma560_fall')
        for integrator, bound in (('velocity_verlet', 2e-5), ('rk4', 1e-9))
    ),
    Check('puma560_fall', 'imex2', 1e-3, 'angle', 3e-5),
    Check('puma560_fall', 'rk4', 1e-3, 'angle', 1e-9),
    *(
        Check(_damped_name(damping, rotors), 'imex2', step, 'angle', bound, dtype=dtype)
        for damping, rotors, *_ in _DAMPED
        for step, bound in ((1e-3, 1e-4), (4e-3, 2e-3))
        for dtype in ('float64', 'float32')
    ),
    Check('so100_fall', 'rk4', 1e-3, 'angle', 1e-8),
    Check('so100_fall', 'rk4', 1e-3, 'energy', 1e-8),
    Check('so100_fall', 'dop853', 1e-12, 'energy', 1e-11),
    Check('so100_spin', 'dop853', 1e-12, 'energy', 1e-11),
    *(
        Check(motion.name, 'dop853', 1e-12, 'angle', 1e-10)
        for motion in MOTIONS
        if motion.way is MIDPOINT
    ),
)


def macro_steps(motion: Motion, steps: int) -> list[Fraction]:
    """Return the lengths [s] of a number of macro steps and the halvings of the first."""
    length = Fraction(motion.duration) / steps
    halved = [length / 2**k for k in range(motion.halvings, 0, -1)]
    first = [halved[0], *halved] if halved else [length]
    return first + [length] * (steps - 1)


def start(motion: Motion) -> tuple[Array, Array]:
    """Return q and qd at the start, (n,)."""
    return np.array(motion.q), np.array(motion.qd)
