# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods on n lanes that the paper does not have.

    omega                NE1 with one matrix for all terms of rotation: the bias of fewest steps
    base_origin          H by sums about the origin of the base
    divide_and_conquer   steps that grow as log2 n: the whole program
    constraint_forces    the same order by odd-even elimination of the joints' constraint forces
"""
