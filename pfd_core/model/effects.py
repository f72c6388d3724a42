# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The table of effects: one record for each effect of a scene (EFFECTS).

A record holds the fields of the effect in Scene, with units and checks, and its physics. Methods,
quantities, derivatives, energy, the choice of an integrator, YAML, the parameters of the node,
reports and the table in docs/guides/model-quantities.md are derived from the records. A new effect
of a joint is a record here and a field of Scene with the record's name for it. One that acts over
a step, as dry friction does (STEP), also changes pfd_core.simulation.contact.modes, and its law
for joints in motion pfd_core.dynamics.drives.

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
import warnings

import numpy as np

from pfd_core.machine.lanes import cos, sin
from pfd_core.model.robot import LIMIT_FIELDS, Payload, PhysicsWarning, Robot, unstated
from pfd_core.model.rotors import estimated_armature
from pfd_core.model.values import (
    LARGEST,
    Array,
    quote,
    quote_all,
    real_array,
    switch,
)

# Where an effect acts: on the links (in each Newton-Euler recursion), on the joint side of the
# motors, on the motors (pfd_core.dynamics.drives), by brakes, or over a step of time
# (pfd_core.simulation).
LINKS, JOINTS, MOTORS, BRAKES, STEP = 'links', 'joints', 'motors', 'brakes', 'step'
# Two effects of the joints that a plant may keep alone: their numbers multiply qdd, and qd.
INERTIA, VISCOSITY = 'inertia', 'viscosity'
# Words for numbers in place of numbers: the robot's own, an estimate, and values at run time.
MODEL, ESTIMATED, INPUT = 'model', 'estimated', 'input'
# What a field of Scene holds: one number, or one row of numbers, a joint; acceleration of free
# fall; True or False; one number for all joints or one a joint, from 0 to 1; a table a joint; a
# Payload; and the gravity that the drives compensate, which Scene checks.
PER_JOINT, VECTOR, SWITCH, SHARE = 'per joint', 'vector', 'switch', 'share'
TABLES, PAYLOAD, COMPENSATION = 'tables', 'payload', 'compensation'
# Multiple of its velocity limit at which a motor of the model drives its joint along no more. Up
# to the limit it gives its full effort; docs/decisions/0032-one-table-of-effects.md.
NO_EFFORT = 2.0

Numbers = Mapping[str, Array | None]  # by field of Scene


@dataclass(frozen=True)
class Field:
    """A field of Scene, and of the parameters of the node."""

    name: str
    text: str  # what it holds, in a few words
    # Units for joints that turn and that slide, '' without one; of columns separated by commas.
    unit: str = ''
    sliding_unit: str = ''
    kind: str = PER_JOINT
    model: str | tuple[str, ...] = ()  # field of Robot for "model", or one for each column
    estimated: bool = False  # whether "estimated" means numbers from the robot's limits
    columns: tuple[str, ...] = ()  # names of the numbers of a row; () for one number a joint
    least: float = 0.0
    above: bool = False  # whether the least number is excluded
    infinite: bool = False  # whether infinity is allowed, for a joint without a limit
    off: Any = None  # the value without the effect
    most: float = 1e6  # largest number that a parameter of the node may have

    @property
    def has_numbers(self) -> bool:
        """Whether a plant has the numbers of the field, one or more for each joint."""
        return self.kind in (PER_JOINT, SHARE, TABLES)

    @property
    def from_model(self) -> bool:
        """Whether the model of a robot may state one number or row a joint."""
        return self.kind == PER_JOINT and bool(self.model)

    @property
    def words(self) -> tuple[str, ...]:
        """The words that may take the place of numbers."""
        return (MODEL,) * bool(self.model) + (ESTIMATED,) * self.estimated

    def units(self, column: int = 0) -> str:
        """Return the units of a number: for joints that turn, and for joints that slide."""
        both = (text.split(', ')[column] for text in (self.unit, self.sliding_unit) if text)
        return ' or '.join(dict.fromkeys(both))

    def checked(self, value: Any) -> Any:
        """
        Return a user's value as None, a word, bool, float or tuples; ValueError names it.

        Of a mapping of joints to numbers, rows or tables they are pairs, in the order of names.
        """
        if not self.has_numbers or not (isinstance(value, Mapping) or _is_by_joint(value)):
            return _CHECKS[self.kind](self, value)
        given = dict(value)
        if not all(isinstance(joint, str) for joint in given):
            raise ValueError(f'{self.name} must have names of joints as keys, got {quote(value)}')
        joints = sorted(given)
        checked = _CHECKS[self.kind](self, [given[joint] for joint in joints])
        return tuple(zip(joints, checked, strict=True)) or self.off

    def of_model(self, robot: Robot) -> Array:
        """Return the numbers of a robot's model, (n,) or (n, columns)."""
        if isinstance(self.model, str):
            numbers: Array = getattr(robot, self.model)
            return numbers
        return np.stack([getattr(robot, name) for name in self.model], axis=1)

    def resolved(self, robot: Robot, value: Any) -> Array | None:
        """Return the value in a scene as numbers for a robot; None without the effect."""
        if value is None or not self.has_numbers:
            return None
        if isinstance(value, str) and value == MODEL:
            self._check_stated(robot)
        elif _is_by_joint(value):
            value = self._of_all_joints(robot, dict(value))
        if self.kind == TABLES:
            return _table_rows(robot, _model_tables(robot) if value == MODEL else value)
        if isinstance(value, str):
            return estimated_armature(robot) if value == ESTIMATED else self.of_model(robot)
        if isinstance(value, float):
            return np.full(robot.n, value)
        check_count(robot, self.name, value)
        return np.asarray(value, dtype=np.float64)

    @property
    def _of_robot(self) -> set[str]:
        """The fields of Robot that "model" selects."""
        return {self.model} if isinstance(self.model, str) else set(self.model)

    def unstated(self, robot: Robot) -> list[str]:
        """Return the joints for which the model of a robot states no value of the field."""
        keys = self._of_robot
        # One end may be all that a joint is limited by; a motor has a torque and a speed, or none.
        enough = 1 if self.kind == TABLES else len(keys)
        found = [j for j in robot.joint_names if len(keys & unstated(robot, j)) >= enough]
        return found if self.name != 'joint_limits' else _without_continuous(robot, found)

    def _check_stated(self, robot: Robot) -> None:
        """Raise ValueError if the model states nothing; warn if it does for some joints only."""
        silent = self.unstated(robot)
        cure = f'give values by joint, {self.name}={{{quote((silent or [""])[0])}: ...}}'
        if self.estimated:
            cure += f', or {ESTIMATED!r}'
        if len(silent) == robot.n:
            raise ValueError(
                f'{self.name} is {MODEL!r}, but the model of {quote(robot.name)} states none for '
                f'any joint: {cure}'
            )
        if self._of_robot & set(LIMIT_FIELDS.values()):
            silent = _without_continuous(robot, silent)
        if silent:
            warnings.warn(
                f'{self.name} is {MODEL!r}, but the model of {quote(robot.name)} states none for '
                f'{quote_all(silent)}, which have none: {cure}',
                PhysicsWarning,
                stacklevel=2,
            )

    def _of_all_joints(self, robot: Robot, given: Mapping[str, Any]) -> list[Any]:
        """Return values by joint as a list, with nothing, or no limit, for all other joints."""
        label = f'{self.name} of the scene'
        for joint in given:
            if joint not in robot.joint_names:
                raise ValueError(
                    f'{label} names joint {quote(joint)}, but {quote(robot.name)} has '
                    f'{quote_all(robot.joint_names)}'
                )
        if self.above and len(given) < robot.n:
            missing = [joint for joint in robot.joint_names if joint not in given]
            raise ValueError(f'{label} must have a value for each joint, not {quote_all(missing)}')
        none: Any = math.inf if self.infinite else 0.0
        if self.columns:
            none = (-none, none) if self.infinite else (none,) * len(self.columns)
        if self.kind == TABLES:
            none = None
        return [given.get(joint, none) for joint in robot.joint_names]


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
        From a robot and the numbers of all fields to the numbers of this effect and of effects
        that need it; {} if it is off. By default it is off where the numbers of its first field
        are all zero, or infinite if infinity means no limit.

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
    completed: Callable[[Robot, Numbers], Numbers] | None = None

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

    def plant_numbers(self, robot: Robot, values: Numbers) -> Numbers:
        """Return the numbers of the effect by field, {} if it is off."""
        if self.completed is not None:
            return self.completed(robot, values)
        acts = _limited if FIELDS[self.field].infinite else _acts
        return {f.name: values[f.name] for f in self.fields} if acts(values[self.field]) else {}


def by_joint(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return values by field, with `friction.elbow_joint` for one joint as friction of that joint.

    ValueError if a field is given for one joint and for all.
    """
    found: dict[str, Any] = {}
    for key, value in values.items():
        name, dot, joint = key.partition('.')
        if not dot or name not in FIELDS or not FIELDS[name].has_numbers:
            name, value = key, dict(value) if isinstance(value, Mapping) else value
            joint = ''
        if name in found and not (joint and isinstance(found[name], dict)):
            raise ValueError(f'{name} is given for all joints and for one: use one of them')
        if joint:
            found.setdefault(name, {})[joint] = value
        else:
            found[name] = value
    return found


def _is_by_joint(value: Any) -> bool:
    """Return whether a value is pairs of a joint and its value, as Scene keeps a mapping."""
    if not isinstance(value, tuple) or not value:
        return False
    return all(isinstance(x, tuple) and len(x) == 2 and isinstance(x[0], str) for x in value)


def _without_continuous(robot: Robot, joints: list[str]) -> list[str]:
    kinds = dict(zip(robot.joint_names, robot.joint_types, strict=True))
    return [joint for joint in joints if kinds[joint] != 'continuous']


def check_count(robot: Robot, key: str, rows: Any, noun: str = 'numbers') -> None:
    """Raise ValueError unless a field of a scene has one entry for each joint of a robot."""
    if len(rows) != robot.n:
        noun = 'rows' if noun == 'numbers' and np.ndim(rows) > 1 else noun
        raise ValueError(
            f'{key} of the scene has {len(rows)} {noun}, but {quote(robot.name)} has '
            f'{robot.n} joints: {quote_all(robot.joint_names)}'
        )


# The checks of a field, by its kind.


def _vector(field: Field, value: Any) -> Any:
    if value is None:
        return None
    return tuple((real_array(field.name, value, shape=(3,), largest=LARGEST) + 0.0).tolist())


def _payload(field: Field, value: Any) -> Any:
    if value is None or isinstance(value, Payload) or (isinstance(value, str) and value == INPUT):
        return value
    raise ValueError(f'{field.name} must be a Payload, {INPUT!r} or None, got {quote(value)}')


def _is_list(value: Any) -> bool:
    """Return whether a value has a length; not so a string or a type of NumPy."""
    try:
        return not isinstance(value, (str, np.dtype)) and len(value) >= 0
    except TypeError:
        return False


def _per_joint(field: Field, value: Any) -> Any:
    key, columns = field.name, field.columns
    if value is None or (isinstance(value, str) and value in field.words):
        return value
    if not _is_list(value):
        words = ''.join(f', {word!r}' for word in field.words)
        row = f'one row ({", ".join(columns)})' if columns else 'one number'
        raise ValueError(f'{key} must be None{words} or {row} per joint, got {quote(value)}')
    shape = ('n', len(columns)) if columns else (len(value),)
    largest = math.inf if field.infinite else LARGEST
    array = real_array(key, value, shape=shape, finite=not field.infinite, largest=largest) + 0.0
    if not (np.isinf(array) | (np.abs(array) <= LARGEST)).all():
        raise ValueError(
            f'{key} must be at most {LARGEST:g} in size, or infinite, got {quote(array.tolist())}'
        )
    if field.above and (array <= field.least).any():
        raise ValueError(f'{key} must be above {field.least:g}, got {quote(array.tolist())}')
    if (array < field.least).any():
        raise ValueError(f'{key} must not be negative, got {quote(array.tolist())}')
    return tuple(map(tuple, array.tolist())) if columns else tuple(array.tolist())


def _share(field: Field, value: Any) -> Any:
    single = not _is_list(value)
    array = real_array(field.name, value, shape=() if single else (len(value),)) + 0.0
    if (array < 0).any() or (array > 1).any():
        raise ValueError(f'{field.name} must be from 0 to 1, got {quote(array.tolist())}')
    return float(array) if single else tuple(array.tolist())


def _tables(field: Field, value: Any) -> Any:
    if value is None or (isinstance(value, str) and value in field.words):
        return value
    if not _is_list(value):
        raise ValueError(
            f'{field.name} must be None, {MODEL!r} or one table a joint with rows (speed, torque),'
            f' got {quote(value)}'
        )
    return tuple(_table(f'{field.name} of joint {i + 1}', rows) for i, rows in enumerate(value))


def _table(label: str, rows: Any) -> tuple[tuple[float, ...], ...] | None:
    """Return the table of one joint, whose speeds rise and whose torques do not."""
    if rows is None:
        return None
    array = real_array(label, rows, shape=('k', 2), largest=LARGEST) + 0.0
    speeds, torques = array.T
    if not len(array):
        raise ValueError(f'{label} must have at least one row, or be None')
    if (array < 0).any():
        raise ValueError(f'{label} must not be negative, got {quote(array.tolist())}')
    if (np.diff(speeds) <= 0).any():
        raise ValueError(f'speeds of {label} must rise, got {quote(speeds.tolist())}')
    if (np.diff(torques) > 0).any():
        raise ValueError(f'torques of {label} must not rise, got {quote(torques.tolist())}')
    return tuple(map(tuple, array.tolist()))


_CHECKS: Mapping[str, Callable[[Field, Any], Any]] = {
    PER_JOINT: _per_joint,
    VECTOR: _vector,
    SWITCH: lambda field, value: switch(field.name, value),
    SHARE: _share,
    TABLES: _tables,
    PAYLOAD: _payload,
    COMPENSATION: lambda field, value: value,
}


# Numbers of the effects for a robot.


def _acts(values: Array | None) -> bool:
    """Return whether a number is not zero; of rows the first number decides."""
    return values is not None and bool((values if values.ndim == 1 else values[:, 0]).any())


def _limited(values: Array | None) -> bool:
    return values is not None and bool(np.isfinite(values).any())


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
    speed = values['stribeck_velocity'] if (resting > sliding).any() else None
    return {'friction': sliding, 'static_friction': resting, 'stribeck_velocity': speed}


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
    return {'cogging': np.where(rows[:, :1] == 0, (0.0, 1.0, 0.0), rows)}


def _table_rows(robot: Robot, tables: Any) -> Array | None:
    """Return the tables of all joints with the rows of the longest, (n, k, 2)."""
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
        limited = math.isfinite(speed) and math.isfinite(torque)
        if limited and not speed < NO_EFFORT * speed:
            raise ValueError(
                f'torque_speed {MODEL!r} needs velocity limits above zero, joint {quote(name)} '
                f'has {speed}'
            )
        tables.append([(speed, torque), (NO_EFFORT * speed, 0.0)] if limited else None)
    return tables


def _torque_speed(robot: Robot, values: Numbers) -> Numbers:
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
    amplitude, periods, phase = c.cogging
    return amplitude * sin(periods * q + phase)


def _cogging_energy(c: Any, q: Any) -> Any:
    amplitude, periods, phase = c.cogging
    return -amplitude / periods * cos(periods * q + phase)


# What users give: field of Scene -> its record.
FIELDS: Mapping[str, Field] = {
    field.name: field
    for field in (
        Field('gravity', 'Acceleration of free fall, base frame', 'm/s^2', kind=VECTOR),
        Field('damping', 'Viscous damping of the joint', 'N m s/rad', 'N s/m', model='damping'),
        Field(
            'armature',
            'Rotor inertia of the joint times the square of its gear ratio',
            'kg m^2',
            'kg',
            model='armature',
            estimated=True,
        ),
        Field('payload', 'A body held by the last link', kind=PAYLOAD),
        Field('external_wrench', 'Wrench on the last link as an input', kind=SWITCH, off=False),
        Field('brakes', 'Joints that can be braked at run time', kind=SWITCH, off=False),
        Field('friction', 'Coulomb friction of the joint', 'N m', 'N', model='friction'),
        Field('static_friction', 'Friction that a resting joint can hold', 'N m', 'N'),
        Field(
            'stribeck_velocity',
            'Velocity at which static friction has fallen half-way to Coulomb friction',
            'rad/s',
            'm/s',
            above=True,
        ),
        Field(
            'joint_limits',
            'Stops at the position limits of the joint',
            'rad',
            'm',
            model=('position_lower', 'position_upper'),
            columns=('lower', 'upper'),
            least=-math.inf,
            infinite=True,
        ),
        Field(
            'restitution',
            'Share of its velocity that a joint keeps when it bounces off its stop',
            kind=SHARE,
            off=0.0,
            most=1.0,
        ),
        Field('stiffness', 'Stiffness of the spring of the joint', 'N m/rad', 'N/m'),
        Field(
            'rest_position',
            'Position at which the spring of the joint is slack',
            'rad',
            'm',
            least=-math.inf,
        ),
        Field(
            'cogging',
            'Torque of the joint that goes through some periods a turn',
            'N m, 1/turn, rad',
            'N, 1/(2 pi m), rad',
            columns=('amplitude', 'periods', 'phase'),
            least=-math.inf,
        ),
        Field(
            'effort_limits',
            'Largest torque of the motor',
            'N m',
            'N',
            model='effort_limit',
            infinite=True,
        ),
        Field(
            'torque_speed',
            'Largest driving torque of the motor by speed',
            'rad/s, N m',
            'm/s, N',
            kind=TABLES,
            model=('velocity_limit', 'effort_limit'),
        ),
        Field(
            'gravity_compensation',
            'Gravity torques of a model that the drives add',
            kind=COMPENSATION,
            off=False,
        ),
        Field(
            'motor_lag',
            'Time constant with which the motor of the joint follows its effort',
            's',
            's',
            most=10.0,
        ),
    )
}
# Their physics.
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
