# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a log again: in lockstep with a controller, or as a motion with assertions.

    motion = replayed(LOG, 'new.mcap', controller=law)     law(t, q, qd) -> tau
    motion = recorded(LOG)                                 the motion as it was recorded

The loop is that of tests, and the arm takes the inputs of the log between its steps: wrenches,
payloads, parameters and states to set keep their cycles, and the controller computes commands in
place of the recorded ones. It begins where the recorded controller did: a callback with the state
before the first command that the arm accepted, a process one period of the commands before. A
cycle that sets the arm and has no command is that of a test between two runs: nobody answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
import importlib
from operator import attrgetter
import os
from pathlib import Path
import shlex
import sys

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.description import DescribedRobot, parsed_urdf
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import COMMANDS, DESCRIPTION, REQUESTS, SET_STATE, Message, Verdict
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.motion import symptoms
from pfd_ros.page import findings as findings_of_page
from pfd_ros.page.page import TYPES, faults
from pfd_ros.page.recorded import Recorded
from pfd_ros.recording.arrays import read_log
from pfd_ros.recording.format import LogError
from pfd_ros.replay.inputs import Fed, Put, Run
from pfd_ros.replay.what_if import Case, Drive, what_if
from pfd_ros.testing import loop
from pfd_ros.testing.loop import ArmError, CallbackLink, Command, Controller, Link
from pfd_ros.testing.patience import PATIENCE_SECONDS, START_PATIENCE_SECONDS, Watch
from pfd_ros.testing.process import ControllerProcess
from pfd_ros.testing.trajectory import Limits, Trajectory
from pfd_ros.text import cut, did_you_mean, one_line


class _OverError(Exception):
    """The log has ended."""


class _LoggedArm:
    """An arm for the loop that takes the inputs of a log, but the commands of a controller."""

    def __init__(self, case: Case, engine: Engine, put: Put) -> None:
        self.engine, self.robot, self.names = engine, engine.robot, engine.names
        settings = engine.state.first
        self.period = settings.publish_every * settings.step_ns / NANOSECONDS
        self._fed = Fed(case.inputs(engine), engine, put)
        self.found = self._fed.found
        # Cycles with commands that the arm accepted, and those that only set the arm; why it
        # rejected other commands, which is no error now; its last cycle.
        self.commanded, self.alone, self.rejected = list[int](), set[int](), {'refused'}
        for message, cycle, broke in case.inputs(engine):
            if message is None:
                self.last = cycle - 1
            elif message.role in COMMANDS and broke:
                self.rejected.add(broke)
            elif message.role in COMMANDS:
                self.commanded.append(cycle)
            elif not broke and (
                message.role == SET_STATE
                or (message.role == REQUESTS and b'"reset"' in message.data)
            ):
                self.alone.add(cycle)
        self.alone -= {*self.commanded}

    def step(
        self, commands: Sequence[Command] = (), every: int = 1
    ) -> tuple[list[Message], list[Verdict]]:
        """Run as LockstepArm.step does, and through cycles that set the arm.

        _OverError at the end of the log; ArmError if the state does not stay finite.
        """
        state, alone = self.engine.state, self.alone
        messages, verdicts = self._cycle(commands)
        while state.cycle % every and state.cycle + 1 not in alone:
            messages = [*messages, *self._cycle()[0]]  # the recorder keeps each list
        while state.cycle + 1 in alone:
            messages, _ = self._cycle()
        if state.cycle >= self.last:
            raise _OverError
        return messages, verdicts

    def _cycle(self, commands: Sequence[Command] = ()) -> tuple[list[Message], list[Verdict]]:
        state = self.engine.state
        cycle, found = state.cycle + 1, self._fed.cycle([Message(*each) for each in commands])
        if state.failure:
            raise ArmError(state.failure)
        if state.cycle < cycle:
            raise _OverError  # a pause or a clock of the log holds the arm to the end
        return found


def closed_loop(controller: Controller | str = '', process: str = '') -> Drive:
    """Return what runs the arm of a log with a controller; its error is in the result.

    The controller is a callback, the name module:function of one, whose module is imported anew
    for each run, or the command line of a process.
    """
    words = shlex.split(process)

    def drive(case: Case, engine: Engine, put: Put) -> Run:
        arm, state, notes = _LoggedArm(case, engine, put), engine.state, list[str]()
        found, every = arm.found, state.first.publish_every
        # A timer of a node commands a period after the node has begun.
        first = arm.commanded[0] if arm.commanded else 1
        period = next((cycle - first for cycle in arm.commanded if cycle > first), 0)
        begin = first - 1 - (period if words and period > every else 0)
        try:
            while state.cycle < begin or state.cycle + 1 in arm.alone:
                arm.step()
            # The log ends the run; cycles that set the arm are less than a period.
            left = (arm.last - state.cycle) * state.first.step_ns / NANOSECONDS
            with ExitStack() as ends:
                if words:
                    link: Link = ends.enter_context(_process(words, case, engine))
                else:
                    law = controller
                    if isinstance(law, str):
                        law = named_controller(law)
                    watch = ends.enter_context(Watch(PATIENCE_SECONDS))
                    link = CallbackLink(law, engine.names, watch)
                notes = link.notes
                loop.run(arm, link, left + (len(arm.alone) + 1) * arm.period, arm.rejected)
        except (_OverError, ArmError):
            pass
        except (loop.ControllerError, loop.NoAnswerError) as error:
            found.failure, found.failed_ns = one_line(error), engine.stamp_ns
            found.error = error
        answers = sum((cycle - 1) % every == 0 for cycle in {*arm.commanded})
        found.loop = (
            f'closed: {cut(process or str(controller), 200)} in lockstep, {found.accepted} '
            f'commands; the log has {len(arm.commanded)}, {answers} of them in the step after a '
            f'state{"".join(f"; {note}" for note in notes)}'
        )
        return found

    return drive


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
    """Return the controller of module:function, imported anew; ValueError if there is none."""
    module, _, path = name.partition(':')
    if not module or not path:
        raise ValueError(f'controller must be module:function or a process, got {cut(name)!r}')
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    sys.modules.pop(module, None)
    try:
        found: Controller = attrgetter(path)(importlib.import_module(module))
    except Exception as error:  # whatever the module raises
        raise ValueError(f'controller {cut(name)!r}: {type(error).__name__}: {error}') from error
    if isinstance(found, type) or not callable(found):
        kind = one_line(repr(found), 100)
        raise ValueError(f'controller {cut(name)!r} is {kind}, expected a function (t, q, qd)')
    return found


def replayed(
    log: Path | str,
    out: Path | str,
    changes: Sequence[str] = (),
    *,
    controller: Controller | None = None,
) -> Trajectory:
    """Run the arm of a recording again, record it in a new file, and return the new motion.

    `changes` are settings that differ, as `pfd replay --what-if` takes them: 'payload.mass=2'. A
    controller(t, q, qd) -> tau computes the commands in place of the recorded ones. If the
    simulation fails, the motion ends there, and `motion.stopped` says why. Errors are those of
    the controller, as in LockstepArm.run, and of pfd_ros.replay.what_if.
    """
    drive = None if controller is None else closed_loop(controller)
    found = what_if(log, changes, out=Path(out), drive=drive)
    if found.error is not None:
        raise found.error
    return replace(recorded(out), stopped=found.failure)


def recorded(log: Path | str, joint: str = '', *, robot: str | None = None) -> Trajectory:
    """Return the motion in any log: of all joints that are published together with `joint`.

    `robot` names the robot of a log that holds none, for its limits. Times are those of the page
    of the log, and `tau` has the efforts of each state; where these are no efforts of the motors
    but torques with gravity or currents, those of true_states, or no limit. LogError without
    states of the joint.
    """
    run = _read(log, robot)
    joints = next((each for each in run.joints if joint in ('', *each.names)), None)
    if joints is None:
        raise LogError(f'{log} has no joint states{f" of {cut(joint)!r}" if joint else ""}')
    # A state that was sent again has the same stamp: the first is taken.
    rows = np.append(True, np.diff(joints.time) > 0.0)
    q, qd, tau = (joints.values[item][rows] for item in JOINT_FIELDS)
    (lower, upper), (_, speed), (_, effort) = (joints.bounds[item] for item in JOINT_FIELDS)
    for each in run.drives:
        if each.names == joints.names and np.array_equal(each.time, joints.time):
            tau, effort = each.values['effort'][rows], each.bounds['effort'][1]
    # Without all joints of a robot its tip is not known.
    whole = run.robot is not None and {*run.robot.joint_names} <= {*joints.names}
    return Trajectory(
        *(joints.time[rows], q, qd, tau, joints.names, Limits(lower, upper, speed, effort)),
        run.robot if whole else None,
        period=run.command_period,
        commanded=[not run.settings or name in run.commanded for name in joints.names],
    )


def findings(
    log: Path | str, kind: str, joint: str = '', *, robot: str | None = None
) -> list[str]:
    """Return what the page of a log finds of one kind at one joint, or at none; [] if nothing.

    ValueError for an unknown kind, LogError for a joint without states: a test of it would pass.
    """
    run, kinds = _read(log, robot), {*findings_of_page.KINDS, *symptoms.KINDS}
    if kind not in kinds:
        hint = did_you_mean(kind, kinds, f'expected one of {sorted(kinds)}')
        raise ValueError(f'kind is {cut(kind)!r}: {hint}')
    found = faults(run)
    if joint not in ('', *run.names, *(each.joint for each in found)):
        raise LogError(f'{log} has no joint states of {cut(joint)!r}')
    chosen = [each for each in found if (each.kind, each.joint) == (kind, joint)]
    return [f't = {each.time:.6g} s: {each.text}' for each in chosen]


def _read(log: Path | str, robot: str | None) -> Recorded:
    found = None if robot is None else pfd.load_robot(robot)
    return Recorded(read_log(log, types=TYPES, unreadable='count'), found)
