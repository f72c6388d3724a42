# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lee and Chang 1987 on n lanes, corrected and as printed, and later parallel methods.

The machine that the paper supposes:

    lanes       data moved between lanes, elements by name, rows packed onto full rows of lanes
    patterns    recurrences (FOHRA, FOIHRA), totals, row and column sweeps
    networks    networks that join the lanes; the steps of a program on each
    systolic    clocked array of cells

The paper's procedures, in any edition:

    editions       our form, the paper's form, and every misprint that can be executed
    chain          links and their pose, for twists of 0 and 90 degrees at the paper's price
    newton_euler   NE1: the equations of motion, torques, H times a vector
    composite      PCRBM: H by composite bodies, about the joints or the origin of the base
    solve          Cholesky, L L' and L D L', with column sweeps; Procedure Set-Ordering and
                   Cholesky as printed
    conjugate      PCGM: conjugate gradients
    array          the triangular array, corrected and as printed

Since then, and for all of them:

    articulated_doubling   articulated bodies by recursive doubling: steps that grow as log2 n
    divide_and_conquer     the same order by joining pieces of the chain in pairs
    constraint_forces      the same order by odd-even elimination of the joints' constraint forces
    emulate                pfd.emulate: a method on the emulated machine; steps, status

From an equation to its function:

    (1)                  newton_euler.record_inverse_dynamics
    (2.a), (2.b)         newton_euler.forward_equations
    (3), (4)             patterns.prefix_affine, suffix_affine
    (5) to (7)           patterns.row_sweep
    (8.a) to (10)        composite.inertia_matrix
    (11), (12)           solve.cholesky; as printed solve.literal_factor
    (13)                 patterns.product; chain.product_of_right_angles
    (14)                 chain.chain_on_lanes
    (15) to (20)         composite._composite_bodies
    (21), (22)           composite._forces: F_j and N_j of one joint serve all f_ij
    (23)                 composite.composite_forces
    (24) to (26)         composite.inertia_matrix
    (27)                 newton_euler.torques
    (28)                 composite.record_pcrbm, solve.solve
    (29) to (31)         array.circular, square; as printed array.printed_circular, printed_square
    Appendix A           composite, with the misprints (A.3) and (A.8) of editions
    section 3, App. B    conjugate.record_pcgm
    Appendix C           solve.set_ordering
"""
