# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sentences about speed name the fastest peer, and what its time contains."""

from __future__ import annotations

from pfd_core.report import headlines
from pfd_core.report.measure import decomposition
from pfd_core.report.measure.speed import Findings
from pfd_core.report.measure.timing import Row

BATCH = 'batch of 4096'
MACHINE = {'processor': 'Abacus', 'virtual': True}


def row(work: str, way: str, seconds: float, times: float | None, robot: str = 'ur5') -> Row:
    return Row(robot, 6, work, way, seconds, seconds, times)


ROWS = [
    row('call', 'pinocchio.aba', 2e-6, 1.0),
    row('call', 'mujoco mj_forward, state in place', 1e-6, 2.0),
    row('call', 'composite_body float64: bound', 1e-7, 20.0),
    row('call', 'composite_body float64: kernel(..., out=)', 6e-7, 3.3),
    row('call', 'composite_body float64: kernel(q, qd, tau)', 9e-7, 2.2),
    row('batch of 1', 'CasADi C, loop in C', 5e-7, 1.0),
    row('batch of 1', 'Pinocchio C++ aba', 2e-6, 0.25),
    row('batch of 1', 'composite_body float64, F order', 1e-6, 0.5),
    row(BATCH, 'pinocchio.abaInParallel, 1 thread', 1.6e-6, 1.0),
    row(BATCH, 'pinocchio.abaInParallel, 2 threads', 1e-9, 1600.0),
    row(BATCH, 'Pinocchio C++ aba', 1.5e-6, 1.25),
    row(BATCH, 'Pinocchio C++ aba refined', 4e-6, 0.4),
    row(BATCH, 'CasADi C, loop in C', 3e-7, 5.0),
    row(BATCH, 'composite_body float64, F order', 2e-8, 75.0),
    row(BATCH, 'composite_body float64, C order', 2.5e-8, 60.0),
    row(BATCH, 'pcrbm float64, F order', 3e-8, 50.0),
    row(BATCH, 'composite_body float32, F order', 1e-8, 150.0),
]


def findings(rows: list[Row]) -> Findings:
    return Findings(rows, [], MACHINE)


def test_a_sentence_is_against_the_fastest_peers_on_one_thread() -> None:
    text = ' '.join(headlines.headline(findings(ROWS)).split())
    assert text.startswith(
        'On one thread of a virtual Abacus, forward dynamics of a UR5 in batches of 4096 states '
        'in Fortran order takes 1/15 of the time of the fastest peer, C that CasADi generates for '
        'this arm (loop in C, `-O3 -march=native`), and 1/60 of the time of the fastest that '
        "takes any robot, Pinocchio's `aba` in C++ compiled for this processor. Relative to the "
        "fastest peer the time is 1/12 in C order, 2.0 times the peer's in a batch of one state. "
        'One call from Python takes 900 ns as `kernel(q, qd, tau)`, 600 ns with `out=`,'
    )
    # Where the fastest peer takes any robot, it is named once.
    assert "1/10 of the time of the fastest peer, MuJoCo's `mj_forward`. A peer is" in text
    assert 'compilation, contacts and joint stops are left out' in text


def test_there_is_no_sentence_without_peers() -> None:
    ours = [row for row in ROWS if 'float64' in row.way]
    assert headlines.headline(findings(ours)) == ''


def test_a_peer_that_is_refined_or_on_two_threads_is_not_the_fastest() -> None:
    own = [row for row in ROWS if row.work == BATCH]
    names = [peer.way for peer in headlines.peers(own, any_robot=True)]
    assert names == ['pinocchio.abaInParallel, 1 thread', 'Pinocchio C++ aba']


def test_factors_of_the_decomposition_multiply_to_the_whole() -> None:
    times = {
        decomposition.PYTHON: 1.0,
        decomposition.CPP: 1.25,
        decomposition.CASADI: 5.0,
        decomposition.SCALAR: 20.0,
        decomposition.VECTOR: 100.0,
        decomposition.FROM_PYTHON: 16.0,
    }
    rows = [row(decomposition.WORK, way, 2e-6 / x, x) for way, x in times.items()]
    section = headlines.decomposed(rows)
    assert section is not None
    # Of calls, code for one robot, with CasADi's part of it, and vectors; then all, and our calls.
    assert '| ur5 | 2000 | 1.25 | 16 | 4 | 5 | 100 | 1.25 |' in section
    without = [row for row in rows if row.way != decomposition.CPP]
    assert '| ur5 | 2000 | - | - | - | 5 | 100 | 1.25 |' in str(headlines.decomposed(without))
    assert headlines.decomposed([]) is None
