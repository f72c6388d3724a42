# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures: processes that leave none behind, peers, recordings, and logs of real arms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal
from typing import Any

from devtools import Page, opened
from plugin_sessions import install
import pytest
from ros_processes import HAS_ROS, Peer, Processes

from pfd_ros.node.main import SIGNALS
from pfd_ros.testing.domains import LOOPBACK as DDS_LOOPBACK
from pfd_ros.testing.domains import claimed_domain, initialised

# A folder with logs of real arms, each a bag of rosbag2 with /joint_states.
REAL_ARMS = 'PFD_REAL_ARM_LOGS'


# Fixtures of tests that start nodes.
STARTS_NODES = {'processes', 'peer_of', 'domain', 'ros_domain'}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what starts nodes, and leave it out without ROS."""
    for item in items:
        if STARTS_NODES & {*getattr(item, 'fixturenames', ())}:
            item.add_marker('ros')
        if item.get_closest_marker('ros') is not None and not HAS_ROS:
            item.add_marker(pytest.mark.skip(reason='rclpy is not installed'))


@pytest.fixture(scope='session', autouse=True)
def signals_of_a_terminal() -> None:
    """Let processes that tests start take signals, also under nohup and in the background."""
    for number in SIGNALS:
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """Undo what `pfd` in the process of a test does to signals: it leaves that to its own end."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    if before != {number: signal.getsignal(number) for number in SIGNALS}:
        signal.set_wakeup_fd(-1)
        for number, handler in before.items():
            signal.signal(number, handler)


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[Processes]:
    """Return what starts processes, ROS or not."""
    found = Processes(tmp_path)
    yield found
    found.close()


@pytest.fixture
def processes(programs: Processes) -> Processes:
    """Return what starts processes with nodes."""
    return programs


@pytest.fixture
def peer_of() -> Iterator[Callable[..., Peer]]:
    peers: list[Peer] = []

    def make(processes: Processes, namespace: str = '') -> Peer:
        peers.append(Peer(processes.domain, namespace))
        return peers[-1]

    yield make
    for peer in peers:
        peer.close()


@pytest.fixture(scope='module')
def domain() -> Iterator[int]:
    """Return a ROS domain of this module, in which rclpy is initialised."""
    with claimed_domain() as found:
        # Of the first participant of a process: the middleware reads its profile once.
        os.environ |= DDS_LOOPBACK
        with initialised(found):
            yield found


@pytest.fixture(scope='session')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that describes this package as pip would, entry point included."""
    folder = tmp_path_factory.mktemp('site')
    install(folder)
    return folder


@pytest.fixture(scope='session')
def page_server() -> Iterator[Any]:
    """Return a page of the view that is served for the whole run."""
    from pfd_ros.view.page import page as view_page

    with view_page(0, 'test') as server:
        yield server


@pytest.fixture(scope='session')
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Return the page of one browser."""
    with opened(tmp_path_factory.mktemp('browser')) as page:
        yield page


@pytest.fixture
def empty(page_server: Any) -> Any:
    """Return a page of the view without anything on it."""
    page_server.scene.reset()
    page_server.gui.reset()
    return page_server


@pytest.fixture(scope='session')
def real_arms() -> Path:
    """Return the folder with logs of real arms."""
    folder = os.environ.get(REAL_ARMS)
    if folder is None:
        pytest.skip(f'set {REAL_ARMS} to a folder with bags of real arms')
    return Path(folder)
