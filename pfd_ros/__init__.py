# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stand-in robot arm on ROS 2: the node, its recordings and the `pfd` command."""
