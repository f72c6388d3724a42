# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The kernels of this package as peers: methods, quantities and number formats."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.quantities import FORWARD, LINEAR_STEP, QUANTITIES
from benchmarks.peers.work import STEP_SIZE, Contents, LeftOutError, Peer, Side, Work, named
from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.kernel import Kernel
from pfd_core.model import Robot
from pfd_core.simulation.linearisation import LinearStep
from pfd_core.simulation.simulator import Simulator

# Method to the largest number of joints that is measured, and the reason for the limit.
GROWTH = 'its straight-line code takes long to compile'
METHODS = {
    'composite_body': (30, GROWTH),
    'grouped_articulated_body': (200, GROWTH),
    'articulated_body': (12, 'grouped_articulated_body is the same in fewer operations'),
    'pcrbm': (12, GROWTH),
}
THREADS = 2
# Smallest batch that is measured with a second thread.
SHARED_FROM = 4096
CODE = 'native code for this robot and processor'
NUMBERS = 'own sine and cosine, 1.5 ulp, any angle'
CHECKED = Contents(CODE, 'Python, arguments checked')
BOUND = Contents(CODE, 'Python, arguments checked before')
BATCH = Contents(CODE, 'Python, once', 'native, a vector of states at a time')
ROLLOUT = Contents(CODE, 'Python, once', 'native')
LINEARISED = Contents(CODE, "Python's work on the step included")


@dataclass(frozen=True)
class Ours(Peer):
    """The kernel of one quantity of a robot, in one number format; `linearizer` linearises."""

    kernel: Kernel
    name: str
    quantity: str = FORWARD
    linearizer: Simulator | None = None

    def _side(self, way: str, run: Any, result: Any, contents: Contents) -> Side:
        numbers = f'{self.kernel.dtype}; {NUMBERS}'
        return Side(way, run, result, contents=replace(contents, numbers=numbers))

    def _calls(self, work: Work) -> Iterator[Side]:
        given = named(self.quantity, work, np.ascontiguousarray, self.kernel.dtype)
        forward, double = self.quantity == FORWARD, self.kernel.dtype == 'float64'
        if self.linearizer is not None:
            linearize = partial(self.linearizer.linearize, **given)
            way = f'{self.name}: simulator.linearize(q, qd, tau)'
            yield self._side(way, linearize, lambda: np.hstack(linearize()).ravel(), LINEARISED)
        call = partial(self.kernel, *given.values())
        out, target = call(), call()
        # Python's share of a call does not depend on the number format.
        if forward and double:
            yield self._side(f'{self.name}: kernel(q, qd, tau)', call, call, CHECKED)
        if double or not forward:
            run, result = partial(call, out=out), partial(self._entries, out)
            yield self._side(f'{self.name}: kernel(..., out=)', run, result, CHECKED)
        bound = self.kernel.bind(**given, out=target)
        yield self._side(f'{self.name}: bound', bound, partial(self._entries, target), BOUND)

    def _batches(self, work: Work) -> Iterator[Side]:
        shared = work.units >= SHARED_FROM and self.kernel.dtype == 'float64'
        for order, laid in (('F', np.asfortranarray), ('C', np.ascontiguousarray)):
            given = named(self.quantity, work, laid, self.kernel.dtype)
            out = self.kernel(**given)
            run, result = partial(self.kernel, **given, out=out), partial(self._entries, out)
            yield self._side(f'{self.name}, {order} order', run, result, BATCH)
            if order == 'F' and self.quantity == FORWARD and shared:
                name = f'{self.name}, {order} order, {THREADS} threads'
                yield self._side(name, partial(run, threads=THREADS), result, BATCH)

    def _rollouts(self, work: Work) -> Iterator[Side]:
        method, dtype = self.kernel.method, self.kernel.dtype
        simulator = _runge_kutta(self.kernel.robot, STEP_SIZE, method=method, dtype=dtype)
        taus = np.tile(work.tau, (work.steps, 1)).astype(dtype)

        def run() -> None:
            simulator.reset(work.q, work.qd)
            simulator.rollout(taus)

        yield self._side(self.name, run, lambda: simulator.q, ROLLOUT)

    def _entries(self, out: NDArray[Any]) -> NDArray[Any]:
        """Return the entries of a quantity from a result of its kernel, (size,) or (B, size)."""
        if self.quantity == 'linear_step':
            # The last column is the state at the end.
            out = out[..., : 3 * self.kernel.robot.n]
        single = out.ndim == len(self.kernel.shape)
        return out.reshape(-1) if single else out.reshape(len(out), -1)


def make(method: str, dtype: str, robot: Robot) -> Ours:
    """Compile a method for a robot; LeftOutError beyond the method's limit of joints."""
    largest, reason = METHODS[method]
    if robot.n > largest:
        raise LeftOutError(f'not measured beyond {largest} joints: {reason}')
    return Ours(compile_kernel(robot, method=method, dtype=dtype), f'{method} {dtype}')


def make_quantity(quantity: str, dtype: str, refine: int, robot: Robot) -> Ours:
    """Compile the kernel of a quantity; LeftOutError beyond its limit of joints."""
    most = QUANTITIES[quantity].most
    if robot.n > most:
        raise LeftOutError(f'not measured beyond {most} joints')
    name = f'pfd {dtype}{" refined" * (refine > 0)}'
    if quantity != 'linear_step':
        kernel = compile_kernel(robot, quantity=quantity, dtype=dtype, refine=refine)
        return Ours(kernel, name, quantity)
    simulator = _runge_kutta(robot, LINEAR_STEP, dtype=dtype, refine=refine)
    return Ours(LinearStep(simulator).kernel, name, quantity, simulator)


def _runge_kutta(robot: Robot, step: float, **settings: Any) -> Simulator:
    return Simulator(robot, step_size=step, substeps=1, integrator='rk4', **settings)
