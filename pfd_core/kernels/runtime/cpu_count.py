# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The number of processors that this process may use: its affinity, and the CPU quotas of cgroups.

A container with two CPUs of a machine of 64 sees 64 in its affinity; its quota is two. A process
lies in a cgroup within others, and the smallest of their quotas counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import math
import os
from pathlib import Path, PurePosixPath


def available(root: Path = Path('/')) -> int:
    """Return the number of processors, at least 1; a part of one counts as one."""
    count = _from_affinity()
    for quota in _quotas(root):
        count = min(count, max(math.ceil(quota), 1))
    return count


def _from_affinity() -> int:
    count = getattr(os, 'process_cpu_count', None)  # Python 3.13
    if count is not None:
        return count() or 1
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _quotas(root: Path) -> Iterator[float]:
    """Yield the quotas of this process's cgroups and of those around them, in processors."""
    groups = root / 'sys/fs/cgroup'
    for line in _text(root / 'proc/self/cgroup').splitlines():
        _, _, rest = line.partition(':')
        controllers, _, path = rest.partition(':')
        inner = PurePosixPath('/', path).relative_to('/')
        for group in (inner, *inner.parents):
            if not controllers:  # version 2
                yield from _share(_text(groups / group / 'cpu.max').split())
            elif 'cpu' in controllers.split(','):
                for mount in (controllers, 'cpu'):
                    names = ('cpu.cfs_quota_us', 'cpu.cfs_period_us')
                    yield from _share([_text(groups / mount / group / name) for name in names])


def _share(texts: list[str]) -> Iterator[float]:
    """Yield a quota over its period; nothing for 'max', -1 and files that are not there."""
    with suppress(ValueError):
        quota, period = map(int, texts)
        if quota > 0 and period > 0:
            yield quota / period


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding='utf-8', errors='replace')
    except OSError:
        return ''
