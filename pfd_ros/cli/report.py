# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report`: tables and plots, measured here and now."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

REPORTS = {
    'counts': 'counts: steps of every method beside what the paper claims',
    'speed': 'speed: times beside those of other libraries, some ten minutes',
    'hard-cases': 'hard-cases: errors where forward dynamics is hard to compute, some ten minutes',
}
HELP = 'tables and plots, measured here and now'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the kind of report and the folder."""
    parser.add_argument('what', choices=REPORTS, help='; '.join(REPORTS.values()))
    parser.add_argument(
        '--out', type=Path, help='folder for the pages; default ./pfd_report', metavar='DIR'
    )
    parser.add_argument(
        '--against-error',
        action='store_true',
        help='speed: time against error of every method, integrator and peer, some ten minutes',
    )
    parser.add_argument('--quick', action='store_true', help='speed: a few turns only')


def run(given: argparse.Namespace) -> int:
    """Measure, write the pages and print their paths."""
    from pfd_core.report import against_error_pages, counts_pages, hard_case_pages, speed_pages

    folder = given.out or Path('pfd_report')
    if given.what == 'speed':
        run_speed = against_error_pages.run if given.against_error else speed_pages.run
        return run_speed(folder, quick=given.quick)
    if given.against_error or given.quick:
        print('pfd report: --against-error and --quick are for speed', file=sys.stderr)
        return 2
    pages = hard_case_pages if given.what == 'hard-cases' else counts_pages
    print('\n'.join(str(page) for page in pages.run(folder)))
    return 0
