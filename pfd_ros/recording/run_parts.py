# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one run: found in a folder, put in order, and whether each continues the other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from pfd_ros.recording.format import EndKey, HeadKey
from pfd_ros.recording.reader import Log, LogError

# Files of one run that are read at once; each is a recording with its own head.
MOST_PARTS = 10_000
# Values of the head that differ from file to file.
_OWN = (HeadKey.PART, HeadKey.DIGESTS, HeadKey.DIGEST)


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return some files, and the MCAP files of some folders.

    Raises
    ------
    LogError
        If a folder has none, or there are too many.
    """
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob('*.mcap')) if path.is_dir() else [path]
        if not inside:
            raise LogError(f'{path} is a folder without MCAP files')
        found += inside
    if len(found) > MOST_PARTS:
        raise LogError(f'{len(found)} files, expected at most {MOST_PARTS}')
    return found


def in_order(logs: Sequence[Log]) -> list[Log]:
    """Return the files of a run in their order.

    Raises
    ------
    LogError
        If one is no recording, they are of two runs, or two have the same place.
    OSError
        If one cannot be read.
    """
    first = logs[0]
    first.read_head()
    run = _run_of(first)
    for log in logs:
        log.read_head()
        log.check_head()
        if _run_of(log) != run:
            raise LogError(f'{log.path} is of another run than {first.path}')
        # Equal texts once: there may be thousands of files.
        log.robot_yaml = first.robot_yaml
        log.head_texts = {
            key: text if key in _OWN else first.head_texts[key]
            for key, text in log.head_texts.items()
        }
    ordered = sorted(logs, key=lambda log: log.part.number)
    for before, log in pairwise(ordered):
        if log.part.number == before.part.number:
            raise LogError(f'{before.path} and {log.path} are both part {log.part.number}')
    return ordered


def continues(before: Log, after: Log) -> bool:
    """Return whether a file continues another one without a gap, once both have been read.

    Raises
    ------
    LogError
        If the end of the first contradicts the head of the second.
    """
    ending = before.ending if before.complete else None
    if ending is None or after.part.number != before.part.number + 1:
        return False
    if ending.totals is not None or before.end_texts[EndKey.DIGEST] != after.part.previous:
        raise LogError(
            f'{after.path} does not follow {before.path}: its head names another end record'
        )
    return True


def parts_between(number: int, other: int) -> list[str]:
    """Return a line about the parts of a run between two parts, none if there are none."""
    if other - number < 2:
        return []
    first, last = number + 1, other - 1
    return [f'part {first} of the run' if first == last else f'parts {first} to {last} of the run']


def parts_after(number: int) -> str:
    """Return a line about the parts of a run that follow a part."""
    return f'the parts of the run after part {number}'


def _run_of(log: Log) -> tuple[object, ...]:
    """Return what all files of a run have in common."""
    values = {key: text for key, text in log.head_texts.items() if key not in _OWN}
    return log.part.first or log.head_texts.get(HeadKey.DIGEST), log.robot_yaml, values
