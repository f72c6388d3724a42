# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Dynamics on n lanes: Lee and Chang 1987, corrected and as printed, and later parallel methods.

Subpackages, in the order in which they may import one another:

    chain      links and equations of motion on n lanes
    paper      Lee and Chang 1987, one procedure a file: NE1, PCRBM, PCGM, Cholesky, the array
    beyond     methods on n lanes that the paper does not have

Modules that take any of them:

    programs   inverse dynamics by NE1, H and bias as whole programs
    emulation  pfd.emulate: a method on the emulated machine, with steps, utilisation, status

pfd_core.dynamics.methods names the methods of both packages.
"""
