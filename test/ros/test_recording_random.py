# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawn damage of recordings: refused with a LogError, or verified with the same messages."""

from __future__ import annotations

import functools
import json
from pathlib import Path

from bridge import (
    END_RECORD,
    HEAD_RECORD,
    REPLAY_INCOMPLETE,
    LogError,
    RecordedLog,
    ReplaySummary,
    read_recording,
)
from damage import damaged_bytes
from hypothesis import event, given, settings
from hypothesis import strategies as st
import numpy as np
from plant_messages import efforts
import pytest
from read_hostile import bounded, replay
from rewriting import ARRAY, NAMED, Recording
from simulating import simulate

# Processor time after which a file that takes minutes is given up, s.
SECONDS = 30.0

Message = tuple[str, int, bytes]


@functools.cache
def run() -> Recording:
    """Return a short run, moved by commands good and bad."""
    rng = np.random.default_rng(5)
    commands = {
        int(step): [efforts(*rng.uniform(-3, 3, rng.choice((2, 2, 2, 1))))]
        for step in rng.choice(np.arange(1, 60), 20, replace=False)
    }
    return simulate(60, commands, clock_rate=500.0)


def messages(path: Path) -> list[Message]:
    return [(entry.role, entry.sequence, entry.data) for entry in RecordedLog(path).entries()]


def by_topic(found: list[Message]) -> dict[str, list[Message]]:
    """Return the messages of each topic: a command may come in a little earlier or later."""
    return {role: [m for m in found if m[0] == role] for role in sorted({m[0] for m in found})}


def is_part(found: list[Message], whole: list[Message]) -> bool:
    """Return whether messages are some of the original ones, in their order."""
    rest = iter(whole)
    return all(message in rest for message in found)


def check(path: Path, original: list[Message]) -> ReplaySummary | None:
    """Verify a file that may be damaged; return its summary, or None if it is refused."""
    try:
        with bounded(SECONDS):
            summary = read_recording(path, verify=True)
    except LogError:
        return None
    found, wanted = by_topic(messages(path)), by_topic(original)
    for role, there in found.items():
        if not summary.absent:
            assert there == wanted[role]
        elif role not in summary.lost and not summary.complete:
            assert there == wanted[role][: len(there)]
        else:
            assert is_part(there, wanted[role])
    return summary


@pytest.fixture(scope='module')
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Message]]:
    """Return a small recording in several chunks, and its messages."""
    path = run().save(tmp_path_factory.mktemp('small') / 'a.mcap', chunk_size=2000)
    return path.read_bytes(), messages(path)


@pytest.fixture(scope='module')
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of the file that is written anew for each example."""
    return tmp_path_factory.mktemp('damaged') / 'a.mcap'


# --- bytes of the file

# The last bytes of a whole file.
MAGIC = b'\x89MCAP0\r\n'


def check_bytes(path: Path, data: bytes, whole: bytes, original: list[Message]) -> None:
    path.write_bytes(data)
    found = check(path, original)
    event('refused' if found is None else 'complete' if found.complete else 'cut off')
    # Damage that reaches the end may leave a file that was cut off.
    cut_off = found is not None and not found.complete and not data.endswith(MAGIC)
    assert found is None or cut_off or whole.startswith(data)


@settings(max_examples=3 * settings().max_examples)
@given(st.data())
def test_damaged_bytes_are_refused(
    small: tuple[bytes, list[Message]], damaged: Path, data: st.DataObject
) -> None:
    whole, original = small
    check_bytes(damaged, data.draw(damaged_bytes(whole)), whole, original)


# --- messages, with valid checksums

EITHER = ('drop', 'duplicate', 'swap', 'shuffle', 'renumber')
# A command that is altered, or made up and never taken, may change no state: only a digest
# tells, and a cut-off file has none.
CLOSED = (*EITHER, 'alter', 'move')
CUT_OFF = (*EITHER, 'alter_outputs')


def damage_messages(r: Recording, kind: str, draw: st.DrawFn) -> None:
    """Draw a change of a recording's messages and make it."""
    places = st.integers(0, len(r.messages) - 1)
    at = draw(places)
    message = r.messages[at]
    if kind == 'drop':
        del r.messages[at : at + draw(st.sampled_from((1, 1, 5)))]
    elif kind == 'duplicate':
        r.messages.insert(at, message)
    elif kind == 'swap':
        other = draw(places)
        r.messages[at], r.messages[other] = r.messages[other], message
    elif kind == 'shuffle':
        times = [m.log_ns for m in r.messages]
        draw(st.randoms(use_true_random=False)).shuffle(r.messages)
        for m, log_ns in zip(r.messages, times, strict=True):
            m.log_ns = log_ns
    elif kind == 'renumber':
        add = draw(st.sampled_from((-1, 1, 1000, 1 << 31)))
        message.sequence = (message.sequence + add) & 0xFFFFFFFF
    elif kind == 'move':
        message.topic = draw(st.sampled_from(r.channels)).topic
    else:
        spared = (NAMED, ARRAY) if kind == 'alter_outputs' else ()
        message = draw(
            st.sampled_from([m for m in r.messages if m.data and m.topic not in spared])
        )
        for _ in range(draw(st.integers(1, 8))):
            message.flip(draw(st.integers(0, len(message.data) - 1)), draw(st.integers(0, 7)))


@settings(max_examples=3 * settings().max_examples)
@given(st.data(), st.booleans())
@pytest.mark.slow
def test_altered_messages_are_refused(
    small: tuple[bytes, list[Message]], damaged: Path, data: st.DataObject, closed: bool
) -> None:
    whole = run()
    changed = whole.copy()
    kind = data.draw(st.sampled_from(CLOSED if closed else CUT_OFF))
    damage_messages(changed, kind, data.draw)
    now, before = ([(m.topic, m.sequence, m.data) for m in r.messages] for r in (changed, whole))
    changed.save(damaged, closed=closed)
    verified = check(damaged, small[1])
    event(f'{kind}, closed: {closed}, verified: {bool(verified)}')
    if verified and closed and verified.absent:
        # As a filter by time leaves it.
        assert now == before[len(before) - len(now) :]
    elif verified and closed:
        assert by_topic(now) == by_topic(before)


# --- settings and other texts of the head

STRANGE_JSON = (
    *('[' * 5000 + ']' * 5000, '{"a":' * 5000 + '1' + '}' * 5000, '9' * 5000, '1' + '0' * 400),
    *('NaN', '1e400', '-Infinity', '[1, 2', '"\\ud800"', '', '{}', 'null', 'true', '"x"', '[[1]]'),
)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
JSON = st.recursive(
    LEAVES, lambda x: st.lists(x) | st.dictionaries(st.text(max_size=5), x), max_leaves=5
)


@st.composite
def changed_heads(draw: st.DrawFn) -> Recording:
    """Draw the beginning of a run with another value of a setting, or of a text of its head."""
    found = run().copy()
    found.messages = found.messages[:3]
    head = found.head(HEAD_RECORD)
    value = draw(st.sampled_from(STRANGE_JSON) | JSON.map(json.dumps))
    name = draw(st.sampled_from(sorted(head)))
    if name == 'settings':
        texts = {key: json.dumps(known) for key, known in json.loads(head['settings']).items()}
        texts[draw(st.sampled_from(sorted(texts)))] = value
        value = '{' + ', '.join(f'{json.dumps(key)}: {text}' for key, text in texts.items()) + '}'
    head[name] = value
    if draw(st.integers(0, 9)) == 0:
        del head[name]
    return found


@settings(max_examples=3 * settings().max_examples)
@given(changed_heads())
def test_a_changed_head_is_refused_in_a_short_line_or_changes_nothing(
    damaged: Path, recording: Recording
) -> None:
    recording.save(damaged, closed=False)
    found = replay('--verify', str(damaged), SECONDS)
    event(f'status {found["status"]}')
    # The file has no end.
    assert found['status'] in (1, REPLAY_INCOMPLETE), found
    if found['status'] == 1:
        (line,) = found['err'].splitlines()
        assert line.isprintable()
        assert len(line) < 800
        assert damaged.name in line


NOTHING_YET = (
    'not a recording of this node|holds no states|no robot in its attachment|'
    'not an MCAP file|damaged after byte 8$'
)


def check_cut(path: Path, data: bytes, size: int, original: list[Message]) -> bool:
    """Verify a file cut to a size; it must hold the same, or say that it holds nothing yet."""
    path.write_bytes(data[:size])
    if check(path, original):
        return True
    with pytest.raises(LogError, match=NOTHING_YET):
        read_recording(path, verify=True)
    return False


def test_a_cut_in_the_last_chunk_is_no_damage(
    tmp_path: Path, small: tuple[bytes, list[Message]]
) -> None:
    whole, original = small
    # Of this writer the end record lies before that chunk; behind its name come its texts.
    start = whole.index(END_RECORD.encode()) - 4
    size = start + int.from_bytes(whole[start - 8 : start], 'little') + 20
    assert check_cut(tmp_path / 'a.mcap', whole, size, original)
    assert 0 < len(messages(tmp_path / 'a.mcap')) < len(original)


@pytest.mark.slow
def test_every_cut_of_a_recording_verifies_up_to_the_cut_or_holds_no_state(
    tmp_path: Path, small: tuple[bytes, list[Message]]
) -> None:
    whole, original = small
    sizes = range(0, len(whole), 151)
    verified = [check_cut(tmp_path / 'a.mcap', whole, size, original) for size in sizes]
    # Nothing is lost any more once something is there.
    assert verified == sorted(verified)
    assert sum(verified) > 10
