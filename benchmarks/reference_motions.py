# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Compute the references of the hard motions, and write them into motion_references.yaml.

    python benchmarks/reference_motions.py [NAME ...]
"""

from __future__ import annotations

from pathlib import Path
import sys

import yaml

from pfd_core import report
from pfd_core.report.cases.motions import MOTIONS, REFERENCES
from pfd_core.report.measure.extrapolation import computed

PATH = Path(report.__file__).parent / 'data' / 'motion_references.yaml'


def main(names: list[str]) -> None:
    """Compute the named motions, or all; the others are kept."""
    found = dict(REFERENCES)
    for motion in MOTIONS:
        if not names or motion.name in names:
            found[motion.name] = computed(motion)
            print(motion.name, found[motion.name].self_difference, flush=True)
    head = PATH.read_text(encoding='utf-8').partition('\n\n')[0]
    rows = {
        motion.name: {
            'self_difference': float(f'{found[motion.name].self_difference:.1e}'),
            'q': list(found[motion.name].q),
        }
        for motion in MOTIONS
        if motion.name in found
    }
    text = yaml.safe_dump(rows, sort_keys=False)
    PATH.write_text(f'{head}\n\n{text}', encoding='utf-8')


if __name__ == '__main__':
    main(sys.argv[1:])
