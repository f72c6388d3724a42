# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the node: each is a request to the arm, answered by its verdict.

~/pause    std_srvs/SetBool    pause or resume simulated time
~/step     std_srvs/Trigger    while paused: as many steps as the parameter `step_count`
~/reset    std_srvs/Trigger    initial state, braked; simulated time continues, noise restarts, and
                               the failure of an arm whose state overflowed is cleared
~/clear_external_wrench    std_srvs/Trigger    no external wrench from the next step on

Where ROS finds the package `simulation_interfaces`, there are the standard services of simulators,
too. They have the names that other simulators give them, in the namespace of the node. Such a call
is answered once it is done, by its own thread: in lockstep, steps wait for commands, which the
executor takes.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import TimeoutError as LateError
from functools import partial
import time
from typing import Any

from rclpy.node import Node
from rclpy.type_support import check_for_type_support
from std_srvs.srv import SetBool, Trigger

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import REQUESTS
from pfd_ros.arm.other_inputs import encode_request
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.node.inbox import Inbox
from pfd_ros.node.threads import Threads
from pfd_ros.text import one_line

# The executor's thread waits for the arm, which takes inputs at least twenty times a second.
ANSWER_SECONDS = 0.5
# Between two looks at an arm that is not done, s.
LOOK_SECONDS = 1e-3
FEATURES = (
    *('SIMULATION_RESET', 'SIMULATION_RESET_STATE', 'SIMULATION_STATE_GETTING'),
    *('SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE'),
    *('STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE'),
)
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


def create_standard_services(
    node: Node, engine: Engine, inbox: Inbox, threads: Threads, ended: Callable[[], bool]
) -> None:
    """Create the standard services of a node, if their package is there."""
    try:
        from simulation_interfaces import msg, srv
    except ImportError:
        return
    try:
        check_for_type_support(srv.GetSimulatorFeatures)
    except Exception as error:  # of another program, or another version of Python
        text = f'no standard services: simulation_interfaces cannot be used: {error}'
        node.get_logger().warning(one_line(text))
        return
    result, states, stopped = msg.Result, msg.SimulationState, False
    requests: dict[int, tuple[str, ...]] = {
        states.STATE_STOPPED: ('pause', 'reset'),
        states.STATE_PLAYING: ('resume',),
        states.STATE_PAUSED: ('pause',),
    }

    def now() -> int:
        """Return the state; it is stopped only if that was set and nothing has moved since."""
        state = engine.state
        still = stopped and state.cycle <= state.epoch
        paused = states.STATE_STOPPED if still else states.STATE_PAUSED
        return int(paused if state.paused else states.STATE_PLAYING)

    def request(*names: str, **more: int) -> tuple[int, str]:
        """Return the result of some requests to the arm, once it has done them."""
        asked = [inbox.put(REQUESTS, encode_request(name, **more)) for name in names]
        while not ended() and (
            not asked[-1].done()
            or (engine.state.active and (engine.state.left or engine.state.jump is not None))
        ):
            time.sleep(LOOK_SECONDS)
        verdicts = [one.result() for one in asked if one.done()]
        why = '; '.join(verdict.detail for verdict in verdicts if not verdict.accepted)
        return result.RESULT_OPERATION_FAILED if why else result.RESULT_OK, why

    def get_state(_: Any, response: Any) -> tuple[int, str]:
        response.state.state = now()
        return result.RESULT_OK, ''

    def set_state(asked: Any, response: Any) -> tuple[int, str]:
        nonlocal stopped
        wanted = asked.state.state
        if wanted not in requests:
            return result.RESULT_FEATURE_UNSUPPORTED, f'state {wanted}, expected {list(requests)}'
        if wanted == now():
            return response.ALREADY_IN_TARGET_STATE, ''
        stopped = wanted == states.STATE_STOPPED
        return request(*requests[wanted])

    def step(asked: Any, _: Any) -> tuple[int, str]:
        if now() != states.STATE_PAUSED:
            return result.RESULT_OPERATION_FAILED, 'the simulation is not paused'
        before = engine.state.cycle
        code, why = request('step', count=asked.steps)
        count = engine.state.cycle - before
        if not why and count < asked.steps:
            return result.RESULT_OPERATION_FAILED, f'ended after {count} of {asked.steps} steps'
        return code, why

    def reset(asked: Any, _: Any) -> tuple[int, str]:
        if asked.scope in (asked.SCOPE_DEFAULT, asked.SCOPE_STATE):
            return request('reset')
        why = 'simulated time continues and nothing is spawned: expected SCOPE_STATE'
        return result.RESULT_FEATURE_UNSUPPORTED, why

    def get_features(_: Any, response: Any) -> Any:
        response.features.features = [getattr(msg.SimulatorFeatures, name) for name in FEATURES]
        return response

    def answer(work: Any, send: Any, both: tuple[Any, Any], header: Any) -> None:
        code, why = result.RESULT_INCORRECT_STATE, 'the arm is inactive: activate its node'
        if engine.state.active:
            code, why = work(*both)
            if engine.state.failure:
                code, why = result.RESULT_OPERATION_FAILED, engine.state.failure
        both[1].result = result(result=code, error_message=one_line(why))
        if not ended():
            send(both[1], header)

    def start(*call: Any) -> None:
        threads.start('a standard service', partial(answer, *call), lambda: True)

    node.create_service(srv.GetSimulatorFeatures, 'get_simulator_features', get_features)
    for kind, name, work in (
        (srv.GetSimulationState, 'get_simulation_state', get_state),
        (srv.SetSimulationState, 'set_simulation_state', set_state),
        (srv.StepSimulation, 'step_simulation', step),
        (srv.ResetSimulation, 'reset_simulation', reset),
    ):
        # The executor passes what the callback returns to `send_response`.
        service: Any = node.create_service(kind, name, lambda *both: both)
        service.send_response = partial(start, work, service.send_response)
