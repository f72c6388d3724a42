# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fill the blocks of README.md and the guides from docs/report: `python benchmarks/readme.py`."""

from __future__ import annotations

from pathlib import Path

from pfd_core.report import blocks

if __name__ == '__main__':
    print('\n'.join(map(str, blocks.fill(Path(__file__).resolve().parent.parent))))
