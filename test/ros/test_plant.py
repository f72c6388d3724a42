# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm behind the topics, driven by bytes and without ROS."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from ros_processes import example_robot

import pfd_core as pfd
from pfd_ros.arm.commands import Verdict
from pfd_ros.arm.plant import Plant, Source, load_robot
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import (
    JointMessage,
    JointStateEncoder,
    decode_clock,
    decode_joint_state,
)

STEP_NS = 1_000_000


def plant(**chosen) -> Plant:
    settings = Settings(**chosen)
    return Plant(settings, load_robot(settings))


def named(names, effort) -> bytes:
    none = np.zeros(len(names))
    return JointStateEncoder(names).encode(0, none, none, np.array(effort, float))


def shown(arm: Plant) -> JointMessage:
    return decode_joint_state(arm.state())


def test_an_arm_nobody_commands_stays_exactly_where_it_starts() -> None:
    start = (0.1, -0.2, 0.3, 0.4, -0.5, 0.6)
    arm = plant(initial_positions=start, start_time=2.0)
    for _ in range(50):
        arm.advance()
    state = shown(arm)
    assert tuple(state.position) == start
    assert not state.velocity.any()
    assert not state.effort.any()
    assert state.stamp_ns == 2_000_000_000 + 50 * STEP_NS == decode_clock(arm.clock())


def test_only_the_joints_that_were_commanded_move() -> None:
    arm = plant()
    arm.receive(Source.NAMED, named(['joint2', 'joint5'], [3.0, 0.2]))
    for _ in range(20):
        arm.advance()
    state = shown(arm)
    assert [bool(v) for v in state.velocity] == [False, True, False, False, True, False]
    assert state.effort.tolist() == [0, 3.0, 0, 0, 0.2, 0]


def test_an_arm_that_is_free_follows_the_simulator_bit_for_bit() -> None:
    efforts = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]
    arm = plant(gravity=(0.0, 0.0, -1.62), damping=True, armature=True, substeps=3)
    arm.receive(Source.ARRAY, array(efforts))
    scene = pfd.Scene(gravity=(0.0, 0.0, -1.62), damping='model', armature='model', brakes=True)
    wanted = pfd.Simulator(pfd.load_robot('puma560'), scene, step_size=1e-3, substeps=3)
    for _ in range(100):
        arm.advance()
        wanted.step(efforts, brakes=np.zeros(6, bool))
    assert shown(arm).position.tobytes() == wanted.q.tobytes()
    assert shown(arm).velocity.tobytes() == wanted.qd.tobytes()


def array(efforts) -> bytes:
    """Return a Float64MultiArray: an empty layout, then the numbers."""
    from pfd_ros.messages.cdr import CdrWriter

    writer = CdrWriter()
    writer.uint32(0)
    writer.uint32(0)
    writer.numbers(np.array(efforts, float))
    return bytes(writer.data)


def test_the_order_of_the_joints_is_a_view_and_does_not_change_the_motion() -> None:
    straight = plant(initial_positions=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    names = straight.names[::-1]
    turned = plant(joints=names, initial_positions=(0.6, 0.5, 0.4, 0.3, 0.2, 0.1))
    straight.receive(Source.ARRAY, array([1, 2, 3, 0.4, 0.5, 0.6]))
    turned.receive(Source.ARRAY, array([0.6, 0.5, 0.4, 3, 2, 1]))
    for _ in range(50):
        straight.advance()
        turned.advance()
    assert shown(turned).names == names
    for field in ('position', 'velocity', 'effort'):
        one, other = getattr(shown(straight), field), getattr(shown(turned), field)
        assert one.tobytes() == other[::-1].tobytes()


def test_a_state_that_overflows_stops_the_arm_at_the_last_finite_one() -> None:
    arm = plant()
    arm.receive(Source.ARRAY, array([1e300] * 6))
    for _ in range(1000):
        before = shown(arm), arm.stamp_ns
        arm.advance()
        if arm.failure:
            break
    assert 'is not finite' in arm.failure
    for _ in range(3):
        arm.advance()
    after = shown(arm)
    assert arm.stamp_ns == after.stamp_ns == before[1]
    assert np.isfinite([after.position, after.velocity, after.effort]).all()
    assert after.position.tobytes() == before[0].position.tobytes()


def test_an_arm_with_a_gripper_has_the_masses_of_the_whole_file() -> None:
    urdf = example_robot('panda_description/urdf/panda.urdf')
    fingers = ('panda_finger_joint1', 'panda_finger_joint2')
    settings = Settings(robot=str(urdf), locked=fingers, locked_positions=(0.02, 0.02))
    robot = load_robot(settings)
    assert robot.joint_names == tuple(f'panda_joint{i}' for i in range(1, 8))
    masses = {
        link.get('name'): float(link.find('inertial/mass').get('value'))
        for link in ElementTree.parse(urdf).iter('link')
        if link.find('inertial/mass') is not None
    }
    del masses['panda_link0']
    np.testing.assert_allclose(robot.masses.sum(), sum(masses.values()), rtol=1e-12)
    arm = Plant(settings, robot)
    arm.receive(Source.ARRAY, array([1.0] * 7))
    arm.advance()
    assert shown(arm).velocity.all()


@pytest.mark.parametrize('source', list(Source))
@pytest.mark.parametrize('data', [b'', b'\x00\x01\x00\x00', b'\xff' * 40])
def test_bytes_that_are_no_message_do_nothing(source: Source, data: bytes) -> None:
    arm = plant()
    assert arm.receive(source, data).verdict is Verdict.MALFORMED


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'joints': ('joint1', 'elbow')}, r"joints is \['joint1', 'elbow'\], expected each joint"),
        ({'joints': ('joint1',) * 6}, 'expected each joint of .* once'),
        ({'initial_positions': (0.0,)}, 'initial_positions holds 1 numbers, expected 6'),
        ({'robot': 'r2d2'}, 'r2d2'),
        ({'integrator': 'euler'}, 'euler'),
        ({'method': 'magic'}, 'magic'),
        ({'tip_link': 'nowhere'}, 'nowhere'),
        ({'locked': ('{0}',)}, r'\{0\}'),
        ({'joints': ('x' * 9999,) * 1000}, '9999 characters.*and 992 more'),
    ],
)
def test_settings_that_do_not_go_with_the_robot_are_refused(wrong: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        plant(**wrong)
