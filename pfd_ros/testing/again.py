# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a log again, in lockstep with a controller in place of the recorded commands.

The loop is that of tests, and the arm takes the inputs of the log between its steps: wrenches,
payloads, parameters and states to set keep their cycles, and the controller computes commands in
place of the recorded ones. It begins where the recorded controller did: a callback with the state
before the first command that the arm accepted, a process one period of the commands before. A
cycle that sets the arm and has no command is that of a test between two runs: nobody answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
import importlib
import json
import os
import shlex
import sys
from typing import Any

from pfd_ros.arm.description import DescribedRobot, parsed_urdf
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import COMMANDS, DESCRIPTION, REQUESTS, SET_STATE, Message, Verdict
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.text_and_arrays import decode_string
from pfd_ros.replay.inputs import Put, Run
from pfd_ros.replay.what_if import Case, Drive
from pfd_ros.testing.callback import CallbackLink, Controller
from pfd_ros.testing.loop import (
    ArmError,
    Command,
    ControllerError,
    Link,
    NoAnswerError,
    run,
)
from pfd_ros.testing.patience import PATIENCE_SECONDS, START_PATIENCE_SECONDS
from pfd_ros.testing.process import ControllerProcess
from pfd_ros.text import cut, one_line


class _OverError(Exception):
    """The log has ended."""


@dataclass
class _Plan:
    """What the inputs of a log say about its controller, in cycles of the new run."""

    commanded: list[int]  # by commands that the arm accepted
    alone: set[int]  # set the arm, without a command
    refused: set[str]  # why the arm of the log rejected other commands
    last: int

    @classmethod
    def of(cls, case: Case, engine: Engine) -> _Plan:
        plan = cls([], set(), {'refused'}, 0)
        for message, cycle, broke in case.inputs(engine):
            if message is None:
                plan.last = cycle - 1
            elif message.role in COMMANDS and broke:
                plan.refused.add(broke)
            elif message.role in COMMANDS:
                plan.commanded.append(cycle)
            elif not broke and _sets(message):
                plan.alone.add(cycle)
        plan.alone -= set(plan.commanded)
        return plan

    def start(self, every: int, *, ahead: bool) -> int:
        """Return the cycle after which the controller begins; `ahead` by a period of commands."""
        first = self.commanded[0] if self.commanded else 1
        later = (cycle - first for cycle in self.commanded if cycle > first)
        period = next(later, 0)
        return max(0, first - 1 - (period if ahead and period > every else 0))


def _sets(message: Message) -> bool:
    """Return whether an accepted input sets the state of the arm."""
    if message.role == REQUESTS:
        return bool(json.loads(decode_string(message.data))['request'] == 'reset')
    return message.role == SET_STATE


class _LoggedArm:
    """An arm for the loop that takes the inputs of a log, but the commands of a controller."""

    def __init__(self, case: Case, engine: Engine, put: Put) -> None:
        self.engine, self.robot, self.names, self.found = engine, engine.robot, engine.names, Run()
        settings = engine.state.first
        self.period = settings.publish_every * settings.step_ns / NANOSECONDS
        self.plan, self._put = _Plan.of(case, engine), put
        self._inputs = iter(case.inputs(engine))
        self._next = next(self._inputs)

    def step(
        self, commands: Sequence[Command] = (), every: int = 1
    ) -> tuple[list[Message], list[Verdict]]:
        """Run as LockstepArm.step does, and through cycles that set the arm.

        _OverError at the end of the log; ArmError if the state does not stay finite.
        """
        state, alone = self.engine.state, self.plan.alone
        messages, verdicts = self._cycle(commands)
        while state.cycle % every and state.cycle + 1 not in alone:
            messages = [*messages, *self._cycle()[0]]  # the recorder keeps each list
        while state.cycle + 1 in alone:
            messages, _ = self._cycle()
        if state.cycle >= self.plan.last:
            raise _OverError
        return messages, verdicts

    def _cycle(self, commands: Sequence[Command] = ()) -> tuple[list[Message], list[Verdict]]:
        """Take the inputs of the next cycle, and the commands in the place of those of the log."""
        engine, state, verdicts = self.engine, self.engine.state, list[Verdict]()
        cycle, messages = state.cycle + 1, list[Message]()

        def take(inputs: Sequence[Message], broke: str = '') -> list[Verdict]:
            taken, found = engine.step(inputs, run=False)
            messages.extend(taken)
            for each, verdict in zip(inputs, found, strict=True):
                self.found.count(each.role, verdict, cycle, broke)
            return found

        waiting = [Message(*each) for each in commands]
        # An arm that waits takes the next input at once.
        while self._next.message and (self._next.cycle <= cycle or engine.waiting):
            message, broke = self._next.message, self._next.broke
            self._next = next(self._inputs)
            if message.role in COMMANDS:
                verdicts += take(waiting)
                waiting.clear()
            else:
                take([message], broke)
        verdicts += take(waiting)
        messages += engine.step()[0]
        self._put(messages, engine.stamp_ns)
        if state.failure:
            raise ArmError(state.failure)
        if state.cycle < cycle:
            raise _OverError  # a pause or a clock of the log holds the arm to the end
        return messages, verdicts


def callback_loop(controller: Controller | str) -> Drive:
    """Return what runs the arm of a log with a callback, or with the name module:function of one.

    ValueError for a name without a controller. By name, its module is imported anew for each run,
    since it may keep a state.
    """
    loaded = [named_controller(controller)] if isinstance(controller, str) else []

    def link(case: Case, engine: Engine) -> CallbackLink:
        called = controller
        if isinstance(called, str):
            called = loaded.pop() if loaded else named_controller(called)
        return CallbackLink(called, engine.names, PATIENCE_SECONDS)

    return partial(_closed_loop, link, str(controller), False)


def process_loop(command: str) -> Drive:
    """Return what runs the arm of a log with a node in a process, by its command line."""
    words = shlex.split(command)
    if not words:
        raise ValueError(f'process is {command!r}, expected the command line of a node')
    return partial(_closed_loop, partial(_process, words), command, True)


def _closed_loop(
    link_of: Callable[[Case, Engine], AbstractContextManager[Link]],
    name: str,
    ahead: bool,
    case: Case,
    engine: Engine,
    put: Put,
) -> Run:
    """Run the arm of a log with a controller; its error is in the result."""
    arm = _LoggedArm(case, engine, put)
    found, plan, settings = arm.found, arm.plan, engine.state.first
    begin = plan.start(settings.publish_every, ahead=ahead)
    try:
        while engine.state.cycle < begin or engine.state.cycle + 1 in plan.alone:
            arm.step()
        # The log ends the run; cycles that set the arm are less than a period.
        left = (plan.last - engine.state.cycle) * settings.step_ns / NANOSECONDS
        with link_of(case, engine) as link:
            found.notes = link.notes
            run(arm, link, left + (len(plan.alone) + 1) * arm.period, plan.refused)
    except _OverError:
        pass
    except ArmError as error:
        found.failure, found.failed_ns = str(error), engine.stamp_ns
    except (ControllerError, NoAnswerError) as error:
        found.failure, found.failed_ns = one_line(error), engine.stamp_ns
        found.error = error
    put(engine.counts(), engine.stamp_ns)
    answers = sum((cycle - 1) % settings.publish_every == 0 for cycle in {*plan.commanded})
    found.loop = (
        f'closed: {cut(name, 200)} in lockstep, {found.accepted} commands; the log has '
        f'{len(plan.commanded)}, {answers} of them in the step after a state'
    )
    return found


@contextmanager
def _process(words: Sequence[str], case: Case, engine: Engine) -> Iterator[Link]:
    """Start a node as a process, with the topics of the log, and end it."""
    from pfd_ros.testing.domains import own_or_current

    urdf = parsed_urdf(case.urdf, DESCRIPTION) if case.urdf else None
    described = DescribedRobot(case.robot, engine.state.first, urdf, case.topics)
    with own_or_current():
        from pfd_ros.testing.nodes import node_link

        with (
            ControllerProcess(words) as process,
            node_link(described, engine, [], [process], PATIENCE_SECONDS) as link,
        ):
            link.begin(None, START_PATIENCE_SECONDS, restored=False)
            try:
                yield link
            except _OverError:
                link.check_end((engine.stamp_ns - engine.state.origin_ns) / NANOSECONDS)


def named_controller(name: str) -> Controller:
    """Return the controller of module:function; ValueError if there is none.

    Its module is imported anew.
    """
    module, _, path = name.partition(':')
    if not all(part.isidentifier() for part in (*module.split('.'), *path.split('.'))):
        raise ValueError(f'controller must be module:function, got {cut(name)!r}')
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    sys.modules.pop(module, None)
    try:
        found: Any = importlib.import_module(module)
    except Exception as error:
        # Also the module itself is not found, or one that it imports.
        raise ValueError(
            f'controller {cut(name)!r}: importing {module} raised {type(error).__name__}: {error}'
        ) from error
    for part in path.split('.'):
        if not hasattr(found, part):
            raise ValueError(f'controller {cut(name)!r}: {module} has no {cut(part)!r}')
        found = getattr(found, part)
    if isinstance(found, type) or not callable(found):
        kind = 'a class' if isinstance(found, type) else one_line(repr(found), 100)
        raise ValueError(
            f'controller {cut(name)!r} is {kind}, expected a function (t, q, qd) -> tau, or an '
            'object that is called so'
        )
    checked: Controller = found
    return checked
