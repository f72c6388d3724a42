# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The kernels of this package as peers: methods, quantities and number formats."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases.problems import FORWARD, STATE
from benchmarks.peers.work import Arguments, Peer, Side, is_batch
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model.robot import Robot

CODE = 'native code for this robot and processor'


def ours(
    robot: Robot,
    quantity: str = FORWARD,
    method: str = 'auto',
    dtype: str = 'float64',
) -> Peer:
    """
    Return the kernel of one quantity of a robot as a peer.

    The ways are a call with arguments checked, and bound before; and batches in Fortran and C
    order.
    """
    kernel = compile_kernel(robot, method=method, dtype=dtype, quantity=quantity)
    name = f'{"pfd" if method == "auto" else method} {dtype}'
    numbers = f'{dtype}, own sine and cosine: 1.5 ulp, any angle'

    def calls(given: Arguments) -> Iterator[Side]:
        arrays = (np.array(x, dtype) for x in given)
        values: dict[str, Any] = dict(zip(STATE, arrays, strict=False))
        call = partial(kernel, *values.values())
        target = call()
        checked = f'{CODE}; called from Python, arguments checked; {numbers}'
        bound = f'{CODE}; called from Python, arguments checked before; {numbers}'
        # Python's share of a call does not depend on the number format.
        if dtype == 'float64':
            yield Side(f'{name}: kernel(q, qd, tau)', call, lambda: call().ravel(), checked)
        run = kernel.bind(**values, out=target)
        yield Side(f'{name}: bound', run, target.ravel, bound)

    def batches(given: Arguments) -> Iterator[Side]:
        contents = f'{CODE}, a vector of states at a time; called once from Python; {numbers}'
        for order in ('F', 'C'):
            arrays = (np.array(x, dtype, order=order) for x in given)
            values: dict[str, Any] = dict(zip(STATE, arrays, strict=False))
            out = kernel(**values)
            run = partial(kernel, **values, out=out)
            result = partial(out.reshape, len(out), -1)
            yield Side(f'{name}, {order} order', run, result, contents)

    return lambda given: batches(given) if is_batch(given) else calls(given)
