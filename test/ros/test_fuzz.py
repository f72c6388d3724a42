# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A short run of the fuzz; `python test/ros/fuzz.py --seconds 600` is a long one."""

from __future__ import annotations

import itertools

import fuzz
from hostile_traffic import SMALL_BYTES, Messages
import pytest
from ros_processes import Processes

from pfd_ros.arm.events import Verdict

SECONDS = 6.0


def test_the_same_seed_gives_the_same_messages() -> None:
    runs = [list(itertools.islice(Messages(seed), 200)) for seed in (3, 3, 4)]
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize('largest', [SMALL_BYTES, 1 << 24])
def test_hostile_messages_leave_a_node_alive_small_and_verifiable(
    processes: Processes, largest: int
) -> None:
    fuzz.check(fuzz.fuzz(processes, SECONDS, seed=1, largest=largest), SECONDS)


@pytest.mark.ros
@pytest.mark.slow
def test_hostile_ticks_of_a_followed_clock_do_no_harm_either(processes: Processes) -> None:
    outcome = fuzz.fuzz(processes, SECONDS, seed=1, follow_clock=True)
    fuzz.check(outcome, SECONDS)
    assert outcome.summary.verdicts[Verdict.STALE]
