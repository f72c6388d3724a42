# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes by several threads and in floods reach the arm in one order, or are reported."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import threading
from typing import Any

from plant_messages import payload
import pytest
from ros_processes import chosen
from waiting import threads_named, wait_until

from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Source
from pfd_ros.arm.settings import Settings

# Without a node, but the callback and its parameters are rclpy's.
pytestmark = pytest.mark.ros


@contextmanager
def stepping(engine: Engine, receiver: Any) -> Iterator[None]:
    """Have a thread run cycles on the events of a receiver."""
    ended = threading.Event()

    def run_cycle() -> None:
        events = receiver.queue.take()
        taken = engine.run_cycle(events)
        receiver.answer(events, [validation for _, validation, _ in taken.validations])

    def run() -> None:
        while not ended.is_set():
            receiver.queue.wait(0.01)
            run_cycle()
        run_cycle()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def made(**settings: Any) -> tuple[Engine, Any, Any]:
    """Return an engine, its receiver, and the callback that rclpy asks."""
    from pfd_ros.node.changing import Changes
    from pfd_ros.node.command_counts import CommandCounts
    from pfd_ros.node.parameters import ParameterChanges
    from pfd_ros.node.receiving import EventQueue, Receiver

    wanted = Settings(**{'robot': 'planar2', **settings})
    engine = Engine(wanted, load_robot(wanted))
    receiver = Receiver(EventQueue(), lambda *_: None, CommandCounts())
    return engine, receiver, ParameterChanges(Changes(receiver, engine))


def test_values_that_several_threads_set_all_reach_the_arm_in_one_order() -> None:
    engine, receiver, changes = made()
    refused: list[str] = []

    def work(k: int) -> None:
        for i in range(1, 20):
            result = changes.set([chosen('real_time_factor', float(20 * k + i))])
            refused.extend([] if result.successful else [result.reason])

    with stepping(engine, receiver):
        threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert refused == []
    assert engine.settings == changes.changes.settings
    assert engine.settings.real_time_factor in {20.0 * k + 19 for k in range(4)}


@pytest.mark.parametrize('topic', [False, True], ids=['parameter', 'topic'])
def test_a_change_for_which_no_thread_starts_is_dropped_and_the_next_is_applied(
    topic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine, receiver, changes = made()

    def send() -> None:
        if topic:
            changes.changes.take_payload(payload('tip_link', 1.0, (0.0, 0.0, 0.0))[1])
        else:
            changes.set([chosen('payload.mass', 1.0)])

    def start(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with stepping(engine, receiver):
        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, 'start', start)
            with pytest.raises(RuntimeError, match="can't start new thread"):
                send()
        assert changes.set([chosen('gravity_compensation', True)]).successful
        wait_until(lambda: engine.settings.gravity_compensation)
    assert engine.settings.payload_mass == 0.0
    assert engine.settings == changes.changes.settings


def test_payloads_and_parameters_from_several_threads_end_in_one_order() -> None:
    engine, receiver, parameters = made()
    changes = parameters.changes

    def sets() -> None:
        for i in range(1, 30):
            values = {'payload.mass': i / 8, 'real_time_factor': float(i)}
            values['payload.center'] = [i / 100] * 3
            name = list(values)[i % 3]
            assert parameters.set([chosen(name, values[name])]).successful

    def loads() -> None:
        for i in range(1, 10):
            changes.take_payload(payload('tip_link', float(i), (0.0, i / 100, 0.0))[1])

    with stepping(engine, receiver):
        threads = [threading.Thread(target=work) for work in (sets, loads, sets)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        wait_until(lambda: not threads_named('compiling'))
    assert engine.settings == changes.settings
    assert engine.arm.scene.payload == engine.settings.payload


def test_a_change_that_a_full_queue_dropped_is_reported_and_not_applied() -> None:
    engine, receiver, changes = made()
    receiver.queue.most = 1
    ask = receiver.ask

    def ask_in_a_flood(source: Source, data: bytes) -> Any:
        answer = ask(source, data)
        receiver.receive(Source.PARAMETERS, b'')
        events = receiver.queue.take()
        receiver.answer(events, [found for _, found, _ in engine.take(events).validations])
        return answer

    receiver.ask = ask_in_a_flood
    result = changes.set([chosen('real_time_factor', 2.0)])
    assert not result.successful
    assert result.reason.startswith('overflowed')
    assert engine.settings.real_time_factor == changes.changes.settings.real_time_factor == 1.0
