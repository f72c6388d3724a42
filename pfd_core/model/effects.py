# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The table of effects: one record for each effect of a scene (EFFECTS).

A record holds the fields of the effect in Scene, with units and checks, and its physics. Methods,
quantities, derivatives, energy, the choice of an integrator, YAML, the parameters of the node,
reports and the table in docs/guides/model-quantities.md are derived from the records. A new effect
of a joint is a record here and a field of Scene with the record's name for it. One that acts over
a step, as dry friction does (STEP), also changes pfd_core.simulation.contact.modes, and its law
for joints in motion pfd_core.algorithms.chain.drives.

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
import math
from typing import Any

import numpy as np

from pfd_core.machine.lanes import cos, sin
from pfd_core.model.robot import Robot
from pfd_core.model.rotors import estimated_armature
from pfd_core.model.scene_checks import (
    ESTIMATED,
    MODEL,
    Rule,
    payload,
    per_joint,
    restitution,
    torque_speed,
)
from pfd_core.model.values import LARGEST, Array, quote, quote_all, real_array, switch

# Where an effect acts: on the links (in each Newton-Euler recursion), on the joint side of the
# motors, on the motors (pfd_core.algorithms.chain.drives), by brakes, or over a step of time
# (pfd_core.simulation).
LINKS, JOINTS, MOTORS, BRAKES, STEP = 'links', 'joints', 'motors', 'brakes', 'step'
# Multiple of its velocity limit at which a motor of the model drives its joint along no more. Up
# to the limit it gives its full effort; docs/decisions/0032-one-table-of-effects.md.
NO_EFFORT = 2.0

Numbers = Mapping[str, Array | None]  # by field of Scene


@dataclass(frozen=True)
class Field:
    """
    A field of Scene.

    Attributes
    ----------
    name : str
        Its name in Scene, in scene files and of the parameter of the node.
    text : str
        What it holds, in a few words.
    unit, sliding_unit : str
        Units for joints that turn and for joints that slide; empty without one. Those of columns
        are separated by commas.
    rule : Rule or None
        What it may hold, if it has one number or one row a joint.
    check : callable or None
        From its name and the value that a user gives to the value that Scene keeps; by default the
        function of the rule. None without a rule: Scene checks it.
    numbers : callable or None
        From a robot and the value in Scene to an array; by default from the rule.
    off : Any
        The value without the effect.
    most : float
        Largest number that a parameter of the node may have.

    """

    name: str
    text: str
    unit: str = ''
    sliding_unit: str = ''
    rule: Rule | None = None
    check: Callable[[str, Any], Any] | None = None
    numbers: Callable[[Robot, Any], Array | None] | None = None
    off: Any = None
    most: float = 1e6

    @property
    def has_numbers(self) -> bool:
        """Whether a plant has the numbers of the field, one or more for each joint."""
        return self.rule is not None or self.numbers is not None

    def units(self, column: int = 0) -> str:
        """Return the units of a number: for joints that turn, and for joints that slide."""
        both = (text.split(', ')[column] for text in (self.unit, self.sliding_unit) if text)
        return ' or '.join(dict.fromkeys(both))

    def checked(self, value: Any) -> Any:
        """Return the value of a user as Scene keeps it; ValueError names the field."""
        if self.rule is not None:
            return per_joint(self.name, value, self.rule)
        return value if self.check is None else self.check(self.name, value)

    def resolved(self, robot: Robot, value: Any) -> Array | None:
        """Return the value in a scene as numbers for a robot; None without the effect."""
        if value is None or not self.has_numbers:
            return None
        if self.numbers is not None:
            return self.numbers(robot, value)
        assert self.rule is not None
        if isinstance(value, str):
            return estimated_armature(robot) if value == ESTIMATED else self.rule.of_model(robot)
        check_count(robot, self.name, value)
        return np.asarray(value, dtype=np.float64)


@dataclass(frozen=True)
class Effect:
    """
    One effect of a scene.

    Attributes
    ----------
    name : str
        Name in tables and on pages.
    fields : tuple of Field
        Its fields in Scene: first the field that switches it on, then fields that refine it.
    acts : str
        LINKS, JOINTS, MOTORS, BRAKES or STEP.
    at_rest : bool
        Whether it exerts a torque at zero velocity, as a function of q.
    inertia : bool
        Whether the inertia matrix depends on it. On the joints the number of its first field
        multiplies qdd.
    viscosity : bool
        Whether the number of its first field multiplies qd; integrators may take it implicitly.
    torque : callable or None
        (c, q, qd) -> the resisting torque [N m or N].
    potential : callable or None
        (c, q) -> the energy that it stores [J], if it is conservative.
    needs : str
        Name of the effect without which it means nothing.
    completed : callable or None
        From a robot and the numbers of all fields to the numbers of this effect and of effects
        that need it; {} if it is off. By default it is off where the numbers of its first field
        are all zero, or infinite if infinity means no limit.

    """

    name: str
    fields: tuple[Field, ...]
    acts: str = JOINTS
    at_rest: bool = False
    inertia: bool = False
    viscosity: bool = False
    torque: Callable[[Any, Any, Any], Any] | None = None
    potential: Callable[[Any, Any], Any] | None = None
    needs: str = ''
    completed: Callable[[Robot, Numbers], Numbers] | None = None

    @property
    def of_joints(self) -> bool:
        """Whether it acts on the joint side of the motors, at an instant or over a step."""
        return self.acts in (JOINTS, STEP)

    @property
    def from_model(self) -> bool:
        """Whether the model of a robot may state the effect."""
        rule = self.fields[0].rule
        return rule is not None and rule.model is not None

    @property
    def field(self) -> str:
        """Name of the field of Scene that switches the effect on."""
        return self.fields[0].name

    def plant_numbers(self, robot: Robot, values: Numbers) -> Numbers:
        """Return the numbers of the effect by field, {} if it is off."""
        if self.completed is not None:
            return self.completed(robot, values)
        own = values[self.field]
        rule = self.fields[0].rule
        off = not _limited(own) if rule is not None and rule.infinite else not _acts(own)
        return {} if off else {field.name: values[field.name] for field in self.fields}


def check_count(robot: Robot, key: str, rows: Any, noun: str = 'numbers') -> None:
    """Raise ValueError unless a field of a scene has one entry for each joint of a robot."""
    if len(rows) != robot.n:
        noun = 'rows' if noun == 'numbers' and np.ndim(rows) > 1 else noun
        raise ValueError(
            f'{key} of the scene has {len(rows)} {noun}, but {quote(robot.name)} has '
            f'{robot.n} joints: {quote_all(robot.joint_names)}'
        )


def _acts(values: Array | None) -> bool:
    """Return whether a number is not zero; of rows the first number decides."""
    return values is not None and bool((values if values.ndim == 1 else values[:, 0]).any())


def _limited(values: Array | None) -> bool:
    return values is not None and bool(np.isfinite(values).any())


# Friction and stops, which pfd_core.simulation.contact simulates.


def _friction(robot: Robot, values: Numbers) -> Numbers:
    """Return Coulomb friction, the friction at rest, and the velocity between them if needed."""
    sliding, resting = values['friction'], values['static_friction']
    resting = sliding if resting is None else resting
    if sliding is None or resting is None or not (sliding.any() or resting.any()):
        return {}
    for name, low, high in zip(robot.joint_names, sliding.tolist(), resting.tolist(), strict=True):
        if high < low:
            raise ValueError(
                f'static_friction of joint {quote(name)} must be at least its friction {low}, '
                f'got {high}'
            )
    falling = (resting > sliding).any()
    return {
        'friction': sliding,
        'static_friction': resting,
        'stribeck_velocity': values['stribeck_velocity'] if falling else None,
    }


def _stops(robot: Robot, values: Numbers) -> Numbers:
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


def _restitution(robot: Robot, value: Any) -> Array:
    if isinstance(value, float):
        return np.full(robot.n, value)
    check_count(robot, 'restitution', value)
    return np.asarray(value, dtype=np.float64)


# Springs.


def _stretch(c: Any, q: Any) -> Any:
    return q if c.rest_position is None else q - c.rest_position


def _spring_torque(c: Any, q: Any, qd: Any) -> Any:
    return c.stiffness * _stretch(c, q)


def _spring_energy(c: Any, q: Any) -> Any:
    stretch = _stretch(c, q)
    return (0.5 * c.stiffness * stretch) * stretch


# Cogging: the torque a sin(k q + phase) of magnets or gears that settle k times a turn.
# Fewer periods are a constant torque whose energy overflows; of more, k q loses its digits.
LEAST_PERIODS, MOST_PERIODS = 1e-6, 1e6


def _cogging(robot: Robot, values: Numbers) -> Numbers:
    rows = values['cogging']
    if rows is None or not _acts(rows):
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
    idle = rows[:, :1] == 0
    return {'cogging': np.where(idle, (0.0, 1.0, 0.0), rows)}


def _cogging_torque(c: Any, q: Any, qd: Any) -> Any:
    amplitude, periods, phase = c.cogging
    return amplitude * sin(periods * q + phase)


def _cogging_energy(c: Any, q: Any) -> Any:
    amplitude, periods, phase = c.cogging
    return -amplitude / periods * cos(periods * q + phase)


# Limits of the motors.


def _torque_speed(robot: Robot, value: Any) -> Array | None:
    """Return the tables of all joints with the rows of the longest, (n, k, 2)."""
    tables: Any = _model_tables(robot) if isinstance(value, str) else value
    check_count(robot, 'torque_speed', tables, 'tables')
    longest = max(len(table or ()) for table in tables)
    if not longest:
        return None
    rows = np.full((robot.n, longest, 2), np.inf)
    for i, table in enumerate(tables):
        if table is not None:
            rows[i, : len(table)] = table
            rows[i, len(table) :, 1] = table[-1][1]
    return rows


def _model_tables(robot: Robot) -> list[list[tuple[float, float]] | None]:
    """Return tables that fall from effort limits beyond velocity limits; None without one."""
    tables: list[list[tuple[float, float]] | None] = []
    for name, speed, torque in zip(
        robot.joint_names, robot.velocity_limit.tolist(), robot.effort_limit.tolist(), strict=True
    ):
        limited = np.isfinite([speed, torque]).all()
        if limited and not speed < NO_EFFORT * speed:
            raise ValueError(
                f'torque_speed {MODEL!r} needs velocity limits above zero, joint {quote(name)} '
                f'has {speed}'
            )
        tables.append([(speed, torque), (NO_EFFORT * speed, 0.0)] if limited else None)
    return tables


# A table of zeros is a limit, too: it is never off.
def _as_given(robot: Robot, values: Numbers) -> Numbers:
    return {'torque_speed': values['torque_speed']}


def _gravity(key: str, value: Any) -> tuple[float, ...] | None:
    if value is None:
        return None
    gravity = real_array(key, value, shape=(3,), largest=LARGEST)
    return tuple((gravity + 0.0).tolist())


EFFECTS: tuple[Effect, ...] = (
    Effect(
        'gravity',
        (Field('gravity', 'Acceleration of free fall, base frame', 'm/s^2', check=_gravity),),
        acts=LINKS,
        at_rest=True,
    ),
    Effect(
        'damping',
        (
            Field(
                'damping',
                'Viscous damping of the joint',
                'N m s/rad',
                'N s/m',
                Rule('damping'),
            ),
        ),
        viscosity=True,
    ),
    Effect(
        'armature',
        (
            Field(
                'armature',
                'Rotor inertia of the joint times the square of its gear ratio',
                'kg m^2',
                'kg',
                Rule('armature', estimated=True),
            ),
        ),
        inertia=True,
    ),
    Effect(
        'payload',
        (Field('payload', 'A body held by the last link', check=payload),),
        acts=LINKS,
        at_rest=True,
        inertia=True,
    ),
    Effect(
        'external wrench',
        (
            Field(
                'external_wrench', 'Wrench on the last link as an input', check=switch, off=False
            ),
        ),
        acts=LINKS,
    ),
    Effect(
        'brakes',
        (Field('brakes', 'Joints that can be braked at run time', check=switch, off=False),),
        acts=BRAKES,
    ),
    Effect(
        'friction',
        (
            Field(
                'friction',
                'Coulomb friction of the joint',
                'N m',
                'N',
                Rule('friction'),
            ),
        ),
        acts=STEP,
        completed=_friction,
    ),
    Effect(
        'static friction',
        (Field('static_friction', 'Friction that a resting joint can hold', 'N m', 'N', Rule()),),
        acts=STEP,
        needs='friction',
    ),
    Effect(
        'Stribeck velocity',
        (
            Field(
                'stribeck_velocity',
                'Velocity at which static friction has fallen half-way to Coulomb friction',
                'rad/s',
                'm/s',
                Rule(above=True),
            ),
        ),
        acts=STEP,
        needs='static friction',
    ),
    Effect(
        'joint stops',
        (
            Field(
                'joint_limits',
                'Stops at the position limits of the joint',
                'rad',
                'm',
                Rule(
                    ('position_lower', 'position_upper'),
                    least=-math.inf,
                    infinite=True,
                    columns=('lower', 'upper'),
                    row='a lower and an upper limit a joint',
                ),
            ),
        ),
        acts=STEP,
        completed=_stops,
    ),
    Effect(
        'restitution',
        (
            Field(
                'restitution',
                'Share of its velocity that a joint keeps when it bounces off its stop',
                check=restitution,
                numbers=_restitution,
                off=0.0,
                most=1.0,
            ),
        ),
        acts=STEP,
        needs='joint stops',
    ),
    Effect(
        'springs',
        (
            Field('stiffness', 'Stiffness of the spring of the joint', 'N m/rad', 'N/m', Rule()),
            Field(
                'rest_position',
                'Position at which the spring of the joint is slack',
                'rad',
                'm',
                Rule(least=-math.inf),
            ),
        ),
        at_rest=True,
        torque=_spring_torque,
        potential=_spring_energy,
    ),
    Effect(
        'cogging',
        (
            Field(
                'cogging',
                'Torque of the joint that goes through some periods a turn',
                'N m, 1/turn, rad',
                'N, 1/(2 pi m), rad',
                Rule(
                    least=-math.inf,
                    columns=('amplitude', 'periods', 'phase'),
                    row='an amplitude, periods a turn and a phase a joint',
                ),
            ),
        ),
        at_rest=True,
        torque=_cogging_torque,
        potential=_cogging_energy,
        completed=_cogging,
    ),
    Effect(
        'effort limits',
        (
            Field(
                'effort_limits',
                'Largest torque of the motor',
                'N m',
                'N',
                Rule('effort_limit', infinite=True),
            ),
        ),
        acts=MOTORS,
    ),
    Effect(
        'torque-speed tables',
        (
            Field(
                'torque_speed',
                'Largest driving torque of the motor by speed',
                'rad/s, N m',
                'm/s, N',
                check=torque_speed,
                numbers=_torque_speed,
            ),
        ),
        acts=MOTORS,
        completed=_as_given,
    ),
    Effect(
        'gravity compensation',
        (
            Field(
                'gravity_compensation', 'Gravity torques of a model that the drives add', off=False
            ),
        ),
        acts=MOTORS,
        at_rest=True,
    ),
    Effect(
        'motor lag',
        (
            Field(
                'motor_lag',
                'Time constant with which the motor of the joint follows its effort',
                's',
                's',
                Rule(),
                most=10.0,
            ),
        ),
        acts=STEP,
    ),
)
# Field of Scene -> its record.
FIELDS: Mapping[str, Field] = {field.name: field for effect in EFFECTS for field in effect.fields}
# Name -> the effect.
NAMED: Mapping[str, Effect] = {effect.name: effect for effect in EFFECTS}
# Field of Scene -> the field without which it means nothing.
NEEDS: Mapping[str, str] = {
    **{field.name: effect.field for effect in EFFECTS for field in effect.fields[1:]},
    **{effect.field: NAMED[effect.needs].field for effect in EFFECTS if effect.needs},
}
