# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that records a run at 1 kHz until it is killed: `killed_recorder.py FILE SETTINGS`.

On its output are the numbers of the steps that it has passed to the recorder, each with the time
of the steady clock, as pairs of 64 bits; the first pair is of the open file.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import struct
import sys
import time

from driven_runs import opened_run, run_steps

PAIR = struct.Struct('<QQ')
STEP_NS = 1_000_000


def tell(step: int) -> None:
    os.write(1, PAIR.pack(step, time.monotonic_ns()))


def main(path: Path, settings: dict[str, float]) -> None:
    driver, log = opened_run(path, recording_time='wall', **settings)
    begun = time.monotonic_ns()
    tell(0)

    def after(step: int) -> None:
        tell(step)
        time.sleep(max(0, begun + step * STEP_NS - time.monotonic_ns()) * 1e-9)

    run_steps(driver, log, 1 << 40, after)


if __name__ == '__main__':
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
