# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes in lockstep with the arm have the same bits in each run, wherever they run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from tested_controllers import command_of, node_of, pd

from pfd_ros.testing import ControllerProcess, LockstepArm, NoAnswerError, Trajectory

pytestmark = pytest.mark.ros

SECONDS = 0.15
UR5: dict[str, Any] = {'robot': 'ur5', 'armature': True}


def bits(motion: Trajectory) -> bytes:
    return b''.join(x.tobytes() for x in (motion.time, motion.q, motion.qd, motion.tau))


@pytest.fixture
def spin(domain: int) -> Callable[..., Trajectory]:
    """Return a function that runs controllers, some here and some as processes."""

    def run(
        here: list[str], there: list[str], seconds: float = SECONDS, **more: Any
    ) -> Trajectory:
        with ExitStack() as stack:
            processes = [stack.enter_context(ControllerProcess(command_of(x))) for x in there]
            nodes = [node_of(kind) for kind in here]
            for node in nodes:
                stack.callback(node.destroy_node)
            arm = stack.enter_context(LockstepArm(**UR5, **more))
            motion = arm.spin(seconds, *nodes, *processes)
            # No timer on the clock of the arm saw another state than that of its tick.
            assert all(node.late == 0 for node in nodes) or here[0] in ('wall', 'steady')
            return motion

    return run


@pytest.mark.parametrize(
    ('kind', 'runs'),
    [
        *((kind, 3) for kind in ('states', 'pairs', 'timer', 'filter', 'two', 'flag', 'lazy')),
        *(pytest.param(kind, 20, marks=pytest.mark.long) for kind in ('filter', 'two')),
    ],
)
def test_nodes_of_this_process_have_the_same_bits_in_each_run(kind: str, runs: int, spin) -> None:
    motions = [spin([kind], []) for _ in range(runs)]
    assert np.ptp(motions[0].q, axis=0).min() > 1e-3
    assert len({bits(motion) for motion in motions}) == 1
    assert [motion.notes for motion in motions] == [[]] * runs


@pytest.mark.parametrize(
    ('kind', 'runs'),
    [
        *((kind, 1) for kind in ('states', 'pairs', 'filter', 'two', 'reads')),
        *(pytest.param(kind, 20, marks=pytest.mark.long) for kind in ('filter', 'two', 'cpp')),
    ],
)
@pytest.mark.slow
def test_a_process_has_the_bits_of_a_node_of_this_process(kind: str, runs: int, spin) -> None:
    expected = spin(['filter' if kind == 'cpp' else kind], [])
    for _ in range(runs):
        found = spin([], [kind])
        assert found.notes == []
        assert bits(found) == bits(expected)


# Seconds of today have no exact nanoseconds as a float.
STARTS = (0.001, 1.7e9)


@pytest.mark.slow
@pytest.mark.parametrize('start', STARTS)
def test_a_clock_with_a_thread_of_its_own_as_in_rclcpp_has_the_same_bits(
    start: float, spin
) -> None:
    more = {'start_time': start}
    assert bits(spin([], ['cpp'], **more)) == bits(spin(['filter'], [], **more))


@pytest.mark.slow
def test_a_chain_of_nodes_has_the_same_bits_wherever_each_of_them_runs(spin) -> None:
    expected = spin(['front', 'back'], [])
    places = [([], ['front', 'back']), (['front'], ['back']), (['back'], ['front'])]
    for here, there in places:
        assert bits(spin(here, there)) == bits(expected)


@pytest.mark.parametrize(
    'rates',
    [{'publish_rate': 500.0, 'clock_rate': 1000.0}, {'publish_rate': 1000.0, 'clock_rate': 500.0}],
    ids=['faster clock', 'faster states'],
)
def test_states_and_ticks_may_have_periods_of_their_own(rates: dict[str, float], domain) -> None:
    found = []
    for _ in range(2):
        node = node_of('timer')
        with LockstepArm(**UR5, **rates) as arm:
            found.append(arm.spin(SECONDS, node))
        node.destroy_node()
        assert arm.time == pytest.approx(SECONDS + 0.001, abs=0.002)
    assert bits(found[0]) == bits(found[1])
    assert found[0].notes == []
    # That of the timer, whatever the periods of states and ticks.
    assert found[0].period == found[0].computation_time().period == 0.002


def test_a_timer_has_the_bits_of_a_callback_with_its_period(domain) -> None:
    # The first tick is one period after time 0, from which timers count.
    settings = {**UR5, 'publish_rate': 500.0, 'clock_rate': 500.0, 'start_time': 0.002}
    node = node_of('timer')
    with LockstepArm(**settings) as arm:
        found = arm.spin(SECONDS, node)
    node.destroy_node()
    with LockstepArm(**settings) as arm:
        expected = arm.run(lambda t, q, qd: pd(q, qd), SECONDS)
    assert bits(found) == bits(expected)
    assert found.period == expected.period == 0.002


def test_a_second_run_continues_where_the_first_one_ended(spin) -> None:
    whole, node = spin(['filter'], []), node_of('filter')
    with LockstepArm(**UR5) as arm:
        parts = [arm.spin(seconds, node) for seconds in (0.1, SECONDS - 0.1)]
    node.destroy_node()
    for name in ('time', 'q', 'qd', 'tau'):
        assert np.concatenate([getattr(part, name) for part in parts]).tobytes() == (
            getattr(whole, name).tobytes()
        )


@pytest.mark.parametrize(
    ('kind', 'note'),
    [
        ('wall', 'not repeatable: the timer of 2 ms of node .pd. runs on wall time (set use_sim'),
        (
            'steady',
            'not repeatable: the timer of 2 ms of node .pd. runs on wall time (give it the',
        ),
        ('uneven', 'uneven: the timer of 3 ms of node .pd. is no multiple of the tick of 2 ms'),
    ],
)
def test_a_timer_of_this_process_that_does_not_follow_the_clock_is_noted(
    kind: str, note: str, spin
) -> None:
    more = {'clock_rate': 500.0} if kind == 'uneven' else {}
    (found,) = spin([kind], [], 0.05, **more).notes
    assert found.replace("'", '.').startswith(note)


@pytest.mark.parametrize(
    ('kinds', 'text'),
    [
        (['wall'], 'a command came after its node had said that it was done'),
        # Whether one also comes between two messages is chance.
        (['threads'], 'commands follow states as well as ticks'),
        (['both'], 'commands follow states as well as ticks'),
        (['states', 'stamps'], 'several nodes commanded at once: their order is chance'),
    ],
    ids=lambda value: ' '.join(value) if isinstance(value, list) else '',
)
@pytest.mark.slow
def test_what_is_not_repeatable_in_other_processes_is_noted(
    kinds: list[str], text: str, spin
) -> None:
    notes = spin([], kinds, 0.1).notes
    assert any(note.startswith(f'not repeatable: {text}') for note in notes)


@pytest.mark.slow
def test_a_second_command_to_one_state_after_many_with_one_has_the_same_bits_everywhere(
    spin,
) -> None:
    here, elsewhere = spin(['twice'], []), spin([], ['twice'])
    assert here.q.tobytes() == elsewhere.q.tobytes()
    assert here.notes == elsewhere.notes == []


def test_a_node_that_joins_the_topics_of_the_arm_is_noted(domain) -> None:
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    node, others = node_of('states'), []

    def join(state: JointState) -> None:
        if not others:
            others.append(Node('late'))
            others[0].create_subscription(JointState, 'joint_states', print, 1)

    node.create_subscription(JointState, 'joint_states', join, 1)
    with LockstepArm(**UR5) as arm:
        (note,) = arm.spin(0.5, node).notes
    for each in (node, *others):
        each.destroy_node()
    assert note.startswith('not repeatable: a node joined or left the topics of the arm, at t = ')


@pytest.mark.parametrize('start', STARTS)
def test_a_period_of_the_controller_is_a_check_of_its_commands(start: float, domain) -> None:
    node = node_of('filter')
    with LockstepArm(**UR5, start_time=start) as arm:
        assert len(arm.spin(0.05, node, controller_period=0.005).time) == 50
        text = r'no command since t = \S+ s, at .*; one is expected every 0\.004 s'
        with pytest.raises(NoAnswerError, match=text):
            arm.spin(0.05, node, controller_period=0.004)
    node.destroy_node()
