# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of real nodes of the first edition verify to the last bit.

They guard equal bits over versions of the code, of NumPy and LLVM, and over processors; their
states are the ones that the first edition recorded (see make_golden.py).
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from bridge import ARM_ROLES, RecordedLog, summarize_log, verify_log
import make_golden
import pytest

DATA = Path(__file__).resolve().parents[1] / 'data'
LOGS = sorted(DATA.glob('*.mcap'))
INPUTS = {role for role, row in ARM_ROLES.items() if row.kind == 'input'}


@pytest.mark.parametrize('path', LOGS, ids=lambda path: path.stem)
def test_a_recording_of_the_past_has_the_same_bits(path: Path) -> None:
    found = verify_log(path)
    assert found.complete
    # A real run, long enough for a difference to grow.
    assert found.compared['joint_states'] > 200


def test_the_recordings_have_several_arms_all_inputs_and_every_reason_to_refuse_one() -> None:
    assert len(LOGS) == 5
    found = [summarize_log(path) for path in LOGS]
    assert len({summary.log.settings.robot for summary in found}) >= 3
    counts = sum((summary.counts for summary in found), Counter())
    # An arm that follows no clock takes no ticks.
    assert counts.keys() & INPUTS == INPUTS - {'clock_ticks'}
    rules = {kind.split()[1] for summary in found for kind in summary.rejected}
    assert rules == {
        *('malformed', 'no_names', 'ragged', 'infinite', 'stale', 'duplicate_names'),
        *('no_effort', 'unknown_names', 'wrong_size', 'not_finite', 'refused'),
    }


def test_a_recording_made_anew_has_the_same_outputs(tmp_path: Path) -> None:
    source, target = DATA / 'golden_3_ur5.mcap', tmp_path / 'new.mcap'
    make_golden.main(source, target)
    assert [*RecordedLog(target).messages()] == [*RecordedLog(source).messages()]
    assert verify_log(target) == verify_log(source)
