# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings: checked once, the same in code, file and recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import dataclasses
import json
from pathlib import Path
import re
from typing import Any

from bridge import (
    Settings,
    Source,
    Verdict,
    effect_fields,
    encode_string,
    joint_settings,
    parameter_name,
    read_recording,
    settings_from_values,
    settings_to_json,
)
import numpy as np
from plant_messages import change, efforts, made, validated
import pytest
from rewriting import STATES
from simulating import rows_of, simulate
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'sim_arm.yaml'


def flat(tree: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield each parameter of a file by its full name."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


def test_the_shipped_file_holds_every_setting_at_its_default() -> None:
    text = CONFIG.read_text(encoding='utf-8')
    given = dict(flat(yaml.safe_load(text)['/**']['ros__parameters']))
    # Groups with a number for each joint have the names of its joints.
    names = {
        parameter_name(field): field.name
        for field in dataclasses.fields(Settings)
        if not field.metadata['per_joint']
    }
    assert set(given) == set(names)
    values = {names[name]: value for name, value in given.items()}
    assert settings_from_values(values) == Settings()


def test_the_shipped_file_names_every_number_of_a_joint_with_the_units_of_the_table() -> None:
    lines = re.findall(
        r'^    #   ([\w.]+)\.joint1: \S+ +(.*)$', CONFIG.read_text('utf-8'), re.MULTILINE
    )
    named = {name: comment.partition(', ')[0] for name, comment in lines}
    wanted = {}
    for field in effect_fields():
        for k, parameter in enumerate(joint_settings(field).values()):
            wanted[parameter] = field.units(k)
    assert named == wanted


def test_settings_come_back_from_json_with_the_same_bits() -> None:
    awkward = Settings(
        robot='/tmp/a b.urdf',
        joints=('ä', 'b'),
        gravity=(0.1, -0.0, 5e-324),
        initial_positions=(1 / 3, -2e300),
        locked=('ä', '{0}'),
        locked_positions=(0.1 + 0.2, -0.0),
        step_size=0.0003,
        start_time=1.1,
    )
    again = settings_from_values(json.loads(settings_to_json(awkward)))
    assert again == awkward
    assert str(again.gravity[1]) == '-0.0'


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'step_size': 0.0}, 'step_size is 0.0, expected 1e-05 to 0.1'),
        ({'step_size': float('nan')}, 'step_size holds nan, expected finite'),
        ({'step_size': 1 / 30000}, 'whole number of nanoseconds'),
        ({'substeps': 0}, 'substeps is 0, expected 1 to 100'),
        ({'gravity': (9.81,)}, 'gravity needs 3 numbers'),
        ({'gravity': (0.0, 0.0, float('inf'))}, 'gravity holds inf'),
        ({'initial_positions': (float('nan'),)}, 'initial_positions holds nan'),
        ({'start_time': -2.0}, 'start_time is -2.0'),
        ({'real_time_factor': -1.0}, 'real_time_factor is -1.0'),
        ({'publish_rate': 300.0}, 'publish_rate is 300.0 Hz, which is one in 3.33333 steps'),
        ({'clock_rate': 2000.0}, 'clock_rate is 2000.0 Hz'),
        ({'robot': ''}, 'robot is empty'),
        ({'position_sums': 'exact'}, "position_sums is 'exact', expected one of .*'plain'"),
        ({'colour': 'red'}, r"unknown settings \['colour'\]"),
        ({'real_time_factor': 5e-324}, 'real_time_factor is 5e-324, expected 0 or'),
        ({'publish_rate': 5e-324}, 'publish_rate is 5e-324, expected 1e-09 Hz'),
        ({'publish_rate': 1e-300}, 'publish_rate is 1e-300, expected 1e-09 Hz'),
        ({'step_size': 10**400}, 'step_size is a number too large for a float'),
        ({'step_size': '0.001'}, 'step_size is .*0.001.*, expected a number'),
        ({'step_size': True}, 'step_size is True, expected a number'),
        ({'step_size': None}, 'step_size is NoneType, expected a number'),
        ({'substeps': 2.0}, 'substeps is 2.0, expected a whole number'),
        ({'damping': 1}, 'damping is 1, expected true or false'),
        ({'robot': ['a']}, 'robot is list, expected text'),
        ({'frame_id': 'a\0b'}, 'frame_id is .* no NUL'),
        ({'frame_id': '{' * (1 << 21)}, r'\(2097152 characters\)'),
        ({'joints': 'joint1'}, 'joints is .*joint1.*, expected a list'),
        ({'joints': [1]}, 'joints is 1, expected text'),
        ({'joints': ['a'] * 100_000}, 'joints holds 100000 values, expected 1000 at most'),
        ({'gravity': [[0.0]] * 3}, 'gravity is list, expected a number'),
        ({'locked': {'a': 1.0}}, 'locked is dict, expected a list'),
        ({'locked': ['a', 'a']}, 'locked names a joint twice'),
        ({'locked': ['a'], 'locked_positions': [float('nan')]}, 'locked_positions holds nan'),
        ({'locked': ['a'], 'locked_positions': [0.0, 1.0]}, r"holds 2 numbers, expected 1, .*'a'"),
        ({'locked_positions': [0.0]}, 'locked_positions holds 1 numbers, expected 0'),
    ],
)
def test_a_wrong_setting_is_refused_and_named(wrong: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text) as refused:
        settings_from_values(wrong)
    assert len(str(refused.value)) < 300


def test_locked_joints_are_at_zero_unless_positions_are_given() -> None:
    assert Settings(locked=('a', 'b')).locks == {'a': 0.0, 'b': 0.0}
    assert Settings(locked=('a',), locked_positions=(0.5,)).locks == {'a': 0.5}
    assert Settings().locks == {}


def test_settings_from_before_a_setting_existed_have_its_default() -> None:
    old = json.loads(settings_to_json(Settings(robot='planar2', substeps=3)))
    del old['locked'], old['locked_positions']
    assert settings_from_values(old) == Settings(robot='planar2', substeps=3)


@pytest.mark.parametrize('values', [1, None, 'a', []])
def test_values_that_are_no_mapping_are_refused(values: object) -> None:
    with pytest.raises(ValueError, match='expected a JSON object'):
        settings_from_values(values)


@pytest.mark.parametrize(
    ('step_size', 'rate', 'every'),
    [(0.001, 0.0, 1), (0.001, 1000.0, 1), (0.001, 100.0, 10), (0.0003, 1 / 0.0009, 3)],
)
def test_a_rate_is_a_whole_number_of_steps(step_size: float, rate: float, every: int) -> None:
    chosen = Settings(step_size=step_size, publish_rate=rate, clock_rate=rate)
    assert (chosen.publish_every, chosen.clock_every) == (every, every)


def test_times_are_whole_nanoseconds() -> None:
    chosen = Settings(step_size=0.0001, start_time=0.3)
    assert (chosen.step_ns, chosen.start_ns) == (100_000, 300_000_000)


# ---- changes while the arm runs ----


def test_a_dynamic_setting_changes_and_all_others_stay() -> None:
    engine = made(substeps=3)
    before = engine.settings
    assert validated(engine, change(real_time_factor=0.5)).verdict is Verdict.ACCEPTED
    assert engine.settings == Settings(**{**vars(before), 'real_time_factor': 0.5})


@pytest.mark.parametrize(
    ('text', 'verdict', 'reason'),
    [
        ('{"real_time_factor": 1001.0}', Verdict.REFUSED, 'real_time_factor is 1001.0, expected'),
        ('{"real_time_factor": NaN}', Verdict.REFUSED, 'real_time_factor holds nan'),
        ('{"real_time_factor": true}', Verdict.MALFORMED, 'real_time_factor is True'),
        ('{"step_size": 0.002}', Verdict.MALFORMED, "['step_size'] cannot change while the arm"),
        ('{"real_time_factor": 1.0, "robot": "ur5"}', Verdict.MALFORMED, "['robot'] cannot"),
        ('{"bias_effort": [1.0]}', Verdict.REFUSED, 'bias.effort holds 1 numbers'),
        ('[1]', Verdict.MALFORMED, 'expected a table'),
        ('', Verdict.MALFORMED, 'Expecting value'),
        ('[' * 2000, Verdict.MALFORMED, 'nested too deeply'),
        (json.dumps({'x' * 9000: 1}), Verdict.MALFORMED, '(9000 characters)'),
        ('{"real_time_factor": 1' + '0' * 400 + '}', Verdict.MALFORMED, 'too large for a float'),
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


def test_a_recording_with_changes_of_settings_and_sensors_verifies(tmp_path: Path) -> None:
    events = {
        2: [efforts(1.0, 2.0), change(real_time_factor=3.0)],
        4: [change(real_time_factor=-1.0), change(step_size=0.1)],
        5: [change(noise_position=0.01, bias_effort=[0.0, 3.0])],
        9: [change(noise_position=0.0, bias_effort=[])],
    }
    run, exact = simulate(20, events), simulate(20, {2: events[2]})
    path = run.save(tmp_path / 'a.mcap')
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert summary.settings.real_time_factor == 1.0
    verdicts = [row.verdict for row in rows_of(path) if row.source is Source.PARAMETERS]
    taken = Verdict.ACCEPTED
    assert verdicts == [taken, Verdict.REFUSED, Verdict.MALFORMED, taken, taken]
    pairs = zip(run.on(STATES), exact.on(STATES), strict=True)
    noisy = [k for k, (one, other) in enumerate(pairs, start=1) if one.data != other.data]
    assert noisy == list(range(5, 9))


# ---- what `auto` selects ----

# h lambda is 1.1 for the model's damping, without rotors: 'auto' is imex2, and rk4 is stable.
STIFF: dict[str, Any] = {'robot': 'puma560', 'damping': True, 'step_size': 0.0004}


@pytest.mark.parametrize(
    ('settings', 'integrator', 'sums'),
    [
        ({'robot': 'planar2'}, 'rk4', 'compensated'),
        ({'robot': 'puma560'}, 'rk4', 'plain'),
        (STIFF, 'imex2', 'plain'),
        (STIFF | {'integrator': 'velocity_verlet'}, 'velocity_verlet', 'plain'),
        ({'robot': 'planar2', 'position_sums': 'plain'}, 'rk4', 'plain'),
    ],
)
def test_a_recording_stores_the_choices_of_auto(
    settings: dict[str, Any], integrator: str, sums: str, tmp_path: Path
) -> None:
    joints = 6 if settings['robot'] == 'puma560' else 2
    run = simulate(60, {3: [efforts(*np.linspace(3.0, -1.0, joints))]}, **settings)
    summary = read_recording(run.save(tmp_path / 'a.mcap'), verify=True)
    assert summary.complete
    stored = summary.settings
    assert (stored.integrator, stored.position_sums) == (integrator, sums)
    assert stored.method != 'auto'
