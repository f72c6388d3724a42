# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stack of a thread: the matrices that native code keeps there must fit."""

from __future__ import annotations

# The widest register, and half of the stack that a thread has on Linux.
REGISTER_BYTES = 64
STACK_BYTES = 4 << 20


def check_stack(name: str, numbers: int) -> None:
    """Raise ValueError if the numbers of a state exceed the stack of a thread."""
    # One register holds one number of each of the states that run at once.
    size = REGISTER_BYTES * numbers
    if size > STACK_BYTES:
        raise ValueError(
            f'{name} needs {size / 2**20:.1f} MB of the stack, more than {STACK_BYTES >> 20} MB: '
            'the robot has too many joints'
        )
