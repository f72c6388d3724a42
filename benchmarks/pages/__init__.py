# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pages: `measure` returns rows, `text` and `plots` show them."""
