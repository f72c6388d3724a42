# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Locked joints, such as those of a gripper, are seen like others and obey nobody."""

from __future__ import annotations

import functools
import json
from pathlib import Path

from bridge import (
    Arrival,
    DifferenceError,
    LockstepArm,
    Source,
    Verdict,
    decode_joint_state,
    read_motion,
    read_recording,
)
import numpy as np
import plant_messages
from plant_messages import efforts, joint_state
import pytest
from simulating import simulate, states_of
from zoo import joint, link, urdf

# The wrist of a puma, welded.
WRIST = {'locked': ('joint6', 'joint5'), 'locked_positions': (0.25, -0.5)}
ONE = [1.0, 2.0, 3.0, 4.0]


made = functools.partial(plant_messages.made, robot='puma560')


def joint_command(names: list[str], effort: list[float]) -> Arrival:
    return Arrival(Source.NAMED, 1, joint_state(names, effort=effort))


def test_locked_joints_are_published_after_the_others_at_rest_where_they_are_locked() -> None:
    engine = made(joints=('joint4', 'joint1', 'joint2', 'joint3'), **WRIST)
    engine.take([Arrival(Source.ARRAY, 1, efforts(*ONE))])
    for _ in range(5):
        states = [decode_joint_state(o.data) for o in engine.step() if o.role == 'joint_states']
    (state,) = states
    assert state.names == ('joint4', 'joint1', 'joint2', 'joint3', 'joint6', 'joint5')
    assert state.position[4:].tolist() == [0.25, -0.5]
    assert state.velocity[4:].tolist() == state.effort[4:].tolist() == [0.0, 0.0]
    assert state.effort[:4].tolist() == ONE
    assert state.velocity[:4].all()


def test_the_cure_for_a_tree_locks_joints_within_their_limits() -> None:
    far = '<limit lower="0.5" upper="1" velocity="3" effort="40"/>'
    body = '0.02 0.03 0.025 0 0 0'
    tree = urdf(
        'tree',
        *(link('base'), link('a', 1.0, J=body), link('b', 1.0, J=body), link('c', 1.0, J=body)),
        joint('turn', 'revolute', 'base', 'a'),
        joint('left', 'revolute', 'a', 'b', extra=far),
        joint('right', 'revolute', 'a', 'c', extra=far),
    )
    with pytest.raises(ValueError, match='is a tree') as refused:
        LockstepArm(tree)
    cure = '-p locked:=[left,right] -p locked_positions:=[0.5,0.5]'
    assert str(refused.value).endswith(cure)
    with LockstepArm(tree, locked=('left', 'right'), locked_positions=(0.5, 0.5)) as arm:
        assert arm.robot.joint_names == ('turn',)


def test_locked_joints_can_be_left_out_of_the_states() -> None:
    engine = made(publish_locked=False, **WRIST)
    (state,) = (decode_joint_state(o.data) for o in engine.step() if o.role == 'joint_states')
    assert state.names == ('joint1', 'joint2', 'joint3', 'joint4')


def test_a_command_for_a_locked_joint_moves_the_others_and_is_not_unknown() -> None:
    engine = made(**WRIST)
    command = joint_command(['joint5', 'joint1', 'nobody'], [9.0, 1.0, 9.0])
    ((_, found, _),) = engine.take([command]).validations
    assert found.verdict is Verdict.ACCEPTED
    (state,) = (decode_joint_state(o.data) for o in engine.step() if o.role == 'joint_states')
    assert state.effort.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert (found.locked, found.unknown, found.unknown_count) == (('joint5',), ('nobody',), 1)


@pytest.mark.parametrize('names', [['joint5'], ['joint6', 'joint5'], ['joint5', 'nobody']])
def test_a_command_for_locked_joints_alone_is_refused(names: list[str]) -> None:
    found = made(**WRIST).validate(joint_command(names, [1.0] * len(names)))
    assert found.verdict is Verdict.REFUSED
    assert 'joint5' in found.detail
    assert found.locked == tuple(name for name in names if name != 'nobody')


def test_nan_for_the_joints_that_move_is_no_command_whatever_locked_joints_get() -> None:
    found = made(**WRIST).validate(joint_command(['joint1', 'joint5'], [float('nan'), 1.0]))
    assert found.verdict is Verdict.ALL_NAN


def test_nan_for_a_locked_joint_is_no_command_for_it() -> None:
    # Hardware sends NaN for a gripper that no controller has claimed.
    engine, nan = made(**WRIST), float('nan')
    found = engine.validate(joint_command(['joint1', 'joint5'], [1.0, nan]))
    assert (found.verdict, found.locked) == (Verdict.ACCEPTED, ())
    for names in (['joint5'], ['joint1', 'joint5']):
        found = engine.validate(joint_command(names, [nan] * len(names)))
        assert (found.verdict, found.locked) == (Verdict.ALL_NAN, ())


def test_names_of_locked_joints_that_are_not_published_stay_unknown() -> None:
    engine = made(publish_locked=False, **WRIST)
    found = engine.validate(joint_command(['joint5'], [1.0]))
    assert (found.verdict, found.locked) == (Verdict.UNKNOWN_NAMES, ())


def test_a_state_of_the_arm_can_be_sent_back_with_its_locked_joints() -> None:
    engine = made(**WRIST)
    names = ('joint1', 'joint2', 'joint3', 'joint4', 'joint6', 'joint5')
    sent = joint_state(names, np.arange(1.0, 7.0), np.zeros(6))
    engine.take([Arrival(Source.SET_STATE, 1, sent)])
    (state,) = (decode_joint_state(o.data) for o in engine.step() if o.role == 'joint_states')
    assert state.position.tolist() == [1.0, 2.0, 3.0, 4.0, 0.25, -0.5]


@pytest.mark.parametrize('published', [True, False])
def test_recordings_with_locked_joints_verify_and_have_a_motion(
    published: bool, tmp_path: Path
) -> None:
    made = simulate(30, {3: [efforts(*ONE)]}, robot='puma560', publish_locked=published, **WRIST)
    path = made.save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).states == 30
    motion = read_motion(path).motion
    assert np.asarray(motion.q).shape[1] == 4
    np.testing.assert_array_equal(motion.q[-1], states_of(path)[28].position[:4])


def test_sensors_add_nothing_to_locked_joints_and_such_a_recording_verifies(
    tmp_path: Path,
) -> None:
    noise = {'noise_position': 1e-3, 'noise_velocity': 1e-3, 'noise_effort': 1e-3}
    made = simulate(30, {3: [efforts(*ONE)]}, robot='puma560', **noise, **WRIST)
    path = made.save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).states == 30
    for state in states_of(path):
        assert state.position[4:].tolist() == [0.25, -0.5]
        assert state.velocity[4:].tolist() == state.effort[4:].tolist() == [0.0, 0.0]
    assert states_of(path)[0].position[:4].all()
    # A motion is that of the arm, not what its sensors say.
    assert not read_motion(path).motion.q[1].any()


def test_a_recording_whose_settings_publish_other_joints_is_refused(tmp_path: Path) -> None:
    made = simulate(30, {3: [efforts(*ONE)]}, robot='puma560', publish_locked=False, **WRIST)
    (head,) = (values for name, values in made.metadata if name == 'pfd_ros')
    settings = json.loads(head['settings'])
    assert settings['publish_locked'] is False
    assert read_recording(made.save(tmp_path / 'a.mcap'), verify=True).states == 30
    settings['publish_locked'] = True
    head['settings'] = json.dumps(settings)
    with pytest.raises(DifferenceError, match='names: recorded'):
        read_recording(made.save(tmp_path / 'b.mcap'), verify=True)
