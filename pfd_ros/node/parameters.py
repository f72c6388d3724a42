# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Declares the settings as parameters of a node and reads them back."""

from __future__ import annotations

from contextlib import suppress
import dataclasses
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterUninitializedException
from rclpy.node import Node
from rclpy.parameter import Parameter

from pfd_ros.arm.setting_fields import parameter_name
from pfd_ros.arm.settings import Settings, from_values
from pfd_ros.text import listed

# By the annotation of the field: an empty tuple does not have the type of its elements.
_KINDS = {
    'str': Parameter.Type.STRING,
    'bool': Parameter.Type.BOOL,
    'int': Parameter.Type.INTEGER,
    'float': Parameter.Type.DOUBLE,
    'tuple[str, ...]': Parameter.Type.STRING_ARRAY,
    'tuple[float, ...]': Parameter.Type.DOUBLE_ARRAY,
}


def _descriptor(field: dataclasses.Field[Any]) -> ParameterDescriptor:
    values = field.metadata['values']
    descriptor = ParameterDescriptor(
        description=field.metadata['text'],
        additional_constraints=f'one of {list(values)}' if values else '',
        read_only=True,
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
    """Declare every setting as a parameter and return that of `autostart`.

    They are read-only, but for those of a node without autostart: such a node may be configured
    again and again, with other values.

    Raises
    ------
    rclpy.exceptions.ParameterException
        If a value has the wrong type or lies outside its range.
    """
    fields = {field.name: field for field in dataclasses.fields(Settings)}
    first = fields.pop('autostart')
    node.declare_parameter(first.name, first.default, _descriptor(first))
    autostart = bool(node.get_parameter(first.name).value)
    for field in fields.values():
        kind = _KINDS[str(field.type)]
        # Without a default value an empty array has no type; the type alone has no default.
        given = kind if isinstance(field.default, tuple) and not field.default else field.default
        descriptor = _descriptor(field)
        descriptor.read_only = autostart
        node.declare_parameter(
            parameter_name(field), list(given) if isinstance(given, tuple) else given, descriptor
        )
    return autostart


def read(node: Node) -> Settings:
    """Return the settings that the parameters of a node say.

    Raises
    ------
    ValueError
        If the values do not go together.
    """
    values: dict[str, Any] = {}
    for field in dataclasses.fields(Settings):
        with suppress(ParameterUninitializedException):
            value = node.get_parameter(parameter_name(field)).value
            values[field.name] = (
                value if isinstance(value, str | bool | int | float) else tuple(value)
            )
    return from_values(values)


def misspelt(node: Node) -> str:
    """Return the parameters the user set that the node does not have, as a list to show."""
    # rclpy keeps parameters of the command line and of files here, and nowhere public.
    given = getattr(node, '_parameter_overrides', {})
    unknown = sorted(name for name in given if not node.has_parameter(name))
    return listed(unknown) if unknown else ''
