# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node with a fault put into it, or observed: `python faulty.py FAULT [node arguments]`."""

from __future__ import annotations

import ctypes
import itertools
import sys
import threading
import time
import tracemalloc
from types import ModuleType

from pfd_ros.node import main as node


class FaultyExecutor:
    """An executor that works for a while and then ends, or fails."""

    def __init__(self, real, fault: str) -> None:
        self._real = real
        self._fault = fault

    def __getattr__(self, name: str):
        return getattr(self._real, name)

    def spin_until_future_complete(self, future, seconds: float) -> None:
        self._real.spin_until_future_complete(future, 0.5)
        if self._fault == 'executor_fails':
            raise SystemError('null argument to {internal} routine')
        if self._fault == 'executor_exits':
            raise SystemExit(0)


def hang_in_python(*_) -> None:
    print('hangs', flush=True)
    while True:
        time.sleep(1000)


def hang_in_c(*_) -> None:
    """Lock a lock twice: no signal interrupts that, and the interpreter runs no handler."""
    print('hangs', flush=True)
    mutex = ctypes.create_string_buffer(128)
    libc = ctypes.CDLL(None)
    libc.pthread_mutex_lock(mutex)
    libc.pthread_mutex_lock(mutex)


def wait_and_hang(args: list[str], stop: threading.Event, companion: object) -> int:
    print('steps', flush=True)
    stop.wait()
    hang_in_python()
    return 0


def wait_and_hang_in_c(args: list[str], stop: threading.Event, companion: object) -> int:
    print('steps', flush=True)
    stop.wait()
    hang_in_c()
    return 0


def wait_and_end(args: list[str], stop: threading.Event, companion: object) -> int:
    print('steps', flush=True)
    stop.wait()
    return 0


def without_ros(run) -> None:
    """Leave only the signals: such a process starts in a moment."""
    stub = ModuleType('pfd_ros.node.process')
    stub.run = run
    sys.modules['pfd_ros.node.process'] = stub


def step_after(count: int) -> None:
    """Let the arm step once that many commands have come in."""
    from pfd_ros.node.receiving import EventQueue
    from pfd_ros.node.stepping import Stepper

    came, enough = itertools.count(1), threading.Event()
    real_put, real_run = EventQueue.put, Stepper.run

    def put(queue, arrival) -> None:
        real_put(queue, arrival)
        if next(came) == count:
            enough.set()

    def run(stepper, stopped) -> None:
        enough.wait()
        real_run(stepper, stopped)

    EventQueue.put = put
    Stepper.run = run


def trace() -> None:
    """Tell with every report how much memory the objects take that came after the first one.

    Traced from the beginning, a first start would compile for a minute on a busy machine.
    """
    from pfd_ros.node.reporting import Reporter

    real_report = Reporter.report

    def report(reporter, **options) -> None:
        real_report(reporter, **options)
        tracemalloc.start()
        print(f'traced {tracemalloc.get_traced_memory()[0]}', flush=True)

    Reporter.report = report


def put_in(fault: str) -> None:
    if fault.startswith('stub_'):
        runs = {'hangs': wait_and_hang, 'hangs_in_c': wait_and_hang_in_c, 'ends': wait_and_end}
        without_ros(runs[fault.removeprefix('stub_')])
        # On a busy machine the interpreter may need longer than that to go down; a process that
        # hangs uses all of it.
        node.GRACE_SECONDS = 30.0 if fault == 'stub_ends' else 0.1
        return
    if fault == 'traced':
        trace()
        return
    from pfd_ros.node import lifecycle, process, sim_arm

    if fault == 'reports_often':
        process.REPORT_SECONDS = 0.1
        return
    if fault.startswith('executor_'):
        real = process.EventsExecutor
        process.EventsExecutor = lambda: FaultyExecutor(real(), fault)
        # As many as a real one may have before the node gives up.
        process.MOST_FAILURES = 3
    elif fault == 'stepping_fails':
        from pfd_ros.node.stepping import Stepper

        real_cycle = Stepper.run_cycle

        def run_cycle(stepper) -> None:
            if stepper.engine.cycles == 200:
                raise KeyError('{0}')
            real_cycle(stepper)

        Stepper.run_cycle = run_cycle
    elif fault == 'stepping_hangs':
        lifecycle.END_SECONDS = process.END_SECONDS = 1
        from pfd_ros.arm.arm import Arm

        real_advance = Arm.advance

        def advance(arm, *drive):
            if arm.step == 200:
                hang_in_c()
            return real_advance(arm, *drive)

        Arm.advance = advance
    elif fault == 'configuring_fails':
        lifecycle.SimArm = lambda *_: {}['{}']
    elif fault == 'first_start_fails':
        real_start, starts = sim_arm.SimArm.start, itertools.count()

        def start(arm, workers) -> None:
            if not next(starts):
                raise RuntimeError("can't start new thread")
            real_start(arm, workers)

        sim_arm.SimArm.start = start
    elif fault == 'first_introduction_fails':
        from pfd_ros.node.reporting import Reporter

        real_introduce, introductions = Reporter.introduce, itertools.count()

        def introduce(reporter) -> None:
            if not next(introductions):
                raise RuntimeError('no introduction')
            real_introduce(reporter)

        Reporter.introduce = introduce
    elif fault == 'first_reading_fails':
        real_misspelt, readings = lifecycle.parameters.misspelt, itertools.count()

        def misspelt(node):
            if not next(readings):
                raise RuntimeError('no parameters')
            return real_misspelt(node)

        lifecycle.parameters.misspelt = misspelt
    elif fault == 'reporting_fails':
        from pfd_ros.node.reporting import Reporter

        Reporter.report = lambda reporter, last=False: {}['{}']
    elif fault == 'requests_fail':
        from pfd_ros.node.services import Services

        Services.request = lambda *_: {}['{}']
    elif fault == 'closing_hangs':
        sim_arm.SimArm.close_recording = hang_in_python
    elif fault == 'closing_hangs_in_c':
        sim_arm.SimArm.close_recording = hang_in_c
    elif fault == 'teardown_hangs':
        process.END_SECONDS = 2
        lifecycle.SimArmNode.destroy_node = hang_in_c
    elif fault == 'exit_hangs':
        process.END_SECONDS = 2
        threading.Thread(target=hang_in_c).start()
    elif fault == 'slow_disk':
        from pfd_ros.recording.recorder import LogRecorder
        from pfd_ros.recording.sink import Sink

        real_init, real_flush = LogRecorder.__init__, Sink.flush
        recorders = []

        def init(recorder, *args) -> None:
            recorders.append(recorder)
            real_init(recorder, *args, limit=100)

        def flush(sink) -> None:
            # Until it was too slow, however slowly a busy machine steps.
            if threading.current_thread().name == 'recording':
                while not sum(recorders[-1].dropped):
                    time.sleep(0.01)
            real_flush(sink)

        LogRecorder.__init__ = init
        Sink.flush = flush
    elif fault == 'recorder_failed':
        from pfd_ros.recording.recorder import LogRecorder

        LogRecorder.waiting_share = property(lambda recorder: 1.0)
        LogRecorder.failed = property(lambda recorder: True, lambda recorder, value: None)
    elif fault.startswith('first_step_after_'):
        step_after(int(fault.removeprefix('first_step_after_')))
    else:
        raise ValueError(f'unknown fault {fault!r}')


def main(args: list[str]) -> int:
    put_in(args[0])
    return node.main(args[1:])


if __name__ == '__main__':
    raise SystemExit(main(sys.argv[1:]))
