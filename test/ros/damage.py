# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawn damage: bytes of any file, and single bits of the contents of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

from hypothesis import strategies as st
from rewriting import Recording, flipped

# Longest piece of a file that is removed, repeated or altered.
BLOCK = 64


@st.composite
def damaged_bytes(draw: st.DrawFn, whole: bytes) -> bytes:
    """Draw the content of a file with bytes flipped, removed, repeated, altered or added."""
    data = bytearray(whole)
    places = st.integers(0, len(data) - 1)
    kind = draw(
        st.sampled_from(
            ('flip', 'flip', 'cut', 'cut_and_flip', 'remove', 'repeat', 'alter', 'grow')
        )
    )
    at = draw(places)
    some = draw(st.binary(min_size=1, max_size=BLOCK) | st.integers(1, BLOCK).map(bytes))
    if kind == 'cut':
        del data[at:]
    elif kind == 'remove':
        del data[at : at + len(some)]
    elif kind == 'repeat':
        data[at:at] = data[at : at + len(some)]
    elif kind == 'alter':
        data[at : at + len(some)] = some[: len(data) - at]
    elif kind == 'grow':
        data += some
    else:
        for place in draw(st.lists(places, min_size=1, max_size=50)):
            data[place] ^= 1 << draw(st.integers(0, 7))
        if kind == 'cut_and_flip':
            del data[at:]
    return bytes(data)


# --- one bit of the contents


class Key(NamedTuple):
    """The key of a table, as the last element of a path."""

    name: str


Path = tuple[Any, ...]


def paths_in(value: Any, path: Path = ()) -> Iterator[Path]:
    """Yield the paths of all texts, bytes and whole numbers in a value that have a bit."""
    if is_dataclass(value):
        for field in fields(value):
            yield from paths_in(getattr(value, field.name), (*path, field.name))
    elif isinstance(value, dict):
        for key, each in value.items():
            yield (*path, Key(key))
            yield from paths_in(each, (*path, key))
    elif isinstance(value, list | tuple):
        for k, each in enumerate(value):
            yield from paths_in(each, (*path, k))
    elif isinstance(value, int) or value:
        yield path


def changed(value: Any, path: Path, change: Callable[[Any], Any]) -> Any:
    """Return a value in which the part at a path is changed."""
    if not path:
        return change(value)
    at, *rest = path
    if isinstance(at, Key):
        return {change(key) if key == at.name else key: each for key, each in value.items()}
    if is_dataclass(value):
        return replace(value, **{at: changed(getattr(value, at), rest, change)})
    parts = value.copy() if isinstance(value, dict) else list(value)
    parts[at] = changed(parts[at], rest, change)
    return tuple(parts) if isinstance(value, tuple) else parts


def parts_of(recording: Recording) -> dict[str, list[Path]]:
    """Return the paths to each part of a recording: a field of a topic, a value of its head."""
    found: dict[str, list[Path]] = {}
    for path in paths_in(recording):
        part = ' '.join(map(str, path))
        if path[0] == 'messages':
            part = f'{path[2]} of {recording.messages[path[1]].topic}'
        elif path[0] == 'channels':
            part = f'{path[2]} of a channel'
        # A message has the topic of its channel.
        if path[0::2] != ('messages', 'topic'):
            found.setdefault(part, []).append(path)
    return found


@st.composite
def flips(draw: st.DrawFn, value: str | bytes | int) -> str | bytes | int:
    """Draw a value with one bit changed; texts stay ASCII."""
    if isinstance(value, int):
        return value ^ 1 << draw(st.integers(0, 31))
    data = value.encode() if isinstance(value, str) else value
    at, bit = draw(st.integers(0, len(data) - 1)), draw(st.integers(0, 6))
    return flipped(data, at, bit).decode() if isinstance(value, str) else flipped(data, at, bit)


def with_a_flip(recording: Recording, path: Path, draw: st.DrawFn) -> Recording:
    """Draw a recording with one bit changed in the part at a path."""
    made: Recording = changed(recording, path, lambda value: draw(flips(value)))
    # Messages follow their channel.
    topics = {
        before.topic: after.topic
        for before, after in zip(recording.channels, made.channels, strict=True)
    }
    made.messages = [replace(m, topic=topics[m.topic]) for m in made.messages]
    return made
