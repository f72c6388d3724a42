# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCRBM with the triangular array: H and bias on n lanes, the solve by n(n+1)/2 cells.

    H qdd = tau - bias,   H = L L',   L z = tau - bias,   L' qdd = z

Lee and Chang 1987, section 2.6 and Table 1. H is from pfd_core.algorithms.paper.pcrbm, the cells
are from pfd_core.algorithms.paper.triangular_array.

Parallel cost: H and bias, and 5n - 2 cycles of the array.

Lane j holds column j of H; the numbers in the array are values on lane 0.
"""

from __future__ import annotations

from collections.abc import Iterator
import math

from pfd_core.algorithms.chain.equations import (
    LinkTorques,
    armature,
    forward_equations,
    held_joints,
)
from pfd_core.algorithms.paper.newton_euler import newton_euler
from pfd_core.algorithms.paper.pcrbm import inertia_matrix
from pfd_core.algorithms.paper.triangular_array import clock
from pfd_core.dynamics.interface import program_with_outputs
from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.program import Instruction, Program, Steps
from pfd_core.model import Plant
from pfd_core.paper import networks
from pfd_core.paper.lanes import gather

# The section of the program that the cells execute, and the section that brings H to lane 0. A
# real array takes H at its rows, each next to a lane.
SECTION = 'triangular array'
STREAMS = f'streams of the {SECTION}'


def record_pcrbm_array(
    plant: Plant, schedule: str, *, link_torques: LinkTorques = newton_euler
) -> Program:
    """
    Return the program of qdd and pivots, (n,), from q, qd and tau.

    The cells' arithmetic is in the section SECTION, one step for each operation of each cell;
    on the array itself it takes triangular_array.solve_cycles(n) cycles. The pivots are the
    radicands of the cells: H is positive definite exactly when all are above zero.
    """
    recorder, chain, at, y = forward_equations(plant, schedule, link_torques)
    rows = inertia_matrix(recorder, chain, at, armature(recorder, plant))
    n = recorder.lanes
    if plant.brakes:
        rows, y, free = held_joints(rows, y)
        rows = [merge(where(on(free, [k]), rows[k], math.inf), rows[k]) for k in range(n)]
    with recorder.section(STREAMS):
        places = [[*((rows[k], m) for m in range(k, n)), (y, k)] for k in range(n)]
        problem = [[gather({0: place}) for place in row] for row in places]
    with recorder.section(SECTION):
        trace = clock([problem], turn=True)
    qdd = [trace.leaving((k, 1), 'left')[0].value for k in range(1, n + 1)]
    pivots = [trace.states[k, k].radicand for k in range(1, n + 1)]
    return program_with_outputs(recorder, qdd=qdd, pivots=pivots)


def streams(n: int) -> Iterator[tuple[int | None, ...]]:
    """
    Yield the routes that bring H to the rows of the array, for each lane the lane it reads.

    Row k takes element (k, m), which is in column m, one cycle after (k, m - 1), and in the same
    cycle row k + 1 takes (k + 1, m - 1): one route for each k + m.
    """
    for cycle in range(1, 2 * n - 2):
        rows = range(max(cycle - n + 1, 0), (cycle + 1) // 2)
        yield tuple(cycle - lane if lane in rows else None for lane in range(n))


def stream_steps(n: int, processors: int, network: str = 'crossbar') -> Steps:
    """Return the steps of these routes on a network; on one processor nothing moves."""
    if processors == 1:
        return Steps()
    routes = tuple(Instruction('route', data=sources) for sources in streams(n))
    return networks.steps(Program(n, routes, {}, {}), network, processors)
