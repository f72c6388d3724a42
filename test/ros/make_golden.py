# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes a golden recording: a real node, and a peer that sends it good commands and bad ones.

    python test/ros/make_golden.py test/data/NAME.mcap

Every run of the tests verifies the golden recordings. They are never made anew to please a
test: a new one is added under a new name when the format changes, and the old ones stay.
"""

from __future__ import annotations

from pathlib import Path
import shutil
import signal
import sys
import tempfile

from ros_processes import JOINTS, Peer, Processes

from pfd_ros.messages import convert

# Slower than time, so that discovery does not fill the file with an arm at rest.
PARAMETERS = {
    'robot': 'puma560',
    'damping': 'true',
    'armature': 'true',
    'gravity': '[0.3, -1.2, -9.7]',
    'initial_positions': '[0.3, -0.7, 1.1, -0.4, 0.9, 0.2]',
    'start_time': '12.5',
    'real_time_factor': '0.1',
    'publish_rate': '500.0',
    'clock_rate': '250.0',
    'frame_id': 'base',
    'recording': 'golden.mcap',
}
NAN, INFINITY = float('nan'), float('inf')


def send(peer: Peer) -> None:
    """Send commands of every verdict, and between them some that move the arm."""
    peer.let_pass(10)
    for k in range(12):
        peer.command(JOINTS[:3], [9.0 - k, -20.0 + 3.0 * k, 7.0])
        peer.let_pass(3)
        peer.plain_command([10.0 - k, -30.0 + k, 5.0 + k, 0.5, -0.25 * k, 0.125])
        peer.let_pass(3)
        hostile(peer, k)
        peer.let_pass(3)
    peer.command([JOINTS[5], 'somebody'], [0.3, 1.0])
    peer.let_pass(140)


def hostile(peer: Peer, k: int) -> None:
    """Send bad command number `k`."""
    truncated = convert.JointStateEncoder(JOINTS).encode(0, *[[0.0] * 6] * 3)[:-5]
    named = {
        0: ([], [1.0]),
        1: (JOINTS[:2], [1.0]),
        2: (JOINTS[:1], [INFINITY]),
        4: ((JOINTS[0], JOINTS[0]), [1.0, 2.0]),
        5: (JOINTS[:2], []),
        6: (['nobody'], [1.0]),
        7: (JOINTS[:2], [NAN, NAN]),
    }
    if k in named:
        peer.command(*named[k])
    elif k == 3:
        peer.command(JOINTS[:1], [1.0], stamp=1)
    elif k == 8:
        peer.plain_command([1.0])
    elif k == 9:
        peer.plain_command([NAN] * 6)
    elif k == 10:
        peer.named.publish(truncated)
    else:
        peer.plain.publish(b'\0\1\0\0' + b'\xff' * 12)


def make(target: Path) -> None:
    """Run a node and put its recording at `target`, which must not exist."""
    if target.exists():
        raise SystemExit(f'{target} exists; a golden recording is never written over')
    processes = Processes(Path(tempfile.mkdtemp()))
    peer = None
    try:
        arguments = [part for pair in PARAMETERS.items() for part in ('-p', ':='.join(pair))]
        arm = processes.arm(*arguments)
        peer = Peer(processes.domain)
        peer.connect()
        send(peer)
        if arm.end(signal.SIGINT) != 0:
            raise SystemExit(arm.text())
        shutil.copyfile(processes.folder / 'golden.mcap', target)
    finally:
        if peer is not None:
            peer.close()
        processes.close()
        shutil.rmtree(processes.folder)


if __name__ == '__main__':
    make(Path(sys.argv[1]))
