# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print control steps per second of an arm in lockstep, compared with bare loops of the same work.

    python benchmarks/lockstep.py [seconds]
    python benchmarks/lockstep.py replay [simulated seconds, default 60]

A UR5 with its rotors, two substeps a step, under the same PD controller. Rounds of all cases take
turns within one run, each after one that is not timed, and each case prints the best and the
median of its rounds: other work on the machine slows all of them alike, so the ratios to the bare
loops say more than the rates.

    simulator     Simulator.step and the positions and velocities, nothing else
    nothing       the whole arm under a callback that returns the same efforts
    callback      the whole arm: engine, validation, checks of the answer, rows of the motion
    stretch       the arm alone, all commands in one native call, as a replay runs it
    recorded      the same, each message written to an MCAP file
    echo          over topics in one process: states of zeros for commands, no arm at all
    node          over topics in one process: the arm, and a node with ordinary messages
    raw node      the same, and a node that reads and writes bytes
    raw echo      as echo, with bytes at both ends

`replay` records such a run at 1 kHz, one command a step. It prints the processor time of reading
the log, divided by the time in which the package `mcap` iterates over the messages.

    mcap          make_reader(...).iter_messages()
    verify        pfd replay --verify
    what-if       pfd replay --what-if, which writes a log of as many messages
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from time import perf_counter, process_time, sleep
from typing import Any

from mcap.reader import make_reader
import numpy as np

import pfd_core as pfd
from pfd_ros.messages.convert import (
    JointStateEncoder,
    decode_floats,
    decode_joint_state,
    encode_floats,
)
from pfd_ros.replay.verify import read
from pfd_ros.replay.what_if import what_if
from pfd_ros.testing.lockstep_arm import LockstepArm

STIFFNESS, DAMPING = np.full(6, 100.0), np.full(6, 10.0)
GOAL = np.array([0.3, -0.6, 0.9, 0.2, -0.5, 0.4])
# Control steps of one round.
STEPS = 200
# Longest time after a round until the last of its messages is in the file.
WRITING_SECONDS = 0.3
# Each case of `replay`.
ROUNDS = 3
SETTINGS: dict[str, Any] = {'robot': 'ur5', 'armature': True, 'substeps': 2}


def pd(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return STIFFNESS * (GOAL - q) - DAMPING * qd


def simulator_loop(robot: pfd.Robot) -> Callable[[], None]:
    sim = pfd.Simulator(robot, pfd.Scene(armature='model'), substeps=2)

    def run() -> None:
        sim.reset()
        for _ in range(STEPS):
            sim.step(pd(sim.q, sim.qd))

    return run


def callback_loop(arm: LockstepArm) -> Callable[[], None]:
    def run() -> None:
        arm.reset()
        arm.run(lambda t, q, qd: pd(q, qd), STEPS * arm.period)

    return run


def nothing_loop(arm: LockstepArm) -> Callable[[], None]:
    efforts = np.zeros(6)

    def run() -> None:
        arm.reset()
        arm.run(lambda t, q, qd: efforts, STEPS * arm.period)

    return run


def stretch_loop(arm: LockstepArm) -> Callable[[], None]:
    efforts = np.zeros((STEPS, 6))

    def run() -> None:
        arm.reset()
        if arm.engine.stretch(efforts, range(STEPS)) is None:
            raise RuntimeError('more than commands acts on the arm')

    return run


def controller(kind: str) -> Any:
    """Return a node that answers states under /arm, with ordinary messages or with bytes."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    node, raw = Node(f'controller_{kind}', namespace=kind), kind.startswith('raw')
    commands = node.create_publisher(Float64MultiArray, 'sim_arm/commands', 10)

    def on_state(state: Any) -> None:
        efforts = pd(np.frombuffer(state.position), np.frombuffer(state.velocity))
        commands.publish(Float64MultiArray(data=efforts))

    def on_bytes(data: bytes) -> None:
        state = decode_joint_state(data)
        commands.publish(encode_floats(pd(state.position, state.velocity)))

    node.create_subscription(
        JointState, 'joint_states', on_bytes if raw else on_state, 10, raw=raw
    )
    return node


def spin_loop(arm: LockstepArm, node: Any) -> Callable[[], None]:
    def run() -> None:
        arm.reset()
        arm.spin(STEPS * arm.period, node)

    return run


def echo_loop(node: Any, kind: str) -> Callable[[], None]:
    """Return a loop that sends the same state for each command, as the middleware allows."""
    from rclpy.node import Node
    from rclpy.task import Future
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    from pfd_ros.testing.session import executor_with

    end, raw = Node(f'echo_{kind}', namespace=kind), kind.startswith('raw')
    states = end.create_publisher(JointState, 'joint_states', 10)
    names = [f'joint{i}' for i in range(6)]
    zeros, encoder = np.zeros(6), JointStateEncoder(names)
    left, ended = [0], [Future()]

    def send() -> None:
        if raw:
            states.publish(encoder.encode(0, zeros, zeros, zeros))
        else:
            states.publish(JointState(name=names, position=zeros, velocity=zeros, effort=zeros))

    def on_command(command: Any) -> None:
        if raw:
            decode_floats(command)
        left[0] -= 1
        if left[0]:
            send()
        else:
            ended[0].set_result(None)

    end.create_subscription(Float64MultiArray, 'sim_arm/commands', on_command, 10, raw=raw)

    def run() -> None:
        left[0], ended[0] = STEPS, Future()
        executor = executor_with([end, node])
        send()
        while not ended[0].done():
            executor.spin_until_future_complete(ended[0], 1.0)

    return run


def cases(stack: ExitStack) -> dict[str, Callable[[], None]]:
    folder = Path(stack.enter_context(TemporaryDirectory()))
    arm = stack.enter_context(LockstepArm(**SETTINGS))
    recorded = stack.enter_context(LockstepArm(**SETTINGS, recording=folder / 'run.mcap'))
    found = {
        'simulator': simulator_loop(arm.robot),
        'nothing': nothing_loop(arm),
        'callback': callback_loop(arm),
        'stretch': stretch_loop(arm),
        'recorded': callback_loop(recorded),
    }
    try:
        from pfd_ros.testing.session import claimed_domain, initialised

        domain = stack.enter_context(claimed_domain())
        stack.enter_context(initialised(domain))
    except ImportError:
        return found
    for name, kind in (('node', 'plain'), ('raw node', 'raw')):
        arm = stack.enter_context(LockstepArm(**SETTINGS, ros_args=['-r', f'__ns:=/{kind}']))
        found[name] = spin_loop(arm, controller(kind))
    for name, kind in (('echo', 'plain_echo'), ('raw echo', 'raw_echo')):
        found[name] = echo_loop(controller(kind), kind)
    return found


def main(seconds: float) -> None:
    with ExitStack() as stack:
        loops = cases(stack)
        times: dict[str, list[float]] = {name: [] for name in loops}
        for loop in loops.values():
            loop()
        begun = perf_counter()
        while perf_counter() - begun < seconds:
            for name, loop in loops.items():
                # The case before has left nothing of this one in the caches.
                loop()
                before = perf_counter()
                loop()
                times[name].append((perf_counter() - before) / STEPS)
                if name == 'recorded':
                    # Its writer's thread would take its time from the next case.
                    sleep(WRITING_SECONDS)
    best = {name: min(found) for name, found in times.items()}
    print(f'{"":12} best [1/s]  median [1/s]  of the bare loop')
    for name, found in times.items():
        bare = {'node': 'echo', 'raw node': 'raw echo'}.get(name, 'simulator')
        share = '' if 'echo' in name else f'{best[bare] / best[name]:.2f} of {bare}'
        print(f'{name:12} {1 / best[name]:10.0f}  {1 / np.median(found):12.0f}  {share}')


def iterate(path: Path) -> None:
    with path.open('rb') as stream:
        for _ in make_reader(stream).iter_messages():
            pass


def replay(seconds: float) -> None:
    with TemporaryDirectory() as folder:
        path, new = Path(folder) / 'run.mcap', Path(folder) / 'new.mcap'
        with LockstepArm(**SETTINGS, recording=path) as arm:
            arm.run(lambda t, q, qd: pd(q, qd), seconds)
        times: dict[str, list[float]] = {'mcap': [], 'verify': [], 'what-if': []}
        for _ in range(ROUNDS):
            for name, found in times.items():
                before = process_time()
                if name == 'mcap':
                    iterate(path)
                elif name == 'verify':
                    read(path, verify=True)
                else:
                    what_if(path, ['payload.mass=1'], out=new)
                found.append(process_time() - before)
                new.unlink(missing_ok=True)
        bare = min(times['mcap'])
        for name, found in times.items():
            print(f'{name:8} {min(found):7.2f} s  {min(found) / bare:.2f} of mcap')


if __name__ == '__main__':
    if sys.argv[1:2] == ['replay']:
        replay(float(sys.argv[2]) if len(sys.argv) > 2 else 60.0)
        raise SystemExit
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
