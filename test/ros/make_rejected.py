# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes the recording `rejected.mcap`: bad, late and missing commands, limits and a reflex.

    PYTHONPATH=test python test/ros/make_rejected.py test/data/NAME.mcap

Its findings are stored (test/digests.py). It is not made anew to please a test.
"""

from __future__ import annotations

from pathlib import Path
import sys

from bridge import JointStateEncoder, Source, encode_floats, encode_state
import numpy as np
from rewriting import Recording
from simulating import simulate

NAMES = ('shoulder', 'elbow')
NAN, INFINITY = float('nan'), float('inf')
Command = tuple[Source, bytes]


def array(*efforts: float) -> Command:
    return Source.ARRAY, encode_floats(np.array(efforts))


def named(*efforts: float, stamp: int = 0, names: tuple[str, ...] = NAMES) -> Command:
    rest = np.zeros(len(names))
    return Source.NAMED, JointStateEncoder(names).encode(stamp, rest, rest, np.array(efforts))


def commands() -> dict[int, list[Command]]:
    """Return the messages before each step: 600 good commands, and others between them."""
    sent = {step: [array(12.0, 3.0 + step % 7)] for step in range(5, 605)}
    sent[50].append(array(1.0))
    sent[60].append(array(NAN, NAN))
    sent[70].append(array(INFINITY, 0.0))
    sent[80].append(named(1.0, NAN))
    sent[90].append(named(NAN, NAN))
    sent[100].append(named(1.0, 2.0, stamp=1))
    sent[110].append(named(1.0, names=('nobody',)))
    sent[120].append((Source.NAMED, b'\0\1\0\0' + b'\xff' * 12))
    # More than the effort limits, and a pause longer than the watchdog's.
    for step in range(150, 170):
        sent[step] = [array(-21.0, 11.0)]
    for step in range(200, 280):
        del sent[step]
    # At the largest speed, and then the reflex.
    fast = encode_state(NAMES, np.array([0.1, 0.2]), np.array([21.0, -3.0]))
    sent[400] = [(Source.SET_STATE, fast)]
    sent[499], sent[500] = [array(20.0, 0.0)], [array(-20.0, 0.0)]
    return sent


def recording() -> Recording:
    return simulate(
        700,
        commands(),
        command_timeout=0.05,
        effort_limits=True,
        drop_state=0.02,
        seed=3,
        start_time=12.5,
        reflex_effort_rate=36_000.0,
    )


if __name__ == '__main__':
    path = Path(sys.argv[1])
    if path.exists():
        raise SystemExit(f'{path} exists; a stored recording is never written over')
    recording().save(path)
