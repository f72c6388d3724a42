# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lee and Chang 1987, corrected where the paper errs; each procedure whole in its file.

The modules of 1987 are the paper's own forms, for comparison with it; the others are cheaper.

    newton_euler        NE1: joint torques, hence the bias; eq. (27)
    pcrbm               PCRBM: H by composite bodies, eqs (15) to (26), and the whole program
    cholesky            H = L D L' or L L' and the solve on n lanes; section 2.4
    elimination_order   orders of elimination: the products that n lanes form in each step
    fohra_first_level   FOHRA for 0R_i at the price of item (a): twists of 0 and 90 degrees
    pcrbm_1987          Procedure PCRBM step by step, eqs (13) to (28), with NE1 and Cholesky
    pcgm_1987           Procedure PCGM step by step, n iterations
    pcgm                PCGM: conjugate gradients, H u by NE1, and the whole program; section 3,
                        Appendix B
    pcrbm_array         PCRBM with the solve on the triangular array: the whole program
    triangular_array    the cells and the clock of the corrected array; section 2.6
    array_solver        the array on numbers: factor, solve, pipeline
    set_ordering        Procedure Set-Ordering and eqs (11), (12) as printed; Appendix C
    literal_array       eqs (11), (12) run on numbers; the array of eqs (29) to (31) as printed
"""
