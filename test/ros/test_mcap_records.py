# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any MCAP file is read as the format allows; damage, cuts, bombs and foreign files are named."""

from __future__ import annotations

from collections.abc import Callable
import gzip
from pathlib import Path
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
from mcap.records import Attachment, Footer, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
import pytest
import zstandard

from pfd_ros import read_log
from pfd_ros.recording.format import LogError
from pfd_ros.recording.mcap_records import CHANNELS as MCAP_CHANNELS
from pfd_ros.recording.mcap_records import TEXT_BYTES as MCAP_TEXT_BYTES
from pfd_ros.recording.mcap_records import records as mcap_records

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


LEGAL = {
    'padded header': header(PADDING) + chunk(INSIDE) + ending(),
    'padded schema': header() + chunk(schema(PADDING) + INSIDE[len(schema()) :]) + ending(),
    'padded channel': header()
    + chunk(schema() + channel(PADDING) + b''.join(map(message, ROWS)))
    + ending(),
    'padded chunk': header() + chunk(INSIDE, padding=PADDING) + ending(),
    'padded attachment': header() + chunk(INSIDE) + attachment(padding=PADDING) + ending(),
    'private records beside chunks': header() + PRIVATE + chunk(INSIDE) + PRIVATE + ending(),
    'private records in chunks': header() + chunk(PRIVATE + INSIDE + PRIVATE) + ending(),
    'records of a later version': header() + FUTURE + chunk(FUTURE + INSIDE) + ending(),
    'attachment without checksum': header() + chunk(INSIDE) + attachment(0) + ending(),
    'chunk without checksum': header() + chunk(INSIDE, crc=0) + ending(),
    'no chunks': header() + INSIDE + ending(),
    'data checksum': header() + INSIDE + ending(zlib.crc32(header() + INSIDE)),
    'two frames of zstd': header() + chunk(INSIDE, halves(INSIDE, zstd), 'zstd') + ending(),
    'two frames of lz4': header()
    + chunk(INSIDE, halves(INSIDE, lz4.frame.compress), 'lz4')
    + ending(),
    'library in Latin-1': header(library='Ä'.encode('latin-1')) + chunk(INSIDE) + ending(),
    'summary of one channel': header() + chunk(INSIDE) + ending(summary=channel()),
    'index that is no index': header() + chunk(INSIDE) + record(7, b'\xff' * 9) + ending(),
    'empty chunk': header() + chunk(b'') + chunk(INSIDE) + ending(),
}


@pytest.mark.parametrize('name', LEGAL)
def test_what_the_format_allows_is_read(tmp_path, name: str) -> None:
    path = saved(tmp_path, LEGAL[name])
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
    tmp_path, compression: CompressionType, chunked: bool, indexed: bool, crcs: bool
) -> None:
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


def test_a_file_is_read_up_to_its_cut_wherever_that_is(tmp_path) -> None:
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


def test_a_flipped_bit_alters_no_message_and_is_damage_unless_it_is_in_an_index(tmp_path) -> None:
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
HOSTILE = {
    'a chunk that states a terabyte': (
        header() + record(6, STATED) + ending(),
        'unpack to more than',
    ),
    'a gigabyte of zeros in kilobytes': (
        header() + chunk(bytes(1 << 26), zstd(bytes(1 << 26)), 'zstd', crc=0) + ending(),
        r'expansion=1000',
    ),
    'a chunk with more than it states': (
        header() + chunk(INSIDE, zstd(bytes(1 << 26)), 'zstd') + ending(),
        'another size',
    ),
    'an lz4 chunk with more than it states': (
        header() + chunk(INSIDE, lz4.frame.compress(bytes(1 << 26)), 'lz4') + ending(),
        'another size',
    ),
    'a chunk of another checksum': (header() + chunk(INSIDE, crc=1) + ending(), 'checksum'),
    'data of another checksum': (header() + INSIDE + ending(1), 'crc validation failed'),
    'an attachment of another checksum': (
        header() + chunk(INSIDE) + attachment(1) + ending(),
        'an attachment has another checksum',
    ),
    'a record longer than the file': (header() + b'\x05' + HUGE + ending(), 'exceeds limit'),
    'a record a little longer than the file': (
        header() + b'\x05' + struct.pack('<Q', 1000) + ending(),
        'a record is longer than the file',
    ),
    'a record longer than its chunk': (
        header() + chunk(INSIDE + b'\x05' + HUGE) + ending(),
        'a record is longer than its chunk',
    ),
    'a chunk that ends in a frame': (
        header() + chunk(INSIDE + b'\x05') + ending(),
        'a chunk ends within a record',
    ),
    'a field longer than its record': (
        header() + record(4, b'\1\0\1\0\xff\0\0\0a') + ending(),
        'a record ends within a field',
    ),
    'a message without its head': (
        header() + record(5, b'abc') + ending(),
        'ends within its head',
    ),
    'a message of no channel': (header() + message(ROWS[0]) + ending(), 'unknown channel 1'),
    'an unknown compression': (
        header() + chunk(INSIDE, compression='brotli') + ending(),
        "compression 'brotli', expected zstd, lz4 or none",
    ),
    'bytes that are no zstd': (
        header() + chunk(INSIDE, b'no frame', 'zstd') + ending(),
        'is damaged near byte',
    ),
    'a definition of megabytes': (
        header() + record(3, bytes(MCAP_TEXT_BYTES + 1)) + ending(),
        'a record SCHEMA has 4194305 bytes',
    ),
    'channels without end': (header() + MANY + ending(), f'more than {MCAP_CHANNELS} topics'),
    'two files in one': (WHOLE + WHOLE, 'bytes follow its footer; two files in one'),
    'another end': (WHOLE[:-8] + b'12345678', 'invalid magic'),
}


@pytest.mark.parametrize('name', HOSTILE)
def test_hostile_and_damaged_files_are_refused_with_a_line(tmp_path, name: str) -> None:
    content, line = HOSTILE[name]
    with pytest.raises(LogError, match=line) as raised:
        read_log(saved(tmp_path, content))
    assert str(raised.value).startswith(str(tmp_path))
    assert str(raised.value).isprintable()


def test_the_bound_of_unpacked_bytes_can_be_raised(tmp_path) -> None:
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
def test_files_that_are_no_log_are_named(tmp_path, name: str) -> None:
    content, line = FOREIGN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=line) as raised:
        read_log(tmp_path / name)
    assert 'damaged' not in str(raised.value)


def test_a_folder_a_device_and_a_missing_file_are_named(tmp_path) -> None:
    with pytest.raises(LogError, match=r'no MCAP or \.db3 file'):
        read_log(tmp_path)
    with pytest.raises(LogError, match='is not a regular file'):
        read_log('/dev/null')
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / 'none.mcap')


@settings(max_examples=3 * settings().max_examples)
@given(st.data())
def test_any_bytes_in_a_chunk_are_read_or_named(tmp_path_factory, data: st.DataObject) -> None:
    raw = data.draw(st.binary(max_size=60)) + data.draw(st.sampled_from([b'', INSIDE]))
    path = saved(tmp_path_factory.mktemp('drawn'), MAGIC + chunk(raw) + ending())
    try:
        list(mcap_records(path))
    except LogError:
        event('refused')
    else:
        event('read')
