# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lee and Chang 1987 on n lanes: the machine that the paper supposes.

    lanes       data moved between lanes
    patterns    recurrences (FOHRA, FOIHRA), totals, row and column sweeps
    networks    networks that join the lanes; the steps of a route on each
    prices      the time of arithmetic for weights of operations
    systolic    clocked array of cells, for the triangular array
"""
