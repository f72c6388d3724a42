# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Where each equation and procedure of Lee and Chang (1987) is implemented, and what tests it.

A test checks that every equation of the paper is here, that the functions and tests exist, that
the function's module cites the equation, and that the test's file uses this module or a method
that contains it.
"""

from __future__ import annotations

from dataclasses import dataclass

PAPER = 'pfd_core.algorithms.paper.'
PCRBM_1987 = PAPER + 'pcrbm_1987:'
PATTERNS = 'pfd_core.machine.patterns:'
CLOSED = 'test_algorithms_1987.py::test_pcrbm_of_1987_has_its_closed_forms'
PINOCCHIO = 'test_algorithms_methods.py::test_random_chains_agree_with_pinocchio'


@dataclass(frozen=True)
class Implemented:
    """
    An equation or procedure of the paper.

    Attributes
    ----------
    names : tuple of str
        Numbers of equations, without brackets, or the name of a procedure.
    text : str
        What it computes.
    function : str
        module:function.
    test : str
        File and function of the test.

    """

    names: tuple[str, ...]
    text: str
    function: str
    test: str


EQUATIONS = (
    Implemented(
        ('1',),
        'torques from accelerations',
        'pfd_core.algorithms.programs:record_inverse_dynamics',
        'test_algorithms_physics.py::'
        'test_terms_and_inverse_dynamics_of_random_chains_agree_with_pinocchio',
    ),
    Implemented(
        ('2.a', '2.b'),
        'H qdd = tau - b',
        'pfd_core.algorithms.chain.equations:forward_equations',
        'test_algorithms_physics.py::test_torque_is_recovered_from_the_accelerations_it_causes',
    ),
    Implemented(
        ('3', '4'),
        'FOIHRA',
        PATTERNS + 'prefix_affine',
        'test_machine_patterns.py::test_foihra_solves_the_recurrence_for_any_n',
    ),
    Implemented(
        ('5', '6', '7'),
        'row sweeping',
        PATTERNS + 'row_sweep',
        'test_machine_patterns.py::test_the_row_sweep_adds_up_columns_from_the_diagonal',
    ),
    Implemented(
        ('8.a', '8.b', '9.a', '9.b', '10'),
        'forces and moments of a column of H',
        PAPER + 'pcrbm:rows_of_moments',
        CLOSED,
    ),
    Implemented(
        ('11', '12'),
        'Cholesky as printed',
        PAPER + 'set_ordering:record_literal_cholesky',
        'test_algorithms_set_ordering.py::test_the_program_is_equations_11_and_12',
    ),
    Implemented(
        ('13',),
        'orientations, FOHRA',
        PCRBM_1987 + 'fohra',
        CLOSED,
    ),
    Implemented(
        ('14',),
        'axes, vectors and inertias',
        'pfd_core.algorithms.chain.base_axes:pose',
        PINOCCHIO,
    ),
    Implemented(
        ('15', '16', '17', '18', '19', '20'),
        'composite bodies',
        PCRBM_1987 + '_composite_bodies',
        CLOSED,
    ),
    Implemented(
        ('21', '22'),
        'force and moment of a unit acceleration',
        PCRBM_1987 + '_forces',
        'test_algorithms_1987.py::test_step_6_as_printed_is_wrong_only_for_sliding_joints',
    ),
    Implemented(('23',), 'moment at the own joint', PCRBM_1987 + 'record_pcrbm_1987', CLOSED),
    Implemented(('24', '25', '26'), 'elements of H', PAPER + 'pcrbm:rows_of_moments', CLOSED),
    Implemented(
        ('27',),
        'bias, NE1',
        PAPER + 'newton_euler:newton_euler',
        'test_algorithms_physics.py::'
        'test_terms_and_inverse_dynamics_of_random_chains_agree_with_pinocchio',
    ),
    Implemented(('28',), "the solve, L L'", PCRBM_1987 + 'record_pcrbm_1987', PINOCCHIO),
    Implemented(
        ('29', '30', '31'),
        'the array as printed',
        PAPER + 'literal_array:literal_array',
        'test_algorithms_triangular_array.py::'
        'test_the_literal_design_takes_3n_minus_1_cycles_for_equations_11_and_12',
    ),
    Implemented(
        ('A.1', 'A.2', 'A.3'),
        'composite bodies, as (15) to (20)',
        PCRBM_1987 + 'record_pcrbm_1987',
        'test_algorithms_1987.py::test_equations_of_appendix_a_as_printed_are_wrong',
    ),
    Implemented(
        ('A.4', 'A.5', 'A.6', 'A.7', 'A.8'),
        'elements of H, as (21) to (26)',
        PCRBM_1987 + 'record_pcrbm_1987',
        'test_algorithms_1987.py::test_equations_of_appendix_a_as_printed_are_wrong',
    ),
)
PROCEDURES = (
    Implemented(
        ('FOHRA',),
        'section 2.2; at the price of item (a) in paper.fohra_first_level',
        PATTERNS + 'prefix',
        'test_machine_patterns.py::test_fohra_multiplies_matrices_in_order',
    ),
    Implemented(
        ('FOIHRA',),
        'section 2.2',
        PATTERNS + 'prefix_affine',
        'test_machine_patterns.py::test_foihra_solves_the_recurrence_for_any_n',
    ),
    Implemented(
        ('Row-Sweeping',),
        'section 2.3',
        PATTERNS + 'row_sweep',
        'test_machine_patterns.py::test_the_row_sweep_adds_up_columns_from_the_diagonal',
    ),
    Implemented(
        ('Set-Ordering',),
        'section 2.4, Appendix C',
        PAPER + 'set_ordering:set_ordering',
        'test_algorithms_set_ordering.py::test_appendix_c_comes_out_set_by_set',
    ),
    Implemented(
        ('Parallel-Cholesky-Factorization',),
        'section 2.4; correct in paper.cholesky',
        PAPER + 'set_ordering:record_literal_cholesky',
        'test_algorithms_set_ordering.py::test_the_program_is_equations_11_and_12',
    ),
    Implemented(
        ('column sweep',),
        'section 2.4',
        PATTERNS + 'column_sweep',
        'test_machine_patterns.py::test_the_column_sweep_solves_triangular_systems',
    ),
    Implemented(
        ('NE1',),
        'section 2.5',
        PAPER + 'newton_euler:newton_euler',
        'test_algorithms_variants.py::test_ne_as_a_whole_is_pose_and_ne1',
    ),
    Implemented(('PCRBM',), 'section 2.5', PCRBM_1987 + 'record_pcrbm_1987', CLOSED),
    Implemented(
        ('triangular array',),
        'section 2.6; corrected in paper.triangular_array',
        PAPER + 'literal_array:literal_array',
        'test_algorithms_triangular_array.py::'
        'test_the_literal_design_takes_3n_minus_1_cycles_for_equations_11_and_12',
    ),
    Implemented(
        ('PCGM',),
        'section 3, Appendix B',
        PAPER + 'pcgm_1987:record_pcgm_1987',
        'test_algorithms_1987.py::test_pcgm_of_1987_has_its_closed_forms',
    ),
)
