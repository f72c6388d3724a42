# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Answers at the states of a problem: by our kernels and by Pinocchio.

Accelerations of ours are programs on the emulator, which give the bits of a kernel, also for
chains that take long to compile. Derivatives are of kernels, A and B of `Simulator.linearize`, one
step of rk4. All have the same bits on every machine.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.problems import FORWARD, STATE, Problem
from benchmarks.cases.robots import Array
from benchmarks.peers.pinocchio import Pinocchio
from benchmarks.references.derivatives import linear_rk4
from pfd_core.kernels.auto import select
from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.recipes import error_estimate, recipe_of
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model.scene import Scene
from pfd_core.simulation.simulator import Simulator

# Names of the ways on pages.
DEFAULT, REFINED, PEER = 'default', 'refine=1', 'Pinocchio'


def kernel_answer(problem: Problem, dtype: str, refine: int, method: str = 'auto') -> NDArray[Any]:
    """Return qdd (S, n), with the bits of the kernel."""
    spec = KernelSpec(problem.robot, problem.scene or Scene(), method, dtype, refine)
    qdd: NDArray[Any] = _run(recipe_of(spec).program, problem, dtype)['qdd']
    return qdd


def first_answer(problem: Problem, dtype: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the answer (S, n) that a refined kernel corrects, and its estimated error (S,)."""
    method, _ = select(problem.plant, 'auto', 1)
    before = kernel_answer(problem, dtype, 0, method)
    spec = KernelSpec(problem.robot, problem.scene or Scene(), method, dtype)
    answered = replace(problem, states=problem.states | {'qdd': before})
    error = _run(error_estimate(spec).program, answered, dtype)['error']
    return before, error[:, 0].astype(np.float64)


def _run(program: Program, problem: Problem, dtype: str) -> dict[str, Any]:
    # A lost answer divides by zero and overflows: its error is infinite.
    with np.errstate(all='ignore'):
        return run(program, problem.states, dtype)


def kernel_jacobians(
    problem: Problem, dtype: str, refine: int, h: float | None
) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return d qdd / d (q, qd, tau), (S, n, 3n), and [A B] of a step of h seconds, if any."""
    how: dict[str, Any] = {'quantity': 'derivatives', 'dtype': dtype, 'refine': refine}
    kernel = compile_kernel(problem.robot, scene=problem.scene, **how)
    given: dict[str, Any] = {name: x.astype(dtype) for name, x in problem.states.items()}
    J = kernel(**given)
    if h is None:
        return J, None
    settings: dict[str, Any] = {'step_size': h, 'substeps': 1, 'dtype': dtype}
    simulator = Simulator(problem.robot, problem.scene, integrator='rk4', **settings)
    rows = zip(*problem.states.values(), strict=True)
    states = (dict(zip(problem.states, row, strict=True)) for row in rows)
    return J, np.array([np.hstack(simulator.linearize(**x)) for x in states]).astype(np.float64)


def peer_answer(problem: Problem) -> Array | None:
    """Return qdd (S, n) by pinocchio.aba; None where it does not take the problem."""
    peer = _peer(problem, FORWARD)
    return None if peer is None else peer.results([problem.states[name] for name in STATE])


def peer_jacobians(problem: Problem, h: float) -> tuple[Array, Array] | None:
    """Return d qdd / d (q, qd, tau) and [A B] of a step by computeABADerivatives, or None."""
    peer = _peer(problem, 'derivatives')
    if peer is None:
        return None
    evaluate = peer.acceleration_and_derivatives
    q, qd, tau = (problem.states[name] for name in STATE)
    rows = list(zip(q, qd, tau, strict=True))
    with np.errstate(all='ignore'):
        J = np.array([evaluate(*row)[1] for row in rows])
        return J, np.array([linear_rk4(evaluate, *row, h) for row in rows])


def _peer(problem: Problem, quantity: str) -> Pinocchio | None:
    """Return Pinocchio's model of a plant; None with a wrench, or if it refuses the robot."""
    if 'wrench' in problem.states:
        return None
    try:
        return Pinocchio(problem.plant, quantity)
    except (ValueError, RuntimeError):
        return None
