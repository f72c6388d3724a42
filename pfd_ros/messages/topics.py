# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics and message classes for nodes of rclpy, which this module does not import."""

from __future__ import annotations

import importlib
from typing import Any

# Node name that the graph reports until discovery has it; some middleware never reports it.
UNKNOWN_NODE = '_NODE_NAME_UNKNOWN_'


def message_class(kind: str) -> Any:
    """Return the class of a type such as 'sensor_msgs/msg/JointState'.

    ImportError or AttributeError if it is not installed.
    """
    package, folder, name = kind.split('/')
    return getattr(importlib.import_module(f'{package}.{folder}'), name)


def remapped(node: Any, own: str) -> str:
    """Return the full name that remappings of a node give one of its topics, '' if none does."""
    name = str(node.resolve_topic_name(own))
    return '' if name == node.resolve_topic_name(own, only_expand=True) else name


def node_of(end: Any) -> str:
    """Return the full name of the node of an endpoint in the graph."""
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'
