# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that no other process of this kind uses, and rclpy in it for a test.

A claim is an abstract Unix socket with the number of the domain, which the kernel releases when
its process ends: the claims of one network namespace see each other, as its nodes do. Domains
above 101 would need ports of the range that the system gives to outgoing connections.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import errno
import importlib
import os
from pathlib import Path
import socket
from typing import Any
import warnings

FIRST, LAST = 1, 101
# Port of the discovery of a domain's first participant (DDSI-RTPS 2.3, 9.6.1).
PORT_BASE, PORT_GAIN, PARTICIPANT_PORT = 7400, 250, 10
# Variables that choose domain, range, discovery server, peers, transport, security, profiles.
MIDDLEWARE = ('ROS_', 'RMW_', 'FASTRTPS_', 'FASTDDS_', 'CYCLONEDDS_', 'ZENOH_')
# Variables of those names that say where the installation is and how it logs and checks.
HARMLESS = (
    *('ROS_DISTRO', 'ROS_VERSION', 'ROS_PYTHON_VERSION', 'ROS_PYTHON_CHECK_FIELDS'),
    *('ROS_ETC_DIR', 'ROS_HOME', 'ROS_LOG_DIR', 'RMW_IMPLEMENTATION'),
)
# Of a process that uses UDP on this host, and no shared memory; see the profile why.
LOOPBACK = {
    'FASTRTPS_DEFAULT_PROFILES_FILE': str(Path(__file__).with_name('loopback.xml')),
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',
}
# Values of RMW_IMPLEMENTATION for which that profile holds; '' is the default of ROS 2.
FAST_DDS = frozenset({'', 'rmw_fastrtps_cpp', 'rmw_fastrtps_dynamic_cpp'})
PROFILES = frozenset({'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'})
# The last one otherwise comes with a user's first publisher.
MODULES = ('rclpy', 'rclpy.signals', 'rosidl_generator_py')


def environment(inherited: Mapping[str, str], domain: int) -> dict[str, str]:
    """Return an environment for a domain, without the variables that connect to other systems."""
    return {
        **{k: v for k, v in inherited.items() if k in HARMLESS or not k.startswith(MIDDLEWARE)},
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        # Fast DDS would take a profile from the folder it is started in.
        'SKIP_DEFAULT_XML_FILE': '1',
    }


def environment_to_kill(inherited: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a process that may be killed while it publishes to this one.

    It is the inherited one for middleware other than Fast DDS, for a range other than this host,
    and with a profile of the user.
    """
    here = inherited.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST'
    fast_dds = inherited.get('RMW_IMPLEMENTATION', '') in FAST_DDS
    suits = here and fast_dds and not PROFILES & inherited.keys()
    return {**inherited, **(LOOPBACK if suits else {})}


@contextmanager
def own_domain(start: int | None = None, avoided: str = '') -> Iterator[int]:
    """Claim a domain in a context; OSError if every domain is taken.

    A domain in which a participant already runs, such as the user's own nodes, is skipped, and the
    one in `avoided`. The search starts at any number, by default the process id, so that domains
    are not used again at once.
    """
    begin, count = os.getpid() if start is None else start, LAST - FIRST + 1
    for step in range(count):
        domain = FIRST + (begin + step) % count
        if str(domain) == avoided:
            continue
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
            try:
                claim.bind(f'\0pfd_ros_domain_{domain}')
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
                    participant.bind(('', PORT_BASE + PORT_GAIN * domain + PARTICIPANT_PORT))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                continue
            yield domain
            return
    raise OSError(f'all ROS domains from {FIRST} to {LAST} are taken')


@contextmanager
def claimed_domain(start: int | None = None) -> Iterator[int]:
    """Claim a domain, as own_domain, and set it in the environment of child processes."""
    before = dict(os.environ)
    with own_domain(start) as domain:
        try:
            _set(environment(before, domain))
            yield domain
        finally:
            _set(before)


def _set(variables: Mapping[str, str]) -> None:
    for name in os.environ.keys() - variables.keys():
        del os.environ[name]
    os.environ.update(variables)


def import_rclpy() -> Any:
    """Return the module rclpy; the parser of its messages warns of a module of Python."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', DeprecationWarning)
        modules = [importlib.import_module(name) for name in MODULES]
    return modules[0]


@contextmanager
def initialised(domain: int) -> Iterator[None]:
    """Initialise rclpy's default context, in which the nodes of users are, and shut it down."""
    rclpy = import_rclpy()
    # Signals are the test runner's.
    options = rclpy.signals.SignalHandlerOptions.NO
    rclpy.init(args=[], signal_handler_options=options, domain_id=domain)
    try:
        yield
    finally:
        rclpy.try_shutdown()


@contextmanager
def own_or_current(start: int | None = None) -> Iterator[int]:
    """Initialise rclpy in a claimed domain; if it is initialised already, use its domain."""
    rclpy = import_rclpy()
    if rclpy.ok():
        yield int(rclpy.get_default_context().get_domain_id())
        return
    with claimed_domain(start) as domain, initialised(domain):
        yield domain
