# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PCRBM and PCGM of 1987 step by step: right answers, counts by equation, misprints that show."""

from __future__ import annotations

import math

from bridge import (
    FORWARD_METHODS,
    MISPRINTS_AS_PRINTED,
    MISPRINTS_OF,
    PCGM_STEP_4,
    PCGM_STEP_7,
    PCRBM_A_3,
    PCRBM_A_8,
    PCRBM_CHOLESKY,
    PCRBM_STEP_6,
    record_pcgm_1987,
    record_pcrbm_1987,
    resolve_plant,
    run_program,
)
from closed_forms import (
    EVERY_SIZE,
    Counts,
    arithmetic,
    by_section,
    chain,
    levels,
)
import mpmath
import numpy as np
from oracle import Oracle, error, relative
import pytest
from tolerances import ACCELERATION
from zoo import random_chain, random_state, right_angled

from benchmarks.cases.robots import uniform_chain
import pfd_core as pfd

METHODS = ('pcrbm_1987', 'pcgm_1987')
RIGHT_ANGLED = pfd.Scene(external_wrench=True, damping='model', armature='model', brakes=True)


def test_the_methods_of_1987_are_emulated_by_name() -> None:
    robot = pfd.load_robot('planar2')
    state = np.random.default_rng(2).normal(size=(3, 2))
    wanted = Oracle(robot).qdd(*state)
    for method in METHODS:
        found = pfd.emulate(robot, *state, method=method)
        assert found.status == 'ok'
        assert relative(found.qdd, wanted) < 1e-10
    assert pfd.emulate(robot, *state, method='pcgm_1987').iterations == 2


@pytest.mark.parametrize('n', [1, 2, 4, 6])
def test_n_iterations_of_1987_are_the_answer_in_fifty_digits(n: int) -> None:
    # Directions lose their orthogonality by rounding: seen up to 1e-38.
    robot, given = right_angled(n)
    given['free'] = (np.arange(n) % 3 != 1).astype(float)
    plant = resolve_plant(robot, RIGHT_ANGLED)
    wanted = run_program(FORWARD_METHODS['pcrbm'](plant, 'parallel'), given, digits=50)['qdd']
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
    wanted = record(resolve_plant(robot), 'parallel', misprints=MISPRINTS_AS_PRINTED[method])
    assert run.program == wanted


def test_one_joint_as_printed_is_right() -> None:
    run = pfd.emulate(chain(1), [0.3], [0.2], [1.0], method='pcrbm_1987', edition='printed')
    assert run.status == 'ok'


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


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda'])
def test_cholesky_as_printed_gives_no_arm_its_accelerations(name: str) -> None:
    robot = pfd.load_robot(name)
    q, qd, tau = random_state(np.random.default_rng(5), robot.n)
    program = record_pcrbm_1987(resolve_plant(robot), 'parallel', misprints=[PCRBM_CHOLESKY])
    with np.errstate(all='ignore'):
        found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})['qdd']
    assert not relative(found, Oracle(robot).qdd(q, qd, tau)) < 0.01  # NaN, or far off


def test_cholesky_as_printed_is_right_for_one_joint_of_unit_inertia() -> None:
    # l_11 = sqrt(h_11) in both; n = 1 has no product.
    robot = chain(1)
    q, qd, tau = random_state(np.random.default_rng(6), 1)
    program = record_pcrbm_1987(resolve_plant(robot), 'parallel', misprints=[PCRBM_CHOLESKY])
    found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})['qdd']
    assert relative(found, Oracle(robot).qdd(q, qd, tau)) < ACCELERATION


def test_step_6_as_printed_is_wrong_only_for_sliding_joints() -> None:
    rng = np.random.default_rng(7)
    for sliding in (False, True):
        robot = chain(4, prismatic=sliding)
        q, qd, tau = random_state(rng, 4)
        program = record_pcrbm_1987(resolve_plant(robot), 'parallel', misprints=[PCRBM_STEP_6])
        with np.errstate(all='ignore'):
            found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})['qdd']
        off = relative(found, Oracle(robot).qdd(q, qd, tau))
        assert not off < 0.01 if sliding else off < 1e-9  # z . F_j = 0 is no pivot: NaN


def test_equations_of_appendix_a_as_printed_are_wrong() -> None:
    # (A.3) for any arm, (A.8) where a joint slides that is not the first of its pairs.
    rng = np.random.default_rng(10)
    for types in (['revolute'] * 4, ['revolute', 'prismatic'] * 2):
        robot = random_chain(rng, 4, joint_types=types)
        q, qd, tau = random_state(rng, 4)
        wanted = Oracle(robot).qdd(q, qd, tau)
        for misprint in (PCRBM_A_3, PCRBM_A_8):
            program = record_pcrbm_1987(resolve_plant(robot), 'parallel', misprints=[misprint])
            with np.errstate(all='ignore'):
                found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})['qdd']
            right = misprint == PCRBM_A_8 and 'prismatic' not in types
            assert (relative(found, wanted) < 1e-3) == right


def test_step_7_as_printed_loses_the_iterate() -> None:
    robot = pfd.load_robot('ur5')
    q, qd, tau = random_state(np.random.default_rng(11), 6)
    given = {'q': q, 'qd': qd, 'tau': tau}
    program = record_pcgm_1987(resolve_plant(robot), 'parallel', misprints=[PCGM_STEP_7])
    assert not relative(run_program(program, given)['qdd'], Oracle(robot).qdd(q, qd, tau)) < 0.01


def test_step_4_as_printed_gives_the_answer_plus_the_estimate() -> None:
    robot = pfd.load_robot('ur5')
    q, qd, tau = random_state(np.random.default_rng(8), 6)
    x0 = np.random.default_rng(9).normal(size=6)
    given = {'q': q, 'qd': qd, 'tau': tau, 'start': x0}
    plant = resolve_plant(robot)
    exact = run_program(FORWARD_METHODS['pcrbm'](plant, 'parallel'), given, digits=50)['qdd']
    with mpmath.workdps(50):
        shifted = exact + x0
    for misprints, wanted in (((), exact), ((PCGM_STEP_4,), shifted)):
        program = record_pcgm_1987(plant, 'parallel', misprints=misprints, start=True)
        assert error(run_program(program, given, digits=50)['qdd'], wanted) < 1e-30


# ---- counts: closed forms, by hand from the equations ----------------------------------------


def pairs(n: int, packed: bool) -> int:
    """Return the rounds of the pairs i < j: n(n-1)/2 on n lanes, or a row each."""
    return math.ceil((n - 1) / 2) if packed else n - 1


def products(n: int, packed: bool) -> int:
    """Return the rounds of the products of Cholesky: (i-1)(n-i+1) of column i."""
    if packed:
        return sum(math.ceil((i - 1) * (n - i + 1) / n) for i in range(2, n + 1))
    return n * (n - 1) // 2


def pcrbm_parts(n: int, packed: bool, literal: bool) -> dict[str, Counts]:
    """Return multiplications, additions, divisions and roots of each section."""
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
    return {section: counts for section, counts in found.items() if any(counts)}


@pytest.mark.sweep
@pytest.mark.parametrize('literal', [False, True])
@pytest.mark.parametrize('schedule', ['parallel', 'unpacked'])
@pytest.mark.parametrize('n', EVERY_SIZE)
def test_pcrbm_of_1987_has_its_closed_forms(n: int, schedule: str, literal: bool) -> None:
    misprints = MISPRINTS_OF['pcrbm_1987'] if literal else ()
    program = record_pcrbm_1987(resolve_plant(chain(n)), schedule, misprints=misprints)
    assert by_section(program) == pcrbm_parts(n, schedule == 'parallel', literal)


def pcgm_parts(n: int, literal: bool) -> dict[str, Counts]:
    """Return multiplications, additions, divisions and roots of each section, one iteration."""
    L = levels(n)
    before = ('joint rotation', 'orientation', 'link vectors', 'newton_euler', 'right-hand side')
    shared = pcrbm_parts(n, False, False)
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
@pytest.mark.parametrize('n', EVERY_SIZE)
def test_pcgm_of_1987_has_its_closed_forms(n: int, literal: bool) -> None:
    misprints = MISPRINTS_OF['pcgm_1987'] if literal else ()
    program = record_pcgm_1987(resolve_plant(chain(n)), 'parallel', misprints=misprints)
    assert by_section(program) == pcgm_parts(n, literal)
    unpacked = record_pcgm_1987(resolve_plant(chain(n)), 'unpacked', misprints=misprints)
    assert unpacked == program  # no pairs, nothing to pack


def test_six_joints_of_1987_take_366_and_351_with_pairs_packed_and_391_and_361_without() -> None:
    # Divisions are multiplications, as in the paper, and R_i is given.
    run = pfd.emulate(uniform_chain(6), *[[0.1] * 6] * 3, method='pcrbm_1987')
    steps = run.steps - run.steps_by_section['joint rotation']
    assert (steps.multiplications + steps.divisions, steps.additions) == (366, 351)
    for schedule, wanted in (('parallel', (366, 351, 6)), ('unpacked', (391, 361, 6))):
        found = arithmetic(record_pcrbm_1987(resolve_plant(chain(6)), schedule).count())
        assert (found[0] + found[2] - 12, found[1] - 6, found[3]) == wanted
