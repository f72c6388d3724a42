# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The queue between the two threads: bounded, in order, and nothing is lost without a trace."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import sys

from pfd_ros.arm.events import Arrival, Overflow, Source
from pfd_ros.node.receiving import EventQueue

NAMED, ARRAY = Source.NAMED, Source.ARRAY


def test_each_message_is_taken_once_and_in_order() -> None:
    queue = EventQueue()
    sent = [Arrival(NAMED, 1, b'a'), Arrival(ARRAY, 1, b'b'), Arrival(NAMED, 2, b'c')]
    for arrival in sent:
        queue.put(arrival)
    assert queue.take() == sent
    assert queue.take() == []


def test_a_full_queue_drops_the_oldest_and_reports_its_number() -> None:
    queue = EventQueue(most=3)
    sent = [Arrival(Source(k % 2), (k + 1) // 2, b'x') for k in range(1, 6)]
    for arrival in sent:
        queue.put(arrival)
    dropped = [Overflow(ARRAY, range(1, 2)), Overflow(NAMED, range(1, 2))]
    assert queue.take() == [*dropped, *sent[2:]]
    queue.put(Arrival(NAMED, 3, b'y'))
    assert queue.take() == [Arrival(NAMED, 3, b'y')]


def test_a_flood_of_commands_drops_no_request() -> None:
    queue = EventQueue(most=3)
    request = Arrival(Source.REQUEST, 1, b'r')
    queue.put(request)
    sent = [Arrival(NAMED, k, b'x') for k in range(1, 11)]
    for arrival in sent:
        queue.put(arrival)
    assert queue.take() == [Overflow(NAMED, range(1, 9)), request, *sent[8:]]
    requests = [Arrival(Source.REQUEST, k, b'r') for k in range(2, 7)]
    for arrival in requests:
        queue.put(arrival)
    assert queue.take() == [Overflow(Source.REQUEST, range(2, 4)), *requests[2:]]


def test_bytes_are_bounded_and_one_large_message_still_gets_in() -> None:
    queue = EventQueue(most_bytes=100)
    sent = [Arrival(NAMED, k, bytes(30)) for k in range(1, 11)]
    for arrival in sent:
        queue.put(arrival)
    assert queue.take() == [Overflow(NAMED, range(1, 8)), *sent[7:]]
    queue.put(Arrival(NAMED, 11, b''))
    queue.put(Arrival(NAMED, 12, bytes(1000)))
    assert queue.take() == [Overflow(NAMED, range(11, 12)), Arrival(NAMED, 12, bytes(1000))]


def test_between_two_threads_every_message_is_taken_or_reported_exactly_once() -> None:
    queue, count = EventQueue(most=5), 20_000
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)

    def fill() -> None:
        for sequence in range(1, count + 1):
            queue.put(Arrival(NAMED, sequence, b'x'))

    got: list[int] = []
    try:
        with ThreadPoolExecutor(1) as pool:
            filled = pool.submit(fill)
            done = False
            while not done:
                done = filled.done()
                # A dropped message is older than every message that stayed.
                for event in queue.take():
                    dropped = isinstance(event, Overflow)
                    got += event.sequences if dropped else [event.sequence]
    finally:
        sys.setswitchinterval(before)
    assert got == list(range(1, count + 1))
