# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a failed test leaves: a recording of each arm, and its page with the moment of the failure.

An unrecorded arm of this process is run again from the journal of its inputs, with the same bits.
Of an arm in another process only the states that the test received are written.
"""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import re
import shutil
from typing import Any

from pfd_ros.page.contents import Mark
from pfd_ros.page.html import write_page
from pfd_ros.page.reading import read_contents
from pfd_ros.recording.run_files import part_path, part_paths
from pfd_ros.testing.lockstep_arm import LockstepArm
from pfd_ros.testing.run_log import RecordingError
from pfd_ros.testing.trajectory import MOMENT
from pfd_ros.text import one_line

# Of the name of a folder, and of the text of an error on a page.
NAME_LENGTH, TEXT_LENGTH = 100, 4000
MOST_FOLDERS = 10_000


def folder_of(item: Any) -> Path:
    """Return a new folder for a test, a pytest.Item."""
    chosen = item.config.getoption('sim_arm_artifacts')
    name = re.sub(r'[^\w.-]+', '_', item.nodeid if chosen else item.name)[-NAME_LENGTH:]
    if chosen:
        parent = item.config.invocation_params.dir / chosen
    elif 'tmp_path' in item.funcargs:
        parent, name = (
            item.funcargs['tmp_path'].parent,
            f'{item.funcargs["tmp_path"].name}-sim_arm',
        )
    else:
        parent, name = item.funcargs['tmp_path_factory'].getbasetemp(), f'{name}-sim_arm'
    return _new_folder(parent, name)


def _new_folder(parent: Path, name: str) -> Path:
    """Create a folder; one that exists is kept, and a number is added."""
    for number in range(MOST_FOLDERS):
        folder = parent / (f'{name}-{number + 1}' if number else name)
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
        log, page = folder / f'{name}.mcap', folder / f'{name}.html'
        try:
            said, files = _write_log(arm, log)
            others = f' to {files[-1].name}' if len(files) > 1 else ''
            lines += [*said, f'recording  {files[0]}{others}']
            contents = read_contents(files, robot=arm.robot, marks=[_mark(arm, error)])
            write_page(contents, page)
            lines.append(f'page       {page}')
            first = contents.first
            if first is not None:
                text = f'{first.kind}: {first.joint} {first.text}'
                lines.append(one_line(f'first      t = {first.time:.3f} s, {text}'))
        # Nothing may hide the failure of the test.
        except Exception as failed:
            lines.append(one_line(f'{name} not written: {type(failed).__name__}: {failed}'))
    return lines


def _write_log(arm: Any, log: Path) -> tuple[list[str], list[Path]]:
    """Write the recording of an arm; return what there is to say about it, and its files."""
    if not isinstance(arm, LockstepArm):
        arm.write_received(log)
        said = ['the arm ran in another process: the recording holds the states received here']
        return said, [log]
    if not arm.settings.recording:
        lacking = arm.record_again(log)
        return [lacking] if lacking else [], [log]
    said = []
    try:
        arm.close()
    except RecordingError as failed:
        said.append(one_line(f'the recording is incomplete: {failed}'))
    recorded = Path(arm.settings.recording)
    parts = part_paths(recorded) if arm.settings.splits else []
    pairs = [(part, part_path(log, k)) for k, part in enumerate(parts, 1)] or [(recorded, log)]
    for source, target in pairs:
        try:
            os.link(source, target)
        except OSError:
            shutil.copyfile(source, target)
    return said, [target for _, target in pairs]


def _mark(arm: Any, error: BaseException) -> Mark:
    """Return the moment of a failure: of the motion that an assertion is about, or the end."""
    label = 'failed assertion' if isinstance(error, AssertionError) else 'failed test'
    end = arm.time if isinstance(arm, LockstepArm) else arm.received_time
    return Mark(
        getattr(error, MOMENT, end), label, f'{type(error).__name__}: {error}'[:TEXT_LENGTH]
    )
