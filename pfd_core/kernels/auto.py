# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The method that 'auto' selects: the cheapest one that keeps the digits of the answer.

Rounding errors of the methods are measured on the robot (`roundings`), and the first method within
its limit in LIMITS is taken, cheapest first. If none is, the answer is refined once
(docs/decisions/0040-a-default-that-is-not-worse.md). Derivatives are measured by the inverse X of
the inertia matrix: their other factor, the derivatives of inverse dynamics, is the same for all
methods. A measurement is kept on disk.

The cheapest is the serial method whose kernel has the fewest operations: composite bodies for
ordinary arms of up to seven joints, whose work grows with n^3, articulated bodies for chains of
sixteen and more, each by at least a tenth. In between it depends on the zeros of the chain, and
both are recorded, lowered and counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import math
from typing import Any

import numpy as np

from pfd_core.dynamics.methods import (
    EMULATED_METHODS,
    METHODS,
    check_followers,
    record_forward_dynamics,
)
from pfd_core.forking import load, no_fork
from pfd_core.kernels.cache import kept
from pfd_core.model.effects import INERTIA
from pfd_core.model.plant import Plant
from pfd_core.model.values import Array, integer, quote

FEW_JOINTS, MANY_JOINTS = 'composite_body', 'grouped_articulated_body'
# Steps of refinement; the second one hardly finds a digit to correct, and each adds its code.
REFINE_AT_MOST = 16
# The longest chain that always takes FEW_JOINTS, and the shortest that always takes MANY_JOINTS.
SHORT, LONG = 7, 16
# Largest rounding error of each method, in `roundings`, by the use of the method. The factor of
# H^-1 is the cheapest by far. Steps of a simulation have larger errors of their own, and are never
# refined: thirteen digits are left of the accelerations. A refinement squares an error in units of
# u; the limit leaves room for ill-conditioned H.
LIMITS = {
    'forward_dynamics': {FEW_JOINTS: 3.0, MANY_JOINTS: 3.8},
    'derivatives': {FEW_JOINTS: 4.0, MANY_JOINTS: 8.0},
    'step': {FEW_JOINTS: 1e3, MANY_JOINTS: math.inf},
    'refined': {FEW_JOINTS: 1e5, MANY_JOINTS: math.inf},
}
# States at which rounding errors are measured; the share of the states that must be within a
# limit; and the relative change of a state by which the effect of rounding its numbers is
# measured.
STATES, SHARE, CHANGE = 256, 0.9, 2.0**-26
# Torques of these states, relative to the largest torque of inertia and gravity: the arm nearly
# falls, so that errors of large torques near the base meet small inertias near the tip.
TORQUES = 2.0**-6


def select(
    plant: Plant, method: str = 'auto', refine: int = 0, use: str = 'forward_dynamics'
) -> tuple[str, int]:
    """
    Return the method to record, and the steps of refinement; `use` is a name in LIMITS.

    ValueError for a method that is neither 'auto' nor a name in METHODS, or a wrong `refine`.
    """
    integer('refine', refine, 0, REFINE_AT_MOST)
    if not isinstance(method, str) or method not in ('auto', *METHODS):
        emulated = isinstance(method, str) and method in EMULATED_METHODS
        more = f', which is only emulated: use pfd.emulate(method={method!r})' if emulated else ''
        raise ValueError(f"method must be 'auto' or one of {METHODS}, got {quote(method)}{more}")
    if method != 'auto':
        check_followers(plant, method)
        return method, refine
    if use == 'derivatives':
        plant = _bodies(plant)
    plain = '' if refine else _first(plant, use)
    return (plain, 0) if plain else (_first(plant, 'refined'), refine or 1)


def _first(plant: Plant, use: str) -> str:
    """Return the first method within its limit, cheapest first, or ''."""
    n, methods = plant.robot.n, list(LIMITS[use])
    if plant.robot.followers:
        # No other method is to choose from, so that only an answer can be refined.
        inverse, limit = use == 'derivatives', LIMITS[use][FEW_JOINTS]
        refined = inverse or use == 'forward_dynamics'
        return '' if refined and roundings(plant, FEW_JOINTS, inverse) > limit else FEW_JOINTS
    if n >= LONG:
        return '' if use == 'forward_dynamics' else MANY_JOINTS
    if use == 'forward_dynamics' and (plant.brakes or plant.inertia is not None):
        # With rotors or brakes no row of a grouped articulated body vanishes, and it loses more
        # than `roundings` shows (geared_rotors_1e6).
        methods = [FEW_JOINTS]
    elif n > SHORT and use != 'derivatives' and _cheapest(plant) == MANY_JOINTS:
        methods = [MANY_JOINTS]
    for method in methods:
        limit = LIMITS[use][method]
        if limit == math.inf or roundings(plant, method, use == 'derivatives') <= limit:
            return method
    return ''


def roundings(plant: Plant, method: str, inverse: bool = False) -> float:
    """
    Return how far a method rounds accelerations, or H^-1, of a robot with payload and rotors.

    The error of a state is the difference from the refined answer: max |difference| / max |qdd| in
    gravity, of H^-1 in the Frobenius norm. Its unit is the change of the refined answer when each
    number of the state changes by a unit of rounding, and at least a unit of rounding. The result
    is the SHARE-quantile over STATES states. It is the same on every machine: NumPy guarantees the
    bits of its generator, sines are expanded, and no sum has an unknown order.
    """
    bare = _bodies(plant)
    if not inverse:
        bare = replace(bare, gravity=plant.gravity)
    name = 'roundings of H^-1' if inverse else 'roundings'
    return float(_kept((name, bare.digest, method), lambda: _roundings(bare, method, inverse)))


def cost(plant: Plant, method: str) -> int:
    """Return the operations of a method's kernel, changes of sign apart."""
    lower, operations = (load(f'kernels.lower.{name}') for name in ('lower', 'operations'))
    program = record_forward_dynamics(plant, method, 'sequential')
    counts = operations(lower(program, 'float64', ['qdd']).compiled)
    return sum(count for op, count in counts.items() if op != 'neg')


def _cheapest(plant: Plant) -> str:
    methods = FEW_JOINTS, MANY_JOINTS
    return str(_kept(('cheapest', plant.digest), lambda: min(methods, key=partial(cost, plant))))


def _kept(key: tuple[str, ...], compute: Callable[[], object]) -> Any:
    head, _ = kept(key, lambda: ({'found': compute()}, b''))
    return head['found']


def _bodies(plant: Plant) -> Plant:
    """Return a plant with the effects that H depends on."""
    return replace(plant.only(INERTIA), external_wrench=False, brakes=False, links={}, varied={})


def _roundings(bare: Plant, method: str, inverse: bool) -> float:
    with no_fork:
        from pfd_core.dynamics.acceleration import record_inverse_inertia
        from pfd_core.dynamics.newton_euler import record_link_torques
        from pfd_core.dynamics.refinement import record_refined
        from pfd_core.kernels.simplify import eliminate_dead_code
        from pfd_core.kernels.sines import expand_sines
        from pfd_core.machine.emulator import run

    def distance(found: Array, right: Array) -> Array:
        pair = found - right, right
        if inverse:
            # Sums in the order of the elements: NumPy's own order depends on the processor.
            difference, whole = (np.sqrt(np.cumsum(x * x, axis=-1)[:, -1]) for x in pair)
        else:
            difference, whole = (np.abs(x).max(axis=-1) for x in pair)
        return np.array(difference / whole)

    if inverse:
        recorded = eliminate_dead_code(record_inverse_inertia(bare, method), ['first', 'X'])
    else:
        recorded = record_refined(bare, method, 1, first=True)
    program = expand_sines(recorded, 'float64')
    q, qd, qdd, tau, signs = _uniform(bare.robot.n)
    states = {'q': np.pi * q, 'qd': qd}
    with np.errstate(all='ignore'):
        torques = expand_sines(record_link_torques(bare), 'float64')
        needed = run(torques, states | {'qdd': qdd})['tau']
        states['tau'] = TORQUES * np.abs(needed).max() * tau
        near = {name: x * (1 + np.copysign(CHANGE, signs)) for name, x in states.items()}
        both = {key: np.concatenate([states[key], near[key]]) for key in program.inputs}
        found = run(program, both)
        first, refined = (
            found[key].reshape(2, STATES, -1) for key in ('first', 'X' if inverse else 'qdd')
        )
        right = refined[0]
        change = distance(refined[1], right) / CHANGE
        error = distance(first[0], right) / (2.0**-53 * np.maximum(1.0, change))
    # A joint without inertia, which only brakes can hold, has no answer to compare.
    errors = np.sort(np.where(np.isfinite(right).all(axis=-1), error, 0.0))
    return float(errors[int(SHARE * STATES)])


def _uniform(n: int) -> Array:
    """Return five rows of STATES numbers for n joints, uniform within [-1, 1)."""
    with no_fork:
        from numpy.random import PCG64

    shape = (5, STATES, n)
    bits = PCG64(0).random_raw(math.prod(shape)).reshape(shape)
    # From the upper 53 bits.
    return np.array((bits >> np.uint64(11)) * 2.0**-52 - 1)
