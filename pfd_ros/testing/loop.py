# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in lockstep with a controller: one loop over a link, and the link to a callback.

    run(arm, link, seconds, allowed)     publish messages, take commands, step
    CallbackLink                         controller(t, q, qd) -> tau

The arm never waits for a command. A link gives each message to the controllers, waits until they
have finished what follows from it, and returns what they commanded: nothing, one or several
commands. So the same commands come before the same cycles, however long a controller computes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
import math
from time import perf_counter
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ACCEPTED, ARRAY, LABELS, NAMED, UNCLAIMED, Message, Verdict
from pfd_ros.arm.state import BRAKE
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS, decode_joints
from pfd_ros.messages.values import encode_floats
from pfd_ros.motion.metrics import Array
from pfd_ros.testing.patience import BlockedError, Watch
from pfd_ros.testing.trajectory import Limits, Trajectory, checked_numbers
from pfd_ros.text import did_you_mean, listed, one_line

# The role and the bytes of a message.
Command: TypeAlias = tuple[str, bytes]
FLOAT = np.dtype('<f8')
# controller(t, q, qd) -> tau, with q, qd and tau (n,) in published order; SI units, t in s.
Controller: TypeAlias = Callable[[float, Array, Array], ArrayLike]
# The names that `allow_rejected` takes.
REASONS = tuple(label for label in LABELS if label not in (ACCEPTED.label, UNCLAIMED.label))
# Share of a control period by which a time may miss the end of the last one.
SLACK = 1e-6


class ArmError(Exception):
    """The simulation stopped, because its state is not finite."""


class ControllerError(Exception):
    """A controller raised, blocks, or its command was rejected."""


class RejectedError(ControllerError):
    """The arm rejected a command for a reason that the test does not allow."""


class NoAnswerError(Exception):
    """No controller answered."""


class Link(Protocol):
    """What the loop needs of a link."""

    silent: bool  # needs no messages, `measured` of each published state is enough
    seconds: float  # wall time that the controller took for the last command
    notes: list[str]  # why the run may differ another time

    def answer(
        self, messages: Sequence[Message], time: float, measured: Array
    ) -> Sequence[Command]:
        """Return the commands, role and bytes, that follow messages of the arm.

        `measured` are positions, velocities and efforts (3, n) of the state at `time` [s], a copy
        that the link may change.
        """

    def rejected(self, time: float, verdict: Verdict) -> Exception:
        """Return the error about a command that the arm rejected at `time`."""


def seconds_of(stamp_ns: int) -> float:
    """Return a stamp in seconds, as most nodes compute it: stamp.sec + 1e-9 * stamp.nanosec."""
    seconds, rest = divmod(stamp_ns, NANOSECONDS)
    return seconds + 1e-9 * rest


def run(arm: Any, link: Link, seconds: float, allowed: Collection[str] = ()) -> Trajectory:
    """Return the motion of an arm, a LockstepArm, for some simulated seconds.

    `allowed` has reasons for which commands may be rejected. Errors are those of the arm and of
    the link; ValueError unless the seconds are finite and above zero.
    """
    checked_numbers(
        'seconds', seconds, ((),), 'one finite number above 0', lambda x: 0.0 < x < math.inf
    )
    engine, silent = arm.engine, link.silent
    settings = engine.state.settings
    every = settings.publish_every
    if not silent and settings.publish_clock:
        # States and clock ticks may have periods of their own.
        every = math.gcd(every, settings.clock_every)
    # Whether each round ends in a published state.
    always = every == settings.publish_every and not settings.drop_state
    count = max(1, math.ceil(seconds / arm.period - SLACK))
    times, compute_time = np.empty(count), np.full(count, math.nan)
    # Position, velocity and effort; the effort of a row is in the next state, with which the next
    # run begins.
    states = np.empty((count + 1, 3, len(arm.names)))
    messages = [] if silent else engine.present()
    step, answer, measure, accepted = arm.step, link.answer, engine.measured, [ACCEPTED]
    # States may show the torques or currents of motors: a motion has the efforts, as limits do.
    acted = settings.state_effort != 'command'
    published, k, sent = True, 0, list[int]()
    end_ns = engine.stamp_ns + round(count * arm.period * NANOSECONDS)
    while True:
        time, measured = seconds_of(engine.stamp_ns), measure()
        if published:
            states[k] = measured
            if acted:
                states[k, 2] = engine.state.rows[engine.state.now, 2, engine.all_joints]
            # A lost state has no row, but time.
            if k == count or engine.stamp_ns >= end_ns:
                break
            times[k] = time
            k += 1
        commands = answer(messages, time, measured)
        if commands:
            compute_time[k - 1] = link.seconds
            sent.append(engine.stamp_ns)
        messages, verdicts = step(commands, every)
        if verdicts != accepted or not silent:
            for command, verdict in zip(commands, verdicts, strict=True):
                found = rejection(command, verdict, engine)
                if found is not None and found.label not in allowed:
                    raise link.rejected(time, found)
        published = always or engine.published
    order, robot = engine.order, arm.robot
    braked = engine.state.acting[BRAKE][order] > 0.0
    bounds = robot.position_lower, robot.position_upper, robot.velocity_limit, robot.effort_limit
    q, qd, tau = (np.array(x) for x in (states[:k, 0], states[:k, 1], states[1 : k + 1, 2]))
    return Trajectory(
        *(times[:k], q, qd, tau, arm.names, Limits(*(bound[order] for bound in bounds)), robot),
        compute_time=compute_time[:k],
        # A timer has a period of its own.
        period=arm.period if len(sent) < 3 else float(np.median(np.diff(sent))) / NANOSECONDS,
        commanded=(tau.any(axis=0) | ~braked).tolist(),
        notes=link.notes,
    )


def rejection(command: Command, verdict: Verdict, engine: Engine) -> Verdict | None:
    """Return why the arm rejected a command or a part of it, None if it accepted all.

    The arm accepts a message by name that commands one of its joints. It ignores names that it
    does not have, and joints without a number keep their last command: a part is rejected.
    Without a servo, efforts alone are commands.
    """
    if verdict.label == UNCLAIMED.label:
        return Verdict('all_nan', verdict.detail)
    if not verdict.accepted:
        return verdict
    for remark in verdict.remarks:
        if remark.label in REASONS:
            return remark
    if command[0] != NAMED:
        return None
    joints = decode_joints(command[1])
    kinds = JOINT_FIELDS if engine.actuators.servo else ('effort',)
    arrays = [x for x in (getattr(joints, kind) for kind in kinds) if len(x)]
    without = np.flatnonzero(np.isnan(arrays).all(axis=0)).tolist()
    left = [joints.names[j] for j in without if joints.names[j] in engine.names]
    return Verdict('all_nan', f'NaN for {listed(left)}') if left else None


def checked_reasons(given: Collection[str]) -> frozenset[str]:
    """Return the reasons that a test allows; ValueError if one is not known."""
    names = {given} if isinstance(given, str) else set(given)
    for name in sorted(names - set(REASONS)):
        hint = did_you_mean(str(name), REASONS, f'expected some of {list(REASONS)}')
        raise ValueError(f'allow_rejected has {name!r}: {hint}')
    return frozenset(names)


class CallbackLink:
    """A controller that is called with each state; the arrays are its own.

    `watch` is a context around the runs.
    """

    silent = True

    def __init__(self, controller: Controller, names: Sequence[str], watch: Watch) -> None:
        self._controller, self._names, self._watch = controller, names, watch
        numbers = np.zeros(len(names))
        self._head = encode_floats(numbers)[: -numbers.nbytes]
        self._answers, self._efforts = 0, np.empty(0)
        self.seconds, self.notes = math.nan, list[str]()

    def answer(
        self, messages: Sequence[Message], time: float, measured: Array
    ) -> Sequence[Command]:
        """Return the command with which the controller answers a state."""
        watch, q, qd = self._watch, measured[0], measured[1]
        begun = watch.since = perf_counter()
        try:
            efforts: Any = self._controller(time, q, qd)
            watch.since = 0.0
        except BlockedError:
            pass
        except Exception as error:
            text = one_line(f'{type(error).__name__}: {error}')
            raise ControllerError(f'the controller raised at t = {time:.6g} s: {text}') from error
        self.seconds = perf_counter() - begun
        if watch.stack:
            # Also if it caught what interrupted it.
            raise ControllerError(watch.report(time, self._answers))
        if (
            type(efforts) is not np.ndarray
            or efforts.dtype is not FLOAT
            or efforts.shape != q.shape
        ):
            efforts = self._converted(efforts, time)
        # The arm checks whether they are finite.
        self._efforts = efforts
        self._answers += 1
        return ((ARRAY, self._head + efforts.tobytes()),)

    def _converted(self, answer: Any, time: float) -> Array:
        names = list(self._names)
        try:
            efforts = np.asarray(answer)
            if efforts.dtype.kind not in 'iuf' or efforts.shape != (len(names),):
                raise ValueError
            return efforts.astype(FLOAT)
        except (TypeError, ValueError):
            shape = f', of shape {answer.shape}' if isinstance(answer, np.ndarray) else ''
            raise ControllerError(
                f'the controller returned {one_line(repr(answer), 200)}{shape} at '
                f't = {time:.6g} s, expected {len(names)} numbers, an effort for each of {names}'
            ) from None

    def rejected(self, time: float, verdict: Verdict) -> Exception:
        """Return the error about efforts that the arm did not accept."""
        wrong = np.flatnonzero(~np.isfinite(self._efforts)).tolist()
        if not wrong:
            return RejectedError(
                f'the arm rejected the efforts at t = {time:.6g} s: {verdict.label}: '
                f'{verdict.detail}'
            )
        told = ', '.join(f'{self._efforts[j]} for joint {self._names[j]!r}' for j in wrong)
        return RejectedError(
            f'the controller returned {told} at t = {time:.6g} s, expected finite efforts'
        )
