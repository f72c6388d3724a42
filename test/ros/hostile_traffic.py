# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile messages for every topic of a node, at random from a seed.

None tears the arm apart, or lets its time leap where no later tick could follow.
"""

from __future__ import annotations

from collections.abc import Iterator
import random
import struct

from bridge import (
    MOST_STEPS_AHEAD,
    Arrival,
    CdrWriter,
    Engine,
    JointCommands,
    Settings,
    Source,
    Validation,
    Verdict,
    WrenchChange,
    decode_clock,
    encode_clock,
    load_arm_robot,
)
import numpy as np
from ros_processes import JOINTS

# Largest message for which the memory of the whole process is validated.
SMALL_BYTES = 2048
SMALL = 2.0  # N m; more than one joint of the arm never gets
SAVAGE = (float('nan'), float('inf'), -float('inf'), 1e308, -1e300, 5e-324, -0.0, 2.0**53)
NAMES = (
    '',
    '{',
    '}',
    '{0}',
    '{!r}',
    '%s%n',
    '\\',
    'a\nb',
    '\x1b[2J',
    '\x7f',
    'ä',
    '关节',
    '😀',
    '..',
)
LONGEST_NAME = 1 << 20
MILLISECOND = 10**6
# Farther ahead than an arm of 1 kHz follows at once, ns; after a reset its time leaps there.
FARTHEST_TICK = MOST_STEPS_AHEAD * MILLISECOND * 3 // 2
# Validation results of an arm with its own clock; only a flood overflows.
REJECTIONS = tuple(set(Verdict) - {Verdict.ACCEPTED, Verdict.OVERFLOWED, Verdict.STALE})
# The sources that are topics of a node with its own clock.
TOPICS = (Source.NAMED, Source.ARRAY, Source.SET_STATE, Source.WRENCH, Source.PAYLOAD)
# Of puma560, the default.
TIP = 'flange'


class Ticks:
    """A source of hostile ticks as bytes, for an arm that follows their clock."""

    def __init__(self, chance: random.Random) -> None:
        self._random = chance
        # Its latest tick that an arm follows: time continues there.
        self._now_ns = self._reached_ns = 0

    def after(self, reached_ns: int) -> bytes:
        """Return a tick for an arm that has reached a simulated time: mostly one that fits."""
        self._now_ns = max(self._now_ns, reached_ns)
        self._reached_ns = reached_ns
        kind = self._random.randrange(100)
        if kind < 60:
            return encode_clock(self._now_ns + self._random.randrange(20 * MILLISECOND))
        if kind < 75:
            return encode_clock(max(self._now_ns - self._random.randrange(FARTHEST_TICK), 0))
        tick = bytearray(encode_clock(self._now_ns))
        if kind == 75:
            tick = bytearray(encode_clock(self._now_ns + self._random.randrange(FARTHEST_TICK)))
        elif kind < 90:
            tick[self._random.randrange(len(tick))] = self._random.randrange(256)
        else:
            # The middleware has no room for more than a tick.
            tick = bytearray(self._random.randbytes(self._random.randrange(4, len(tick) + 1)))
        return bytes(tick) if self._can_follow(bytes(tick)) else encode_clock(self._now_ns)

    def _can_follow(self, tick: bytes) -> bool:
        """Return whether later ticks can follow one, and take note of one that the arm follows."""
        try:
            stamp_ns = decode_clock(tick)
        except ValueError:
            return True
        if stamp_ns > self._now_ns + FARTHEST_TICK:
            return False
        # One that is refused as too far ahead leaves the arm where it is: so must the later ones.
        if stamp_ns <= self._reached_ns + MOST_STEPS_AHEAD * MILLISECOND:
            self._now_ns = max(self._now_ns, stamp_ns)
        return True


class Messages:
    """A source of hostile messages as bytes."""

    def __init__(self, seed: int, largest: int = SMALL_BYTES) -> None:
        self.random = random.Random(seed)
        self._largest = largest
        settings = Settings(damping=True, external_wrench=True)
        self._engine = Engine(settings, load_arm_robot(settings))

    def name(self) -> str:
        chance = self.random.random()
        if chance < 0.4:
            return self.random.choice(JOINTS)
        if chance < 0.7:
            return self.random.choice(NAMES)
        if chance < 0.997:
            return f'{self.random.getrandbits(64):x}'
        return f'{self.random.getrandbits(64):x}' * self.random.randrange(LONGEST_NAME // 16)

    def size(self) -> int:
        return self.random.choice((0, 0, 1, 2, 5, 6, 6, 6, 6, 7, 100, self.random.randrange(3000)))

    def numbers(self, size: int, *, savage: float) -> np.ndarray:
        kinds = self.random.choice((SAVAGE, SAVAGE[:1]))
        return np.array(
            [
                self.random.choice(kinds)
                if self.random.random() < savage
                else self.random.uniform(-SMALL, SMALL)
                for _ in range(size)
            ]
        )

    def stamp(self, writer: CdrWriter) -> None:
        """Append a time: seconds, some negative, and nanoseconds, some of a second or more."""
        writer.uint32(self.random.choice((0, 0, 0, -1 % 2**32, 1, 2**31 - 1)))
        writer.uint32(self.random.choice((0, 0, 0, 1, 2**32 - 1)))

    def named(self) -> bytes:
        """Return a JointState: whole or ragged, known joints or strange ones."""
        names = list(JOINTS)
        if self.random.random() < 0.7:
            names = [self.name() for _ in range(self.size())]
        writer = CdrWriter()
        self.stamp(writer)
        writer.string(self.name())
        writer.strings(tuple(names))
        for _ in range(3):
            size = len(names) if self.random.random() < 0.8 else self.size()
            size = 0 if self.random.random() < 0.3 else size
            writer.numbers(self.numbers(size, savage=self.random.choice((0.0, 0.0, 0.2, 1.0))))
        return bytes(writer.data)

    def plain(self) -> bytes:
        """Return a Float64MultiArray, some with a layout."""
        writer = CdrWriter()
        dimensions = self.random.choice((0, 0, 0, 1, 50))
        writer.uint32(dimensions)
        for _ in range(dimensions):
            writer.string(self.name())
            writer.uint32(self.random.getrandbits(32))
            writer.uint32(self.random.getrandbits(32))
        writer.uint32(self.random.getrandbits(32))
        writer.numbers(self.numbers(self.size(), savage=self.random.choice((0.0, 0.0, 0.2))))
        return bytes(writer.data)

    def stamped(self, count: int) -> bytes:
        """Return numbers with a header: a WrenchStamped has 6, an InertiaStamped 10."""
        writer = CdrWriter()
        self.stamp(writer)
        writer.string(TIP if self.random.random() < 0.5 else self.name())
        writer.row(self.numbers(count, savage=self.random.choice((0.0, 0.0, 0.2))))
        return bytes(writer.data)

    def whole(self, source: Source) -> bytes:
        """Return a message of the type of a source."""
        if source is Source.ARRAY:
            return self.plain()
        counts = {Source.WRENCH: 6, Source.PAYLOAD: 10}
        return self.stamped(counts[source]) if source in counts else self.named()

    def broken(self, source: Source) -> bytes:
        """Return bytes that may be no message: cut, changed, with a wild length, or noise."""
        data = bytearray(self.whole(source))
        kind = self.random.randrange(4)
        if kind == 0:
            return bytes(data[: self.random.randrange(4, len(data) + 1)])
        if kind == 1:
            return bytes(data[:4]) + self.random.randbytes(self.random.randrange(2000))
        if kind == 2:
            for _ in range(self.random.randrange(1, 8)):
                data[self.random.randrange(len(data))] = self.random.randrange(256)
            return bytes(data)
        at = 4 * self.random.randrange(len(data) // 4)
        struct.pack_into('<I', data, at, self.random.choice((2**32 - 1, 2**31, 10**6, 0)))
        return bytes(data)

    def __iter__(self) -> Iterator[tuple[Source, bytes]]:
        """Yield messages that do not tear the arm apart."""
        while True:
            source = self.random.choice(TOPICS)
            data = self.broken(source) if self.random.random() < 0.3 else self.whole(source)
            if len(data) <= self._largest and self._is_gentle(source, data):
                yield source, data

    def _is_gentle(self, source: Source, data: bytes) -> bool:
        effect = self._validation(source, data).effect
        if isinstance(effect, JointCommands):
            given = [kind for kind in effect[1:] if kind is not None]
            return all(bool((np.abs(kind) <= SMALL).all()) for kind in given)
        return not isinstance(effect, WrenchChange) or max(map(abs, effect.wrench)) <= SMALL

    def _validation(self, source: Source, data: bytes) -> Validation:
        # The middleware fills up to four bytes: a message that was cut may come out whole.
        return self._engine.validate(Arrival(source, 1, data + bytes(-len(data) % 4)))

    def of_each_verdict(self) -> Iterator[tuple[Verdict, Source, bytes]]:
        """Yield a message for each of REJECTIONS, of a size that every middleware delivers."""
        missing = set(REJECTIONS)
        for source, data in self:
            verdict = self._validation(source, data).verdict
            # One with a stamp would be stale where a followed clock has leapt.
            stamped = source is not Source.ARRAY and any(data[4:12])
            if verdict in missing and len(data) <= SMALL_BYTES and not stamped:
                missing.remove(verdict)
                yield verdict, source, data
            if not missing:
                return
