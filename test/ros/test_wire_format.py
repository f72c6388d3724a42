# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of messages: rclpy, rosbags and this package read and write the same."""

from __future__ import annotations

from collections.abc import Callable
import functools
import importlib
import itertools
from operator import attrgetter
import re
import struct
from typing import Any

from bridge import (
    CLOCK_TYPE,
    FLOAT_ARRAY_TYPE,
    HEADER_TYPE,
    INERTIA_TYPE,
    INTEGER_ARRAY_TYPE,
    JOINT_STATE_FIELDS,
    JOINT_STATE_TYPE,
    POSE_TYPE,
    STAMPED_NUMBERS,
    WRENCH_TYPE,
    ArrayEncoder,
    JointStateEncoder,
    decode_array,
    decode_clock,
    decode_floats,
    decode_joint_state,
    decode_joint_states,
    decode_rows,
    decode_stamped,
    decode_string,
    effort_encoder,
    encode_clock,
    encode_rows,
    encode_string,
    stamped_encoder,
)
from hypothesis import event, given
from hypothesis import strategies as st
import numpy as np
from plant_messages import efforts
import pytest

STAMP = 12_345_678_901
TAKEN = ('step', 'source', 'sequence', 'verdict')
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
TEXTS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
NAMES = st.lists(TEXTS, max_size=7)
NUMBER = st.floats()
Reader = Callable[[bytes, str], Any]


def several(count: int) -> st.SearchStrategy[np.ndarray]:
    return st.lists(NUMBER, min_size=count, max_size=count).map(np.array)


@pytest.fixture(scope='module', params=['rclpy', 'rosbags'])
def read(request: pytest.FixtureRequest) -> Reader:
    """Return a library's reader of messages by their type; both have the fields of the type."""
    if request.param == 'rosbags':
        typesys = pytest.importorskip('rosbags.typesys')
        return typesys.get_typestore(typesys.Stores.ROS2_JAZZY).deserialize_cdr
    serialization = pytest.importorskip('rclpy.serialization')

    def deserialized(data: bytes, kind: str) -> Any:
        package, _, name = kind.split('/')
        message = getattr(importlib.import_module(f'{package}.msg'), name)
        return serialization.deserialize_message(data, message)

    return deserialized


@pytest.fixture(scope='module')
def write() -> Callable[[Any], bytes]:
    """Return rclpy's writer of messages."""
    return pytest.importorskip('rclpy.serialization').serialize_message


def stamp_ns(message: Any) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def bits(values: Any) -> bytes:
    return np.array(values, np.float64).tobytes()


@given(st.data(), STAMPS, TEXTS, NAMES)
def test_others_read_the_states_we_write(
    read: Reader, data: st.DataObject, stamp: int, frame_id: str, names: list[str]
) -> None:
    arrays = [data.draw(several(len(names))) for _ in range(3)]
    encoder = JointStateEncoder(names, frame_id)
    written = encoder.encode(stamp, *arrays)
    message = read(written, JOINT_STATE_TYPE)
    assert (stamp_ns(message), message.header.frame_id) == (stamp, frame_id)
    assert list(message.name) == names
    for got, wanted in zip(
        (message.position, message.velocity, message.effort), arrays, strict=True
    ):
        assert bits(got) == bits(wanted)
    # Whatever was written between.
    encoder.encode(0, *arrays[::-1])
    assert encoder.encode(stamp, *arrays) == written


@given(STAMPS, TEXTS, NAMES, st.tuples(*[st.lists(NUMBER, max_size=4)] * 3))
def test_we_read_any_joint_state_that_rclpy_writes(
    write: Callable[[Any], bytes],
    stamp: int,
    frame_id: str,
    names: list[str],
    arrays: tuple[list[float], ...],
) -> None:
    from sensor_msgs.msg import JointState

    message = JointState(name=names, position=arrays[0], velocity=arrays[1], effort=arrays[2])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id = frame_id
    got = decode_joint_state(write(message))
    assert (got.stamp_ns, got.frame_id, got.names) == (stamp, frame_id, tuple(names))
    for values, wanted in zip((got.position, got.velocity, got.effort), arrays, strict=True):
        assert bits(values) == bits(wanted)


@given(st.lists(TEXTS, max_size=3), st.lists(NUMBER, max_size=5))
def test_we_read_arrays_with_any_layout(
    write: Callable[[Any], bytes], labels: list[str], values: list[float]
) -> None:
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    message = Float64MultiArray(data=values)
    message.layout.dim = [MultiArrayDimension(label=x, size=3, stride=3) for x in labels]
    written = write(message)
    assert bits(decode_floats(written)) == bits(values)
    got = decode_array(written)
    assert (got.labels, got.sizes) == (tuple(labels), (3,) * len(labels))


# The numbers of each type below its header, as the libraries name them.
FIELDS = {
    POSE_TYPE: attrgetter(
        *(f'pose.position.{axis}' for axis in 'xyz'),
        *(f'pose.orientation.{axis}' for axis in 'xyzw'),
    ),
    WRENCH_TYPE: attrgetter(
        *(f'wrench.{part}.{axis}' for part in ('force', 'torque') for axis in 'xyz')
    ),
    INERTIA_TYPE: attrgetter(
        'inertia.m',
        *(f'inertia.com.{axis}' for axis in 'xyz'),
        *(f'inertia.i{axes}' for axes in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')),
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize('kind', STAMPED_NUMBERS)
@given(st.data(), STAMPS, TEXTS)
def test_others_read_headed_numbers_as_we_write_them_and_so_do_we(
    read: Reader, kind: str, data: st.DataObject, stamp: int, frame_id: str
) -> None:
    numbers = data.draw(several(len(STAMPED_NUMBERS[kind])))
    written = stamped_encoder(kind, frame_id).encode(stamp, numbers)
    message = read(written, kind)
    assert (stamp_ns(message), message.header.frame_id) == (stamp, frame_id)
    assert bits(FIELDS[kind](message)) == bits(numbers)
    got = decode_stamped(written, kind)
    assert (got.stamp_ns, got.frame_id, bits(got.values)) == (stamp, frame_id, bits(numbers))


@given(st.data(), NAMES, TEXTS)
def test_others_read_states_of_efforts_alone(
    read: Reader, data: st.DataObject, names: list[str], frame_id: str
) -> None:
    efforts = data.draw(several(len(names)))
    message = read(effort_encoder(names, frame_id).encode(STAMP, efforts), JOINT_STATE_TYPE)
    assert (message.header.frame_id, list(message.name)) == (frame_id, names)
    assert (len(message.position), len(message.velocity)) == (0, 0)
    assert bits(message.effort) == bits(efforts)


def test_others_read_the_arrays_we_write_with_their_layout_and_so_do_we(read: Reader) -> None:
    values = np.arange(6.0).reshape(2, 3)
    layout = [('row', ('x', 'yy')), ('column', ('a', 'b', 'c'))]
    data = ArrayEncoder(layout).encode(values)
    message = read(data, FLOAT_ARRAY_TYPE)
    dimensions = [(d.label, d.size, d.stride) for d in message.layout.dim]
    assert dimensions == [('row: x,yy', 2, 6), ('column: a,b,c', 3, 3)]
    assert list(message.data) == values.reshape(-1).tolist()
    got = decode_array(data)
    assert (got.labels, got.sizes) == (('row: x,yy', 'column: a,b,c'), (2, 3))
    assert got.values.tolist() == values.reshape(-1).tolist()


@given(st.lists(st.lists(st.integers(0, 2**64 - 1), min_size=4, max_size=4), max_size=4))
def test_others_read_the_rows_we_write_and_so_do_we(read: Reader, rows: list[list[int]]) -> None:
    data = encode_rows(rows, TAKEN)
    message = read(data, INTEGER_ARRAY_TYPE)
    assert list(message.data) == list(itertools.chain(*rows))
    assert [d.size for d in message.layout.dim] == [len(rows), len(TAKEN)]
    assert message.layout.dim[1].label == 'step,source,sequence,verdict'
    assert decode_rows(data, len(TAKEN)) == rows


@given(STAMPS)
def test_others_read_the_clock_we_write_and_so_do_we(read: Reader, stamp: int) -> None:
    message = read(encode_clock(stamp), CLOCK_TYPE)
    assert message.clock.sec * 10**9 + message.clock.nanosec == stamp
    assert decode_clock(encode_clock(stamp)) == stamp


def test_a_message_from_a_big_endian_machine_is_read() -> None:
    data = b'\x00\x00\x00\x00' + struct.pack('>II', 0, 0) + struct.pack('>I', 1)
    # Eight-byte numbers begin at a multiple of eight after the header: four bytes of padding.
    data += bytes(4) + struct.pack('>d', 2.5)
    assert decode_floats(data).tolist() == [2.5]


def test_a_message_that_ends_early_is_refused_wherever_it_ends() -> None:
    q = np.array([1.0, 2.0])
    data = JointStateEncoder(['a', 'b'], 'base').encode(STAMP, q, q, q)
    for size in range(len(data)):
        with pytest.raises(ValueError, match=r'message (ends at byte|begins with)'):
            decode_joint_state(data[:size])


@pytest.mark.parametrize('head', [b'\x00\x03\x00\x00', b'\x00\x0b\x00\x00', b'ab'])
def test_an_encoding_other_than_plain_cdr_is_refused(head: bytes) -> None:
    with pytest.raises(ValueError, match='expected plain CDR'):
        decode_floats(head + bytes(12))


def test_rows_that_do_not_fill_up_are_refused() -> None:
    data = encode_rows([[1, 2, 3]], ('a', 'b', 'c'))
    with pytest.raises(ValueError, match='3 numbers, expected whole rows of 4'):
        decode_rows(data, 4)


def joint_state(names: bytes) -> bytes:
    """Return a JointState at time 0 in frame '' whose sequence of names is given as bytes."""
    return HEADER_TYPE + bytes(8) + struct.pack('<I', 1) + bytes(4) + names


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
def test_a_malformed_string_or_sequence_is_refused(names: bytes, expected: str) -> None:
    with pytest.raises(ValueError, match=expected) as error:
        decode_joint_state(joint_state(names))
    assert type(error.value) is ValueError


def test_an_empty_string_may_come_without_its_zero() -> None:
    got = decode_joint_state(joint_state(struct.pack('<III', 2, 0, 0) + bytes(12)))
    assert got.names == ('', '')


# Each decoder, and a message for it.
DECODERS: dict[str, tuple[Callable[[bytes], object], bytes]] = {
    'state': (
        decode_joint_state,
        JointStateEncoder(['a', 'bcd'], 'base').encode(STAMP, *np.ones((3, 2))),
    ),
    'array': (
        decode_array,
        ArrayEncoder([('row', ('x', 'yy'))]).encode(np.zeros(2)),
    ),
    'floats': (decode_floats, efforts(1.0, 2.0)),
    'rows': (
        functools.partial(decode_rows, width=4),
        encode_rows([[1, 2, 3, 4]], TAKEN),
    ),
    'clock': (decode_clock, encode_clock(STAMP)),
    'text': (decode_string, encode_string('wört')),
    **{
        kind: (
            functools.partial(decode_stamped, kind=kind),
            stamped_encoder(kind, 'b').encode(STAMP, np.zeros(len(STAMPED_NUMBERS[kind]))),
        )
        for kind in STAMPED_NUMBERS
    },
}


@st.composite
def strange_bytes(draw: st.DrawFn, whole: bytes) -> bytes:
    """Draw bytes behind a header, or a message with a few bytes changed, and perhaps cut off."""
    data = bytearray(whole)
    change = draw(st.sampled_from(('alter', 'alter', 'cut', 'invent')))
    if change == 'invent':
        # Small numbers: nearly every other length is too large.
        body = draw(st.lists(st.sampled_from((0, 0, 0, 0, 1, 2, 4, 255)), max_size=90))
        return draw(st.sampled_from((HEADER_TYPE, bytes(4), b''))) + bytes(body)
    for _ in range(draw(st.integers(1, 3))):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data if change == 'alter' else data[: draw(st.integers(0, len(data)))])


@pytest.mark.parametrize('decoder', DECODERS)
@given(st.data())
def test_garbage_is_read_or_refused_with_a_value_error(decoder: str, data: st.DataObject) -> None:
    decode, whole = DECODERS[decoder]
    decode(whole)
    try:
        decode(data.draw(strange_bytes(whole)))
    except ValueError:
        event('refused')
    else:
        event('read')


@given(st.data(), st.booleans())
def test_joint_states_read_together_are_those_read_one_by_one(
    data: st.DataObject, altered: bool
) -> None:
    encoder = JointStateEncoder(['a', 'b'], 'base')
    messages = [encoder.encode(k * STAMP, *np.full((3, 2), k / 3)) for k in range(3)]
    if altered:
        messages[data.draw(st.integers(0, 2))] = data.draw(strange_bytes(messages[0]))
    try:
        found = decode_joint_states(messages)
    except ValueError as error:
        with pytest.raises(ValueError, match=re.escape(str(error))):
            decode_joint_state(messages[0])
        return
    if found is None:
        event('differ')
        assert altered
        return
    single = [decode_joint_state(message) for message in messages]
    assert {one.names for one in single} == {found.names}
    assert [one.stamp_ns for one in single] == found.stamps_ns.tolist()
    for name in JOINT_STATE_FIELDS:
        assert bits([getattr(one, name) for one in single]) == bits(getattr(found, name))


@pytest.mark.parametrize('nanoseconds', [1_000_000_000, 2**32 - 1])
def test_a_time_with_a_second_or_more_of_nanoseconds_is_refused_in_every_message(
    nanoseconds: int,
) -> None:
    messages = {
        decode_clock: encode_clock(STAMP),
        decode_joint_state: JointStateEncoder(['a']).encode(STAMP, *np.zeros((3, 1))),
        **{
            functools.partial(decode_stamped, kind=kind): stamped_encoder(kind, 'base').encode(
                STAMP, np.zeros(len(STAMPED_NUMBERS[kind]))
            )
            for kind in STAMPED_NUMBERS
        },
    }
    for decode, data in messages.items():
        decode(data)
        strange = data[:8] + struct.pack('<I', nanoseconds) + data[12:]
        with pytest.raises(ValueError, match=f'nanosec of a time is {nanoseconds}, expected 0 to'):
            decode(strange)
