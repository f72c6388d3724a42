# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings that change while the arm runs: the engine alone, without ROS."""

from __future__ import annotations

import json
from pathlib import Path

from plant_messages import change, efforts, made, validated
import pytest
from rewriting import STATES
from simulating import rows_of, simulate

from pfd_ros.arm.changes import LONGEST_CHANGES
from pfd_ros.arm.events import Source, Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import encode_string
from pfd_ros.replay.verify import read


def test_a_dynamic_setting_changes_and_all_others_stay() -> None:
    engine = made(substeps=3)
    before = engine.settings
    assert validated(engine, change(real_time_factor=0.5)).verdict is Verdict.ACCEPTED
    assert engine.settings.real_time_factor == 0.5
    assert engine.settings == Settings(**{**vars(before), 'real_time_factor': 0.5})


@pytest.mark.parametrize(
    ('text', 'verdict', 'reason'),
    [
        ('{"real_time_factor": 1001.0}', Verdict.REFUSED, 'real_time_factor is 1001.0, expected'),
        ('{"real_time_factor": NaN}', Verdict.REFUSED, 'real_time_factor holds nan'),
        ('{"real_time_factor": -Infinity}', Verdict.REFUSED, 'real_time_factor holds -inf'),
        ('{"real_time_factor": 1e-9}', Verdict.REFUSED, 'expected 0 or 1e-06 and more'),
        ('{"real_time_factor": true}', Verdict.MALFORMED, 'real_time_factor is True'),
        ('{"real_time_factor": "1"}', Verdict.MALFORMED, "real_time_factor is '1', expected"),
        ('{"real_time_factor": [1.0]}', Verdict.MALFORMED, 'real_time_factor is list'),
        ('{"step_size": 0.002}', Verdict.MALFORMED, "['step_size'] cannot change while the arm"),
        ('{"real_time_factor": 1.0, "robot": "ur5"}', Verdict.MALFORMED, "['robot'] cannot"),
        ('{"%s{0}\\n": 1}', Verdict.MALFORMED, 'cannot change'),
        ('{}', Verdict.MALFORMED, 'expected a table'),
        ('[1]', Verdict.MALFORMED, 'expected a table'),
        ('', Verdict.MALFORMED, 'Expecting value'),
        ('[' * LONGEST_CHANGES, Verdict.MALFORMED, 'nested too deeply'),
        (' ' * (LONGEST_CHANGES + 1), Verdict.MALFORMED, f'expected {LONGEST_CHANGES} at most'),
        (json.dumps({'x' * 9000: 1}), Verdict.MALFORMED, '(9000 characters)'),
        ('{"real_time_factor": 1' + '0' * 400 + '}', Verdict.MALFORMED, 'too large for a float'),
        ('{"real_time_factor": 1' + '0' * 5000 + '}', Verdict.MALFORMED, 'integer string'),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_wrong_change_is_refused_whole_with_its_reason(
    text: str, verdict: Verdict, reason: str
) -> None:
    engine = made()
    before = engine.settings
    found = validated(engine, (Source.PARAMETERS, encode_string(text)))
    assert found.verdict is verdict
    assert reason in found.detail
    assert len(found.detail) < 600
    assert found.detail.isprintable()
    assert engine.settings is before


def test_a_recording_with_changes_verifies(tmp_path: Path) -> None:
    events = {
        2: [efforts(1.0, 2.0), change(real_time_factor=3.0)],
        4: [change(real_time_factor=-1.0), change(step_size=0.1)],
    }
    path = simulate(20, events).save(tmp_path / 'a.mcap')
    summary = read(path, verify=True)
    assert summary.complete
    verdicts = [row.verdict for row in rows_of(path) if row.source is Source.PARAMETERS]
    assert verdicts == [Verdict.ACCEPTED, Verdict.REFUSED, Verdict.MALFORMED]
    assert summary.settings.real_time_factor == 1.0


def test_the_bound_on_the_rate_of_cycles_follows_the_real_time_factor(tmp_path: Path) -> None:
    # 5000 steps in 3 s of wall time: at factor 1 there are 1000 in 1 s.
    def shortened(events: dict) -> Path:
        made = simulate(5000, events, publish_rate=100.0, publish_clock=False)
        start = made.messages[0].log_ns
        for message in made.messages:
            message.log_ns = start + (message.log_ns - start) * 3 // 5
        made.recount()
        return made.save(tmp_path / f'{len(events)}.mcap')

    with pytest.raises(ValueError, match='when at most'):
        read(shortened({}))
    assert read(shortened({1: [change(real_time_factor=2.0)]})).steps == 5000
    # What the arm refuses does not move the bound.
    refused = {1: [change(real_time_factor=1e9)], 2: [change(real_time_factor=0.5)]}
    with pytest.raises(ValueError, match='when at most'):
        read(shortened(refused))


def test_a_recording_in_which_the_sensors_change_verifies(tmp_path: Path) -> None:
    events = {
        2: [efforts(1.0, 2.0)],
        5: [change(noise_position=0.01, bias_effort=[0.0, 3.0])],
        9: [change(noise_position=0.0, quantization_velocity=0.5)],
        15: [change(quantization_velocity=0.0, bias_effort=[])],
    }
    made = simulate(20, events)
    exact = simulate(20, {2: events[2]})
    assert read(made.save(tmp_path / 'a.mcap'), verify=True).complete
    differing = [
        k
        for k, (one, other) in enumerate(
            zip(made.on(STATES), exact.on(STATES), strict=True), start=1
        )
        if one.data != other.data
    ]
    assert differing == list(range(5, 15))


@pytest.mark.parametrize('values', [{'bias_effort': [1.0]}, {'bias_effort': [0.0, float('nan')]}])
def test_numbers_for_each_joint_are_one_for_each_or_none(values: dict) -> None:
    engine = made()
    assert validated(engine, change(**values)).verdict is Verdict.REFUSED
    assert engine.sensors is None
