# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of messages: rclpy, rosbags and this package read and write the same."""

from __future__ import annotations

import contextlib
import functools
import itertools
import random
import struct

import numpy as np
import pytest

from pfd_ros.messages import convert
from pfd_ros.messages.stamped import NUMBERS, decode_stamped, effort_encoder, stamped_encoder

STAMP = 12_345_678_901
TAKEN = ('step', 'source', 'sequence', 'verdict')


@pytest.fixture(scope='module')
def ros() -> object:
    pytest.importorskip('rclpy')
    from rclpy import serialization

    return serialization


@pytest.mark.parametrize('count', [0, 1, 2, 7])
@pytest.mark.parametrize('frame_id', ['', 'b', 'base', 'base_link', 'Grundgestell µ'])
def test_rclpy_reads_the_states_we_write(ros, count: int, frame_id: str) -> None:
    from sensor_msgs.msg import JointState

    names = [f'joint{"x" * i}' for i in range(count)]
    q, qd, tau = np.random.default_rng(1).normal(size=(3, count))
    data = convert.JointStateEncoder(names, frame_id).encode(STAMP, q, qd, tau)
    message = ros.deserialize_message(data, JointState)
    stamp = message.header.stamp
    assert (stamp.sec, stamp.nanosec) == (12, 345_678_901)
    assert (message.header.frame_id, message.name) == (frame_id, names)
    for got, wanted in ((message.position, q), (message.velocity, qd), (message.effort, tau)):
        assert np.array(got).tobytes() == wanted.tobytes()


@pytest.mark.parametrize('lengths', list(itertools.product([0, 1, 3], repeat=4)))
def test_we_read_any_joint_state_that_rclpy_writes(ros, lengths: tuple[int, ...]) -> None:
    from sensor_msgs.msg import JointState

    names = ['a', 'bcd', 'é'][: lengths[0]]
    arrays = [[0.5 + i, float('nan'), float('-inf')][:length] for i, length in enumerate(lengths)]
    message = JointState(name=names, position=arrays[1], velocity=arrays[2], effort=arrays[3])
    message.header.stamp.sec = -2
    got = convert.decode_joint_state(ros.serialize_message(message))
    assert (got.stamp_ns, got.frame_id, got.names) == (-2_000_000_000, '', tuple(names))
    for values, wanted in zip((got.position, got.velocity, got.effort), arrays[1:], strict=True):
        np.testing.assert_array_equal(values, wanted)


@pytest.mark.parametrize('dimensions', [0, 1, 2])
def test_we_read_arrays_with_any_layout(ros, dimensions: int) -> None:
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    message = Float64MultiArray(data=[1.5, -2.5, float('inf')])
    message.layout.dim = [
        MultiArrayDimension(label='x' * (k + 1), size=3, stride=3) for k in range(dimensions)
    ]
    got = convert.decode_floats(ros.serialize_message(message))
    assert got.tolist() == [1.5, -2.5, float('inf')]


@pytest.mark.parametrize('frame_id', ['', 'b', 'base', 'tool0'])
def test_rclpy_reads_poses_and_wrenches_as_we_write_them_and_so_do_we(ros, frame_id: str) -> None:
    from geometry_msgs.msg import PoseStamped, WrenchStamped

    numbers = np.arange(1.5, 8.0)
    data = stamped_encoder(convert.POSE, frame_id).encode(STAMP, numbers)
    pose = ros.deserialize_message(data, PoseStamped)
    wrench = ros.deserialize_message(
        stamped_encoder(convert.WRENCH, frame_id).encode(STAMP, numbers[:6]), WrenchStamped
    )
    for message in (pose, wrench):
        assert (message.header.stamp.sec, message.header.frame_id) == (12, frame_id)
    position, turn = pose.pose.position, pose.pose.orientation
    assert [position.x, position.y, position.z] == [1.5, 2.5, 3.5]
    assert [turn.x, turn.y, turn.z, turn.w] == [4.5, 5.5, 6.5, 7.5]
    force, torque = wrench.wrench.force, wrench.wrench.torque
    assert [force.x, force.y, force.z, torque.x, torque.y, torque.z] == numbers[:6].tolist()
    got = decode_stamped(ros.serialize_message(pose), convert.POSE)
    assert (got.stamp_ns, got.frame_id, got.values.tolist()) == (STAMP, frame_id, numbers.tolist())


@pytest.mark.parametrize('count', [1, 2, 7])
def test_rclpy_reads_states_of_efforts_alone(ros, count: int) -> None:
    from sensor_msgs.msg import JointState

    names = [f'joint{"x" * i}' for i in range(count)]
    data = effort_encoder(names, 'base').encode(STAMP, np.arange(count) + 0.5)
    message = ros.deserialize_message(data, JointState)
    assert (message.header.frame_id, message.name) == ('base', names)
    assert (len(message.position), len(message.velocity)) == (0, 0)
    assert list(message.effort) == [i + 0.5 for i in range(count)]


def test_rclpy_reads_the_arrays_we_write_with_their_layout_and_so_do_we(ros) -> None:
    from std_msgs.msg import Float64MultiArray

    values = np.arange(6.0).reshape(2, 3)
    layout = [('row', ('x', 'yy')), ('column', ('a', 'b', 'c'))]
    data = convert.ArrayEncoder(layout).encode(values)
    message = ros.deserialize_message(data, Float64MultiArray)
    dimensions = [(d.label, d.size, d.stride) for d in message.layout.dim]
    assert dimensions == [('row: x,yy', 2, 6), ('column: a,b,c', 3, 3)]
    assert list(message.data) == values.reshape(-1).tolist()
    got = convert.decode_array(data)
    assert (got.labels, got.sizes) == (('row: x,yy', 'column: a,b,c'), (2, 3))
    assert got.values.tolist() == values.reshape(-1).tolist()


@pytest.mark.parametrize('rows', [[], [[1, 0, 1, 0]], [[2**40, 1, 2, 3], [5, 6, 7, 8]]])
def test_rclpy_reads_the_rows_we_write_and_so_do_we(ros, rows: list[list[int]]) -> None:
    from std_msgs.msg import UInt64MultiArray

    data = convert.encode_rows(rows, TAKEN)
    message = ros.deserialize_message(data, UInt64MultiArray)
    assert list(message.data) == list(itertools.chain(*rows))
    assert [d.size for d in message.layout.dim] == [len(rows), len(TAKEN)]
    assert message.layout.dim[1].label == 'step,source,sequence,verdict'
    assert convert.decode_rows(data, len(TAKEN)) == rows


def test_rclpy_reads_the_clock_we_write_and_so_do_we(ros) -> None:
    from rosgraph_msgs.msg import Clock

    message = ros.deserialize_message(convert.encode_clock(STAMP), Clock)
    assert (message.clock.sec, message.clock.nanosec) == (12, 345_678_901)
    assert convert.decode_clock(convert.encode_clock(STAMP)) == STAMP


def test_rosbags_reads_the_states_we_write() -> None:
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    q = np.array([0.1, -0.0, 5e-324])
    data = convert.JointStateEncoder(['a', 'b', 'c'], 'base').encode(STAMP, q, q, q)
    message = store.deserialize_cdr(data, convert.JOINT_STATE)
    assert message.position.tobytes() == q.tobytes()
    assert message.header.stamp.nanosec == 345_678_901


def test_the_same_state_is_always_the_same_bytes() -> None:
    q = np.array([1.0, 2.0])
    first, other = (convert.JointStateEncoder(['left', 'r'], 'base') for _ in range(2))
    wanted = first.encode(STAMP, q, -q, q)
    first.encode(0, -q, q, q)
    assert first.encode(STAMP, q, -q, q) == wanted == other.encode(STAMP, q, -q, q)


def test_a_message_from_a_big_endian_machine_is_read() -> None:
    data = b'\x00\x00\x00\x00' + struct.pack('>II', 0, 0) + struct.pack('>I', 1)
    # Eight-byte numbers begin at a multiple of eight after the header: four bytes of padding.
    data += bytes(4) + struct.pack('>d', 2.5)
    assert convert.decode_floats(data).tolist() == [2.5]


def test_a_message_that_ends_early_is_refused_wherever_it_ends() -> None:
    q = np.array([1.0, 2.0])
    data = convert.JointStateEncoder(['a', 'b'], 'base').encode(STAMP, q, q, q)
    for size in range(len(data)):
        with pytest.raises(ValueError, match=r'message (ends at byte|begins with)'):
            convert.decode_joint_state(data[:size])


@pytest.mark.parametrize('head', [b'\x00\x03\x00\x00', b'\x00\x0b\x00\x00', b'ab'])
def test_an_encoding_other_than_plain_cdr_is_refused(head: bytes) -> None:
    with pytest.raises(ValueError, match='expected plain CDR'):
        convert.decode_floats(head + bytes(12))


def test_rows_that_do_not_fill_up_are_refused() -> None:
    data = convert.encode_rows([[1, 2, 3]], ('a', 'b', 'c'))
    with pytest.raises(ValueError, match='3 numbers, expected whole rows of 4'):
        convert.decode_rows(data, 4)


def joint_state(names: bytes) -> bytes:
    """Return a JointState at time 0 in frame '' whose sequence of names is given as bytes."""
    return convert.HEADER + bytes(8) + struct.pack('<I', 1) + bytes(4) + names


@pytest.mark.parametrize(
    ('names', 'expected'),
    [
        (struct.pack('<II', 1, 3) + b'abc' + bytes(13), 'expected a closing zero'),
        (struct.pack('<II', 1, 3) + b'\xff\xfe\0' + bytes(13), 'expected UTF-8'),
        (struct.pack('<II', 1, 1 << 31) + bytes(16), 'message ends at byte'),
        (struct.pack('<I', (1 << 32) - 1) + bytes(16), 'expected 4294967295 elements'),
        (struct.pack('<I', 5) + bytes(16), 'expected 5 elements of 4 bytes'),
        (struct.pack('<II', 0, (1 << 32) - 1) + bytes(16), 'expected 4294967295 elements of 8'),
        (struct.pack('<II', 0, 3) + bytes(23), 'message ends at byte'),
    ],
)
def test_a_string_or_sequence_that_is_none_is_refused(names: bytes, expected: str) -> None:
    with pytest.raises(ValueError, match=expected) as error:
        convert.decode_joint_state(joint_state(names))
    assert type(error.value) is ValueError


def test_an_empty_string_may_come_without_its_zero() -> None:
    got = convert.decode_joint_state(joint_state(struct.pack('<III', 2, 0, 0) + bytes(12)))
    assert got.names == ('', '')


def test_garbage_is_refused_with_a_value_error_and_nothing_else() -> None:
    draw = random.Random(3)
    decoders = (
        convert.decode_joint_state,
        convert.decode_floats,
        convert.decode_clock,
        lambda data: convert.decode_rows(data, 4),
    )
    read = 0
    for _ in range(3000):
        # Small numbers, or nearly everything would be a length that is too large.
        data = bytes(draw.choice((0, 0, 0, 0, 1, 2, 4, 255)) for _ in range(draw.randrange(90)))
        data = draw.choice((convert.HEADER, bytes(4), b'')) + data
        for decode in decoders:
            with contextlib.suppress(ValueError):
                decode(data)
                read += 1
    assert 500 < read < 6000


@pytest.mark.parametrize('nanoseconds', [1_000_000_000, 2**32 - 1])
def test_a_time_with_a_second_or_more_of_nanoseconds_is_refused_in_every_message(
    nanoseconds: int,
) -> None:
    messages = {
        convert.decode_clock: convert.encode_clock(STAMP),
        convert.decode_joint_state: convert.JointStateEncoder(['a']).encode(
            STAMP, *np.zeros((3, 1))
        ),
        **{
            functools.partial(decode_stamped, kind=kind): stamped_encoder(kind, 'base').encode(
                STAMP, np.zeros(len(NUMBERS[kind]))
            )
            for kind in NUMBERS
        },
    }
    for decode, data in messages.items():
        decode(data)
        strange = data[:8] + struct.pack('<I', nanoseconds) + data[12:]
        with pytest.raises(ValueError, match=f'nanosec of a time is {nanoseconds}, expected 0 to'):
            decode(strange)
