# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""recover keeps what can be read of a cut off or damaged file, and names what it loses."""

from __future__ import annotations

from pathlib import Path
import random
import struct

from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from recordings import busy, largest_file, rewritten

from pfd_ros.cli.main import main as pfd_main
from pfd_ros.recording.format import LogError
from pfd_ros.recording.mcap_records import MAGIC as MCAP_MAGIC
from pfd_ros.recording.recover import recover as recover_log
from pfd_ros.replay.verify import verify as verify_log

Found = tuple[str, int, int, bytes]
# The place of the checksum in a chunk. Changed compressed data may unpack to the same bytes.
CHECKSUM = 33


def messages(path: Path) -> list[Found]:
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
    kept = messages(whole)
    assert found.messages == len(kept)
    return kept, found.lost


def test_of_a_whole_file_nothing_is_lost(source, tmp_path) -> None:
    kept, lost = recovered(source.read_bytes(), tmp_path)
    assert (kept, lost) == (messages(source), [])
    assert verify_log(tmp_path / 'whole.mcap') == verify_log(source)
    assert verify_log(source).complete
    # Channels without messages, too.
    assert described(tmp_path / 'whole.mcap') == described(source)
    assert {topic for topic, *_ in described(source)} > {topic for topic, *_ in kept}


def test_a_cut_of_a_recovered_file_is_seen(source, tmp_path) -> None:
    recovered(source.read_bytes(), tmp_path)
    data, last = (tmp_path / 'whole.mcap').read_bytes(), chunks(tmp_path / 'whole.mcap')[-1]
    (tmp_path / 'cut.mcap').write_bytes(data[: last.chunk_start_offset])
    assert not verify_log(tmp_path / 'cut.mcap').complete


def test_what_follows_a_whole_file_is_reported(source, tmp_path) -> None:
    data = source.read_bytes()
    kept, lost = recovered(data + data, tmp_path)
    assert kept == messages(source)
    assert [f'byte {len(data)} ' in part for part in lost] == [True]


def test_a_cut_costs_the_chunk_that_it_is_in(source, tmp_path) -> None:
    data, every = source.read_bytes(), messages(source)
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


def test_a_damaged_chunk_costs_that_chunk_alone(source, tmp_path) -> None:
    data, every = source.read_bytes(), messages(source)
    sizes = []
    for chunk in chunks(source):
        damaged, begin = bytearray(data), chunk.chunk_start_offset
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
    length: int, source, tmp_path
) -> None:
    data, every = source.read_bytes(), messages(source)
    chunk = chunks(source)[4]
    at = chunk.chunk_start_offset
    damaged = data[: at + 1] + struct.pack('<Q', length) + data[at + 9 :]
    kept, lost = recovered(damaged, tmp_path)
    after = [row for row in every if row[2] > chunk.message_end_time]
    assert len(lost) >= 1
    assert set(after) <= set(kept) < set(every)
    end = chunks(source)[-1]
    cut = damaged[: end.chunk_start_offset + end.chunk_length]
    kept, lost = recovered(cut, tmp_path)
    assert len(lost) >= 1
    assert kept
    assert set(kept) <= set(every) - set(after)


def test_a_damaged_index_costs_no_message(source, tmp_path) -> None:
    data, every = source.read_bytes(), messages(source)
    (begin,) = struct.unpack('<Q', data[-28:-20])
    for chunk in chunks(source):
        place = data.index(struct.pack('<Q', chunk.chunk_start_offset), begin)
        damaged = bytearray(data)
        damaged[place] ^= 4
        assert recovered(bytes(damaged), tmp_path)[0] == every


@pytest.mark.parametrize('offset', [3, 1 << 40, (1 << 64) - 1])
def test_the_entries_of_the_index_that_are_right_are_used(offset: int, source, tmp_path) -> None:
    data = bytearray(source.read_bytes())
    (begin,) = struct.unpack('<Q', data[-28:-20])
    at, other = (chunks(source)[k].chunk_start_offset for k in (4, 9))
    data[at + 1 : at + 9] = struct.pack('<Q', 1 << 20)
    expected = recovered(bytes(data), tmp_path)
    place = data.index(struct.pack('<Q', other), begin)
    data[place : place + 8] = struct.pack('<Q', offset)
    assert recovered(bytes(data), tmp_path) == expected


def test_of_many_lost_parts_some_are_named_and_all_counted(source, tmp_path, capsys) -> None:
    path = rewritten(source, tmp_path / 'many.mcap', chunk=300)
    data, many = bytearray(path.read_bytes()), chunks(path)
    for chunk in many:
        data[chunk.chunk_start_offset + CHECKSUM] ^= 8
    path.write_bytes(data)
    assert pfd_main(['recover', str(path), '--out', str(tmp_path / 'whole.mcap')]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 20 < len(lines) == 22 < len(many)
    assert lines[-2].split() == ['lost', str(len(many)), 'parts', 'in', 'all']


def test_damage_outside_the_chunks_is_reported(source, tmp_path) -> None:
    data = bytearray(source.read_bytes())
    data[data.index(b'"seed"') + 1] ^= 1
    kept, lost = recovered(bytes(data), tmp_path)
    assert kept == messages(source)
    assert ['crc validation failed' in part for part in lost] == [True]


def test_zeros_after_a_power_cut_are_reported(source, tmp_path) -> None:
    chunk = chunks(source)[6]
    end = chunk.chunk_start_offset + chunk.chunk_length
    begin = source.read_bytes()[:end]
    kept, lost = recovered(begin + bytes(100_000), tmp_path)
    assert kept == recovered(begin, tmp_path)[0]
    assert len(lost) == 1


@pytest.mark.parametrize('compression', CompressionType)
@pytest.mark.parametrize('chunked', [False, True])
def test_logs_of_others_are_copied(compression: CompressionType, chunked: bool, tmp_path) -> None:
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
    assert kept == messages(path)
    with (tmp_path / 'whole.mcap').open('rb') as stream:
        reader = make_reader(stream)
        assert [(a.create_time, a.name, a.data) for a in reader.iter_attachments()] == [
            (3, 'a.txt', b'hello')
        ]
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [('note', {'a': 'b'})]
        found = {c.topic: c.metadata for c in reader.get_summary().channels.values()}
    assert found == {'/bare': {'who': 'me'}, '/typed': {}}


def test_any_damage_leaves_a_readable_file(source, tmp_path) -> None:
    data, every, rng = source.read_bytes(), set(messages(source)), random.Random(5)
    for _ in range(60):
        damaged = bytearray(data)
        for _ in range(rng.choice([1, 1, 3])):
            at, many = rng.randrange(8, len(data)), rng.choice([1, 1, 8, 500])
            damaged[at : at + many] = rng.choice([b'', bytes(many), rng.randbytes(many)])
        kept, lost = recovered(bytes(damaged), tmp_path)
        assert set(kept) <= every
        assert len(kept) > 0 or lost
        assert lost or len(kept) == len(every)


def test_what_cannot_be_recovered_leaves_no_file(source, tmp_path) -> None:
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
