# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of the node, once a second, on the main thread, from counts of other threads.

One status for each task, as REP 107 has it:

    lifecycle      the state of the node
    stepping       real-time factor, duration of a step, missed periods
    commands       rate, age, rejections by cause, publishers of each input, watchdog, reflex
    simulation     joints beyond their velocity limits, integrator, method, its error, energy, the
                   largest stable gains of a PD loop
    recording      open, waiting, recorded, error

To add a value, append a pair (name, value) in the function of its task.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

import pfd_core as pfd
from pfd_ros.arm.advice import gain_limits
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ACCEPTED, COMMANDS, DIAGNOSTICS, ROLES
from pfd_ros.arm.plant import INPUT, Plant, acceleration_kernel
from pfd_ros.arm.state import NEXT
from pfd_ros.messages.matching import OVERRIDABLE
from pfd_ros.node.graph import GraphCheck
from pfd_ros.node.report import Report, is_rejection, speed_of
from pfd_ros.node.services import NANOSECONDS
from pfd_ros.node.stepping import Stepper
from pfd_ros.text import one_line

if TYPE_CHECKING:
    from pfd_ros.recording.recorder import Recorder

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
# Longest text of a value; a robot may have hundreds of joints.
TEXT_LENGTH = 200
MICROSECONDS = 1e3  # ns


class Task(NamedTuple):
    """The status of one task: its level, a sentence, and values by name."""

    name: str
    level: bytes
    message: str
    values: Sequence[tuple[str, object]] = ()


def compiled_scene(plant: Plant) -> pfd.Scene:
    """Return the scene that native code is compiled for: it may take the payload as an input."""
    return replace(plant.scene, payload=INPUT) if plant.inputs else plant.scene


class MassKernels:
    """Inertia matrix, energy and error of the accelerations of an arm in one scene, compiled.

    As for the outputs, the wrench on the tip and the gravity torques of the motors are left out.
    """

    def __init__(self, engine: Engine) -> None:
        robot, scene = engine.robot, compiled_scene(engine.plant)
        self.digest = scene.digest
        alone = replace(scene, external_wrench=False, gravity_compensation=False)
        self.inertia: Any
        self.energy: Any
        self.inertia, self.energy = (
            pfd.compile_kernel(robot, scene=alone, quantity=quantity)
            for quantity in ('inertia_matrix', 'energy')
        )
        method = engine.state.settings.method
        self._accelerations = acceleration_kernel(robot, scene, method)
        # Compiled before the stepping thread starts.
        zero = np.zeros(robot.n)
        self.error_estimate(zero, zero, zero, engine.plant.inputs)

    def error_estimate(
        self, q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any], payload: Mapping[str, Any]
    ) -> float:
        """Return the relative error of accelerations by the method in use."""
        return float(self._accelerations.error_estimate(q, qd, tau, **payload)[1])


class ArmDiagnostics:
    """The tasks of one arm."""

    def __init__(
        self, stepper: Stepper, graph: GraphCheck, report: Report, kernels: MassKernels
    ) -> None:
        self._stepper, self._graph, self._report = stepper, graph, report
        self._engine, self._kernels = stepper.engine, kernels
        self._seen = self._counts()

    def _counts(self) -> dict[str, float]:
        stepper, state, inputs = self._stepper, self._engine.state, self._report.inputs()
        return {
            'seconds': time.monotonic(),
            'simulated_seconds': self._engine.stamp_ns / NANOSECONDS,
            'cycles': state.cycle,
            'late': stepper.late,
            'missed': stepper.missed,
            'accepted': sum(inputs.get((role, ACCEPTED.label), (0,))[0] for role in COMMANDS),
            'rejected': sum(n for (_, label), (n, _) in inputs.items() if is_rejection(label)),
            'fast': state.fast,
        }

    def tasks(self) -> list[Task]:
        """Return the status of each task since the last call."""
        last, self._seen = self._seen, self._counts()
        new = {key: count - last[key] for key, count in self._seen.items()}
        tasks = (self._stepping, self._commands, self._simulation)
        recording = _recording(self._stepper.recorder, self._engine.state.settings.recording)
        return [*(task(self._seen, new) for task in tasks), recording]

    def _stepping(self, now: dict[str, float], new: dict[str, float]) -> Task:
        engine, state = self._engine, self._engine.state
        values: list[tuple[str, object]] = [
            ('real_time_factor', f'{new["simulated_seconds"] / new["seconds"]:.4f}'),
            ('requested_real_time_factor', state.settings.real_time_factor),
            ('simulated_time_s', now['simulated_seconds']),
            ('cycles', now['cycles']),
        ]
        lengths = self._stepper.newest_lengths(int(new['cycles']))
        if len(lengths):
            shares = np.percentile(lengths, (50, 99, 100)) / MICROSECONDS
            names = ('step_p50_us', 'step_p99_us', 'step_max_us')
            values += [(name, f'{share:.1f}') for name, share in zip(names, shares, strict=True)]
        values += [
            ('late_steps', new['late']),
            ('missed_periods', new['missed']),
            ('missed_periods_total', now['missed']),
            ('states_sent_again', self._stepper.resent),
        ]
        if state.failure:
            return Task('stepping', ERROR, state.failure, values)
        if new['missed']:
            return Task('stepping', WARN, 'periods missed (busy machine)', values)
        return Task('stepping', OK, _reason_to_wait(engine) or 'running', values)

    def _commands(self, now: dict[str, float], new: dict[str, float]) -> Task:
        state, mismatched = self._engine.state, self._graph.mismatched
        newest = max(self._report.newest.get(role, 0.0) for role in COMMANDS)
        values: list[tuple[str, object]] = [
            ('accepted_per_s', f'{new["accepted"] / new["seconds"]:.1f}'),
            ('accepted', now['accepted']),
            ('age_of_newest_s', f'{now["seconds"] - newest:.3f}' if newest else 'none'),
            ('endpoints_with_qos_or_type_mismatch', mismatched),
        ]
        for (role, label), (count, _) in sorted(self._report.inputs().items()):
            if label != ACCEPTED.label:
                values.append((f'{role}.{label}', count))
        for role, nodes in self._graph.publishers.items():
            if nodes:
                values.append((f'{role}.publishers', ' '.join(nodes)))
        values += [
            ('watchdog_trips', state.timeouts),
            ('lost_commands', state.lost),
            ('saturated_steps', state.saturated),
            ('reflex_trips', state.trips),
        ]
        if state.tripped:
            text = f'protective stop, all joints braked until ~/reset: {state.tripped}'
            return Task('commands', ERROR, text, values)
        warnings = (
            (state.timed_out, 'no command for command_timeout'),
            (new['rejected'], 'messages rejected'),
            (mismatched, 'QoS or type mismatch with another node'),
        )
        for found, text in warnings:
            if found:
                return Task('commands', WARN, text, values)
        return Task('commands', OK, 'received' if now['accepted'] else 'no commands yet', values)

    def _simulation(self, now: dict[str, float], new: dict[str, float]) -> Task:
        engine, plant = self._engine, self._engine.plant
        state, settings = engine.state, engine.state.settings
        q, qd, tau = state.rows[state.now].copy()
        if self._kernels.digest != compiled_scene(plant).digest:
            # The scene has changed.
            self._kernels = MassKernels(engine)
        kernels, payload = self._kernels, plant.inputs
        kinetic, potential = kernels.energy(q, qd, **payload)
        # A controller acts on each published state.
        period = settings.publish_every * settings.step_ns / NANOSECONDS
        level, message = (ERROR, state.failure) if state.failure else (OK, 'running')
        speed = speed_of(engine)
        if speed is not None and new['fast'] and not state.failure:
            level, message = WARN, f'beyond the velocity limit: {speed.text}'
        values: list[tuple[str, object]] = [
            ('robot', settings.robot),
            ('integrator', settings.integrator),
            ('method', settings.method),
            ('position_sums', settings.position_sums),
            ('error_estimate', f'{kernels.error_estimate(q, qd, tau, payload):.2g}'),
            ('kinetic_energy_J', f'{kinetic:.6g}'),
            ('potential_energy_J', f'{potential:.6g}'),
            ('largest_speed_over_limit', 0.0 if speed is None else f'{speed.ratio:.4g}'),
            ('cycles_beyond_velocity_limits', now['fast']),
            ('control_period_s', period),
        ]
        if settings.external_wrench:
            values += [
                ('external_wrench', _numbers(state.wrench[NEXT], '.6g')),
                ('external_wrench_frame', engine.robot.tip),
                ('external_wrench_timeout_s', settings.external_wrench_timeout),
            ]
        # The inertia matrix may be singular, or not finite.
        with suppress(np.linalg.LinAlgError):
            # Bounds of stable gains, without delay, in one proportion for all joints.
            limits = gain_limits(kernels.inertia(q, **payload), period)
            values += [
                ('pd_limit.kp_over_kd', f'{limits.ratio:.6g}'),
                ('pd_limit.kd', _numbers(limits.velocity[engine.order])),
                ('pd_limit.kp', _numbers(limits.position[engine.order])),
                ('pd_limit.same_kd_for_all', f'{limits.equal_velocity:.4g}'),
            ]
        return Task('simulation', level, message, values)


def _recording(recorder: Recorder | None, path: str) -> Task:
    if recorder is None:
        return Task('recording', OK, 'not requested', [('open', False)])
    values: list[tuple[str, object]] = [
        ('open', not recorder.error),
        ('file', path),
        ('waiting_share', f'{recorder.waiting_share:.4f}'),
        ('recorded', sum(recorder.recorded.values())),
    ]
    if recorder.error:
        return Task('recording', ERROR, recorder.error, values)
    return Task('recording', OK, 'running', values)


def _reason_to_wait(engine: Engine) -> str:
    """Return what the next cycle waits for, '' for nothing."""
    state = engine.state
    if not engine.waiting:
        return ''
    if not state.active:
        return 'inactive'
    if state.paused:
        return 'paused'
    if state.settings.follows_clock:
        return 'waiting for the followed /clock'
    return 'waiting for a command (lockstep)'


def _numbers(values: Iterable[float], form: str = '.4g') -> str:
    return ' '.join(format(value, form) for value in values)


class DiagnosticsPublisher:
    """Publishes tasks on `/diagnostics`, stamped with the time of day."""

    def __init__(self, node: Node) -> None:
        self._name = node.get_fully_qualified_name().lstrip('/')
        self._publisher = node.create_publisher(
            DiagnosticArray,
            ROLES[DIAGNOSTICS].topic,
            QoSProfile(depth=1),
            qos_overriding_options=OVERRIDABLE,
        )

    def publish(self, tasks: Iterable[Task]) -> bytes:
        """Publish the status of each task; return the message."""
        message = DiagnosticArray()
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.time_ns(), NANOSECONDS)
        message.status = [
            DiagnosticStatus(
                level=task.level,
                name=f'{self._name}: {task.name}',
                message=one_line(task.message, TEXT_LENGTH),
                hardware_id=self._name,
                values=[
                    KeyValue(key=key, value=one_line(value, TEXT_LENGTH))
                    for key, value in task.values
                ],
            )
            for task in tasks
        ]
        data = bytes(serialize_message(message))
        self._publisher.publish(data)
        return data
