# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The peers of the tests outlive the processes they talk to, however those end."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import pytest
from ros_processes import PATIENCE, Processes

# Where peers shared memory, every tenth round or so died.
ROUNDS = 60


def shared() -> set[str]:
    """Return the files of Fast DDS's shared memory that this process has mapped."""
    lines = Path('/proc/self/maps').read_text(encoding='utf-8').splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/fast' in line}


@pytest.mark.ros
def test_a_peer_shares_no_memory_with_a_process_that_may_be_killed(
    processes: Processes, peer_of
) -> None:
    before = shared()
    processes.arm('-p', 'robot:=planar2')
    peer_of(processes).connect()
    assert shared() <= before


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(2 * PATIENCE * ROUNDS)
def test_peers_end_well_where_the_processes_they_talk_to_are_killed() -> None:
    script = Path(__file__).with_name('killed_talkers.py')
    done = subprocess.run(
        [sys.executable, str(script), str(ROUNDS)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == ROUNDS
