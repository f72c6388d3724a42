# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile recordings: messages that are lost, altered, out of order or too many, false totals."""

from __future__ import annotations

from collections.abc import Callable
import json
from typing import Any, NamedTuple

from bridge import END_RECORD, HEAD_RECORD, TAKEN_COLUMNS, decode_rows, encode_rows
from rewriting import ARRAY, CLOCK, NAMED, STATES, TAKEN, Recording, Sent

LARGE = 1 << 31
# The file's own name: the rest of the line is left open.
NAMED_FILE = 'GOLDEN'
Change = Callable[[Recording], object]


class Case(NamedTuple):
    """A part of the expected line, and a change of the golden recording, with valid checksums."""

    expected: str
    change: Change
    closed: bool = True
    # Whether the first messages are enough: the file is refused before they are simulated.
    short: bool = False


def renumber(topic: str, add: int) -> Change:
    """Add to the numbers of a topic, from 8 on."""

    def change(recording: Recording) -> None:
        for m in recording.on(topic):
            if m.sequence >= 8:
                m.sequence = (m.sequence + add) & 0xFFFFFFFF
        recording.recount()

    return change


# --- numbers that repeat, decrease or jump, in a closed file that counts them, and in a cut one


def numbers() -> dict[str, Case]:
    found = {}
    in_time, counted = 'steps can have been done', 'its end record counts'
    jumps = {
        STATES: (in_time, in_time),
        CLOCK: (in_time, in_time),
        TAKEN: ('lacks {} records of commands taken', counted),
        NAMED: ('lacks command', counted),
    }
    for topic, (cut, closed) in jumps.items():
        for name, add in {'repeats': -1, 'decreases': -5, 'wraps': LARGE}.items():
            case = Case('repeated or out of order', renumber(topic, add))
            found |= {
                f'{name}{topic}_closed': case,
                f'{name}{topic}_cut': case._replace(closed=False),
            }
        for jump in (10**6, LARGE - 2):
            change = renumber(topic, jump)
            found[f'jumps_{jump}{topic}_cut'] = Case(cut.format(jump), change, closed=False)
            found[f'jumps_{jump}{topic}_closed'] = Case(closed, change)
    return found


def jump_in_time(recording: Recording) -> None:
    """Jump, with recorded times that would explain it; only the stamp does not."""
    for m in recording.messages:
        if (m.topic == STATES and m.sequence > 100) or (m.topic == CLOCK and m.sequence > 50):
            m.sequence += 10**9 if m.topic == CLOCK else 2 * 10**9
    cut = next(k for k, m in enumerate(recording.messages) if m.sequence >= 10**9)
    for m in recording.messages[cut:]:
        m.log_ns += 10**17
    recording.messages[cut:] = [m for m in recording.messages[cut:] if m.topic in (STATES, CLOCK)]


def decrease_a_time(recording: Recording) -> None:
    recording.messages[50].log_ns -= 10**9


def swap_state_and_tick(recording: Recording) -> None:
    at = next(k for k, m in enumerate(recording.messages) if m.topic == CLOCK)
    one, other = recording.messages[at - 1 : at + 1]
    assert one.topic == STATES
    recording.messages[at - 1 : at + 1] = [other, one]
    one.log_ns, other.log_ns = other.log_ns, one.log_ns
    recording.recount()


# --- messages that are gone from a closed file

GONE: dict[str, Callable[[int, int], bool]] = {
    'front': lambda n, last: n <= 20,
    'middle': lambda n, last: last / 3 < n <= last / 2,
    'end': lambda n, last: n > last - 20,
    'half': lambda n, last: n % 2 == 0,
    'all': lambda n, last: True,
}


def without(topic: str, goes: Callable[[int, int], bool], *, recount: bool = False) -> Change:
    """Remove the messages of a topic of which `goes` says so, by number and last number."""

    def change(recording: Recording) -> None:
        last = recording.on(topic)[-1].sequence
        recording.keep(lambda m: m.topic != topic or not goes(m.sequence, last))
        if recount:
            recording.recount()

    return change


def alter_bytes(recording: Recording) -> None:
    """Alter a byte that no state depends on: the effort of a command for nobody."""
    recording.recount()
    next(m for m in recording.on(NAMED) if b'nobody' in m.data).flip()


# --- the end record

TOTALS = {
    'steps': [0, 537, 540, 10**9, 10**400, -1, 1.5, '538', None, True],
    'states': [0, 268, 270, [], float('nan')],
    'commands_accepted': [24, 26, {}],
    'failure': [None, 3],
}


def end(key: str, **values: Any) -> Change:
    return lambda r: r.edit(END_RECORD, key, lambda found: found.update(values))


def say(**texts: str) -> Change:
    """Set texts of the end record."""
    return lambda r: r.head(END_RECORD).update(texts)


def say_no_hex(recording: Recording) -> None:
    recording.recount()
    digests = json.loads(recording.head(END_RECORD)['digests'])
    digests[CLOCK] = 'é' * 64
    recording.head(END_RECORD)['digests'] = json.dumps(digests)


# --- rows of commands taken


def row(index: int, value: int) -> Change:
    """Set a column of a row."""

    def change(recording: Recording) -> None:
        message = recording.on(TAKEN)[5]
        rows = decode_rows(message.data, len(TAKEN_COLUMNS))
        rows[0][index] = value
        message.data = encode_rows(rows, TAKEN_COLUMNS)

    return change


def rows_are(data: bytes) -> Change:
    return lambda r: setattr(r.on(TAKEN)[3], 'data', data)


def say_overflowed(recording: Recording) -> None:
    """Say of a command that moved the arm that it was never taken."""
    for message in recording.on(TAKEN):
        rows = decode_rows(message.data, len(TAKEN_COLUMNS))
        if rows[0][3] == 0:
            rows[0][3] = 12
            message.data = encode_rows(rows, TAKEN_COLUMNS)
            return


# --- commands that are never taken must not be kept for ever


def flood(count: int, size: int) -> Change:
    def change(recording: Recording) -> None:
        last = recording.on(ARRAY)[-1]
        at = recording.messages.index(last) + 1
        recording.messages[at:at] = [
            Sent(ARRAY, last.sequence + k + 1, last.log_ns, bytes(size)) for k in range(count)
        ]

    return change


CASES = {
    **numbers(),
    'jumps_in_time_too': Case('recorded stamp', jump_in_time, closed=False),
    'log_times_decrease': Case('the message before it at', decrease_a_time, closed=False),
    'swapped_state_and_tick': Case('was recorded before it', swap_state_and_tick),
    **{
        f'without_{part}{topic}': Case('messages', without(topic, goes))
        for topic in (STATES, CLOCK)
        for part, goes in GONE.items()
    },
    'without_last_taken': Case(
        'of 37 messages taken: the last one is 36', without(TAKEN, lambda n, last: n == 37)
    ),
    'without_a_command': Case(
        'messages commands: 3 to 3', lambda r: r.messages.remove(r.on(ARRAY)[2])
    ),
    'without_ticks_and_recounted': Case('clock ticks', without(CLOCK, GONE['all'], recount=True)),
    'half_the_states_and_recounted': Case(
        'its end record counts', without(STATES, lambda n, last: n % 2 == 1, recount=True)
    ),
    'without_publish_clock': Case(
        'publish_clock is False',
        lambda r: r.edit(HEAD_RECORD, 'settings', lambda s: s.update(publish_clock=False)),
    ),
    'altered_bytes_of_no_effect': Case('not the recorded ones', alter_bytes),
    **{
        f'end_{name}_{value!r:.12}': Case(NAMED_FILE, end('totals', **{name: value}))
        for name, values in TOTALS.items()
        for value in values
    },
    'end_failure': Case('the end: recorded', end('totals', failure='it broke')),
    'end_states_counted': Case('messages joint_states', end('recorded', **{STATES: 268})),
    'end_more_dropped': Case('its end record counts', end('dropped', **{STATES: 1})),
    'end_of_other_topics': Case('messages dropped are of', end('dropped', **{'/x': 1})),
    'end_without_totals': Case('totals of its end', lambda r: r.head(END_RECORD).pop('totals')),
    'end_totals_list': Case('totals of its end', say(totals='[1]')),
    'end_digests_table': Case('digests', say(digests='[]')),
    'end_digests_few': Case('digests are of', say(digests='{}')),
    'end_digest_no_hex': Case('expected SHA-256', say_no_hex),
    'two_end_records': Case('two records', lambda r: r.metadata.append(r.metadata[-1])),
    'two_heads': Case('two records', lambda r: r.metadata.insert(0, r.metadata[0])),
    'row_verdict': Case('verdict 200', row(3, 200)),
    'row_other_verdict': Case('replayed as', row(3, 4), closed=False),
    'row_source': Case('source 9', row(1, 9)),
    'row_past': Case('was recorded before it', row(0, 1)),
    'row_step_0': Case('names steps [0]', row(0, 0)),
    'row_future': Case('steps can have been done', row(0, 10**18)),
    'row_near_future': Case('steps can have been done', row(0, 400), closed=False),
    'row_largest': Case('steps can have been done', row(0, 2**64 - 1)),
    'row_command': Case('lacks command 77', row(2, 77), closed=False),
    'row_garbage': Case(NAMED_FILE, rows_are(b'\xff' * 40)),
    'row_empty': Case(NAMED_FILE, rows_are(b'')),
    'row_overflowed': Case('joint', say_overflowed, closed=False),
    # The replay keeps 65536 commands of 64 MiB.
    'flood_of_small_commands': Case('were never taken', flood(70_000, 0), closed=False),
    'flood_of_large_commands': Case('were never taken', flood(70, 1 << 20), closed=False),
}
