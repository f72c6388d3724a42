# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of past versions verify to the last bit.

They are the only guard of equal bits over versions of the code, of NumPy and LLVM, and over
processors.
"""

from __future__ import annotations

from pathlib import Path

from bridge import Source, Verdict, read_recording
import pytest
from simulating import rows_of

DATA = Path(__file__).resolve().parents[1] / 'data'
GOLDEN = sorted(DATA.glob('golden_*.mcap'))


@pytest.mark.parametrize('path', GOLDEN, ids=lambda path: path.stem)
def test_a_recording_of_a_past_version_has_the_same_bits(path: Path) -> None:
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert summary.missing == 0
    # A real run, long enough for a difference to grow.
    assert summary.states > 200


def test_golden_recordings_have_two_arms_every_verdict_and_every_input() -> None:
    found = [read_recording(path) for path in GOLDEN]
    assert len({summary.settings.robot for summary in found}) >= 2
    verdicts = {verdict for summary in found for verdict in summary.verdicts}
    assert {Verdict(number) for number in range(12)} <= verdicts
    sources = {row.source for path in GOLDEN for row in rows_of(path)}
    # An arm that follows no clock takes no ticks.
    assert sources == set(Source) - {Source.TICK}
