# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Seeded mutations of recordings: refused with a LogError, or verified with the same messages."""

from __future__ import annotations

from collections.abc import Callable
import functools
from pathlib import Path
import random

import pytest
from read_hostile import bounded
from rewriting import ARRAY, GOLDEN, NAMED, Recording, load
from simulating import efforts, simulate

from pfd_ros.recording.format import END
from pfd_ros.recording.reader import Log, LogError
from pfd_ros.replay.verify import Summary, read

# Processor time that one file may take, s.
SECONDS = 3.0
SEEDS = [
    *range(15),
    *(pytest.param(k, marks=pytest.mark.slow) for k in range(15, 30)),
    *(pytest.param(k, marks=[pytest.mark.slow, pytest.mark.long]) for k in range(30, 120)),
]
BLOCK = 64

Message = tuple[str, int, bytes]


@functools.cache
def run() -> Recording:
    """Return a short run, moved by commands good and bad."""
    draw = random.Random(5)
    commands = {
        step: [efforts(*(draw.uniform(-3, 3) for _ in range(draw.choice((2, 2, 2, 1)))))]
        for step in draw.sample(range(1, 60), 20)
    }
    return simulate(60, commands, clock_rate=500.0)


def messages(path: Path) -> list[Message]:
    return [(entry.role, entry.sequence, entry.data) for entry in Log(path).entries()]


def by_topic(found: list[Message]) -> dict[str, list[Message]]:
    """Return the messages of each topic: a command may come in a little earlier or later."""
    return {role: [m for m in found if m[0] == role] for role in sorted({m[0] for m in found})}


def is_part(found: list[Message], whole: list[Message]) -> bool:
    """Return whether messages are some of the original ones, in their order."""
    rest = iter(whole)
    return all(message in rest for message in found)


def check(path: Path, original: list[Message]) -> Summary | None:
    """Verify a file that may be damaged; return its summary, or None if it is refused."""
    try:
        with bounded(SECONDS):
            summary = read(path, verify=True)
    except LogError:
        return None
    found, wanted = by_topic(messages(path)), by_topic(original)
    for role, there in found.items():
        if summary.complete:
            assert there == wanted[role]
        elif role not in summary.lost:
            assert there == wanted[role][: len(there)]
        else:
            assert is_part(there, wanted[role])
    return summary


# --- bytes of the file


def flip(data: bytearray, draw: random.Random) -> None:
    for _ in range(draw.choice((1, 1, 2, 8))):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def cut(data: bytearray, draw: random.Random) -> None:
    del data[draw.randrange(len(data)) :]


def cut_and_flip(data: bytearray, draw: random.Random) -> None:
    cut(data, draw)
    if data:
        flip(data, draw)


def remove(data: bytearray, draw: random.Random) -> None:
    at = draw.randrange(len(data))
    del data[at : at + draw.randrange(1, BLOCK)]


def repeat(data: bytearray, draw: random.Random) -> None:
    at = draw.randrange(len(data))
    data[at:at] = data[at : at + draw.randrange(1, BLOCK)]


def overwrite(data: bytearray, draw: random.Random) -> None:
    at = draw.randrange(len(data))
    size = min(draw.randrange(1, BLOCK), len(data) - at)
    data[at : at + size] = draw.choice((bytes(size), b'\xff' * size, draw.randbytes(size)))


def grow(data: bytearray, draw: random.Random) -> None:
    data += draw.randbytes(draw.randrange(1, BLOCK))


BYTES = (flip, flip, cut, cut_and_flip, remove, repeat, overwrite, grow)
TEARS = (cut_and_flip, remove, overwrite)
# The last bytes of a whole file.
MAGIC = b'\x89MCAP0\r\n'


def damage_bytes(path: Path, seed: int, whole: bytes, original: list[Message]) -> None:
    draw = random.Random(seed)
    for mutate in BYTES:
        data = bytearray(whole)
        mutate(data, draw)
        path.write_bytes(data)
        found = check(path, original)
        # Damage that reaches the end may leave a file that was cut off.
        torn = mutate in TEARS and not data.endswith(MAGIC)
        cut_off = found is not None and not found.complete and torn
        assert found is None or cut_off or whole.startswith(data)


# --- messages, with valid checksums


def drop(r: Recording, draw: random.Random) -> None:
    at = draw.randrange(len(r.messages))
    del r.messages[at : at + draw.choice((1, 1, 5))]


def duplicate(r: Recording, draw: random.Random) -> None:
    at = draw.randrange(len(r.messages))
    r.messages.insert(at, r.messages[at])


def swap(r: Recording, draw: random.Random) -> None:
    one, other = (draw.randrange(len(r.messages)) for _ in range(2))
    r.messages[one], r.messages[other] = r.messages[other], r.messages[one]


def shuffle(r: Recording, draw: random.Random) -> None:
    times = [m.log_ns for m in r.messages]
    draw.shuffle(r.messages)
    for m, log_ns in zip(r.messages, times, strict=True):
        m.log_ns = log_ns


def renumber(r: Recording, draw: random.Random) -> None:
    message = draw.choice(r.messages)
    message.sequence = (message.sequence + draw.choice((-1, 1, 1000, 1 << 31))) & 0xFFFFFFFF


def move_topic(r: Recording, draw: random.Random) -> None:
    draw.choice(r.messages).topic = draw.choice(r.channels).topic


def alter(r: Recording, draw: random.Random, spared: tuple[str, ...] = ()) -> None:
    message = draw.choice([m for m in r.messages if m.topic not in spared and m.data])
    data = bytearray(message.data)
    flip(data, draw)
    message.data = bytes(data)


def alter_outputs(r: Recording, draw: random.Random) -> None:
    alter(r, draw, (NAMED, ARRAY))


Mutation = Callable[[Recording, random.Random], None]
EITHER: tuple[Mutation, ...] = (drop, duplicate, swap, shuffle, renumber)
# A command that is altered, or made up and never taken, may change no state: only a digest
# tells, and a cut-off file has none.
RECORDS: dict[bool, tuple[Mutation, ...]] = {
    True: (*EITHER, alter, move_topic),
    False: (*EITHER, alter_outputs),
}


def damage_records(path: Path, seed: int, whole: Recording, original: list[Message]) -> None:
    draw = random.Random(seed)
    for closed in (True, False):
        for mutate in RECORDS[closed]:
            changed = whole.copy()
            mutate(changed, draw)
            now, before = (
                [(m.topic, m.sequence, m.data) for m in r.messages] for r in (changed, whole)
            )
            same = by_topic(now) == by_topic(before)
            changed.save(path, closed=closed)
            verified = check(path, original)
            assert not verified or same or not closed


@pytest.fixture(scope='module')
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Message]]:
    """Return a small recording in several chunks, and its messages."""
    path = run().save(tmp_path_factory.mktemp('small') / 'a.mcap', chunk_size=2000)
    return path.read_bytes(), messages(path)


@pytest.mark.parametrize('seed', SEEDS)
def test_damaged_bytes_are_refused(
    tmp_path: Path, small: tuple[bytes, list[Message]], seed: int
) -> None:
    damage_bytes(tmp_path / 'a.mcap', seed, *small)


@pytest.mark.parametrize('seed', SEEDS)
def test_altered_messages_are_refused(
    tmp_path: Path, small: tuple[bytes, list[Message]], seed: int
) -> None:
    damage_records(tmp_path / 'a.mcap', seed, run(), small[1])


@pytest.mark.slow
def test_damaged_bytes_of_a_real_run_are_refused(tmp_path: Path) -> None:
    for seed in range(10):
        damage_bytes(tmp_path / 'a.mcap', seed, GOLDEN.read_bytes(), messages(GOLDEN))


NOTHING_YET = (
    'no recording of this node|holds no states|no robot in its attachment|'
    'not an MCAP file|damaged after byte 8$'
)


def check_cut(path: Path, data: bytes, size: int, original: list[Message]) -> bool:
    """Verify a file cut to a size; it must hold the same, or say that it holds nothing yet."""
    path.write_bytes(data[:size])
    if check(path, original):
        return True
    with pytest.raises(LogError, match=NOTHING_YET):
        read(path, verify=True)
    return False


@pytest.mark.parametrize('name', ['small', 'golden'])
def test_a_cut_in_the_last_chunk_is_no_damage(
    tmp_path: Path, small: tuple[bytes, list[Message]], name: str
) -> None:
    whole, original = small if name == 'small' else (GOLDEN.read_bytes(), messages(GOLDEN))
    # The end record lies before that chunk; behind its name come its texts.
    start = whole.index(END.encode()) - 4
    size = start + int.from_bytes(whole[start - 8 : start], 'little') + 20
    assert check_cut(tmp_path / 'a.mcap', whole, size, original)
    assert 0 < len(messages(tmp_path / 'a.mcap')) < len(original)


@pytest.mark.slow
def test_every_cut_of_a_recording_verifies_up_to_the_cut_or_holds_no_state(
    tmp_path: Path, small: tuple[bytes, list[Message]]
) -> None:
    whole, original = small
    sizes = range(0, len(whole), 61)
    verified = [check_cut(tmp_path / 'a.mcap', whole, size, original) for size in sizes]
    # Nothing is lost any more once something is there.
    assert verified == sorted(verified)
    assert sum(verified) > 25


def test_the_golden_recording_says_the_same_when_it_is_copied(tmp_path: Path) -> None:
    copied = load(GOLDEN).save(tmp_path / 'a.mcap')
    assert check(copied, messages(GOLDEN))
