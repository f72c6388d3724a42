# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd recover` keeps every message that can be read, and other readers open the new file."""

from __future__ import annotations

import io
from pathlib import Path
import struct

from bridge import MCAP_MAGIC, LogError, pfd_main, read_recording, recover_log
from damage import damaged_bytes
from hypothesis import given, settings
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
import pytest
from rewriting import GOLDEN, STATES, load

DATA = GOLDEN.read_bytes()


def messages_of(path: Path) -> list[tuple[str, int, int, bytes]]:
    """Return topic, number, time and bytes of the messages, by the reader of the package mcap."""
    with path.open('rb') as stream:
        found = make_reader(stream).iter_messages(log_time_order=False)
        return [(c.topic, m.sequence, m.log_time, m.data) for _, c, m in found]


def streamed(data: bytes) -> int:
    """Return the messages that the stream reader of mcap finds up to the end of a cut file."""
    count = 0
    try:
        for record in StreamReader(io.BytesIO(data)).records:
            count += isinstance(record, Message)
    except (McapError, ValueError, EOFError, struct.error):
        pass
    return count


def chunks(path: Path) -> list[tuple[int, int]]:
    """Return begin and end of the chunks of a file."""
    with path.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    begins = sorted((c.chunk_start_offset, c.chunk_length) for c in summary.chunk_indexes)
    return [(begin, begin + length) for begin, length in begins]


def test_a_whole_file_keeps_all_of_it_and_verifies(tmp_path: Path) -> None:
    found = recover_log(GOLDEN, tmp_path / 'a.mcap')
    assert (found.lost_parts, found.lost) == (0, [])
    assert messages_of(tmp_path / 'a.mcap') == messages_of(GOLDEN)
    before, after = load(GOLDEN), load(tmp_path / 'a.mcap')
    assert (after.metadata, after.attachments) == (before.metadata, before.attachments)
    summary = read_recording(tmp_path / 'a.mcap', verify=True)
    assert summary.absent == []


@pytest.mark.parametrize('share', [0.2, 0.5, 0.77, 0.9, 0.99])
def test_a_cut_off_file_keeps_all_messages_that_a_stream_reader_finds_and_verifies(
    tmp_path: Path, share: float
) -> None:
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(DATA[: int(share * len(DATA))])
    found = recover_log(cut, tmp_path / 'a.mcap')
    assert found.lost_parts == 1
    kept = messages_of(tmp_path / 'a.mcap')
    assert kept == messages_of(GOLDEN)[: len(kept)]
    assert len(kept) == found.messages >= streamed(cut.read_bytes())
    if any(topic == STATES for topic, *_ in kept):
        # The end record comes right after the last message: without the index nothing is lost.
        lacks = bool(read_recording(tmp_path / 'a.mcap', verify=True).absent)
        assert lacks == (len(kept) < len(messages_of(GOLDEN)))


def test_a_damaged_chunk_costs_that_chunk_alone(tmp_path: Path) -> None:
    begin, end = chunks(GOLDEN)[1]
    damaged = bytearray(DATA)
    damaged[(begin + end) // 2] ^= 0x55
    path = tmp_path / 'damaged.mcap'
    path.write_bytes(damaged)
    found = recover_log(path, tmp_path / 'a.mcap')
    assert found.lost_parts == 1
    assert f'at byte {begin + 9}' in found.lost[0]
    kept, whole = messages_of(tmp_path / 'a.mcap'), messages_of(GOLDEN)
    records = StreamReader(io.BytesIO(DATA), emit_chunks=True).records
    chunk = [record for record in records if isinstance(record, Chunk)][1]
    inside = [m for m in whole if chunk.message_start_time <= m[2] <= chunk.message_end_time]
    assert 0 < len(whole) - len(kept) <= len(inside)
    assert [m for m in whole if m in kept] == kept


@pytest.mark.parametrize(
    ('chunk', 'byte', 'bit', 'lost'),
    [
        # The schemas and channels in the first chunk are in the index, too.
        pytest.param(0, 200, 0x55, 'at byte', id='contents of the first'),
        pytest.param(3, 6, 0x10, 'their length is damaged', id='length'),
    ],
)
def test_a_damaged_chunk_of_many_costs_its_messages_and_no_topic(
    tmp_path: Path, chunk: int, byte: int, bit: int, lost: str
) -> None:
    path = load(GOLDEN).save(tmp_path / 'small.mcap', chunk_size=2000)
    begin, _ = chunks(path)[chunk]
    data = bytearray(path.read_bytes())
    data[begin + byte] ^= bit
    path.write_bytes(data)
    found = recover_log(path, tmp_path / 'a.mcap')
    assert found.lost_parts == 1
    assert lost in found.lost[0]
    assert 0 < len(messages_of(GOLDEN)) - found.messages < 30


def damage_index_offset(data: bytearray, chunk: int, xor: int, crc: bool) -> None:
    """Change the offset of a chunk in the index; without `crc` also remove the checksum."""
    # At the end: the body of the footer (start of the summary, ..., checksum) and the magic.
    (at,) = struct.unpack_from('<Q', data, len(data) - 28)
    number = -1
    while True:
        kind, length = struct.unpack_from('<BQ', data, at)
        number += kind == Opcode.CHUNK_INDEX
        if number == chunk:
            # Frame, first and last time of the chunk.
            (offset,) = struct.unpack_from('<Q', data, at + 9 + 16)
            struct.pack_into('<Q', data, at + 9 + 16, offset ^ xor)
            break
        at += 9 + length
    if not crc:
        data[-12:-8] = bytes(4)


@pytest.mark.sweep
@pytest.mark.parametrize('crc', [True, False], ids=['checksum differs', 'no checksum'])
@pytest.mark.parametrize('xor', [0x07, 0x4000])
def test_a_damaged_offset_in_the_index_costs_no_message(
    tmp_path: Path, xor: int, crc: bool
) -> None:
    path = load(GOLDEN).save(tmp_path / 'small.mcap', chunk_size=2000)
    whole, data = messages_of(path), path.read_bytes()
    count = len(chunks(path))
    assert count > 20
    for chunk in range(count):
        damaged = bytearray(data)
        damage_index_offset(damaged, chunk, xor, crc)
        path.write_bytes(damaged)
        target = tmp_path / f'{chunk}.mcap'
        found = recover_log(path, target)
        assert messages_of(target) == whole
        assert found.messages == len(whole)
        assert not any('length is damaged' in part for part in found.lost)
        assert found.lost_parts == crc


def test_damage_outside_the_chunks_is_not_called_whole(tmp_path: Path) -> None:
    damaged = bytearray(DATA)
    damaged[DATA.index(b'"cpu"') + 8] ^= 0x01
    path = tmp_path / 'damaged.mcap'
    path.write_bytes(damaged)
    found = recover_log(path, tmp_path / 'a.mcap')
    assert 'checksum of the data section' in found.lost[0]


def test_zeros_at_the_end_of_a_file_end_the_walk(tmp_path: Path) -> None:
    path = tmp_path / 'zeros.mcap'
    with path.open('wb') as stream:
        stream.write(DATA[:40_000])
        stream.truncate(1 << 28)
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(DATA[:40_000])
    recover_log(path, tmp_path / 'a.mcap')
    recover_log(cut, tmp_path / 'b.mcap')
    # The zeros stand for the rest of a chunk that the disk never got.
    assert messages_of(tmp_path / 'a.mcap') == messages_of(tmp_path / 'b.mcap')


def test_messages_of_a_chunk_that_the_file_ends_within_are_kept(tmp_path: Path) -> None:
    # Without compression each whole message of the last chunk can be read.
    run = load(GOLDEN)
    path = run.save(tmp_path / 'plain.mcap', compression=CompressionType.NONE)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    found = recover_log(path, tmp_path / 'a.mcap')
    assert streamed(path.read_bytes()) < found.messages
    kept = messages_of(tmp_path / 'a.mcap')
    assert [(topic, data) for topic, _, _, data in kept] == [
        (sent.topic, sent.data) for sent in run.messages[: len(kept)]
    ]


def test_the_command_prints_the_losses_and_never_overwrites(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(DATA[:40_000])
    assert pfd_main(['recover', str(cut)]) == 0
    out = capsys.readouterr().out
    assert 'lost       the end, from byte' in out
    assert f'messages in {tmp_path / "cut.recovered.mcap"}; the log was incomplete' in out
    assert pfd_main(['recover', str(cut)]) == 1
    assert 'File exists' in capsys.readouterr().err


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for files, which each example overwrites."""
    return tmp_path_factory.mktemp('recover')


def test_a_file_that_is_no_mcap_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    path.write_bytes(b'x' * 1000)
    with pytest.raises(LogError, match='nothing to recover'):
        recover_log(path, tmp_path / 'b.mcap')
    assert not (tmp_path / 'b.mcap').exists()


@settings(max_examples=60)
@given(damaged=damaged_bytes(DATA))
def test_a_damaged_file_is_recovered_into_a_readable_file(damaged: bytes, folder: Path) -> None:
    path, target = folder / 'damaged.mcap', folder / 'recovered.mcap'
    path.write_bytes(DATA[: len(MCAP_MAGIC)] + damaged[len(MCAP_MAGIC) :])
    target.unlink(missing_ok=True)
    recover_log(path, target)
    # Every chunk has a checksum, so no message is another one; channels have none.
    assert {m[3] for m in messages_of(target)} <= {m[3] for m in messages_of(GOLDEN)}
