# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errata of Lee and Chang (1987): each misprint executed as printed, and its effect measured.

Effects on qdd are relative to the largest acceleration of a state: the median over STATES states
of a PUMA 560, and of a chain of revolute and prismatic joints in turn. Conjugate gradients run in
50 digits, where n iterations give the answer.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.paper import pcgm_1987, pcrbm_1987
from pfd_core.algorithms.paper.literal_array import literal_array
from pfd_core.algorithms.paper.pcgm_1987 import record_pcgm_1987
from pfd_core.algorithms.paper.pcrbm_1987 import record_pcrbm_1987
from pfd_core.algorithms.paper.set_ordering import set_ordering
from pfd_core.algorithms.programs import FORWARD, record_terms
from pfd_core.machine.emulator import run
from pfd_core.machine.patterns import prefix_affine
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Robot, Scene, load_robot, resolve
from pfd_core.report.cases.paper import TABLE, levels, value
from pfd_core.report.cases.robots import uniform_chain
from pfd_core.report.measure.differences import differences

Array = NDArray[Any]
STATES, SEED = 20, 1987
FEW = 3  # states in 50 digits
ROUNDING = 1e-12


@dataclass(frozen=True)
class Erratum:
    """
    A misprint of the paper.

    Attributes
    ----------
    place : str
        Equation, step or section.
    printed, wrong, right : str
        The printed form, why it is wrong, and the right form.
    effect : callable
        effect() runs it as printed and returns the result in words.
    test : str
        File and function of the test that shows it.

    """

    place: str
    printed: str
    wrong: str
    right: str
    effect: Callable[[], str]
    test: str


def robots() -> tuple[Robot, Robot]:
    """Return a PUMA 560, and a chain whose joints rotate and slide in turn."""
    types = ('revolute', 'prismatic') * 3
    return load_robot('puma560'), replace(uniform_chain(6), name='sliding6', joint_types=types)


def state(count: int = STATES) -> dict[str, Array]:
    """Return positions, velocities and torques of six joints, (count, 6) each."""
    unit = 2 * np.random.default_rng(SEED).random((3, count, 6)) - 1
    return {'q': np.pi * unit[0], 'qd': 2 * unit[1], 'tau': 5 * unit[2]}


def errors(found: Array, wanted: Array) -> str:
    """Return the median error of qdd, NaN counted apart."""
    off = differences(found, wanted)
    undefined = ~np.isfinite(off.astype(float))
    if undefined.all():
        return 'NaN'
    share = f', NaN in {undefined.sum()} of {len(off)} states' if undefined.any() else ''
    median = float(np.median(off[~undefined].astype(float)))
    return (f'{median:.0e}' if median > ROUNDING else 'rounding') + share


def _executed(program: Program, inputs: dict[str, Array], digits: int | None = None) -> Array:
    with np.errstate(all='ignore'):
        result: Array = run(program, inputs, digits=digits)['qdd']
    return result


def _on_each(effect: Callable[[Robot], str]) -> str:
    return '; '.join(f'{robot.name}: {effect(robot)}' for robot in robots())


def pcrbm_error(misprints: Collection[str]) -> str:
    """Return the error of qdd of PCRBM with some misprints."""

    def effect(robot: Robot) -> str:
        plant, inputs = resolve(robot), state()
        program = record_pcrbm_1987(plant, 'parallel', misprints=misprints)
        wanted = _executed(FORWARD['pcrbm'](plant, 'parallel'), inputs)
        return errors(_executed(program, inputs), wanted)

    return 'qdd off by ' + _on_each(effect)


def pcgm_error(misprints: Collection[str]) -> str:
    """Return the error of qdd of PCGM from an estimate x_0, with some misprints, in 50 digits."""

    def effect(robot: Robot) -> str:
        plant, inputs = resolve(robot), state(FEW)
        inputs['start'] = np.random.default_rng(SEED).random((FEW, 6))
        program = record_pcgm_1987(plant, 'parallel', misprints=misprints, start=True)
        wanted = _executed(FORWARD['pcrbm'](plant, 'parallel'), inputs, 50)
        return errors(_executed(program, inputs, 50), wanted)

    return 'qdd off by ' + _on_each(effect)


def gravity_error(gravity: float) -> str:
    """Return the error of qdd under this gravity along -z instead of 9.81 m/s^2."""

    def effect(robot: Robot) -> str:
        scenes = Scene(gravity=(0.0, 0.0, -gravity)), Scene()
        found, wanted = (
            _executed(FORWARD['pcrbm'](resolve(robot, scene), 'parallel'), state())
            for scene in scenes
        )
        return errors(found, wanted)

    return 'qdd off by ' + _on_each(effect)


def recurrence_error() -> str:
    """Return the error of x_n of FOIHRA with matrix coefficients in the order of (3)."""
    n = 6
    numbers = np.random.default_rng(SEED).normal(size=(STATES, n, 12))

    def result(literal: bool) -> Array:
        recorder = Recorder(n)
        rows = [recorder.input('x', [12 * i + k for i in range(n)]) for k in range(12)]
        a, b = array(rows[:9]).reshape(3, 3), array(rows[9:])
        x = prefix_affine(
            a, b, lambda k, v: k @ v, (lambda k, kk: kk @ k) if literal else lambda k, kk: k @ kk
        )
        recorder.output('qdd', (3,), [(component, n - 1) for component in x])
        return _executed(recorder.program(), {'x': numbers.reshape(STATES, -1)})

    return f'x_6 off by {errors(result(True), result(False))}, scalar coefficients: none'


def array_status() -> str:
    """Return the status of the array as printed for the inertia matrices of arms."""

    def effect(robot: Robot) -> str:
        program = record_terms(resolve(robot), 'parallel')
        found = run(program, {'q': state()['q'], 'qd': np.zeros((STATES, 6))})['H']
        status = [literal_array(H).result.status for H in found]
        kinds = (f'{status.count(kind)} {kind.replace("_", " ")}' for kind in sorted(set(status)))
        return ', '.join(kinds)

    return f'of {STATES} matrices ' + _on_each(effect)


def loop_cost() -> str:
    """Return the additional cost of the loop as printed, in six iterations."""
    plant = resolve(uniform_chain(6))
    one, other = (
        record_pcgm_1987(plant, 'parallel', misprints=misprints).count(iterations=6)
        for misprints in ((pcgm_1987.STEP_16,), ())
    )
    more = one - other
    return f'none on qdd; 6 joints take {more.multiplications} and {more.additions} steps more'


def ordering_cost() -> str:
    """Return the additions that set ordering takes, and the paper's two counts."""
    taken = len(set_ordering(6)) - 1
    return f'none on L; {taken} additions at n = 6, where the paper has 15 and {value("P2", 6)}'


def formula(system: str, kind: str) -> str:
    """Return a printed value of Table 1 and the value of its formula."""
    claim = getattr(TABLE[system], kind)
    return f'{float(claim.formula(6)):g} by the formula, {claim.printed} printed'


OWN, COUNTS = 'test_algorithms_1987.py::test_', 'test_report_counts.py::test_'
ERRATA_TESTS = 'test_report_errata.py::test_'
AT_SIX = COUNTS + 'the_formulas_at_six_joints_are_those_of_the_paper'
ERRATA = (
    Erratum(
        'eq. (3)',
        'X(i - s) * X(i), s = 2^(k-1)',
        'with (4) the coefficients are applied from the left',
        'X(i) * X(i - s) for matrix coefficients',
        recurrence_error,
        ERRATA_TESTS + 'the_order_of_equation_3_is_wrong_for_matrices',
    ),
    Erratum(
        'section 2.2',
        's = ceil(log2(n + 1)) levels',
        'PCRBM has n elements and needs ceil(log2 n) levels, as in the counts',
        's = ceil(log2 n)',
        lambda: f'none; {levels(9)} levels instead of {levels(8)} at n = 8',
        'test_machine_patterns.py::'
        'test_foihra_of_vectors_with_scalar_coefficients_takes_4_levels_less_one',
    ),
    Erratum(
        'eqs (11), (12)',
        'h_ij h_kj, h_ii',
        'products and divisors are elements of H, not of L',
        'l_ij l_kj, l_ii, column after column',
        partial(pcrbm_error, (pcrbm_1987.CHOLESKY,)),
        OWN + 'cholesky_as_printed_gives_no_arm_its_accelerations',
    ),
    Erratum(
        'section 2.4',
        'n(n - 1)/2 additions of set ordering, and ceil((n^2 - 1)/2) in item (b)',
        'each parallel addition serves n sets',
        'ceil((n^2 - 1)/6)',
        ordering_cost,
        'test_algorithms_set_ordering.py::test_the_literal_factorisation_takes_the_steps_of_its_parts',
    ),
    Erratum(
        'section 2.5 (c)',
        'g = 9.869621 m/s^2',
        'on the surface of the Earth gravity is 9.78 to 9.83 m/s^2',
        '9.81 m/s^2',
        partial(gravity_error, 9.869621),
        ERRATA_TESTS + 'another_gravity_and_its_sign_change_the_accelerations',
    ),
    Erratum(
        'section 2.5 (c)',
        "p''_0 = g",
        'if g is the vector of gravity, the base accelerates against it',
        "p''_0 = -g",
        partial(gravity_error, -9.81),
        ERRATA_TESTS + 'another_gravity_and_its_sign_change_the_accelerations',
    ),
    Erratum(
        'step 6, eq. (21)',
        'F_j and N_j of a rotational joint',
        'the translational branch of Appendix A is missing',
        'F_j = M_j z_(j-1), N_j = 0 for a translational joint',
        partial(pcrbm_error, (pcrbm_1987.STEP_6,)),
        OWN + 'step_6_as_printed_is_wrong_only_for_sliding_joints',
    ),
    Erratum(
        'eq. (A.3)',
        'M_j [...]',
        'the first bracket belongs to the links j + 1 to n',
        'M_(j+1) [...], as in (19)',
        partial(pcrbm_error, (pcrbm_1987.A_3,)),
        OWN + 'equations_of_appendix_a_as_printed_are_wrong',
    ),
    Erratum(
        'eq. (A.8)',
        'if joint j is rotational',
        'row i belongs to joint i',
        'if joint i is rotational, as in (26)',
        partial(pcrbm_error, (pcrbm_1987.A_8,)),
        OWN + 'equations_of_appendix_a_as_printed_are_wrong',
    ),
    Erratum(
        'Appendix C',
        'S_42^(2), NS, a_32^(1) in the sums of S_33, sets S_44 and S_32 in step 6',
        'the sets themselves are right',
        'S_42^(4), NA, a_33^(1), S_44 and S_22',
        lambda: 'none',
        'test_algorithms_set_ordering.py::test_appendix_c_comes_out_set_by_set',
    ),
    Erratum(
        'eqs (29) to (31)',
        'h_im h_km, 1/h_ii',
        'as (11), (12)',
        'l_im l_km, 1/l_ii; 3 n - 2 cycles instead of 3 n - 1',
        array_status,
        'test_algorithms_triangular_array.py::'
        'test_the_literal_design_takes_3n_minus_1_cycles_for_equations_11_and_12',
    ),
    Erratum(
        'section 3, step 4',
        'w_0 = tau - b for any estimate x_0',
        'the residual of x_0 lacks H x_0',
        'w_0 = tau - b - H x_0',
        partial(pcgm_error, (pcgm_1987.STEP_4,)),
        OWN + 'step_4_as_printed_gives_the_answer_plus_the_estimate',
    ),
    Erratum(
        'section 3, step 7',
        'x_1 = tau of NE1',
        'H u overwrites the iterate',
        't = tau of NE1',
        partial(pcgm_error, (pcgm_1987.STEP_7,)),
        OWN + 'step_7_as_printed_loses_the_iterate',
    ),
    Erratum(
        'section 3, step 16',
        'go to step 5',
        'step 5 repeats the inner product of step 12',
        'go to step 7',
        loop_cost,
        OWN + 'pcgm_of_1987_has_its_closed_forms',
    ),
    Erratum(
        'section 2.5',
        '2 n in the multiplications of PCRBM',
        'item (e) has 4 n',
        '4 n, as in Table 1',
        lambda: (
            f'{value("P6 + 2 n + 10 h + 31 L + 170", 6)} instead of '
            f'{TABLE["pcrbm"].multiplications.formula(6)} at n = 6'
        ),
        COUNTS + 'the_parts_of_the_paper_sum_to_what_adding_them_by_hand_gives',
    ),
    Erratum(
        'Table 1, PCRBM',
        '334 and 328',
        'no formula of the paper gives these values',
        'unexplained',
        lambda: '; '.join(formula('pcrbm', kind) for kind in ('multiplications', 'additions')),
        AT_SIX,
    ),
    Erratum(
        'section 1',
        '1629 multiplications of method 3',
        'Table 1 and section 2.5 have 1627',
        '1627',
        partial(formula, 'walker_orin_3', 'multiplications'),
        AT_SIX,
    ),
    Erratum(
        'Table 1, method 1',
        '114 1/2 n',
        'not an integer for every n, and not the printed value',
        '114 1/3 n',
        partial(formula, 'walker_orin_1', 'multiplications'),
        AT_SIX,
    ),
    Erratum(
        'Table 1, method 2',
        '151 1/2 n',
        'not an integer for every n, and not the printed value',
        '151 1/3 n',
        partial(formula, 'walker_orin_2', 'multiplications'),
        AT_SIX,
    ),
    Erratum(
        'Table 1, method 4',
        '76 1/2 n^2 + 12 n - 21',
        'does not give the printed value',
        '117 n gives the printed value',
        partial(formula, 'walker_orin_4', 'multiplications'),
        AT_SIX,
    ),
    Erratum(
        'Table 1, articulated bodies',
        '2280 and 1816; 2250 in the introduction',
        'the formulas 380 n - 198 and 302 n - 173 give other values',
        'unexplained; 2280 is 380 n',
        lambda: '; '.join(
            formula('articulated_body', kind) for kind in ('multiplications', 'additions')
        ),
        AT_SIX,
    ),
)
