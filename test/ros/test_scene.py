# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An arm in a scene from a file: the file's text goes into settings, recording and replay."""

from __future__ import annotations

from pathlib import Path

from bridge import (
    ActuatorCommand,
    Arm,
    Settings,
    effect_fields,
    joint_settings,
    load_arm_robot,
    read_recording,
    scene_of,
    with_scene_text,
)
from effect_cases import example
import numpy as np
from plant_messages import efforts
import pytest
from ros_processes import Processes
from simulating import simulate

import pfd_core as pfd

SCENE = pfd.Scene(
    damping=(0.5, 0.2),
    armature=(0.1, 0.1),
    effort_limits=(3.0, 1.0),
    gravity_compensation=True,
    payload=pfd.Payload(0.5, (0.1, 0.0, 0.0)),
    friction=(0.3, 0.1),
    static_friction=(0.4, 0.1),
    joint_limits=((-0.02, 2.0), (-2.0, 2.0)),
    restitution=(0.5, 0.5),
    motor_lag=(0.002, 0.0),
)
TEXT = pfd.scene_to_yaml(SCENE)
MOVE = {3: [efforts(1.0, 2.0)], 9: [efforts(-9.0, 0.5)]}


def test_settings_keep_the_content_of_a_scene_file(tmp_path: Path) -> None:
    path = tmp_path / 'scene.yaml'
    path.write_text('# by hand\n' + TEXT)
    settings = with_scene_text(Settings(robot='planar2', scene=str(path)))
    assert settings.scene == TEXT
    path.unlink()
    assert with_scene_text(settings) == settings
    found = scene_of(settings, (0, 1))
    assert found.digest == pfd.Scene(**{**vars(SCENE), 'brakes': True}).digest
    assert with_scene_text(Settings()) == Settings()


def test_an_arm_in_a_scene_verifies_and_moves_as_the_simulator(tmp_path: Path) -> None:
    path = simulate(30, MOVE, scene=TEXT).save(tmp_path / 'a.mcap')
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert summary.settings is not None
    assert summary.settings.scene == TEXT
    settings = Settings(robot='planar2', scene=TEXT)
    arm = Arm(settings, load_arm_robot(settings))
    scene = pfd.Scene(**{**vars(SCENE), 'brakes': True})
    wanted = pfd.Simulator(pfd.load_robot('planar2'), scene)
    for _ in range(20):
        efforts = np.array([2.0, 5.0])
        arm.advance(efforts, ActuatorCommand(efforts, np.zeros(2, bool)))
        wanted.step([2.0, 5.0])
    np.testing.assert_array_equal(arm.q, wanted.q)
    assert wanted.qd.any()


def test_the_numbers_of_each_joint_make_the_scene_of_the_table() -> None:
    order = (1, 0)
    wanted, settings = {}, {}
    for field in effect_fields():
        names = list(joint_settings(field))
        if names:
            wanted[field.name] = np.array(example(field, 2))
            columns = wanted[field.name].reshape(2, -1).T
            for name, column in zip(names, columns, strict=True):
                settings[name] = tuple(column[list(order)].tolist())
    found = scene_of(Settings(robot='planar2', **settings), order)
    assert found == pfd.Scene(**wanted, brakes=True)
    assert pfd.load_scene(pfd.scene_to_yaml(found)) == found


@pytest.mark.parametrize(
    ('scene', 'message'),
    [
        ('/etc/passwd', "scene is '/etc/passwd', expected the YAML of a scene"),
        ('damping: [1, 2, 3]\n', "damping of the scene has 3 numbers, but 'planar2' has 2 joints"),
        ('damping: 5\n', 'damping must be None'),
    ],
)
def test_an_arm_reads_no_file_and_refuses_a_wrong_scene(scene: str, message: str) -> None:
    settings = Settings(robot='planar2', scene=scene)
    with pytest.raises(ValueError, match=message):
        Arm(settings, load_arm_robot(settings))


@pytest.mark.parametrize('other', [{'damping': True}, {'gravity': (0.0, 0.0, 0.0)}])
def test_a_scene_file_replaces_the_switches(other: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f'scene conflicts with {next(iter(other))}'):
        Settings(scene=TEXT, **other)


@pytest.mark.ros
def test_the_node_reads_the_file_and_records_its_content(processes: Processes, peer_of) -> None:
    path = processes.folder / 'scene.yaml'
    SCENE.save(path)
    missing = processes.arm('-p', 'scene:=none.yaml', ready=False)
    assert missing.end() == 1
    assert "sim_arm: no scene file 'none.yaml'" in missing.text()
    arm = processes.arm(
        *('-p', 'robot:=planar2', '-p', f'scene:={path}', '-p', 'recording:=arm.mcap')
    )
    peer = peer_of(processes)
    peer.connect()
    peer.plain_command([0.5] * 2)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.5] * 2)
    arm.stop()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.settings is not None
    assert summary.settings.scene == TEXT
