# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The methods of the paper, those it compares with, and others, each once as text over lanes."""
