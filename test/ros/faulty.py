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

import bridge


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
    name = bridge.PATCHED['node_process_run'].partition(':')[0]
    stub = ModuleType(name)
    stub.run = run
    sys.modules[name] = stub


def step_after(count: int) -> None:
    """Let the arm step once that many commands have come in."""
    came, enough = itertools.count(1), threading.Event()
    real_put, real_run = bridge.EventQueue_put, bridge.Stepper_run

    def put(queue, arrival) -> None:
        real_put(queue, arrival)
        if next(came) == count:
            enough.set()

    def run(stepper, stopped) -> None:
        enough.wait()
        real_run(stepper, stopped)

    bridge.put('EventQueue_put', put)
    bridge.put('Stepper_run', run)


def trace() -> None:
    """Tell with every report how much memory the objects take that came after the first one.

    Traced from the beginning, a first start would compile for a minute on a busy machine.
    """
    real_report = bridge.Reporter_report

    def report(reporter, **options) -> None:
        real_report(reporter, **options)
        tracemalloc.start()
        print(f'traced {tracemalloc.get_traced_memory()[0]}', flush=True)

    bridge.put('Reporter_report', report)


def put_in(fault: str) -> None:
    if fault.startswith('stub_'):
        runs = {'hangs': wait_and_hang, 'hangs_in_c': wait_and_hang_in_c, 'ends': wait_and_end}
        without_ros(runs[fault.removeprefix('stub_')])
        # On a busy machine the interpreter may need longer than that to go down; a process that
        # hangs uses all of it.
        bridge.put('GRACE_SECONDS', 30.0 if fault == 'stub_ends' else 0.1)
        return
    if fault == 'traced':
        trace()
        return
    if fault == 'reports_often':
        bridge.put('REPORT_SECONDS', 0.1)
        return
    if fault.startswith('executor_'):
        real = bridge.EventsExecutor
        bridge.put('EventsExecutor', lambda: FaultyExecutor(real(), fault))
        # As many as a real one may have before the node gives up.
        bridge.put('MOST_FAILURES', 3)
    elif fault == 'stepping_fails':
        real_cycle = bridge.Stepper_run_cycle

        def run_cycle(stepper) -> None:
            if stepper.engine.cycles == 200:
                raise KeyError('{0}')
            real_cycle(stepper)

        bridge.put('Stepper_run_cycle', run_cycle)
    elif fault == 'stepping_hangs':
        bridge.put('LIFECYCLE_END_SECONDS', 1)
        bridge.put('PROCESS_END_SECONDS', 1)
        real_advance = bridge.Arm_advance

        def advance(arm, *drive):
            if arm.step == 200:
                hang_in_c()
            return real_advance(arm, *drive)

        bridge.put('Arm_advance', advance)
    elif fault == 'configuring_fails':
        bridge.put('lifecycle_SimArm', lambda *_: {}['{}'])
    elif fault == 'first_start_fails':
        real_start, starts = bridge.SimArm_start, itertools.count()

        def start(arm, workers) -> None:
            if not next(starts):
                raise RuntimeError("can't start new thread")
            real_start(arm, workers)

        bridge.put('SimArm_start', start)
    elif fault == 'first_introduction_fails':
        real_introduce, introductions = bridge.Reporter_introduce, itertools.count()

        def introduce(reporter) -> None:
            if not next(introductions):
                raise RuntimeError('no introduction')
            real_introduce(reporter)

        bridge.put('Reporter_introduce', introduce)
    elif fault == 'first_reading_fails':
        real_misspelt, readings = bridge.misspelt_parameters, itertools.count()

        def misspelt(node):
            if not next(readings):
                raise RuntimeError('no parameters')
            return real_misspelt(node)

        bridge.put('misspelt_parameters', misspelt)
    elif fault == 'reporting_fails':
        bridge.put('Reporter_report', lambda reporter, last=False: {}['{}'])
    elif fault == 'requests_fail':
        bridge.put('Services_request', lambda *_: {}['{}'])
    elif fault == 'closing_hangs':
        bridge.put('SimArm_close_recording', hang_in_python)
    elif fault == 'closing_hangs_in_c':
        bridge.put('SimArm_close_recording', hang_in_c)
    elif fault == 'teardown_hangs':
        bridge.put('PROCESS_END_SECONDS', 2)
        bridge.put('SimArmNode_destroy_node', hang_in_c)
    elif fault == 'exit_hangs':
        bridge.put('PROCESS_END_SECONDS', 2)
        threading.Thread(target=hang_in_c).start()
    elif fault == 'slow_disk':
        real_init, real_flush = bridge.LogRecorder_init, bridge.Sink_flush
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

        bridge.put('LogRecorder_init', init)
        bridge.put('Sink_flush', flush)
    elif fault == 'recorder_failed':
        failed = property(lambda recorder: True, lambda recorder, value: None)
        bridge.put('LogRecorder_waiting_share', property(lambda recorder: 1.0))
        bridge.put('LogRecorder_failed', failed)
    elif fault.startswith('first_step_after_'):
        step_after(int(fault.removeprefix('first_step_after_')))
    else:
        raise ValueError(f'unknown fault {fault!r}')


def main(args: list[str]) -> int:
    put_in(args[0])
    return bridge.node_main(args[1:])


if __name__ == '__main__':
    raise SystemExit(main(sys.argv[1:]))
