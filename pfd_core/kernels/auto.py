# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The method that 'auto' stands for: the serial one whose kernel has the fewest operations.

The matrix of composite bodies grows with n^2 and its factors with n^3, articulated bodies with n,
from a higher start. Ordinary arms of up to seven joints are cheaper by the former, chains of
sixteen and more by the latter, by at least a tenth; in between it depends on the zeros of the
chain, and both are recorded, lowered and counted.
"""

from __future__ import annotations

from pfd_core.algorithms.programs import METHODS, record_forward_dynamics
from pfd_core.kernels.passes.pipeline import lower, operations
from pfd_core.kernels.runtime.json_cache import get_or_compute
from pfd_core.model import Plant
from pfd_core.model.checked_numbers import integer

FEW_JOINTS, MANY_JOINTS = 'composite_body', 'grouped_articulated_body'
# The longest chain that always takes FEW_JOINTS, and the shortest that always takes MANY_JOINTS.
SHORT, LONG = 7, 16


def choose(plant: Plant, method: str, refine: int) -> str:
    """Return the method to record for a name in METHODS or 'auto'; ValueError for other names."""
    integer('refine', refine, 0)
    if method != 'auto' and method not in METHODS:
        raise ValueError(f"method must be 'auto' or one of {METHODS}, got {method!r}")
    if method != 'auto':
        return method
    if plant.robot.n <= SHORT:
        return FEW_JOINTS
    if plant.robot.n >= LONG:
        return MANY_JOINTS
    choices = (FEW_JOINTS, MANY_JOINTS)
    return get_or_compute(('auto', plant.digest), lambda: _cheapest(plant), choices.__contains__)


def _cheapest(plant: Plant) -> str:
    few, many = (cost(plant, method) for method in (FEW_JOINTS, MANY_JOINTS))
    return FEW_JOINTS if few <= many else MANY_JOINTS


def cost(plant: Plant, method: str) -> int:
    """Return the operations of a method's kernel, changes of sign apart."""
    program = record_forward_dynamics(plant, method, 'sequential')
    counts = operations(lower(program, 'float64', ['qdd']).compiled)
    return sum(count for op, count in counts.items() if op != 'neg')
