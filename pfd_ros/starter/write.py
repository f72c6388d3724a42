# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a controller package, from the templates; all of them or none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.resources import files
import keyword
from pathlib import Path
import re
import shutil
from string import Template
import sys
import tempfile
from typing import Any
from xml.sax.saxutils import quoteattr

import yaml

from pfd_ros.arm.settings import Settings
from pfd_ros.starter.arm import NUMBERS, TAKEN, Arm
from pfd_ros.starter.plan import Plan
from pfd_ros.text import cut

# Template -> its file in the package.
FILES = {
    'README.md': 'README.md',
    'package.xml': 'package.xml',
    'setup.py': 'setup.py',
    'setup.cfg': 'setup.cfg',
    '__init__.py': '{0}/__init__.py',
    'law.py': '{0}/law.py',
    'node.py': '{0}/node.py',
    'controllers.yaml': '{0}/controllers.yaml',
    'arm.launch.py': 'launch/arm.launch.py',
    'test_controller.py': 'test/test_controller.py',
    'workflow.yml': '.github/workflows/test.yml',
    'action.yml': '.github/actions/test-controller/action.yml',
    'run.sh': 'run.sh',
}
# Settings in arm.yaml: where they are not the default, and always.
DEFAULT, ALWAYS = Settings(), {'tip_link', 'step_size', 'initial_positions'}
# Names as of REP 144, which Python can import beside what is there.
NAME = re.compile(r'[a-z](?:_?[a-z0-9])+', re.ASCII)
USED = {'pfd_core', 'pfd_ros', 'rclpy', 'sim_arm', *keyword.kwlist, *sys.stdlib_module_names}
# Where the node publishes, as a controller of ros2_control of this name subscribes.
TOPIC = '/effort_controller/commands'
# Of the hardware that talks over topics, see docs/guides/alongside-a-controller.md.
BLOCK = re.compile(r'\s*<ros2_control\b.*?</ros2_control>', re.DOTALL)
HARDWARE = """
  <ros2_control name="arm" type="system">
    <hardware>
      <plugin>joint_state_topic_hardware_interface/JointStateTopicSystem</plugin>
      <param name="joint_commands_topic">/robot_joint_commands</param>
      <param name="joint_states_topic">/robot_joint_states</param>
      <param name="trigger_joint_command_threshold">-1</param>
    </hardware>
{}  </ros2_control>
</robot>
"""
JOINT = """    <joint name={}>
      <command_interface name="effort"/>
      <state_interface name="position"/>
      <state_interface name="velocity"/>
      <state_interface name="effort"/>
    </joint>
"""
# The nodes of ros2_control in the launch file.
MANAGER = """            Node(
                package='controller_manager',
                executable='ros2_control_node',
                parameters=[str(FOLDER / 'controllers.yaml')],
            ),
            Node(
                package='controller_manager',
                executable='spawner',
                arguments=['joint_state_broadcaster', 'effort_controller'],
            ),
"""
DEPENDS = [
    'controller_manager',
    'forward_command_controller',
    'joint_state_broadcaster',
    'joint_state_topic_hardware_interface',
]


class Marked(Template):
    """A template with `%%name`, as shell and YAML files have dollars of their own."""

    delimiter = '%%'


def check_name(name: str) -> None:
    """Raise ValueError unless a text names a new package of ROS and Python."""
    if not NAME.fullmatch(name) or name in USED:
        raise ValueError(
            f'NAME must be lower-case letters, digits and single underscores, start with a letter '
            f'and be no module or keyword of Python, got {cut(name)!r}'
        )


def write_package(folder: Path, arm: Arm, plan: Plan, ros2_control: bool) -> None:
    """Write a package into a new folder of its name; OSError if it exists or cannot be written."""
    name = folder.name
    urdf = arm.urdf
    glue = f"    'ros2_control': False,\n    'command_topic': '{TOPIC}',\n"
    more, depends, with_them = '', '', ''
    if ros2_control:
        joints = ''.join(JOINT.format(quoteattr(joint)) for joint in arm.robot.joint_names)
        urdf = re.sub(r'\s*</robot>\s*$', lambda _: HARDWARE.format(joints), BLOCK.sub('', urdf))
        glue, more, with_them = (
            "    'publish_description': True,\n",
            MANAGER,
            ', with ros2_control',
        )
        depends = ''.join(f'  <exec_depend>{x}</exec_depend>\n' for x in DEPENDS)
    texts = {
        'name': name,
        'topic': TOPIC,
        'arm': arm.robot.name,
        'with': with_them,
        'glue': glue,
        'more_nodes': more,
        'more_depends': depends,
        'joints': written(list(arm.robot.joint_names)),
        'update_rate': round(1 / arm.period),
        'seconds': f'{plan.duration + 10 / plan.bandwidth.min() + 2:.0f}',
    }
    if folder.exists():
        raise FileExistsError(f'{folder} exists and is not overwritten')
    temporary = Path(tempfile.mkdtemp(prefix=f'.{name}_', dir=folder.parent))
    try:
        temporary.chmod(0o755)
        for template, path in FILES.items():
            if template != 'controllers.yaml' or ros2_control:
                text = (files('pfd_ros.starter') / 'templates' / f'{template}.in').read_text(
                    'utf-8'
                )
                _write(temporary / path.format(name), Marked(text).substitute(texts))
        _write(temporary / 'resource' / name, '')
        _write(temporary / name / 'arm.urdf', urdf)
        _write(temporary / name / 'arm.yaml', ''.join(_parameters(name, arm, plan)))
        (temporary / 'run.sh').chmod(0o755)
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding='utf-8')


def written(value: Any) -> str:
    """Return a value as YAML on one line."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
    return text.removesuffix('...\n').strip()


def _parameters(name: str, arm: Arm, plan: Plan) -> Iterator[str]:
    """Yield the lines of arm.yaml, each value with its source."""
    settings, start = arm.settings, {'initial_positions': tuple(plan.start.tolist())}
    yield '# Parameters of the simulated arm and of the controller, each with its source.\n'
    yield '# The node, the law and the tests read this file.\nsim_arm:\n  ros__parameters:\n'
    for key in (*TAKEN, *start):
        value = start.get(key, getattr(settings, key))
        if value != getattr(DEFAULT, key) or key in ALWAYS:
            plain = list(value) if isinstance(value, tuple) else value
            source = plan.reason if key in start and plan.reason else arm.sources[key]
            yield f'    {key}: {written(plain)}  # {source}\n'
    for key, unit in NUMBERS.items():
        named = zip(
            arm.robot.joint_names, arm.numbers[key].tolist(), arm.sources[key], strict=True
        )
        found = [(joint, x, source) for joint, x, source in named if x]
        if not found:
            yield f'    # {key}: none in the model, so none here ({unit})\n'
            continue
        yield f'    {key}:  # {unit}\n'
        for joint, x, source in found:
            yield f'      {written(joint)}: {written(x)}  # {source}\n'
    yield f'{name}:\n  ros__parameters:\n'
    for key, (value, source) in _law(plan).items():
        yield f'    {key}: {written(value)}  # {source}\n'


def _law(plan: Plan) -> Mapping[str, tuple[Any, str]]:
    return {
        'goal': (
            plan.goal.tolist(),
            'rad or m; a step of 0.5 rad or 0.1 m, or a quarter of the range',
        ),
        'duration': (plan.duration, 's; takes half of the velocity and effort limits at most'),
        'bandwidth': (
            plan.bandwidth.tolist(),
            'rad/s; the least of: 0.4 of the effort limit at an error of 0.1 rad or 0.02 m; 30; '
            '0.2 over 3.5 control periods',
        ),
        'rate': (0.0, 'Hz of a timer; 0.0: a command for each state'),
    }
