# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The fields of a scene (FIELDS): what users may give, its units, checks, and numbers for a robot.

A field with a value a joint takes values of all joints, of some joints by name, or "model": the
values that a robot states. The records in `pfd_core.model.effects` hold what the values do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import math
from typing import Any
import warnings

import numpy as np

from pfd_core.model.robot import LIMIT_FIELDS, Payload, PhysicsWarning, Robot, unstated
from pfd_core.model.rotors import estimated_armature
from pfd_core.model.values import LARGEST, Array, quote, quote_all, real_array, switch

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
    # Number of a joint that values by joint leave out; NaN if the effect completes it.
    left_out: float = 0.0
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
        return tuple((j, self._of_joint_checked(j, given[j])) for j in sorted(given)) or self.off

    def _of_joint_checked(self, joint: str, value: Any) -> Any:
        label = f'{self.name} of joint {quote(joint)}'
        if self.kind == TABLES:
            return _table(label, value)
        if self.columns and not (_is_list(value) and len(value) == len(self.columns)):
            raise ValueError(f'{label} must be ({", ".join(self.columns)}), got {quote(value)}')
        return _CHECKS[self.kind](replace(self, name=label), [value])[0]

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
        if len(silent) == robot.n:
            raise ValueError(
                f'{self.name} is {MODEL!r}, but the model of {quote(robot.name)} states none for '
                f'any joint: give values by joint, {self._by_joint(silent[:1])}'
            )
        if self._of_robot & set(LIMIT_FIELDS.values()):
            silent = _without_continuous(robot, silent)
        if silent:
            # A scene with values by joint has none of the model.
            stated = [j for j in robot.joint_names if self._of_robot - unstated(robot, j)]
            warnings.warn(
                f'{self.name} is {MODEL!r}, but the model of {quote(robot.name)} states none for '
                f'{quote_all(silent)}, which have none: give the values of all joints, '
                f'{self._by_joint([*stated[:1], silent[0]])}',
                PhysicsWarning,
                stacklevel=2,
            )

    def _by_joint(self, joints: list[str]) -> str:
        """Return how values of some joints are given, in Python and in files and parameters."""
        pairs = ', '.join(f'{quote(joint)}: ...' for joint in joints)
        keys = ', '.join(f'{self.name}.{quote(joint)[1:-1]}' for joint in joints)
        found = f'{self.name}={{{pairs}}} or {keys}'
        return f'{found}, or {ESTIMATED!r}' if self.estimated else found

    def _of_all_joints(self, robot: Robot, given: Mapping[str, Any]) -> list[Any]:
        """Return values by joint as a list, with `left_out` or no limit for all other joints."""
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
        none: Any = math.inf if self.infinite else self.left_out
        if self.columns:
            none = (-none, none) if self.infinite else (none,) * len(self.columns)
        if self.kind == TABLES:
            none = None
        return [given.get(joint, none) for joint in robot.joint_names]


def by_joint(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return values by field, with `friction.elbow_joint` for one joint as friction of that joint.

    ValueError if a field is given for one joint and for all, or twice for one.
    """
    found: dict[str, Any] = {}
    for key, value in values.items():
        name, dot, joint = key.partition('.')
        if not dot or name not in FIELDS or not FIELDS[name].has_numbers:
            name = key
        else:
            value = {joint: value}
        if name not in found:
            found[name] = dict(value) if isinstance(value, Mapping) else value
            continue
        table = found[name]
        if not (isinstance(table, dict) and isinstance(value, Mapping)):
            raise ValueError(f'{name} is given for all joints and for one: use one of them')
        for joint in value:
            if joint in table:
                raise ValueError(f'{name} of joint {quote(joint)} is given twice')
        table |= value
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


# Field of Scene -> its record.
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
        Field(
            'static_friction',
            'Friction that a resting joint can hold, at least and by default its Coulomb friction',
            'N m',
            'N',
            left_out=math.nan,
        ),
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
