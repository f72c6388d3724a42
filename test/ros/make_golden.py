# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes a golden recording: a real node, and a peer that sends it good commands and bad ones.

    PYTHONPATH=test python test/ros/make_golden.py puma560 test/data/NAME.mcap
    PYTHONPATH=test python test/ros/make_golden.py ur5 test/data/NAME.mcap

Every run of the tests verifies the golden recordings. They are never made anew to please a
test: a new one is added under a new name when the format changes, and the old ones stay.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import shutil
import signal
import sys
import tempfile

from bridge import JointStateEncoder
from ros_processes import JOINTS, Peer, Processes, call, chosen

# Slower than time, so that discovery does not fill the file with an arm at rest.
COMMON = {
    'damping': 'true',
    'armature': 'true',
    'initial_positions': '[0.3, -0.7, 1.1, -0.4, 0.9, 0.2]',
    'start_time': '12.5',
    'real_time_factor': '0.1',
    'publish_rate': '500.0',
    'clock_rate': '250.0',
    'frame_id': 'base',
    'recording': 'golden.mcap',
}
PUMA560 = {'robot': 'puma560', 'gravity': '[0.3, -1.2, -9.7]'}
UR5 = {
    'robot': 'ur5',
    # The model states none; a joint's own value turns it on.
    'damping': 'false',
    'damping.shoulder_lift_joint': '3.0',
    'friction.elbow_joint': '1.5',
    'joint_limits': 'true',
    'external_wrench': 'true',
    'payload.mass': '0.5',
    'outputs': '[tip_pose, energy]',
    'seed': '5',
    'noise.position': '0.0001',
    'delay.state': '0.002',
    'delay.commands': '0.002',
    'drop.state': '0.05',
    'drop.commands': '0.1',
    'recording_state_period': '0.25',
}
NAN, INFINITY = float('nan'), float('inf')


def send_commands(peer: Peer) -> None:
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
    truncated = JointStateEncoder(JOINTS).encode(0, *[[0.0] * 6] * 3)[:-5]
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


def send_to_every_input(peer: Peer) -> None:
    """Send commands, states, wrenches, a payload, requests and changed parameters."""
    from geometry_msgs.msg import InertiaStamped, WrenchStamped
    from rcl_interfaces.srv import SetParameters
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    names = list(peer.states[-1].name)
    places = peer.node.create_publisher(JointState, 'sim_arm/set_state', 10)
    pushes = peer.node.create_publisher(WrenchStamped, 'sim_arm/external_wrench', 10)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    loads = peer.node.create_publisher(InertiaStamped, 'sim_arm/payload', latched)
    masses: list[float] = []
    peer.node.create_subscription(
        InertiaStamped,
        'sim_arm/payload_in_use',
        lambda message: masses.append(message.inertia.m),
        latched,
    )
    for end in (places, pushes, loads):
        peer.wait(end.get_subscription_count)
    push, load = WrenchStamped(), InertiaStamped()
    push.header.frame_id = load.header.frame_id = 'tool0'
    push.wrench.force.y = 20.0
    load.inertia.m = 1.5
    load.inertia.com.z = 0.05
    for k in range(8):
        peer.plain_command([5.0, -60.0 + 5.0 * k, 20.0, 1.0, -0.5, 0.25])
        peer.let_pass(4)
        peer.command(names[:2], [3.0 - k, -40.0])
        peer.let_pass(4)
    pushes.publish(push)
    peer.let_pass(8)
    loads.publish(load)
    # Its code is compiled first.
    peer.wait(lambda: load.inertia.m in masses)
    peer.let_pass(8)
    places.publish(JointState(name=names[:2], position=[0.1, -1.0], velocity=[0.0, 0.5]))
    peer.let_pass(8)
    louder = chosen('noise.velocity', 0.001).to_parameter_msg()
    call(peer, SetParameters, 'set_parameters', parameters=[louder])
    peer.let_pass(8)
    call(peer, Trigger, 'reset')
    for k in range(8):
        peer.plain_command([-2.0, -30.0 + 5.0 * k, 10.0, -1.0, 0.5, 0.0])
        peer.let_pass(6)
    peer.let_pass(60)


RUNS: dict[str, tuple[dict[str, str], Callable[[Peer], None]]] = {
    'puma560': (PUMA560, send_commands),
    'ur5': (UR5, send_to_every_input),
}


def make(robot: str, target: Path) -> None:
    """Run a node and put its recording at `target`, which must not exist."""
    if target.exists():
        raise SystemExit(f'{target} exists; a golden recording is never written over')
    parameters, send = RUNS[robot]
    processes = Processes(Path(tempfile.mkdtemp()))
    peer = None
    try:
        arguments = [
            part for pair in (COMMON | parameters).items() for part in ('-p', ':='.join(pair))
        ]
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
    make(sys.argv[1], Path(sys.argv[2]))
