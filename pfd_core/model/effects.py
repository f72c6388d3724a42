# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The table of effects: one record for each effect of a scene (EFFECTS).

A record holds the physics of an effect; its fields, with units and checks, are records in
`pfd_core.model.scene_fields`. Methods, quantities, derivatives, energy, the choice of an
integrator, YAML, the parameters of the node, reports and the table in
docs/guides/model-quantities.md are derived from the records. A new effect of a joint is a record
here and one of its field, and a field of Scene. One that acts over a step, as dry friction does
(STEP), also changes pfd_core.simulation.dry, and its law for joints in motion
pfd_core.dynamics.drives.

The effects add to the joint torques of the rigid links:

    tau = tau of links, gravity and wrench
          + viscosity qd + torque(q, qd) + inertia qdd        summed over the effects

torque and potential are functions on lane values. They use the operators of lane values and the
functions of pfd_core.machine.lanes, and are recorded on n lanes (one row for all joints) and on
one processor (one number for each joint). Each joint's torque depends on its own q and qd only,
and a conservative one is the derivative of its potential. `c` holds the numbers of the effect as
constants by the names of the fields: a lane value, or a tuple of them for a field with columns. A
field that refines another is None where it is not given or zero, so that it costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfd_core.forking import no_fork
from pfd_core.model.robot import Robot
from pfd_core.model.scene_fields import FIELDS, Field
from pfd_core.model.values import Array, quote

# Where an effect acts: on the links (in each Newton-Euler recursion), on the joint side of the
# motors, on the motors (pfd_core.dynamics.drives), by brakes, or over a step of time
# (pfd_core.simulation).
LINKS, JOINTS, MOTORS, BRAKES, STEP = 'links', 'joints', 'motors', 'brakes', 'step'
# Two effects of the joints that a plant may keep alone: their numbers multiply qdd, and qd.
INERTIA, VISCOSITY = 'inertia', 'viscosity'

FieldNumbers = Mapping[str, Array | None]  # by field of Scene


@dataclass(frozen=True)
class Effect:
    """
    One effect of a scene.

    Attributes
    ----------
    name, field : str
        Name in tables and on pages, and the field of Scene that switches the effect on.
    refined_by : tuple of str
        Further fields of Scene.
    acts : str
        LINKS, JOINTS, MOTORS, BRAKES or STEP.
    at_rest, inertia : bool
        Whether it exerts a torque at zero velocity, as a function of q; whether the inertia matrix
        depends on it. On the joints the number of `field` multiplies qdd then.
    viscosity : bool
        Whether the number of `field` multiplies qd; integrators may take it implicitly.
    torque, potential : callable or None
        (c, q, qd) -> the resisting torque [N m or N]; (c, q) -> the energy that it stores [J], if
        it is conservative.
    needs : str
        Name of the effect without which it means nothing.
    completed : callable or None
        From a robot and the numbers of all fields, which may differ among arms, to the numbers of
        this effect and of effects that need it; {} if it is off. By default it is off where the
        numbers of its first field are all zero, or infinite if infinity means no limit.

    """

    name: str
    field: str
    acts: str = JOINTS
    refined_by: tuple[str, ...] = ()
    at_rest: bool = False
    inertia: bool = False
    viscosity: bool = False
    torque: Callable[[Any, Any, Any], Any] | None = None
    potential: Callable[[Any, Any], Any] | None = None
    needs: str = ''
    completed: Callable[[Robot, FieldNumbers], FieldNumbers] | None = None

    @property
    def fields(self) -> tuple[Field, ...]:
        """Its fields in Scene: first the field that switches it on, then fields that refine it."""
        return tuple(FIELDS[name] for name in (self.field, *self.refined_by))

    @property
    def kind(self) -> str:
        """Where it acts, or INERTIA or VISCOSITY for such an effect of the joints."""
        if self.acts == JOINTS and self.inertia:
            return INERTIA
        return VISCOSITY if self.viscosity else self.acts

    @property
    def of_joints(self) -> bool:
        """Whether it acts on the joint side of the motors, at an instant or over a step."""
        return self.acts in (JOINTS, STEP)

    def plant_numbers(self, robot: Robot, values: FieldNumbers) -> FieldNumbers:
        """Return the numbers of the effect by field, {} if it is off."""
        if self.completed is not None:
            return self.completed(robot, values)
        acts = _limited if FIELDS[self.field].infinite else _acts
        return {f.name: values[f.name] for f in self.fields} if acts(values[self.field]) else {}


# Numbers of the effects for a robot.


def _acts(values: Array | None) -> bool:
    return values is not None and bool(values.any())


def _limited(values: Array | None) -> bool:
    return values is not None and bool(np.isfinite(values).any())


def _friction(robot: Robot, values: FieldNumbers) -> FieldNumbers:
    """Return Coulomb friction, the friction at rest, and the velocity between them if needed."""
    sliding, resting = values['friction'], values['static_friction']
    if sliding is not None:
        resting = sliding if resting is None else np.where(np.isnan(resting), sliding, resting)
    if sliding is None or resting is None or not (sliding.any() or resting.any()):
        return {}
    below = np.argwhere(resting < sliding).tolist()
    if below:
        low, high = np.broadcast_arrays(sliding, resting)
        *arm, joint = place = tuple(below[0])
        raise ValueError(
            f'static_friction of joint {quote(robot.joint_names[joint])}'
            f'{f" of arm {arm[0]}" if arm else ""} must be at least its friction {low[place]}, '
            f'got {high[place]}'
        )
    speed = values['stribeck_velocity'] if (resting > sliding).any() else None
    return {'friction': sliding, 'static_friction': resting, 'stribeck_velocity': speed}


def _stops(robot: Robot, values: FieldNumbers) -> FieldNumbers:
    """Return lower and upper limits, (n, 2), and the restitution, (n,)."""
    limits = values['joint_limits']
    if limits is None:
        return {}
    for name, (lower, upper) in zip(robot.joint_names, limits.tolist(), strict=True):
        if not lower < upper:
            raise ValueError(
                f'joint_limits of joint {quote(name)} must be a lower limit below an upper one, '
                f'got {lower} and {upper}; lock a joint that cannot move'
            )
    if not _limited(limits):
        return {}
    return {'joint_limits': limits, 'restitution': values['restitution']}


# Cogging: the torque a sin(k q + phase) of magnets or gears that settle k times a turn.
# Fewer periods are a constant torque whose energy overflows; of more, k q loses its digits.
LEAST_PERIODS, MOST_PERIODS = 1e-6, 1e6


def _cogging(robot: Robot, values: FieldNumbers) -> FieldNumbers:
    rows = values['cogging']
    if rows is None or not _acts(rows[:, 0]):
        return {}
    for name, (amplitude, periods, _) in zip(robot.joint_names, rows.tolist(), strict=True):
        if amplitude and not periods:
            raise ValueError(f'periods of cogging of joint {quote(name)} must not be 0')
        if amplitude and not LEAST_PERIODS <= abs(periods) <= MOST_PERIODS:
            raise ValueError(
                f'periods of cogging of joint {quote(name)} must be within {LEAST_PERIODS:g} and '
                f'{MOST_PERIODS:g} a turn, got {periods:g}'
            )
    # A joint without cogging has some period, by which its energy is divided.
    return {'cogging': np.where(rows[:, :1] == 0, (0.0, 1.0, 0.0), rows)}


def _torque_speed(robot: Robot, values: FieldNumbers) -> FieldNumbers:
    return {'torque_speed': values['torque_speed']}


# Torques and energies.


def _stretch(c: Any, q: Any) -> Any:
    return q if c.rest_position is None else q - c.rest_position


def _spring_torque(c: Any, q: Any, qd: Any) -> Any:
    return c.stiffness * _stretch(c, q)


def _spring_energy(c: Any, q: Any) -> Any:
    stretch = _stretch(c, q)
    return (0.5 * c.stiffness * stretch) * stretch


def _cogging_torque(c: Any, q: Any, qd: Any) -> Any:
    with no_fork:
        from pfd_core.machine.lanes import sin

    amplitude, periods, phase = c.cogging
    return amplitude * sin(periods * q + phase)


def _cogging_energy(c: Any, q: Any) -> Any:
    with no_fork:
        from pfd_core.machine.lanes import cos

    amplitude, periods, phase = c.cogging
    return -amplitude / periods * cos(periods * q + phase)


EFFECTS: tuple[Effect, ...] = (
    Effect('gravity', 'gravity', LINKS, at_rest=True),
    Effect('damping', 'damping', viscosity=True),
    Effect('armature', 'armature', inertia=True),
    Effect('payload', 'payload', LINKS, at_rest=True, inertia=True),
    Effect('external wrench', 'external_wrench', LINKS),
    Effect('brakes', 'brakes', BRAKES),
    Effect('friction', 'friction', STEP, completed=_friction),
    Effect('static friction', 'static_friction', STEP, needs='friction'),
    Effect('Stribeck velocity', 'stribeck_velocity', STEP, needs='static friction'),
    Effect('joint stops', 'joint_limits', STEP, completed=_stops),
    Effect('restitution', 'restitution', STEP, needs='joint stops'),
    Effect(
        'springs',
        'stiffness',
        refined_by=('rest_position',),
        at_rest=True,
        torque=_spring_torque,
        potential=_spring_energy,
    ),
    Effect(
        'cogging',
        'cogging',
        at_rest=True,
        torque=_cogging_torque,
        potential=_cogging_energy,
        completed=_cogging,
    ),
    Effect('effort limits', 'effort_limits', MOTORS),
    # A table of zeros is a limit, too: it is never off.
    Effect('torque-speed tables', 'torque_speed', MOTORS, completed=_torque_speed),
    Effect('gravity compensation', 'gravity_compensation', MOTORS, at_rest=True),
    Effect('motor lag', 'motor_lag', STEP),
)
# Field of Scene, and name -> the effect.
EFFECT_OF: Mapping[str, Effect] = {f.name: effect for effect in EFFECTS for f in effect.fields}
NAMED: Mapping[str, Effect] = {effect.name: effect for effect in EFFECTS}
# Field of Scene -> the field without which it means nothing.
NEEDS: Mapping[str, str] = {
    **{name: effect.field for effect in EFFECTS for name in effect.refined_by},
    **{effect.field: NAMED[effect.needs].field for effect in EFFECTS if effect.needs},
}
