# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any sequence of commands, requests, jumps and transitions, against a small model of the arm.

The model holds the brakes and efforts of two joints, whether the arm is active, paused or waits
for a controller, and a `pfd.Simulator`. It predicts the result of validation of each message, and
of each cycle the published time, efforts and, bit for bit, the motion. At the end the same events
are recorded and replayed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
import tempfile
from typing import Any

from bridge import Arrival, JointMessage, Source, Verdict, decode_joint_state, read_recording
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    rule,
    run_state_machine_as_test,
)
import numpy as np
from plant_messages import UNLIMITED, Message, change, efforts, joint_state, made, request
import pytest
from simulating import simulate, states_of

import pfd_core as pfd

NAMES = ('shoulder', 'elbow')
START = (0.3, -0.2)
STEP_NS = 1_000_000
NAN, INF = float('nan'), float('inf')
# Efforts act as they are commanded.
SETTINGS: dict[str, Any] = {
    'robot': 'planar2',
    'initial_positions': START,
    'position_sums': 'plain',
    **UNLIMITED,
}
SMALL = st.floats(-2.0, 2.0, width=32)
PAIRS = st.lists(SMALL | SMALL | st.just(NAN), min_size=2, max_size=2)
CYCLES = st.integers(0, 6)
WRONG = (
    *((source, b'no message', Verdict.MALFORMED) for source in Source),
    (Source.NAMED, joint_state(['elbow'] * 2, effort=[1, 2]), Verdict.DUPLICATE_NAMES),
    (Source.NAMED, joint_state(['nobody'], effort=[1]), Verdict.UNKNOWN_NAMES),
    (Source.NAMED, joint_state([], effort=[]), Verdict.NO_NAMES),
    (Source.NAMED, joint_state(NAMES, effort=[1]), Verdict.RAGGED),
    (Source.NAMED, joint_state(NAMES, effort=[1, -INF]), Verdict.INFINITE),
    (Source.SET_STATE, joint_state(['nobody'], [1]), Verdict.UNKNOWN_NAMES),
)
ANSWERS = (Verdict.ACCEPTED, Verdict.ALL_NAN, Verdict.REFUSED)


@dataclass
class Model:
    """The arm as its documentation describes it; a message is (source, bytes)."""

    lockstep: bool
    active: bool = True
    paused: bool = False
    waits: bool = False
    commanded: bool = False
    steps_left: int = 0
    time_ns: int = 0
    # Commands stamped before it are stale.
    since_ns: int = 0
    effort: list[float] = field(default_factory=lambda: [0.0, 0.0])
    braked: list[bool] = field(default_factory=lambda: [True, True])
    # Where the next cycle jumps to: None, or positions and velocities.
    jump: tuple[np.ndarray, np.ndarray] | None = None

    def __post_init__(self) -> None:
        self.simulator = self.simulator_of(compensated=False)
        self.simulator.reset(q=START)

    def simulator_of(self, *, compensated: bool) -> pfd.Simulator:
        scene = pfd.Scene(gravity_compensation=compensated, brakes=True)
        robot, step_size = pfd.load_robot('planar2'), STEP_NS * 1e-9
        return pfd.Simulator(robot, scene, step_size=step_size, compensated=False)

    @property
    def waiting(self) -> bool:
        """Whether there is no cycle now; a jump needs neither a step nor an answer."""
        stopped = self.waits or (self.paused and not self.steps_left)
        return not self.active or (stopped and self.jump is None)

    def answered(self, verdict: Verdict) -> Verdict:
        """Take note of a command's validation, and return it."""
        if self.lockstep and verdict in ANSWERS:
            self.commanded |= verdict is Verdict.ACCEPTED
            self.waits = False
        return verdict

    def command(self, values: list[float], problem: Verdict | None) -> Verdict:
        """Return the verdict on a command by name; NaN leaves a joint as it is."""
        if not self.active:
            return self.answered(Verdict.REFUSED)
        if problem is not None:
            return self.answered(problem)
        if np.isnan(values).all():
            return self.answered(Verdict.ALL_NAN)
        for joint, value in enumerate(values):
            if not np.isnan(value):
                self.effort[joint], self.braked[joint] = value, False
        return self.answered(Verdict.ACCEPTED)

    def forget_commands(self, *, brake: bool) -> None:
        self.effort = [0.0, 0.0]
        if brake:
            self.braked = [True, True]
        self.since_ns = self.time_ns + STEP_NS

    def place(self, q: list[float], qd: list[float]) -> Verdict:
        """Return the verdict on a state to jump to; a joint without a position moves on."""
        if not self.active:
            return Verdict.REFUSED
        if np.isnan(q).all():
            return Verdict.ALL_NAN
        position, velocity = self.jump or (self.simulator.q, self.simulator.qd)
        moved = ~np.isnan(q)
        self.jump = np.where(moved, q, position), np.where(moved, np.nan_to_num(qd), velocity)
        self.forget_commands(brake=False)
        return Verdict.ACCEPTED

    def request(self, name: str, count: int) -> Verdict:
        if name == 'reset' and self.active:
            self.jump = np.array(START), np.zeros(2)
            self.forget_commands(brake=True)
        elif name == 'step' and self.active and self.paused:
            self.steps_left += count
        elif name in ('reset', 'step'):
            return Verdict.REFUSED
        elif name in ('pause', 'resume'):
            self.paused, self.steps_left = name == 'pause', 0
        else:
            self.active = name == 'activate'
            self.waits = self.commanded = False
            if not self.active:
                self.forget_commands(brake=True)
        return Verdict.ACCEPTED

    def compensate_gravity(self, compensated: bool) -> None:
        changed = self.simulator_of(compensated=compensated)
        changed.reset(self.simulator.q, self.simulator.qd)
        self.simulator = changed

    def cycle(self) -> list[float]:
        """Run a cycle; return the efforts that it publishes."""
        acting = self.effort.copy()
        if self.jump is None:
            self.simulator.step(acting, brakes=np.array(self.braked))
        else:
            self.simulator.reset(*self.jump)
            acting, self.jump = [0.0, 0.0], None
        self.time_ns += STEP_NS
        self.steps_left = max(0, self.steps_left - 1)
        self.waits = self.lockstep and self.commanded
        if self.waits:
            self.since_ns = self.time_ns
        return acting


class CommandedArm(RuleBasedStateMachine):
    """Messages and cycles, for the arm and for its model."""

    @initialize(lockstep=st.booleans())
    def start(self, lockstep: bool) -> None:
        self.settings = SETTINGS | {'lockstep': lockstep}
        self.arm, self.model = made(**self.settings), Model(lockstep)
        # By the cycle that takes them.
        self.events: dict[int, list[Message]] = {}
        self.cycles = 0
        self.states: list[JointMessage] = []

    def send(self, message: Message, expected: Verdict, cycles: int) -> None:
        """Send a message, then run cycles until the arm waits."""
        self.events.setdefault(self.cycles + 1, []).append(message)
        source, data = message
        ((_, validation, _),) = self.arm.take([Arrival(source, 1, data)]).validations
        assert validation.verdict is expected, validation
        assert self.arm.waiting == self.model.waiting
        while cycles and not self.model.waiting:
            self.run_cycle()
            cycles -= 1

    def run_cycle(self) -> None:
        self.cycles += 1
        wanted = self.model.cycle()
        outputs = {output.role: output for output in self.arm.step()}
        found = decode_joint_state(outputs['joint_states'].data)
        assert outputs['joint_states'].number == self.cycles
        assert found.stamp_ns == self.model.time_ns
        assert found.effort.tolist() == wanted
        assert found.position.tobytes() == self.model.simulator.q.tobytes()
        assert found.velocity.tobytes() == self.model.simulator.qd.tobytes()
        assert self.arm.waiting == self.model.waiting
        self.states.append(found)

    @rule(
        values=PAIRS,
        # Of the state that it answers, in cycles; None is a command without a stamp.
        age=st.sampled_from((None, 0, 1, 5)),
        cycles=CYCLES,
    )
    def command_by_name(self, values: list[float], age: int | None, cycles: int) -> None:
        stamp_ns = 0 if age is None else max(0, self.model.time_ns - age * STEP_NS)
        stale = 0 != stamp_ns < self.model.since_ns
        data = joint_state(NAMES, effort=values, stamp_ns=stamp_ns)
        verdict = self.model.command(values, Verdict.STALE if stale else None)
        self.send((Source.NAMED, data), verdict, cycles)

    @rule(values=st.lists(SMALL | st.sampled_from((NAN, INF)), max_size=3) | PAIRS, cycles=CYCLES)
    def command_without_names(self, values: list[float], cycles: int) -> None:
        problem = None
        if len(values) != len(NAMES):
            problem = Verdict.WRONG_SIZE
        elif not np.isfinite(values).all():
            problem = Verdict.NOT_FINITE
        self.send((Source.ARRAY, efforts(*values)), self.model.command(values, problem), cycles)

    @rule(q=PAIRS, qd=PAIRS, cycles=CYCLES)
    def jump(self, q: list[float], qd: list[float], cycles: int) -> None:
        self.send((Source.SET_STATE, joint_state(NAMES, q, qd)), self.model.place(q, qd), cycles)

    @rule(
        name=st.sampled_from(('pause', 'resume', 'step', 'reset', 'activate', 'deactivate')),
        count=st.integers(1, 5),
        cycles=CYCLES,
    )
    def ask(self, name: str, count: int, cycles: int) -> None:
        self.send(request(name, count), self.model.request(name, count), cycles)

    @rule(compensated=st.booleans(), cycles=CYCLES)
    def change_a_setting(self, compensated: bool, cycles: int) -> None:
        self.model.compensate_gravity(compensated)
        self.send(change(gravity_compensation=compensated), Verdict.ACCEPTED, cycles)

    @rule(wrong=st.sampled_from(WRONG), cycles=CYCLES)
    def send_a_wrong_command(self, wrong: tuple[Source, bytes, Verdict], cycles: int) -> None:
        source, data, problem = wrong
        moving = source in (Source.NAMED, Source.ARRAY, Source.SET_STATE)
        verdict = problem if self.model.active or not moving else Verdict.REFUSED
        if source in (Source.NAMED, Source.ARRAY):
            self.model.answered(verdict)
        self.send((source, data), verdict, cycles)

    def teardown(self) -> None:
        """Record the same events and replay them."""
        if not self.states:
            return
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / 'a.mcap'
            simulate(self.cycles, self.events, **self.settings).save(path)
            assert read_recording(path, verify=True).complete
            again = states_of(path)
        for one, other in zip(self.states, again, strict=True):
            assert one.stamp_ns == other.stamp_ns
            for kind in ('position', 'velocity', 'effort'):
                assert getattr(one, kind).tobytes() == getattr(other, kind).tobytes()


# An example is a whole run, and its recording.
FEWER = settings(max_examples=settings().max_examples // 2, stateful_step_count=20)


# Smaller failing sequences are looked for during minutes.
@pytest.mark.timeout(900)
def test_any_sequence_of_messages_and_cycles_moves_the_arm_as_the_model_says() -> None:
    run_state_machine_as_test(CommandedArm, settings=FEWER)
