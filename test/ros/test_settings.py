# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings: checked once, the same in code, file and recording; numbers of single joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import dataclasses
from pathlib import Path
import re
from typing import Any

from arm_messages import change, made, verdict
import gripper_arm
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
import yaml

import pfd_core as pfd
from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.plant import scene_of
from pfd_ros.arm.plant_settings import EFFECT_FIELDS as ARM_EFFECT_FIELDS
from pfd_ros.arm.plant_settings import joint_settings
from pfd_ros.arm.settings import FIELDS as SETTING_ROWS
from pfd_ros.arm.settings import REMOVED as REMOVED_SETTINGS
from pfd_ros.arm.settings import Settings, split_joints, with_joint_numbers

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'sim_arm.yaml'


def flat(tree: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield each parameter of a file by its full name."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


# ---- one table


def test_the_shipped_file_holds_every_setting_at_its_default() -> None:
    text = CONFIG.read_text(encoding='utf-8')
    shipped = dict(flat(yaml.safe_load(text)['/**']['ros__parameters']))
    # Groups with a number for each joint have the names of its joints.
    names = {row.name: row.field for row in SETTING_ROWS if not row.per_joint}
    assert set(shipped) == set(names)
    values = {names[name]: value for name, value in shipped.items()}
    assert Settings.from_values(values) == Settings()


def test_the_shipped_file_names_every_number_of_a_joint_with_the_units_of_the_table() -> None:
    lines = re.findall(
        r'^    #   ([\w.]+)\.joint1: \S+ +(.*)$', CONFIG.read_text('utf-8'), re.MULTILINE
    )
    named = {name: comment.partition(', ')[0] for name, comment in lines}
    wanted = {}
    for field in ARM_EFFECT_FIELDS:
        for k, parameter in enumerate(joint_settings(field).values()):
            wanted[parameter] = field.units(k)
    assert named == wanted


def test_parameters_that_are_gone_are_no_settings_and_say_why() -> None:
    assert REMOVED_SETTINGS.keys() >= {'recording_max_size', 'payload_changes'}
    assert REMOVED_SETTINGS.keys().isdisjoint(row.name for row in SETTING_ROWS)
    assert all(REMOVED_SETTINGS.values())


# ---- values from outside


def test_settings_come_back_from_json_with_the_same_bits() -> None:
    awkward = Settings(
        robot='/tmp/a b.urdf',
        joints=('ä', 'b'),
        gravity=(0.1, -0.0, 5e-324),
        initial_positions=(1 / 3, -2e300),
        locked=('ä', '{0}'),
        locked_positions=(0.1 + 0.2, -0.0),
        step_size=0.0003,
        start_time=1.1,
        armature='estimated',
    )
    again = Settings.from_json(awkward.to_json())
    assert again == awkward
    assert str(again.gravity[1]) == '-0.0'


_DRAWN: dict[str, Any] = {
    'seed': st.integers(0, 2**63 - 1),
    'noise_effort': st.floats(0.0, 1e6),
    'bias_position': st.lists(st.floats(-1e6, 1e6), max_size=3).map(tuple),
    'servo_p': st.lists(st.floats(0.0, 1e9), max_size=3).map(tuple),
    'frame_id': st.text(st.characters(exclude_characters='\0'), max_size=9),
    'lockstep': st.booleans(),
    'drop_state': st.floats(0.0, 0.99),
}


@given(st.fixed_dictionaries({}, optional=_DRAWN))
def test_any_settings_come_back_from_json(values: dict[str, Any]) -> None:
    chosen = Settings(**values)
    assert Settings.from_json(chosen.to_json()) == chosen
    assert Settings.from_values(values) == chosen


WRONG: list[tuple[dict[str, Any], str]] = [
    ({'step_size': 0.0}, 'step_size is 0.0, expected 1e-05 to 0.1'),
    ({'step_size': float('nan')}, 'step_size holds nan, expected finite'),
    ({'step_size': 1 / 30000}, 'whole number of nanoseconds'),
    ({'substeps': 0}, 'substeps is 0, expected 1 to 100'),
    ({'gravity': (9.81,)}, 'gravity needs 3 numbers'),
    (
        {'payload_mass': 1.0, 'payload_inertia': (1.0, 0.0, 0.0, 0.1, 0.0, 0.1)},
        r'payload\.inertia is not physically consistent',
    ),
    ({'start_time': -0.5}, 'start_time is -0.5, expected -1 or 0.0 to'),
    ({'publish_rate': 300.0}, 'publish_rate is 300.0, which is 3.33333 steps of 0.001 s'),
    ({'position_sums': 'exact'}, "position_sums is 'exact', expected one of .*'plain'"),
    ({'colour': 'red'}, r"unknown settings \['colour'\]"),
    ({'real_time_factor': 5e-324}, 'real_time_factor is 5e-324, expected 0 or 1e-06'),
    ({'publish_rate': 5e-324}, 'publish_rate is 5e-324, which is .* expected a whole number'),
    ({'step_size': 10**400}, 'step_size is a number too large for a float'),
    ({'step_size': '0.001'}, 'step_size is .*0.001.*, expected a number'),
    ({'step_size': True}, 'step_size is True, expected a number'),
    ({'step_size': None}, 'step_size is NoneType, expected a number'),
    ({'substeps': 2.0}, 'substeps is 2.0, expected a whole number'),
    ({'damping': 1}, 'damping is 1, expected true or false, or a number by joint, damping.JOINT'),
    *(({'armature': value}, 'armature is') for value in ('model', 'yes', '', 1, 0.5, None)),
    ({'frame_id': 'a\0b'}, 'frame_id is .* no NUL'),
    ({'frame_id': '{' * (1 << 21)}, r'\(2097152 characters\)'),
    ({'joints': 'joint1'}, 'joints is .*joint1.*, expected a list'),
    ({'joints': ['a'] * 100_000}, 'joints holds 100000 values, expected 1000 at most'),
    ({'gravity': [[0.0]] * 3}, 'gravity is list, expected a number'),
    ({'locked': {'a': 1.0}}, 'locked is dict, expected a list'),
    ({'locked': ['a', 'a']}, 'locked has duplicates'),
    ({'locked': ['a'], 'locked_positions': [0.0, 1.0]}, r"holds 2 numbers, expected 1, .*'a'"),
    ({'locked_positions': [0.0]}, 'locked_positions holds 1 numbers, expected 0'),
    ({'outputs': ['pose']}, "outputs is 'pose', expected one of"),
    ({'time_source': 'clock'}, 'needs publish_clock false'),
    ({'delay_state': 0.0015}, r'delay\.state is 0\.0015, which is 1\.5 steps'),
    ({'scene': 'a.yaml', 'damping': True}, 'scene conflicts with damping'),
    ({'servo_p': [-1.0]}, r'servo_p is -1\.0, expected 0\.0 to'),
]


def test_a_wrong_setting_is_refused_and_named() -> None:
    for wrong, text in WRONG:
        with pytest.raises(ValueError, match=text) as refused:
            Settings.from_values(wrong)
        assert len(str(refused.value)) < 300


@pytest.mark.parametrize('text', ['1', 'null', '"a"', '[]', '{', '', '[' * 200_000])
def test_a_text_that_is_no_table_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r'expected|Expecting'):
        Settings.from_json(text)


# ---- what follows from them


@pytest.mark.parametrize(
    ('step_size', 'rate', 'every'),
    [(0.001, 0.0, 1), (0.001, 1000.0, 1), (0.001, 100.0, 10), (0.0003, 1 / 0.0009, 3)],
)
def test_a_rate_is_a_whole_number_of_steps(step_size: float, rate: float, every: int) -> None:
    chosen = Settings(step_size=step_size, publish_rate=rate, clock_rate=rate)
    assert (chosen.publish_every, chosen.clock_every) == (every, every)


@pytest.mark.parametrize(('rate', 'every'), [(0.0, 0), (50.0, 20), (30.0, 33), (1e5, 1)])
def test_the_rate_of_recorded_frames_is_rounded_to_steps(rate: float, every: int) -> None:
    assert Settings(recording_tf_rate=rate).tf_every == every


@pytest.mark.parametrize('stamp_ns', [0, 1, 123_456_789_012_345_678, 10**9 + 1])
def test_a_run_that_continues_begins_at_the_stamp_or_later(stamp_ns: int) -> None:
    start = Settings().started(7.0, stamp_ns).start_ns
    assert 0 <= start - stamp_ns < 1000
    later = Settings(start_time=2e8)
    assert later.started(7.0, stamp_ns).start_ns == max(start, later.start_ns)


def test_the_time_of_day_takes_the_place_of_minus_one_alone() -> None:
    assert Settings(start_time=-1.0).started(5.00049, 0).start_time == 5.0
    # A day in 2038: stamps end in the night after 18 January.
    assert Settings(start_time=-1.0).started(2_147_400_000.0, 0).start_time == 2_147_400_000.0
    assert Settings(start_time=3.0).started(5.0, 0).start_time == 3.0


@pytest.mark.parametrize(
    ('chosen', 'expected'),
    [
        ({}, 'wall'),
        ({'lockstep': True}, 'simulated'),
        ({'real_time_factor': 2.0}, 'simulated'),
        ({'time_source': 'clock', 'publish_clock': False}, 'simulated'),
        ({'lockstep': True, 'recording_time': 'wall'}, 'wall'),
        ({'recording_time': 'simulated'}, 'simulated'),
    ],
)
def test_the_time_base_of_a_recording_follows_the_run(chosen: dict, expected: str) -> None:
    assert Settings(**chosen).log_time == expected


# h lambda is 1.1 for the model's damping, without rotors: 'auto' is imex2, and rk4 is stable.
STIFF: dict[str, Any] = {'robot': 'puma560', 'damping': True, 'step_size': 0.0004}


@pytest.mark.parametrize(
    ('chosen', 'integrator', 'sums'),
    [
        ({'robot': 'planar2'}, 'rk4', 'compensated'),
        ({'robot': 'puma560'}, 'rk4', 'plain'),
        (STIFF, 'imex2', 'plain'),
        (STIFF | {'integrator': 'velocity_verlet'}, 'velocity_verlet', 'plain'),
        ({'robot': 'planar2', 'position_sums': 'plain'}, 'rk4', 'plain'),
    ],
)
def test_an_arm_states_the_choices_of_auto(chosen: dict, integrator: str, sums: str) -> None:
    resolved = made(**chosen).state.settings
    assert (resolved.integrator, resolved.position_sums) == (integrator, sums)
    assert resolved.method != 'auto'
    assert resolved.recording_time == 'wall'


# ---- changes while the arm runs


def test_a_dynamic_setting_changes_and_all_others_stay() -> None:
    engine = made(substeps=3)
    before = engine.state.settings
    assert verdict(engine, change(real_time_factor=0.5)).accepted
    assert engine.state.settings == dataclasses.replace(before, real_time_factor=0.5)


# ---- numbers of single joints

UR5 = pfd.load_robot('ur5')
# A number of one joint in each spelling.
SPELLINGS: list[dict[str, Any]] = [
    {'friction': {'elbow_joint': 3.0}},
    {'friction.elbow_joint': 3.0},
    {'joint_friction': {'elbow_joint': 3}},
    {'joint_friction': (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)},
]


def with_numbers(values: Mapping[str, Any], robot: pfd.Robot = UR5) -> Settings:
    """Return settings of values, with those of single joints."""
    plain, of_joints = split_joints(values)
    return with_joint_numbers(Settings.from_values(plain), robot, of_joints)


@pytest.mark.parametrize('values', SPELLINGS)
def test_the_number_of_one_joint_is_a_setting_in_each_spelling(values: dict[str, Any]) -> None:
    found = with_numbers(values)
    assert found.joint_friction == (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    assert scene_of(found, np.arange(6)) == pfd.Scene(friction=found.joint_friction, brakes=True)


def test_the_other_joints_keep_the_numbers_of_the_model() -> None:
    robot = pfd.load_robot('puma560')
    found = with_numbers({'friction': True, 'friction.joint2': 3.0}, robot)
    expected = robot.friction.copy()
    expected[1] = 3.0
    assert found.joint_friction == tuple(expected.tolist())


def test_numbers_of_joints_are_in_published_order() -> None:
    order = tuple(reversed(UR5.joint_names))
    found = with_numbers({'joints': order, 'damping.elbow_joint': 2.0, 'stiffness': {order[0]: 5}})
    assert found.joint_damping == (0.0, 0.0, 0.0, 2.0, 0.0, 0.0)
    scene = scene_of(found, np.arange(6)[::-1])
    assert np.asarray(scene.damping).tolist() == [0.0, 0.0, 2.0, 0.0, 0.0, 0.0]
    assert np.asarray(scene.stiffness).tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]


def test_joints_without_static_friction_of_their_own_have_their_friction() -> None:
    values = {'friction': {'elbow_joint': 2.0, 'wrist_1_joint': 1.0}}
    found = with_numbers(values | {'static_friction.elbow_joint': 3.0})
    assert found.joint_friction == (0.0, 0.0, 2.0, 1.0, 0.0, 0.0)
    assert found.static_friction == (0.0, 0.0, 3.0, 1.0, 0.0, 0.0)


def test_joints_with_neither_a_number_of_the_model_nor_their_own_are_warned_of() -> None:
    expected = r"for \['shoulder_pan_joint', .*wrist_3_joint'\]"
    with pytest.warns(pfd.PhysicsWarning, match=expected):
        made(robot='ur5', friction=True, joint_friction=(0.0, 0.0, 3.0, 0.0, 0.0, 0.0))


def test_the_cure_in_the_error_of_a_switch_is_a_setting() -> None:
    with pytest.raises(ValueError, match='states none for any joint') as refused:
        made(robot='ur5', friction=True)
    cure = str(refused.value).rpartition(' or ')[2]
    assert with_numbers({cure: 3.0}).joint_friction == (3.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'friction': {'elbow': 3.0}}, r'friction\.elbow: no such joint'),
        ({'friction.elbow': 3.0}, r'friction\.elbow: no such joint'),
        ({'friction.elbow_joint': 'much'}, r"friction\.elbow_joint is 'much', expected a number"),
        ({'friction.elbow_joint': -1.0}, r'friction is -1\.0, expected 0\.0'),
        (
            {'friction': {'elbow_joint': 1.0}, 'friction.elbow_joint': 1.0},
            r'friction\.elbow_joint is given twice',
        ),
        ({'joints': ['elbow_joint']}, 'expected each joint of'),
    ],
)
def test_wrong_numbers_of_single_joints_are_refused_and_named(
    values: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        with_numbers(values)


# ---- what the model gives


def test_the_model_of_settings_has_the_ends_and_locks_that_they_name() -> None:
    text = gripper_arm.urdf()
    whole = Settings(robot=text, locked=('finger',), tip_link='lower')
    assert load_arm_robot(whole, text).joint_names == gripper_arm.ARM
    short = Settings(robot=text, locked=('finger', 'elbow'), base_link='base')
    assert load_arm_robot(short, text).joint_names == ('shoulder',)
