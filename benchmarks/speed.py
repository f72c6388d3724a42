# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed against the peers: `python benchmarks/speed.py [ROBOT ...] [--quick] [--out DIR]`.

The same as `pfd report speed`; with names of arms, chainN or denseN for these only, and forward
dynamics alone.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from pfd_core.report import speed_pages
from pfd_core.report.measure import speed


def main() -> int:
    parser = argparse.ArgumentParser(description='Speed of forward dynamics against the peers.')
    parser.add_argument('robots', nargs='*', metavar='ROBOT', help='e.g. ur5 chain30 dense7')
    parser.add_argument('--quick', action='store_true', help='a few turns only')
    parser.add_argument('--out', type=Path, default=Path('pfd_report'), metavar='DIR')
    asked = parser.parse_args()
    plan = speed.QUICK if asked.quick else speed.Survey()
    if asked.robots:
        plan = replace(plan, robots=tuple(asked.robots), others=None)
    print('\n'.join(map(str, speed_pages.run(asked.out, plan=plan))))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
