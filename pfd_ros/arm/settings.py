# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of a run: one frozen table, checked once, written into every recording.

A new setting is a new field of `Settings` or of one of its base classes, which group the settings
in the documentation. FIELDS lists them all: the parameters of the node, the arguments of the test
fixture, the keys of what-if and the documentation come from it. A replay reads the settings from
the recording, so it runs the same simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass
from functools import partial
import json
import math
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.conventions import CONVENTIONS, PLAIN, defaults, joint_numbers
from pfd_ros.arm.events import MOST_STEPS, OPTIONAL
from pfd_ros.arm.noise import LARGEST_SEED
from pfd_ros.arm.plant_settings import PlantSettings
from pfd_ros.arm.setting_fields import Row, check_values, rows_of, setting, typed
from pfd_ros.messages.cdr import LAST_SECOND, NANOSECONDS
from pfd_ros.text import cut, listed

# How far a product of step size and rate may lie from a whole number before it is refused:
# decimal fractions such as 1/3 kHz carry that much rounding.
WHOLE = 1e-6
# A slower arm has a period in nanoseconds that a float does not hold exactly.
SLOWEST_FACTOR = 1e-6
# Most steps from one published message to the next; more is a mistake.
MOST_EVERY = 1e12
# The time of day when the node is configured: simulated time then never goes back from one run to
# the next, as controllers that outlive a run need.
TIME_OF_DAY = -1.0
# Values of `recording_time`.
WALL, SIMULATED = 'wall', 'simulated'
# Values of `position_sums` for the simulator, which chooses for None.
POSITION_SUMS = {'auto': None, 'plain': False, 'compensated': True}
# Longest delay of commands and of states, s: a line of this length is kept.
LONGEST_DELAY = 1.0
# Stiffer than any servo, and far more than any sensor errs by; sums with them stay finite.
LARGEST_GAIN, LARGEST_ERROR = 1e9, 1e6
# Parameters of earlier versions, and why there are none.
REMOVED = {
    'recording_flush_period': 'a recorded message is in the file after 0.1 s',
    'recording_max_size': 'a run has one file',
    'recording_max_duration': 'a run has one file',
    'recording_state_period': 'a replay starts at the beginning of a recording',
    'payload_changes': 'a payload that changes is an input of the compiled step where it can be',
}


_dynamic = partial(setting, dynamic=True)


def _gain(description: str) -> Any:
    return _dynamic((), description, 0.0, LARGEST_GAIN, per_joint=True)


def _scale(name: str, of: str) -> Any:
    text = f'Share of {of} that the drives compensate; default: of the convention'
    default = joint_numbers(name)
    return _dynamic((), text, 0.0, 1.0, per_joint=True, joint_default=default)


def _error(name: str, description: str) -> Any:
    return _dynamic(0.0, description, 0.0, LARGEST_ERROR, name=name)


def _bias(kind: str, unit: str) -> Any:
    text, span = f'Added to the measured {kind} of each joint, {unit}', LARGEST_ERROR
    return _dynamic((), text, -span, span, name=f'bias.{kind}', per_joint=True)


def _delay(name: str, description: str) -> Any:
    return setting(0.0, f'{description}, s, whole steps', 0.0, LONGEST_DELAY, name=name)


def _rate(description: str, default: float = 0.0) -> Any:
    return setting(default, f'{description} per simulated second, Hz', 0.0, 1e5)


@dataclass(frozen=True)
class CommandSettings:
    """The settings of commands."""

    lockstep: bool = setting(False, 'Wait after each state for a command with its stamp, or none')
    wait_for_controller: bool = setting(False, 'In lockstep, the first step waits for a command')
    step_count: int = setting(1, 'Steps of one call of ~/step', 1, MOST_STEPS)
    convention: str = setting(
        PLAIN,
        'Torque control as documented by a vendor: other defaults, and efforts without gravity',
        values=tuple(CONVENTIONS),
    )
    viscous_scale: tuple[float, ...] = _scale('viscous_scale', 'damping')
    coulomb_scale: tuple[float, ...] = _scale('coulomb_scale', 'friction')
    effort_limits: bool = _dynamic(True, 'Limit efforts to the limits of the model or the scene')
    torque_speed: bool = _dynamic(
        True, 'Limit efforts by torque-speed tables, of the model or the scene'
    )
    servo_p: tuple[float, ...] = _gain(
        'Gain of the servo on positions, N m/rad or N/m; 0: no servo'
    )
    servo_d: tuple[float, ...] = _gain('Gain of the servo on velocities, N m s/rad or N s/m')
    command_timeout: float = _dynamic(
        0.0, 'Time without a command until on_timeout acts, s; 0 is never', 0.0, 1e6
    )
    on_timeout: str = _dynamic(
        'brake',
        'What acts then: brakes, no effort, the servos, or a reflex',
        values=('brake', 'zero', 'hold', 'stop'),
    )
    delay_commands: float = _delay('delay.commands', 'From reception of a command to its effect')
    drop_commands: float = _dynamic(
        0.0, 'Share of the commands that are lost', 0.0, 1.0, name='drop.commands'
    )
    reflex_effort_rate: float = _dynamic(
        0.0, 'Rate of an effort that brakes all joints, N m/s or N/s; 0: off', 0.0, 1e9
    )
    reflex_effort_start: bool = _dynamic(
        False, 'Compare the first effort of a joint with 0, too: for reflex_effort_rate'
    )
    reflex_position: bool = _dynamic(
        False, 'Brake all joints if one leaves the position limits of the model'
    )
    reflex_velocity: bool = _dynamic(
        False, 'Brake all joints if one exceeds the velocity limit of the model'
    )
    reflex_external_effort: tuple[float, ...] = setting(
        (),
        'Effort of ~/external_wrench at a joint that brakes all joints, N m or N; 0: none',
        0.0,
        LARGEST_ERROR,
        per_joint=True,
    )


@dataclass(frozen=True)
class DescriptionSettings:
    """The settings of the model outside of the arm."""

    ros2_control: bool = setting(True, 'Take topics and positions from <ros2_control> of the URDF')
    description_timeout: float = setting(30.0, 'How long to wait for a model, s', 0.1, 3600.0)
    publish_description: bool = setting(False, 'Publish robot_description: the URDF of the arm')
    command_topic: str = setting('', "Topic of commands without names; '' is ~/commands")
    publish_locked: bool = setting(True, 'Publish the locked joints after the others, at rest')


@dataclass(frozen=True)
class SensorSettings:
    """The settings of measured states, and of outputs in addition to them."""

    outputs: tuple[str, ...] = setting((), 'Published with each state', values=OPTIONAL)
    state_effort: str = setting(
        'command',
        'Effort in joint_states: as commanded, with the torques that drives add, or current',
        values=('command', 'torque', 'current'),
    )
    torque_constant: tuple[float, ...] = setting(
        (),
        'Torque at the joint for a current of the motor, N m/A or N/A',
        0.0,
        LARGEST_ERROR,
        per_joint=True,
    )
    seed: int = setting(0, 'Seed of all noise', 0, LARGEST_SEED)
    noise_position: float = _error('noise.position', 'Standard deviation, rad or m')
    noise_velocity: float = _error('noise.velocity', 'Standard deviation, rad/s or m/s')
    noise_effort: float = _error('noise.effort', 'Standard deviation, N m or N')
    bias_position: tuple[float, ...] = _bias('position', 'rad or m')
    bias_velocity: tuple[float, ...] = _bias('velocity', 'rad/s or m/s')
    bias_effort: tuple[float, ...] = _bias('effort', 'N m or N')
    quantization_position: float = _error('quantization.position', 'Step, rad or m; 0: none')
    quantization_velocity: float = _error('quantization.velocity', 'Step, rad/s or m/s; 0: none')
    quantization_effort: float = _error('quantization.effort', 'Step, N m or N; 0: none')
    delay_state: float = _delay('delay.state', 'Age of the measured state')
    drop_state: float = setting(
        0.0, 'Share of the states that are not published', 0.0, 0.99, name='drop.state'
    )


@dataclass(frozen=True)
class Settings(CommandSettings, PlantSettings, DescriptionSettings, SensorSettings):
    """The parameters of the node `sim_arm`; units SI, angles in rad.

    ValueError if a value is not finite, outside its range, or does not go with the others.
    """

    robot: str = setting('puma560', 'A name that `pfd robots` lists, a file, or robot_description')
    xacro_args: tuple[str, ...] = setting(
        (), 'Arguments of a .xacro file, each name:=value; empty: those of the file'
    )
    base_link: str = setting('', "First link of the chain; '' is the root of the model")
    tip_link: str = setting('', "Last link of the chain; '' is the only leaf of the model")
    joints: tuple[str, ...] = setting((), 'Order of the joints; empty is the order of the model')
    locked: tuple[str, ...] = setting((), 'Joints to weld, or patterns, such as hand_*')
    locked_positions: tuple[float, ...] = setting(
        (), 'Their positions, rad or m; empty: initial_value of <ros2_control>, or nearest to 0'
    )
    step_size: float = setting(0.001, 'Simulated time per step, s', 1e-5, 0.1)
    substeps: int = setting(2, 'Steps of the integrator per step', 1, 100)
    integrator: str = setting('auto', 'Integrator', values=pfd.INTEGRATORS)
    position_sums: str = setting('auto', 'Sums of positions', values=tuple(POSITION_SUMS))
    method: str = setting('auto', 'Forward dynamics', values=('auto', *pfd.METHODS))
    initial_positions: tuple[float, ...] = setting(
        (),
        'Where the joints start, rad or m; empty: initial_value of <ros2_control>, 0, or '
        'the middle of limits that exclude 0',
    )
    autostart: bool = setting(True, 'Be active from the start on, without lifecycle transitions')
    time_source: str = setting(
        'own', 'Clock: its own, or the /clock of another node', values=('own', 'clock')
    )
    start_time: float = setting(
        0.0,
        'Time before the first step, s; -1 is the time of day',
        0.0,
        float(LAST_SECOND),
        or_else=TIME_OF_DAY,
    )
    real_time_factor: float = _dynamic(
        1.0,
        'Simulated seconds per second; 0 is as fast as possible',
        SLOWEST_FACTOR,
        1000.0,
        or_else=0.0,
    )
    publish_rate: float = _rate('joint_states (0: one a step)')
    publish_clock: bool = setting(True, 'Publish /clock; only one node of a system may')
    clock_rate: float = _rate('/clock ticks (0: one a step)')
    frame_id: str = setting('', 'header.frame_id of joint_states')
    recording: str = setting('', "MCAP file to write, never over another; '' records nothing")
    recording_time: str = setting(
        'auto', 'Time base of log_time in the recording', values=('auto', WALL, SIMULATED)
    )
    recording_tf_rate: float = _rate('/tf in the recording (0: none)', 50.0)

    def __post_init__(self) -> None:
        """Check every value, so that the users of settings need not."""
        check_values(self)
        for name in ('locked', 'outputs'):
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise ValueError(f'{name} has duplicates: {listed(values)}')
        if self.locked_positions and len(self.locked_positions) != len(self.locked):
            raise ValueError(
                f'locked_positions holds {len(self.locked_positions)} numbers, expected '
                f'{len(self.locked)}, one for each of {listed(self.locked)}, or none'
            )
        if self.follows_clock and self.publish_clock:
            raise ValueError('an arm with time_source clock needs publish_clock false')
        if not self.robot:
            raise ValueError('robot is empty; name one that `pfd robots` lists, or a file')
        self.check_plant()
        if abs(self.step_ns / NANOSECONDS - self.step_size) > WHOLE * self.step_size:
            raise ValueError(
                f'step_size is {self.step_size!r} s, expected a whole number of nanoseconds'
            )
        _ = self.publish_every, self.clock_every
        _ = self.state_delay_steps, self.command_delay_steps

    @classmethod
    def from_values(cls, values: Any) -> Settings:
        """Return settings from values by field, perhaps from outside; others have their default.

        It is the default of the convention. ValueError if a name is not known, or a value has the
        wrong type or is refused.
        """
        given = typed_values(values)
        return cls(**{**defaults(given.get('convention', PLAIN)), **given})

    @classmethod
    def from_json(cls, text: str) -> Settings:
        """Return the settings of `to_json`; ValueError for other texts, as `from_values`."""
        try:
            return cls(**typed_values(json.loads(text)))
        except RecursionError:
            raise ValueError('the settings are nested too deep, expected a JSON object') from None

    def to_json(self) -> str:
        """Return the settings as JSON text; every number comes back with the same bits."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    @property
    def locks(self) -> dict[str, Any]:
        """Joint to weld -> position, rad or m; None is nearest to 0 within its limits."""
        positions = self.locked_positions or (None,) * len(self.locked)
        return dict(zip(self.locked, positions, strict=True))

    @property
    def follows_clock(self) -> bool:
        """Whether the arm follows the clock of another node."""
        return self.time_source == 'clock'

    def started(self, now: float, reached_ns: int) -> Settings:
        """Return settings with the time of day `now`, s, in the place of -1.

        Without a followed clock, simulated time does not begin before a stamp, ns. It does not
        begin at 0 if the first state waits for a command: there a stamp of 0 means now, so a
        second answer to that state would be one to the next.
        """
        start = int(now * 1000) / 1000 if self.start_time == TIME_OF_DAY else self.start_time
        if self.lockstep and self.wait_for_controller and not round(start * NANOSECONDS):
            start = self.step_size
        while not self.follows_clock and round(start * NANOSECONDS) < reached_ns:
            start = max(reached_ns / NANOSECONDS, math.nextafter(start, math.inf))
        return dataclasses.replace(self, start_time=start)

    @property
    def log_time(self) -> str:
        """Time base of the recording, WALL or SIMULATED; publish times have the other one."""
        if self.recording_time != 'auto':
            return self.recording_time
        in_real_time = self.real_time_factor == 1.0 and not self.lockstep
        return WALL if in_real_time and not self.follows_clock else SIMULATED

    @property
    def step_ns(self) -> int:
        """Simulated time per step in nanoseconds."""
        return round(self.step_size * NANOSECONDS)

    @property
    def start_ns(self) -> int:
        """Simulated time before the first step in nanoseconds."""
        if self.start_time < 0.0:
            raise ValueError('start_time is the time of day, which only a node knows')
        return round(self.start_time * NANOSECONDS)

    @property
    def publish_every(self) -> int:
        """Steps from one `joint_states` to the next."""
        rate = self.publish_rate
        return self._steps('publish_rate', rate, 1.0 / rate) if rate else 1

    @property
    def clock_every(self) -> int:
        """Steps from one `/clock` tick to the next."""
        rate = self.clock_rate
        return self._steps('clock_rate', rate, 1.0 / rate) if rate else 1

    @property
    def tf_every(self) -> int:
        """Steps from one `/tf` of the recording to the next; 0 without any."""
        steps = self.recording_tf_rate * self.step_size
        return max(1, round(1.0 / max(steps, 1.0 / MOST_EVERY))) if steps else 0

    @property
    def state_delay_steps(self) -> int:
        """Steps by which measured states are late."""
        return self._steps('delay.state', self.delay_state, self.delay_state)

    @property
    def command_delay_steps(self) -> int:
        """Steps from the arrival of a command until it acts."""
        return self._steps('delay.commands', self.delay_commands, self.delay_commands)

    def _steps(self, name: str, value: float, seconds: float) -> int:
        steps = seconds / self.step_size
        if steps > MOST_EVERY or abs(steps - round(steps)) > WHOLE * max(1.0, steps):
            raise ValueError(
                f'{name} is {value!r}, which is {steps:.6g} steps of {self.step_size!r} s; '
                'expected a whole number of steps'
            )
        return round(steps)


FIELDS = rows_of(Settings)
PER_JOINT = tuple(row for row in FIELDS if row.per_joint)


def typed_values(values: Any, *, dynamic: bool = False) -> dict[str, Any]:
    """Return values of settings by field, each of its type; ValueError for other values.

    With `dynamic`, the settings are those that may change while the arm runs.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f'the settings are {type(values).__name__}, expected a JSON object')
    if dynamic and not values:
        raise ValueError('no setting is to change, expected at least one')
    kinds = {row.field: row.type for row in FIELDS if row.dynamic or not dynamic}
    strange = sorted(str(name) for name in values if name not in kinds)
    if strange:
        if dynamic:
            raise ValueError(f'{listed(strange)} cannot change while the arm runs')
        raise ValueError(
            f'unknown settings {listed(strange)}; a file with them is of another version of pfd'
        )
    by_joint = {row.name for row in PER_JOINT}
    found = {}
    for name, value in values.items():
        try:
            found[name] = typed(name, value, kinds[name])
        except ValueError as error:
            also = f', or a number by joint, {name}.JOINT' if name in by_joint else ''
            raise ValueError(f'{error}{also}') from None
    return found


def timeout_steps(seconds: float, step_size: float) -> float:
    """Return the whole steps after which a timeout is over, one at least; 0 s is never: inf."""
    return max(1, math.ceil(seconds / step_size - WHOLE)) if seconds else math.inf


def check_counts(settings: Settings, count: int) -> None:
    """Raise ValueError unless settings go with a number of joints.

    They have a number for each joint or none, and the watchdog holds with servos alone.
    """
    names = {row.field: row.name for row in PER_JOINT}
    for field, name in {**names, 'initial_positions': 'initial_positions'}.items():
        given = len(getattr(settings, field))
        if given not in (0, count):
            raise ValueError(
                f'{name} holds {given} numbers, expected {count}, one for each joint, or none'
            )
    constants = settings.torque_constant
    if settings.state_effort == 'current' and not (constants and min(constants) > 0.0):
        raise ValueError(
            "state_effort is 'current', expected torque_constant above 0 for every joint, N m/A: "
            'that of the motor times the gear ratio'
        )
    if settings.on_timeout == 'hold' and not (settings.servo_p and min(settings.servo_p) > 0.0):
        raise ValueError("on_timeout is 'hold', expected servo_p above 0 for every joint")


def with_convention(settings: Settings, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return new values by field, and with a new convention its values, too.

    They replace the values of the old convention, not others.
    """
    names = settings.convention, values.get('convention', settings.convention)
    if names[0] == names[1]:
        return dict(values)
    old, new = (vars(Settings.from_values({'convention': name})) for name in names)
    changed = {name for x in names for name in defaults(x)}
    same = {name: new[name] for name in sorted(changed) if getattr(settings, name) == old[name]}
    return {**same, **values}


def joint_order(wanted: Sequence[str], robot: pfd.Robot) -> tuple[int, ...]:
    """Return the index in the model of each joint, in the order in which joints are published.

    ValueError if `wanted` is not empty and not a permutation of the robot's joints.
    """
    names = list(robot.joint_names)
    if wanted and sorted(wanted) != sorted(names):
        raise ValueError(
            f'joints is {listed(wanted)}, expected each joint of {cut(robot.name)!r} once: {names}'
        )
    return tuple(names.index(name) for name in wanted or names)


def joint_values(
    row: Row, settings: Settings, robot: pfd.Robot, order: Sequence[int]
) -> tuple[float, ...]:
    """Return the numbers in use of a setting with one for each joint, in published order."""
    given: tuple[float, ...] = getattr(settings, row.field)
    default = row.joint_default
    if given or default is None:
        return given or (0.0,) * len(order)
    if isinstance(default, str):
        (other,) = (other for other in PER_JOINT if other.field == default)
        return joint_values(other, settings, robot, order)
    return tuple(default(settings, robot)[list(order)].tolist())


def split_joints(
    values: Mapping[str, Any],
) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
    """Return settings of all joints, and the numbers of single joints by field.

    `values` are by name; of single joints `friction.elbow_joint`, or `friction` with a mapping of
    joints. ValueError if a joint's number is none, or is given twice.
    """
    groups = {name: row for row in PER_JOINT for name in (row.field, row.name)}
    plain: dict[str, Any] = {}
    found: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        group, joints = name, value
        if name not in groups:
            group = max((x for x in groups if name.startswith(f'{x}.')), key=len, default='')
            joints = {name.removeprefix(f'{group}.'): value} if group else None
        if not isinstance(joints, Mapping):
            plain[name] = value
            continue
        table = found.setdefault(groups[group].field, {})
        for joint, number in joints.items():
            label = f'{groups[group].name}.{cut(str(joint))}'
            if joint in table:
                raise ValueError(f'{label} is given twice')
            table[joint] = typed(label, number, 'float')
    return plain, found


def with_joint_numbers(
    settings: Settings, robot: pfd.Robot, numbers: Mapping[str, Mapping[str, float]]
) -> Settings:
    """Return settings with the numbers of single joints by field; the other joints keep theirs.

    ValueError if the robot has no such joint.
    """
    order = joint_order(settings.joints, robot)
    names = [robot.joint_names[i] for i in order]
    for row in PER_JOINT:
        if row.field not in numbers:
            continue
        values = dict.fromkeys(names, 0.0)
        strange = [joint for joint in numbers[row.field] if joint not in values]
        if strange:
            raise ValueError(
                f'{row.name}.{cut(str(strange[0]))}: no such joint; joints are {listed(names)}'
            )
        if len(numbers[row.field]) < len(names):  # a convention may have none for so many joints
            values.update(zip(names, joint_values(row, settings, robot, order), strict=True))
        values.update(numbers[row.field])
        changed: dict[str, Any] = {row.field: tuple(values.values())}
        settings = dataclasses.replace(settings, **changed)
    return settings
