# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a failed test leaves: a recording of each arm, and its page with the moment of the failure.

An unrecorded arm is run again with the inputs that it kept, with the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
import math
import os
from pathlib import Path
import re
import shutil
from typing import Any

import numpy as np

from pfd_ros.page.curves import Reference
from pfd_ros.page.findings import BAD, NOTE, Finding
from pfd_ros.page.page import TYPES, page
from pfd_ros.recording.arrays import read_log
from pfd_ros.testing.arm import LockstepArm, RecordingError
from pfd_ros.text import one_line

# Of the name of a folder, and of the text of an error on a page.
NAME_LENGTH, TEXT_LENGTH = 100, 4000
MOST_FOLDERS = 10_000


def folder_of(item: Any) -> Path:
    """Return a new folder for a test, a pytest.Item; one that exists is kept, with a number."""
    chosen = item.config.getoption('sim_arm_artifacts')
    name = re.sub(r'[^\w.-]+', '_', item.nodeid if chosen else item.name)[-NAME_LENGTH:]
    if chosen:
        parent = item.config.invocation_params.dir / chosen
    elif 'tmp_path' in item.funcargs:
        own = item.funcargs['tmp_path']
        parent, name = own.parent, f'{own.name}-sim_arm'
    else:
        parent, name = item.funcargs['tmp_path_factory'].getbasetemp(), f'{name}-sim_arm'
    for number in range(MOST_FOLDERS):
        folder = Path(parent, f'{name}-{number + 1}' if number else name)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise FileExistsError(f'{parent} has {MOST_FOLDERS} folders {name}')


def write_artifacts(arms: Sequence[Any], folder: Path, error: BaseException) -> list[str]:
    """Write recording and page of each arm; return lines that name them, or say what failed."""
    lines = []
    for number, arm in enumerate(arms, 1):
        name = 'arm' if len(arms) == 1 else f'arm{number}'
        log = folder / f'{name}.mcap'
        try:
            said = _write_log(arm, log)
            lines += [*filter(None, [one_line(said)]), f'recording  {log}']
            found = page(read_log(log, types=TYPES, unreadable='count'), _marks(arm, error))
            found.write(log.with_suffix('.html'))
            lines.append(f'page       {log.with_suffix(".html")}')
            first = found.first
            if first is not None:
                text = ' '.join(filter(None, (f'{first.kind}:', first.joint, first.text)))
                lines.append(one_line(f'first      t = {first.time:.3f} s, {text}'))
        # Nothing may hide the failure of the test.
        except Exception as failed:
            lines.append(one_line(f'{name} not written: {type(failed).__name__}: {failed}'))
    return lines


def _write_log(arm: LockstepArm, log: Path) -> str:
    """Write the recording of an arm; return what there is to say about it, or ''."""
    if not arm.recording:
        return arm.record_again(log)
    said = ''
    try:
        arm.close()
    except RecordingError as failed:
        said = f'the recording is incomplete: {failed}'
    try:
        os.link(arm.recording, log)
    except OSError:
        shutil.copyfile(arm.recording, log)
    return said


def _marks(arm: LockstepArm, error: BaseException) -> Iterator[Finding | Reference]:
    """Yield the moment of a failure, what the joints should have done, and the pushes."""
    label = 'failed assertion' if isinstance(error, AssertionError) else 'failed test'
    time, reference = getattr(error, 'motion', (arm.time, None))
    text = f'{type(error).__name__}: {error}'[:TEXT_LENGTH]
    yield Finding(label, BAD, '', text, np.array([[time, time]]))
    if reference is not None:
        names, times, positions, within = reference
        yield Reference(tuple(names), times, positions, within)
    longest = arm.settings.external_wrench_timeout or math.inf
    for (time, numbers), (end, _) in pairwise([*arm.pushes, (arm.time, ())]):
        if any(numbers):
            text = f'{list(numbers[:3])} N, {list(numbers[3:])} N m'
            spans = np.array([[time, min(end, time + longest)]])
            yield Finding('push', NOTE, '', text, spans)
