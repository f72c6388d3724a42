# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report`: tables and plots, measured here and now."""

from __future__ import annotations

import argparse
from pathlib import Path

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


def run(given: argparse.Namespace) -> int:
    """Measure, write the pages and print their paths."""
    from pfd_core.report import counts_pages, hard_case_pages, speed_pages

    folder = given.out or Path('pfd_report')
    if given.what == 'speed':
        return speed_pages.run(folder)
    pages = hard_case_pages if given.what == 'hard-cases' else counts_pages
    print('\n'.join(str(page) for page in pages.run(folder)))
    return 0
