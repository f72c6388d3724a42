# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged and hostile recordings: one line, status 1, little time, little memory.

All are made from the golden recording, with valid checksums, and verified by one process.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import struct
import subprocess
import sys
from typing import Any
import zlib

import lz4.frame
from mcap.opcode import Opcode
from mcap.writer import CompressionType
import pytest
from rewriting import ARRAY, CLOCK, END, HEAD, NAMED, STATES, TAKEN, Recording, Sent, Type, load
from ros_processes import environment
import zstandard

from pfd_ros.arm.events import TAKEN_COLUMNS
from pfd_ros.messages import convert
from pfd_ros.recording.mcap_records import MAGIC, RECORD_LIMIT

HERE = Path(__file__).resolve().parent
GOLDEN = HERE.parent / 'data' / 'golden_1.mcap'
# What a file may cost, processor time in s and memory of the whole process in MB.
SECONDS = 3.0
MEGABYTES = 300.0
# A process that has hung in native code is ended after this, s.
PATIENCE = 300.0
LARGE = 1 << 31

Case = Callable[[Recording, Path], object]
CASES: dict[str, tuple[str, Case]] = {}


def case(expected: str, name: str = '') -> Callable[[Case], Case]:
    """Register the maker of a file, with a part of the line that is expected for it."""

    def add(make: Case) -> Case:
        key = name or make.__name__
        assert key not in CASES
        CASES[key] = (expected, make)
        return make

    return add


def altered(
    name: str, expected: str, change: Callable[[Recording], object], **options: Any
) -> None:
    """Register a recording that `change` alters."""

    def make(recording: Recording, path: Path) -> None:
        change(recording)
        recording.save(path, **options)

    case(expected, name)(make)


def renumber(topic: str, first: int, add: int) -> Callable[[Recording], None]:
    """Add to the numbers of a topic, from a number on."""

    def change(recording: Recording) -> None:
        for m in recording.on(topic):
            if m.sequence >= first:
                m.sequence = (m.sequence + add) & 0xFFFFFFFF
        recording.recount(digests=True)

    return change


# --- numbers that repeat, decrease or jump, in a closed file that says so itself, and in a cut one

for TOPIC in (STATES, CLOCK, TAKEN, NAMED):
    for CLOSED in (True, False):
        LABEL = f'{TOPIC}_{"closed" if CLOSED else "cut"}'
        altered(
            f'repeats{LABEL}', 'repeated or out of order', renumber(TOPIC, 8, -1), closed=CLOSED
        )
        altered(
            f'decreases{LABEL}', 'repeated or out of order', renumber(TOPIC, 8, -5), closed=CLOSED
        )
        altered(
            f'wraps{LABEL}', 'repeated or out of order', renumber(TOPIC, 8, LARGE), closed=CLOSED
        )
    for JUMP in (10**6, LARGE - 2):
        WANTED = {
            STATES: 'steps can have been done',
            CLOCK: 'steps can have been done',
            TAKEN: f'lacks {JUMP} records of commands taken',
            NAMED: 'lacks command',
        }[TOPIC]
        altered(f'jumps_{JUMP}{TOPIC}', WANTED, renumber(TOPIC, 8, JUMP), closed=False)
        altered(
            f'jumps_{JUMP}{TOPIC}_closed',
            WANTED if TOPIC in (STATES, CLOCK) else 'its end record counts',
            renumber(TOPIC, 8, JUMP),
        )


def jump_in_time(recording: Recording) -> None:
    """Jump, with recorded times that would explain it; only the stamp does not."""
    for m in recording.messages:
        if (m.topic == STATES and m.sequence > 100) or (m.topic == CLOCK and m.sequence > 50):
            m.sequence += 10**9 if m.topic == CLOCK else 2 * 10**9
    cut = next(k for k, m in enumerate(recording.messages) if m.sequence >= 10**9)
    for m in recording.messages[cut:]:
        m.log_ns += 10**17
    recording.messages[cut:] = [m for m in recording.messages[cut:] if m.topic in (STATES, CLOCK)]


altered('jumps_in_time_too', 'recorded stamp', jump_in_time, closed=False)


@case('what is before it at')
def log_times_decrease(recording: Recording, path: Path) -> None:
    recording.messages[50].log_ns -= 10**9
    recording.save(path, closed=False)


@case('was recorded before it')
def swapped_state_and_tick(recording: Recording, path: Path) -> None:
    at = next(k for k, m in enumerate(recording.messages) if m.topic == CLOCK)
    one, other = recording.messages[at - 1 : at + 1]
    assert one.topic == STATES
    recording.messages[at - 1 : at + 1] = [other, one]
    one.log_ns, other.log_ns = other.log_ns, one.log_ns
    recording.recount(digests=True)
    recording.save(path)


# --- messages that are gone from a closed file

GONE = {
    'front': lambda n, last: n <= 20,
    'middle': lambda n, last: last / 3 < n <= last / 2,
    'end': lambda n, last: n > last - 20,
    'half': lambda n, last: n % 2 == 0,
    'all': lambda n, last: True,
}
for TOPIC in (STATES, CLOCK):
    for PART, GOES in GONE.items():

        def remove(recording: Recording, topic: str = TOPIC, goes: Any = GOES) -> None:
            last = recording.on(topic)[-1].sequence
            recording.keep(lambda m: m.topic != topic or not goes(m.sequence, last))

        altered(f'without_{PART}{TOPIC}', 'messages', remove)

altered(
    'without_last_taken',
    'of 37 messages taken: the last one is 36',
    lambda r: r.keep(lambda m: m.topic != TAKEN or m.sequence != 37),
)
altered(
    'without_a_command', 'messages commands: 3 to 3', lambda r: r.messages.remove(r.on(ARRAY)[2])
)


def without_ticks(recording: Recording) -> None:
    recording.keep(lambda m: m.topic != CLOCK)
    recording.recount(digests=True)


altered('without_ticks_and_recounted', 'clock ticks', without_ticks)


def half_and_recounted(recording: Recording) -> None:
    recording.keep(lambda m: m.topic != STATES or m.sequence % 2 == 0)
    recording.recount(digests=True)


altered('half_the_states_and_recounted', 'its end record counts', half_and_recounted)
altered(
    'without_publish_clock',
    'publish_clock is False',
    lambda r: r.edit(HEAD, 'settings', lambda s: s.update(publish_clock=False)),
)


def altered_bytes(recording: Recording) -> None:
    """Alter what no state depends on: the effort of a command for nobody."""
    recording.recount(digests=True)
    message = next(m for m in recording.on(NAMED) if b'nobody' in m.data)
    message.data = message.data[:-1] + bytes([message.data[-1] ^ 1])


altered('altered_bytes_of_no_effect', 'not the recorded ones', altered_bytes)

# --- the end record

altered('no_end_record', 'without the end record', lambda r: r.metadata.pop())


def end(key: str, **values: Any) -> Callable[[Recording], None]:
    return lambda r: r.edit(END, key, lambda found: found.update(values))


for NAME, VALUE in {
    'steps': [0, 537, 540, 10**9, 10**400, -1, 1.5, '538', None, True],
    'states': [0, 268, 270, [], float('nan')],
    'commands_accepted': [24, 26, {}],
    'failure': ['it broke', None, 3],
}.items():
    for VARIANT in VALUE:
        LABEL = repr(VARIANT)[:12]
        WANTED = 'the end: recorded' if VARIANT == 'it broke' else 'GOLDEN'
        altered(f'end_{NAME}_{LABEL}', WANTED, end('totals', **{NAME: VARIANT}))
altered('end_states_counted', 'messages joint_states', end('recorded', **{STATES: 268}))
altered('end_more_dropped', 'its end record counts', end('dropped', **{STATES: 1}))
altered('end_of_other_topics', 'messages dropped are of', end('dropped', **{'/x': 1}))
altered('end_without_totals', 'totals of its end', lambda r: r.head(END).pop('totals'))
altered('end_totals_list', 'totals of its end', lambda r: r.edit(END, 'totals', lambda t: [1]))
altered('end_empty', 'without the end record', lambda r: r.head(END).clear())
altered('end_digests_table', 'digests', lambda r: r.head(END).update(digests='[]'))
altered('end_digests_few', 'digests are of', lambda r: r.head(END).update(digests='{}'))
altered('two_end_records', 'two records', lambda r: r.metadata.append(r.metadata[-1]))
altered('two_heads', 'two records', lambda r: r.metadata.insert(0, r.metadata[0]))


def wrong_digest(recording: Recording) -> None:
    recording.recount(digests=True)
    digests = json.loads(recording.head(END)['digests'])
    digests[CLOCK] = 'é' * 64
    recording.head(END)['digests'] = json.dumps(digests)


altered('end_digest_no_hex', 'expected SHA-256', wrong_digest)

# --- rows of commands taken


def row(index: int, value: int) -> Callable[[Recording], None]:
    def change(recording: Recording) -> None:
        message = recording.on(TAKEN)[5]
        rows = convert.decode_rows(message.data, 4)
        rows[0][index] = value
        message.data = convert.encode_rows(rows, TAKEN_COLUMNS)

    return change


altered('row_verdict', 'verdict 200', row(3, 200))
altered('row_other_verdict', 'replayed as', row(3, 4), closed=False)
altered('row_source', 'source 9', row(1, 9))
altered('row_past', 'was recorded before it', row(0, 1))
altered('row_step_0', 'names steps [0]', row(0, 0))
altered('row_future', 'steps can have been done', row(0, 10**18))
altered('row_near_future', 'steps can have been done', row(0, 400), closed=False)
altered('row_largest', 'steps can have been done', row(0, 2**64 - 1))
altered('row_command', 'lacks command 77', row(2, 77), closed=False)
altered('row_garbage', 'GOLDEN', lambda r: setattr(r.on(TAKEN)[3], 'data', b'\xff' * 40))
altered('row_empty', 'GOLDEN', lambda r: setattr(r.on(TAKEN)[3], 'data', b''))


def overflowed(recording: Recording) -> None:
    """Say of a command that moved the arm that it was never taken."""
    for message in recording.on(TAKEN):
        rows = convert.decode_rows(message.data, 4)
        if rows[0][3] == 0:
            rows[0][3] = 12
            message.data = convert.encode_rows(rows, TAKEN_COLUMNS)
            return


altered('row_overflowed', 'joint', overflowed, closed=False)

# --- commands that are never taken, and rows far ahead, must not be kept for ever


def flood(count: int, size: int) -> Callable[[Recording], None]:
    def change(recording: Recording) -> None:
        last = recording.on(ARRAY)[-1]
        at = recording.messages.index(last) + 1
        recording.messages[at:at] = [
            Sent(ARRAY, last.sequence + k + 1, last.log_ns, bytes(size)) for k in range(count)
        ]

    return change


altered('flood_of_small_commands', 'were never taken', flood(200_000, 0), closed=False)
altered('flood_of_large_commands', 'were never taken', flood(300, 1 << 20), closed=False)

# --- metadata: wrong types, nesting, numbers that are none

DEEP = '[' * 5000 + ']' * 5000
HOSTILE_JSON = {
    'null': 'null',
    'true': 'true',
    'text': '"x"',
    'nested': DEEP,
    'nested_table': '{"a":' * 5000 + '1' + '}' * 5000,
    'nan': 'NaN',
    'infinite': '1e400',
    'minus_infinite': '-Infinity',
    'huge': '1' + '0' * 400,
    'digits': '9' * 5000,
    'table': '{}',
    'list': '[[1]]',
    'cut': '[1, 2',
    'surrogate': '"\\ud800"',
    'nothing': '',
}
SETTINGS = sorted(json.loads(load(GOLDEN).head(HEAD)['settings']))


def setting(name: str, text: str) -> Callable[[Recording], None]:
    def change(recording: Recording) -> None:
        found = json.loads(recording.head(HEAD)['settings'])
        parts = [
            f'{json.dumps(k)}: {text if k == name else json.dumps(v)}' for k, v in found.items()
        ]
        recording.head(HEAD)['settings'] = '{' + ', '.join(parts) + '}'

    return change


# Texts take any text, and `robot`, `recording` and what is empty make no difference.
ALLOWED = {
    **{name: {'text', 'surrogate'} for name in ('robot', 'recording', 'frame_id')},
    **{name: {'text', 'surrogate'} for name in ('base_link', 'tip_link')},
    **{name: {'true'} for name in ('damping', 'armature', 'publish_clock')},
}
for NAME in SETTINGS:
    for KIND, TEXT in HOSTILE_JSON.items():
        if KIND not in ALLOWED.get(NAME, ()):
            altered(f'setting_{NAME}_{KIND}', 'GOLDEN', setting(NAME, TEXT))
for NAME in ('settings', 'topics', 'versions', 'clock', 'format'):
    for KIND, TEXT in HOSTILE_JSON.items():
        if (NAME, KIND) != ('versions', 'table'):
            altered(
                f'head_{NAME}_{KIND}',
                'GOLDEN',
                lambda r, name=NAME, text=TEXT: r.head(HEAD).update({name: text}),
            )
    altered(f'head_without_{NAME}', 'GOLDEN', lambda r, name=NAME: r.head(HEAD).pop(name) and None)
altered(
    'setting_twice',
    'a name comes twice',
    lambda r: r.head(HEAD).update(settings='{"robot": "a", "robot": "b"}'),
)
altered('settings_unknown', 'unknown settings', setting('robot', '"a", "wings": 2'))
altered(
    'settings_many_joints',
    'expected 1000 at most',
    setting('joints', '["joint1"' + ',"x"' * 9999 + ']'),
)
altered('settings_rare_states', 'steps can have been done', setting('publish_rate', '1e-5'))
altered('settings_faster', 'step', setting('step_size', '1e-5'))
altered('settings_other_start', 'recorded 12', setting('start_time', '12.6'))
altered('settings_unknown_method', 'method', setting('method', '"magic"'))
altered('settings_blow_up', 'must be finite', setting('gravity', '[1e308, 1e308, 1e308]'))
altered(
    'topics_swapped',
    'holds',
    lambda r: r.edit(
        HEAD, 'topics', lambda t: t.update(joint_states=t['clock'], clock=t['joint_states'])
    ),
)
altered(
    'topics_equal',
    'expected topics of',
    lambda r: r.edit(HEAD, 'topics', lambda t: t.update(joint_states=t['clock'])),
)
altered(
    'topics_swapped_same_type',
    'GOLDEN',
    lambda r: r.edit(
        HEAD,
        'topics',
        lambda t: t.update(joint_states=t['joint_commands'], joint_commands=t['joint_states']),
    ),
)
altered(
    'topics_unknown_role',
    'expected topics of',
    lambda r: r.edit(HEAD, 'topics', lambda t: t.update(wings='/wings')),
)
altered(
    'topics_few',
    'GOLDEN',
    lambda r: r.edit(HEAD, 'topics', lambda t: {'joint_states': t['joint_states']}),
)
altered('no_head', 'is no recording of this node', lambda r: r.metadata.pop(0))
altered('large_head', 'a record of', lambda r: r.head(HEAD).update(settings=' ' * (1 << 21)))
altered(
    'terminal_escapes', 'recorded', lambda r: setting('frame_id', '"\\u001b[2J\\n\\r\\u0007"')(r)
)

# --- the robot

ALIASES = 'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{chr(98 + k)}: &{chr(98 + k)} [{", ".join(["*" + chr(97 + k)] * 9)}]\n' for k in range(12)
)
LONG = 'robot: x\njoints:\n' + ''.join(
    f'- {{name: j{k}, type: revolute, mass: 1.0, inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}, '
    'dh: {a: 0.1, d: 0, alpha_deg: 0, theta_deg: 0}}\n'
    for k in range(500)
)
ROBOTS = {
    'name': b'puma560',
    'file': b'/dev/zero.yaml',
    'urdf': b'<robot name="x"/>\n',
    'aliases': ALIASES.encode() + b'robot: *l\njoints: *l\n',
    'aliases_in_a_name': ALIASES.encode() + b'robot: *l\njoints: 5\n',
    'nested': b'robot: ' + b'[' * 5000 + b'\n',
    'huge': b'# ' + b'x' * (1 << 20) + b'\n',
    'digits': b'robot: x\njoints:\n- {name: a, type: revolute, mass: 1' + b'0' * 400 + b'}\n',
    'no_text': b'\xff\xfe\x00' * 10 + b'\n',
    'empty': b'',
    'tag': b'robot: !!python/object/apply:os.system ["true"]\njoints: []\n',
    'nothing': b'robot: x\njoints: []\n',
    # Valid, and minutes to compile.
    'long': LONG.encode(),
}
for NAME, TEXT in ROBOTS.items():
    altered(
        f'robot_{NAME}',
        'its robot has' if NAME == 'long' else 'GOLDEN',
        lambda r, text=TEXT: setattr(r, 'attachments', [('robot.yaml', text)]),
    )
altered('no_robot', 'no robot in its attachment', lambda r: r.attachments.clear())
altered('two_robots', 'two records', lambda r: r.attachments.append(r.attachments[0]))
altered(
    'other_robot',
    'step',
    lambda r: setattr(
        r,
        'attachments',
        [('robot.yaml', r.attachments[0][1].replace(b'mass: 17.4', b'mass: 17.3'))],
    ),
)

# --- channels


def channel(topic: str, **values: str) -> Callable[[Recording], None]:
    def change(recording: Recording) -> None:
        for kind in recording.channels:
            if kind.topic == topic:
                vars(kind).update(values)

    return change


altered('schema_wrong', 'expected', channel(STATES, schema='std_msgs/msg/String'))
altered('schema_encoding_wrong', 'expected', channel(STATES, schema_encoding='ros2idl'))
altered('encoding_wrong', 'expected', channel(CLOCK, encoding='json'))


@case('on a topic that the node does not have')
def foreign_topic(recording: Recording, path: Path) -> None:
    recording.channels.append(Type('/x', 'cdr', 'std_msgs/msg/String', 'ros2msg'))
    recording.messages.insert(9, Sent('/x', 1, recording.messages[8].log_ns, b''))
    recording.save(path)


# --- the container, byte by byte


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack('<BQ', opcode, len(body) if length is None else length) + body


def text(value: str) -> bytes:
    return struct.pack('<I', len(value.encode())) + value.encode()


HEADER = MAGIC + record(Opcode.HEADER, text('ros2') + text('test'))


def chunk(compression: str, packed: bytes, size: int, crc: int = 0) -> bytes:
    body = struct.pack('<QQQI', 0, 0, size, crc) + text(compression)
    return record(Opcode.CHUNK, body + struct.pack('<Q', len(packed)) + packed)


def zstd_bomb(size: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(1 << 24)
    return b''.join(packer.compress(block) for _ in range(size >> 24)) + packer.flush()


def raw(name: str, expected: str, content: Callable[[], bytes]) -> None:
    case(expected, name)(lambda recording, path: path.write_bytes(content()))


def spliced(content: Callable[[], bytes]) -> bytes:
    """Return the golden recording with a record behind its header."""
    data = GOLDEN.read_bytes()
    at = len(MAGIC) + 9 + int.from_bytes(data[9:17], 'little')
    return data[:at] + content() + data[at:]


raw('empty', 'does not begin as MCAP', lambda: b'')
raw('only_magic', 'damaged', lambda: MAGIC)
raw('magic_twice', 'damaged', lambda: MAGIC * 2)
raw('text', 'does not begin as MCAP', lambda: b'certainly no such file')
raw('zeros', 'does not begin as MCAP', lambda: bytes(1 << 20))
raw('zstd_bomb', 'a chunk of', lambda: HEADER + chunk('zstd', zstd_bomb(1 << 28), 1 << 28))
raw('zstd_bomb_lies', 'or more', lambda: HEADER + chunk('zstd', zstd_bomb(1 << 30), 1000))
raw('lz4_bomb', 'or more', lambda: HEADER + chunk('lz4', lz4.frame.compress(bytes(1 << 28)), 1000))
raw(
    'zstd_of_the_largest_size',
    'GOLDEN',
    lambda: HEADER + chunk('zstd', zstd_bomb(RECORD_LIMIT), RECORD_LIMIT) + MAGIC,
)
raw('zstd_short', 'or more', lambda: HEADER + chunk('zstd', zstd_bomb(1 << 24), (1 << 24) + 1))
raw('zstd_garbage', 'damaged', lambda: HEADER + chunk('zstd', b'\xff' * 99, 10))
raw('lz4_garbage', 'damaged', lambda: HEADER + chunk('lz4', b'\xff' * 99, 10))
raw(
    'lz4_cut', 'damaged', lambda: HEADER + chunk('lz4', lz4.frame.compress(bytes(9999))[:-9], 9999)
)
raw('unknown_compression', 'is packed as', lambda: HEADER + chunk('rar', b'', 0))
raw('chunk_size_huge', 'a chunk of', lambda: HEADER + chunk('', b'', 1 << 63))
raw('chunk_in_a_chunk', 'a chunk holds', lambda: HEADER + chunk('', chunk('', b'', 0), 49))
raw('chunk_crc', 'checksum', lambda: HEADER + chunk('', bytes(4), 4, zlib.crc32(bytes(3))))
raw(
    'attachment_of_gigabytes',
    'damaged',
    lambda: spliced(
        lambda: record(
            Opcode.ATTACHMENT, bytes(16) + text('x') * 2 + struct.pack('<Q', 1 << 33) + bytes(4)
        )
    ),
)
raw(
    'attachment_record_of_gigabytes',
    'damaged',
    lambda: spliced(lambda: record(Opcode.ATTACHMENT, b'', 1 << 33)),
)
raw(
    'attachment_crc',
    'checksum of the attachment',
    lambda: spliced(
        lambda: record(Opcode.ATTACHMENT, bytes(16) + text('x') * 2 + struct.pack('<QI', 0, 1))
    ),
)
raw(
    'message_index_garbage',
    'GOLDEN',
    lambda: spliced(lambda: record(Opcode.MESSAGE_INDEX, b'\xff' * 50)),
)
raw(
    'metadata_no_utf_8',
    'damaged',
    lambda: spliced(
        lambda: record(Opcode.METADATA, struct.pack('<I', 2) + b'\xff\xfe' + bytes(4))
    ),
)
raw('unknown_record', 'in a place for other kinds', lambda: spliced(lambda: record(0x90, b'xyz')))
raw(
    'message_of_no_channel',
    'which there is not',
    lambda: spliced(lambda: record(Opcode.MESSAGE, bytes(22))),
)
raw('message_too_short', 'damaged', lambda: spliced(lambda: record(Opcode.MESSAGE, bytes(5))))
raw(
    'many_channels',
    'more than',
    lambda: (
        HEADER
        + b''.join(
            record(
                Opcode.CHANNEL, struct.pack('<HH', k, 0) + text(str(k)) + text('cdr') + bytes(4)
            )
            for k in range(5000)
        )
    ),
)
raw(
    'two_channels_of_a_topic',
    'two channels',
    lambda: (
        HEADER
        + b''.join(
            record(Opcode.CHANNEL, struct.pack('<HH', k, 0) + text('/x') + text('cdr') + bytes(4))
            for k in range(2)
        )
    ),
)
raw(
    'channel_changes',
    'is another than before',
    lambda: (
        HEADER
        + b''.join(
            record(
                Opcode.CHANNEL, struct.pack('<HH', 1, 0) + text(f'/{k}') + text('cdr') + bytes(4)
            )
            for k in range(2)
        )
    ),
)
raw('bytes_behind_the_end', 'GOLDEN', lambda: GOLDEN.read_bytes() + b'x')
raw('twice_the_same', 'GOLDEN', lambda: GOLDEN.read_bytes() * 2)


@case('expected at most')
def sparse_file_of_gigabytes(recording: Recording, path: Path) -> None:
    with path.open('wb') as stream:
        stream.write(HEADER + struct.pack('<BQ', Opcode.ATTACHMENT, 1 << 33))
        stream.truncate(1 << 34)


@case('GOLDEN')
def chunk_of_empty_messages(recording: Recording, path: Path) -> None:
    """Pack many messages into some kB."""
    first = recording.messages[0]
    recording.messages = [Sent(STATES, 1, first.log_ns, b'')] * 100_000
    recording.save(path, closed=False, chunk_size=1 << 24, compression=CompressionType.LZ4)


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('hostile')


@pytest.fixture(scope='module')
def outcomes(folder: Path) -> dict[str, dict[str, Any]]:
    """Return what verifying each case, and the good file before and after, came to."""
    golden = load(GOLDEN)
    paths = [GOLDEN]
    for number, (_, make) in enumerate(CASES.values()):
        paths.append(folder / f'{number}_GOLDEN.mcap')
        make(golden.copy(), paths[-1])
    done = subprocess.run(
        [
            sys.executable,
            str(HERE / 'read_hostile.py'),
            str(SECONDS),
            *map(str, paths),
            str(GOLDEN),
        ],
        cwd=folder,
        env=environment(1),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(results) == len(paths) + 1, done.stderr
    return dict(zip(['good', *CASES, 'good again'], results, strict=True))


@pytest.mark.parametrize('name', CASES)
def test_a_hostile_file_is_one_line_and_status_1(
    outcomes: dict[str, dict[str, Any]], name: str
) -> None:
    found = outcomes[name]
    assert found['status'] == 1, found
    assert found['out'] == ''
    lines = found['err'].splitlines()
    assert len(lines) == 1
    assert lines[0].isprintable()
    assert len(lines[0]) < 800
    assert CASES[name][0] in lines[0]


def test_good_files_verify_before_and_after(outcomes: dict[str, dict[str, Any]]) -> None:
    for name in ('good', 'good again'):
        assert outcomes[name]['status'] == 0
        assert 'every bit equal' in outcomes[name]['out']


def test_no_file_takes_much_memory(outcomes: dict[str, dict[str, Any]]) -> None:
    assert outcomes['good again']['peak_mb'] < MEGABYTES
