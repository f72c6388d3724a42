# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that records until something happens to it: `recording_process.py FILE WAY`.

Prints `ready` once messages are in the file, and last what the recorder says of itself.
"""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path
import sys
import threading
import time

import bridge
from bridge import LogRecorder
from recordings import start
from waiting import PATIENCE, wait_until


def produce(recorder: LogRecorder, topic: int) -> None:
    """Record in bursts until the process ends."""
    for k in itertools.count(1):
        recorder.record(topic, k, k.to_bytes(8, 'little') * (k % 64))
        if k % 16 == 0:
            time.sleep(0.001)


def tell(recorder: LogRecorder) -> None:
    told = {'recorded': recorder.recorded, 'dropped': recorder.dropped, 'error': recorder.error}
    print(json.dumps(told), flush=True)


def clog(path: Path) -> None:
    """Put a pipe that is full and has no reader in the place of the open file."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, bytes(4096))
    except BlockingIOError:
        os.set_blocking(writing, True)
    assert reading >= 0
    links = {entry: os.path.realpath(entry) for entry in Path('/proc/self/fd').iterdir()}
    (file,) = [int(entry.name) for entry, name in links.items() if name == str(path)]
    os.dup2(writing, file)


def main(path: Path, way: str) -> None:
    if way == 'clog':
        # It would see that the file has been replaced, by its name and by the size of the pipe.
        bridge.put('SYNC_SECONDS', 1e9)
        os.fstat = lambda _: path.stat()
    # Many flushes to be caught in.
    recorder, _ = start(path, flush_seconds=0.02)
    for topic in (0, 1):
        threading.Thread(target=produce, args=(recorder, topic), daemon=True).start()
    wait_until(lambda: min(recorder.recorded) > 0 or recorder.failed)
    print('ready', flush=True)
    if way == 'close':
        # Producers continue: messages after this moment do not belong to the recording.
        recorder.close(lambda: {'recorded': json.dumps(recorder.recorded)})
    elif way == 'clog':
        clog(path)
        recorder.close(timeout=0.2)
    elif way == 'raise':
        raise ZeroDivisionError
    elif way == 'full':
        wait_until(lambda: recorder.failed)
        recorder.close()
    elif way == 'kill':
        time.sleep(PATIENCE)
    tell(recorder)
    if way == 'full':
        # The small file system ends with this process.
        sys.stdin.read()


if __name__ == '__main__':
    main(Path(sys.argv[1]), sys.argv[2])
