# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Compute the references of the hard motions, and write them into trajectory_references.py.

    python benchmarks/reference_motions.py [NAME ...]
"""

from __future__ import annotations

from pathlib import Path
import sys

from pfd_core.report import trajectory_references
from pfd_core.report.trajectory_cases import MOTIONS
from pfd_core.report.trajectory_references import REFERENCES, Reference, computed

BEGIN, END = 'REFERENCES: dict[str, Reference] = {\n', '}\n# fmt: on\n'


def entry(name: str, reference: Reference) -> str:
    """Return the lines of one motion."""
    angles = ''.join(f"            '{angle}',\n" for angle in reference.q)
    last = f'        {reference.self_difference:.1e},\n'
    return f"    '{name}': Reference(\n        (\n{angles}        ),\n{last}    ),\n"


def main(names: list[str]) -> None:
    """Compute the named motions, or all; the others are kept."""
    found = dict(REFERENCES)
    for motion in MOTIONS:
        if not names or motion.name in names:
            found[motion.name] = computed(motion)
            print(motion.name, found[motion.name].self_difference, flush=True)
    path = Path(trajectory_references.__file__)
    before, _, rest = path.read_text(encoding='utf-8').partition(BEGIN)
    after = rest.partition(END)[2]
    known = [motion.name for motion in MOTIONS if motion.name in found]
    lines = ''.join(entry(name, found[name]) for name in known)
    path.write_text(before + BEGIN + lines + END + after, encoding='utf-8')


if __name__ == '__main__':
    main(sys.argv[1:])
