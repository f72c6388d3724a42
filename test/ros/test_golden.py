# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of past versions verify to the last bit.

They are the only guard of equal bits over versions of the code, of NumPy and LLVM, and over
processors.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pfd_ros.arm.events import Verdict
from pfd_ros.replay.verify import read

DATA = Path(__file__).resolve().parents[1] / 'data'
GOLDEN = sorted(DATA.glob('golden_*.mcap'))


@pytest.mark.parametrize('path', GOLDEN, ids=lambda path: path.stem)
def test_a_recording_of_a_past_version_has_the_same_bits(path: Path) -> None:
    summary = read(path, verify=True)
    assert summary.complete
    assert summary.missing == 0
    # One real run with every verdict of its time, long enough for a difference to grow.
    assert summary.states > 200
    assert {Verdict(number) for number in range(12)} <= set(summary.verdicts)


def test_golden_recordings_of_two_arms_are_there() -> None:
    assert len({read(path).settings.robot for path in GOLDEN}) >= 2
