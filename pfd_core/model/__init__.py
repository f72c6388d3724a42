# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is simulated: a serial chain and the effects a scene switches on."""
