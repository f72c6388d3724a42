# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings as parameters of the node: declared, read back, and set while the arm runs.

A setting with a number for each joint is a group of parameters, `damping.<joint>`, which is
declared once the robot is known. Setting a dynamic parameter is an input of the arm, which accepts
or rejects it; other parameters cannot change while there is an arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import TimeoutError as LateError
from contextlib import suppress
from dataclasses import replace
import itertools
import json
import math
from pathlib import Path
import re
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
import yaml

import pfd_core as pfd
from pfd_ros.arm.conventions import defaults
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import PARAMETERS
from pfd_ros.arm.other_inputs import changed
from pfd_ros.arm.setting_fields import Row, typed
from pfd_ros.arm.settings import (
    FIELDS,
    PER_JOINT,
    REMOVED,
    Settings,
    joint_order,
    joint_values,
    with_joint_numbers,
)
from pfd_ros.messages.values import encode_string
from pfd_ros.node.inbox import Changes
from pfd_ros.node.services import ANSWER_SECONDS
from pfd_ros.text import listed, one_line, similar

# Unknown parameters that are compared with known ones, which takes some milliseconds each.
MOST_UNKNOWN = 100
# By the annotation of the field: an empty tuple does not have the type of its elements.
_KINDS = {
    'str': Parameter.Type.STRING,
    'bool': Parameter.Type.BOOL,
    'bool | str': Parameter.Type.NOT_SET,
    'int': Parameter.Type.INTEGER,
    'float': Parameter.Type.DOUBLE,
    'tuple[str, ...]': Parameter.Type.STRING_ARRAY,
    'tuple[float, ...]': Parameter.Type.DOUBLE_ARRAY,
}
# What an integer becomes where doubles are expected: `payload.mass:=3` is YAML's integer.
_DOUBLES = {
    Parameter.Type.INTEGER: Parameter.Type.DOUBLE,
    Parameter.Type.INTEGER_ARRAY: Parameter.Type.DOUBLE_ARRAY,
}
_SINGLE = tuple(row for row in FIELDS if not row.per_joint)


def _descriptor(row: Row, *, fixed: bool) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=row.description,
        additional_constraints=f'one of {list(row.values)}' if row.values else '',
        read_only=fixed and not row.dynamic,
        type=_KINDS[row.type].value,
        dynamic_typing=_KINDS[row.type] is Parameter.Type.NOT_SET,
    )
    if row.least is not None:
        least = row.least if row.or_else is None else min(row.least, row.or_else)
        span = {'from_value': least, 'to_value': row.most}
        if row.type == 'int':
            descriptor.integer_range = [IntegerRange(**span, step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(**span)]
    return descriptor


def doubles(parameters: Iterable[Parameter]) -> list[Parameter]:
    """Return parameters with doubles in place of integers where a setting has doubles."""
    single = {row.name: _KINDS[row.type] for row in _SINGLE}
    joints = tuple(f'{row.name}.' for row in PER_JOINT)
    found = []
    for one in parameters:
        expected = Parameter.Type.DOUBLE if one.name.startswith(joints) else None
        kind, value = single.get(one.name, expected), one.value
        if kind is not None and _DOUBLES.get(one.type_) is kind:
            array = kind is Parameter.Type.DOUBLE_ARRAY
            one = Parameter(one.name, kind, [*map(float, value)] if array else float(value))
        found.append(one)
    return found


def declare(node: Node) -> bool:
    """Declare every setting except those per joint, and return the value of `autostart`.

    They are read-only, except dynamic ones. All of a node without autostart may be changed before
    each configuration, but for the convention, on which defaults depend. ParameterException if a
    value has the wrong type or is out of its range.
    """
    autostart, values = True, dict[str, Any]()
    overrides = _given(node)
    overrides |= {one.name: one for one in doubles(overrides.values())}
    node.add_pre_set_parameters_callback(doubles)
    first = 'autostart', 'convention'
    for row in sorted(_SINGLE, key=lambda row: row.field not in first):
        kind, default = _KINDS[row.type], values.get(row.field, row.default)
        given = list(default) if isinstance(default, tuple) else default
        fixed = autostart or row.field == 'convention'
        if given != []:
            node.declare_parameter(row.name, given, _descriptor(row, fixed=fixed))
        else:
            # Declared by its type, as rclpy takes it for bytes. Without a value it would keep
            # GetParameters from answering with any other.
            one = node.declare_parameter(row.name, kind, _descriptor(row, fixed=False))
            if one.type_ is Parameter.Type.NOT_SET:
                node.set_parameters([Parameter(row.name, kind, given)])
            node.set_descriptor(row.name, _descriptor(row, fixed=fixed))
        if row.field == 'autostart':
            autostart = bool(node.get_parameter(row.name).value)
        elif row.field == 'convention':
            values = defaults(str(node.get_parameter(row.name).value))
    return autostart


def read(node: Node) -> Settings:
    """Return the settings from the parameters of a node; ValueError if they are inconsistent."""
    values = {row.field: _plain(node.get_parameter(row.name).value) for row in _SINGLE}
    return Settings.from_values(values)


def declare_joints(node: Node, settings: Settings, robot: pfd.Robot) -> Settings:
    """Declare the settings with a number for each joint, and return the settings with them.

    A group without a number that differs from its default stays empty in the settings. Values from
    the start of the node apply again to each new arm.
    """
    fixed = bool(node.get_parameter('autostart').value)
    order = joint_order(settings.joints, robot)
    for row in PER_JOINT:
        for joint in node.get_parameters_by_prefix(row.name):
            # Of the previous arm, which may have been another robot.
            if not node.describe_parameter(f'{row.name}.{joint}').read_only:
                node.undeclare_parameter(f'{row.name}.{joint}')
        names = [f'{row.name}.{robot.joint_names[k]}' for k in order]
        try:
            defaults = joint_values(row, settings, robot, order)
        except ValueError:  # the convention has none for so many joints
            if not set(names) <= _given(node).keys():
                raise
            defaults = (math.nan,) * len(order)
        for name, default in zip(names, defaults, strict=True):
            if not node.has_parameter(name):
                node.declare_parameter(name, default, _descriptor(row, fixed=fixed))
        values = tuple(node.get_parameter(name).value for name in names)
        if values != defaults:
            changes: dict[str, Any] = {row.field: values}
            settings = replace(settings, **changes)
    return settings


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | bool | int | float) else tuple(value)


def unknown_parameters(node: Node) -> list[str]:
    """Return the parameters that arguments or files give, and the node does not have."""
    return sorted(name for name in _given(node) if not node.has_parameter(name))


def _given(node: Node) -> dict[str, Parameter]:
    # rclpy has no public access to them.
    given: dict[str, Parameter] = getattr(node, '_parameter_overrides', {})
    return given


def refuse_unknown(node: Node) -> str:
    """Return a line about unknown parameters, '' without any, unless one seems to be misspelt.

    ValueError if a name resembles a known one, or is of an earlier version. A file for all nodes
    (`/**`) may hold parameters of others, and a node without autostart may have some for the
    joints of its next robot.
    """
    unknown = unknown_parameters(node)
    for name in unknown:
        if name in REMOVED:
            raise ValueError(f'there is no parameter {name!r} any more: {REMOVED[name]}')
    known = sorted(node.get_parameters_by_prefix(''))
    meant = {name: similar(name, known) for name in unknown[:MOST_UNKNOWN]}
    near = sorted({match for found in meant.values() for match in found})
    hint = f'; similar names: {listed(near)}' if near else ''
    if near and node.get_parameter('autostart').value:
        raise ValueError(f'unknown parameters {listed([n for n in meant if meant[n]])}{hint}')
    return f'unknown parameters ignored: {listed(unknown)}{hint}' if unknown else ''


def files_of_others(node: Node, args: Sequence[str]) -> Iterator[str]:
    """Yield a line for each parameter file on a command line without a section for a node.

    ROS ignores such a file, which a launch file may give to all its nodes. If nothing else names
    the robot, the node would run another one than the file states: ValueError.
    """
    full_name = node.get_fully_qualified_name()
    for option, path in itertools.pairwise(args):
        if option != '--params-file':
            continue
        with suppress(OSError, UnicodeDecodeError, yaml.YAMLError):
            text = Path(path).read_text(encoding='utf-8')
            sections = list(_sections(yaml.load(text, yaml.CSafeLoader)))
            # As rcl reads them: '/**' stands for any names, '*' for a part of one.
            patterns = [
                re.escape(section).replace(r'/\*\*', '(/.*)?').replace(r'\*', '[^/]*')
                for section in sections
            ]
            if sections and not re.fullmatch('|'.join(patterns), full_name):
                line = (
                    f'{path} has no parameters for {full_name}, only for {listed(sections)}: '
                    f"write {full_name.rpartition('/')[2]!r} or '/**' in it, or leave it out"
                )
                if 'robot' not in _given(node):
                    raise ValueError(line)
                yield line


def _sections(tree: Any, name: str = '') -> Iterator[str]:
    """Yield the names of nodes in a parameter file, perhaps with wildcards."""
    for key, value in tree.items() if isinstance(tree, dict) else ():
        if key == 'ros__parameters':
            yield name or '/'
        else:
            yield from _sections(value, f'{name}/{str(key).strip("/")}')


def setter(
    engine: Engine, changes: Changes
) -> Callable[[Sequence[Parameter]], SetParametersResult]:
    """Return the callback that passes new values to the arm before rclpy sets them.

    It returns success or the reason, and accepts parameters of rclpy, such as use_sim_time.
    """
    places = {row.name: (row, '') for row in _SINGLE}
    for row in PER_JOINT:
        places |= {f'{row.name}.{joint}': (row, joint) for joint in engine.names}

    def set_parameters(parameters: Sequence[Parameter]) -> SetParametersResult:
        given = [(one, *places[one.name]) for one in parameters if one.name in places]
        try:
            reason = passed_on(given) if given else ''
        except ValueError as error:
            reason = one_line(error)
        return SetParametersResult(successful=not reason, reason=reason)

    def passed_on(given: Sequence[tuple[Parameter, Row, str]]) -> str:
        """Pass values on, and return why the arm refuses them, '' if it does not."""
        changes.settle(ANSWER_SECONDS)
        values, numbers = dict[str, Any](), dict[str, dict[str, float]]()
        for parameter, row, joint in given:
            if not row.dynamic:
                raise ValueError(f'{listed([parameter.name])} cannot change until cleanup')
            if joint:
                number = typed(parameter.name, parameter.value, 'float')
                numbers.setdefault(row.field, {})[joint] = number
            else:
                values[row.field] = typed(row.name, _plain(parameter.value), row.type)
        settings = with_joint_numbers(engine.state.settings, engine.robot, numbers)
        values |= {field: getattr(settings, field) for field in numbers}
        settings = changed(engine, values)
        verdict = changes.put(PARAMETERS, encode_string(json.dumps(values)))
        if not engine.plants.ready(settings):
            # The executor does not wait for the compiler; a late refusal is logged.
            return ''
        try:
            found = verdict.result(ANSWER_SECONDS)
        except LateError:
            # A very slow arm applies them later.
            return ''
        return '' if found.accepted else f'{found.label}: {found.detail}'

    return set_parameters
