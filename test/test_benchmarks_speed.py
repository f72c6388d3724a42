# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page speed: peers do the same work, sides take turns, the page tells gains and losses."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from functools import partial
from importlib.util import find_spec
import json
import os
from pathlib import Path
import shutil
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from benchmarks import readme, timing
from benchmarks.cases.motions import stored_arm
from benchmarks.cases.problems import FORWARD, QUANTITIES, random_states
from benchmarks.cases.robots import mechanism, robot
from benchmarks.pages import speed
from benchmarks.peers import control_loop, native
from benchmarks.peers.casadi import LARGEST_ANGLE, ULPS, casadi_c, vector_casadi, vector_library
from benchmarks.peers.others import dynibo, mujoco
from benchmarks.peers.ours import CODE, ours
from benchmarks.peers.pinocchio import Pinocchio, pinocchio_cpp
from benchmarks.peers.work import Arguments, LeftOutError, Peer, Side, valid_sides
from benchmarks.table import json_text
from benchmarks.timing import Pace, differences
import pfd_core as pfd

COMPILERS = [name for name in ('gcc', 'clang') if shutil.which(name)]
COMPILED = pytest.mark.skipif(not COMPILERS, reason='needs a C compiler')
# Of results that are rounded in another order, on arms that lose few digits.
CLOSE = 1e-10
PEERS: dict[str, Callable[[pfd.Robot], Peer]] = {
    'Pinocchio': Pinocchio,
    'MuJoCo': mujoco,
    'composite_body': partial(ours, method='composite_body'),
    'CasADi C': casadi_c,
    'vectors': partial(vector_casadi, compiler=(COMPILERS or ['gcc'])[0]),
    'Pinocchio C++': pinocchio_cpp,
}


def works(arm: pfd.Robot, states: int, quantity: str = FORWARD) -> list[Arguments]:
    """Return a call and a batch."""
    known = random_states(arm, states)
    arrays = [known[name] for name in QUANTITIES[quantity]]
    return [[x[0] for x in arrays], arrays]


def made(make: Callable[[pfd.Robot], Peer], arm: pfd.Robot) -> Peer:
    try:
        return make(arm)
    except LeftOutError as reason:
        pytest.skip(str(reason))


def checked(peer: Peer, known: Pinocchio, works: list[Arguments]) -> int:
    """Compare the results of all ways with Pinocchio's, and return their number."""
    ways = 0
    for work in works:
        for side in peer(work):
            side.run()
            assert differences(side.result(), known.results(work)).max() < CLOSE, side.way
            ways += 1
    return ways


@pytest.mark.parametrize('axes', ['zyXy', 'zZ'])
@pytest.mark.parametrize(
    'name',
    [pytest.param(x, marks=[pytest.mark.long] if x == 'Pinocchio C++' else []) for x in PEERS],
)
def test_peers_give_pinocchios_results_also_of_slides(name: str, axes: str) -> None:
    arm = mechanism(axes)
    # Not a multiple of the lanes.
    assert checked(made(PEERS[name], arm), Pinocchio(arm), works(arm, 13)) >= 2


@pytest.mark.parametrize('quantity', [name for name in QUANTITIES if name != FORWARD])
def test_quantities_of_ours_and_of_casadi_are_pinocchios(quantity: str) -> None:
    arm = mechanism('zyXy')
    given = works(arm, 3, quantity)
    known = Pinocchio(arm, quantity)
    peers: list[Peer] = [known, ours(arm, quantity)]
    peers += [casadi_c(arm, quantity)] if COMPILERS else []
    assert all(checked(peer, known, given) >= 2 for peer in peers)


@COMPILED
@pytest.mark.long
def test_casadi_and_pinocchio_in_cpp_simulate_one_arm_with_limits_and_friction() -> None:
    case = stored_arm()
    ends = [
        run()
        for make in (control_loop.casadi_runs, control_loop.pinocchio_runs)
        for way, _, _, run in make(case, [2], [1e-2])
        if way.endswith('RK4')
    ]
    assert [end.status for end in ends] == ['ok', 'ok']
    assert np.abs(ends[0].q - case.start).max() > 1e-3
    np.testing.assert_allclose(ends[0].q, ends[1].q, rtol=0, atol=1e-11)


@COMPILED
@pytest.mark.parametrize('compiler', COMPILERS)
def test_vectors_of_any_number_of_states_are_right(compiler: str) -> None:
    arm = robot('ur5')
    peer = made(partial(vector_casadi, compiler=compiler), arm)
    for states in (1, 8, 15):
        assert checked(peer, Pinocchio(arm), works(arm, states)) == 2


@COMPILED
@pytest.mark.parametrize('compiler', COMPILERS)
def test_sine_and_cosine_of_vectors_keep_their_error(compiler: str) -> None:
    try:
        library = vector_library(robot('ur5'), compiler)
    except LeftOutError as reason:
        pytest.skip(str(reason))
    count = 1 << 17
    angles = np.random.default_rng(1).uniform(-1, 1, count) * np.geomspace(1, LARGEST_ANGLE, count)
    found = np.empty((2, count))
    library.sines(ctypes.c_longlong(count), *map(native.address, (angles, *found)))
    wide = angles.astype(np.longdouble)
    exact = np.array([np.sin(wide), np.cos(wide)])
    assert (np.abs(found - exact) / np.spacing(np.abs(exact.astype(float)))).max() < ULPS


def test_dynibo_gives_the_same_accelerations_for_the_scaled_arm() -> None:
    arm = robot('ur5')
    assert checked(made(dynibo, arm), Pinocchio(arm), works(arm, 1)) == 1


# JAX warns in every process that is forked later: not in this one.
WITH_FRAX = """
from benchmarks.peers.others import frax
from test_benchmarks_speed import Pinocchio, checked, robot, works
arm = robot('ur5')
print(checked(frax(arm), Pinocchio(arm), works(arm, 3)))
"""


@pytest.mark.slow
def test_frax_has_the_same_arm() -> None:
    if find_spec('frax') is None:
        pytest.skip('needs frax')
    here = Path(__file__).resolve().parent
    path = os.pathsep.join([str(here), str(here.parent), *sys.path])
    command, environment = [sys.executable, '-c', WITH_FRAX], {**os.environ, 'PYTHONPATH': path}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout == '2\n'


def test_a_run_of_which_mujoco_warns_is_excluded() -> None:
    arm, reasons = robot('ur5'), dict[str, str]()
    # A single forward checks nothing.
    q, qd, tau = works(arm, 3)[1]
    assert not valid_sides({'MuJoCo': made(mujoco, arm)}, (1e12 * q, qd, tau), reasons)
    assert 'BADQPOS' in reasons['MuJoCo, batch of 3']


def test_without_a_compiler_peers_in_c_are_left_out_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(native.shutil, 'which', lambda name: None)
    for make in (casadi_c, vector_casadi):
        with pytest.raises(LeftOutError, match='no compiler'):
            make(robot('planar2'))


class Clock:
    """Seconds that pass only when a side works."""

    def __init__(self, slow: list[float]) -> None:
        self.now, self.slow = 0.0, iter(slow)

    def __call__(self) -> float:
        return self.now

    def side(self, seconds: float) -> Side:
        def run() -> None:
            self.now += seconds * next(self.slow, 1.0)

        return Side('', run, lambda: np.ones(2))


def test_times_are_per_unit_and_a_machine_that_slows_down_does_not_change_their_ratio() -> None:
    clock = Clock([1.0] * 4 + [8.0] * 4)
    sides = [clock.side(8.0), clock.side(2.0)]
    peer, own = timing.take_turns(sides, 2, Pace(chunk=1e-9, turns=3, budget=1e9), clock)
    assert (peer.minimum, peer.median, peer.times) == (4.0, 32.0, 1.0)
    assert (own.minimum, own.median, own.times) == (1.0, 8.0, 4.0)


def test_a_long_work_has_fewer_turns_but_never_less_than_the_fewest() -> None:
    for seconds, turns in ((1.0, 10), (3.0, 4), (50.0, 2)):
        clock = Clock([])
        pace = Pace(chunk=1e-9, turns=10, fewest=2, budget=12.0)
        timing.take_turns([clock.side(seconds)], 1, pace, clock)
        # Once to see how long it takes.
        assert clock.now == (turns + 1) * seconds


def row(way: str, ns: float, work: str = speed.MANY, contents: str = 'C++ for any robot') -> Any:
    head = {'robot': 'ur5', 'work': work, 'way': way, 'quantity': FORWARD}
    times = {'minimum': ns * 1e-9, 'median': ns * 1e-9, 'times': 1 / ns}
    return head | times | {'contents': contents}


def page_data() -> dict[str, Any]:
    rows = []
    for work, own in ((speed.MANY, 20.0), (speed.FEW, 45.0)):
        rows.append(row('Pinocchio C++ aba', 2000.0, work))
        rows.append(row('CasADi C on vectors, gcc, F order', 30.0, work, 'C for this robot'))
        rows.append(row('composite_body float64, F order', own, work, CODE))
    for way, ns in (('kernel(q, qd, tau)', 900.0), ('bound', 100.0)):
        rows.append(row(f'composite_body float64: {way}', ns, 'call', CODE))
    rows.append(row('pinocchio.aba', 2000.0, 'call'))
    data = {'machine': timing.surroundings(), 'rows': rows, 'first': []}
    excluded = ['frax, forward_dynamics of ur5: absent']
    found: dict[str, Any] = json.loads(json_text(data | {'excluded': excluded}))
    return found


def test_gains_and_losses_are_against_the_fastest_peer() -> None:
    many, few, call = speed.results_rows(page_data())
    assert (many['ours'], many['theirs'], many['speed-up']) == ('20 ns', '30 ns', '1.5')
    assert (few['ours'], few['theirs'], few['speed-up']) == ('45 ns', '30 ns', '0.667')
    assert (call['ours'], call['peer']) == ('100 ns / 900 ns', 'pinocchio.aba')
    assert (call['theirs'], call['speed-up']) == ('2000 ns', '20 / 2.22')


def test_a_page_without_peers_says_what_to_install() -> None:
    data = page_data()
    data['rows'] = [one for one in data['rows'] if one['contents'] == CODE]
    assert "pip install '.[peers]'" in speed.text(data)
    assert speed.for_any_robot(data) == ''


def test_the_page_has_a_cell_for_every_row_and_names_what_is_excluded() -> None:
    data = page_data()
    text = speed.text(data)
    assert all(one['way'] in text for one in data['rows'])
    assert '- frax, forward_dynamics of ur5: absent' in text


def test_the_results_of_the_readme_are_what_the_stored_data_gives() -> None:
    text = readme.README.read_text(encoding='utf-8')
    assert readme.MARKED.search(text)
    assert readme.filled() == text, 'run python -m benchmarks.readme'
