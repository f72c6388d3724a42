# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The first picture of README.md: `python benchmarks/controlled_arm.py [--measure]`.

Writes the page, the picture and the block of README.md from docs/report/controlled-arm.json;
with --measure that file first, as `pfd report controlled-arm` does, in some minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pfd_core.report import controlled_arm_pages

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    parser = argparse.ArgumentParser(description='The first picture of README.md.')
    parser.add_argument('--measure', action='store_true', help='measure on this machine first')
    if parser.parse_args().measure:
        controlled_arm_pages.run(ROOT / 'docs' / 'report')
    print('\n'.join(str(path) for path in controlled_arm_pages.publish(ROOT)))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
