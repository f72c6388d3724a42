# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node that can discover nobody steps, records and ends as any other."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys

from bridge import read_recording
import pytest
from ros_processes import NODE, Processes, environment, in_namespaces
from waiting import PATIENCE

pytestmark = pytest.mark.ros
SETTINGS = ('--ros-args', '-p', 'robot:=planar2', '-p', 'recording:=arm.mcap')


@pytest.mark.parametrize('without', ['discovery', 'a network'])
def test_without_discovery_or_a_network_an_arm_steps_and_records(
    processes: Processes, without: str
) -> None:
    alone = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'} if without == 'discovery' else {}
    # A new network, in which not even the loopback is up.
    network = in_namespaces('--net') if without == 'a network' else []
    started = subprocess.Popen(
        [*network, sys.executable, *NODE, *SETTINGS],
        cwd=processes.folder,
        env=environment(processes.domain) | alone,
        stdin=subprocess.DEVNULL,
    )
    end(started, processes.folder)


def end(started: subprocess.Popen[bytes], folder: Path) -> None:
    """Let a node step for a while, end it, and verify its recording."""
    path = folder / 'arm.mcap'
    try:
        # Chunks are closed five times a second.
        with pytest.raises(subprocess.TimeoutExpired):
            started.wait(0.1)
        while not path.exists() or os.path.getsize(path) < 50_000:
            with pytest.raises(subprocess.TimeoutExpired):
                started.wait(0.1)
        started.send_signal(signal.SIGINT)
        assert started.wait(PATIENCE) == 0
    finally:
        started.kill()
        started.wait()
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert summary.states > 100
