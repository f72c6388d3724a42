# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes a golden recording anew: the same inputs in the same cycles, computed and recorded now.

    PYTHONPATH=test python test/ros/make_golden.py OLD.mcap NEW.mcap

The recordings in test/data guard equal bits over versions of the code, of NumPy and LLVM, and
over processors. They are made anew when the format changes or there are new outputs, never to
please a test: the script fails if an output that both have differs. The inputs were recorded
from real nodes by the first edition.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
import sys
import time
from unittest.mock import patch

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.recording.recorder import Recorder as LogRecorder
from pfd_ros.recording.recorder import topic_names
from pfd_ros.replay.verify import recorded_engine

START_NS = 1_700_000_000_000_000_000


def record(
    target: Path,
    engine: Engine,
    topics: Mapping[str, str],
    messages: Iterable[ArmMessage],
    cycles: int,
) -> None:
    """Record a run again; its wall clock is that of a run in real time.

    Parameters
    ----------
    target
        The new file.
    engine
        At the start of the run.
    topics
        By role; outputs of this edition get their usual names.
    messages
        Inputs and asides in their order; an aside belongs to the cycle of the message before it.
    cycles
        Of the run.
    """
    first_ns = engine.stamp_ns
    shown = {role for role in topic_names(engine.roles) if role in topics or role == 'rejected'}
    if engine.plant.scene.external_wrench:
        shown.add('tip_wrench')
    names = {role: topics.get(role, name) for role, name in topic_names(shown).items()}
    with ExitStack() as patches:
        clock = patch.object(time, 'monotonic_ns', lambda: engine.stamp_ns - first_ns)
        patches.enter_context(clock)
        patches.enter_context(patch.object(time, 'time_ns', lambda: START_NS))
        recorder = LogRecorder(target, engine, names, print)

        def put(found: list[ArmMessage]) -> None:
            recorder.put([m for m in found if m.role in names], engine.stamp_ns)

        waiting: list[ArmMessage] = []
        for message in messages:
            is_input = ARM_ROLES[message.role].kind == 'input'
            while engine.state.cycle < message.cycle - is_input:
                put(engine.step(waiting)[0])
                waiting = []
            if is_input:
                waiting.append(message)
            else:
                put([message._replace(cycle=0)])
        while engine.state.cycle < cycles:
            put(engine.step(waiting)[0])
            waiting = []
        recorder.close()
    assert not recorder.error, recorder.error


def differences(source: Path, target: Path) -> list[str]:
    """Return the outputs of a recording that another one lacks or has otherwise.

    Of a rejection the first line counts, as in a verification.
    """

    def data(message: ArmMessage) -> bytes:
        return message.data.partition(b'\n')[0][8:] if message.role == 'rejected' else message.data

    outputs = [
        {(m.role, m.cycle): data(m) for m in RecordedLog(path).messages() if m.cycle}
        for path in (source, target)
    ]
    return [f'{role} {k}' for (role, k), x in outputs[0].items() if outputs[1].get((role, k)) != x]


def main(source: Path, target: Path) -> None:
    log = RecordedLog(source)
    engine, found, cycle = recorded_engine(log), [], 0
    # The recorder writes these itself.
    opening = {message.role for message in engine.frames.opening(0)} if engine.frames else set()
    for message in log.messages():
        cycle = message.cycle or cycle
        if ARM_ROLES[message.role].kind != 'output' and message.role not in opening:
            found.append(message._replace(cycle=cycle))
    record(target, engine, log.topics, found, log.end['totals']['cycles'])
    if wrong := differences(source, target):
        raise SystemExit(f'{len(wrong)} outputs differ, the first: {wrong[0]}')


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
