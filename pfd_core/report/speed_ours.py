# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The kernels of this package as contenders: every method and precision."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.kernel import Kernel
from pfd_core.model import Robot
from pfd_core.report.timing import STEP_SIZE, LeftOutError, Side, Work
from pfd_core.simulation.simulator import Simulator

# Method to the largest number of joints that is measured, and the reason for the limit.
GROWTH = 'its straight-line code takes long to compile'
METHODS = {
    'composite_body': (30, GROWTH),
    'grouped_articulated_body': (200, GROWTH),
    'articulated_body': (12, 'grouped_articulated_body is the same in fewer operations'),
    'pcrbm': (12, GROWTH),
}
DTYPES = ('float64', 'float32')
THREADS = 2
# Smallest batch that is measured with a second thread.
SHARED_FROM = 4096


@dataclass(frozen=True)
class Ours:
    """The kernels of one robot, by one method in one precision."""

    kernel: Kernel
    simulators: list[Simulator]
    name: str

    def sides(self, work: Work) -> Iterator[Side]:
        """Return the ways in which users call a kernel."""
        return {'call': self._calls, 'rollout': self._rollouts, 'batch': self._batches}[work.kind](
            work
        )

    def _calls(self, work: Work) -> Iterator[Side]:
        q, qd, tau = (x.astype(self.kernel.dtype) for x in work.arrays)
        out, target = np.empty_like(q), np.empty_like(q)
        # Python's share of a call does not depend on the number format.
        if self.kernel.dtype == 'float64':
            call = partial(self.kernel, q, qd, tau)
            yield Side(f'{self.name}: kernel(q, qd, tau)', call, call)
            run = partial(self.kernel, q, qd, tau, out=target)
            yield Side(f'{self.name}: kernel(..., out=)', run, lambda: target)
        yield Side(f'{self.name}: bound', self.kernel.bind(q, qd, tau, out), lambda: out)

    def _batches(self, work: Work) -> Iterator[Side]:
        for order, laid in (('F', np.asfortranarray), ('C', np.ascontiguousarray)):
            q, qd, tau = (laid(x).astype(self.kernel.dtype) for x in work.arrays)
            out = np.empty_like(q)
            run = partial(self.kernel, q, qd, tau, out=out)
            # `out` would be the last one by the time of the call.
            yield Side(f'{self.name}, {order} order', run, partial(np.asarray, out))
            if order == 'F' and self.kernel.dtype == 'float64' and work.units >= SHARED_FROM:
                shared = partial(run, threads=THREADS)
                name = f'{self.name}, {order} order, {THREADS} threads'
                yield Side(name, shared, partial(np.asarray, out))

    def _rollouts(self, work: Work) -> Iterator[Side]:
        if not self.simulators:
            self.simulators.append(
                Simulator(
                    self.kernel.robot,
                    step_size=STEP_SIZE,
                    substeps=1,
                    integrator='rk4',
                    method=self.kernel.method,
                    dtype=self.kernel.dtype,
                )
            )
        (sim,) = self.simulators
        taus = np.tile(work.tau, (work.steps, 1)).astype(self.kernel.dtype)

        def run() -> None:
            sim.reset(work.q, work.qd)
            sim.rollout(taus)

        yield Side(self.name, run, lambda: sim.q)


def make(method: str, dtype: str, robot: Robot) -> Ours:
    """Compile a method for a robot; LeftOutError beyond the method's limit of joints."""
    largest, reason = METHODS[method]
    if robot.n > largest:
        raise LeftOutError(f'not measured beyond {largest} joints: {reason}')
    return Ours(compile_kernel(robot, method=method, dtype=dtype), [], f'{method} {dtype}')
