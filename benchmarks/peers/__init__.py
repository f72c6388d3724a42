# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ways of the same work: this library, Pinocchio, CasADi, MuJoCo and others."""
