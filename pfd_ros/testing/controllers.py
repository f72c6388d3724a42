# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The controllers of an arm over topics, and why one of them did not answer a state.

Each cause has a different message, with the state and the number of answers before it: no
controller was found, it never published a command, it stopped, it left the ROS graph, its process
ended, or the arm rejected its command.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

from pfd_ros.messages.topics import UNKNOWN_NODE, node_of
from pfd_ros.testing.child_process import ControllerProcess
from pfd_ros.testing.controller import ControllerError
from pfd_ros.text import listed


class NoAnswerError(Exception):
    """No controller answered a state."""


@dataclass
class Controllers:
    """The nodes of controllers in the ROS graph.

    Attributes
    ----------
    node
        The node of the arm, or a node that monitors it.
    states, commands
        Full names of the topics of states and of commands.
    nodes, processes
        Controllers in this process, and processes started by the test.
    own
        Full names of the nodes of the arm.
    seen
        Full names of the nodes that have published on a topic of commands so far.
    """

    node: Any
    states: str
    commands: Sequence[str]
    nodes: Sequence[Any] = ()
    processes: Sequence[ControllerProcess] = ()
    own: Collection[str] = ()
    seen: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Note the endpoints that exist before the processes are found."""
        self._old = set(self._ends())

    def _ends(self) -> dict[tuple[int, ...], str]:
        """Return the node of each publisher of commands, by the identity of the publisher."""
        return {
            tuple(end.endpoint_gid): node_of(end)
            for topic in self.commands
            for end in self.node.get_publishers_info_by_topic(topic)
            if node_of(end) not in self.own
        }

    def found(self) -> bool:
        """Return whether a node publishes commands; with processes, a new node.

        A node that was killed is in the graph for some seconds more: only a new publisher
        belongs to a new process. The nodes of this process must also be connected.
        """
        ends = self._ends()
        self.publishers()
        return self._connected() and bool(ends.keys() - self._old if self.processes else ends)

    def _connected(self) -> bool:
        return all(
            end.get_subscription_count()
            for node in self.nodes
            for end in node.publishers
            if end.topic_name in self.commands
        )

    def publishers(self) -> set[str]:
        """Return the nodes that have a publisher of commands now."""
        own = {
            str(node.get_fully_qualified_name())
            for node in self.nodes
            if any(end.topic_name in self.commands for end in node.publishers)
        }
        found = own | {name for name in self._ends().values() if UNKNOWN_NODE not in name}
        self.seen |= found
        return found

    def readers(self) -> set[str]:
        """Return the nodes that subscribe to states now."""
        own = {
            str(node.get_fully_qualified_name())
            for node in self.nodes
            if any(end.topic_name == self.states for end in node.subscriptions)
        }
        ends = self.node.get_subscriptions_info_by_topic(self.states)
        names = {node_of(end) for end in ends} - set(self.own)
        return own | {name for name in names if UNKNOWN_NODE not in name}

    def absence(self, seconds: float) -> NoAnswerError:
        """Return the error about controllers that were not found within a time, s."""
        text = self._missing(self.publishers(), self.readers())
        return NoAnswerError(f'no answer within {seconds:g} s: {text}{self._outputs()}')

    def check(self, t: float | None, answers: int) -> None:
        """Raise NoAnswerError if a process has ended; `t` is the stamp of the state, if any."""
        for process in self.processes:
            end = process.end()
            if end:
                state = '' if t is None else f', at the state of t = {t:.6g} s'
                raise NoAnswerError(
                    f'{process} {end} after {answers} answers{state}{process.tail()}'
                )

    def silence(self, t: float, answers: int, seconds: float, rejected: str = '') -> NoAnswerError:
        """Return the error about a state without an answer.

        Parameters
        ----------
        t
            The stamp of the state, s.
        answers
            Number of answers before.
        seconds
            Wall time since the last answer, or since the first state.
        rejected
            Why the arm rejected the last command, or ''.
        """
        now, readers = self.publishers(), self.readers()
        begin = f'no answer for {seconds:.3g} s to the state at t = {t:.6g} s'
        if rejected:
            why = f'the last command was rejected, {rejected}'
        elif answers:
            # The ROS graph shows a node for some time after its end: a node that ended before the
            # run can disappear during it. The error names all nodes.
            gone = self.seen - now
            there = f'{_told(now)} still runs' if now or not gone else ''
            left = f'{_told(gone)} left the ROS graph' if gone else ''
            both = ', '.join(filter(None, (there, left)))
            why = f'commands stopped after {answers} answers, and {both}'
        else:
            why = self._missing(now, readers)
        return NoAnswerError(f'{begin}: {why}{self._outputs()}')

    def rejected(self, topic: str, t: float, answers: int, rejection: object) -> ControllerError:
        """Return the error about a command on a topic that the arm rejected at a state."""
        return ControllerError(
            f'the arm rejected the command of {_told(self.publishers())} on {topic} at '
            f't = {t:.6g} s, after {answers} answers: {rejection}'
        )

    def _missing(self, publishers: set[str], readers: set[str]) -> str:
        missing = []
        if not readers:
            missing.append(f'nobody subscribes to {self.states}')
        if not publishers:
            missing.append(f'nobody publishes commands on {" or ".join(self.commands)}')
        there = sorted(readers | publishers)
        if not missing:
            return f'{_told(there)} never published a command'
        return ', '.join(missing) + (f' ({_told(there)} is there)' if there else '')

    def _outputs(self) -> str:
        return ''.join(f'; {process} runs{process.tail()}' for process in self.processes)


def _told(names: Collection[str]) -> str:
    found = sorted(names)
    if not found:
        return 'a node'
    return f'node {found[0]!r}' if len(found) == 1 else f'nodes {listed(found)}'


def split(controllers: Sequence[Any]) -> tuple[list[Any], list[ControllerProcess]]:
    """Return the nodes and the processes among some controllers."""
    processes = [one for one in controllers if isinstance(one, ControllerProcess)]
    return [one for one in controllers if not isinstance(one, ControllerProcess)], processes
