# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Further rows of the state than q and qd: simulated, copied and stored with it."""

from __future__ import annotations

import pickle
from typing import Any

from bridge import INTEGRATOR_TABLE, IntegratedSystem, Integrator
import numpy as np
import pytest

import pfd_core as pfd

H = 1e-3
PLAIN = {'compensated': False}
TAUS = np.random.default_rng(1).normal(size=(30, 2))


def adams_bashforth(
    system: IntegratedSystem, h: float, q: Any, qd: Any, before: Any
) -> tuple[Any, ...]:
    """Advance by the last two accelerations; the older one is a row of the state."""
    a = system.accelerations(q, qd, 0)
    return system.advance(q, h * qd), qd + h * (1.5 * a - 0.5 * before), a


@pytest.fixture(autouse=True)
def _adams_bashforth(monkeypatch: pytest.MonkeyPatch) -> None:
    method = Integrator(adams_bashforth, ('q', 'qd', 'before'), order=1, evaluations=1)
    monkeypatch.setitem(INTEGRATOR_TABLE, 'adams_bashforth', method)


SETTINGS: dict[str, Any] = {'step_size': H, 'substeps': 1, 'integrator': 'adams_bashforth'} | PLAIN


def expected(q: np.ndarray, qd: np.ndarray, taus: np.ndarray) -> np.ndarray:
    """Return the positions after each step, (steps, 2), by a loop over a kernel."""
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), method='composite_body')
    before, found = np.zeros(2), []
    for tau in taus:
        system = IntegratedSystem(lambda q, qd, at, u=tau: kernel(q, qd, u))  # type: ignore[misc]
        q, qd, before = adams_bashforth(system, H, q, qd, before)
        found.append(q)
    return np.array(found)


def test_a_row_begins_at_zero_and_is_carried_from_step_to_step_and_through_a_pickle() -> None:
    right = expected(np.array([0.1, 0.2]), np.zeros(2), TAUS)
    sim = pfd.Simulator(pfd.load_robot('planar2'), **SETTINGS)
    for _ in range(2):
        sim.reset(q=[0.1, 0.2])
        np.testing.assert_array_equal(sim.rollout(TAUS[:10]).q, right[:10])
        sim = pickle.loads(pickle.dumps(sim))
        for tau, q in zip(TAUS[10:], right[10:], strict=True):
            sim.step(tau)
            np.testing.assert_array_equal(sim.q, q)


def test_arms_of_an_ensemble_have_their_own_rows() -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 5, **SETTINGS)
    starts = np.random.default_rng(2).normal(size=(5, 2))
    many.reset(starts, 0.5)
    first = many.rollout(TAUS[:10])
    rest = pickle.loads(pickle.dumps(many)).rollout(TAUS[10:])
    for k, q in enumerate(starts):
        right = expected(q, np.full(2, 0.5), TAUS)
        np.testing.assert_array_equal(first.q[k], right[:10])
        np.testing.assert_array_equal(rest.q[k], right[10:])
