# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PCRBM and PCGM of 1987 step by step: right answers, counts by equation, misprints that show."""

from __future__ import annotations

from dataclasses import replace
import json
import math
from pathlib import Path
from typing import Any

from closed_forms import Counts, by_section, chain, levels
import mpmath
import numpy as np
from oracle import Oracle, error, relative
import pytest
from zoo import random_chain, random_state, right_angled

from benchmarks.cases import conjugate
from benchmarks.cases.paper import AS_PRINTED, CORRECTED, row
from benchmarks.cases.robots import uniform_chain
import pfd_core as pfd
from pfd_core.dynamics import methods
from pfd_core.machine.emulator import run as run_program
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper import editions
from pfd_core.paper.composite import record_pcrbm_1987
from pfd_core.paper.conjugate import record_pcgm_1987

METHODS = ('pcrbm_1987', 'pcgm_1987')
RIGHT_ANGLED = pfd.Scene(external_wrench=True, damping='model', armature='model', brakes=True)


@pytest.mark.parametrize('n', [1, 2, 4, 6])
def test_n_iterations_of_1987_are_the_answer_in_fifty_digits(n: int) -> None:
    # Directions lose their orthogonality by rounding: seen up to 1e-38.
    robot, given = right_angled(n)
    given['free'] = (np.arange(n) % 3 != 1).astype(float)
    plant = resolve_plant(robot, RIGHT_ANGLED)
    wanted = run_program(methods.FORWARD['pcrbm'](plant, 'parallel'), given, digits=50)['qdd']
    for schedule in ('parallel', 'sequential'):
        found = run_program(record_pcgm_1987(plant, schedule), given, digits=50)
        assert found['iterations'] <= n
        assert error(found['qdd'], wanted) < 1e-30


def test_n_iterations_of_1987_leave_an_error_in_double_precision() -> None:
    robot = uniform_chain(12)
    states = [random_state(np.random.default_rng(seed), 12) for seed in range(20)]
    given = dict(zip(('q', 'qd', 'tau'), np.transpose(states, (1, 0, 2)), strict=True))
    found = run_program(record_pcgm_1987(resolve_plant(robot), 'parallel'), given)
    oracle = Oracle(robot)
    errors = [
        relative(qdd, oracle.qdd(*state)) for qdd, state in zip(found['qdd'], states, strict=True)
    ]
    assert min(errors) > 1e-5
    assert set(found['iterations'].ravel()) == {12}
    worst = pfd.emulate(robot, *states[int(np.argmax(errors))], method='pcgm_1987')
    assert (worst.status, worst.iterations) == ('not_converged', 12)


@pytest.mark.parametrize('method', METHODS)
def test_emulate_runs_the_edition_with_misprints_and_does_not_call_it_right(method: str) -> None:
    robot = pfd.load_robot('ur5')
    state = np.random.default_rng(3).normal(size=(3, 6))
    run = pfd.emulate(robot, *state, method=method, edition='printed')
    assert run.status == 'wrong'
    assert 'set ordering' in run.steps_by_section or 'step 5' in run.steps_by_section
    record = record_pcrbm_1987 if method == 'pcrbm_1987' else record_pcgm_1987
    wanted = record(resolve_plant(robot), 'parallel', misprints=editions.AS_PRINTED[method])
    assert run.program == wanted
    # Of one joint it is right.
    one = pfd.emulate(chain(1), [0.3], [0.2], [1.0], method='pcrbm_1987', edition='printed')
    assert one.status == 'ok'


@pytest.mark.parametrize('method', [*METHODS, 'pcrbm_array', 'composite_body'])
def test_steps_are_the_sum_of_the_steps_of_sections(method: str) -> None:
    state = np.random.default_rng(4).normal(size=(3, 6))
    run = pfd.emulate(uniform_chain(6), *state, method=method)
    assert sum(run.steps_by_section.values(), pfd.Steps()) == run.steps


# ---- misprints -------------------------------------------------------------------------------


def test_an_unknown_misprint_is_an_error() -> None:
    plant = resolve_plant(chain(2))
    for record in (record_pcrbm_1987, record_pcgm_1987):
        with pytest.raises(ValueError, match=r"misprint must be one of .* got 'eq\. 99'"):
            record(plant, 'parallel', misprints=['eq. 99'])


def off(robot: pfd.Robot, misprint: str, seed: int, record: Any = record_pcrbm_1987) -> float:
    """Return the relative error of qdd with a misprint; NaN where a pivot is zero or negative."""
    q, qd, tau = random_state(np.random.default_rng(seed), robot.n)
    program = record(resolve_plant(robot), 'parallel', misprints=[misprint])
    with np.errstate(all='ignore'):
        found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})['qdd']
    return relative(found, Oracle(robot).qdd(q, qd, tau))


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda'])
def test_cholesky_as_printed_gives_no_arm_its_accelerations(name: str) -> None:
    assert not off(pfd.load_robot(name), editions.CHOLESKY, 5) < 0.01


def test_step_6_as_printed_is_wrong_only_for_sliding_joints() -> None:
    assert off(chain(4), editions.STEP_6, 7) < 1e-9
    assert not off(chain(4, prismatic=True), editions.STEP_6, 7) < 0.01  # z . F_j = 0


@pytest.mark.parametrize('types', [['revolute'] * 4, ['revolute', 'prismatic'] * 2])
def test_equations_of_appendix_a_as_printed_are_wrong(types: list[str]) -> None:
    # (A.3) for any arm, (A.8) where a joint slides that is not the first of its pairs.
    robot = random_chain(np.random.default_rng(10), 4, joint_types=types)
    assert not off(robot, editions.A_3, 10) < 1e-3
    assert (off(robot, editions.A_8, 10) < 1e-3) == ('prismatic' not in types)


def test_step_7_as_printed_loses_the_iterate() -> None:
    assert not off(pfd.load_robot('ur5'), editions.STEP_7, 11, record_pcgm_1987) < 0.01


def test_step_4_as_printed_gives_the_answer_plus_the_estimate() -> None:
    robot = pfd.load_robot('ur5')
    q, qd, tau = random_state(np.random.default_rng(8), 6)
    x0 = np.random.default_rng(9).normal(size=6)
    given = {'q': q, 'qd': qd, 'tau': tau, 'start': x0}
    plant = resolve_plant(robot)
    exact = run_program(methods.FORWARD['pcrbm'](plant, 'parallel'), given, digits=50)['qdd']
    with mpmath.workdps(50):
        shifted = exact + x0
    for misprints, wanted in (((), exact), ((editions.STEP_4,), shifted)):
        program = record_pcgm_1987(plant, 'parallel', misprints=misprints, start=True)
        assert error(run_program(program, given, digits=50)['qdd'], wanted) < 1e-30


def test_conjugate_gradients_that_start_at_the_answer_end_at_once() -> None:
    # They stop by |tau - b|: by the residual of the start they would go on to its rounding.
    robot = uniform_chain(6)
    program = methods.FORWARD['pcgm'](resolve_plant(robot), 'parallel', start=True)
    for seed in range(5):
        q, qd, tau = random_state(np.random.default_rng(seed), 6)
        given = {'q': q, 'qd': qd, 'tau': tau}
        answer = Oracle(robot).qdd(q, qd, tau)
        assert run_program(program, given | {'start': answer})['iterations'] <= 2
        assert run_program(program, given | {'start': 0 * answer})['iterations'] > 4


# ---- counts: closed forms, by hand from the equations ----------------------------------------


def pairs(n: int, packed: bool) -> int:
    """Return the rounds of the pairs i < j: n(n-1)/2 on n lanes, or a row each."""
    return math.ceil((n - 1) / 2) if packed else n - 1


def products(n: int, packed: bool) -> int:
    """Return the rounds of the products of Cholesky: (i-1)(n-i+1) of column i."""
    if packed:
        return sum(math.ceil((i - 1) * (n - i + 1) / n) for i in range(2, n + 1))
    return n * (n - 1) // 2


def pcrbm_parts(n: int, packed: bool, literal: bool, square: bool = False) -> dict[str, Counts]:
    """Return multiplications, additions, divisions and roots of each section, of each twist."""
    L, p = levels(n), pairs(n, packed)
    many = n > 1
    found = {
        'joint rotation': (12, 6, 0, 0),
        'orientation': (27 * L, 18 * L, 0, 0),
        # R p and R s, 9 and 6 each; R J R', 27 and 18 for R J, 18 and 12 for six elements.
        'link vectors': (63, 42, 0, 0),
        # w_(i-1) x zq_i needs a link before.
        'newton_euler': (87 - 6 * (not many), 15 * L + 65 - 3 * (not many), 0, 0),
        'right-hand side': (0, 1, 0, 0),
        'equation (15)': (0, L, 0, 0),
        # 1/M_j; a_j; m c + M p* and its product with 1/M_j.
        'equations (16), (17)': (10 * many, 3 + 3 * many, int(many), 0),
        # a x + b of vectors; products of the a, needless on the last level.
        'equation (18)': (4 * L - 1 if many else 0, 3 * L, 0, 0),
        # p* - c, u, v; two times 6 products, 3 sums and a factor; two sums of six elements.
        'equation (19)': (24 * many, 27 * many, 0, 0),
        'equation (20)': (0, 9 * L, 0, 0),
        'step 6': (18, 9, 0, 0),  # M c, z x M c, E z
        'equation (23)': (6, 6, 0, 0),
        'diagonal of H': (3, 2, 0, 0),
        'moments of the row sweep': (6 * p, 3 * p, 0, 0),
        'row sweep': (0, 3 * (n - 1), 0, 0),
        'elements of H': (3 * p, 2 * p, 0, 0),
        'column sweeps': (2 * (n - 1), 2 * (n - 1), 2 * n, 0),
    }
    if literal:
        P6 = math.ceil((n * n - 1) / 6)
        found |= {
            'set ordering': (P6, P6, 0, 0),
            'square roots': (0, 0, 0, 1),
            'divisions': (0, 0, math.ceil((n - 1) / 2), 0),
        }
    else:
        found['factorisation'] = (products(n, packed), n * (n - 1) // 2, n - 1, n)
    if square:
        # Five elements of R_i are 0 or 1: a first level of 8 and 4. One component of p*_i is 0.
        found |= {'orientation': (27 * L - 19, 18 * L - 14, 0, 0), 'link vectors': (60, 39, 0, 0)}
    return {section: counts for section, counts in found.items() if any(counts)}


# Chains by twist: skew axes of any length, twists of 0 and 90 degrees from two joints on.
TWISTS = [*((False, n) for n in range(1, 33)), *((True, n) for n in range(2, 17))]


def of_twist(n: int, square: bool) -> pfd.Robot:
    return uniform_chain(n, right_angles=True) if square else chain(n)


@pytest.mark.sweep
@pytest.mark.parametrize('literal', [False, True])
@pytest.mark.parametrize('schedule', ['parallel', 'unpacked'])
@pytest.mark.parametrize(('square', 'n'), TWISTS)
def test_pcrbm_of_1987_has_its_closed_forms(
    n: int, square: bool, schedule: str, literal: bool
) -> None:
    misprints = editions.OF_PROCEDURE['pcrbm_1987'] if literal else ()
    plant = resolve_plant(of_twist(n, square))
    program = record_pcrbm_1987(plant, schedule, misprints=misprints)
    assert by_section(program) == pcrbm_parts(n, schedule == 'parallel', literal, square)


def pcgm_parts(n: int, literal: bool, square: bool = False) -> dict[str, Counts]:
    """Return multiplications, additions, divisions and roots of each section, one iteration."""
    L = levels(n)
    before = ('joint rotation', 'orientation', 'link vectors', 'newton_euler', 'right-hand side')
    shared = pcrbm_parts(n, False, False, square)
    found = {section: shared[section] for section in before if section in shared}
    found |= {
        'first inner product': (1, L, 0, 0),
        # z u, wd x p*, wd x s, m a, J wd, s x F, p* x f, z . n; four sums of vectors.
        'step 7': (42, 12 * L + 29, 0, 0),
        'step 8': (1, L, 1, 0),
        'step 9': (1, 1, 0, 0),
    }
    if n == 1:  # the only iteration ends with step 10
        return found
    found |= {'step 11': (1, 1, 0, 0), 'step 12': (1, L, 0, 0), 'steps 14, 15': (1, 1, 1, 0)}
    return found | ({'step 5': (1, L, 0, 0)} if literal else {})


@pytest.mark.sweep
@pytest.mark.parametrize('literal', [False, True])
@pytest.mark.parametrize(('square', 'n'), TWISTS)
def test_pcgm_of_1987_has_its_closed_forms(n: int, square: bool, literal: bool) -> None:
    misprints = editions.OF_PROCEDURE['pcgm_1987'] if literal else ()
    plant = resolve_plant(of_twist(n, square))
    program = record_pcgm_1987(plant, 'parallel', misprints=misprints)
    assert by_section(program) == pcgm_parts(n, literal, square)
    unpacked = record_pcgm_1987(plant, 'unpacked', misprints=misprints)
    assert unpacked == program  # no pairs, nothing to pack


@pytest.mark.sweep
@pytest.mark.parametrize('square', [False, True])
@pytest.mark.parametrize(
    'n',
    [pytest.param(n, marks=[pytest.mark.slow] * (n not in (2, 3, 4, 7, 9))) for n in range(2, 17)],
)
def test_pcrbm_with_the_array_takes_its_cycles_for_the_factorisation(n: int, square: bool) -> None:
    # A cycle is a multiplication or a division, and an addition if a cell subtracts: in P_21 from
    # cycle 4 as printed and 3 corrected, in row n to the cycle before the last root.
    for literal, edition, cycles in ((True, AS_PRINTED, 3 * n - 1), (False, CORRECTED, 3 * n - 2)):
        parts = pcrbm_parts(n, True, literal, square)
        cells = ('set ordering', 'square roots', 'divisions', 'factorisation', 'joint rotation')
        rest = [counts for section, counts in parts.items() if section not in cells]
        products, sums, divisions, _ = map(sum, zip(*rest, strict=True))
        found = row('pcrbm_array', n, edition, right_angles=square)
        assert found['multiplications'] == products + divisions + cycles
        assert found['additions'] == sums + 3 * n - 5
        assert found['square_roots'] == n


def test_conjugate_gradients_as_printed_end_with_step_10_of_iteration_n() -> None:
    run = pfd.emulate(uniform_chain(6), *[[0.1] * 6] * 3, method='pcgm_1987', edition='printed')
    products = {
        name: steps.multiplications
        for name, steps in run.steps_by_section.items()
        if name.startswith('step')
    }
    assert run.iterations == 6
    assert products == {
        'step 7': 42 * 6,
        'step 8': 6,
        'step 9': 6,
        'step 11': 5,
        'step 12': 5,
        'steps 14, 15': 5,
        'step 5': 5,
    }


# ---- statuses --------------------------------------------------------------------------------


def stored_statuses(page: str, table: str) -> list[dict[str, Any]]:
    path = Path(__file__).resolve().parent.parent / 'docs' / 'report' / f'{page}.json'
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding='utf-8'))['data'][table]
    return rows


@pytest.mark.parametrize(
    ('page', 'table', 'bad', 'always'),
    [
        ('counts', 'statuses', 'not_converged', 'pcgm'),
        ('since-1987', 'accuracy', 'inaccurate', 'pcrbm'),
    ],
)
def test_no_stored_answer_that_is_wrong_is_called_ok(
    page: str, table: str, bad: str, always: str
) -> None:
    rows = stored_statuses(page, table)
    assert {x['status'] for x in rows} == {'ok', bad}
    assert {x['status'] for x in rows if x['method'] == always} == {'ok'}
    assert all(x['status'] == bad or x['error'] <= x['allowed'] for x in rows)


ALL_METHODS = pfd.METHODS + pfd.EMULATED_METHODS


def tip_on_its_axis(inertia: float) -> pfd.Robot:
    """Return four turning joints on skew axes, the last with a point mass on its axis, nearly."""
    robot = random_chain(np.random.default_rng(5), 4, 0.0)
    A, a = robot.rotations[-1], robot.translations[-1]
    centers, inertias = robot.centers.copy(), robot.inertias.copy()
    centers[-1], inertias[-1] = A.T @ (np.array([0.0, 0.0, 0.1]) - a), inertia * np.eye(3)
    return replace(robot, centers=centers, inertias=inertias)


@pytest.mark.parametrize('method', sorted(set(ALL_METHODS) - {'constraint_forces'}))
def test_an_arm_that_is_singular_up_to_rounding_has_one_status_of_all_methods(method: str) -> None:
    state = np.random.default_rng(6).normal(size=(3, 4))
    run = pfd.emulate(tip_on_its_axis(0.0), *state, method=method)
    assert run.status == 'not_positive_definite'
    light = pfd.emulate(tip_on_its_axis(1e-8), *state, method=method)
    assert light.status != 'not_positive_definite'


@pytest.mark.parametrize(
    ('method', 'chain', 'digits'),
    [
        ('constraint_forces', (6, 'masses over 8 decades', 2), 1e-8),
        ('divide_and_conquer', (4, 'heavy tip', 27), 1e-11),
    ],
)
def test_a_direct_method_that_loses_more_digits_than_the_condition_is_inaccurate(
    method: str, chain: tuple[int, str, int], digits: float
) -> None:
    lost, kept = conjugate.statuses_of(chain, (method, 'pcrbm'))
    assert lost['error'] > max(digits, lost['allowed'])
    assert (lost['status'], kept['status']) == ('inaccurate', 'ok')


@pytest.mark.parametrize('name', ['panda', 'puma560'])
def test_at_rest_on_an_upright_arm_an_answer_of_rounding_is_ok(name: str) -> None:
    robot = pfd.load_robot(name)
    for turn in (0.0, 0.7):
        q = np.zeros(robot.n)
        q[0] = turn
        hold = pfd.inverse_dynamics(robot, q, 0 * q, 0 * q)
        for tau in (hold, 0 * q):
            run = pfd.emulate(robot, q, 0 * q, tau)
            assert run.status == 'ok', (turn, run.error)


@pytest.mark.parametrize('kind', [np.float32, np.longdouble])
def test_digits_take_numbers_of_any_type_whatever_the_format_of_the_machine(kind: Any) -> None:
    robot, q = uniform_chain(2), [0.5, 0.25]
    wanted = pfd.emulate(robot, q, q, q, digits=20)
    run = pfd.emulate(robot, [*map(kind, q)], q, kind(q), digits=20, dtype='float32')
    assert (*run.qdd, run.allowed) == (*wanted.qdd, wanted.allowed)


@pytest.mark.parametrize('method', methods.ITERATIVE + METHODS[1:])
def test_an_arm_that_nothing_accelerates_takes_no_iteration(method: str) -> None:
    robot, zero = uniform_chain(3), np.zeros(3)
    run = pfd.emulate(robot, zero + 1, zero, zero, method=method, scene=pfd.Scene(gravity=None))
    assert (run.status, run.iterations) == ('ok', 0)
    assert run.steps == run.program.count(iterations=0)
    assert run != pfd.emulate(robot, zero, zero, zero)
    assert len(repr(run)) < 4000


@pytest.mark.parametrize('method', ALL_METHODS)
def test_methods_that_take_rotations_as_they_are_have_all_digits(method: str) -> None:
    robot = random_chain(np.random.default_rng(7), 3)
    state = np.random.default_rng(8).normal(size=(3, 3))
    exact = pfd.emulate(robot, *state, digits=60).qdd
    run = pfd.emulate(robot, *state, method=method, digits=40)
    off = float(abs(run.qdd - exact).max() / abs(exact).max())
    orthogonal = method in methods.SERIAL or method in (
        'articulated_body_doubling',
        'constraint_forces',
    )
    # Rotations are orthogonal up to rounding only; `error` shows it.
    assert 1e-18 < off < 1e-12 if orthogonal else off < 1e-30
    assert abs(run.error - off) <= 0.1 * off + 1e-30
    assert run.status == 'ok'
