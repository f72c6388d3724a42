# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities other than forward dynamics: kernels as contenders, states, and 50-digit references.

A quantity is a row of QUANTITIES; its peers are rows of tables of the same names in
pfd_core.report.quantity_peers and quantity_casadi. `linear_step` is the linearised step of a
simulation, [A B], by classical Runge-Kutta.

All numbers of states are rounded to float32, so that one reference serves both number formats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.acceleration_derivatives import record_acceleration_derivatives
from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.algorithms.quantities import RECORDERS
from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.functions import inverse_dynamics
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.quantities import QUANTITIES as KERNEL_QUANTITIES
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Robot, resolve
from pfd_core.report.hard_case_problems import SEED, single
from pfd_core.report.hard_case_reference import DIGITS
from pfd_core.report.timing import Array, LeftOutError, Side, Work
from pfd_core.simulation.linearisation import LinearStep
from pfd_core.simulation.simulator import Simulator

# Seconds of a linearised step: 2^-7, so that halves of it are exact.
LINEAR_STEP = 2.0**-7

States = Mapping[str, Array]
Evaluation = Callable[[NDArray[Any], NDArray[Any], NDArray[Any]], tuple[Any, Any]]


@dataclass(frozen=True)
class Quantity:
    """
    A quantity of the report.

    Attributes
    ----------
    title : str
        The result in words, for a page.
    most : int
        The most joints for which it is measured.
    call : str
        The way to its kernel, for a page; empty for a quantity of compile_kernel.

    """

    title: str
    most: int = 30
    call: str = ''


STATE = ('q', 'qd', 'tau')
QUANTITIES = {
    'inverse_dynamics': Quantity('torques of an acceleration'),
    'inertia_matrix': Quantity('inertia matrix'),
    'bias_torques': Quantity('torques at zero acceleration'),
    'gravity_torques': Quantity('torques at rest'),
    'tip_pose': Quantity("pose of the tip in the base link's frame"),
    'tip_jacobian': Quantity('Jacobian of the tip in axes of the base link'),
    'derivatives': Quantity('d qdd / d(q, qd, tau)'),
    'linear_step': Quantity(
        'A and B of a step of classical Runge-Kutta', most=12, call='`Simulator.linearize`'
    ),
}


def argument_names(quantity: str) -> tuple[str, ...]:
    """Return the names of the arguments of a quantity, among those of `random_states`."""
    kernel = KERNEL_QUANTITIES.get(quantity)
    return STATE if kernel is None else kernel.arguments


def solves(quantity: str) -> bool:
    """Return whether a quantity contains forward dynamics, which may be refined."""
    kernel = KERNEL_QUANTITIES.get(quantity)
    return kernel is None or not kernel.method


def random_states(robot: Robot, count: int) -> dict[str, Array]:
    """Return q, qd, qdd and the torques of that acceleration, (count, n) each."""
    rng = np.random.default_rng(SEED)
    q, qd, qdd = (
        single(reach * rng.uniform(-1, 1, (count, robot.n))) for reach in (np.pi, 1.0, 1.0)
    )
    return {'q': q, 'qd': qd, 'qdd': qdd, 'tau': single(inverse_dynamics(robot, q, qd, qdd))}


def arguments(quantity: str, work: Work) -> tuple[Array, ...]:
    """Return the arguments of a quantity in a work, whose `tau` is its third argument."""
    return work.arrays[: len(argument_names(quantity))]


def work_of(kind: str, quantity: str, states: States) -> Work:
    """Return the work of a quantity: a batch of all states, or a call of the first."""
    third = 'qdd' if 'qdd' in argument_names(quantity) else 'tau'
    q, qd, last = (states[name] for name in ('q', 'qd', third))
    return Work(kind, q, qd, last) if kind == 'batch' else Work(kind, q[0], qd[0], last[0])


@dataclass(frozen=True)
class QuantityKernel:
    """The kernel of one quantity of a robot, in a number format, as a contender."""

    quantity: str
    name: str
    kernel: Kernel
    simulator: Simulator | None = None

    def sides(self, work: Work) -> Iterator[Side]:
        """Return the ways of a call or a batch; results are (size,) or (B, size)."""
        return self._calls(work) if work.kind == 'call' else self._batches(work)

    def _calls(self, work: Work) -> Iterator[Side]:
        given = named(self.quantity, work, np.ascontiguousarray, self.kernel.dtype)
        if self.simulator is not None:
            sim = self.simulator
            yield Side(
                f'{self.name}: simulator.linearize(q, qd, tau)',
                partial(sim.linearize, **given),
                lambda: np.hstack(sim.linearize(**given)).ravel(),
            )
        out, target = self.kernel(**given), self.kernel(**given)
        yield Side(
            f'{self.name}: kernel(..., out=)',
            partial(self.kernel, **given, out=out),
            partial(self._entries, out),
        )
        bound = self.kernel.bind(**given, out=target)
        yield Side(f'{self.name}: bound', bound, partial(self._entries, target))

    def _batches(self, work: Work) -> Iterator[Side]:
        for order, laid in (('F', np.asfortranarray), ('C', np.ascontiguousarray)):
            given = named(self.quantity, work, laid, self.kernel.dtype)
            out = self.kernel(**given)
            yield Side(
                f'{self.name}, {order} order',
                partial(self.kernel, **given, out=out),
                partial(self._entries, out),
            )

    def _entries(self, out: NDArray[Any]) -> NDArray[Any]:
        """Return the entries of a quantity from a result of its kernel, (size,) or (B, size)."""
        if self.quantity == 'linear_step':
            # The last column is the state at the end.
            out = out[..., : 3 * self.kernel.robot.n]
        single = out.ndim == len(self.kernel.shape)
        return out.reshape(-1) if single else out.reshape(len(out), -1)


def named(quantity: str, work: Work, laid: Callable[[Array], Array], dtype: str) -> dict[str, Any]:
    """Return the arguments of a kernel by name, copied in an order and number format."""
    given = (laid(x).astype(dtype) for x in arguments(quantity, work))
    return dict(zip(STATE, given, strict=False))


def make(quantity: str, dtype: str, refine: int, robot: Robot) -> QuantityKernel:
    """Compile the kernel of a quantity; LeftOutError beyond its limit of joints."""
    row = QUANTITIES[quantity]
    if robot.n > row.most:
        raise LeftOutError(f'not measured beyond {row.most} joints')
    name = f'pfd {dtype}{" refined" * (refine > 0)}'
    if quantity != 'linear_step':
        kernel = compile_kernel(robot, quantity=quantity, dtype=dtype, refine=refine)
        return QuantityKernel(quantity, name, kernel)
    simulator = Simulator(
        robot, step_size=LINEAR_STEP, substeps=1, integrator='rk4', dtype=dtype, refine=refine
    )
    return QuantityKernel(quantity, name, LinearStep(simulator).kernel, simulator)


def exact(quantity: str, robot: Robot, states: States) -> NDArray[Any]:
    """Return a quantity of states in 50 digits, (S, size), as mpmath.mpf."""
    if quantity == 'linear_step':
        return _exact_linear_steps(robot, states)
    plant = resolve(robot)
    if quantity == 'derivatives':
        program = record_acceleration_derivatives(plant)
    else:
        program = RECORDERS[quantity](plant, None)
    (output,) = program.outputs
    return _run(program, output, states)


def _run(program: Program, output: str, states: States) -> NDArray[Any]:
    result = run(program, states, digits=DIGITS)[output]
    flat: NDArray[Any] = result.reshape(len(result), -1)
    return flat


def _exact_linear_steps(robot: Robot, states: States) -> NDArray[Any]:
    import mpmath

    plant, n = resolve(robot), robot.n
    accelerations = record_forward_dynamics(plant, 'articulated_body', 'parallel')
    derivatives = record_acceleration_derivatives(plant)

    def evaluate(q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any]) -> tuple[Any, Any]:
        state = {'q': q[None], 'qd': qd[None], 'tau': tau[None]}
        (qdd,) = _run(accelerations, 'qdd', state)
        (J,) = _run(derivatives, 'derivatives', state)
        return qdd, J.reshape(n, 3 * n)

    with mpmath.workdps(DIGITS):
        number = np.vectorize(mpmath.mpf, otypes=[object])
        step = mpmath.mpf(LINEAR_STEP)
        rows = zip(*(number(states[name]) for name in STATE), strict=True)
        return np.array([linear_rk4(evaluate, q, qd, tau, step).ravel() for q, qd, tau in rows])


def linear_rk4(
    evaluate: Evaluation, q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any], step: Any
) -> NDArray[Any]:
    """
    Return [A B], (2n, 3n), of a step of classical Runge-Kutta, stage by stage.

    `evaluate` returns qdd, (n,), and its derivatives by q, qd and tau, (n, 3n). The numbers may
    be of any type.
    """
    n = len(q)
    start = np.eye(3 * n)[: 2 * n]
    x, v, by_start = q, qd, start
    slopes = []
    for part in (0.5, 0.5, 1.0, 0.0):
        qdd, J = evaluate(x, v, tau)
        by_state = J[:, : 2 * n] @ by_start
        by_state[:, 2 * n :] += J[:, 2 * n :]
        slope = np.concatenate([by_start[n:], by_state])
        slopes.append(slope)
        x, v, by_start = q + part * step * v, qd + part * step * qdd, start + part * step * slope
    a, b, c, d = slopes
    result: NDArray[Any] = start + step / 6 * (a + 2 * b + 2 * c + d)
    return result


def largest_error(found: NDArray[Any], wanted: NDArray[Any]) -> float:
    """Return max|found - wanted| / max|wanted| of a state, the largest over states, (S, size)."""
    off = np.abs(np.asarray(found, float).astype(object) - wanted).max(axis=-1)
    return float((off / np.abs(wanted).max(axis=-1)).max())
