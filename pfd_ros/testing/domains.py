# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that no other process of this kind uses: one lock file for each domain.

The kernel releases a lock when its process ends. Domains above 101 would need
ports of the range that the system gives to outgoing connections.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
import fcntl
import os
from pathlib import Path
import socket
import tempfile

FIRST, LAST = 1, 101
# Port of the discovery of a domain's first participant (DDSI-RTPS 2.3, 9.6.1).
PORT_BASE, PORT_GAIN, PARTICIPANT_PORT = 7400, 250, 10
# Variables that choose domain, range, discovery server, peers, transport, security, profiles.
MIDDLEWARE = ('ROS_', 'RMW_', 'FASTRTPS_', 'FASTDDS_', 'CYCLONEDDS_', 'ZENOH_')
# Variables of those names that say where the installation is and how it logs and checks.
HARMLESS = frozenset(
    {
        'ROS_DISTRO',
        'ROS_VERSION',
        'ROS_PYTHON_VERSION',
        'ROS_PYTHON_CHECK_FIELDS',
        'ROS_ETC_DIR',
        'ROS_HOME',
        'ROS_LOG_DIR',
        'RMW_IMPLEMENTATION',
    }
)
# Of a process that uses UDP on this host, and no shared memory; see the profile why.
LOOPBACK = {
    'FASTRTPS_DEFAULT_PROFILES_FILE': str(Path(__file__).with_name('loopback.xml')),
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',
}
# Values of RMW_IMPLEMENTATION for which that profile holds; '' is the default of ROS 2.
FAST_DDS = frozenset({'', 'rmw_fastrtps_cpp', 'rmw_fastrtps_dynamic_cpp'})
PROFILES = frozenset({'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'})


def environment(inherited: Mapping[str, str], domain: int) -> dict[str, str]:
    """Return the environment of processes on a domain: no variables that connect to other systems.

    Parameters
    ----------
    inherited
        The environment of this process.
    domain
        The ROS domain they get.
    """
    chosen = {
        name: value
        for name, value in inherited.items()
        if name in HARMLESS or not name.startswith(MIDDLEWARE)
    }
    return chosen | {
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        # Fast DDS would take a profile from the folder it is started in.
        'SKIP_DEFAULT_XML_FILE': '1',
    }


def environment_to_kill(inherited: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a process that may be killed while it publishes to this one.

    Parameters
    ----------
    inherited
        The environment of this process. It is unchanged for middleware other than Fast DDS, for
        a range other than this host, and with a profile of the user.
    """
    here = inherited.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST'
    fast_dds = inherited.get('RMW_IMPLEMENTATION', '') in FAST_DDS
    suits = here and fast_dds and not PROFILES & inherited.keys()
    return {**inherited, **(LOOPBACK if suits else {})}


@contextmanager
def own_domain(
    folder: Path | None = None, start: int | None = None, avoided: str = ''
) -> Iterator[int]:
    """Claim a domain in a context.

    A domain in which a participant already runs, such as the user's own nodes, is skipped.

    Parameters
    ----------
    folder
        Of the lock files; default: the one for temporary files.
    start
        Where the search starts, any number; default: the process id, so that domains are not used
        again at once.
    avoided
        A domain to skip, as a string.

    Raises
    ------
    OSError
        If every domain is taken, or no lock can be had.
    """
    where = Path(tempfile.gettempdir()) if folder is None else folder
    begin, count = os.getpid() if start is None else start, LAST - FIRST + 1
    for step in range(count):
        domain = FIRST + (begin + step) % count
        if str(domain) == avoided:
            continue
        lock = _locked(where / f'pfd_ros_domain_{domain}.lock')
        if lock is None:
            continue
        try:
            if not inhabited(domain):
                yield domain
                return
        finally:
            os.close(lock)
    raise OSError(f'all ROS domains from {FIRST} to {LAST} are taken, by locks in {where}')


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
