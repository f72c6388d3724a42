# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any MCAP file is read as the format allows; what is damaged or cut is named, and recovered."""

from __future__ import annotations

from collections.abc import Callable
import gzip
from pathlib import Path
import random
import struct
from typing import Any
import zlib

from hypothesis import event, given, settings
from hypothesis import strategies as st
from logs import (
    MAGIC,
    PADDING,
    STATES,
    Row,
    attachment,
    channel,
    chunk,
    ending,
    header,
    message,
    record,
    schema,
    states,
    text,
    write_mcap,
)
import lz4.frame
from mcap.reader import make_reader
from mcap.records import Attachment, ChunkIndex, Footer, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from recordings import busy, largest_file, rewritten
import zstandard

from pfd_ros import read_log
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.recording.format import LogError
from pfd_ros.recording.mcap_records import CHANNELS as MCAP_CHANNELS
from pfd_ros.recording.mcap_records import MAGIC as MCAP_MAGIC
from pfd_ros.recording.mcap_records import TEXT_BYTES as MCAP_TEXT_BYTES
from pfd_ros.recording.mcap_records import records as mcap_records
from pfd_ros.recording.recover import recover as recover_log
from pfd_ros.replay.verify import verify as verify_log

ROWS = states(20)
INSIDE = schema() + channel() + b''.join(map(message, ROWS))
WHOLE = header() + chunk(INSIDE) + ending()
PRIVATE = record(0x90, b'note')
FUTURE = record(0x42, b'later')


def zstd(data: bytes) -> bytes:
    return zstandard.ZstdCompressor().compress(data)


def halves(data: bytes, pack: Callable[[bytes], bytes]) -> bytes:
    """Return data in two compressed frames."""
    return pack(data[: len(data) // 2]) + pack(data[len(data) // 2 :])


def saved(folder: Path, content: bytes) -> Path:
    path = folder / 'a.mcap'
    path.write_bytes(content)
    return path


def messages(path: Path) -> list[Any]:
    return [one for one in mcap_records(path) if isinstance(one, Message)]


def file_of(content: bytes) -> bytes:
    """Return a file: what has no beginning gets one, and an end."""
    return content if content.startswith(MAGIC) else header() + content + ending()


MESSAGES = b''.join(map(message, ROWS))
LEGAL = {
    'padded header': header(PADDING) + chunk(INSIDE) + ending(),
    'padded schema': chunk(schema(PADDING) + channel() + MESSAGES),
    'padded channel': chunk(schema() + channel(PADDING) + MESSAGES),
    'padded chunk': chunk(INSIDE, padding=PADDING),
    'padded attachment': chunk(INSIDE) + attachment(padding=PADDING),
    'private records beside chunks': PRIVATE + chunk(INSIDE) + PRIVATE,
    'private records in chunks': chunk(PRIVATE + INSIDE + PRIVATE),
    'records of a later version': FUTURE + chunk(FUTURE + INSIDE),
    'attachment without checksum': chunk(INSIDE) + attachment(0),
    'chunk without checksum': chunk(INSIDE, crc=0),
    'no chunks': INSIDE,
    'data checksum': header() + INSIDE + ending(zlib.crc32(header() + INSIDE)),
    'two frames of zstd': chunk(INSIDE, halves(INSIDE, zstd), 'zstd'),
    'two frames of lz4': chunk(INSIDE, halves(INSIDE, lz4.frame.compress), 'lz4'),
    'library in Latin-1': header(library='Ä'.encode('latin-1')) + chunk(INSIDE) + ending(),
    'summary of one channel': header() + chunk(INSIDE) + ending(summary=channel()),
    'index that is no index': chunk(INSIDE) + record(7, b'\xff' * 9),
    'empty chunk': chunk(b'') + chunk(INSIDE),
}


@pytest.mark.parametrize('name', LEGAL)
def test_what_the_format_allows_is_read(tmp_path, name):
    path = saved(tmp_path, file_of(LEGAL[name]))
    found = list(mcap_records(path))
    assert [one.data for one in found if isinstance(one, Message)] == [row.data for row in ROWS]
    assert isinstance(found[-1], Footer)
    assert sum(isinstance(one, Attachment) for one in found) == ('attachment' in name)
    log = read_log(path)
    assert log.complete
    assert len(log[STATES]) == len(ROWS)


@pytest.mark.parametrize(
    ('compression', 'chunked', 'indexed', 'crcs'),
    [
        *zip(
            CompressionType,
            (True, True, False),
            (True, False, True),
            (False, True, True),
            strict=False,
        ),
        (CompressionType.NONE, False, False, False),
        (CompressionType.ZSTD, True, True, True),
    ],
)
def test_files_of_the_package_mcap_are_read_as_it_reads_them(
    tmp_path, compression, chunked, indexed, crcs
):
    path = write_mcap(
        tmp_path / 'a.mcap',
        states(300),
        compression=compression,
        use_chunking=chunked,
        chunk_size=2000,
        enable_crcs=crcs,
        enable_data_crcs=crcs,
        use_statistics=indexed,
        use_summary_offsets=indexed,
        repeat_channels=indexed,
        repeat_schemas=indexed,
    )
    with path.open('rb') as stream:
        wanted = [one for one in StreamReader(stream).records if isinstance(one, Message)]
    assert messages(path) == wanted
    assert len(wanted) == 300


def test_a_file_is_read_up_to_its_cut_wherever_that_is(tmp_path):
    whole = write_mcap(tmp_path / 'w.mcap', states(12), chunk_size=500)
    data, wanted = whole.read_bytes(), messages(whole)
    counts = []
    for size in (*range(1, len(data) - 40, 5), *range(len(data) - 40, len(data))):
        found = list(mcap_records(saved(tmp_path, data[:size])))
        own = [one for one in found if isinstance(one, Message)]
        assert own == wanted[: len(own)]
        # The cut is seen even where only the last bytes are missing.
        assert not any(isinstance(one, Footer) for one in found)
        counts.append(len(own))
    assert counts == sorted(counts)
    assert counts[-1] == len(wanted)


def flip_outcome(path: Path, data: bytes, place: int, bit: int) -> Any:
    """Return the messages of a file with a flipped bit, or the error."""
    changed = bytearray(data)
    changed[place] ^= 1 << bit
    path.write_bytes(changed)
    try:
        return messages(path)
    except LogError as error:
        return error


def frames(data: bytes) -> list[tuple[int, int, int]]:
    """Return kind, begin and end of each record's body."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        kind, length = struct.unpack_from('<BQ', data, at)
        found.append((kind, at + 9, at + 9 + length))
        at += 9 + length
    return found


def test_a_flipped_bit_alters_no_message_and_is_damage_unless_it_is_in_an_index(tmp_path):
    whole = write_mcap(tmp_path / 'w.mcap', states(6), chunk_size=700, enable_data_crcs=True)
    data, wanted = whole.read_bytes(), messages(whole)
    parts = frames(data)
    (data_end,) = (begin for kind, begin, _ in parts if kind == 15)
    for k in range(0, data_end - 9, 3):
        # The record after them has their checksum.
        assert isinstance(flip_outcome(tmp_path / 'a.mcap', data, k, k % 8), LogError)
    for k in range(data_end - 9, len(data), 3):
        found = flip_outcome(tmp_path / 'a.mcap', data, k, k % 8)
        assert isinstance(found, LogError) or found == wanted
    # Nobody reads an index; without a checksum of all data.
    whole = write_mcap(tmp_path / 'v.mcap', states(6), chunk_size=700)
    data = whole.read_bytes()
    index = [part for part in frames(data) if part[0] in (7, 8, 10, 11, 13, 14)]
    assert {kind for kind, *_ in index} >= {7, 8, 11, 14}
    for _, begin, end in index:
        for place in range(begin, end, 3):
            assert flip_outcome(tmp_path / 'a.mcap', data, place, place % 8) == wanted


HUGE = struct.pack('<Q', 1 << 40)
STATED = struct.pack('<QQQI', 0, 0, 1 << 40, 0) + text('zstd') + struct.pack('<Q', 4) + b'abcd'
MANY = b''.join(channel(number=k) for k in range(1, MCAP_CHANNELS + 3))
MANY += b''.join(schema(number=k) for k in range(1, MCAP_CHANNELS + 3))
ZEROS = bytes(1 << 26)
# What takes long is made by its test alone.
HOSTILE = {
    'a chunk that states a terabyte': (record(6, STATED), 'unpack to more than'),
    'a gigabyte of zeros in kilobytes': (
        lambda: chunk(ZEROS, zstd(ZEROS), 'zstd', 0),
        'expansion=1000',
    ),
    'a chunk with more than it states': (
        lambda: chunk(INSIDE, zstd(ZEROS), 'zstd'),
        'another size',
    ),
    'an lz4 chunk with more than it states': (
        lambda: chunk(INSIDE, lz4.frame.compress(ZEROS), 'lz4'),
        'another size',
    ),
    'a chunk of another checksum': (chunk(INSIDE, crc=1), 'checksum'),
    'data of another checksum': (header() + INSIDE + ending(1), 'crc validation failed'),
    'an attachment of another checksum': (
        chunk(INSIDE) + attachment(1),
        'an attachment has another checksum',
    ),
    'a record longer than the file': (b'\x05' + HUGE, 'exceeds limit'),
    'a record a little longer than the file': (
        b'\x05' + struct.pack('<Q', 1000),
        'a record is longer than the file',
    ),
    'a record longer than its chunk': (chunk(INSIDE + b'\x05' + HUGE), 'longer than its chunk'),
    'a chunk that ends in a frame': (chunk(INSIDE + b'\x05'), 'a chunk ends within a record'),
    'a field longer than its record': (
        record(4, b'\1\0\1\0\xff\0\0\0a'),
        'a record ends within a field',
    ),
    'a message without its head': (record(5, b'abc'), 'ends within its head'),
    'a message of no channel': (message(ROWS[0]), 'unknown channel 1'),
    'an unknown compression': (
        chunk(INSIDE, compression='brotli'),
        "compression 'brotli', expected zstd, lz4 or none",
    ),
    'bytes that are no zstd': (chunk(INSIDE, b'no frame', 'zstd'), 'is damaged near byte'),
    'a definition of megabytes': (
        record(3, bytes(MCAP_TEXT_BYTES + 1)),
        'a record SCHEMA has 4194305 bytes',
    ),
    'channels without end': (MANY, f'more than {MCAP_CHANNELS} topics'),
    'two files in one': (WHOLE + WHOLE, 'bytes follow its footer; two files in one'),
    'another end': (WHOLE[:-8] + b'12345678', 'invalid magic'),
}


@pytest.mark.parametrize('name', HOSTILE)
def test_hostile_and_damaged_files_are_refused_with_a_line(tmp_path, name):
    content, line = HOSTILE[name]
    content = content() if callable(content) else content
    with pytest.raises(LogError, match=line) as raised:
        read_log(saved(tmp_path, file_of(content)))
    assert str(raised.value).startswith(str(tmp_path))
    assert str(raised.value).isprintable()


def test_the_bound_of_unpacked_bytes_can_be_raised(tmp_path):
    rows = [Row(STATES, k, ROWS[0].data[:52] + bytes(1 << 20)) for k in range(20)]
    path = write_mcap(tmp_path / 'a.mcap', rows, compression=CompressionType.ZSTD)
    with pytest.raises(LogError, match=r'mcap decompress.*expansion=1000'):
        messages(path)
    found = read_log(path, expansion=1e5, topics=[])
    assert len(found.received_ns[STATES]) == len(rows)


FOREIGN = {
    'lfs.mcap': (b'version https://git-lfs.github.com/spec/v1\noid sha256:0\n', 'git lfs pull'),
    'one.bag': (b'#ROSBAG V2.0\n' + bytes(99), 'ROS 1 bag.*rosbags-convert'),
    'z.mcap.gz': (gzip.compress(b'log'), 'gzip.*gunzip'),
    'z.mcap.zstd': (zstd(b'log'), 'zstd.*unzstd'),
    'z.mcap.lz4': (lz4.frame.compress(b'log'), 'lz4'),
    'empty.mcap': (b'', r'is empty \(0 bytes\)'),
    'a.zip': (b'PK\x03\x04' + bytes(99), 'ZIP'),
    'table.csv': (b't,q\n0,1\n', 'is a text'),
    'bytes.mcap': (bytes(range(200)), 'is not an MCAP file'),
    'px4.ulg': (b'ULog\x01\x12\x35' + bytes(20), 'PX4'),
}


@pytest.mark.parametrize('name', FOREIGN)
def test_files_that_are_no_log_are_named(tmp_path, name):
    content, line = FOREIGN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=line) as raised:
        read_log(tmp_path / name)
    assert 'damaged' not in str(raised.value)


def test_a_folder_a_device_and_a_missing_file_are_named(tmp_path):
    with pytest.raises(LogError, match=r'no MCAP or \.db3 file'):
        read_log(tmp_path)
    with pytest.raises(LogError, match='is not a regular file'):
        read_log('/dev/null')
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / 'none.mcap')


@settings(max_examples=3 * settings().max_examples)
@given(st.data())
def test_any_bytes_in_a_chunk_are_read_or_named(tmp_path_factory, data):
    raw = data.draw(st.binary(max_size=60)) + data.draw(st.sampled_from([b'', INSIDE]))
    path = saved(tmp_path_factory.mktemp('drawn'), MAGIC + chunk(raw) + ending())
    try:
        list(mcap_records(path))
    except LogError:
        event('refused')
    else:
        event('read')


Found = tuple[str, int, int, bytes]
# The place of the checksum in a chunk. Changed compressed data may unpack to the same bytes.
CHECKSUM = 33


def found_in(path: Path) -> list[Found]:
    """Return topic, number, time and bytes of the messages, by the reader of the package mcap."""
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            (channel.topic, message.sequence, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def chunks(path: Path) -> list[ChunkIndex]:
    with path.open('rb') as stream:
        return list(make_reader(stream).get_summary().chunk_indexes)


def described(path: Path) -> set[tuple[str, str, str, tuple[tuple[str, str], ...]]]:
    """Return topic, encoding, type and metadata of the channels."""
    with path.open('rb') as stream:
        found = make_reader(stream).get_summary()
    return {
        (c.topic, c.message_encoding, found.schemas[c.schema_id].name, (*c.metadata.items(),))
        for c in found.channels.values()
    }


@pytest.fixture(scope='module')
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of 60 steps in some twenty chunks."""
    folder = tmp_path_factory.mktemp('source')
    busy(folder / 'run.mcap')
    path = rewritten(folder / 'run.mcap', folder / 'chunks.mcap', chunk=1000)
    assert len(chunks(path)) > 10
    return path


def recovered(data: bytes, folder: Path) -> tuple[list[Found], list[str]]:
    """Return what is recovered of a file, and what is lost."""
    damaged, whole = folder / 'damaged.mcap', folder / 'whole.mcap'
    damaged.write_bytes(data)
    whole.unlink(missing_ok=True)
    found = recover_log(damaged, whole)
    kept = found_in(whole)
    assert found.messages == len(kept)
    return kept, found.lost


def test_of_a_whole_file_nothing_is_lost(source, tmp_path):
    kept, lost = recovered(source.read_bytes(), tmp_path)
    assert (kept, lost) == (found_in(source), [])
    assert verify_log(tmp_path / 'whole.mcap') == verify_log(source)
    assert verify_log(source).complete
    # Channels without messages, too.
    assert described(tmp_path / 'whole.mcap') == described(source)
    assert {topic for topic, *_ in described(source)} > {topic for topic, *_ in kept}


def test_a_cut_of_a_recovered_file_is_seen(source, tmp_path):
    recovered(source.read_bytes(), tmp_path)
    data, last = (tmp_path / 'whole.mcap').read_bytes(), chunks(tmp_path / 'whole.mcap')[-1]
    (tmp_path / 'cut.mcap').write_bytes(data[: last.chunk_start_offset])
    assert not verify_log(tmp_path / 'cut.mcap').complete


def test_what_follows_a_whole_file_is_reported(source, tmp_path):
    data = source.read_bytes()
    kept, lost = recovered(data + data, tmp_path)
    assert kept == found_in(source)
    assert [f'byte {len(data)} ' in part for part in lost] == [True]


def test_a_cut_costs_the_chunk_that_it_is_in(source, tmp_path):
    data, every = source.read_bytes(), found_in(source)
    some = 0
    for at in random.Random(3).sample(range(len(MCAP_MAGIC), len(data)), 40):
        kept, lost = recovered(data[:at], tmp_path)
        before = [c for c in chunks(source) if c.chunk_start_offset + c.chunk_length <= at]
        assert len(lost) == 1
        assert kept == every[: len(kept)]
        assert bool(kept) == bool(before)
        if kept:
            some += len(kept) < len(every)
            verified = verify_log(tmp_path / 'damaged.mcap')
            assert verified.compared.total() == len(kept)
            # A file that lacks nothing but its index is whole again.
            assert verify_log(tmp_path / 'whole.mcap')[:2] == verified[:2]
    assert some > 10


def test_a_damaged_chunk_costs_that_chunk_alone(source, tmp_path):
    data, every = source.read_bytes(), found_in(source)
    sizes = []
    for part in chunks(source):
        damaged, begin = bytearray(data), part.chunk_start_offset
        damaged[begin + CHECKSUM] ^= 8
        kept, lost = recovered(bytes(damaged), tmp_path)
        assert len(lost) == 1
        # With the topics of the first chunk, from the index.
        assert set(kept) < set(every)
        sizes.append(len(every) - len(kept))
        # Its size when unpacked comes after two times.
        bomb = data[: begin + 25] + struct.pack('<Q', 1 << 40) + data[begin + 33 :]
        assert recovered(bomb, tmp_path)[0] == kept
    assert sum(sizes) == len(every)


@pytest.mark.parametrize('length', [0, 5, 2000, 1 << 20, 1 << 62])
def test_a_damaged_length_costs_one_chunk_with_an_index_and_the_rest_without(
    length, source, tmp_path
):
    data, every = source.read_bytes(), found_in(source)
    part = chunks(source)[4]
    at = part.chunk_start_offset
    damaged = data[: at + 1] + struct.pack('<Q', length) + data[at + 9 :]
    kept, lost = recovered(damaged, tmp_path)
    after = [row for row in every if row[2] > part.message_end_time]
    assert len(lost) >= 1
    assert set(after) <= set(kept) < set(every)
    end = chunks(source)[-1]
    cut = damaged[: end.chunk_start_offset + end.chunk_length]
    kept, lost = recovered(cut, tmp_path)
    assert len(lost) >= 1
    assert kept
    assert set(kept) <= set(every) - set(after)


def test_a_damaged_index_costs_no_message(source, tmp_path):
    data, every = source.read_bytes(), found_in(source)
    (begin,) = struct.unpack('<Q', data[-28:-20])
    for part in chunks(source):
        place = data.index(struct.pack('<Q', part.chunk_start_offset), begin)
        damaged = bytearray(data)
        damaged[place] ^= 4
        assert recovered(bytes(damaged), tmp_path)[0] == every


@pytest.mark.parametrize('offset', [3, 1 << 40, (1 << 64) - 1])
def test_the_entries_of_the_index_that_are_right_are_used(offset, source, tmp_path):
    data = bytearray(source.read_bytes())
    (begin,) = struct.unpack('<Q', data[-28:-20])
    at, other = (chunks(source)[k].chunk_start_offset for k in (4, 9))
    data[at + 1 : at + 9] = struct.pack('<Q', 1 << 20)
    expected = recovered(bytes(data), tmp_path)
    place = data.index(struct.pack('<Q', other), begin)
    data[place : place + 8] = struct.pack('<Q', offset)
    assert recovered(bytes(data), tmp_path) == expected


def test_of_many_lost_parts_some_are_named_and_all_counted(source, tmp_path, capsys):
    path = rewritten(source, tmp_path / 'many.mcap', chunk=300)
    data, many = bytearray(path.read_bytes()), chunks(path)
    for part in many:
        data[part.chunk_start_offset + CHECKSUM] ^= 8
    path.write_bytes(data)
    assert pfd_main(['recover', str(path), '--out', str(tmp_path / 'whole.mcap')]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 20 < len(lines) == 22 < len(many)
    assert lines[-2].split() == ['lost', str(len(many)), 'parts', 'in', 'all']


def test_damage_outside_the_chunks_is_reported(source, tmp_path):
    data = bytearray(source.read_bytes())
    data[data.index(b'"seed"') + 1] ^= 1
    kept, lost = recovered(bytes(data), tmp_path)
    assert kept == found_in(source)
    assert ['crc validation failed' in part for part in lost] == [True]


def test_zeros_after_a_power_cut_are_reported(source, tmp_path):
    part = chunks(source)[6]
    end = part.chunk_start_offset + part.chunk_length
    begin = source.read_bytes()[:end]
    kept, lost = recovered(begin + bytes(100_000), tmp_path)
    assert kept == recovered(begin, tmp_path)[0]
    assert len(lost) == 1


@pytest.mark.parametrize('compression', CompressionType)
@pytest.mark.parametrize('chunked', [False, True])
def test_logs_of_others_are_copied(compression, chunked, tmp_path):
    path = tmp_path / 'other.mcap'
    with path.open('wb') as stream:
        writer = Writer(
            stream, 500, compression, IndexType.NONE, use_chunking=chunked, use_statistics=False
        )
        writer.start('', 'other')
        writer.add_attachment(3, 4, 'a.txt', 'text/plain', b'hello')
        bare = writer.register_channel('/bare', 'json', 0, {'who': 'me'})
        schema = writer.register_schema('X', 'jsonschema', b'{}')
        typed = writer.register_channel('/typed', 'json', schema)
        for k in range(40):
            writer.add_message([bare, typed][k % 2], 100 - k, b'{}' * k, k, k)
        writer.add_metadata('note', {'a': 'b'})
        writer.finish()
    kept, lost = recovered(path.read_bytes(), tmp_path)
    assert lost == []
    assert kept == found_in(path)
    with (tmp_path / 'whole.mcap').open('rb') as stream:
        reader = make_reader(stream)
        assert [(a.create_time, a.name, a.data) for a in reader.iter_attachments()] == [
            (3, 'a.txt', b'hello')
        ]
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [('note', {'a': 'b'})]
        found = {c.topic: c.metadata for c in reader.get_summary().channels.values()}
    assert found == {'/bare': {'who': 'me'}, '/typed': {}}


def test_any_damage_leaves_a_readable_file(source, tmp_path):
    data, every, rng = source.read_bytes(), set(found_in(source)), random.Random(5)
    for _ in range(60):
        damaged = bytearray(data)
        for _ in range(rng.choice([1, 1, 3])):
            at, many = rng.randrange(8, len(data)), rng.choice([1, 1, 8, 500])
            damaged[at : at + many] = rng.choice([b'', bytes(many), rng.randbytes(many)])
        kept, lost = recovered(bytes(damaged), tmp_path)
        assert set(kept) <= every
        assert len(kept) > 0 or lost
        assert lost or len(kept) == len(every)


def test_what_cannot_be_recovered_leaves_no_file(source, tmp_path):
    target = tmp_path / 'whole.mcap'
    for data in (b'', b'hello, world', b'version https://git-lfs.github.com/spec/v1\n'):
        (tmp_path / 'other').write_bytes(data)
        with pytest.raises(LogError, match='other'):
            recover_log(tmp_path / 'other', target)
    with largest_file(2000), pytest.raises(OSError, match='too large'):
        recover_log(source, target)
    with pytest.raises(FileNotFoundError):
        recover_log(tmp_path / 'missing', target)
    assert not target.exists()
    target.write_bytes(b'mine')
    with pytest.raises(FileExistsError):
        recover_log(source, target)
    assert target.read_bytes() == b'mine'
