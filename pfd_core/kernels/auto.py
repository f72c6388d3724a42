# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The method that 'auto' selects: the cheapest one that keeps the digits of the answer.

For a kernel of forward dynamics, rounding errors of the methods are measured (`roundings`). The
first method within its limit in MOST_ROUNDINGS is taken, or a method with one step of refinement
if none is within it, as on all chains of LONG joints and more
(docs/decisions/0040-a-default-that-is-not-worse.md).

For derivatives the rounding error of the inverse X of the inertia matrix is measured
(`inverse_roundings`): their other factor, the derivatives of inverse dynamics, is the same for all
methods. The first method within its limit in MOST_INVERSE is taken, for X and for the
accelerations, or a step of refinement of both.

The rest of this text is about the method of a step of a simulation, and of a refined kernel.

The cheapest is the serial method whose kernel has the fewest operations. The matrix of
composite bodies grows with n^2 and its factors with n^3, articulated bodies with n, from a higher
start. Ordinary arms of up to seven joints are cheaper by the former, chains of sixteen and more by
the latter, by at least a tenth; in between it depends on the zeros of the chain, and both are
recorded, lowered and counted.

A pivot d_i of the inertia matrix H is what is left of the diagonal h_ii after the joints nearer
to the tip are eliminated. The answer of composite bodies loses a factor of up to max h_ii / d_i.
Beyond LARGEST_LOSS a plain kernel uses articulated bodies with the parameters as given,
which subtract no such large numbers. A step of refinement squares the loss, in units of u: it is
corrected up to u^-1/2. Beyond LARGEST_LOSS_REFINED a refined kernel uses articulated bodies. The
condition number of the scaled H would decide alike, but needs LAPACK; pivots need products and
differences in a fixed order, so every machine makes the same choice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
import math
from typing import TypeVar

import numpy as np

from pfd_core.dynamics.methods import EMULATED_METHODS, METHODS, record_forward_dynamics
from pfd_core.dynamics.quantities import RECORDERS
from pfd_core.forking import no_fork
from pfd_core.kernels.cache import kept
from pfd_core.kernels.lower import lower, operations
from pfd_core.kernels.simplify import eliminate_dead_code
from pfd_core.kernels.sines import expand_sines
from pfd_core.model import Plant
from pfd_core.model.effects import INERTIA
from pfd_core.model.values import Array, integer, quote

T = TypeVar('T')

FEW_JOINTS, MANY_JOINTS = 'composite_body', 'grouped_articulated_body'
# Steps of refinement; the second one hardly finds a digit to correct, and each adds its code.
REFINE_AT_MOST = 16
# The longest chain that always takes FEW_JOINTS, and the shortest that always takes MANY_JOINTS.
SHORT, LONG = 7, 16
ACCURATE = 'articulated_body'
# Largest h_ii / d_i that composite bodies are taken with: plain, thirteen digits are left in
# float64; refined, it is a tenth of u^-1/2.
LARGEST_LOSS, LARGEST_LOSS_REFINED = 1e3, 1e7
# Poses at which the pivots are looked at.
POSES = 16
# Largest rounding error that an answer may have without refinement, in roundings (`roundings`).
MOST_ROUNDINGS = {FEW_JOINTS: 3.0, MANY_JOINTS: 3.8}
# The same for H^-1, whose factor is the cheapest by far.
MOST_INVERSE = {FEW_JOINTS: 4.0, MANY_JOINTS: 8.0}
# States at which rounding errors are measured; the share of the states that must be within a
# limit; and the relative change of a state by which the effect of rounding its numbers is
# measured.
STATES, SHARE, CHANGE = 256, 0.9, 2.0**-26
# Torques of these states, relative to the largest torque of inertia and gravity: the arm nearly
# falls, so that errors of large torques near the base meet small inertias near the tip.
TORQUES = 2.0**-6


def _kept(key: tuple[str, ...], compute: Callable[[], T]) -> T:
    def found(head: dict[str, T], _: bytes) -> T:
        return head['found']

    return kept(key, lambda: ({'found': compute()}, b''), found)


def choose(plant: Plant, method: str, refine: int) -> str:
    """Return the method to record for a name in METHODS or 'auto'; ValueError for other names."""
    integer('refine', refine, 0, REFINE_AT_MOST)
    if not isinstance(method, str) or method not in ('auto', *METHODS):
        emulated = isinstance(method, str) and method in EMULATED_METHODS
        more = f', which is only emulated: use pfd.emulate(method={method!r})' if emulated else ''
        raise ValueError(f"method must be 'auto' or one of {METHODS}, got {quote(method)}{more}")
    if method != 'auto':
        return method
    n = plant.robot.n
    if n >= LONG:
        return MANY_JOINTS
    loss = _kept(('pivot loss', plant.digest), lambda: _loss(plant))
    if loss > (LARGEST_LOSS_REFINED if refine else LARGEST_LOSS):
        # ACCURATE takes no payload as an input.
        return MANY_JOINTS if refine or plant.payload_input else ACCURATE
    if n <= SHORT:
        return FEW_JOINTS
    return _kept(('auto', plant.digest), lambda: _cheapest(plant))


def default(plant: Plant, method: str, refine: int) -> tuple[str, int]:
    """Return the method and the steps of refinement of a kernel of forward dynamics."""
    if not _left_to_auto(method, refine):
        return choose(plant, method, refine), refine
    plain = _kept(('accurate', plant.digest), lambda: _accurate(plant))
    return (plain, 0) if plain else (choose(plant, 'auto', 1), 1)


def default_of_derivatives(plant: Plant, method: str, refine: int) -> tuple[str, int]:
    """Return the method and the steps of refinement of a kernel of derivatives."""
    if _left_to_auto(method, refine):
        return default_inverse(plant)
    return choose(plant, method, refine), refine


def default_inverse(plant: Plant) -> tuple[str, int]:
    """Return the method and the steps of refinement that derivatives have by default."""
    bodies = _bodies(plant)
    plain = _kept(('accurate inverse', bodies.digest), lambda: _accurate_inverse(bodies))
    return (plain, 0) if plain else (choose(bodies, 'auto', 1), 1)


def _bodies(plant: Plant) -> Plant:
    """Return a plant with the effects that H depends on."""
    return replace(
        plant.only(INERTIA),
        external_wrench=False,
        brakes=False,
        payload_input=False,
    )


def _accurate_inverse(plant: Plant) -> str:
    """Return the first method whose errors of H^-1 are within its limit, cheapest first, or ''."""
    if plant.robot.n >= LONG:
        return MANY_JOINTS
    found = inverse_roundings(plant, MOST_INVERSE)
    return next((method for method, error in found if error <= MOST_INVERSE[method]), '')


def inverse_roundings(plant: Plant, methods: Iterable[str]) -> Iterator[tuple[str, float]]:
    """
    Yield methods and how far they round H^-1 on a robot with its payload and rotors.

    As `roundings`, at the same positions, with errors in the Frobenius norm.
    """
    with no_fork:
        from pfd_core.dynamics.acceleration import record_derivatives
        from pfd_core.machine.emulator import run

    bare = _bodies(plant)
    q, *_, signs = _uniform(plant.robot.n)
    q = np.pi * q
    near = q * (1 + np.copysign(CHANGE, signs))

    def inverse(method: str, steps: int, *positions: Array) -> list[Array]:
        recorded = eliminate_dead_code(record_derivatives(bare, method, steps), ['X'])
        program = expand_sines(recorded, 'float64')
        return [run(program, dict.fromkeys(program.inputs, x))['X'] for x in positions]

    with np.errstate(all='ignore'):
        right, moved = inverse(choose(plant, 'auto', 1), 1, q, near)
        change = _distances(moved, right) / CHANGE
    for method in methods:
        with np.errstate(all='ignore'):
            (plain,) = inverse(method, 0, q)
            error = _distances(plain, right) / (2.0**-53 * np.maximum(1.0, change))
        yield method, _at_share(error, right.reshape(STATES, -1))


def _distances(found: Array, right: Array) -> Array:
    """Return |found - right| / |right| of each matrix, in the Frobenius norm."""
    flat = right.reshape(STATES, -1)
    difference = found.reshape(STATES, -1) - flat
    # Sums in the order of the elements: NumPy's own order depends on the processor.
    squares, whole = (np.cumsum(x * x, axis=-1)[:, -1] for x in (difference, flat))
    result: Array = np.sqrt(squares / whole)
    return result


def _at_share(errors: Array, right: Array) -> float:
    """Return the SHARE-quantile of the errors of answers, (STATES, k)."""
    # A joint without inertia, which only brakes can hold, has no answer to compare.
    found = np.sort(np.where(np.isfinite(right).all(axis=-1), errors, 0.0))
    return float(found[int(SHARE * STATES)])


def _left_to_auto(method: str, refine: int) -> bool:
    named = not isinstance(method, str) or method != 'auto'
    return not named and not integer('refine', refine, 0, REFINE_AT_MOST)


def _uniform(n: int) -> Array:
    """Return five rows of STATES numbers for n joints, uniform within [-1, 1)."""
    with no_fork:
        from numpy.random import PCG64

    shape = (5, STATES, n)
    bits = PCG64(0).random_raw(math.prod(shape)).reshape(shape)
    # From the upper 53 bits.
    numbers: Array = (bits >> np.uint64(11)) * 2.0**-52 - 1
    return numbers


def _accurate(plant: Plant) -> str:
    """Return the first method whose errors are within its limit, cheapest first, or ''."""
    if plant.robot.n >= LONG:
        return ''
    first = FEW_JOINTS if plant.robot.n <= SHORT else _cheapest(plant)
    # With rotors or brakes no row of a grouped articulated body vanishes, and it loses more than
    # `roundings` shows (geared_rotors_1e6).
    stiff = plant.brakes or plant.inertia is not None
    methods = (FEW_JOINTS,) if stiff else (first, MANY_JOINTS)
    return next(
        (
            method
            for method in dict.fromkeys(methods)
            if roundings(plant, method) <= MOST_ROUNDINGS[method]
        ),
        '',
    )


def roundings(plant: Plant, method: str) -> float:
    """
    Return how far a method rounds on a robot with its payload and rotors, in gravity.

    The error of a state is max |difference| / max |qdd| compared with the refined answer. Its
    unit is the change of the refined answer when each number of the state changes by a unit of
    rounding, and at least a unit of rounding. The result is the SHARE-quantile over STATES states.
    It is the same on every machine: NumPy guarantees the bits of its generator, sines are
    expanded, and no sum has an unknown order.
    """
    with no_fork:
        from pfd_core.dynamics.newton_euler import record_link_torques
        from pfd_core.dynamics.refinement import record_refined
        from pfd_core.machine.emulator import run

    bare = replace(
        plant.only(INERTIA),
        gravity=plant.gravity,
        external_wrench=False,
        brakes=False,
        payload_input=False,
    )
    torques, plain, refined = (
        expand_sines(program, 'float64')
        for program in (
            record_link_torques(bare),
            *(record_refined(bare, method, steps, estimate=None) for steps in (0, 1)),
        )
    )
    q, qd, qdd, tau, signs = _uniform(plant.robot.n)
    states = {'q': np.pi * q, 'qd': qd}
    with np.errstate(all='ignore'):
        needed = run(torques, states | {'qdd': qdd})['tau']
        states['tau'] = TORQUES * np.abs(needed).max() * tau
        near = {name: x * (1 + np.copysign(CHANGE, signs)) for name, x in states.items()}
        right = run(refined, states)['qdd']
        error, change = (
            np.abs(x - right).max(axis=-1) / np.abs(right).max(axis=-1)
            for x in (run(plain, states)['qdd'], run(refined, near)['qdd'])
        )
        found = error / (2.0**-53 * np.maximum(1.0, change / CHANGE))
    return _at_share(found, right)


def _cheapest(plant: Plant) -> str:
    few, many = (cost(plant, method) for method in (FEW_JOINTS, MANY_JOINTS))
    return FEW_JOINTS if few <= many else MANY_JOINTS


def cost(plant: Plant, method: str) -> int:
    """Return the operations of a method's kernel, changes of sign apart."""
    program = record_forward_dynamics(plant, method, 'sequential')
    counts = operations(lower(program, 'float64', ['qdd']).compiled)
    return sum(count for op, count in counts.items() if op != 'neg')


def _loss(plant: Plant) -> float:
    """
    Return the largest h_ii / d_i of H at POSES poses, at most the largest float.

    The first pose is straight, the others are spread. A joint without inertia, which only brakes
    can hold, loses nothing. The order of the operations is fixed, without BLAS, so that
    the outcome is the same on every machine.
    """
    with no_fork:
        from pfd_core.machine.emulator import run

    n = plant.robot.n
    q = np.pi * np.sin(np.outer(np.arange(POSES), np.arange(1, n + 1)))
    # A payload is unknown where it is an input.
    bare = replace(plant, payload_input=False)
    H = run(RECORDERS['inertia_matrix'](bare, None), {'q': q})['H']
    rest = H.copy()
    largest = 1.0
    for i in range(n - 1, -1, -1):
        row, pivot = rest[:, i].copy(), rest[:, i, i, np.newaxis].copy()
        moves = H[:, i, i] > 0
        if (pivot[moves] <= 0).any():
            return float(np.finfo(float).max)
        losses = H[moves, i, i] / pivot[moves, 0]
        largest = max(largest, float(losses.max(initial=1.0)))
        factors = np.divide(row, pivot, out=np.zeros_like(row), where=pivot > 0)
        rest -= factors[:, :, np.newaxis] * row[:, np.newaxis, :]
    return largest
