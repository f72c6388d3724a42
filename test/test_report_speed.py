# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the speed compares equal work, and says what it could not compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
import json
import os
from pathlib import Path
import runpy
import shutil
import sys

import numpy as np
import pinocchio as pin
import pytest
import tolerances
import zoo

import pfd_core as pfd
from pfd_core.report import speed_pages
from pfd_core.report.cases.hard_cases import CASES
from pfd_core.report.cases.robots import robot
from pfd_core.report.contenders import casadi, native, ours
from pfd_core.report.contenders.mujoco import Mujoco
from pfd_core.report.contenders.pinocchio import Pinocchio
from pfd_core.report.contenders.pinocchio_cpp import NAME as CPP
from pfd_core.report.contenders.work import LeftOutError, Side, Work, valid_sides
from pfd_core.report.measure import decomposition, port_limit, speed, timing
from pfd_core.report.measure.differences import largest_difference
from pfd_core.report.measure.timing import Pace, Row

BENCHMARK = Path(__file__).resolve().parent.parent / 'benchmarks' / 'speed.py'
# MuJoCo gets rotations as unit quaternions, which adds their rounding to that of the dynamics.
QUATERNIONS = 10 * tolerances.DYNAMICS
WITH_COMPILER = pytest.mark.skipif(
    shutil.which(native.C.compiler) is None, reason='needs a C compiler'
)
# Other quantities have tests of their own.
# Pinocchio's C++ takes half a minute to compile, and has tests of its own.
TINY = replace(
    speed.QUICK,
    robots=('planar2', 'chain3'),
    others=None,
    makers={name: make for name, make in speed.QUICK.makers.items() if name != CPP},
)
PAGES = speed.Findings(
    rows=[
        Row('chain3', 3, 'call', 'pinocchio.aba', 2e-6, 3e-6, 1.0, 0.0),
        Row('chain3', 3, 'call', 'pcrbm float64: bound', 1e-7, 1.5e-7, 20.0, 3e-15),
        Row('chain3', 3, 'batch of 64', 'pinocchio.abaInParallel, 1 thread', 1e-6, 1e-6, 1.0, 0.0),
        Row('chain3', 3, 'batch of 64', 'pcrbm float64, F order', 1e-8, 2e-8, 50.0, 4e-15),
        Row('chain3', 3, port_limit.WORK, 'pcrbm float64', 7.5e-9, 8e-9, 0.75),
        Row('chain3', 3, 'first result', 'pcrbm float64', 0.1, 0.2),
    ],
    left_out=['mujoco on chain3: it is absent'],
    machine=speed.surroundings(),
)


@pytest.fixture(scope='module')
def findings() -> speed.Findings:
    return speed.survey(TINY)


class Clock:
    """Seconds that pass only when a side works; every third turn all is ten times slower."""

    def __init__(self) -> None:
        self.now = 0.0
        self.slow = 1.0

    def __call__(self) -> float:
        return self.now

    def side(self, way: str, seconds: float, value: float, reference: bool = False) -> Side:
        def run() -> None:
            self.now += seconds * self.slow

        return Side(way, run, lambda: np.array([1.0, value]), reference)


def test_times_are_per_state_and_compared_with_the_reference(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(timing.time, 'perf_counter', clock)
    sides = [clock.side('peer', 8.0, 4.0, True), clock.side('ours', 0.5, 4.25)]
    work = Work('batch', *np.zeros((3, 4, 2)))
    peer, ours = timing.take_turns('arm', work, sides, Pace(chunk=16.0, turns=5, budget=1e9))
    assert (peer.minimum, peer.median, peer.times, peer.difference) == (2.0, 2.0, 1.0, 0.0)
    assert (ours.minimum, ours.median, ours.times, ours.difference) == (0.125, 0.125, 16.0, 0.0625)
    assert (ours.work, ours.n) == ('batch of 4', 2)


def test_results_are_compared_with_what_is_wanted_where_that_is_not_the_reference() -> None:
    clock = Clock()
    sides = [
        replace(clock.side('peer', 1.0, 4.0, True), wanted=lambda: np.array([1.0, 8.0])),
        clock.side('ours', 1.0, 8.0),
    ]
    pace = Pace(chunk=1e-9, turns=1)
    peer, ours = timing.take_turns('arm', Work('call', *np.zeros((3, 2))), sides, pace)
    assert (peer.difference, ours.difference) == (0.5, 0.0)


def test_a_machine_that_slows_down_changes_the_median_but_not_the_ratio(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(timing.time, 'perf_counter', clock)
    sides = [clock.side('peer', 4.0, 1.0, True), clock.side('ours', 1.0, 1.0)]
    turns = iter([1.0] * 2 + [1.0, 1.0, 8.0, 8.0, 8.0, 8.0])
    pace = Pace(chunk=1e-9, turns=3, budget=1e9)
    work = [
        replace(s, run=lambda s=s: (setattr(clock, 'slow', next(turns)), s.run())) for s in sides
    ]
    peer, ours = timing.take_turns('arm', Work('call', *np.zeros((3, 2))), work, pace)
    assert (ours.minimum, ours.median, peer.median) == (1.0, 8.0, 32.0)
    assert ours.times == 4.0


def test_a_long_work_has_fewer_turns_but_never_less_than_the_fewest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(timing.time, 'perf_counter', clock)
    for seconds, turns in ((1.0, 10), (3.0, 4), (50.0, 2)):
        clock.now = 0.0
        side = clock.side('ours', seconds, 1.0, True)
        pace = Pace(chunk=1e-9, turns=10, fewest=2, budget=12.0)
        timing.take_turns('arm', Work('call', *np.zeros((3, 2))), [side], pace)
        # Once to see how long it takes.
        assert clock.now == (turns + 1) * seconds


def test_the_turns_of_a_work_take_no_longer_than_its_budget(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(timing.time, 'perf_counter', clock)
    sides = [clock.side('peer', 1.0, 1.0, True)] + [clock.side('ours', 1.0, 1.0)] * 4
    pace = Pace(chunk=1e-9, turns=10, fewest=2, budget=21.0)
    timing.take_turns('arm', Work('call', *np.zeros((3, 2))), sides, pace)
    # The reference works twice in a turn of the four others.
    assert clock.now == len(sides) + 3 * (4 + 2)


def turns_of(times: Sequence[float], most: int) -> int:
    """Return the turns of one side whose times are given, and repeat."""
    clock, seconds = Clock(), cycle(times)
    taken: list[float] = []

    def run() -> None:
        taken.append(next(seconds))
        clock.now += taken[-1]

    pace = Pace(chunk=1e-9, turns=most, budget=1e9)
    timing.interleave([Side('ours', run, lambda: np.ones(1), True)], 1, pace, clock)
    # Once to see how long it takes.
    return len(taken) - 1


def test_equal_times_end_after_the_fewest_turns_and_scattered_ones_take_all() -> None:
    assert turns_of([1.0], 40) == timing.FEWEST_SETTLED
    assert turns_of([1.0, 1.005], 40) == timing.FEWEST_SETTLED
    # Both halves lie more than SETTLED from the median between them.
    assert turns_of([1.0, 1.05], 40) == 40
    assert turns_of([1.0], 6) == 6


def test_a_minimum_must_be_found_again_before_the_turns_end() -> None:
    # The least time comes in turns 1, 14, 27, ..., and turns end in pairs.
    seldom = [1.02, 1.0, *[1.02] * 11]
    assert turns_of(seldom, 100) == 28
    assert turns_of(seldom, 20) == 20


def test_a_chunk_of_several_calls_begins_with_one_that_is_not_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(timing.time, 'perf_counter', clock)
    # A call that follows one of another side takes 25 ms, others take a quarter.
    last = []

    def run(way: str) -> None:
        clock.now += 2.0**-12 if last == [way] else 0.025
        last[:] = [way]

    sides = [
        Side(way, lambda way=way: run(way), lambda: np.ones(2), way == 'peer')
        for way in ('peer', 'ours')
    ]
    pace = Pace(chunk=2.0**-8, turns=4, budget=1e9)
    rows = timing.take_turns('arm', Work('call', *np.zeros((3, 2))), sides, pace)
    times = [time for row in rows for time in (row.minimum, row.median)]
    assert times == pytest.approx([2.0**-12] * 4)


@pytest.mark.slow
def test_every_way_gives_what_pinocchio_gives(findings: speed.Findings) -> None:
    compared = [row for row in findings.rows if row.difference is not None]
    works = {'call', 'rollout', 'batch of 1', 'batch of 64', decomposition.WORK}
    assert {row.work for row in compared} == works
    for row in compared:
        single = 'float32' in row.way
        assert row.difference < (tolerances.SINGLE if single else QUATERNIONS), row


@pytest.mark.slow
def test_every_time_says_what_it_contains(findings: speed.Findings) -> None:
    for row in findings.rows:
        if row.difference is not None:
            assert row.code, row
            assert row.call, row
            # One state has no loop; many have one, and so have the steps of a rollout.
            assert bool(row.loop) == (row.work != 'call'), row
    page = speed_pages.markdown(findings)
    assert '| call | C++ for any robot, as in the wheel | Python | - | pinocchio.aba; ' in page
    native = 'C for this robot, cc -O3 -march=native | ctypes, once | C | CasADi C, loop in C |'
    assert f'| batch | {native}' in page


@pytest.mark.slow
def test_the_factor_over_pinocchio_is_decomposed(findings: speed.Findings) -> None:
    ways = [row.way for row in findings.rows if row.work == decomposition.WORK]
    some = [decomposition.SCALAR, decomposition.VECTOR, decomposition.FROM_PYTHON]
    assert ways == [decomposition.PYTHON, decomposition.CASADI, *some] * len(TINY.robots)


@pytest.mark.slow
def test_every_contender_that_is_installed_is_measured(findings: speed.Findings) -> None:
    ways = '\n'.join(row.way for row in findings.rows)
    left_out = '\n'.join(findings.left_out)
    for name in TINY.makers:
        assert (name in ways) != (name in left_out)
    for row in findings.rows:
        assert 0 < row.minimum <= row.median


@pytest.mark.slow
def test_results_that_lie_on_the_disk_are_measured_too(findings: speed.Findings) -> None:
    works = {row.work for row in findings.rows if row.way == 'composite_body float64'}
    assert {'first result', 'first result, from disk', 'first batch, from disk'} <= works
    ways = {row.way for row in findings.rows if row.work == 'fresh process'}
    assert ways == {'pfd.forward_dynamics', 'pfd.forward_dynamics, from disk'}


@pytest.mark.slow
def test_the_port_limit_of_every_kernel_is_measured(findings: speed.Findings) -> None:
    found = [(row.robot, row.way) for row in findings.rows if row.work == port_limit.WORK]
    own = [way for way in TINY.makers if way.startswith(tuple(ours.METHODS))]
    assert found == [(robot, way) for robot in TINY.robots for way in own]


def test_kernels_without_a_port_limit_are_left_out_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(port_limit, 'LONGEST', 10)
    makers = {'composite_body float64': TINY.makers['composite_body float64']}
    found = speed.survey(replace(TINY, robots=('chain2',), sizes=(3,), makers=makers))
    assert not [row for row in found.rows if row.work == port_limit.WORK]
    (text,) = found.left_out
    assert text.startswith(
        'port limit of composite_body float64 on chain2: a loop of more than 10'
    )


@pytest.mark.slow
def test_measuring_leaves_the_cache_of_the_user_as_it_is(findings: speed.Findings) -> None:
    assert 'pfd_speed_' not in os.environ.get('PFD_CACHE', '')


@pytest.mark.parametrize(
    ('maker', 'needs'),
    [
        (Pinocchio, 'pinocchio'),
        (Mujoco, 'mujoco'),
        pytest.param(casadi.Casadi, 'casadi', marks=WITH_COMPILER),
    ],
    ids=['pinocchio', 'mujoco', 'casadi'],
)
def test_a_peer_made_of_our_numbers_is_the_same_arm(maker: type, needs: str) -> None:
    pytest.importorskip(needs)
    # Joints of all kinds on odd axes, on a base that is turned.
    arm = pfd.load_robot(zoo.ODD_ARM, tip='tool')
    q, qd, tau = np.random.default_rng(3).uniform(-1, 1, (3, 5, arm.n))
    peer = maker(arm)
    model = zoo.to_pinocchio(arm)
    wanted = np.array(
        [pin.aba(model, model.createData(), *x) for x in zip(q, qd, tau, strict=True)]
    )
    for work in (Work('batch', q, qd, tau), Work('call', q[0], qd[0], tau[0])):
        for side in peer.sides(work):
            side.run()
            rows = wanted if work.kind == 'batch' else wanted[0]
            assert largest_difference(side.result(), rows) < QUATERNIONS


def test_an_absent_peer_is_left_out_and_the_page_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ('mujoco', 'casadi', 'pinocchio'):
        monkeypatch.setitem(sys.modules, name, None)
    kept = ('pinocchio', 'mujoco', 'CasADi C', 'composite_body float64')
    plan = replace(TINY, robots=('chain2',), sizes=(3,), makers={k: TINY.makers[k] for k in kept})
    found = speed.survey(plan)
    assert [text.split(':')[0] for text in found.left_out] == [f'{k} on chain2' for k in kept[:3]]
    assert all('install the extra `peers`' in text for text in found.left_out)
    assert found.rows
    assert all(row.times is None for row in found.rows if row.work != port_limit.WORK)
    assert 'mujoco on chain2: mujoco cannot be imported' in speed_pages.markdown(found)


def test_without_a_compiler_casadi_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('casadi')
    monkeypatch.setattr(shutil, 'which', lambda name: None)
    with pytest.raises(LeftOutError, match='no C compiler'):
        casadi.Casadi(robot('chain2'))


@WITH_COMPILER
def test_the_message_of_the_compiler_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('casadi')
    monkeypatch.setattr(casadi, 'text', lambda name: '#error "broken on purpose"')
    with pytest.raises(LeftOutError, match='broken on purpose'):
        casadi.Casadi(robot('chain2'))


def test_a_run_of_which_mujoco_warns_has_failed_and_is_not_measured() -> None:
    pytest.importorskip('mujoco')
    (case,) = (case for case in CASES if case.name == 'collinear_axes_1e-12')
    problem = case.make()
    peer = Mujoco(problem.plant.robot)
    states = [np.repeat(x, 3, axis=0) for x in problem.states.values()]
    reasons: dict[str, str] = {}
    assert not valid_sides(peer.sides(Work('batch', *states)), reasons)
    assert reasons == {'mujoco.rollout': 'failed: MuJoCo warned of BADQACC'}
    # At an ordinary state of the same arm it does not warn.
    easy = [np.full_like(x, 0.5) for x in states]
    (side,) = valid_sides(peer.sides(Work('batch', *easy)), reasons)
    assert len(reasons) == 1
    assert side.contents.loop == 'C'


def test_state_by_state_in_native_code_gives_the_bits_of_the_kernel() -> None:
    arm = robot('chain2')
    q, qd, tau = np.random.default_rng(2).uniform(-1, 1, (3, 5, 2))
    kernel = pfd.compile_kernel(arm)
    side = decomposition.state_by_state(kernel, Work('batch', q, qd, tau))
    side.run()
    wanted = [kernel(*state) for state in zip(q, qd, tau, strict=True)]
    np.testing.assert_array_equal(side.result(), wanted)


def test_a_method_that_would_take_minutes_to_compile_is_left_out() -> None:
    with pytest.raises(LeftOutError, match='12 joints'):
        ours.make('pcrbm', 'float64', robot('chain13'))


def test_a_dense_arm_has_no_zero_and_a_chain_only_right_angles() -> None:
    dense = robot('dense6')
    for values in (dense.rotations, dense.translations, dense.centers, dense.inertias):
        assert np.abs(values).min() > 1e-6  # metres, kg m^2: far above rounding
    chain = robot('chain5')
    assert chain.n == 5
    assert set(np.unique(chain.rotations)) == {-1.0, 0.0, 1.0}


def test_an_unknown_robot_is_refused() -> None:
    with pytest.raises(ValueError, match='chainsaw'):
        robot('chainsaw')


def test_the_pages_hold_every_row(tmp_path: Path) -> None:
    paths = speed_pages.write(PAGES, tmp_path)
    assert [path.name for path in paths[:2]] == ['speed.md', 'speed.json']
    page = paths[0].read_text()
    assert '| pcrbm float64: bound | 100 / 150 (20) |' in page
    assert '| pcrbm float64, F order | 10 / 20 (50) |' in page
    assert '| pcrbm float64 | 100 / 200 |' in page  # milliseconds
    assert '| pcrbm float64 | 4e-15 |' in page  # the larger of two
    assert '| chain3 | - | 20.0 | - | 50.0 | - | - | 0.75 |' in page
    assert '| pcrbm float64 | 7.5 / 8 (0.75) |' in page
    assert 'mujoco on chain3: it is absent' in page
    assert PAGES.machine['versions']['NumPy'] in page
    data = json.loads(paths[1].read_text())
    assert [Row(**row) for row in data['rows']] == PAGES.rows


def test_the_plot_is_left_out_without_matplotlib(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('matplotlib', 'matplotlib.figure', 'matplotlib.backends.backend_agg'):
        monkeypatch.setitem(sys.modules, name, None)
    assert [path.name for path in speed_pages.write(PAGES, tmp_path)] == ['speed.md', 'speed.json']


def test_the_benchmark_measures_the_robots_that_it_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[Path, speed.Survey] = {}
    monkeypatch.setattr(speed_pages, 'run', lambda out, plan: asked.update({out: plan}) or [])
    command = [str(BENCHMARK), 'puma560', 'chain7', '--quick', '--out', str(tmp_path)]
    monkeypatch.setattr(sys, 'argv', command)
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(BENCHMARK), run_name='__main__')
    assert stopped.value.code == 0
    wanted = replace(speed.QUICK, robots=('puma560', 'chain7'), others=None)
    assert asked == {tmp_path: wanted}
