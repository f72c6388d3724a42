# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SIGKILL at any moment: the file is readable, lacks at most the promised tail, and verifies."""

from __future__ import annotations

from collections.abc import Iterator
import io
from itertools import pairwise
import json
from pathlib import Path
import random
import signal
import statistics
import subprocess
import sys
import time
from typing import NamedTuple

from bridge import Settings, read_recording_run, recover_log
from killed_recorder import PAIR
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
import pytest
from recordings import HAS_DEFINITIONS
from ros_processes import environment
from waiting import PATIENCE

HERE = Path(__file__).resolve().parent
STATES = ('/joint_states', '/sim_arm/dropped_states')
# Times until the signal, s: within the promise, and later.
EARLY, LATE = 0.1, 1.0
PROMISE_NS = round(Settings().recording_flush_period * 1e9)
SPLIT = {'recording_max_duration': 0.1}

pytestmark = pytest.mark.skipif(not HAS_DEFINITIONS, reason='needs definitions of ROS')


class Kill(NamedTuple):
    """What a killed process reported: steps by number with their times, ns."""

    files: list[Path]
    steps: dict[int, int]


def killed(folder: Path, seconds: float, settings: dict[str, float]) -> Kill:
    """Kill a process so many seconds after it has opened its recording."""
    folder.mkdir()
    script, target = HERE / 'killed_recorder.py', folder / 'run.mcap'
    process = subprocess.Popen(
        [sys.executable, str(script), str(target), json.dumps(settings)],
        env=environment(0),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
    )
    try:
        first = process.stdout.read(PAIR.size)
        assert len(first) == PAIR.size, process.communicate()
        time.sleep(seconds)
        process.kill()
        output, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait(PATIENCE)
    assert (process.returncode, errors) == (-signal.SIGKILL, b'')
    told = first + output[: len(output) // PAIR.size * PAIR.size]
    return Kill(sorted(folder.iterdir()), dict(PAIR.iter_unpack(told)))


def streamed(path: Path) -> Iterator[tuple[str, Message]]:
    """Yield the messages that the stream reader of mcap finds up to the end of a cut file."""
    topics = {}
    try:
        for record in StreamReader(io.BytesIO(path.read_bytes())).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            if isinstance(record, Message):
                yield topics[record.channel_id], record
    except (McapError, EOFError):
        pass


def check(kill: Kill, folder: Path) -> float:
    """Check the files of a killed process; return by how much they miss the run's end, s."""
    found = [(topic, message.sequence) for path in kill.files for topic, message in streamed(path)]
    assert '/robot_description' in dict(found)
    steps = [number for topic, number in found if topic in STATES]
    last = max(steps, default=0)
    assert steps == list(range(1, last + 1))
    # Each file is readable as a whole once it is recovered, and what was there verifies.
    folder.mkdir()
    for path in kill.files:
        recover_log(path, folder / path.name)
        with (folder / path.name).open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert [m.sequence for *_, m in reader.iter_messages(log_time_order=False)] == [
                message.sequence for _, message in streamed(path)
            ]
    if any(topic == STATES[0] for topic, _ in found):
        for files in (kill.files, sorted(folder.iterdir())):
            summary = read_recording_run(files, verify=True)
            assert summary.compared == sum(topic == STATES[0] for topic, _ in found)
            # The end is missing, or a file that was about to begin, and nothing before it.
            (missing,) = summary.absent
            after = f'the parts of the run after part {len(files)}'
            assert missing.startswith(('the end of the file', 'the end record', after))
    ended = max(kill.steps)
    # It may have been killed before it reported the last step.
    assert last <= ended + 1
    return (kill.steps[ended] - kill.steps.get(last, kill.steps[ended])) * 1e-9


def longest_pause(kill: Kill) -> float:
    """Return the longest time between two steps at the end, s: a pause of the whole process."""
    times = list(kill.steps.values())
    late = [time_ns for time_ns in times if time_ns >= times[-1] - 3 * PROMISE_NS]
    return max((b - a for a, b in pairwise(late)), default=0) * 1e-9


@pytest.mark.parametrize(
    'often', [4, pytest.param(100, marks=[pytest.mark.slow, pytest.mark.long])]
)
@pytest.mark.timeout(900)
def test_a_killed_process_leaves_readable_files_that_lack_at_most_the_promised_tail(
    often: int, tmp_path: Path
) -> None:
    rng, losses = random.Random(21), []
    for k in range(often):
        seconds = (LATE if k % 2 else EARLY) * rng.random()
        kill = killed(tmp_path / str(k), seconds, SPLIT if k % 4 > 1 else {})
        loss = check(kill, tmp_path / f'{k}_recovered')
        losses.append(loss)
        # A machine that is too slow for the process is too slow for its recorder, too.
        assert loss <= PROMISE_NS * 1e-9 + longest_pause(kill), losses
    print(
        f'{often} kills: median loss {1e3 * statistics.median(losses):.1f} ms, '
        f'worst {1e3 * max(losses):.1f} ms; within {EARLY} s of the start '
        f'{1e3 * max(losses[::2]):.1f} ms'
    )
