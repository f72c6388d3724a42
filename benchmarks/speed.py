# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed against the peers: `python benchmarks/speed.py [ROBOT ...] [--quick] [--out DIR]`.

    --publish   measures into docs/report and writes the sentences of README.md and the guide
    --render    the same from the numbers that docs/report/speed.json has, without measuring

The same as `pfd report speed`; with names of arms, chainN or denseN for these only, and forward
dynamics alone.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from pfd_core.report import speed_pages
from pfd_core.report.measure import speed

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    parser = argparse.ArgumentParser(description='Speed of forward dynamics against the peers.')
    parser.add_argument('robots', nargs='*', metavar='ROBOT', help='e.g. ur5 chain30 dense7')
    parser.add_argument('--quick', action='store_true', help='a few turns only')
    parser.add_argument('--out', type=Path, default=Path('pfd_report'), metavar='DIR')
    parser.add_argument(
        '--publish', action='store_true', help='into docs, README.md and the guide'
    )
    parser.add_argument('--render', action='store_true', help='these from docs/report/speed.json')
    asked = parser.parse_args()
    if asked.publish or asked.render:
        if asked.publish:
            speed_pages.run(ROOT / 'docs' / 'report')
        print('\n'.join(str(path) for path in speed_pages.publish(ROOT)))
        return 0
    plan = speed.QUICK if asked.quick else speed.Survey()
    if asked.robots:
        plan = replace(plan, robots=tuple(asked.robots), others=None)
    print('\n'.join(map(str, speed_pages.run(asked.out, plan=plan))))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
