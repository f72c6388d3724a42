# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scene is written to a file and read back as the same scene, or the file is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pfd_core as pfd

INF = float('inf')
EVERYTHING = pfd.Scene(
    gravity=(0.1, -0.2, -9.7),
    damping=(0.1, 1 / 3),
    armature='model',
    payload=pfd.Payload(1.7, (0.1, 0.0, 1e-17), np.diag([0.1, 0.2, 0.25])),
    external_wrench=True,
    brakes=True,
    friction=(1e-9, 2.0),
    static_friction=(1.5, 2.5),
    stribeck_velocity=(0.1, 0.2),
    joint_limits=[(-1.0, 2 / 3), (-INF, INF)],
    restitution=(0.5, 1.0),
    stiffness=(10.0, 0.0),
    rest_position=(-0.1, 0.0),
    effort_limits=(150.0, INF),
    torque_speed=[None, [(0.5, 28.0), (3.14, 0.0)]],
    gravity_compensation=pfd.Scene(gravity=(0, 0, -9.81), payload=pfd.Payload(2.0)),
    motor_lag=(0.002, 0.0),
)


@pytest.mark.parametrize(
    'scene',
    [
        EVERYTHING,
        pfd.Scene(),
        pfd.Scene(gravity=None, gravity_compensation=True, damping='model'),
        pfd.Scene(joint_limits='model', restitution=0.3, friction='model', torque_speed='model'),
        pfd.Scene(damping=[np.nextafter(1.0, 2.0), 5e-324, 1e100]),
    ],
    ids=['everything', 'default', 'switches', 'models', 'extreme numbers'],
)
def test_a_scene_comes_back_the_same(scene: pfd.Scene, tmp_path: Path) -> None:
    path = tmp_path / 'scene.yaml'
    scene.save(path)
    again = pfd.load_scene(path)
    assert again == scene
    assert again.digest == scene.digest
    assert pfd.load_scene(pfd.scene_to_yaml(scene)) == scene


def test_a_file_holds_gravity_and_what_is_not_the_default(tmp_path: Path) -> None:
    path = tmp_path / 'scene.yaml'
    pfd.Scene(brakes=True, torque_speed=[None, [(0, 1)]]).save(str(path))
    text = path.read_text(encoding='utf-8')
    assert ' '.join(text.split()) == (
        'gravity: [0.0, 0.0, -9.81] brakes: true torque_speed: - null - - [0.0, 1.0]'
    )


def test_a_file_may_be_written_by_hand() -> None:
    text = """
        damping: &ours [0.1, 0.2]   # N m s/rad
        friction: *ours
        gravity: null
        payload: {mass: 2}
        joint_limits: [[-1, 1], [-inf, .inf]]
        brakes: True
    """
    assert pfd.load_scene(text) == pfd.Scene(
        damping=(0.1, 0.2),
        friction=(0.1, 0.2),
        gravity=None,
        payload=pfd.Payload(2.0),
        joint_limits=[(-1, 1), (-INF, INF)],
        brakes=True,
    )


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('dampnig: [1]', "the scene has an unknown key 'dampnig'; known keys are gravity"),
        ('damping: [1]\ndamping: [2]', "key 'damping' occurs more than once"),
        ('damping: [1, yes]', "damping must be a number, got 'yes'"),
        ('damping: [-1]', r"YAML text': damping must not be negative"),
        ('damping: urdf', "damping must be a number, got 'urdf'"),
        ('brakes: 1', 'brakes must be True or False, got 1.0'),
        ('damping: {joint1: 1}', 'damping must be a number, a list or a word, got a table'),
        ('payload: {center: [0, 0, 0]}', "payload has no 'mass'"),
        ('payload: {mass: 1, density: 2}', "payload has an unknown key 'density'"),
        ('payload: {mass: heavy}', "payload mass must be a number, got 'heavy'"),
        ('payload: 3', "payload must be a Payload, 'input' or None, got 3.0"),
        ('gravity_compensation: {damping: [1]}', 'gravity_compensation may have .* has damping'),
        ('gravity_compensation: {mass: 1}', 'gravity_compensation has an unknown key'),
        ('- damping', 'the scene must be a mapping with gravity'),
        ('gravity: [0, 0, !!float 1]', 'tag .* is not used'),
        ('a: [', 'is not YAML'),
        ('x' * 1_000_001, 'a YAML file may have 1000000'),
        (f'damping: [{"1," * 30_001}]', 'more than 30000 nodes'),
    ],
)
def test_a_wrong_file_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_scene(text + '\n')


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no scene file 'none\.yaml' \(looked in"):
        pfd.load_scene('none.yaml')
    with pytest.raises(ValueError, match=r'cannot read .*no regular file'):
        pfd.load_scene(tmp_path)
    binary = tmp_path / 'scene.yaml'
    binary.write_bytes(b'\xff\xfe\x00')
    with pytest.raises(ValueError, match=r'cannot read .*scene\.yaml.*utf-8'):
        pfd.load_scene(binary)
    with pytest.raises(ValueError, match='source must be a path or a YAML string, got 5'):
        pfd.load_scene(5)
