# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the node: each is a request to the arm, answered by its verdict.

~/pause    std_srvs/SetBool    pause or resume simulated time
~/step     std_srvs/Trigger    while paused: as many steps as the parameter `step_count`
~/reset    std_srvs/Trigger    initial state, braked; simulated time continues, noise restarts, and
                               the failure of an arm whose state overflowed is cleared
~/clear_external_wrench    std_srvs/Trigger    no external wrench from the next step on
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import TimeoutError as LateError
from functools import partial
from typing import Any

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import REQUESTS
from pfd_ros.arm.other_inputs import encode_request
from pfd_ros.node.inbox import Inbox
from pfd_ros.text import one_line

# The executor's thread waits for the arm, which takes inputs at least twenty times a second.
ANSWER_SECONDS = 0.5
NANOSECONDS = 1_000_000_000

# Name, type, and the request of a service, from the settings and the message of a caller.
SERVICES: tuple[tuple[str, Any, Callable[[Any, Any], dict[str, Any]]], ...] = (
    ('~/pause', SetBool, lambda _, asked: {'name': 'pause' if asked.data else 'resume'}),
    ('~/step', Trigger, lambda settings, _: {'name': 'step', 'count': settings.step_count}),
    ('~/reset', Trigger, lambda *_: {'name': 'reset'}),
    ('~/clear_external_wrench', Trigger, lambda *_: {'name': 'clear_wrench'}),
)


def create_services(node: Node, engine: Engine, inbox: Inbox) -> None:
    """Create the services of a node."""

    def answer(request_of: Callable[[Any, Any], dict[str, Any]], asked: Any, response: Any) -> Any:
        request = request_of(engine.state.settings, asked)
        try:
            verdict = inbox.put(REQUESTS, encode_request(**request)).result(ANSWER_SECONDS)
        except LateError:
            # It may still be done, or refused.
            response.success = False
            response.message = f'{request["name"]}: no answer within {ANSWER_SECONDS:g} s; queued'
            return response
        seconds = engine.stamp_ns / NANOSECONDS
        text = f'{verdict.label}: {verdict.detail or request["name"]}; simulated time {seconds} s'
        response.success, response.message = verdict.accepted, one_line(text)
        return response

    for name, kind, request_of in SERVICES:
        node.create_service(kind, name, partial(answer, request_of))
