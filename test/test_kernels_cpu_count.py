# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The number of threads follows the affinity of the process and the quotas of its cgroups."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pfd_core.kernels.runtime.cpu_count import available

QUOTA = 'sys/fs/cgroup/cpu,cpuacct{}/cpu.cfs_quota_us'
PERIOD = 'sys/fs/cgroup/cpu,cpuacct{}/cpu.cfs_period_us'
V1 = '4:cpu,cpuacct:/docker/a\n3:cpuset:/docker/a\n'


@pytest.mark.parametrize(
    ('files', 'expected'),
    [
        ({}, 8),
        ({'proc/self/cgroup': '0::/'}, 8),
        ({'proc/self/cgroup': '0::/', 'sys/fs/cgroup/cpu.max': 'max 100000'}, 8),
        ({'proc/self/cgroup': '0::/', 'sys/fs/cgroup/cpu.max': '200000 100000'}, 2),
        ({'proc/self/cgroup': '0::/', 'sys/fs/cgroup/cpu.max': '150000 100000'}, 2),
        ({'proc/self/cgroup': '0::/', 'sys/fs/cgroup/cpu.max': '1000 100000'}, 1),
        ({'proc/self/cgroup': '0::/', 'sys/fs/cgroup/cpu.max': '6400000 100000'}, 8),
        ({'proc/self/cgroup': '0::/', 'sys/fs/cgroup/cpu.max': 'not a number'}, 8),
        (
            {
                'proc/self/cgroup': '0::/user.slice/job.scope\n',
                'sys/fs/cgroup/user.slice/job.scope/cpu.max': '500000 100000\n',
                'sys/fs/cgroup/user.slice/cpu.max': '300000 100000\n',
            },
            3,
        ),
        # A container that sees the path outside, and its own group as the root.
        ({'proc/self/cgroup': '0::/../out', 'sys/fs/cgroup/cpu.max': '400000 100000'}, 4),
        ({'proc/self/cgroup': V1, QUOTA.format('/docker/a'): '-1'}, 8),
        (
            {
                'proc/self/cgroup': V1,
                QUOTA.format('/docker/a'): '-1\n',
                PERIOD.format('/docker/a'): '100000\n',
                QUOTA.format('/docker'): '250000\n',
                PERIOD.format('/docker'): '100000\n',
            },
            3,
        ),
        (
            {
                'proc/self/cgroup': V1,
                'sys/fs/cgroup/cpu/cpu.cfs_quota_us': '100000',
                'sys/fs/cgroup/cpu/cpu.cfs_period_us': '50000',
            },
            2,
        ),
    ],
)
def test_the_smallest_quota_of_all_cgroups_bounds_the_processors(
    files: dict[str, str], expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, 'process_cpu_count', lambda: 8, raising=False)
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert available(tmp_path) == expected


@pytest.mark.skipif(not hasattr(os, 'sched_setaffinity'), reason='needs affinities')
def test_the_affinity_of_the_process_bounds_the_processors() -> None:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        assert available() == 1
    finally:
        os.sched_setaffinity(0, before)


def test_python_may_be_given_fewer_processors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, 'process_cpu_count', lambda: 3, raising=False)
    assert available(tmp_path) == 3
