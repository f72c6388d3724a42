# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The queue between the two threads: what it keeps, and that nothing is lost without a trace."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import sys

from pfd_ros.node.inbox import Inbox


def test_what_was_put_is_taken_once_and_in_order() -> None:
    inbox = Inbox()
    inbox.put(0, 1, b'a')
    inbox.put(1, 1, b'b')
    inbox.put(0, 2, b'c')
    taken = inbox.take()
    assert (taken.dropped, taken.commands) == ({}, [(0, 1, b'a'), (1, 1, b'b'), (0, 2, b'c')])
    assert inbox.take().commands == []


def test_the_oldest_makes_room_and_its_number_is_told() -> None:
    inbox = Inbox(most=3)
    for number in range(1, 6):
        inbox.put(number % 2, (number + 1) // 2, b'x')
    taken = inbox.take()
    assert taken.commands == [(1, 2, b'x'), (0, 2, b'x'), (1, 3, b'x')]
    assert taken.dropped == {1: range(1, 2), 0: range(1, 2)}
    inbox.put(0, 3, b'y')
    assert inbox.take().dropped == {}


def test_bytes_are_bounded_and_one_large_command_still_gets_in() -> None:
    inbox = Inbox(most_bytes=100)
    for number in range(1, 11):
        inbox.put(0, number, bytes(30))
    taken = inbox.take()
    assert [number for _, number, _ in taken.commands] == [8, 9, 10]
    assert taken.dropped == {0: range(1, 8)}
    inbox.put(0, 11, b'')
    inbox.put(0, 12, bytes(1000))
    taken = inbox.take()
    assert [number for _, number, _ in taken.commands] == [12]
    assert taken.dropped == {0: range(11, 12)}


def test_a_million_dropped_commands_take_no_memory() -> None:
    inbox = Inbox(most=1)
    for number in range(1, 100_002):
        inbox.put(0, number, b'x')
    assert inbox.take().dropped == {0: range(1, 100_001)}


def test_between_two_threads_every_command_is_taken_or_told_exactly_once() -> None:
    inbox, count = Inbox(most=5), 20_000
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(1) as pool:

            def fill() -> None:
                for number in range(1, count + 1):
                    inbox.put(0, number, b'x')

            filled = pool.submit(fill)
            got: list[int] = []
            while True:
                done = filled.done()
                taken = inbox.take()
                # A dropped command is older than every one that stayed.
                got += taken.dropped.get(0, ())
                got += (number for _, number, _ in taken.commands)
                if done:
                    break
    finally:
        sys.setswitchinterval(before)
    assert got == list(range(1, count + 1))
