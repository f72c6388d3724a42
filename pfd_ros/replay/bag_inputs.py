# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The commands of any bag for an arm, by zero-order hold.

The first cycle sets the arm to the first complete state of the bag. After that each command is an
input of the first step at or after its time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ARRAY, NAMED, SET_STATE, Message
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.joints import decode_joints, encode_joints
from pfd_ros.messages.types import FLOAT_ARRAY, JOINT_STATE
from pfd_ros.recording.arrays import LogArrays, new_names, renamed
from pfd_ros.recording.format import LogError
from pfd_ros.replay.inputs import Input, Run
from pfd_ros.text import cut, listed

# A longer time without a message means that the clock of a bag was changed, s.
LONGEST_GAP = 3600.0
# Topic of the states where the topic of the commands has none.
USUAL_STATES = '/joint_states'


class BagInputs:
    """The commands of a bag, for an arm with joints `names` that starts at their first state.

    `commands` is a topic of JointStates with efforts, or of Float64MultiArrays in published order;
    `states` one of JointStates, '' the topic of the commands if it has positions, else
    /joint_states, or the only topic with positions. `rename` has the new beginning of joint names
    by the old one.

    `topic` is the topic of the states, `states` has its messages with renamed joints, `times_ns`
    their times, (N,): those of `times`, 'stamps' if both topics have them, else 'log times'.
    `start_ns` is the time of the first complete state. LogError if the bag has no such topic or
    state, or messages of another type.
    """

    def __init__(
        self,
        log: LogArrays,
        commands: str,
        states: str,
        rename: Mapping[str, str],
        names: Sequence[str],
    ) -> None:
        self._log, self._commands, self._rename = renamed(log, rename), commands, rename
        log.required(commands, JOINT_STATE, FLOAT_ARRAY)
        moving = log.of_type(JOINT_STATE).items()
        known = sorted(t for t, found in moving if np.isfinite(found.position).any())
        usual = [name for name in (commands, USUAL_STATES) if name in known]
        self.topic = states or (usual[0] if usual else known[0] if len(known) == 1 else '')
        if self.topic not in known:
            why = 'name the topic of the recorded states with --states'
            if states:
                why = f'topic {cut(states)!r} has no {JOINT_STATE} with positions'
            raise LogError(f'{log.path}: {why}; topics with positions are {listed(known)}')
        self.states = self._log[self.topic]
        stamped = self.states.stamped and self._log[commands].stamped
        self.times = 'stamps' if stamped else 'log times'
        stamps = self.states.stamp_ns if stamped else None
        self.times_ns: NDArray[np.int64] = self.states.log_ns if stamps is None else stamps
        self.start_ns, self._first = self._first_state(names)

    def _first_state(self, names: Sequence[str]) -> tuple[int, bytes]:
        """Return the time of the first complete state of these joints, and the state to set."""
        states = self.states
        known = [name for name in names if name in states.names]
        if not known:
            raise LogError(
                f'{self._log.path}: none of its joints {listed(states.names)} is one of the arm, '
                f'which has {listed(names)}; --rename OLD=NEW replaces the beginning of names'
            )
        # Several publishers may name some of the joints each.
        held = {name: np.isfinite(states.position[:, states.names.index(name)]) for name in known}
        known = [name for name in known if held[name].any()]
        if not known:
            raise LogError(f'{self._log.path}: topic {cut(self.topic)!r} has no positions of them')
        last = max(int(held[name].argmax()) for name in known)
        rows = [int(np.flatnonzero(held[name][: last + 1])[-1]) for name in known]
        columns = [states.names.index(name) for name in known]
        qd = states.velocity[rows, columns]
        qd = np.where(np.isfinite(qd), qd, 0.0)
        return int(self.times_ns[last]), encode_joints(known, states.position[rows, columns], qd)

    def inputs(self, engine: Engine) -> Iterator[Input]:
        """Yield the inputs for an arm before its first cycle; LogError for a gap."""
        commands = sorted(self._efforts(), key=itemgetter(0))
        times = np.array([at for at, _ in commands], np.int64)
        every = np.sort(np.concatenate([times, self.times_ns]))
        gaps = np.diff(every[every >= self.start_ns]) / NANOSECONDS
        if len(gaps) and gaps.max() > LONGEST_GAP:
            raise LogError(
                f'{self._log.path}: no message for {gaps.max():.0f} s, expected {LONGEST_GAP:.0f} '
                's at most: its clock was changed'
            )
        step_ns = engine.state.first.step_ns
        # Cycle k begins k - 2 steps after the first state, which the first cycle sets.
        end = 2 - (self.start_ns - int(self.times_ns.max())) // step_ns
        yield Input(Message(SET_STATE, self._first), 1)
        for at, message in commands:
            cycle = 2 + max(0, -((self.start_ns - at) // step_ns))
            if cycle < end:
                yield Input(message, cycle)
        yield Input(None, end)

    def check(self, run: Run) -> None:
        """Raise LogError if an arm took no command, or could not be set to the first state."""
        if run.first_rejected.startswith('cycle 1:'):
            why = run.first_rejected.removeprefix('cycle 1: ')
            raise LogError(f'{self._log.path}: its first state cannot be set: {why}')
        if not run.accepted:
            raise LogError(
                f'{self._log.path}: no message on {cut(self._commands)!r} has efforts for the '
                f'joints of the arm: {dict(run.rejected)}'
            )

    def _efforts(self) -> Iterator[tuple[int, Message]]:
        """Yield the times and commands; those that cannot be decoded are left out."""
        received = self._log.received_ns[self._commands].tolist()
        for at, data in zip(received, self._log.messages(self._commands), strict=True):
            if self._log.topics[self._commands] == FLOAT_ARRAY:
                yield at, Message(ARRAY, data)
                continue
            with suppress(ValueError):
                joints = decode_joints(data)
                # Positions may be those of a state: no targets.
                data = encode_joints(new_names(joints.names, self._rename), effort=joints.effort)
                yield joints.stamp_ns if self.times == 'stamps' else at, Message(NAMED, data)
