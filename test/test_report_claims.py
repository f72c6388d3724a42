# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The speeds in README.md and in the guide equal docs/report/speed.json."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import re
from typing import Any

import pytest

from pfd_core.report import speed_pages
from pfd_core.report.measure.speed import Findings
from pfd_core.report.render.records import read

ROOT = Path(__file__).resolve().parent.parent
GUIDE = 'docs/guides/speed-and-accuracy.md'
BATCH, CALL, ROLLOUT = 'batch of 4096', 'call', 'rollout'
# Rows of the guide's table: quantity, work, and how the way of ours ends.
ROWS = {
    'batch of 4096 states, Fortran order': ('forward_dynamics', BATCH, 'float64, F order'),
    'one call from Python through `kernel.bind`': ('forward_dynamics', CALL, 'float64: bound'),
    'a step of a Runge-Kutta rollout': ('forward_dynamics', ROLLOUT, 'float64'),
    'derivatives of qdd by q, qd, tau, the same batch': ('derivatives', BATCH, 'float64, F order'),
    'the same, one bound call': ('derivatives', CALL, 'float64: bound'),
}
PEERS = ('pinocchio', 'Pinocchio', 'Python loop', 'mujoco', 'CasADi')


def rows_of(robot: str, quantity: str, work: str) -> list[dict[str, Any]]:
    found = json.loads((ROOT / 'docs/report/speed.json').read_text(encoding='utf-8'))
    return [
        row
        for row in [*found['rows'], *found['others']]
        if (row['robot'], row['quantity'], row['work']) == (robot, quantity, work)
    ]


def parts(
    robot: str, quantity: str, work: str, ours: str, *kinds: Callable[[str], bool]
) -> list[str]:
    """Return, for each kind of peer, our part of the time of the strongest."""
    rows = rows_of(robot, quantity, work)
    own = [row for row in rows if not row['way'].startswith(PEERS) and row['way'].endswith(ours)]
    fastest = min(own, key=lambda row: row['minimum'])
    printed = []
    for kind in kinds:
        peers = [
            row
            for row in rows
            if row['way'].startswith(PEERS)
            and not row['way'].endswith((' threads', ' refined'))
            and kind(row['way'])
        ]
        strongest = min(peers, key=lambda row: row['minimum'])
        # `times` is the speed as a multiple of Pinocchio's, of rounds that took turns.
        ratio = fastest['times'] / strongest['times']
        printed.append(f'1/{ratio:.0f}' if ratio > 10 else f'1/{ratio:.1f}')
    return printed


def anyone(way: str) -> bool:
    return True


def for_any_robot(way: str) -> bool:
    return not way.startswith('CasADi')


def text_of(name: str) -> str:
    return ' '.join((ROOT / name).read_text(encoding='utf-8').split())


@pytest.fixture(scope='module')
def stored() -> Findings:
    return read(Findings, ROOT / 'docs/report/speed.json')


@pytest.mark.parametrize('label', ROWS)
def test_a_row_of_the_guide_has_the_measured_parts_of_the_fastest_peers(label: str) -> None:
    guide = (ROOT / GUIDE).read_text(encoding='utf-8')
    (line,) = (line for line in guide.splitlines() if line.startswith(f'| {label} |'))
    found = [cell.split()[0] for cell in line.split('|')[3:5]]
    assert found == parts('ur5', *ROWS[label], anyone, for_any_robot)


def test_the_sentence_about_a_panda_has_the_measured_ratios() -> None:
    casadi, pinocchio = (lambda way: 'CasADi' in way), (lambda way: 'pinocchio' in way)
    batch = parts('panda', 'derivatives', BATCH, 'float64, F order', casadi, pinocchio)
    call = parts('panda', 'derivatives', CALL, 'float64: bound', casadi, pinocchio)
    found = re.search(
        r"a Panda take (\S+) and (\S+) of CasADi's time, (\S+) and (\S+) of Pinocchio's",
        text_of(GUIDE),
    )
    assert found is not None
    assert found.groups() == (batch[0], call[0], batch[1], call[1])


def test_the_sentence_of_the_readme_is_against_the_fastest_peers() -> None:
    text = text_of('README.md').split('<!-- speed-headline -->')[1]
    found = re.findall(r'(1/[\d.]+) of the time of the fastest', text)
    batch = parts('ur5', *ROWS['batch of 4096 states, Fortran order'], anyone, for_any_robot)
    call = parts('ur5', *ROWS['one call from Python through `kernel.bind`'], anyone, for_any_robot)
    assert found == [*batch, *call]


def test_the_page_of_speed_is_the_one_of_its_numbers(stored: Findings) -> None:
    page = (ROOT / 'docs/report/speed.md').read_text(encoding='utf-8')
    assert page == speed_pages.markdown(stored)
