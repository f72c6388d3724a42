# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The native code of quantities of the model: of outputs, and of the error of accelerations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.settings import OUTPUTS, Settings


def model_kernels(settings: Settings, robot: pfd.Robot, scene: pfd.Scene) -> Mapping[str, Any]:
    """Return the kernel of each enabled output that is a quantity of the model.

    The wrench on the tip and the gravity torques of the drives are not in the scene, since
    the outputs describe the model of the arm.
    """
    alone = replace(scene, external_wrench=False, gravity_compensation=False)
    return MappingProxyType(
        {
            name: pfd.compile_kernel(robot, scene=alone, quantity=kind.quantity)
            for name, kind in OUTPUTS.items()
            if name in settings.outputs and kind.quantity
        }
    )


def acceleration_kernel(robot: pfd.Robot, scene: pfd.Scene, method: str, refine: int = 0) -> Any:
    """Return the kernel of the accelerations, without brakes and the external wrench.

    Effects that act over a step, such as friction, are left out too: they have no accelerations.
    """
    over_a_step = {effect.name for effect in pfd.EFFECTS if effect.acts == 'step'}
    smooth = scene.without(over_a_step | {'brakes', 'external wrench'})
    return pfd.compile_kernel(robot, method=method, scene=smooth, refine=refine)
