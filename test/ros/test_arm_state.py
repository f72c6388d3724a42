# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The state of the arm: any sequence of inputs against a small model; saved, restored, replayed.

The model holds the brakes and efforts of two joints, whether the arm is active, paused or waits
for a controller, and a `pfd.Simulator`. It predicts the verdict on each message, and of each cycle
the published time, efforts and, bit for bit, the motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import pickle
import threading
from typing import Any

from arm_messages import (
    INF,
    NAN,
    STEP_NS,
    UNLIMITED,
    change,
    efforts,
    made,
    named,
    payload,
    placed,
    request,
    wrench,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test
import numpy as np
import pytest

import pfd_core as pfd
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import INPUTS as ARM_INPUTS
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.messages.joints import decode_joints

NAMES, TIP = ('shoulder', 'elbow'), 'tip_link'
START = (0.3, -0.2)
# Efforts act as they are commanded.
SETTINGS: dict[str, Any] = {
    'initial_positions': START,
    'position_sums': 'plain',
    'robot': 'planar2',
    **UNLIMITED,
}
SMALL = st.floats(-2.0, 2.0, width=32)
PAIRS = st.lists(SMALL | SMALL | st.just(NAN), min_size=2, max_size=2)
CYCLES = st.integers(0, 6)
WRONG = (
    *((ArmMessage(role, b'no message'), 'malformed') for role in ARM_INPUTS),
    (named(['elbow'] * 2, [1, 2]), 'duplicate_names'),
    (named(['nobody'], [1]), 'unknown_names'),
    (named([]), 'no_names'),
    (named(NAMES, [1]), 'ragged'),
    (named(NAMES, [1, -INF]), 'infinite'),
    (placed(['nobody'], [1]), 'unknown_names'),
)
COMMANDS = ('joint_commands', 'commands')


@dataclass
class Model:
    """The arm as its documentation describes it."""

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

    def answered(self, label: str) -> str:
        """Take note of the verdict on a command, and return it."""
        if self.lockstep and label in ('accepted', 'all_nan', 'unclaimed', 'refused'):
            self.commanded |= label == 'accepted'
            self.waits = False
        return label

    def command(self, values: list[float], problem: str) -> str:
        """Return the verdict on a command by name; NaN leaves a joint as it is."""
        if not self.active:
            return self.answered('refused')
        if problem:
            return self.answered(problem)
        if np.isnan(values).all():
            return self.answered('unclaimed' if all(self.braked) else 'all_nan')
        for joint, value in enumerate(values):
            if not np.isnan(value):
                self.effort[joint], self.braked[joint] = value, False
        return self.answered('accepted')

    def forget_commands(self, *, brake: bool) -> None:
        self.effort = [0.0, 0.0]
        if brake:
            self.braked = [True, True]
        self.since_ns = self.time_ns + STEP_NS

    def place(self, q: list[float], qd: list[float]) -> str:
        """Return the verdict on a state to jump to; a joint without a position moves on."""
        if not self.active:
            return 'refused'
        if np.isnan(q).all():
            return 'refused'
        position, velocity = self.jump or (self.simulator.q, self.simulator.qd)
        moved = ~np.isnan(q)
        self.jump = np.where(moved, q, position), np.where(moved, np.nan_to_num(qd), velocity)
        self.forget_commands(brake=False)
        return 'accepted'

    def request(self, name: str, count: int) -> str:
        if name == 'reset' and self.active:
            self.jump = np.array(START), np.zeros(2)
            self.forget_commands(brake=True)
        elif name == 'step' and self.active and self.paused:
            self.steps_left += count
        elif name in ('reset', 'step'):
            return 'refused'
        elif name in ('pause', 'resume'):
            self.paused, self.steps_left = name == 'pause', 0
        else:
            self.active = name == 'activate'
            self.waits = self.commanded = False
            if not self.active:
                self.forget_commands(brake=True)
        return 'accepted'

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


def replayed(messages: list[ArmMessage], engine: Engine) -> list[ArmMessage]:
    """Return what a fresh engine returns for the inputs among the messages of a run."""
    found: list[ArmMessage] = []
    last = max((m.cycle for m in messages if m.role not in ARM_INPUTS), default=0)
    inputs: dict[int, list[ArmMessage]] = {}
    for message in messages:
        if message.role in ARM_INPUTS:
            inputs.setdefault(message.cycle, []).append(message)
    for cycle in range(1, max([last, *inputs]) + 1):
        found += engine.step(inputs.get(cycle, ()), run=cycle <= last)[0]
    return found


class CommandedArm(RuleBasedStateMachine):
    """Messages and cycles, for the arm and for its model."""

    @initialize(lockstep=st.booleans())
    def start(self, lockstep: bool) -> None:
        self.settings = SETTINGS | {'lockstep': lockstep}
        self.arm, self.model = made(**self.settings), Model(lockstep)
        self.recorded: list[ArmMessage] = []

    def send(self, message: ArmMessage, expected: str, cycles: int) -> None:
        """Send a message, then run cycles until the arm waits."""
        produced, (found,) = self.arm.step([message], run=False)
        self.recorded += produced
        assert found.label == expected, found
        assert self.arm.waiting == self.model.waiting
        while cycles and not self.model.waiting:
            self.run_cycle()
            cycles -= 1

    def run_cycle(self) -> None:
        wanted = self.model.cycle()
        produced, _ = self.arm.step()
        self.recorded += produced
        (found,) = (decode_joints(m.data) for m in produced if m.role == 'joint_states')
        assert found.stamp_ns == self.model.time_ns
        assert found.effort.tolist() == wanted
        assert found.position.tobytes() == self.model.simulator.q.tobytes()
        assert found.velocity.tobytes() == self.model.simulator.qd.tobytes()
        assert self.arm.waiting == self.model.waiting

    # The age of the state that it answers is in cycles; None is a command without a stamp.
    @rule(values=PAIRS, age=st.sampled_from((None, 0, 1, 5)), cycles=CYCLES)
    def command_by_name(self, values: list[float], age: int | None, cycles: int) -> None:
        stamp_ns = 0 if age is None else max(0, self.model.time_ns - age * STEP_NS)
        stale = 0 != stamp_ns < self.model.since_ns
        label = self.model.command(values, 'stale' if stale else '')
        self.send(named(NAMES, values, stamp_ns=stamp_ns), label, cycles)

    @rule(values=st.lists(SMALL | st.sampled_from((NAN, INF)), max_size=3) | PAIRS, cycles=CYCLES)
    def command_without_names(self, values: list[float], cycles: int) -> None:
        problem = ''
        if len(values) != len(NAMES):
            problem = 'wrong_size'
        elif not np.isfinite(values).all():
            problem = 'not_finite'
        self.send(efforts(*values), self.model.command(values, problem), cycles)

    @rule(q=PAIRS, qd=PAIRS, cycles=CYCLES)
    def jump(self, q: list[float], qd: list[float], cycles: int) -> None:
        self.send(placed(NAMES, q, qd), self.model.place(q, qd), cycles)

    @rule(
        name=st.sampled_from(('pause', 'resume', 'step', 'reset', 'activate', 'deactivate')),
        count=st.integers(1, 5),
        cycles=CYCLES,
    )
    def ask(self, name: str, count: int, cycles: int) -> None:
        more = {'count': count} if name == 'step' else {}
        self.send(request(name, **more), self.model.request(name, count), cycles)

    @rule(compensated=st.booleans(), cycles=CYCLES)
    def change_a_setting(self, compensated: bool, cycles: int) -> None:
        self.model.compensate_gravity(compensated)
        self.send(change(gravity_compensation=compensated), 'accepted', cycles)

    @rule(wrong=st.sampled_from(WRONG), cycles=CYCLES)
    def send_a_wrong_message(self, wrong: tuple[ArmMessage, str], cycles: int) -> None:
        message, label = wrong
        if not self.model.active and message.role in (*COMMANDS, 'set_state'):
            label = 'refused'
        if message.role in COMMANDS:
            self.model.answered(label)
        self.send(message, label, cycles)

    @rule(data=st.data(), other=st.booleans())
    def save_and_restore(self, data: st.DataObject, other: bool) -> None:
        saved = pickle.loads(pickle.dumps(self.arm.save()))
        if other:
            self.arm = made(**self.settings)
        else:
            # Whatever happens after it was saved is undone.
            self.arm.step([efforts(*data.draw(PAIRS)), request('reset')])
        self.arm.restore(saved)

    def teardown(self) -> None:
        """Replay the recorded inputs."""
        if hasattr(self, 'settings'):
            assert replayed(self.recorded, made(**self.settings)) == self.recorded


# An example is a whole run, and its replay.
FEWER = settings(max_examples=settings().max_examples // 2, stateful_step_count=20)


# Smaller failing sequences are looked for during minutes.
@pytest.mark.timeout(900)
def test_any_sequence_of_messages_and_cycles_moves_the_arm_as_the_model_says():
    run_state_machine_as_test(CommandedArm, settings=FEWER)


# Everything at once.

# Delay, drop-out and noise both ways, servos, watchdog, reflex, wrench, stops, friction, lag.
RICH: dict[str, Any] = {
    'joints': NAMES[::-1],
    'delay_commands': 0.004,
    'drop_commands': 0.2,
    'command_timeout': 0.03,
    'on_timeout': 'hold',
    'servo_p': (50.0, 80.0),
    'servo_d': (4.0, 5.0),
    'reflex_effort_rate': 1e5,
    'delay_state': 0.003,
    'drop_state': 0.1,
    'noise_position': 1e-4,
    'noise_velocity': 1e-3,
    'quantization_effort': 0.01,
    'bias_position': (0.01, -0.02),
    'external_wrench': True,
    'external_wrench_timeout': 0.05,
    'joint_friction': (0.2, 0.1),
    'motor_lag': (0.01, 0.0),
    'outputs': OPTIONAL_OUTPUTS,
    'publish_rate': 500.0,
    'seed': 7,
}
CYCLES_EACH, PIECES = 50, 10


def inputs(cycle: int) -> list[ArmMessage]:
    """Return the inputs before a cycle: commands with gaps, and every other kind now and then."""
    found = []
    if cycle % 60 < 25:
        wave = np.sin(0.1 * cycle)
        target = named(NAMES, [wave, -wave], [wave, -wave], [0.5 * wave, -0.5 * wave])
        found.append(efforts(8.0 * wave, 3.0 * wave) if cycle % 3 else target)
    once = {
        70: wrench(TIP, (0.0, 3.0, 0.0)),
        130: change(payload_mass=0.7, payload_center=[0.1, 0.0, 0.0]),
        180: change(noise_velocity=0.0, servo_p=[60.0, 60.0]),
        230: payload(TIP, 0.3),
        260: placed(['elbow'], [0.4]),
        305: ArmMessage('requests', b'not a request'),
        320: request('clear_wrench'),
        410: request('reset'),
    }
    return [*found, once[cycle]] if cycle in once else found


def run(engine: Engine, cycles: int = CYCLES_EACH) -> list[ArmMessage]:
    found: list[ArmMessage] = []
    for _ in range(cycles):
        found += engine.step(inputs(engine.state.cycle + 1))[0]
    return found


@pytest.fixture(scope='module')
def whole() -> tuple[list[list[ArmMessage]], list[bytes]]:
    """Return the messages and the pickled states of a run, by pieces."""
    engine = made(**RICH)
    saved, found = [pickle.dumps(engine.save())], []
    for _ in range(PIECES):
        found.append(run(engine))
        saved.append(pickle.dumps(engine.save()))
    assert engine.state.timeouts > 2
    assert engine.state.lost > 10
    return found, saved


def test_a_fresh_arm_continues_a_saved_run_with_the_same_bits(whole):
    found, saved = whole
    # Recording, pace and start may be others.
    engine = made(**RICH, start_time=5.0, real_time_factor=0.5, recording='a.mcap')
    for k in (8, 0, 3, 5):
        state = pickle.loads(saved[k])
        engine.restore(state)
        again = engine.save()
        assert run(engine) == found[k]
        # Saved states stay as they are while the arm runs.
        assert pickle.dumps(again) == pickle.dumps(state) == pickle.dumps(pickle.loads(saved[k]))


def test_a_state_of_another_arm_is_refused():
    engine = made()
    before = engine.state
    for other, reason in (
        ({'robot': 'puma560'}, "robot='puma560', expected 'planar2'"),
        ({'seed': 8}, 'seed=8, expected 0'),
        ({'payload_mass': 0.123}, r'payload_mass=0\.123, expected 0\.0'),
    ):
        with pytest.raises(ValueError, match=reason):
            engine.restore(made(**other).save())
    assert engine.state is before


NUMBERS = (0.0, -0.0, 1.0, -3.0, 0.4, 50.0, 1e6, -1e300, NAN, INF)
PAIR = st.lists(st.sampled_from(NUMBERS[:8]), min_size=2, max_size=2)
# Mostly small numbers and NaN.
NUMBER = st.sampled_from((*NUMBERS[:6] * 5, *NUMBERS, *[NAN] * 8))
CHANGES: dict[str, st.SearchStrategy[Any]] = {
    'servo_p': st.lists(st.sampled_from((0.0, 9.0, 1e9)), min_size=2, max_size=2),
    'servo_d': st.lists(st.sampled_from((0.0, 2.0, 1e9)), min_size=2, max_size=2),
    'command_timeout': st.sampled_from((0.0, 0.004)),
    'on_timeout': st.sampled_from(('brake', 'zero', 'hold', 'stop')),
    'drop_commands': st.sampled_from((0.0, 0.5)),
    'reflex_effort_rate': st.sampled_from((0.0, 0.0, 1e4)),
    'reflex_effort_start': st.booleans(),
    'reflex_velocity': st.sampled_from((False, False, True)),
    'payload_mass': st.sampled_from((0.0, 1.0)),
    'effort_limits': st.just(True),
}
GIVEN = st.fixed_dictionaries(
    {
        'servo_p': st.sampled_from(((80.0, 0.0), (80.0, 40.0))),
        'servo_d': st.just((8.0, 4.0)),
        'delay_commands': st.sampled_from((0.0, 0.002)),
        'delay_state': st.sampled_from((0.0, 0.002)),
        'convention': st.sampled_from(('plain', 'franka')),
        'joints': st.sampled_from((NAMES, NAMES[::-1])),
        'lockstep': st.booleans(),
    }
)


@st.composite
def named_commands(draw: st.DrawFn) -> ArmMessage:
    names = draw(st.lists(st.sampled_from((*NAMES, 'nobody')), min_size=1, unique=True))
    whole = st.lists(NUMBER, min_size=len(names), max_size=len(names))
    return named(names, *(draw(whole | st.just([])) for _ in range(3)))


ANYTHING = st.one_of(
    PAIR.map(lambda values: efforts(*values)),
    st.just(efforts(1.0, 2.0, 3.0)),
    named_commands(),
    named_commands(),
    st.sampled_from([request(name) for name in ('reset', 'pause', 'resume', 'step')]),
    PAIR.map(lambda values: placed(NAMES, values)),
    st.sampled_from(sorted(CHANGES))
    .flatmap(lambda name: st.fixed_dictionaries({name: CHANGES[name]}))
    .map(lambda values: change(**values)),
    st.builds(ArmMessage, st.sampled_from(ARM_INPUTS), st.binary(max_size=60)),
)


# An example is a whole run, and its replay.
@settings(max_examples=settings().max_examples // 2)
@given(
    st.dictionaries(st.integers(1, 80), st.lists(ANYTHING, min_size=1, max_size=3), min_size=5),
    GIVEN,
)
def test_any_messages_leave_a_finite_arm_and_a_run_that_replays(events, chosen):
    engine, found = made(**chosen), []
    for k in range(1, 101):
        found += engine.step(events.get(k, ()))[0]
    assert replayed(found, made(**chosen)) == found
    # In the published order: 20 N m for the shoulder, 10 for the elbow.
    limits = [{'shoulder': 20.0, 'elbow': 10.0}[name] for name in chosen['joints']]
    for message in found:
        if message.role == 'joint_states':
            shown = decode_joints(message.data)
            assert np.isfinite([shown.position, shown.velocity]).all()
            assert (np.abs(shown.effort) <= limits).all()


def test_changes_prepared_on_threads_while_the_arm_runs_leave_its_bits_alone():
    engine, alone = made(**RICH), made(**RICH)
    bodies = [payload(TIP, 0.1 * k) for k in range(8)]
    stopped = threading.Event()

    def prepare():
        while not stopped.is_set():
            for body in bodies:
                engine.prepare(body.role, body.data)

    threads = [threading.Thread(target=prepare) for _ in range(4)]
    for thread in threads:
        thread.start()
    try:
        found = run(engine, 300)
    finally:
        stopped.set()
        for thread in threads:
            thread.join()
    assert found == run(alone, 300)
