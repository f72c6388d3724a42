# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pytest plugin: fixtures sim_arm, sim_node, controller_process and ros_domain.

pytest loads it in every session of an environment in which this package is installed, so nothing
but pytest is imported before a test uses a fixture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from itertools import count
import os
from typing import Any

import pytest

# The arms of a test, by its node.
ARMS = pytest.StashKey[list[Any]]()
# Each test has another domain: a node that a failed test left would be a peer in the next one.
_started = count(os.getpid())


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare where failing tests leave their recordings."""
    parser.getgroup('sim_arm', 'simulated arms').addoption(
        '--sim-arm-artifacts',
        metavar='DIR',
        help='folder where failing tests with sim_arm leave a recording and an HTML page of each '
        'arm; default: next to the temporary folder of the test',
    )


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Iterator[None]:
    """Write recording and page of each arm of a failed test, and name them in its report."""
    outcome: Any = yield
    arms = item.stash.get(ARMS, [])
    if not arms or call.when != 'call' or call.excinfo is None:
        return
    report = outcome.get_result()
    if report.failed:
        from pfd_ros.testing.artifacts import folder_of, write_artifacts
        from pfd_ros.text import one_line

        try:
            lines = write_artifacts(arms, folder_of(item), call.excinfo.value)
            if not item.config.getoption('--sim-arm-artifacts'):
                lines.append(
                    'pytest removes them after some runs; --sim-arm-artifacts DIR keeps them'
                )
        # Nothing may hide the failure of the test.
        except Exception as error:
            lines = [one_line(f'no recording and no page: {type(error).__name__}: {error}')]
        report.sections.append(('sim_arm', '\n'.join(lines)))


@pytest.fixture
def sim_arm(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., Any]]:
    """Return a function that creates simulated arms: sim_arm(robot='ur5', publish_rate=500).

    It takes the arguments of pfd_ros.testing.LockstepArm. At the end of the test the arms are
    closed. A failed test writes a recording and an HTML page of each, see --sim-arm-artifacts.
    """
    made = request.node.stash.setdefault(ARMS, [])
    with ExitStack() as arms:

        def make(robot: Any, **settings: Any) -> Any:
            from pfd_ros.testing.arm import LockstepArm

            made.append(arms.enter_context(LockstepArm(robot, **settings)))
            return made[-1]

        yield make
    # The node of a test lives as long as the session.
    made.clear()


@pytest.fixture
def sim_node(ros_domain: int) -> Iterator[Callable[..., Any]]:
    """Return a function that starts the node itself: sim_node(robot='ur5', ros_args=[...]).

    It takes parameters of the node, and returns when the arm is active. The process runs in real
    time, in the domain of the test, and ends with it; the test fails if the node does.
    """
    from pfd_ros.testing.process import NodeProcess

    with ExitStack() as processes:

        def start(*, ros_args: Sequence[str] = (), **parameters: Any) -> Any:
            node = NodeProcess(parameters, ros_args)
            processes.enter_context(node)
            node.wait()
            return node

        yield start


@pytest.fixture
def controller_process(ros_domain: int) -> Iterator[Callable[..., Any]]:
    """Return a function that starts a controller: controller_process([sys.executable, 'node.py']).

    Pass the result to `spin`, which reports how the process ended and the end of its output. The
    process runs in the domain of the test, and it and all that it started end with the test.
    """
    from pfd_ros.testing.process import ControllerProcess

    with ExitStack() as processes:
        yield lambda command: processes.enter_context(ControllerProcess(command))


@pytest.fixture
def ros_domain() -> Iterator[int]:
    """Initialise rclpy for a test, in a domain that no other test uses; return the domain.

    If rclpy is initialised already, its context and domain are used.
    """
    from pfd_ros.testing.domains import own_or_current

    with own_or_current(next(_started)) as domain:
        yield domain
