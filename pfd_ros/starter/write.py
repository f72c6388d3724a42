# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a controller package, from the templates; all of them or none."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.machinery import PathFinder
import keyword
from pathlib import Path
import re
from string import Template
import sys
import tempfile
from typing import Any
import xml.etree.ElementTree as ElementTree
from xml.sax.saxutils import quoteattr

import yaml

from pfd_ros.arm.settings import Settings
from pfd_ros.starter.arm import NUMBERS, PLAIN, Arm
from pfd_ros.starter.plan import Plan
from pfd_ros.text import cut

# Each is a file of the package in the folder of its template; but the folders PACKAGE and GITHUB.
TEMPLATES = Path(__file__).with_name('templates')
PACKAGE, GITHUB = 'package', 'github'
# Settings in arm.yaml: where they are not the default, and always.
DEFAULT, ALWAYS = Settings(), {'tip_link', 'step_size', 'initial_positions'}
# Rules of REP 144 for names, by what breaks them; the first counts. Python imports it, too.
RULES = {
    r'[^a-z0-9_]': 'be of lower-case letters, digits and underscores',
    r'^[^a-z]': 'start with a letter',
    r'__|_$': 'have a letter or digit after each underscore',
    r'^.?$': 'have two characters or more, as each name of a ROS package',
}
USED = dict.fromkeys(sys.stdlib_module_names, 'be no module of Python')
USED |= dict.fromkeys(keyword.kwlist, 'be no keyword of Python')
USED |= dict.fromkeys(['pfd_core', 'pfd_ros', 'rclpy'], 'be no installed Python module')
USED['sim_arm'] = 'differ from the node of the arm'
USED |= dict.fromkeys(
    ['build', 'install', 'launch', 'log', 'resource', 'setup', 'test'],
    'differ from the files and folders in the package',
)
# Hardware of ros2_control that talks over topics, and a joint of it: see the guide
# docs/guides/alongside-a-controller.md.
HARDWARE = """
<ros2_control name="arm" type="system">
  <hardware>
    <plugin>joint_state_topic_hardware_interface/JointStateTopicSystem</plugin>
    <param name="joint_commands_topic">/robot_joint_commands</param>
    <param name="joint_states_topic">/robot_joint_states</param>
    <param name="trigger_joint_command_threshold">-1</param>
  </hardware>{}
</ros2_control>
"""
JOINT = '<joint name={}><command_interface name="effort"/>'
JOINT += ''.join(f'<state_interface name="{x}"/>' for x in ('position', 'velocity', 'effort'))
JOINT += '</joint>'
DEPENDS = ['controller_manager', 'forward_command_controller', 'joint_state_broadcaster']
DEPENDS += ['joint_state_topic_hardware_interface']


class Marked(Template):
    """A template with `%%name`, as shell and YAML files have dollars of their own."""

    delimiter = '%%'


def check_name(name: str) -> None:
    """Raise ValueError unless a text names a new package of ROS and Python in this folder."""
    others = [folder for folder in sys.path if Path(folder).resolve() != Path.cwd()]
    broken = next((rule for pattern, rule in RULES.items() if re.search(pattern, name)), '')
    if not broken and (name in USED or PathFinder.find_spec(name, others)):
        broken = USED.get(name, 'be no installed Python module')
    if broken:
        raise ValueError(f'NAME must {broken}, got {cut(name)!r}')
    if Path(name).exists():
        raise FileExistsError(f'{name} exists and is not overwritten; choose another NAME')


def write_package(name: str, arm: Arm, plan: Plan, ros2_control: bool) -> None:
    """Write a package into a new folder of its name; OSError if it cannot be written."""
    urdf, joints = arm.urdf, arm.robot.joint_names
    if ros2_control:
        urdf = _controlled(urdf, ''.join(JOINT.format(quoteattr(joint)) for joint in joints))
    texts = {
        'name': name,
        'arm': arm.robot.name,
        'joints': _yaml(list(joints)),
        'depends': ''.join(f'  <exec_depend>{x}</exec_depend>\n' for x in DEPENDS * ros2_control),
        'update_rate': round(1 / (arm.settings.publish_every * arm.settings.step_size)),
        'seconds': f'{plan.duration + 10 / plan.bandwidth.min() + 2:.0f}',
    }
    files = {f'resource/{name}': '', f'{name}/arm.urdf': urdf}
    files[f'{name}/arm.yaml'] = ''.join(_parameters(name, arm, plan))
    for template in TEMPLATES.rglob('*.in'):
        top, *rest = template.relative_to(TEMPLATES).with_suffix('').parts
        path = '/'.join([{PACKAGE: name, GITHUB: f'.{GITHUB}'}.get(top, top), *rest])
        if ros2_control or template.stem != 'controllers.yaml':
            files[path] = Marked(template.read_text('utf-8')).substitute(texts)
    with tempfile.TemporaryDirectory(prefix=f'.{name}_', dir='.') as temporary:
        folder = Path(temporary) / name
        for path, text in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text, encoding='utf-8')
        (folder / 'run.sh').chmod(0o755)
        folder.rename(name)


def _controlled(urdf: str, joints: str) -> str:
    """Return a URDF with a block for the joints in place of its own ones, and its comments."""
    comments = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(urdf.strip(), ElementTree.XMLParser(target=comments))
    for block in root.findall('ros2_control'):
        root.remove(block)
    root.append(ElementTree.fromstring(HARDWARE.format(joints)))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def _yaml(value: Any) -> str:
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
    return text.removesuffix('...\n').strip()


def _parameters(name: str, arm: Arm, plan: Plan) -> Iterator[str]:
    """Yield the lines of arm.yaml, each value with its source."""
    yield '# Parameters of the simulated arm and of the controller, each with its source.\n'
    yield '# The node, the law and the tests read this file.\nsim_arm:\n  ros__parameters:\n'
    for key in PLAIN:
        value, source = getattr(arm.settings, key), arm.sources[key]
        if key == 'initial_positions':
            value, source = plan.start.tolist(), f'rad or m, {plan.reason or source}'
        if key in ALWAYS or value != getattr(DEFAULT, key):
            yield f'    {key}: {_yaml(list(value) if isinstance(value, tuple) else value)}'
            yield f'  # {source}\n'
    for key, unit in NUMBERS.items():
        rows = zip(arm.robot.joint_names, arm.numbers[key].tolist(), arm.sources[key], strict=True)
        found = [f'      {_yaml(joint)}: {_yaml(x)}  # {why}\n' for joint, x, why in rows if x]
        yield f'    {key}:  # {unit}\n' if found else f'    # {key}: none in the model ({unit})\n'
        yield from found
    yield f'{name}:\n  ros__parameters:\n'
    yield f'    goal: {_yaml(plan.goal.tolist())}'
    yield '  # rad or m; a step of 0.5 rad or 0.1 m, or a quarter of the range\n'
    yield f'    duration: {plan.duration}'
    yield '  # s; takes half of the velocity and effort limits at most\n'
    yield f'    bandwidth: {_yaml(plan.bandwidth.tolist())}'
    yield '  # rad/s; the least of 30, 0.2 over 3.5 control periods, and what takes 0.4 of the '
    yield 'effort limit at an error of 0.1 rad or 0.02 m\n'
    yield '    rate: 0.0  # Hz of a timer; 0.0: a command for each state\n'
