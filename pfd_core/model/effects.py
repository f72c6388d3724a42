# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The table of effects (EFFECTS): one record for each effect of a scene, or what refines one.

A record holds a field of Scene, what users may give, with units, checks and numbers for a robot,
and the physics. Methods, quantities, derivatives, energy, the choice of an integrator, YAML, the
parameters of the node, reports and docs/reference/effects.md are derived from the records. A new
effect of a joint is a record here and a field of Scene. One on motors also needs its torque in
pfd_core.dynamics.drives, and one that acts over a step (STEP) its law in pfd_core.simulation: dry
friction and stops in dry, the lag of motors in stages. A torque that depends on the torque of the
motor is of the latter kind: `torque` is a function of q and qd only.

The effects add to the joint torques of the rigid links:

    tau = tau of links, gravity and wrench
          + viscosity qd + torque(q, qd) + inertia qdd        summed over the effects

torque and potential are functions on lane values. They use the operators of lane values and the
functions of pfd_core.machine.lanes, and are recorded on n lanes (one row for all joints) and on
one processor (one number for each joint). Each joint's torque depends on its own q and qd only,
and a conservative one is the derivative of its potential. `c` holds the numbers of the effect by
the names of the fields: a lane value, or a tuple of them for a field with columns. A field that
refines another is None where it is not given or zero, so that it costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import Any

import numpy as np

from pfd_core.forking import load
from pfd_core.model.limits import estimated_armature
from pfd_core.model.robot import LIMIT_FIELDS, Payload, Robot, unstated, warn
from pfd_core.model.values import (
    LARGEST,
    Array,
    Shape,
    check_least,
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
# Multiple of its velocity limit at which a motor of the model has no driving torque left. Up to
# the limit it gives its full effort; docs/decisions/0032-one-table-of-effects.md.
NO_EFFORT = 2.0

FieldNumbers = Mapping[str, Array | None]  # by field of Scene


class ByJoint(tuple[tuple[str, Any], ...]):
    """Pairs of a joint and its value, as Scene keeps a mapping."""


@dataclass(frozen=True)
class Effect:
    """An effect of a scene, or what refines one: a field of Scene, and a parameter of the node."""

    name: str  # in tables and on pages
    acts: str  # LINKS, JOINTS, MOTORS, BRAKES or STEP
    field: str  # of Scene and of the parameters of the node
    text: str  # what the field holds, in a few words
    # Units for joints that turn and that slide, '' without one; of columns separated by commas.
    unit: str = ''
    sliding_unit: str = ''
    kind: str = PER_JOINT
    model: tuple[str, ...] = ()  # fields of Robot for "model", one for each column
    estimated: bool = False  # whether "estimated" means numbers from the robot's limits
    columns: tuple[str, ...] = ()  # names of the numbers of a row; () for one number a joint
    least: float = 0.0
    above: bool = False  # whether the least number is excluded
    infinite: bool = False  # whether infinity is allowed, for a joint without a limit
    off: Any = None  # the value without the effect
    needs: str = ''  # field without which it means nothing: it refines that effect
    # Number or row of a joint that values by joint leave out; NaN if the effect completes it.
    left_out: Any = 0.0
    most: float = 1e6  # largest number that a parameter of the node may have

    at_rest: bool = False  # whether it exerts a torque at zero velocity, as a function of q
    # Whether the inertia matrix depends on it. On the joints its number multiplies qdd then.
    inertia: bool = False
    viscosity: bool = False  # whether its number multiplies qd; integrators may take it implicitly
    # (c, q, qd) -> the resisting torque [N m or N]; (c, q) -> the energy that it stores [J], if it
    # is conservative.
    torque: Callable[[Any, Any, Any], Any] | None = None
    potential: Callable[[Any, Any], Any] | None = None
    # From a robot and the numbers of all fields, which may differ among arms, to the numbers of
    # this effect and of those that refine it; {} if it is off. By default it is off where its
    # numbers are all zero, or infinite if infinity means no limit.
    completed: Callable[[Robot, FieldNumbers], FieldNumbers] | None = None

    @property
    def part(self) -> str:
        """Where it acts, or INERTIA or VISCOSITY for such an effect of the joints."""
        if self.acts == JOINTS and self.inertia:
            return INERTIA
        return VISCOSITY if self.viscosity else self.acts

    @property
    def of_joints(self) -> bool:
        """Whether it acts on the joint side of the motors, at an instant or over a step."""
        return self.acts in (JOINTS, STEP)

    @property
    def fields(self) -> tuple[str, ...]:
        """Its field, and those that refine it."""
        return (self.field, *(key for key, other in FIELDS.items() if other.needs == self.field))

    @property
    def has_numbers(self) -> bool:
        """Whether a plant has the numbers of the field, one or more for each joint."""
        return self.kind in (PER_JOINT, SHARE, TABLES)

    @property
    def from_model(self) -> bool:
        """Whether the model of a robot may state one number or row a joint."""
        return self.kind == PER_JOINT and bool(self.model)

    @property
    def _words(self) -> tuple[str, ...]:
        """The words that may take the place of a value."""
        if self.kind == PAYLOAD:
            return (INPUT,)
        return (MODEL,) * bool(self.model) + (ESTIMATED,) * self.estimated

    def units(self, column: int = 0) -> str:
        """Return the units of a number: for joints that turn, and for joints that slide."""
        both = (text.split(', ')[column] for text in (self.unit, self.sliding_unit) if text)
        return ' or '.join(dict.fromkeys(both))

    # What a user gives, checked.

    def checked(self, value: Any) -> Any:
        """
        Return a user's value as None, a word, bool, float or tuples; ValueError names it.

        Of a mapping of joints to numbers, rows or tables they are pairs, in the order of names.
        """
        if value is None and self.off is None:
            return value
        if isinstance(value, str) and value in self._words:
            return value
        if self.kind == SWITCH:
            return switch(self.field, value)
        if self.kind == VECTOR:
            return self._numbers(self.field, value, (3,))
        if self.kind == PAYLOAD and not isinstance(value, Payload):
            raise ValueError(
                f'{self.field} must be a Payload, {INPUT!r} or None, got {quote(value)}'
            )
        if not self.has_numbers:
            return value
        if isinstance(value, (Mapping, ByJoint)):
            given = dict(value)
            if not all(isinstance(joint, str) for joint in given):
                raise ValueError(
                    f'{self.field} must have names of joints as keys, got {quote(value)}'
                )
            pairs = ((j, self._of_joint(f'joint {quote(j)}', given[j])) for j in sorted(given))
            return ByJoint(pairs) or self.off
        if _is_list(value):
            if self.kind == TABLES:
                return tuple(self._of_joint(f'joint {i}', x) for i, x in enumerate(value, 1))
            return self._numbers(self.field, value, ('n', *self._row))
        if self.kind == SHARE:
            return self._numbers(self.field, value, ())
        row = f'one row ({", ".join(self.columns)})' if self.columns else 'one number'
        row = 'one table with rows (speed, torque)' if self.kind == TABLES else row
        words = ', '.join(map(repr, (self.off, *self._words)))
        raise ValueError(f'{self.field} must be {words} or {row} per joint, got {quote(value)}')

    @property
    def _row(self) -> tuple[int, ...]:
        return (len(self.columns),) if self.columns else ()

    def _of_joint(self, joint: str, value: Any) -> Any:
        """Return the number, row or table of one joint; the speeds of a table rise."""
        label = f'{self.field} of {joint}'
        if self.columns and not (_is_list(value) and len(value) == len(self.columns)):
            raise ValueError(f'{label} must be ({", ".join(self.columns)}), got {quote(value)}')
        if self.kind != TABLES:
            return self._numbers(label, value, self._row)
        if value is None:
            return None
        rows = self._numbers(label, value, ('k', 2))
        if not rows:
            raise ValueError(f'{label} must have at least one row, or be None')
        speeds, torques = zip(*rows, strict=True)
        if any(b <= a for a, b in pairwise(speeds)):
            raise ValueError(f'speeds of {label} must rise, got {quote(list(speeds))}')
        if any(b > a for a, b in pairwise(torques)):
            raise ValueError(f'torques of {label} must not rise, got {quote(list(torques))}')
        return rows

    def _numbers(self, label: str, value: Any, shape: Shape) -> Any:
        """Return numbers of a shape within the bounds of the field, as a float or tuples."""
        array = (
            real_array(label, value, shape=shape, infinite=self.infinite, largest=LARGEST) + 0.0
        )
        check_least(label, array, self.least, above=self.above)
        if self.most == 1 and (array > 1).any():
            raise ValueError(f'{label} must be from 0 to 1, got {quote(array.tolist())}')
        return _tuples(array.tolist())

    # Its numbers for a robot.

    def resolved(self, robot: Robot, value: Any) -> Array | None:
        """Return the value in a scene as numbers for a robot; None without the effect."""
        if value is None or not self.has_numbers:
            return None
        if value == ESTIMATED:
            return estimated_armature(robot)
        if value == MODEL:
            self._check_stated(robot)
            value = _model_tables(robot) if self.kind == TABLES else self.of_model(robot)
        elif isinstance(value, float):
            value = [value] * robot.n
        elif isinstance(value, ByJoint):
            value = self._of_all_joints(robot, dict(value))
        if len(value) != robot.n:
            rows = 'tables' if self.kind == TABLES else 'rows' if self.columns else 'numbers'
            raise ValueError(
                f'{self.field} of the scene has {len(value)} {rows}, but {quote(robot.name)} has '
                f'{robot.n} joints: {quote_all(robot.joint_names)}'
            )
        return _table_rows(value) if self.kind == TABLES else np.asarray(value, dtype=np.float64)

    def of_model(self, robot: Robot) -> Array:
        """Return the numbers of a robot's model, (n,) or (n, columns)."""
        numbers = [getattr(robot, name) for name in self.model]
        return np.stack(numbers, axis=1) if self.columns else numbers[0]

    def unstated(self, robot: Robot) -> list[str]:
        """Return the joints for which the model of a robot states no value of the field."""
        keys = set(self.model)
        # One end may be all that a joint is limited by; a motor has a torque and a speed, or none.
        enough = 1 if self.kind == TABLES else len(keys)
        found = [j for j in robot.joint_names if len(keys & unstated(robot, j)) >= enough]
        return found if self.field != 'joint_limits' else _without_continuous(robot, found)

    def _check_stated(self, robot: Robot) -> None:
        """Raise ValueError if the model states nothing; warn if it does for some joints only."""
        silent = self.unstated(robot)
        label = f'{self.field} is {MODEL!r}, but the model of {quote(robot.name)} states none for'
        if len(silent) == robot.n:
            raise ValueError(
                f'{label} any joint: give values by joint, {self._by_joint(silent[:1])}'
            )
        keys = set(self.model)
        if keys & set(LIMIT_FIELDS.values()):
            silent = _without_continuous(robot, silent)
        if silent:
            # A scene with values by joint has none of the model.
            stated = [j for j in robot.joint_names if keys - unstated(robot, j)]
            warn(
                f'{label} {quote_all(silent)}, which have none: give the values of all joints, '
                f'{self._by_joint([*stated[:1], silent[0]])}'
            )

    def _by_joint(self, joints: list[str]) -> str:
        """Return how values of some joints are given, in Python and in files and parameters."""
        pairs = ', '.join(f'{quote(joint)}: ...' for joint in joints)
        keys = ', '.join(f'{self.field}.{quote(joint)[1:-1]}' for joint in joints)
        found = f'{self.field}={{{pairs}}} or {keys}'
        return f'{found}, or {ESTIMATED!r}' if self.estimated else found

    def _of_all_joints(self, robot: Robot, given: Mapping[str, Any]) -> list[Any]:
        """Return values by joint as a list, with `left_out` for all other joints."""
        label = f'{self.field} of the scene'
        for joint in given:
            if joint not in robot.joint_names:
                raise ValueError(
                    f'{label} names joint {quote(joint)}, but {quote(robot.name)} has '
                    f'{quote_all(robot.joint_names)}'
                )
        if self.above and len(given) < robot.n:
            missing = [joint for joint in robot.joint_names if joint not in given]
            raise ValueError(f'{label} must have a value for each joint, not {quote_all(missing)}')
        return [given.get(joint, self.left_out) for joint in robot.joint_names]

    def numbers(self, robot: Robot, values: FieldNumbers) -> FieldNumbers:
        """Return the numbers of the effect by field, from those of a scene; {} if it is off."""
        if not self.has_numbers or self.needs:
            return {}
        if self.completed is not None:
            return self.completed(robot, values)
        found = values[self.field]
        # A table of zeros is a limit, too.
        limits = self.infinite or self.kind == TABLES
        if found is None or not (np.isfinite(found) if limits else found).any():
            return {}
        return {key: values[key] for key in self.fields}


def _is_list(value: Any) -> bool:
    """Return whether a value has a length; not so a string or a type of NumPy."""
    try:
        return not isinstance(value, (str, np.dtype)) and len(value) >= 0
    except TypeError:
        return False


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _without_continuous(robot: Robot, joints: list[str]) -> list[str]:
    kinds = dict(zip(robot.joint_names, robot.joint_types, strict=True))
    return [joint for joint in joints if kinds[joint] != 'continuous']


def _table_rows(tables: Any) -> Array | None:
    """Return the tables of all joints with the rows of the longest, (n, k, 2)."""
    longest = max(len(table or ()) for table in tables)
    if not longest:
        return None
    rows = np.full((len(tables), longest, 2), np.inf)
    for i, table in enumerate(tables):
        if table is not None:
            rows[i, : len(table)] = table
            rows[i, len(table) :, 1] = table[-1][1]
    return rows


def _model_tables(robot: Robot) -> list[list[tuple[float, float]] | None]:
    """Return tables that fall from effort limits beyond velocity limits; None without one."""
    pairs = zip(robot.velocity_limit.tolist(), robot.effort_limit.tolist(), strict=True)
    return [
        [(speed, torque), (NO_EFFORT * speed, 0.0)] if math.isfinite(max(speed, torque)) else None
        for speed, torque in pairs
    ]


# Numbers of the effects for a robot.


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
    if not np.isfinite(limits).any():
        return {}
    return {'joint_limits': limits, 'restitution': values['restitution']}


# Cogging: the torque a sin(k q + phase) of magnets or gears that settle k times a turn.
# Fewer periods are a constant torque whose energy overflows; of more, k q loses its digits.
LEAST_PERIODS, MOST_PERIODS = 1e-6, 1e6


def _cogging(robot: Robot, values: FieldNumbers) -> FieldNumbers:
    rows = values['cogging']
    if rows is None or not rows[:, 0].any():
        return {}
    for name, (amplitude, periods, _) in zip(robot.joint_names, rows.tolist(), strict=True):
        if amplitude and not LEAST_PERIODS <= abs(periods) <= MOST_PERIODS:
            raise ValueError(
                f'periods of cogging of joint {quote(name)} must be within {LEAST_PERIODS:g} and '
                f'{MOST_PERIODS:g} a turn, got {periods:g}'
            )
    # A joint without cogging has some period, by which its energy is divided.
    return {'cogging': np.where(rows[:, :1] == 0, (0.0, 1.0, 0.0), rows)}


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
    return amplitude * load('machine.lanes.sin')(periods * q + phase)


def _cogging_energy(c: Any, q: Any) -> Any:
    amplitude, periods, phase = c.cogging
    return -amplitude / periods * load('machine.lanes.cos')(periods * q + phase)


EFFECTS: tuple[Effect, ...] = (
    Effect(
        *('gravity', LINKS, 'gravity', 'Acceleration of free fall, root frame', 'm/s^2'),
        kind=VECTOR,
        least=-math.inf,
        at_rest=True,
    ),
    Effect(
        *('damping', JOINTS, 'damping', 'Viscous damping of the joint', 'N m s/rad', 'N s/m'),
        model=('damping',),
        viscosity=True,
    ),
    Effect(
        *('armature', JOINTS, 'armature'),
        *('Rotor inertia of the joint times the square of its gear ratio', 'kg m^2', 'kg'),
        model=('armature',),
        estimated=True,
        inertia=True,
    ),
    Effect(
        *('payload', LINKS, 'payload', 'A body held by the last link'),
        kind=PAYLOAD,
        at_rest=True,
        inertia=True,
    ),
    Effect(
        *('external wrench', LINKS, 'external_wrench', 'Wrench on the last link as an input'),
        kind=SWITCH,
        off=False,
    ),
    Effect(
        *('brakes', BRAKES, 'brakes', 'Joints that can be braked at run time'),
        kind=SWITCH,
        off=False,
    ),
    Effect(
        *('friction', STEP, 'friction', 'Coulomb friction of the joint', 'N m', 'N'),
        model=('friction',),
        completed=_friction,
    ),
    Effect(
        *('static friction', STEP, 'static_friction'),
        'Friction that a resting joint can hold, at least and by default its Coulomb friction',
        *('N m', 'N'),
        left_out=math.nan,
        needs='friction',
    ),
    Effect(
        *('Stribeck velocity', STEP, 'stribeck_velocity'),
        'Velocity at which static friction has fallen half-way to Coulomb friction',
        *('rad/s', 'm/s'),
        above=True,
        needs='static_friction',
    ),
    Effect(
        *('load friction', STEP, 'load_friction'),
        *('Share of the torque of the motor that friction takes, as in gears', '1'),
        most=1.0,
    ),
    Effect(
        *('joint stops', STEP, 'joint_limits'),
        *('Stops at the position limits of the joint', 'rad', 'm'),
        model=('position_lower', 'position_upper'),
        columns=('lower', 'upper'),
        least=-math.inf,
        infinite=True,
        left_out=(-math.inf, math.inf),
        completed=_stops,
    ),
    Effect(
        *('restitution', STEP, 'restitution'),
        'Share of its velocity that a joint keeps when it bounces off its stop',
        kind=SHARE,
        off=0.0,
        most=1.0,
        needs='joint_limits',
    ),
    Effect(
        *('springs', JOINTS, 'stiffness', 'Stiffness of the spring of the joint'),
        *('N m/rad', 'N/m'),
        at_rest=True,
        torque=_spring_torque,
        potential=_spring_energy,
    ),
    Effect(
        *('rest position', JOINTS, 'rest_position'),
        *('Position at which the spring of the joint is slack', 'rad', 'm'),
        least=-math.inf,
        needs='stiffness',
        at_rest=True,
    ),
    Effect(
        *(
            'cogging',
            JOINTS,
            'cogging',
            'Torque of the joint that goes through some periods a turn',
        ),
        *('N m, 1/turn, rad', 'N, 1/(2 pi m), rad'),
        columns=('amplitude', 'periods', 'phase'),
        least=-math.inf,
        left_out=(0.0, 0.0, 0.0),
        at_rest=True,
        torque=_cogging_torque,
        potential=_cogging_energy,
        completed=_cogging,
    ),
    Effect(
        *('effort limits', MOTORS, 'effort_limits', 'Largest torque of the motor', 'N m', 'N'),
        model=('effort_limit',),
        infinite=True,
        left_out=math.inf,
    ),
    Effect(
        *('torque-speed tables', MOTORS, 'torque_speed'),
        *('Largest driving torque of the motor by speed', 'rad/s, N m', 'm/s, N'),
        kind=TABLES,
        model=('velocity_limit', 'effort_limit'),
        left_out=None,
    ),
    Effect(
        *('gravity compensation', MOTORS, 'gravity_compensation'),
        'Gravity torques of a model that the drives add',
        kind=COMPENSATION,
        off=False,
        at_rest=True,
    ),
    Effect(
        *('motor lag', STEP, 'motor_lag'),
        'Time constant with which the motor of the joint follows its effort',
        *('s', 's'),
        most=10.0,
    ),
)
FIELDS: Mapping[str, Effect] = {effect.field: effect for effect in EFFECTS}
