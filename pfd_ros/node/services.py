# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the node: each is a request to the arm, answered by its validation result.

~/pause    std_srvs/SetBool    pause or resume simulated time
~/step     std_srvs/Trigger    while paused: as many steps as the parameter `step_count`
~/reset    std_srvs/Trigger    initial state, braked; simulated time continues, noise restarts, and
                               the failure of an arm whose state overflowed is cleared
~/clear_external_wrench    std_srvs/Trigger    no external wrench from the next step on
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Request, Source, Verdict
from pfd_ros.arm.requests import encode_request
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.node.receiving import Receiver
from pfd_ros.text import one_line


@dataclass(frozen=True)
class Services:
    """The callbacks of the services, on the executor's thread."""

    receiver: Receiver
    engine: Engine

    def request(self, request: Request, response: Any) -> Any:
        """Pass a request to the arm and wait for its result."""
        validation = self.receiver.validation_of(Source.REQUEST, encode_request(request))
        if validation is None:
            response.success, response.message = True, f'{request.name}: queued for the next step'
            return response
        response.success = validation.verdict is Verdict.ACCEPTED
        seconds = self.engine.arm.stamp_ns / NANOSECONDS
        result = validation.verdict.label
        response.message = one_line(f'{result}: {validation.detail}; simulated time {seconds} s')
        return response

    def pause(self, asked: Any, response: Any) -> Any:
        """Answer `~/pause`."""
        return self.request(Request('pause' if asked.data else 'resume'), response)

    def step(self, asked: Any, response: Any) -> Any:
        """Answer `~/step`."""
        return self.request(Request('step', self.engine.settings.step_count), response)

    def reset(self, asked: Any, response: Any) -> Any:
        """Answer `~/reset`."""
        return self.request(Request('reset'), response)

    def clear_wrench(self, asked: Any, response: Any) -> Any:
        """Answer `~/clear_external_wrench`."""
        return self.request(Request('clear_wrench'), response)


def create_services(node: Node, receiver: Receiver, engine: Engine) -> None:
    """Create the services of a node."""
    services = Services(receiver, engine)
    node.create_service(SetBool, '~/pause', services.pause)
    node.create_service(Trigger, '~/step', services.step)
    node.create_service(Trigger, '~/reset', services.reset)
    node.create_service(Trigger, '~/clear_external_wrench', services.clear_wrench)
