# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings and types of outputs in addition to joint_states."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.setting_fields import setting
from pfd_ros.messages import convert

# Type of the messages of each output, whose topic is `~/<name>` and whose role is the name; in the
# order in which a cycle puts them out. The names are in recordings and stay.
OUTPUTS = {
    'true_states': convert.JOINT_STATE,
    'acceleration': convert.FLOAT_ARRAY,
    'external_torques': convert.JOINT_STATE,
    'inertia_matrix': convert.FLOAT_ARRAY,
    'bias_torques': convert.JOINT_STATE,
    'gravity_torques': convert.JOINT_STATE,
    'external_torques_array': convert.FLOAT_ARRAY,
    'bias_torques_array': convert.FLOAT_ARRAY,
    'gravity_torques_array': convert.FLOAT_ARRAY,
    'tip_jacobian': convert.FLOAT_ARRAY,
    'tip_pose': convert.POSE,
    'tip_wrench': convert.WRENCH,
    'energy': convert.FLOAT_ARRAY,
}


@dataclass(frozen=True)
class OutputSettings:
    """The settings of outputs in addition to joint_states."""

    outputs: tuple[str, ...] = setting(
        (), 'Published with each state, on ~/<name>; empty means nothing', values=tuple(OUTPUTS)
    )
