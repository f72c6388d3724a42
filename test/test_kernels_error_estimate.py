# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The error estimate of a refined kernel against the error by 50 digits, over random states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from refined_answers import PAYLOAD, ROUNDING, reference, relative_error, rods
from zoo import random_chain

import pfd_core as pfd
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.machine.emulator import run
from pfd_core.model import resolve
from pfd_core.report.error_estimates import record_with_first_answer

Arm = tuple[pfd.Robot, pfd.Scene | None]
ARMS: dict[str, Callable[[], Arm]] = {
    'ur5': lambda: (pfd.load_robot('ur5'), None),
    'panda': lambda: (pfd.load_robot('panda'), None),
    'panda_payload_1e6': lambda: (pfd.load_robot('panda'), pfd.Scene(payload=PAYLOAD)),
    'chain_12': lambda: (random_chain(np.random.default_rng(12), 12, 0.0), None),
    'rods_12': lambda: (rods(12), None),
    'heavy_tip_1e8': lambda: (rods(6, 1e8), None),
}
# Arms of which composite bodies are further off than SHOWN in some of the states.
HARD = ('rods_12', 'heavy_tip_1e8')
# The method whose 50 digits are the reference: never the one that is judged.
OTHER = {'composite_body': 'articulated_body', 'articulated_body': 'pcrbm'}

# Largest ratio of estimate and error, either way, where the error is above SHOWN: the same number
# of units of rounding in both formats.
FACTOR = 3.0
SHOWN = {dtype: 1e-13 * unit / ROUNDING['float64'] for dtype, unit in ROUNDING.items()}
# An answer without a digit, which occurs in float32: its estimate may be infinite.
LOST = 0.1


def assert_estimates(arm: str, method: str, dtype: str, count: int) -> None:
    """Compare estimates with errors in `count` random states."""
    robot, scene = ARMS[arm]()
    plant = resolve(robot, scene)
    rng = np.random.default_rng(500)
    # Numbers of the format, so that all answers are for the same ones.
    state = {
        key: rng.uniform(-size, size, (count, robot.n)).astype(dtype)
        for key, size in (('q', np.pi), ('qd', 1.0), ('tau', 1.0))
    }
    kernel = pfd.compile_kernel(robot, scene=scene, method=method, dtype=dtype, refine=1)
    qdd, estimates = kernel.error_estimate(*state.values())
    # The answer before the step. That of a kernel without refinement differs in its last bits,
    # for other products are fused there, and so by a multiple in its error.
    emulated = run(
        lower(record_with_first_answer(plant, method, dtype), dtype).compiled, state, dtype
    )
    np.testing.assert_array_equal(emulated['qdd'], qdd)
    np.testing.assert_array_equal(emulated['error'][:, 0], estimates)
    exact = {key: x.astype('float64') for key, x in state.items()}
    errors = relative_error(emulated['before'], reference(plant, exact, OTHER[method]))
    assert dtype == 'float32' or (errors < LOST).all()
    shown = (errors > SHOWN[dtype]) & (errors < LOST)
    if method == 'composite_body' and arm in HARD:
        assert shown.any()
    ratio = estimates[shown].astype(np.float64) / errors[shown]
    assert (ratio <= FACTOR).all(), (errors[shown], estimates[shown])
    assert (ratio >= 1 / FACTOR).all(), (errors[shown], estimates[shown])
    # Good answers raise no alarm, and lost ones do.
    assert (estimates[errors <= SHOWN[dtype]] <= FACTOR * SHOWN[dtype]).all()
    assert (estimates[errors >= LOST] >= LOST / FACTOR).all()


@pytest.mark.parametrize('arm', ARMS)
@pytest.mark.slow
def test_the_estimate_is_within_a_factor_of_three_of_the_error(arm: str) -> None:
    assert_estimates(arm, 'composite_body', 'float64', 8)


# In float32 the heavy tip has no answer: its condition number times the rounding is above one.
ALL = [
    (arm, method, dtype)
    for arm in ARMS
    for method in OTHER
    for dtype in ROUNDING
    if (arm, dtype) != ('heavy_tip_1e8', 'float32')
]


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(('arm', 'method', 'dtype'), ALL)
def test_the_estimate_is_within_a_factor_of_three_in_500_states(
    arm: str, method: str, dtype: str
) -> None:
    assert_estimates(arm, method, dtype, 500)


# The correction is solved for with the digits of the number format, from a residual with nearly
# twice as many. Seen from 0.994 to 1.004.
CLOSE = 1.05
INCLUDED = ('ur5', 'panda', 'puma560')
# Shares by which tau is off the bias: 10^-k with k below this.
SHARES = {'float64': 15, 'float32': 7}


def assert_close_estimates(arm: str, method: str, dtype: str, count: int) -> None:
    """Compare estimates with all errors, where tau is close to the bias and where it is not."""
    robot = pfd.load_robot(arm)
    rng = np.random.default_rng(501)
    q, qd, tau = (rng.uniform(-s, s, (count, robot.n)) for s in (np.pi, 1.0, 1.0))
    bias = pfd.compile_kernel(robot, quantity='bias_torques')(q, qd)
    share = 10.0 ** -rng.integers(1, SHARES[dtype], (count, 1))
    tau = np.concatenate([tau, bias * (1.0 + share)])
    both = (np.tile(q, (2, 1)), np.tile(qd, (2, 1)), tau)
    state = dict(zip(('q', 'qd', 'tau'), (x.astype(dtype) for x in both), strict=True))
    plant = resolve(robot)
    program = lower(record_with_first_answer(plant, method, dtype), dtype).compiled
    found = run(program, state, dtype)
    exact = {key: x.astype('float64') for key, x in state.items()}
    errors = relative_error(found['before'], reference(plant, exact, OTHER[method]))
    ratio = found['error'][:, 0].astype(np.float64) / errors
    assert (ratio <= CLOSE).all(), (errors, ratio)
    assert (ratio >= 1 / CLOSE).all(), (errors, ratio)


@pytest.mark.parametrize('dtype', ROUNDING)
@pytest.mark.parametrize('arm', INCLUDED)
@pytest.mark.slow
def test_the_estimate_is_close_to_the_error_near_equilibrium_and_elsewhere(
    arm: str, dtype: str
) -> None:
    assert_close_estimates(arm, 'composite_body', dtype, 8)


@pytest.mark.parametrize('method', OTHER)
@pytest.mark.parametrize('dtype', ROUNDING)
@pytest.mark.parametrize('arm', INCLUDED)
@pytest.mark.slow
@pytest.mark.long
def test_the_estimate_is_close_to_the_error_in_200_states(
    arm: str, dtype: str, method: str
) -> None:
    assert_close_estimates(arm, method, dtype, 200)


@pytest.mark.parametrize('dtype', ROUNDING)
@pytest.mark.slow
def test_the_kernel_of_the_estimate_gives_the_bits_of_a_call(dtype: str) -> None:
    rng = np.random.default_rng(8)
    for robot in (pfd.load_robot('planar2'), random_chain(rng, 3, 0.5)):
        for refine in (1, 2):
            kernel = pfd.compile_kernel(robot, dtype=dtype, refine=refine)
            q, qd, tau = rng.uniform(-3, 3, (3, 20, robot.n)).astype(dtype)
            qdd, _ = kernel.error_estimate(q, qd, tau)
            np.testing.assert_array_equal(qdd, kernel(q, qd, tau))
