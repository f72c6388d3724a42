# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The step timer, on a clock that the test moves."""

from __future__ import annotations

from pfd_ros.node.step_timer import CATCH_UP_NS, LONGEST_SLEEP_NS, StepTimer

MILLISECOND = 1_000_000


class Time:
    """A clock that only sleeping and working move."""

    def __init__(self) -> None:
        self.now = 123
        self.sleeps: list[float] = []

    def clock(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.sleeps.append(seconds)
        self.now += round(seconds * 1e9)


def timer(time: Time, period_ns: float = MILLISECOND) -> StepTimer:
    made = StepTimer(period_ns, time.clock, time.sleep)
    made.start()
    return made


def test_steps_are_due_at_whole_periods_however_long_they_take() -> None:
    time = Time()
    timed = timer(time)
    for k in range(1, 100):
        timed.wait()
        assert time.now == 123 + k * MILLISECOND
        time.now += (k % 10) * MILLISECOND // 10
    assert (timed.late, timed.missed) == (0, 0)


def test_a_short_delay_is_made_up_for() -> None:
    time = Time()
    timed = timer(time)
    time.now += 10 * MILLISECOND
    for _ in range(20):
        timed.wait()
    assert time.now == 123 + 20 * MILLISECOND
    assert (timed.late, timed.missed) == (8, 0)


def test_a_long_stall_is_counted_and_not_rushed_through() -> None:
    time = Time()
    timed = timer(time)
    time.now += CATCH_UP_NS + 10 * MILLISECOND
    stalled = time.now
    timed.wait()
    assert (timed.late, timed.missed) == (1, 59)
    timed.wait()
    assert time.now == stalled + MILLISECOND


def test_a_long_sleep_is_split_so_that_a_slow_arm_receives_and_stops_promptly() -> None:
    time = Time()
    timed = timer(time, 1000 * MILLISECOND)
    looks = 0
    while not timed.wait():
        looks += 1
        assert time.sleeps[-1] == LONGEST_SLEEP_NS / 1e9
    assert looks == 1000 * MILLISECOND // LONGEST_SLEEP_NS - 1
    assert time.now == 123 + 1000 * MILLISECOND


def test_another_period_counts_from_its_change_on() -> None:
    time = Time()
    timed = timer(time)
    for _ in range(10):
        timed.wait()
    time.now += MILLISECOND // 2
    timed.set_period(4 * MILLISECOND)
    for _ in range(3):
        timed.wait()
    assert time.now == 123 + 10 * MILLISECOND + MILLISECOND // 2 + 12 * MILLISECOND
    timed.set_period(4 * MILLISECOND)
    timed.wait()
    assert time.now == 123 + 26 * MILLISECOND + MILLISECOND // 2
    assert (timed.late, timed.missed) == (0, 0)
