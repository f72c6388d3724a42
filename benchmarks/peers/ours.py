# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The kernels of this package as peers: methods, quantities and number formats."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.quantities import FORWARD, STATE
from benchmarks.peers.work import STEP_SIZE, LeftOutError, Side, Work
from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.kernel import Kernel
from pfd_core.model import Robot
from pfd_core.simulation.simulator import Simulator

# Most joints that are measured.
MOST = {'composite_body': 30}
THREADS = 2
# Smallest batch that is measured with a second thread.
SHARED_FROM = 4096
CODE = 'native code for this robot and processor'


class Ours:
    """
    The kernel of one quantity of a robot, in one number format.

    The ways are a call with arguments checked, with `out=`, and bound before; a rollout of the
    simulator; and batches in Fortran and C order. LeftOutError beyond MOST joints.
    """

    def __init__(self, robot: Robot, method: str, dtype: str, quantity: str = FORWARD) -> None:
        most = MOST.get(method, robot.n)
        if robot.n > most:
            raise LeftOutError(f'not measured beyond {most} joints: it takes long to compile')
        self.kernel = compile_kernel(robot, method=method, dtype=dtype, quantity=quantity)
        self.name = f'{"pfd" if method == "auto" else method} {dtype}'
        self.numbers = f'{dtype}, own sine and cosine: 1.5 ulp, any angle'

    def sides(self, work: Work) -> Iterator[Side]:
        """Yield the ways of a work."""
        ways = {'call': self._calls, 'batch': self._batches, 'rollout': self._rollouts}
        return ways[work.kind](work)

    def _calls(self, work: Work) -> Iterator[Side]:
        given = arguments(self.kernel, work)
        call = partial(self.kernel, *given.values())
        out, target = call(), call()
        checked = f'{CODE}; called from Python, arguments checked; {self.numbers}'
        bound = f'{CODE}; called from Python, arguments checked before; {self.numbers}'
        # Python's share of a call does not depend on the number format.
        if self.kernel.dtype == 'float64':
            plain, into = f'{self.name}: kernel(q, qd, tau)', f'{self.name}: kernel(..., out=)'
            yield Side(plain, call, lambda: call().ravel(), checked)
            yield Side(into, partial(call, out=out), out.ravel, checked)
        run = self.kernel.bind(**given, out=target)
        yield Side(f'{self.name}: bound', run, target.ravel, bound)

    def _batches(self, work: Work) -> Iterator[Side]:
        contents = f'{CODE}, a vector of states at a time; called once from Python; {self.numbers}'
        for order in 'FC':
            given = arguments(self.kernel, work, order)
            out = self.kernel(**given)
            run, result = partial(self.kernel, **given, out=out), partial(_rows, out)
            name = f'{self.name}, {order} order'
            yield Side(name, run, result, contents)
            if order == 'F' and work.units >= SHARED_FROM and self.kernel.dtype == 'float64':
                shared = partial(run, threads=THREADS)
                yield Side(f'{name}, {THREADS} threads', shared, result, contents)

    def _rollouts(self, work: Work) -> Iterator[Side]:
        kernel, (q, qd, tau) = self.kernel, work.arrays
        simulator = Simulator(
            kernel.robot,
            step_size=STEP_SIZE,
            substeps=1,
            integrator='rk4',
            method=kernel.method,
            dtype=kernel.dtype,
        )
        taus = np.tile(tau, (work.steps, 1)).astype(kernel.dtype)

        def run() -> None:
            simulator.reset(q, qd)
            simulator.rollout(taus)

        contents = f'{CODE}; called once from Python, loop in native code; {self.numbers}'
        yield Side(self.name, run, lambda: simulator.q, contents)


def arguments(kernel: Kernel, work: Work, order: Any = 'C') -> dict[str, Any]:
    """Return the arguments of a work for a kernel, copied in its number format and an order."""
    given = (np.array(x, kernel.dtype, order=order) for x in work.arrays)
    return dict(zip(STATE, given, strict=False))


def _rows(out: NDArray[Any]) -> NDArray[Any]:
    """Return the results of a batch, (B, size)."""
    return out.reshape(len(out), -1)
