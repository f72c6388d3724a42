# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings as parameters of the node: declared, read back, and set while the arm runs.

A setting with a number for each joint is a group of parameters, `damping.<joint>`, which is
declared once the robot is known. Setting a dynamic parameter is an event of the arm, which accepts
or rejects it; other parameters cannot change while there is an arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
import dataclasses
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterUninitializedException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

import pfd_core as pfd
from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.setting_fields import joint_values, parameter_name, typed
from pfd_ros.arm.settings import Settings, from_values
from pfd_ros.node.changing import Changes
from pfd_ros.text import NAME_COUNT, cut, listed, one_line, similar

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
_PER_JOINT = tuple(f for f in dataclasses.fields(Settings) if f.metadata['per_joint'])


def _descriptor(field: dataclasses.Field[Any], *, fixed: bool = True) -> ParameterDescriptor:
    values = field.metadata['values']
    descriptor = ParameterDescriptor(
        description=field.metadata['text'],
        additional_constraints=f'one of {list(values)}' if values else '',
        read_only=fixed and not field.metadata['dynamic'],
        dynamic_typing=_KINDS[str(field.type)] is Parameter.Type.NOT_SET,
    )
    if field.metadata['range'] is not None:
        least, most = field.metadata['range']
        if field.type == 'int':
            descriptor.integer_range = [IntegerRange(from_value=least, to_value=most, step=1)]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=least, to_value=most, step=0.0)
            ]
    return descriptor


def declare(node: Node) -> bool:
    """Declare every setting except those per joint, and return the value of `autostart`.

    They are read-only, except dynamic ones. All of a node without autostart may be changed before
    each configuration.

    Raises
    ------
    ValueError, rclpy.exceptions.ParameterException
        If a value has the wrong type or lies outside its range.
    """
    fields = {f.name: f for f in dataclasses.fields(Settings) if f not in _PER_JOINT}
    first = fields.pop('autostart')
    node.declare_parameter(first.name, first.default, _descriptor(first))
    autostart = bool(node.get_parameter(first.name).value)
    for field in fields.values():
        kind = _KINDS[str(field.type)]
        # Without a default value an empty array has no type; the type alone has no default.
        given = kind if isinstance(field.default, tuple) and not field.default else field.default
        _declare(
            node,
            parameter_name(field),
            list(given) if isinstance(given, tuple) else given,
            kind,
            _descriptor(field, fixed=autostart),
        )
    return autostart


def read(node: Node) -> Settings:
    """Return the settings from the parameters of a node.

    Raises
    ------
    ValueError
        If the values are inconsistent.
    """
    values: dict[str, Any] = {}
    for field in dataclasses.fields(Settings):
        if field not in _PER_JOINT:
            with suppress(ParameterUninitializedException):
                values[field.name] = _plain(node.get_parameter(parameter_name(field)).value)
    return from_values(values)


def declare_joints(node: Node, settings: Settings, robot: pfd.Robot) -> Settings:
    """Declare the settings with a number for each joint, and return the settings with them.

    A group without a number that differs from its default stays empty in the settings. Values from
    the start of the node apply again to each new arm.

    Raises
    ------
    rclpy.exceptions.ParameterException, ValueError
        As `declare` and `read`.
    """
    fixed = bool(node.get_parameter('autostart').value)
    order = joint_order(settings.joints, robot)
    for field in _PER_JOINT:
        _undeclare_group(node, parameter_name(field))
        defaults = joint_values(field, settings, robot, order)
        names = [joint_parameter(field, robot.joint_names[i]) for i in order]
        for name, default in zip(names, defaults, strict=True):
            if not node.has_parameter(name):
                kind = Parameter.Type.DOUBLE
                _declare(node, name, default, kind, _descriptor(field, fixed=fixed))
        values = tuple(node.get_parameter(name).value for name in names)
        if values != defaults:
            changed: dict[str, Any] = {field.name: values}
            settings = dataclasses.replace(settings, **changed)
    return settings


def _undeclare_group(node: Node, group: str) -> None:
    """Undeclare the joint parameters of the previous arm, which may have been another robot."""
    for joint in node.get_parameters_by_prefix(group):
        name = f'{group}.{joint}'
        if not node.describe_parameter(name).read_only:
            node.undeclare_parameter(name)


def joint_parameter(field: dataclasses.Field[Any], joint: str) -> str:
    """Return the name of a setting's parameter for one joint."""
    return f'{parameter_name(field)}.{joint}'


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | bool | int | float) else tuple(value)


def given_parameters(node: Node) -> Mapping[str, Parameter]:
    """Return the parameters on the command line and in files, by name."""
    # rclpy has no public access to them.
    found: Mapping[str, Parameter] = getattr(node, '_parameter_overrides', {})
    return found


def misspelt(node: Node) -> str:
    """Return the parameters set by the user that the node does not have, for a log line."""
    unknown = sorted(name for name in given_parameters(node) if not node.has_parameter(name))
    known = sorted(node.get_parameters_by_prefix(''))
    meant = sorted({match for name in unknown[:NAME_COUNT] for match in similar(name, known)})
    hint = f'; similar names: {listed(meant)}' if meant else ''
    return f'{listed(unknown)}{hint}' if unknown else ''


@dataclass
class ParameterChanges:
    """The callback that validates parameters before rclpy sets them, from any thread."""

    changes: Changes
    # Parameter -> its field, and the index of its joint or -1.
    _places: dict[str, tuple[Any, int]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """List the parameters by name."""
        for field in dataclasses.fields(Settings):
            if field in _PER_JOINT:
                for place, joint in enumerate(self.changes.engine.arm.names):
                    self._places[joint_parameter(field, joint)] = field, place
            else:
                self._places[parameter_name(field)] = field, -1

    def set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Apply new values, all or none; return success or the reason.

        Parameters of rclpy, such as use_sim_time, are accepted.
        """
        ours = [parameter for parameter in parameters if parameter.name in self._places]
        reason = ''
        if ours:
            try:
                self.changes.set(lambda settings: self._values(ours, settings))
            except ValueError as error:
                reason = one_line(error)
        return SetParametersResult(successful=not reason, reason=reason)

    def _values(self, parameters: Sequence[Parameter], settings: Settings) -> dict[str, Any]:
        """Return the new values by field."""
        arm = self.changes.engine.arm
        values: dict[str, Any] = {}
        for parameter in parameters:
            field, place = self._places[parameter.name]
            if not field.metadata['dynamic']:
                raise ValueError(f'{listed([parameter.name])} cannot change until cleanup')
            if place < 0:
                value = typed(parameter.name, _plain(parameter.value), str(field.type))
            else:
                before = values.get(field.name) or joint_values(
                    field, settings, arm.robot, arm.order
                )
                number = typed(parameter.name, parameter.value, 'float')
                value = (*before[:place], number, *before[place + 1 :])
            values[field.name] = value
        return values


class StrictParameterService(ParameterService):
    """The parameter services; reject a value of unknown type, for which rclpy raises.

    The reason for rejecting an integer shows how to write it as a floating-point number.
    It overrides callbacks of rclpy (Jazzy) that have no public name.
    """

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self._own_node = node

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        refused = _untyped(request.parameters)
        if refused is None:
            response = super()._set_parameters_callback(request, response)
            for message, result in zip(request.parameters, response.results, strict=True):
                self._explain(result, [message])
            return response
        response.results = [refused] * len(request.parameters)
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        refused = _untyped(request.parameters)
        if refused is None:
            response = super()._set_parameters_atomically_callback(request, response)
            self._explain(response.result, request.parameters)
            return response
        response.result = refused
        return response

    def _explain(self, result: SetParametersResult, messages: Sequence[Any]) -> None:
        """Replace the reason if an integer is the cause, and a number would be accepted."""
        if result.successful:
            return
        for message in messages:
            if self._own_node.has_parameter(message.name):
                descriptor = self._own_node.describe_parameter(message.name)
                if descriptor.read_only:
                    return
                declared = Parameter.Type(descriptor.type)
                result.reason = (
                    _integer_trouble(Parameter.from_parameter_msg(message), declared)
                    or result.reason
                )


def _integer_trouble(given: Parameter, declared: Parameter.Type) -> str:
    """Return how to write integers of a floating-point parameter, or ''."""
    kinds = given.type_, declared
    if kinds == (Parameter.Type.INTEGER, Parameter.Type.DOUBLE):
        written = f'{given.value}.0'
    elif kinds == (Parameter.Type.INTEGER_ARRAY, Parameter.Type.DOUBLE_ARRAY):
        written = f'[{", ".join(f"{value}.0" for value in given.value)}]'
    else:
        return ''
    return one_line(f'{cut(given.name)} takes floating-point numbers: write {cut(written)}')


def _declare(
    node: Node, name: str, given: Any, kind: Parameter.Type, descriptor: ParameterDescriptor
) -> None:
    """Declare a parameter with a default value, or with its type alone."""
    chosen = given_parameters(node).get(name)
    trouble = '' if chosen is None else _integer_trouble(chosen, kind)
    if trouble:
        raise ValueError(trouble)
    node.declare_parameter(name, given, descriptor)


def _untyped(parameters: Sequence[Any]) -> SetParametersResult | None:
    """Return the rejection of parameters with a value of unknown type, or None."""
    types = {int(kind.value) for kind in Parameter.Type}
    strange = [parameter.name for parameter in parameters if parameter.value.type not in types]
    if not strange:
        return None
    reason = f'{listed(strange)} has a value of unknown type'
    return SetParametersResult(successful=False, reason=one_line(reason))
