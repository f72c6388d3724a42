# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distributions of errors: their references, checked by other means, the boxes and the page."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import PackageNotFoundError
import json
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray
import pytest

from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.machine.emulator import run
from pfd_core.report.cases.quantities import LINEAR_STEP, STATE
from pfd_core.report.cases.robots import PUBLIC, robot
from pfd_core.report.distribution_pages import CONDITIONS, Findings, markdown, write
from pfd_core.report.measure import distributions
from pfd_core.report.measure.distributions import (
    DEFAULT,
    DERIVATIVES,
    FORWARD,
    PEER,
    REFINED,
    SHARES,
    STEPS,
    Plan,
    drawn,
    matrices,
    measure,
)

DIGITS = 50
SMALL = Plan(('planar2',), {FORWARD: 30, DERIVATIVES: 5, STEPS: 3})


@pytest.fixture(scope='module')
def found() -> Findings:
    boxes, checks = measure(('planar2', SMALL))
    return Findings(boxes, checks)


def states_of(name: str) -> tuple[Any, list[NDArray[Any]]]:
    some = drawn(robot(name), 1)
    with mpmath.workdps(DIGITS):
        number = np.vectorize(mpmath.mpf, otypes=[object])
        return some, [number(some.states[key]) for key in STATE]


def central(function: Any, given: list[NDArray[Any]]) -> NDArray[Any]:
    """Return the Jacobian of a function of the arguments by differences, exact to 20 digits."""
    h = mpmath.mpf(10) ** -12
    columns = []
    for k, values in enumerate(given):
        for j in range(values.shape[-1]):
            ends = []
            for sign in (1, -1):
                moved = [x.copy() for x in given]
                moved[k][..., j] = moved[k][..., j] + sign * h
                ends.append(function(*moved))
            columns.append((ends[0] - ends[1]) / (2 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize('quantity', [DERIVATIVES, STEPS])
def test_the_reference_of_a_matrix_is_the_difference_quotient_in_50_digits(quantity: str) -> None:
    some, given = states_of('planar2')
    program = record_forward_dynamics(some.plant, 'articulated_body', 'parallel')

    def qdd(*state: NDArray[Any]) -> NDArray[Any]:
        result = run(program, dict(zip(STATE, state, strict=True)), digits=DIGITS)['qdd']
        return np.asarray(result)

    def step(q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any]) -> NDArray[Any]:
        h = mpmath.mpf(LINEAR_STEP)
        slopes = [(qd, qdd(q, qd, tau))]
        for part in (0.5, 0.5, 1.0):
            v, a = slopes[-1]
            slopes.append((qd + part * h * a, qdd(q + part * h * v, qd + part * h * a, tau)))
        ends = [
            x + h / 6 * (s[0] + 2 * s[1] + 2 * s[2] + s[3])
            for x, s in zip((q, qd), zip(*slopes, strict=True), strict=True)
        ]
        return np.concatenate(ends, axis=-1)

    with mpmath.workdps(DIGITS):
        wanted = central(qdd if quantity == DERIVATIVES else step, given).reshape(1, -1)
        exact = matrices(quantity, some.plant, some.states, DIGITS)
        assert float(np.abs(exact - wanted).max() / np.abs(wanted).max()) < 1e-18
    wide = matrices(quantity, some.plant, some.states, None)
    off = np.abs(wide.astype(float) - wanted.astype(float)).max() / np.abs(wanted).max()
    assert float(off) < 2.0**-51


def test_the_reference_is_far_more_accurate_than_what_is_compared_with_it(found: Findings) -> None:
    assert [check.quantity for check in found.checks] == [FORWARD, DERIVATIVES, STEPS]
    assert all(0 < check.distance < 0.1 for check in found.checks)


def test_every_way_and_condition_number_has_a_box(found: Findings) -> None:
    boxes = {(box.quantity, box.way, box.dtype): box for box in found.boxes}
    ways = {(way, dtype) for way in (DEFAULT, REFINED) for dtype in ('float64', 'float32')}
    ways |= {(PEER, 'float64'), *((way, 'float64') for way in CONDITIONS)}
    assert {(way, dtype) for quantity, way, dtype in boxes if quantity == FORWARD} == ways
    for box in found.boxes:
        assert len(box.shares) == len(SHARES)
        assert list(box.shares) == sorted(box.shares)
        assert box.largest is not None
        assert box.largest >= box.shares[-1]
    # No matrix is better conditioned than the identity.
    assert boxes[FORWARD, 'kappa_J', 'float64'].shares[0] >= 1
    # float64 and float32 err by about as many units of rounding.
    pair = [boxes[FORWARD, REFINED, dtype].shares[2] for dtype in ('float64', 'float32')]
    assert 0.2 < pair[0] / pair[1] < 5


def test_the_states_of_a_block_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = drawn(robot('planar2'), 7)
    monkeypatch.setattr(distributions, 'BLOCK', 3)
    blocks = list(distributions._blocks(whole))
    for name, values in whole.states.items():
        np.testing.assert_array_equal(np.concatenate([b.states[name] for b in blocks]), values)


def test_the_page_has_tables_and_says_where_an_answer_is_lost(
    found: Findings, tmp_path: Path
) -> None:
    text = markdown(found)
    assert '| planar2 | default | float64 | 30 |' in text
    assert 'Answers that are not finite' not in text
    lost = [replace(found.boxes[2], largest=None), *found.boxes[3:]]
    assert 'Answers that are not finite: forward_dynamics.' in markdown(replace(found, boxes=lost))
    paths = write(found, tmp_path)
    assert [path.name for path in paths] == [
        f'distributions.{kind}' for kind in ('md', 'json', 'png', 'svg')
    ]
    assert len(json.loads(paths[1].read_text())['boxes']) == len(found.boxes)


def test_public_arms_are_found_or_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert {name: robot(name).n for name in PUBLIC} == {
        **dict.fromkeys(('ur3', 'ur10', 'kinova', 'so101'), 6),
        **dict.fromkeys(('talos_left_arm', 'xarm7', 'z1'), 7),
    }

    def not_installed(package: str) -> None:
        raise PackageNotFoundError(package)

    monkeypatch.setattr('pfd_core.report.cases.robots.files', not_installed)
    with pytest.raises(ValueError, match='example-robot-data, which is not installed'):
        robot('ur10')
