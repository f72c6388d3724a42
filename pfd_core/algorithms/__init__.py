# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The paper, written once as text over lanes."""
