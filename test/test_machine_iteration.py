# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The repeated part of a program: on the emulator, lowered, and in native code."""

from __future__ import annotations

from bridge import (
    MACHINE_SCHEDULES,
    Lanes,
    Recorder,
    iterate,
    on_lane,
    pattern_total,
    run_program,
)
import numpy as np
import pytest

import pfd_core as pfd

AT_MOST = 12


def roots(n: int, schedule: str, at_most: int = AT_MOST) -> pfd.Program:
    """
    Record square roots by Newton's iteration x <- (x + q / x) / 2 on every lane.

    It goes on while the largest change on lane 0, the sum of squares, is above 1e-20.
    """
    recorder = Recorder(n, schedule)
    q = recorder.input('q', range(n))

    def step(x: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        following = 0.5 * (x + q / x)
        change = following - x
        return (following,), pattern_total(change * change) - 1e-20

    (x,), iterations = iterate(step, (q,), on_lane(q, [0]), at_most)
    # What follows a loop may use what was computed before and inside it.
    y = x + recorder.constant(0.0) * q
    recorder.output('y', (n + 1,), [*((y, lane) for lane in range(n)), (iterations, 0)])
    return recorder.program()


def newton(q: np.ndarray, at_most: int = AT_MOST) -> tuple[np.ndarray, int]:
    """Return the same by a plain loop."""
    x = q.copy()
    for iterations in range(1, at_most + 1):
        x, before = 0.5 * (x + q / x), x
        if ((x - before) ** 2).sum() <= 1e-20:
            return x, iterations
    return x, at_most


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_a_loop_ends_when_its_number_falls_to_zero(schedule: str) -> None:
    q = np.array([2.0, 9.0, 1e4, 0.5])
    y = run_program(roots(4, schedule), {'q': q})['y']
    x, iterations = newton(q)
    np.testing.assert_allclose(y[:4], np.sqrt(q), rtol=1e-15)
    np.testing.assert_allclose(y[:4], x, rtol=1e-15)
    assert y[4] == iterations


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_a_loop_ends_at_its_limit(schedule: str) -> None:
    q = np.array([1e8])
    y = run_program(roots(1, schedule, at_most=3), {'q': q})['y']
    np.testing.assert_array_equal(y, [newton(q, 3)[0][0], 3])


def test_a_finished_problem_keeps_its_bits_while_others_continue() -> None:
    q = np.array([[4.0], [1e6], [2.0], [1e-6], [-1.0]])
    together = run_program(roots(1, 'sequential'), {'q': q})['y']
    for row, alone in zip(together, q, strict=True):
        np.testing.assert_array_equal(row, run_program(roots(1, 'sequential'), {'q': alone})['y'])
    assert len(set(together[:4, 1])) > 1
    # Nothing to do: not one iteration is taken over.
    np.testing.assert_array_equal(together[4], [-1.0, 0.0])


def test_counts_follow_the_iterations() -> None:
    program = roots(4, 'parallel')
    one, five = program.count(), program.count(iterations=5)
    assert (one.divisions, five.divisions) == (1, 5)
    # In an iteration: sum, change, its two levels of a total, minus the tolerance; one after it.
    assert (one.additions, five.additions) == (5 + 1, 25 + 1)


def test_printing_shows_the_markers() -> None:
    text = str(roots(1, 'parallel'))
    for word in ('loop', 'state', 'end', 'result'):
        assert f'= {word} ' in text


@pytest.mark.parametrize(
    ('act', 'message'),
    [
        (lambda r, q: iterate(lambda x: ((x,), x), (q,), q, 0), 'at_most must be at least 1'),
        (
            lambda r, q: iterate(lambda x: ((x,), x), (q,), on_lane(q, [1]), 1),
            'no value on lane 0',
        ),
        (
            lambda r, q: iterate(lambda x: ((on_lane(x, [1]),), x), (q,), q, 1),
            'row 0 .* lacks lanes',
        ),
    ],
)
def test_a_loop_that_cannot_run_is_refused(act, message: str) -> None:  # type: ignore[no-untyped-def]
    recorder = Recorder(2)
    with pytest.raises(ValueError, match=message):
        act(recorder, recorder.input('q', [0, 1]))


def test_an_observer_sees_the_state_before_the_loop_and_after_each_iteration() -> None:
    q = np.array([[2.0, 9.0], [1.0, 1.0]])
    seen: list[np.ndarray] = []
    result = run_program(
        roots(2, 'parallel'), {'q': q}, observe=lambda rows: seen.append(rows[0].T)
    )
    iterations = result['y'][:, -1]
    assert len(seen) == iterations.max() + 1
    np.testing.assert_array_equal(seen[0], q)
    for state, count in enumerate(iterations):
        # A finished problem keeps its state while the other continues.
        np.testing.assert_array_equal(seen[int(count)][state], seen[-1][state])
        x = q[state]
        for row in seen[1 : int(count) + 1]:
            x = 0.5 * (x + q[state] / x)
            np.testing.assert_array_equal(row[state], x)
