# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in tests of controllers: in lockstep, faster than real time, with reproducible bits.

From the fixtures to the arm, and back to assertions:

    plugin       the pytest fixtures; imports the others when a test uses one
    arm          LockstepArm: settings, runs, inputs; the inputs are kept to record a failed test
    loop         the loop of arm and controller over a link, the link to a function of the test;
                 errors; why a command was rejected
    nodes        the link to rclpy nodes of this process and to any nodes of others
    patience     interrupts a controller that blocks
    again        the arm of a log again: with a controller in the loop, or as a motion
    written      the first finding of a log as a pytest
    trajectory   Trajectory: the arrays of a run, its metrics, and assertions
    artifacts    files of a failed test: recording and page of each arm
    domains      a ROS domain for this process alone, and rclpy in it
    process      processes that end with the test: controllers and the node

Only `plugin` imports pytest, and only `nodes`, `domains` and NodeProcess.wait rclpy. A new metric
is a function in pfd_ros.motion.metrics, a method of trajectory.Trajectory, and perhaps an
assertion there.
"""

from __future__ import annotations

import importlib
from typing import Any

# Public names, imported when they are used: the plugin is in every session of pytest.
_NAMES = {
    'arm': ('LockstepArm', 'RecordingError'),
    'loop': ('ArmError', 'ControllerError', 'NoAnswerError', 'RejectedError', 'REASONS'),
    'process': ('ControllerProcess', 'NodeProcess', 'NodeProcessError'),
    'trajectory': ('Trajectory', 'Limits', 'LimitHit', 'ComputationTime'),
    'again': ('replayed', 'recorded', 'findings'),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(importlib.import_module(f'{__name__}.{_HOMES[name]}'), name)
