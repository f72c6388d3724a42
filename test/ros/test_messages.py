# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of messages: rclpy, rosbags and this package read and write the same."""

from __future__ import annotations

from collections.abc import Callable
import functools
import importlib
import json
from operator import attrgetter
from pathlib import Path
import struct
import sys
from typing import Any

from hypothesis import event, given
from hypothesis import strategies as st
import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
import yaml

from pfd_ros.messages.cdr import HEADER
from pfd_ros.messages.columns import Decoder, type_hash
from pfd_ros.messages.columns import definition_of as definition_text
from pfd_ros.messages.columns import joined as joined_columns
from pfd_ros.messages.joints import JOINT_FIELDS, decode_joints, encode_joints, joint_encoder
from pfd_ros.messages.qos import Qos, offered_qos, qos_text
from pfd_ros.messages.types import CLOCK as CLOCK_TYPE
from pfd_ros.messages.types import FLOAT_ARRAY as FLOAT_ARRAY_TYPE
from pfd_ros.messages.types import JOINT_STATE as JOINT_STATE_TYPE
from pfd_ros.messages.types import STRING as STRING_TYPE
from pfd_ros.messages.types import TRANSFORMS as TRANSFORMS_TYPE
from pfd_ros.messages.values import NUMBERS as MESSAGE_NUMBERS
from pfd_ros.messages.values import (
    array_encoder,
    decode_clock,
    decode_floats,
    decode_numbers,
    decode_string,
    encode_clock,
    encode_floats,
    encode_numbers,
    encode_string,
    numbers_encoder,
    transform_encoder,
)

STAMP = 12_345_678_901
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
TEXTS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
NAMES = st.lists(TEXTS, max_size=7)
NUMBER = st.floats()
STORE = get_typestore(Stores.ROS2_JAZZY)
Reader = Callable[[bytes, str], Any]


def several(*shape: int) -> st.SearchStrategy[np.ndarray]:
    count = int(np.prod(shape))
    numbers = st.lists(NUMBER, min_size=count, max_size=count)
    return numbers.map(lambda values: np.array(values, float).reshape(shape))


@pytest.fixture(scope='module', params=['rclpy', 'rosbags'])
def read(request: pytest.FixtureRequest) -> Reader:
    """Return a library's reader of messages by their type; both have the fields of the type."""
    if request.param == 'rosbags':
        return STORE.deserialize_cdr
    serialization = pytest.importorskip('rclpy.serialization')

    def deserialized(data: bytes, kind: str) -> Any:
        package, _, name = kind.split('/')
        try:
            message = getattr(importlib.import_module(f'{package}.msg'), name)
        except ImportError:
            pytest.skip(f'{kind} is not installed')
        return serialization.deserialize_message(data, message)

    return deserialized


@pytest.fixture(scope='module')
def write() -> Callable[[Any], bytes]:
    """Return rclpy's writer of messages."""
    return pytest.importorskip('rclpy.serialization').serialize_message


def nanoseconds(stamp: Any) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def bits(values: Any) -> bytes:
    return np.array(values, np.float64).tobytes()


# ---- joint states


@given(st.data(), STAMPS, TEXTS, NAMES, st.dictionaries(TEXTS, NUMBER, max_size=2))
def test_others_read_the_states_we_write(read, data, stamp, frame_id, names, fixed):
    rows = data.draw(several(3, len(names)))
    encoder = joint_encoder(names, frame_id, fixed)
    written = encoder.encode(stamp, rows)
    message = read(written, JOINT_STATE_TYPE)
    assert (nanoseconds(message.header.stamp), message.header.frame_id) == (stamp, frame_id)
    assert list(message.name) == [*names, *fixed]
    at_rest = [list(fixed.values()), [0.0] * len(fixed), [0.0] * len(fixed)]
    for got, wanted, rest in zip(
        (message.position, message.velocity, message.effort), rows, at_rest, strict=True
    ):
        assert bits(got) == bits([*wanted, *rest])
    # Whatever was written between.
    encoder.encode(0, rows[::-1])
    assert encoder.encode(stamp, rows) == written


@given(st.data(), STAMPS, TEXTS, NAMES, st.sets(st.sampled_from(JOINT_FIELDS), min_size=1))
def test_an_encoder_of_some_fields_leaves_the_others_empty(data, stamp, frame_id, names, chosen):
    fields = [name for name in JOINT_FIELDS if name in chosen]
    rows = data.draw(several(len(fields), len(names)))
    written = joint_encoder(names, frame_id, fields=fields).encode(stamp, rows)
    given_rows = dict(zip(fields, rows, strict=True))
    assert written == encode_joints(names, stamp_ns=stamp, frame_id=frame_id, **given_rows)


@given(STAMPS, TEXTS, NAMES, st.tuples(*[st.lists(NUMBER, max_size=4)] * 3))
def test_we_read_any_joint_state_that_rclpy_writes(write, stamp, frame_id, names, arrays):
    from sensor_msgs.msg import JointState

    message = JointState(name=names, position=arrays[0], velocity=arrays[1], effort=arrays[2])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id = frame_id
    # The second time, the names are those of the message before.
    for got in (decode_joints(write(message)), decode_joints(write(message))):
        assert (got.stamp_ns, got.frame_id, got.names) == (stamp, frame_id, tuple(names))
        for values, wanted in zip((got.position, got.velocity, got.effort), arrays, strict=True):
            assert bits(values) == bits(wanted)


def test_names_that_begin_like_those_of_the_message_before_are_read_anew():
    for names in (('a', 'b'), ('a',), ('a', 'b', 'c'), ('a', 'b'), ('ab',), ()):
        data = encode_joints(names, np.arange(len(names)), frame_id='base')
        got = decode_joints(data)
        assert (got.names, got.position.tolist()) == (names, list(range(len(names))))


# ---- headed numbers, clock, arrays, frames

# The numbers of each type below its header, as the libraries name them.
FIELDS = {
    'geometry_msgs/msg/PoseStamped': attrgetter(
        *(f'pose.position.{axis}' for axis in 'xyz'),
        *(f'pose.orientation.{axis}' for axis in 'xyzw'),
    ),
    'geometry_msgs/msg/WrenchStamped': attrgetter(
        *(f'wrench.{part}.{axis}' for part in ('force', 'torque') for axis in 'xyz')
    ),
    'geometry_msgs/msg/InertiaStamped': attrgetter(
        'inertia.m',
        *(f'inertia.com.{axis}' for axis in 'xyz'),
        *(f'inertia.i{axes}' for axes in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')),
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize('kind', MESSAGE_NUMBERS)
@given(st.data(), STAMPS, TEXTS)
def test_others_read_headed_numbers_as_we_write_them_and_so_do_we(
    read, kind, data, stamp, frame_id
):
    numbers = data.draw(several(len(MESSAGE_NUMBERS[kind])))
    written = numbers_encoder(kind, frame_id).encode(stamp, numbers)
    assert encode_numbers(kind, stamp, frame_id, numbers) == written
    message = read(written, kind)
    assert (nanoseconds(message.header.stamp), message.header.frame_id) == (stamp, frame_id)
    assert bits(FIELDS[kind](message)) == bits(numbers)
    got = decode_numbers(written, kind)
    assert (got.stamp_ns, got.frame_id, bits(got.values)) == (stamp, frame_id, bits(numbers))


@given(STAMPS)
def test_others_read_the_clock_we_write_and_so_do_we(read, stamp):
    assert nanoseconds(read(encode_clock(stamp), CLOCK_TYPE).clock) == stamp
    assert decode_clock(encode_clock(stamp)) == stamp


@given(st.data(), STAMPS, st.lists(st.tuples(TEXTS, TEXTS), max_size=4))
def test_others_read_the_frames_we_write(read, data, stamp, frames):
    numbers = data.draw(several(len(frames), 7))
    message = read(transform_encoder(frames).encode(stamp, numbers), TRANSFORMS_TYPE)
    assert len(message.transforms) == len(frames)
    for got, names, wanted in zip(message.transforms, frames, numbers, strict=True):
        assert (got.header.frame_id, got.child_frame_id) == names
        assert nanoseconds(got.header.stamp) == stamp
        place, turn = got.transform.translation, got.transform.rotation
        assert bits([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]) == bits(wanted)


def test_others_read_the_arrays_we_write_with_their_layout_and_so_do_we(read):
    values = np.arange(6.0).reshape(2, 3)
    layout = [('row', ('x', 'yy')), ('column', ('a', 'b', 'c'))]
    data = array_encoder(layout).encode(0, values)
    message = read(data, FLOAT_ARRAY_TYPE)
    dimensions = [(d.label, d.size, d.stride) for d in message.layout.dim]
    assert dimensions == [('row: x,yy', 2, 6), ('column: a,b,c', 3, 3)]
    assert list(message.data) == values.reshape(-1).tolist()
    assert decode_floats(data).tolist() == values.reshape(-1).tolist()


@given(st.lists(TEXTS, max_size=3), st.lists(NUMBER, max_size=5))
def test_we_read_arrays_with_any_layout(write, labels, values):
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    message = Float64MultiArray(data=values)
    message.layout.dim = [MultiArrayDimension(label=x, size=3, stride=3) for x in labels]
    written = write(message)
    assert bits(decode_floats(written)) == bits(values)
    assert bits(decode_floats(encode_floats(values))) == bits(values)


@given(TEXTS)
def test_others_read_the_text_we_write_and_so_do_we(read, text):
    assert read(encode_string(text), STRING_TYPE).data == text
    assert decode_string(encode_string(text)) == text


def test_half_of_a_surrogate_pair_is_written_as_an_escape():
    assert decode_string(encode_string('a\ud800')) == 'a\\ud800'


# ---- bytes that no writer of ROS 2 sends


def test_a_message_from_a_big_endian_machine_is_read():
    head = b'\x00\x00\x00\x00'
    # Eight-byte numbers begin at a multiple of eight after the header: four bytes of padding.
    data = head + struct.pack('>III', 0, 0, 1) + bytes(4) + struct.pack('>d', 2.5)
    assert decode_floats(data).tolist() == [2.5]
    state = head + struct.pack('>iI', 1, 2) + struct.pack('>I', 0)
    state += struct.pack('>II', 1, 2) + b'a\0' + bytes(2) + struct.pack('>I', 1) + bytes(4)
    state += struct.pack('>d', 2.5) + struct.pack('>II', 0, 0)
    assert decode_joints(encode_joints(['a'], [1.0])).names == ('a',)
    got = decode_joints(state)
    assert (got.stamp_ns, got.names, got.position.tolist()) == (10**9 + 2, ('a',), [2.5])
    arrays, _ = Decoder(JOINT_STATE_TYPE).read([state])
    assert arrays['position'].tolist() == [[2.5]]


def test_a_message_that_ends_early_is_refused_wherever_it_ends():
    data = encode_joints(['a', 'b'], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0], STAMP, 'base')
    decode_joints(data)
    for size in range(len(data)):
        with pytest.raises(ValueError, match=r'message (ends at byte|begins with)'):
            decode_joints(data[:size])


@pytest.mark.parametrize('head', [b'\x00\x03\x00\x00', b'\x00\x0b\x00\x00', b'ab', b''])
def test_an_encoding_other_than_plain_cdr_is_refused(head):
    with pytest.raises(ValueError, match='expected plain CDR'):
        decode_floats(head + bytes(12) if head else head)


def joint_state(names: bytes) -> bytes:
    """Return a JointState at time 0 in frame '' whose sequence of names is given as bytes."""
    return HEADER + bytes(8) + struct.pack('<I', 1) + bytes(4) + names


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
def test_a_malformed_string_or_sequence_is_refused(names, expected):
    with pytest.raises(ValueError, match=expected) as error:
        decode_joints(joint_state(names))
    assert type(error.value) is ValueError


def test_an_empty_string_may_come_without_its_zero():
    got = decode_joints(joint_state(struct.pack('<III', 2, 0, 0) + bytes(12)))
    assert got.names == ('', '')


# Each decoder, and a message for it.
DECODERS: dict[str, tuple[Callable[[bytes], object], bytes]] = {
    'state': (decode_joints, joint_encoder(['a', 'bcd'], 'base').encode(STAMP, np.ones((3, 2)))),
    'array': (decode_floats, array_encoder([('row', ('x', 'yy'))]).encode(0, np.zeros(2))),
    'floats': (decode_floats, encode_floats([1.0, 2.0])),
    'clock': (decode_clock, encode_clock(STAMP)),
    'text': (decode_string, encode_string('wört')),
    'any': (Decoder(JOINT_STATE_TYPE).decode, encode_joints(['a'], [1.0], stamp_ns=STAMP)),
    **{
        kind: (
            functools.partial(decode_numbers, kind=kind),
            encode_numbers(kind, STAMP, 'b', np.zeros(len(names))),
        )
        for kind, names in MESSAGE_NUMBERS.items()
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
        return draw(st.sampled_from((HEADER, bytes(4), b''))) + bytes(body)
    for _ in range(draw(st.integers(1, 3))):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data if change == 'alter' else data[: draw(st.integers(0, len(data)))])


@pytest.mark.parametrize('decoder', DECODERS)
@given(st.data())
def test_garbage_is_read_or_refused_with_a_value_error(decoder, data):
    decode, whole = DECODERS[decoder]
    decode(whole)
    try:
        decode(data.draw(strange_bytes(whole)))
    except ValueError:
        event('refused')
    else:
        event('read')


def test_a_time_with_a_second_or_more_of_nanoseconds_is_refused():
    for decoder in ('state', 'clock', *MESSAGE_NUMBERS):
        decode, data = DECODERS[decoder]
        for rest in (10**9, 2**32 - 1):
            strange = data[:8] + struct.pack('<I', rest) + data[12:]
            with pytest.raises(ValueError, match=f'nanosec of a time is {rest}, expected 0 to'):
                decode(strange)
            if decoder == 'state':
                assert Decoder(JOINT_STATE_TYPE).read([data, strange])[1].tolist() == [0]


# ---- many messages at once


def fields_of(data: bytes) -> dict[str, Any]:
    """Return the fields of a JointState by path, by the decoder of joints."""
    joints = decode_joints(data)
    sec, nanosec = divmod(joints.stamp_ns, 10**9)
    header = {'header.stamp.sec': sec, 'header.stamp.nanosec': nanosec}
    arrays = {name: bits(getattr(joints, name)) for name in JOINT_FIELDS}
    return {**header, 'header.frame_id': joints.frame_id, 'name': joints.names, **arrays}


@given(st.data(), st.booleans())
def test_joint_states_read_together_are_those_read_one_by_one(data, altered):
    encoder = joint_encoder(['a', 'bcd'], 'base')
    messages = [encoder.encode(k * STAMP, np.full((3, 2), k / 3)) for k in range(3)]
    if altered:
        messages[data.draw(st.integers(0, 2))] = data.draw(strange_bytes(messages[0]))
    arrays, places = Decoder(JOINT_STATE_TYPE).read(messages)
    assert len(places) >= 2 + (not altered)
    for k, place in enumerate(places):
        wanted = fields_of(messages[place])
        names = tuple(arrays['name'][k].tolist())
        assert names[: len(wanted['name'])] == wanted['name']
        for name in ('header.stamp.sec', 'header.stamp.nanosec', 'header.frame_id'):
            assert arrays[name][k] == wanted[name]
        for name in JOINT_FIELDS:
            assert bits(arrays[name][k]).startswith(wanted[name])


def test_another_type_of_the_name_is_read_by_its_definition():
    text = 'int32 count\nstring[] name\nfloat64[] position\nfloat32[] velocity\nfloat64[] effort\n'
    decoder = Decoder(JOINT_STATE_TYPE, text)
    data = HEADER + struct.pack('<iIIIfI', 7, 0, 0, 1, 0.5, 0)
    arrays, _ = decoder.read([data, data])
    assert (arrays['count'].tolist(), arrays['velocity'].tolist()) == ([7, 7], [[0.5], [0.5]])


@pytest.mark.parametrize('padding', [b'\xff', b'x'])
def test_padding_of_any_value_leaves_joint_states_equal(padding):
    # Behind 'a' and its zero are two bytes of padding, and rclpy leaves them as they were.
    messages = [bytearray(encode_joints(['a', 'b'], [k, 0.5], stamp_ns=k)) for k in range(300)]
    at = bytes(messages[0]).index(b'a\0') + 2
    for k in range(0, 300, 2):
        messages[k][at : at + 2] = 2 * padding
    arrays, places = Decoder(JOINT_STATE_TYPE).read([bytes(one) for one in messages])
    assert len(places) == 300
    assert arrays['position'][:, 0].tolist() == list(range(300))


def test_numbers_in_nested_messages_are_columns_filled_up_with_nan():
    frames = [('base', 'a'), ('a', 'b')]
    messages = [
        transform_encoder(frames[:k]).encode(k, np.arange(14.0).reshape(2, 7)[:k]) for k in (1, 2)
    ]
    arrays, _ = Decoder(TRANSFORMS_TYPE).read(messages)
    x = arrays['transforms.transform.translation.x']
    assert x[0, 0] == 0.0
    assert np.isnan(x[0, 1])
    assert x[1].tolist() == [0.0, 7.0]
    assert arrays['transforms.child_frame_id'].tolist() == [['a', ''], ['a', 'b']]
    whole, _ = Decoder(TRANSFORMS_TYPE).read(messages[1:])
    assert whole['transforms.header.stamp.nanosec'].dtype == np.uint32
    none, _ = Decoder(TRANSFORMS_TYPE).read([transform_encoder([]).encode(0, np.zeros((0, 7)))])
    assert none['transforms.transform.rotation.w'].shape == (1, 0)


def test_blocks_are_joined_with_shorter_rows_filled_up():
    decoder = Decoder(FLOAT_ARRAY_TYPE)
    blocks = [decoder.read([encode_floats(range(k))] * 2)[0] for k in (1, 3)]
    data = joined_columns([block['data'] for block in blocks])
    assert data[2].tolist() == [0.0, 1.0, 2.0]
    assert np.isnan(data[0, 1:]).all()
    equal = joined_columns([blocks[1]['data']] * 2)
    assert equal.tolist() == [[0.0, 1.0, 2.0]] * 4


def test_one_long_row_among_many_short_ones_is_refused():
    decoder = Decoder(FLOAT_ARRAY_TYPE)
    messages = [encode_floats(np.zeros(100_000)), *[encode_floats([])] * 1000]
    with pytest.raises(ValueError, match='read a shorter window'):
        decoder.read(messages)
    blocks = [decoder.read(messages[:1])[0], decoder.read(messages[1:])[0]]
    with pytest.raises(ValueError, match='read a shorter window'):
        joined_columns([block['data'] for block in blocks])


SEPARATOR = '=' * 80 + '\n'


def nested(depth: int, times: int = 1) -> str:
    """Return a definition of types that use the next one a number of times each."""
    parts = [
        ''.join(f'a/A{k + 1} x{j}\n' for j in range(times)) if k < depth else 'int8 x\n'
        for k in range(depth + 1)
    ]
    titles = (f'MSG: a/A{k}\n{part}' for k, part in enumerate(parts) if k)
    return SEPARATOR.join([parts[0], *titles])


@pytest.mark.parametrize(
    ('definition', 'expected'),
    [
        ('a/A0 again\n', 'nested deeper'),
        ('b/B x\n', 'type b/msg/B is missing'),
        (nested(40), 'nested deeper'),
        (nested(12, times=2), 'more than 4096 fields'),
        (''.join(f'int8 x{k}\n' for k in range(4200)), 'more than 4096'),
        (''.join(f'int8 C{k}=1\n' for k in range(5_000)), 'more than 4096'),
        ('string[1000000000] x\n', 'more than 4096'),
        ('a/B[1000000000] x\n' + SEPARATOR + 'MSG: a/B\nint8 x\n', 'more than 4096'),
        ('wstring x\n', 'missing|cannot be read'),
        ('garbage (((\n', 'cannot be read'),
        ('# ' + 'a' * 300_000, 'expected at most'),
        ('\0', 'cannot be read'),
    ],
    ids=range(12),
)
def test_a_hostile_definition_is_refused_at_once(definition, expected):
    with pytest.raises(ValueError, match=expected):
        Decoder('a/msg/A0', definition)


@pytest.mark.parametrize(
    'definition',
    [
        'int8 from\nint8 class\nint8 self\r\n',
        'int8[3] a [1, 2, 3]\nstring s "x=1"\nstring<=5 t\nfloat64[<=4] u\nbool[2] b # end\n',
        'int8 X=3\n',
    ],
)
def test_names_defaults_bounds_and_constants_of_definitions_are_read(definition):
    types = get_types_from_msg(definition.replace('\r', ''), 'a/msg/A')
    fields = [name for name, _ in types['a/msg/A'][1]]
    assert list(Decoder('a/msg/A', definition).paths) == fields


# ---- types and QoS


@pytest.mark.parametrize('kind', [JOINT_STATE_TYPE, TRANSFORMS_TYPE, CLOCK_TYPE])
def test_a_definition_is_that_of_the_hash_by_which_peers_know_a_type(kind):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition_text(kind), kind))
    assert store.hash_rihs01(kind) == type_hash(kind)
    assert type_hash(kind).startswith('RIHS01_')


@pytest.mark.parametrize('kind', ['nix_msgs/msg/Nix', 'JointState', ''])
def test_an_unknown_type_is_named(kind):
    for look_up in (definition_text, type_hash):
        with pytest.raises(ValueError, match=f"message type '{kind}' is unknown"):
            look_up(kind)


@pytest.mark.ros
def test_the_hashes_are_those_that_ros_installed():
    share = Path(sys.prefix, 'share', 'sensor_msgs', 'msg', 'JointState.json')
    if not share.exists():
        pytest.skip('ROS is not installed in this environment')
    hashes = {
        x['type_name']: x['hash_string'] for x in json.loads(share.read_text())['type_hashes']
    }
    assert hashes[JOINT_STATE_TYPE] == type_hash(JOINT_STATE_TYPE)


@pytest.mark.parametrize(
    'qos', [Qos(), Qos(3, reliable=False, transient_local=True), Qos(1, True)]
)
def test_the_qos_that_we_write_is_read(qos):
    assert offered_qos(qos_text(qos)) == qos


@pytest.mark.parametrize(
    ('offers', 'expected'),
    [
        ([], None),
        ([{}], Qos()),
        ([{'history': 3, 'depth': 0, 'reliability': 1, 'durability': 2}], Qos()),
        ([{'reliability': 2, 'depth': 5}, {'durability': 1}], Qos(10, False, True, True)),
        ([{'history': 'keep_all'}, {'depth': 10**9}], Qos(10_000, True)),
        ([{'reliability': 'best_effort'}], Qos(reliable=False)),
    ],
)
def test_the_strongest_of_several_offers_is_taken(offers, expected):
    assert offered_qos(yaml.safe_dump(offers)) == expected


@given(
    st.text()
    | st.recursive(
        st.text(max_size=9) | st.integers(),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(['depth', 'history', 'reliability']), inner)
        ),
    ).map(yaml.safe_dump)
)
def test_any_text_is_a_qos_or_one_error(text):
    try:
        found = offered_qos(text)
    except ValueError:
        event('refused')
    else:
        assert found is None or 1 <= found.depth <= 10_000


@pytest.mark.parametrize('text', ['[' * 500, '- depth: [1]', '- 1', 'a: 1', ' ' * 70_000])
def test_a_text_that_is_no_list_of_qos_profiles_is_one_error(text):
    with pytest.raises(ValueError, match='QoS profile'):
        offered_qos(text)
