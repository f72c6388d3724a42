# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of pfd_core.kernels.threads, until their users import that module."""

from pfd_core.kernels.threads import (
    MAX_BLOCK_WORK,
    BatchWork,
    address,
    block_size,
    run,
    thread_count,
)

__all__ = ['MAX_BLOCK_WORK', 'BatchWork', 'address', 'block_size', 'run', 'thread_count']
