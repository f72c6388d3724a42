# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of the array: every cell, every cycle, and text that anyone can read."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from pfd_core.algorithms.paper.array_solver import factor
from pfd_core.algorithms.paper.triangular_array import solve_cycles
from pfd_core.report.counts_pages import solve_picture
from pfd_core.report.render.array_activity import runs_svg

SVG = '{http://www.w3.org/2000/svg}'


@pytest.mark.parametrize('n', [1, 2, 6])
def test_the_picture_shows_every_cell_in_every_cycle(n: int) -> None:
    root = ElementTree.fromstring(solve_picture(n))
    frames = root.findall(f'{SVG}g')
    assert len(frames) == solve_cycles(n)
    assert all(len(frame.findall(f'{SVG}circle')) == n for frame in frames)
    assert all(len(frame.findall(f'{SVG}rect')) == n * (n - 1) // 2 for frame in frames)
    cells = [shape for frame in frames for shape in frame if 'stroke' in shape.attrib]
    acting = [shape for shape in cells if shape.attrib['fill'] != 'none']
    assert len(acting) == n * (n + 1) * (n + 2) // 6 + n * (n + 1)
    assert f'{solve_cycles(n)} cycles' in root.findtext(f'{SVG}title', '')


def test_the_title_of_the_picture_is_quoted() -> None:
    trace = factor(np.eye(2)).trace
    root = ElementTree.fromstring(runs_svg({'': (trace, None)}, 'n < 3 & "more"'))
    assert root.findtext(f'{SVG}title') == 'n < 3 & "more"'
