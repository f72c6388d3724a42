# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every tolerance of the suite that more than one file uses, and its cause."""

# H, bias and torque of chains of up to 12 skew links, relative to the largest element. Both
# sides sum some hundred rounded terms about different points: seen up to 4e-14.
DYNAMICS = 1e-12

# qdd relative to the largest element, times the condition number of H after Jacobi scaling:
# solving H qdd = y multiplies the rounding of H by just that number, and no less.
ACCELERATION = 1e-12

# The same in single precision, whose rounding is 2^29 times larger.
SINGLE = DYNAMICS * 2.0**29

# 50-digit arithmetic against itself over some thousand operations.
FIFTY_DIGITS = 1e-45

# Hard cases of arms whose rotation matrices, rounded to float64, are not exactly orthogonal, and
# how far methods in other frames then differ in 50 digits: some roundings, seen up to 2.8e-15.
NOT_ORTHOGONAL = ('ordinary_so100', 'ordinary_so101', 'ordinary_xarm7')
ROUNDED_FRAMES = 1e-14
