# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that no other process of this kind uses: one lock file for each domain.

The kernel gives a lock back when its process ends, however it ends. Domains above 101 would need
ports of the range that the system gives to outgoing connections.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
import fcntl
import os
from pathlib import Path
import socket
import tempfile

FIRST, LAST = 1, 101
# Port of the discovery of a domain's first participant (DDSI-RTPS 2.3, 9.6.1).
PORT_BASE, PORT_GAIN, PARTICIPANT_PORT = 7400, 250, 10


@contextmanager
def own_domain(folder: Path | None = None, start: int | None = None) -> Iterator[int]:
    """Claim a domain and hold it.

    A domain in which a participant already runs, such as the user's own nodes, is passed over.

    Parameters
    ----------
    folder
        Of the lock files; default: the one for temporary files.
    start
        Where the search starts, any number; default: the process id, so that domains are not used
        again at once.

    Raises
    ------
    RuntimeError
        If every domain is taken.
    """
    where = Path(tempfile.gettempdir()) if folder is None else folder
    begin, count = os.getpid() if start is None else start, LAST - FIRST + 1
    for step in range(count):
        domain = FIRST + (begin + step) % count
        lock = _locked(where / f'pfd_ros_domain_{domain}.lock')
        if lock is None:
            continue
        try:
            if not inhabited(domain):
                yield domain
                return
        finally:
            os.close(lock)
    raise RuntimeError(f'all ROS domains from {FIRST} to {LAST} are taken, by locks in {where}')


def _locked(path: Path) -> int | None:
    """Return the descriptor of a file that this process has locked, None if another one has."""
    # In a folder that all users share, the system refuses O_CREAT for a file of another user.
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = None
    for creating in (0, os.O_CREAT | os.O_EXCL, 0):
        with suppress(OSError):
            descriptor = os.open(path, flags | creating, 0o644)
            break
    if descriptor is None:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def inhabited(domain: int) -> bool:
    """Return whether some participant of this host is in a domain."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        try:
            probe.bind(('', PORT_BASE + PORT_GAIN * domain + PARTICIPANT_PORT))
        except OSError:
            return True
    return False
