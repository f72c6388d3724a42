# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Transitions of the node."""

from __future__ import annotations

from ros_processes import Peer, call


def change(peer: Peer, label: str) -> bool:
    """Ask for a transition and return whether it succeeded."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    return bool(
        call(peer, ChangeState, 'change_state', transition=Transition(label=label)).success
    )
