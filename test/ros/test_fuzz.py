# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A short run of the fuzz; `python test/ros/fuzz.py --seconds 600` is a long one."""

from __future__ import annotations

import contextlib
import itertools
import random

from bridge import ClockTick, Verdict, decode_clock, validate_tick
import fuzz
from hostile_traffic import MILLISECOND, REJECTIONS, SMALL_BYTES, Messages, Ticks
import pytest
from ros_processes import Processes

SECONDS = 2.5


def test_the_same_seed_gives_the_same_messages() -> None:
    runs = [list(itertools.islice(Messages(seed), 200)) for seed in (3, 3, 4)]
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize('seed', [1, 2, 3, 16777216])
def test_each_reason_for_a_rejection_has_a_message(seed: int) -> None:
    found = [verdict for verdict, _, _ in Messages(seed, 1 << 24).of_each_verdict()]
    assert sorted(found) == sorted(REJECTIONS)


def test_an_arm_that_refused_a_tick_follows_later_ones() -> None:
    ticks, until = Ticks(random.Random(2)), 0
    refused, since = 0, 0
    for _ in range(5000):
        reached = until
        tick = ticks.after(reached)
        with contextlib.suppress(ValueError):
            validation = validate_tick(decode_clock(tick), reached, until, MILLISECOND)
            refused += validation.verdict is Verdict.REFUSED
            if isinstance(validation.effect, ClockTick):
                until = validation.effect.stamp_ns
        since = 0 if until > reached else since + 1
        # Of a hundred ticks sixty fit.
        assert since < 100
    assert refused > 5


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize('largest', [SMALL_BYTES, pytest.param(1 << 24, marks=pytest.mark.long)])
def test_hostile_messages_leave_a_node_alive_small_and_verifiable(
    processes: Processes, largest: int
) -> None:
    fuzz.check(fuzz.fuzz(processes, SECONDS, seed=1, largest=largest), SECONDS)


@pytest.mark.ros
@pytest.mark.slow
def test_hostile_ticks_of_a_followed_clock_do_no_harm_either(processes: Processes) -> None:
    fuzz.check(fuzz.fuzz(processes, SECONDS, seed=1, follow_clock=True), SECONDS)
