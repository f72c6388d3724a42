# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node of a command, which visits the graph; what ROS refuses is one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from rclpy.validate_full_topic_name import validate_full_topic_name

from pfd_ros.text import cut


@contextmanager
def visitor(name: str, namespace: str = '/') -> Iterator[Node]:
    """
    Make a node that leaves signals to its program, until the block ends.

    ValueError if the namespace is invalid or ROS cannot start, such as in an invalid domain.
    """
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        yield rclpy.create_node(
            name, namespace=namespace, start_parameter_services=False, enable_rosout=False
        )
    except NameValidationException as error:
        raise ValueError(f'{cut(namespace)!r} is not a valid node namespace') from error
    except RCLError as error:
        raise ValueError(f'ROS: {error}') from error
    finally:
        try_shutdown()


def resolved(node: Node, topic: str) -> str:
    """Return the full name of a topic; ValueError if it is invalid."""
    try:
        name = node.resolve_topic_name(topic or ' ')
        validate_full_topic_name(name)
    except (NameValidationException, RCLError) as error:
        raise ValueError(f'{cut(topic)!r} is not a valid topic name') from error
    return str(name)
