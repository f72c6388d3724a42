# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log lines: few, short, and with nothing lost between them."""

from __future__ import annotations

import re

from pfd_ros.node.throttled_log import LONGEST_SECONDS, MOST_FINDINGS, ThrottledLog
from pfd_ros.text import cut, listed, one_line


class Logger(list):
    def warning(self, text: str) -> None:
        self.append(('warning', text))

    def error(self, text: str) -> None:
        self.append(('error', text))


class Time:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def made() -> tuple[ThrottledLog, Logger, Time]:
    logger, time = Logger(), Time()
    return ThrottledLog(logger, time), logger, time


def test_the_first_of_a_kind_is_logged_at_once_and_nothing_twice() -> None:
    log, logger, time = made()
    log.count('a', 2, 'bad', error=True)
    log.count('b', 1, 'worse')
    time.now = 100.0
    log.count('a', 2, 'bad', error=True)
    assert logger == [('error', '2 bad'), ('warning', '1 worse')]


def test_a_lasting_problem_is_logged_ever_more_rarely_and_every_count_is_logged() -> None:
    log, logger, time = made()
    for k in range(1, 36_001):
        time.now = k / 10
        log.count('a', k, '{} {0} %s')
    log.count('a', 36_000, '{} {0} %s', last=True)
    told = [int(text.removesuffix(' {} {0} %s')) for _, text in logger]
    assert sum(told) == 36_000
    # An hour: the first minute or two, then one a minute.
    assert len(told) < 3600 / LONGEST_SECONDS + 10


def test_findings_are_logged_once_each_up_to_a_bound() -> None:
    log, logger, _ = made()
    for k in range(1000):
        log.once(k % 500, f'found {k}')
    assert len(logger) == MOST_FINDINGS + 2
    assert logger[-1][1] == 'further warnings of this kind are not logged'
    # Counts are of a kind known beforehand, and logged all the same.
    log.count('failure', 1, 'failure', error=True)
    assert logger[-1] == ('error', '1 failure')


def test_foreign_text_is_shown_short_and_on_one_line() -> None:
    assert cut('x' * 100) == f'{"x" * 64}... (100 characters)'
    assert cut('{0}') == '{0}'
    assert listed(['{', 'a\nb', 'x' * 70]) == f"['{{', 'a\\nb', '{'x' * 64}... (70 characters)']"
    assert listed([str(k) for k in range(10)]).endswith("'7', and 2 more]")
    assert one_line('a\n  b\x1b[31m\0c') == r'a b\x1b[31m\x00c'
    assert re.fullmatch(r'x+\.\.\. \(1000000 characters\) \.\.\.x+', one_line('x' * 1_000_000))
    assert len(one_line('x' * 1_000_000)) < 600


def test_an_event_is_a_line_without_a_number_unless_it_came_more_than_once() -> None:
    log, logger, time = made()
    log.event('a', 1, 'brakes on')
    time.now = 100.0
    log.event('a', 1, 'brakes on')
    log.event('a', 4, 'brakes on', error=True)
    assert logger == [('warning', 'brakes on'), ('error', 'brakes on (3 times)')]
