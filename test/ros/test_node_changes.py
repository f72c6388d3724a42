# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a real node that are set while it runs, by clients that mean well or not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import signal
import threading
from typing import Any

import pytest
from ros_processes import Peer, Processes

from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.changes import read_changes
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Source
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import decode_string
from pfd_ros.recording.reader import Log
from pfd_ros.replay.ordering import placed_messages
from pfd_ros.replay.verify import read

pytestmark = pytest.mark.ros


class Client:
    """Calls the parameter services of `sim_arm`."""

    def __init__(self, peer: Peer) -> None:
        from rcl_interfaces import srv

        self._peer, self._types, self._clients = peer, srv, {}

    def call(self, kind: str, **fields: Any) -> Any:
        service = getattr(self._types, kind)
        name = ''.join(f'_{c.lower()}' if c.isupper() else c for c in kind)[1:]
        if kind not in self._clients:
            self._clients[kind] = self._peer.node.create_client(service, f'sim_arm/{name}')
        client = self._clients[kind]
        self._peer.wait(client.service_is_ready)
        answer = client.call_async(service.Request(**fields))
        self._peer.wait(answer.done)
        return answer.result()

    def set(self, *parameters: Any) -> tuple[bool, str]:
        """Set all of some parameters or none; return the success and the reason."""
        result = self.call('SetParametersAtomically', parameters=list(parameters)).result
        return result.successful, result.reason

    def get(self, name: str) -> Any:
        return self.call('GetParameters', names=[name]).values[0]

    def describe(self, name: str) -> Any:
        return self.call('DescribeParameters', names=[name]).descriptors[0]


def value_of(value: Any, kind: int | None = None) -> Any:
    """Return a parameter's value as it travels; `kind` is another type than it has."""
    from rcl_interfaces.msg import ParameterValue

    kinds = {bool: (1, 'bool_value'), int: (2, 'integer_value'), float: (3, 'double_value')}
    kinds |= {str: (4, 'string_value'), list: (8, 'double_array_value')}
    number, name = kinds[type(value)]
    return ParameterValue(**{'type': number if kind is None else kind, name: value})


def parameter(name: str, value: Any, kind: int | None = None) -> Any:
    from rcl_interfaces.msg import Parameter

    return Parameter(name=name, value=value_of(value, kind))


def recorded_changes(path: Path) -> list[dict[str, Any]]:
    """Return the changes of settings that a recording holds."""
    return [
        read_changes(decode_string(message.data))
        for message in placed_messages(Log(path))
        if message.role == 'parameters'
    ]


def test_a_node_takes_dynamic_parameters_and_refuses_all_else_with_a_reason(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'robot:=planar2', '-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    client = Client(peer)
    told = client.describe('real_time_factor')
    assert not told.read_only
    assert told.floating_point_range[0].to_value == 1000.0
    told = client.describe('integrator')
    assert told.read_only
    assert told.additional_constraints.startswith("one of ['auto', 'rk4'")
    peer.connect()

    assert client.set(parameter('real_time_factor', 0.5)) == (True, '')
    assert client.get('real_time_factor').double_value == 0.5
    reasons = {
        'read-only': [parameter('step_size', 0.002)],
        'out of range': [parameter('real_time_factor', float('nan'))],
        'expected 0 or 1e-06 and more': [parameter('real_time_factor', 1e-9)],
        'Wrong parameter type': [parameter('real_time_factor', 1)],
        'value of no type': [parameter('real_time_factor', 1.0, kind=200)],
        'cannot be undeclared': [parameter('real_time_factor', 1.0, kind=0)],
        'Invalid access': [parameter('%s{0}\n\x01' + 'x' * 1000, 1.0)],
        'read-only parameter: robot': [
            parameter('real_time_factor', 2.0),
            parameter('robot', 'ur5'),
        ],
        'read-only parameter: gravity': [parameter('gravity', [0.0] * 100_000)],
    }
    for reason, parameters in reasons.items():
        successful, told = client.set(*parameters)
        assert not successful
        assert reason in told
    each = client.call(
        'SetParameters',
        parameters=[parameter('real_time_factor', 2.0), parameter('real_time_factor', 1.0, 77)],
    )
    assert [result.successful for result in each.results] == [False, False]
    assert client.get('real_time_factor').double_value == 0.5
    assert client.set(parameter('use_sim_time', False)) == (True, '')
    peer.let_pass()

    assert arm.end(signal.SIGINT) == 0, arm.text()
    assert 'callback' not in arm.text()
    path = processes.folder / 'arm.mcap'
    assert recorded_changes(path) == [{'real_time_factor': 0.5}]
    summary = read(path, verify=True)
    assert summary.complete
    assert {row.source for m in placed_messages(Log(path)) for row in m.rows} == {
        Source.PARAMETERS
    }


@contextmanager
def stepping(engine: Engine, receiver: Any) -> Iterator[None]:
    """Have a thread run cycles on the events of a receiver."""
    ended = threading.Event()

    def run() -> None:
        while not ended.is_set():
            receiver.queue.wait(0.01)
            events = receiver.queue.take()
            taken = engine.run_cycle(events)
            receiver.answer(events, [judgement for _, judgement, _ in taken.judgements])

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def made(**settings: Any) -> tuple[Engine, Any, Any]:
    """Return an engine, its receiver, and the callback that rclpy asks."""
    from pfd_ros.node.command_counts import CommandCounts
    from pfd_ros.node.parameters import ParameterChanges
    from pfd_ros.node.receiving import EventQueue, Receiver

    chosen = Settings(**{'robot': 'planar2', **settings})
    robot = load_robot(chosen)
    engine = Engine(chosen, robot)
    receiver = Receiver(EventQueue(), lambda *_: None, CommandCounts())
    return engine, receiver, ParameterChanges(receiver, engine.settings, robot)


def chosen(name: str, value: Any) -> Any:
    from rclpy.parameter import Parameter

    return Parameter(name, value=value)


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
    assert engine.settings == changes.settings
    assert engine.settings.real_time_factor in {20.0 * k + 19 for k in range(4)}


def test_a_change_that_a_flood_pushed_out_is_told_and_not_taken_over() -> None:
    engine, receiver, changes = made()
    receiver.queue.most = 1
    ask = receiver.ask

    def ask_in_a_flood(source: Source, data: bytes) -> Any:
        answer = ask(source, data)
        receiver.receive(Source.ARRAY, b'')
        events = receiver.queue.take()
        receiver.answer(events, [found for _, found, _ in engine.take(events).judgements])
        return answer

    receiver.ask = ask_in_a_flood
    result = changes.set([chosen('real_time_factor', 2.0)])
    assert not result.successful
    assert result.reason.startswith('overflowed')
    assert engine.settings.real_time_factor == changes.settings.real_time_factor == 1.0
