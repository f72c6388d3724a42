# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the model that the arm shares with its controllers, and of their topics."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.setting_fields import setting


@dataclass(frozen=True)
class DescriptionSettings:
    """The part of the settings that is about the model outside of the arm."""

    publish_locked: bool = setting(
        True, 'Publish the locked joints in joint_states too, after the others, at rest'
    )
