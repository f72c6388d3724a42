# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pytest plugin: the fixtures `sim_arm`, `ros_domain` and `controller_process`.

pytest loads it in every session of an environment in which this package is installed, so nothing
but pytest is imported before a test uses a fixture. Each worker of pytest-xdist is a process with
a separate domain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest


@pytest.fixture
def sim_arm(request: pytest.FixtureRequest) -> Iterator[Callable[..., Any]]:
    """Return a function that creates simulated arms: sim_arm(robot='ur5', publish_rate=500).

    The arguments are those of pfd_ros.testing.lockstep_arm.LockstepArm; with process=True, of
    pfd_ros.testing.process_arm.ProcessArm. At the end of the test the arms are closed.
    """
    with ExitStack() as arms:

        def make(robot: Any, *, process: bool = False, **settings: Any) -> Any:
            if process:
                request.getfixturevalue('ros_domain')
                from pfd_ros.testing.process_arm import ProcessArm

                return arms.enter_context(ProcessArm(robot, **settings))
            from pfd_ros.testing.lockstep_arm import LockstepArm

            return arms.enter_context(LockstepArm(robot, **settings))

        yield make


@pytest.fixture
def controller_process(ros_domain: int) -> Iterator[Callable[..., Any]]:
    """Return a function that starts a controller: controller_process([sys.executable, 'node.py']).

    Pass the result to `spin`, which reports how the process ended and the end of its output. The
    process runs in the domain of the test, and ends with it.
    """
    from pfd_ros.testing.controller_process import ControllerProcess

    with ExitStack() as processes:
        yield lambda command: processes.enter_context(ControllerProcess(command))


@pytest.fixture
def ros_domain(request: pytest.FixtureRequest) -> Iterator[int]:
    """Initialise rclpy for a test, in a domain that no other worker uses; return the domain.

    If rclpy is initialised already, its context and domain are used.
    """
    from pfd_ros.testing.session import current_domain, initialised

    domain = current_domain()
    if domain is not None:
        yield domain
        return
    domain = request.getfixturevalue('_own_ros_domain')
    with initialised(domain):
        yield domain


@pytest.fixture(scope='session')
def _own_ros_domain() -> Iterator[int]:
    """Claim a domain for this process and those that its tests start."""
    from pfd_ros.testing.session import claimed_domain

    with claimed_domain() as domain:
        yield domain
