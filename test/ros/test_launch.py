# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Launch files start nodes with parameters that they have; they run where `launch` is."""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from pathlib import Path
import runpy
import sys
from types import ModuleType
from typing import Any

import gripper_arm
import pytest

from pfd_ros.arm.settings import Settings

FOLDER = Path(__file__).resolve().parents[2] / 'launch'
FILES = sorted(FOLDER.glob('*.launch.py'))
MODULES = {
    'launch': ['LaunchContext', 'LaunchDescription'],
    'launch.actions': ['DeclareLaunchArgument', 'OpaqueFunction'],
    'launch.substitutions': ['LaunchConfiguration'],
    'launch_ros': [],
    'launch_ros.actions': ['Node'],
    'launch_ros.parameter_descriptions': ['ParameterValue'],
}


class Recorded:
    """An object of a launch file that remembers its arguments."""

    def __init__(self, *args: Any, **named: Any) -> None:
        self.args, self.named = args, named

    def perform(self, values: dict[str, str]) -> str:
        return values[self.args[0]]


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, type[Recorded]]]:
    """Put classes that only remember in the place of those of launch."""
    kinds = {name: type(name, (Recorded,), {}) for names in MODULES.values() for name in names}
    for module, names in MODULES.items():
        stub = ModuleType(module)
        vars(stub).update({name: kinds[name] for name in names})
        monkeypatch.setitem(sys.modules, module, stub)
    return kinds


def nodes(path: Path, kinds: dict[str, type[Recorded]], urdf: Path) -> list[dict[str, Any]]:
    """Return the arguments of the nodes that a launch file starts."""
    (entities,) = runpy.run_path(str(path))['generate_launch_description']().args
    found = []
    for entity in entities:
        if isinstance(entity, kinds['OpaqueFunction']):
            found += entity.named['function']({'urdf': str(urdf)})
        elif isinstance(entity, kinds['Node']):
            found.append(entity)
    return [node.named for node in found]


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_a_launch_file_starts_arms_with_parameters_that_they_have(
    path: Path, recorder, tmp_path
) -> None:
    urdf = tmp_path / 'arm.urdf'
    urdf.write_text(gripper_arm.urdf())
    known = {field.metadata['name'] or field.name for field in dataclasses.fields(Settings)}
    started = nodes(path, recorder, urdf)
    arms = [node for node in started if node['package'] == 'pfd_ros']
    assert len(arms) == (2 if path.name.startswith('two') else 1)
    for arm in arms:
        assert (arm['executable'], arm['name']) == ('sim_node', 'sim_arm')
        (parameters,) = arm['parameters']
        assert set(parameters) <= known
    others = [node for node in started if node not in arms]
    assert all(node['parameters'][0]['use_sim_time'] is True for node in others)


def test_one_of_two_arms_publishes_the_clock_that_the_other_follows(recorder) -> None:
    arms = nodes(FOLDER / 'two_arms.launch.py', recorder, Path())
    keys = ('publish_clock', 'time_source')
    told = {arm['namespace']: [arm['parameters'][0][key] for key in keys] for arm in arms}
    assert told == {'left': [True, 'own'], 'right': [False, 'clock']}


@pytest.mark.ros
@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_a_launch_file_runs(path: Path, tmp_path) -> None:
    launch = pytest.importorskip('launch')
    pytest.importorskip('launch_ros')
    from launch.actions import IncludeLaunchDescription, Shutdown, TimerAction
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    urdf = tmp_path / 'arm.urdf'
    urdf.write_text(gripper_arm.urdf())
    source = PythonLaunchDescriptionSource(str(path))
    service = launch.LaunchService(noninteractive=True)
    service.include_launch_description(
        launch.LaunchDescription(
            [
                IncludeLaunchDescription(source, launch_arguments=[('urdf', str(urdf))]),
                TimerAction(period=5.0, actions=[Shutdown()]),
            ]
        )
    )
    assert service.run() == 0
