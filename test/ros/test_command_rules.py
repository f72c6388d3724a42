# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for commands: the verdict on each case and its effect on the drive."""

from __future__ import annotations

from bridge import (
    ActuatorCommand,
    CommandCounts,
    CommandGains,
    JointCommands,
    JointMessage,
    Validation,
    Verdict,
    all_braked,
    merge_commands,
    validate_array,
    validate_named,
)
import numpy as np
import pytest

INDEX = {'a': 0, 'b': 1, 'c': 2}
START_NS = 5_000_000_000
NAN, INF = float('nan'), float('inf')


def message(names, effort=(), position=(), velocity=(), stamp_ns: int = 0) -> JointMessage:
    arrays = [np.array(values, float) for values in (position, velocity, effort)]
    return JointMessage(stamp_ns, '', tuple(names), *arrays)


def validate(*args, **other) -> Validation:
    return validate_named(message(*args, **other), INDEX, START_NS)


def merged(actuation: ActuatorCommand, validation: Validation) -> ActuatorCommand:
    assert isinstance(validation.effect, JointCommands)
    return merge_commands(actuation, validation.effect)


@pytest.mark.parametrize(
    ('command', 'verdict'),
    [
        (message('ab', [1, 2]), Verdict.ACCEPTED),
        (message('abx', [1, 2, 3]), Verdict.ACCEPTED),
        (message('ab', [1, NAN]), Verdict.ACCEPTED),
        (message('ab', [1, 2], position=[0, 0]), Verdict.ACCEPTED),
        (message('ab', [1, 2], stamp_ns=START_NS), Verdict.ACCEPTED),
        (message('', []), Verdict.NO_NAMES),
        (message('', [1, 2, 3]), Verdict.NO_NAMES),
        (message('ab', [1]), Verdict.RAGGED),
        (message('ab', [1, 2], velocity=[0]), Verdict.RAGGED),
        (message('ab', [1, 2], position=[0, 0, 0]), Verdict.RAGGED),
        (message('ab', [1, INF]), Verdict.INFINITE),
        (message('ab', [-INF, NAN]), Verdict.INFINITE),
        (message('ab', [1, 2], velocity=[INF, 0]), Verdict.INFINITE),
        (message('xb', [INF, 1]), Verdict.INFINITE),
        (message('ab', [1, 2], stamp_ns=START_NS - 1), Verdict.STALE),
        (message('ab', [1, 2], stamp_ns=-1), Verdict.STALE),
        (message('aa', [1, 2]), Verdict.DUPLICATE_NAMES),
        (message('ab', position=[1, 2]), Verdict.NO_EFFORT),
        (message('ab', velocity=[1, 2]), Verdict.NO_EFFORT),
        (message('ab'), Verdict.NO_EFFORT),
        (message('xy', [1, 2]), Verdict.UNKNOWN_NAMES),
        (message('ab', [NAN, NAN]), Verdict.ALL_NAN),
        (message('ax', [NAN, 1]), Verdict.ALL_NAN),
    ],
)
def test_each_case_has_its_validation_result_and_only_accepted_commands_act(
    command: JointMessage, verdict: Verdict
) -> None:
    got = validate_named(command, INDEX, START_NS)
    assert got.verdict is verdict
    assert (got.effect is None) == (verdict is not Verdict.ACCEPTED)
    assert bool(got.detail) == (verdict is not Verdict.ACCEPTED)


def test_a_braked_arm_has_no_command() -> None:
    actuation = all_braked(3)
    assert actuation.effort.tolist() == [0, 0, 0]
    assert actuation.braked.tolist() == [True, True, True]


def test_a_command_changes_the_joints_it_names_and_keeps_the_others() -> None:
    actuation = merged(all_braked(3), validate('ca', [3.0, 1.0]))
    assert actuation.effort.tolist() == [1, 0, 3]
    assert actuation.braked.tolist() == [False, True, False]
    actuation = merged(actuation, validate('bc', [2.0, 4.0]))
    assert actuation.effort.tolist() == [1, 2, 4]
    assert not actuation.braked.any()


def test_nan_keeps_the_last_effort_and_a_braked_joint_braked() -> None:
    actuation = merged(all_braked(3), validate('a', [1.0]))
    actuation = merged(actuation, validate('abc', [NAN, NAN, 3.0]))
    assert actuation.effort.tolist() == [1, 0, 3]
    assert actuation.braked.tolist() == [False, True, False]


def test_merging_a_command_does_not_change_the_previous_one() -> None:
    before = all_braked(3)
    merged(before, validate('a', [1.0]))
    assert before.braked.all()
    assert not before.effort.any()


GAINS = CommandGains(np.array([100.0, 100.0, 0.0]), np.array([10.0, 0.0, 1.0]))


def steered(actuation: ActuatorCommand, *args, **other) -> ActuatorCommand:
    return merged(actuation, validate_named(message(*args, **other), INDEX, START_NS, GAINS))


@pytest.mark.parametrize(
    ('command', 'verdict'),
    [
        (message('ab', position=[1, 2]), Verdict.ACCEPTED),
        (message('ac', velocity=[1, 2]), Verdict.ACCEPTED),
        (message('ab', position=[1, NAN]), Verdict.ACCEPTED),
        (message('abc', [1, 2, 3], [1, 2, 3], [1, 2, 3]), Verdict.ACCEPTED),
        # A joint without a gain for its target has its effort, or breaks the rule.
        (message('bc', [NAN, 3], position=[1, 2]), Verdict.ACCEPTED),
        (message('bc', [3, NAN], position=[1, 2]), Verdict.NO_EFFORT),
        (message('ac', position=[1, 2]), Verdict.NO_EFFORT),
        (message('ab', velocity=[1, 2]), Verdict.NO_EFFORT),
        (message('ab'), Verdict.NO_EFFORT),
        (message('ac', position=[1, NAN]), Verdict.ACCEPTED),
        (message('ab', position=[NAN, NAN]), Verdict.ALL_NAN),
        (message('ab', [NAN, NAN], [NAN, NAN], [NAN, NAN]), Verdict.ALL_NAN),
        (message('ab', position=[1]), Verdict.RAGGED),
        (message('ab', [1, 2], position=[1]), Verdict.RAGGED),
        (message('ab', position=[1, INF]), Verdict.INFINITE),
        (message('ab', [1, 2], velocity=[-INF, 0]), Verdict.INFINITE),
        (message('ab', position=[1, -1e7]), Verdict.REFUSED),
        (message('ab', [1, 2], velocity=[1e5, 0]), Verdict.REFUSED),
        (message('xa', position=[1e7, 0]), Verdict.ACCEPTED),
        (message('xy', position=[0, 0]), Verdict.UNKNOWN_NAMES),
        (message('ab', position=[0, 0], stamp_ns=START_NS - 1), Verdict.STALE),
    ],
)
def test_a_servo_adds_positions_and_velocities_to_the_rules(
    command: JointMessage, verdict: Verdict
) -> None:
    got = validate_named(command, INDEX, START_NS, GAINS)
    assert got.verdict is verdict
    assert (got.effect is None) == (verdict is not Verdict.ACCEPTED)


def told(actuation: ActuatorCommand) -> list[list[float]]:
    assert actuation.position is not None
    assert actuation.velocity is not None
    return [x.tolist() for x in (actuation.effort, actuation.position, actuation.velocity)]


def test_each_kind_of_a_command_is_kept_for_each_joint() -> None:
    actuation = steered(all_braked(3), 'ab', [1.0, NAN], position=[0.1, 0.2])
    assert actuation.braked.tolist() == [False, False, True]
    np.testing.assert_equal(told(actuation), [[1, 0, 0], [0.1, 0.2, NAN], [NAN] * 3])
    actuation = steered(actuation, 'ac', [NAN, 3.0], position=[0.3, 0.4], velocity=[0.5, 0.6])
    assert not actuation.braked.any()
    # c has no position gain: its velocity is followed, its position is none.
    np.testing.assert_equal(told(actuation), [[1, 0, 3], [0.3, 0.2, NAN], [0.5, NAN, 0.6]])
    actuation = steered(actuation, 'a', [7.0], position=[NAN], velocity=[NAN])
    np.testing.assert_equal(told(actuation), [[7, 0, 3], [0.3, 0.2, NAN], [0.5, NAN, 0.6]])


def test_a_kind_without_numbers_is_no_command_of_it() -> None:
    actuation = steered(all_braked(3), 'ab', [1.0, 2.0], position=[0.1, 0.2], velocity=[3.0, 4.0])
    np.testing.assert_equal(told(actuation), [[1, 2, 0], [0.1, 0.2, NAN], [3, NAN, NAN]])
    # A position alone has no feed-forward, and stays there.
    actuation = steered(actuation, 'b', position=[0.3])
    np.testing.assert_equal(told(actuation), [[1, 0, 0], [0.1, 0.3, NAN], [3, NAN, NAN]])
    # An effort alone ends the servo, by name and without.
    actuation = steered(actuation, 'a', [5.0])
    np.testing.assert_equal(told(actuation), [[5, 0, 0], [NAN, 0.3, NAN], [NAN] * 3])
    actuation = merged(actuation, validate_array(np.array([1.0, 2.0, 3.0]), np.arange(3)))
    assert (actuation.effort.tolist(), actuation.position, actuation.velocity) == (
        [1, 2, 3],
        None,
        None,
    )


def test_a_position_for_a_joint_without_a_servo_is_refused_by_name() -> None:
    got = validate_named(message('abc', position=[1, 2, 3]), INDEX, START_NS, GAINS)
    assert got.detail == "no effort for ['c'], and no servo gain for their targets"


def test_unknown_names_are_reported_and_known_ones_act() -> None:
    command = validate('xay', [1.0, 2.0, 3.0])
    assert command.unknown == ('x', 'y')
    assert merged(all_braked(3), command).effort.tolist() == [2.0, 0.0, 0.0]
    assert merged(all_braked(3), command).braked.tolist() == [False, True, True]


def test_the_size_of_a_validation_result_does_not_depend_on_the_message() -> None:
    names = [f'{k}{"x" * 1000}' for k in range(3000)]
    for command in (validate(names, [1.0] * 3000), validate(['a', *names], [1.0] * 3001)):
        assert command.unknown_count == 3000
        assert len(command.unknown) <= 8
        assert len(repr(command)) < 2000
    assert validate(['x' * 1_000_000], [1.0]).detail.endswith(
        "x... (1000000 characters)'] is a joint of the arm"
    )


def test_the_counts_stay_small_however_many_names_come() -> None:
    counts = CommandCounts()
    for k in range(1000):
        counts.add(0, validate([f'{{{k}}}', 'y'], [1.0, 1.0]))
        counts.add(1, validate('a', [1.0]), 3)
    assert counts.verdicts() == {
        (0, Verdict.UNKNOWN_NAMES): (1000, "none of ['{999}', 'y'] is a joint of the arm"),
        (1, Verdict.ACCEPTED): (3000, ''),
    }
    count, names = counts.unknown()
    assert (count, names[:3], len(names)) == (2000, ['{0}', 'y', '{1}'], 8)


def test_the_details_name_the_received_values() -> None:
    assert validate('ab', [1]).detail == '2 names and 1 numbers in effort'
    assert validate('ab', position=[1, 2], velocity=[1, 2]).detail == (
        'expected one effort for each name, got only position and velocity'
    )
    assert validate('ab').detail == 'expected one effort for each name'


def test_an_array_goes_to_the_joints_in_their_published_order() -> None:
    command = validate_array(np.array([10.0, 20.0, 30.0]), np.array([2, 0, 1]))
    assert merged(all_braked(3), command).effort.tolist() == [20, 30, 10]


@pytest.mark.parametrize(
    ('values', 'verdict'),
    [
        ([1.0, 2.0], Verdict.WRONG_SIZE),
        ([], Verdict.WRONG_SIZE),
        ([1.0, 2.0, 3.0, 4.0], Verdict.WRONG_SIZE),
        ([1.0, NAN, 3.0], Verdict.NOT_FINITE),
        ([1.0, 2.0, -INF], Verdict.NOT_FINITE),
    ],
)
def test_an_array_that_breaks_a_rule_is_dropped_whole(
    values: list[float], verdict: Verdict
) -> None:
    command = validate_array(np.array(values), np.arange(3))
    assert command.verdict is verdict
    assert command.effect is None


def test_recorded_validation_results_keep_their_numbers() -> None:
    # Written into files: a new verdict goes to the end.
    assert [verdict.name for verdict in Verdict] == [
        'ACCEPTED',
        'MALFORMED',
        'NO_NAMES',
        'RAGGED',
        'INFINITE',
        'STALE',
        'DUPLICATE_NAMES',
        'NO_EFFORT',
        'UNKNOWN_NAMES',
        'ALL_NAN',
        'WRONG_SIZE',
        'NOT_FINITE',
        'OVERFLOWED',
        'REFUSED',
    ]
