# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why joints run away, with the most likely remedy, and the largest stable gains of a PD loop.

A controller reads the state every T seconds and holds its torque -kp q - kd qd until the next
reading. Linearize about a configuration with the inertia matrix H, without delay, damping and
friction. Let the gains be proportional to a diagonal D: kp = p D and kd = d D. The loop then
separates into one sampled loop for each mode of the pair (H, D); its inertia m is an eigenvalue of
D^-1 H. With a = p T^2 / (2 m) and b = d T / m its characteristic polynomial is
z^2 - (2 - a - b) z + (1 + a - b). Its roots lie inside the unit circle if, and only if,

    0 < a < b < 2,   that is   p / d < 2 / T   and   d < 2 m / T

(criterion of Jury). So the mode with the least inertia sets the bounds. Its inertia is far below
the joint inertias, since a torque at one joint accelerates the others too. Without rotors the last
joints of an arm have an inertia of only 1e-4 kg m^2; a real arm has the rotor of a geared motor
there. So the most likely cause of a joint that runs away is missing rotor inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.actuators import speed_limits
from pfd_ros.arm.plant_settings import ESTIMATED
from pfd_ros.messages.joints import JOINT_UNITS
from pfd_ros.text import cut

# Multiple of the velocity limit beyond every intended motion. Under the torque-speed limit, which
# is on by default, a joint that oscillates at full effort comes close to 2 and never above.
RUNAWAY = 1.5
# With fewer commands no controller answers the states. With more it is not known whether one does:
# the same torque may be published again and again.
FEWEST_COMMANDS = 10


def stated(robot: pfd.Robot) -> dict[str, bool]:
    """Return for each effect that a model may have numbers for whether it has, zeros apart."""
    return {
        x.field: len(x.unstated(robot)) < robot.n and bool(x.of_model(robot).any())
        for x in pfd.EFFECTS
        if x.from_model
    }


class GainLimits(NamedTuple):
    """Bounds of stable gains; beyond any of them the loop diverges."""

    # Of kp / kd, 1/s.
    ratio: float
    # Of kd (n,), N m s/rad or N s/m, if all joints have the same share of their bounds.
    velocity: NDArray[Any]
    # Of kp (n,), N m/rad or N/m, which are reached only with kd close to its bound.
    position: NDArray[Any]
    # Of kd, if it is the same number for each joint.
    equal_velocity: float


def gain_limits(inertia: NDArray[Any], period: float) -> GainLimits:
    """Return the bounds of a PD loop with the inertia matrix H (n, n), kg m^2 or kg.

    `period` is the time from one reading of the state to the next, T, s. LinAlgError if the
    matrix is not finite and positive definite.
    """
    if not np.isfinite(inertia).all():
        raise np.linalg.LinAlgError('the inertia matrix is not finite')
    np.linalg.cholesky(inertia)
    diagonal = np.diagonal(inertia)
    scale = 1.0 / np.sqrt(diagonal)
    # 1 without coupling, close to 0 where the joints throw each other about.
    share = np.linalg.eigvalsh(scale[:, None] * inertia * scale)[0]
    velocity = 2.0 * share * diagonal / period
    equal = float(2.0 * np.linalg.eigvalsh(inertia)[0] / period)
    return GainLimits(2.0 / period, velocity, 2.0 / period * velocity, equal)


class Speeding(NamedTuple):
    """The joint that was the farthest beyond its velocity limit."""

    # Its largest speed as a multiple of the limit.
    ratio: float
    # One line with the remedy.
    text: str

    @property
    def runaway(self) -> bool:
        """Whether no motor drives a joint that fast."""
        return self.ratio >= RUNAWAY


def speeding(
    robot: pfd.Robot,
    scene: pfd.Scene,
    peaks: Sequence[float],
    *,
    commands: int = FEWEST_COMMANDS,
    from_file: bool = False,
) -> Speeding | None:
    """Return the joint that was farthest beyond its velocity limit, if one was.

    `peaks` are the largest speeds of the joints as multiples of their limits, (n,) in model order,
    0 for a joint that kept it, and `commands` are how many came. A remedy for a scene `from_file`
    is written into that file.
    """
    ratio = max(peaks)
    if not ratio:
        return None
    joint = list(peaks).index(ratio)
    name, limit = cut(robot.joint_names[joint]), float(speed_limits(robot)[joint])
    unit = JOINT_UNITS['velocity'][robot.joint_types[joint] == 'prismatic']
    found = f'{name} at {ratio * limit:.3g} {unit}, limit {limit:.3g} {unit}'
    if robot.velocity_limit[joint] != limit:
        found += ' (assumed, the model has none)'
    remedy = 'a real arm would stop with a fault; move slower'
    if commands < FEWEST_COMMANDS:
        came = f'{commands} command{"s" * (commands != 1)} came, so a constant torque drives it'
        remedy = came + _constant_remedy(robot, scene, joint, from_file)
    elif ratio >= RUNAWAY:
        remedy = _rotor_remedy(robot, scene, joint, from_file)
    return Speeding(ratio, f'{found}: {remedy}')


def _acts(robot: pfd.Robot, scene: pfd.Scene, name: str, joint: int) -> bool:
    """Return whether an effect of a scene acts on a joint."""
    (effect,) = (x for x in pfd.EFFECTS if x.field == name)
    acting = effect.resolved(robot, getattr(scene, name))
    return acting is not None and bool(np.any(acting[joint]))


def _constant_remedy(robot: pfd.Robot, scene: pfd.Scene, joint: int, from_file: bool) -> str:
    name = robot.joint_names[joint]
    stated = 'friction' not in robot.silent or name not in robot.silent['friction']
    ends = np.isfinite([robot.position_lower[joint], robot.position_upper[joint]]).all()
    missing = {}
    if not _acts(robot, scene, 'friction', joint):
        missing['friction'] = '-p friction:=true' if stated else f'-p friction.{name}:=1.0'
    if ends and not _acts(robot, scene, 'joint_limits', joint):
        missing['stops'] = '-p joint_limits:=true'
    if not missing:
        return '; no controller answers the states'
    text = f', with no {" or ".join(missing)} in this scene'
    return text if from_file else f'{text}: {" ".join(missing.values())}'


def _rotor_remedy(robot: pfd.Robot, scene: pfd.Scene, joint: int, from_file: bool) -> str:
    if _acts(robot, scene, 'armature', joint):
        return 'lower the gains; /diagnostics shows the largest stable ones'
    stated = bool(robot.armature[joint])
    if from_file:
        word = 'model' if stated else ESTIMATED
        return f'no rotor inertia in this scene? Write armature: {word} into the scene file'
    if not pfd.estimated_armature(robot)[joint]:
        return f'no rotor inertia in this model? -p armature.{robot.joint_names[joint]}:=0.1'
    return f'no rotor inertia in this model? -p armature:={"true" if stated else ESTIMATED}'


def estimate_text(robot: pfd.Robot) -> str:
    """Return one line about the rotor inertias of `armature:=estimated`, and joints without."""
    numbers = pfd.estimated_armature(robot)
    inertias = ', '.join(
        f'{cut(name)} {number:.3g}'
        for name, number in zip(robot.joint_names, numbers.tolist(), strict=True)
    )
    text = (
        f'armature is estimated, kg m^2 or kg: {inertias} (from effort '
        'and velocity limits, where the model states no rotor inertia)'
    )
    if np.all(numbers > 0):
        return text
    return f'{text}; joints with 0 have no limits in the model: set armature.<joint> for them'
