# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node says that it compiles at a first start, before and after, and nothing when warm."""

from __future__ import annotations

from pathlib import Path
import re

from plant_messages import made
import pytest

from pfd_ros.node.compile_report import compile_report


def test_a_first_start_logs_that_it_compiles_and_a_warm_start_does_not(
    folder: Path, emitted: list[str]
) -> None:
    lines: list[tuple[int, str]] = []
    for _ in range(2):
        with compile_report(lambda line: lines.append((len(emitted), line)), 'planar2'):
            made()
    (before, first), (after, last) = lines
    assert before == 0
    assert first == "Compiling native code for 'planar2' (first start; cached afterwards)"
    assert after == len(emitted) > 0
    assert re.fullmatch(r"Compiled native code for 'planar2' in \d+\.\d s", last)


def test_a_start_that_fails_has_no_line_about_its_end(folder: Path) -> None:
    lines: list[str] = []
    with pytest.raises(ValueError, match='payload'), compile_report(lines.append, 'planar2'):
        made(payload_mass=-1.0)
    assert lines == []
