# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node with a fault put into it, or observed: `python faulty.py FAULT [node arguments]`."""

from __future__ import annotations

import ctypes
import itertools
import os
from pkgutil import resolve_name
import sys
import threading
import time
from types import ModuleType
from typing import Any


def failing(error: type[Exception], *_: Any) -> None:
    """Raise an error: what a partial function of it replaces has a bug."""
    raise error('a bug')


def put(path: str, value: object) -> Any:
    """Replace what a dotted path names for the rest of this process; return what was there."""
    owner, _, name = path.rpartition('.')
    place = resolve_name(owner)
    before = getattr(place, name)
    setattr(place, name, value)
    return before


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


def without_ros(end) -> None:
    """Leave only the signals, and what is called after the first: it starts in a moment."""

    def run(args: list[str], stop: threading.Event, companion: object) -> int:
        print('steps', flush=True)
        stop.wait()
        end()
        return 0

    stub = ModuleType('pfd_ros.node.process')
    stub.run = run
    sys.modules[stub.__name__] = stub


def step_after(count: int) -> None:
    """Let the arm step once that many inputs have come in."""
    came, enough = itertools.count(1), threading.Event()

    def counted(inbox, role, data, verdict=None):
        found = real_put(inbox, role, data, verdict)
        if next(came) == count:
            enough.set()
        return found

    def run(stepper, stopped) -> None:
        enough.wait()
        real_run(stepper, stopped)

    put('pfd_ros.node.sim_arm.TRANSITION_SECONDS', 0.5)
    real_put = put('pfd_ros.node.inbox.Inbox.put', counted)
    real_run = put('pfd_ros.node.stepping.Stepper.run', run)


def fail_first(name: str, error: str) -> None:
    """Let the first call of a function of the node fail."""
    calls = itertools.count()

    def called(*args, **named):
        if not next(calls):
            raise RuntimeError(error)
        return real(*args, **named)

    real = put(f'pfd_ros.node.{name}', called)


def fail_at_first() -> None:
    fail_first('parameters.refuse_unknown', 'no parameters')
    fail_first('parameters.setter', 'no setter')
    fail_first('lifecycle.introduce', 'no introduction')
    fail_first('sim_arm.SimArm.start', 'no start')


def at_cycle(cycle: int, fault) -> None:
    """Call a function in the step after a cycle, before anything of it is recorded."""

    def step(engine, *args):
        before, found = engine.state.cycle, real_step(engine, *args)
        if before == cycle:
            fault()
        return found

    real_step = put('pfd_ros.arm.engine.Engine.step', step)


def put_in(fault: str) -> None:
    if fault.startswith('stub_'):
        ends = {'hangs': hang_in_python, 'hangs_in_c': hang_in_c, 'ends': lambda: None}
        without_ros(ends[fault.removeprefix('stub_')])
        # On a busy machine the interpreter may need longer than that to go down; a process that
        # hangs uses all of it.
        put('pfd_ros.node.main.GRACE_SECONDS', 30.0 if fault == 'stub_ends' else 0.1)
        return
    if fault.startswith('executor_'):
        executor = 'pfd_ros.node.process.EventsExecutor'
        real = put(executor, lambda: FaultyExecutor(real(), fault))
        # As many as a real one may have before the node gives up.
        put('pfd_ros.node.process.MOST_FAILURES', 3)
    elif fault.startswith('first_step_after_'):
        step_after(int(fault.removeprefix('first_step_after_')))
    else:
        FAULTS[fault]()


def end_within(seconds: int) -> None:
    for module in ('threads', 'process', 'lifecycle'):
        put(f'pfd_ros.node.{module}.END_SECONDS', seconds)


def hang_at_exit() -> None:
    end_within(2)
    threading.Thread(target=hang_in_c).start()


def hang_in_teardown() -> None:
    end_within(2)
    put('pfd_ros.node.lifecycle.SimArmNode.destroy_node', hang_in_c)


def configure(fault, seconds: int = 100) -> None:
    """Call a function before an arm is made; the end of the node waits so long for it."""
    end_within(seconds)

    def made(*args):
        print('configures', flush=True)
        fault()
        return real(*args)

    real = put('pfd_ros.node.lifecycle.SimArm', made)


def prepare_slowly() -> None:
    """Let the native code of a change take a second."""

    def prepare(engine, role, data) -> None:
        print('compiles', flush=True)
        time.sleep(1.0)
        real(engine, role, data)
        print('has compiled', flush=True)

    real = put('pfd_ros.arm.engine.Engine.prepare', prepare)


def hang_in_a_step() -> None:
    end_within(1)
    at_cycle(200, hang_in_c)


def sync_within(seconds: float) -> None:
    """Let the disk need so long for what it is given, which is little; the node waits 1 s."""
    put('pfd_ros.recording.recorder.SYNC_SECONDS', 0.0)
    put('pfd_ros.recording.recorder.QUEUE_BYTES', 40_000)
    put('pfd_ros.node.stepping.DEAD_SECONDS', 1.0)
    os.fdatasync = lambda number: time.sleep(seconds)


def no_companion(node: str) -> None:
    raise PermissionError('no view')


def accompany() -> None:
    process = 'pfd_ros.node.process.run'
    real = put(process, lambda args, stop, _: real(args, stop, no_companion))


def fail(*_: object, **__: object) -> None:
    raise KeyError('{0}')


def report_often() -> None:
    put('pfd_ros.node.process.REPORT_SECONDS', 0.1)
    put('pfd_ros.node.graph.PATIENCE_SECONDS', 2.0)
    put('pfd_ros.node.report.LOST_CLOCK_SECONDS', 1)


FAULTS = {
    'reports_often': report_often,
    'stepping_fails': lambda: at_cycle(200, fail),
    'disk_is_slow': lambda: sync_within(0.2),
    'disk_is_dead': lambda: sync_within(3.0),
    'companion_fails': accompany,
    'stepping_hangs': hang_in_a_step,
    'configuring_fails': lambda: configure(fail),
    'configuring_lasts': lambda: configure(lambda: time.sleep(1.0)),
    'configuring_hangs': lambda: configure(hang_in_c, 1),
    'starts_fail': fail_at_first,
    'preparing_lasts': prepare_slowly,
    'reporting_fails': lambda: put('pfd_ros.node.lifecycle.report_arm', fail),
    'requests_fail': lambda: put('pfd_ros.node.services.encode_request', fail),
    'teardown_hangs': hang_in_teardown,
    'exit_hangs': hang_at_exit,
}


def main(args: list[str]) -> int:
    put_in(args[0])
    return resolve_name('pfd_ros.node.main.main')(args[1:])


if __name__ == '__main__':
    raise SystemExit(main(sys.argv[1:]))
