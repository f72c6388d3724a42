# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd info` counts what independent readers count, and knows the run of our recordings."""

from __future__ import annotations

import json
from pathlib import Path
import random

from bags import write_bag
from bridge import pfd_main
from mcap.reader import make_reader
import pytest
from rewriting import GOLDEN, STATES, load
from simulating import simulate

rosbag2 = pytest.importorskip('rosbags.rosbag2')


def test_topics_times_and_counts_equal_the_summary_of_the_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert pfd_main(['info', str(GOLDEN), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    with GOLDEN.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counted = summary.statistics.channel_message_counts
    channels = {
        channel.topic: counted.get(number, 0) for number, channel in summary.channels.items()
    }
    assert {name: topic['messages'] for name, topic in found['topics'].items()} == channels
    assert found['messages'] == summary.statistics.message_count
    assert found['begin_ns'] == summary.statistics.message_start_time
    assert found['end_ns'] == summary.statistics.message_end_time
    assert found['bytes'] == GOLDEN.stat().st_size
    run = found['run']
    assert (run['robot'], run['accepted'], run['can_be_replayed']) == ('puma560', 25, True)
    assert sum(run['rejected'].values()) == 12
    assert run['settings']['step_size'] == 0.001


def test_lines_name_each_topic_and_the_settings(capsys: pytest.CaptureFixture[str]) -> None:
    assert pfd_main(['info', str(GOLDEN)]) == 0
    lines = capsys.readouterr().out.splitlines()
    count = f' {len(load(GOLDEN).on(STATES))} '
    assert any(line.startswith(f'topic      {STATES}') and count in line for line in lines)
    assert 'replay     can be verified with `pfd replay LOG --verify`' in lines
    assert any('robot=puma560' in line for line in lines)


def test_a_recording_that_was_cut_off_is_reported_as_incomplete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'cut.mcap'
    path.write_bytes(GOLDEN.read_bytes()[:40_000])
    assert pfd_main(['info', str(path)]) == 0
    text = capsys.readouterr().out
    assert 'MB, cut off' in text
    assert 'the file was not closed' in text


def test_a_recording_without_states_cannot_be_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = simulate(0).save(tmp_path / 'a.mcap')
    assert pfd_main(['info', str(path)]) == 0
    out = capsys.readouterr().out
    assert 'replay     not possible: the recording has no states' in out
    assert 'begin' not in out
    assert pfd_main(['info', str(path), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['run']['can_be_replayed'] is False
    assert (found['messages'], found['begin_ns'], found['end_ns']) == (0, None, None)


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_bags_of_others_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], storage: str
) -> None:
    kinds = ['std_msgs/msg/String', 'sensor_msgs/msg/Imu']
    write_bag(tmp_path / 'bag', kinds, random.Random(3), rosbag2.StoragePlugin[storage])
    assert pfd_main(['info', str(tmp_path / 'bag'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    counted = {topic['type']: topic['messages'] for topic in found['topics'].values()}
    assert counted == dict.fromkeys(kinds, 6)
    assert 'run' not in found
    with rosbag2.Reader(tmp_path / 'bag') as reader:
        assert found['begin_ns'] == reader.start_time
        assert found['messages'] == reader.message_count


def test_a_file_that_is_no_log_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'a.mcap'
    path.write_text('nothing')
    assert pfd_main(['info', str(path)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
