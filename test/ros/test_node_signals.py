# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ends of the node: signals, threads that end, steps and clean-ups that hang; the exit status."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest
from ros_processes import (
    FAULTY,
    JOINTS,
    NODE,
    PATIENCE,
    Process,
    environment,
    parameter,
    set_parameters,
    trigger,
    wait_until,
)
from sampling import one_fast

from pfd_ros.replay.verify import verify as verify_log

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
STATUS_BASE = 128  # of a shell, for a process that a signal ended
HANGS = ['stub_hangs', 'stub_hangs_in_c']


@pytest.mark.parametrize('fault', HANGS)
def test_a_third_signal_ends_a_process_that_hangs(processes, fault: str) -> None:
    process = processes.python(FAULTY, fault)
    process.wait_for_text('steps')
    process.process.send_signal(INT)
    process.wait_for_text('hangs')
    process.process.send_signal(TERM)
    time.sleep(0.05)
    assert process.process.poll() is None
    # Signals that are pending together may come in another order.
    assert process.end(INT) in (STATUS_BASE + TERM, STATUS_BASE + INT)
    assert 'ended by a third signal' in process.text()


@pytest.mark.parametrize('reader', one_fast(['is gone', 'hangs'], 'hangs'))
def test_a_third_signal_ends_a_process_with_an_output_that_takes_no_line(reader: str) -> None:
    code = (
        'import time; from pfd_ros.node.main import stop_on_signals; stop_on_signals()\n'
        "print('waits', flush=True); time.sleep(1e3)"
    )
    reading, writing = os.pipe()
    if reader == 'is gone':
        os.close(reading)
    else:
        os.set_blocking(writing, False)
        with suppress(BlockingIOError):
            while True:
                os.write(writing, bytes(1 << 12))
        # The process has the same end of the pipe.
        os.set_blocking(writing, True)
    with subprocess.Popen(
        [sys.executable, '-c', code], stdout=subprocess.PIPE, stderr=writing
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b'waits\n'
            for number in (INT, TERM, HUP):
                process.send_signal(number)
                time.sleep(0.05)
            assert process.wait(PATIENCE) - STATUS_BASE in (INT, TERM, HUP)
        finally:
            process.kill()


def test_two_signals_are_a_clean_end(processes) -> None:
    for second in (INT, TERM, HUP):
        process = processes.python(FAULTY, 'stub_ends')
        process.wait_for_text('steps')
        process.process.send_signal(INT)
        time.sleep(0.005)
        process.process.send_signal(second)
        assert process.process.wait(PATIENCE) == 0


def test_an_ignored_hangup_stays_ignored_and_an_ignored_interrupt_does_not(processes) -> None:
    # As under nohup, and as a shell starts a process in the background.
    output = processes.folder / 'output.txt'
    with output.open('wb') as stream:
        started = subprocess.Popen(
            ['sh', '-c', 'trap "" HUP INT; exec "$@"', '-', sys.executable, FAULTY, 'stub_ends'],
            env=environment(processes.domain),
            stdout=stream,
            stderr=stream,
        )
    process = Process(started, output)
    processes.started.append(process)
    process.wait_for_text('steps')
    started.send_signal(HUP)
    time.sleep(0.2)
    assert started.poll() is None
    assert process.end(INT) == 0


@pytest.mark.ros
@pytest.mark.parametrize(
    ('fault', 'robot', 'text'),
    [
        ('teardown_hangs', 'planar2', ' s of simulated time: '),
        ('exit_hangs', 'nobody', "unknown robot 'nobody'"),
    ],
)
def test_a_hang_at_the_end_of_a_run_and_of_a_start_that_fails_is_ended_by_an_alarm(
    processes, fault: str, robot: str, text: str
) -> None:
    arm = processes.faulty(fault, '-p', f'robot:={robot}', ready=robot != 'nobody')
    assert arm.end(*[INT] * (robot != 'nobody')) in (-signal.SIGALRM, 1)
    assert text in arm.text()


# Ways to start the node, without the arguments for ROS.
STARTS = (('-m', 'pfd_ros.cli.main', 'sim'), NODE)
# Processes that start at the same time.
AT_ONCE = 4


def wait_for_handlers(process: Process) -> None:
    """Wait until a process handles SIGHUP and SIGTERM, which Python by itself does not."""
    wanted = sum(1 << number - 1 for number in (INT, TERM, HUP))

    def handled() -> bool:
        status = Path(f'/proc/{process.process.pid}/status').read_text(encoding='ascii')
        caught = int(next(line for line in status.splitlines() if 'SigCgt' in line).split()[1], 16)
        found = caught & wanted == wanted
        assert found or process.process.poll() is None, process.text()
        return found

    wait_until(handled)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('count', [6, pytest.param(240, marks=pytest.mark.long)])
def test_a_signal_while_the_node_starts_ends_it_like_a_later_one(processes, count: int) -> None:
    def once(k: int) -> None:
        process = processes.python(*STARTS[k % len(STARTS)], '--ros-args', '-p', 'robot:=planar2')
        wait_for_handlers(process)
        # Each time with another delay, up to three seconds.
        time.sleep(3.0 * k / count)
        assert process.end((INT, TERM, HUP)[k % 3]) == 0, process.text()
        text = process.text()
        assert 'Traceback' not in text
        # The nodes that run at the same time may find each other, and miss periods.
        usual = ('[INFO]', 'of the same name', 'periods missed')
        assert all(any(part in line for part in usual) for line in text.splitlines()), text

    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(once, range(count)))


def test_the_handlers_of_signals_come_before_every_import_that_takes_long() -> None:
    # What `pfd sim` has imported by then: nothing but the standard library and these.
    code = (
        'import sys, pfd_ros.cli.main, pfd_ros.node.main\n'
        "print(*sorted(m for m in sys.modules if m.partition('.')[0] in"
        " ('pfd_ros', 'pfd_core', 'numpy', 'rclpy', 'llvmlite', 'mcap', 'yaml')))\n"
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=True, timeout=PATIENCE
    )
    assert done.stdout.split() == [
        *('pfd_ros', 'pfd_ros.cli', 'pfd_ros.cli.main', 'pfd_ros.cli.terminal', 'pfd_ros.node'),
        *('pfd_ros.node.main', 'pfd_ros.text', 'pfd_ros.view', 'pfd_ros.view.ports'),
    ]


@pytest.mark.ros
@pytest.mark.parametrize(
    ('fault', 'text'),
    [
        ('executor_returns', 'the executor ended unexpectedly'),
        ('executor_fails', 'the executor failed: RuntimeError: 3 callbacks failed'),
        ('executor_exits', 'the executor failed: SystemExit: 0'),
        ('stepping_fails', "stepping failed: KeyError: '{0}'"),
        ('reporting_fails', "reporting failed: KeyError: '{0}'"),
        ('companion_fails', 'starting the companion failed: PermissionError: no view'),
    ],
)
@pytest.mark.slow
def test_a_thread_that_ends_ends_the_node_with_a_closed_file(
    processes, fault: str, text: str
) -> None:
    arm = processes.faulty(fault, '-p', 'recording:=arm.mcap', ready=False)
    assert arm.process.wait(PATIENCE) == 1, arm.text()
    assert text in arm.text()
    # Of a cycle that failed some is in the state of the arm, and nothing in the file.
    assert verify_log(processes.folder / 'arm.mcap').complete == (fault != 'stepping_fails')


@pytest.mark.ros
@pytest.mark.slow
def test_a_step_that_never_ends_is_logged_and_the_file_is_closed(processes, peer_of) -> None:

    arm = processes.faulty('stepping_hangs', '-p', 'recording:=arm.mcap')
    arm.wait_for_text('hangs')
    # Nobody knows whether it will be done.
    answer = trigger(peer_of(processes), 'reset')
    assert not answer.success
    assert 'no answer within 0.5 s' in answer.message
    assert arm.end(INT) == 1
    assert 'stepping did not end within 1 s' in arm.text()
    assert verify_log(processes.folder / 'arm.mcap').cycles == 200


@pytest.mark.ros
def test_a_node_ends_after_the_native_code_that_it_compiles(processes, peer_of) -> None:
    arm = processes.faulty('preparing_lasts', '-p', 'robot:=planar2')
    assert set_parameters(peer_of(processes), parameter('payload.mass', 1.0))[0]
    arm.wait_for_text('compiles')
    assert arm.end(INT) == 0
    assert 'has compiled' in arm.text()


@pytest.mark.ros
def test_a_callback_that_fails_is_counted_and_the_arm_still_receives(processes, peer_of) -> None:
    from std_srvs.srv import Trigger

    arm = processes.faulty('requests_fail')
    peer = peer_of(processes)
    peer.connect()
    client = peer.node.create_client(Trigger, '/sim_arm/reset')
    peer.wait(client.service_is_ready)
    for _ in range(3):
        client.call_async(Trigger.Request())
    arm.wait_for_text('callbacks failed, most recently by KeyError')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0] * 6)
    arm.stop()
