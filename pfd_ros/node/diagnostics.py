# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of the node, once a second, on the main thread, from counts of other threads.

One status for each task, as REP 107 has it:

    lifecycle      the state of the node
    stepping       real-time factor, time of a step, overruns
    commands       rate, age, rejections by cause, mismatched publishers, watchdog, reflex
    simulation     joints beyond their velocity limits, integrator, method, its error, energy, the
                   largest stable gains of a PD loop
    recording      open, failed, waiting, dropped

To add a value, append a pair (name, text) in the function of its task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.commands import QUIET
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import COMMANDS, Verdict
from pfd_ros.arm.model_kernels import acceleration_kernel, model_kernels
from pfd_ros.arm.speeding import speeding
from pfd_ros.arm.stable_gains import gain_limits
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.messages.node_reports import Status, encode_diagnostics
from pfd_ros.node.graph_check import GraphCheck
from pfd_ros.node.stepping import Stepper
from pfd_ros.recording.format import ROLE_OF_SOURCE
from pfd_ros.text import one_line

OK, WARN, ERROR = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
# Longest text of a value; a robot may have hundreds of joints.
TEXT_LENGTH = 200
MICROSECONDS = 1e3  # ns


class Task(NamedTuple):
    """The status of one task: its level, a sentence, and values by name."""

    name: str
    level: bytes
    message: str
    values: Sequence[tuple[str, object]] = ()


class _Seen(NamedTuple):
    """The counts of an arm at one time, s."""

    seconds: float
    stamp_ns: int
    cycles: int
    late: int
    missed: int
    accepted: int
    rejected: int
    fast: int
    not_recorded: int


class MassKernels:
    """Inertia matrix, energy and accelerations of an arm in one scene, compiled."""

    def __init__(self, arm: Arm) -> None:
        self.scene = arm.plant.compiled.scene
        asked = replace(arm.settings, outputs=('inertia_matrix', 'energy'))
        # As on the topics of these names.
        kernels = model_kernels(asked, arm.robot, self.scene)
        self.inertia, self.energy = kernels['inertia_matrix'], kernels['energy']
        self.accelerations = acceleration_kernel(arm.robot, self.scene, arm.settings.method)
        # Compiled before the stepping thread starts.
        zero = np.zeros(arm.robot.n)
        self.error_estimate(zero, zero, zero, {})

    def error_estimate(
        self, q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any], payload: Mapping[str, Any]
    ) -> float:
        """Return the relative error of accelerations by the method in use."""
        return float(self.accelerations.error_estimate(q, qd, tau, **payload)[1])


@dataclass
class ArmDiagnostics:
    """The tasks of one arm."""

    stepper: Stepper
    graph: GraphCheck
    kernels: MassKernels

    def __post_init__(self) -> None:
        """Begin to count."""
        self._last = self._seen()

    def _seen(self) -> _Seen:
        stepper, engine = self.stepper, self.stepper.engine
        verdicts = self.stepper.receiver.counts.verdicts()
        commands = {key: count for key, (count, _) in verdicts.items() if key[0] in COMMANDS}
        accepted = sum(n for (_, verdict), n in commands.items() if verdict is Verdict.ACCEPTED)
        return _Seen(
            time.monotonic(),
            engine.arm.stamp_ns,
            engine.cycles,
            stepper.timer.late,
            stepper.timer.missed,
            accepted,
            sum(n for (_, verdict), (n, _) in verdicts.items() if verdict not in QUIET),
            engine.state.actuators.fast_cycles,
            stepper.session.dropped,
        )

    def tasks(self) -> list[Task]:
        """Return the status of each task since the last call."""
        last, now = self._last, self._seen()
        self._last = now
        return [
            self._stepping(last, now),
            self._commands(last, now),
            self._simulation(last, now),
            self._recording(last, now),
        ]

    def _stepping(self, last: _Seen, now: _Seen) -> Task:
        engine = self.stepper.engine
        factor = (now.stamp_ns - last.stamp_ns) / NANOSECONDS / (now.seconds - last.seconds)
        values: list[tuple[str, object]] = [
            ('real_time_factor', f'{factor:.4f}'),
            ('requested_real_time_factor', engine.settings.real_time_factor),
            ('simulated_time_s', now.stamp_ns / NANOSECONDS),
            ('cycles', now.cycles),
        ]
        lengths = self.stepper.lengths.newest(last.cycles, now.cycles)
        if len(lengths):
            half, most, longest = np.percentile(lengths, (50, 99, 100)) / MICROSECONDS
            values += [
                ('step_p50_us', f'{half:.1f}'),
                ('step_p99_us', f'{most:.1f}'),
                ('step_max_us', f'{longest:.1f}'),
            ]
        values += [
            ('late_steps', now.late - last.late),
            ('missed_periods', now.missed - last.missed),
            ('missed_periods_total', now.missed),
            ('states_sent_again', self.stepper.resent),
        ]
        if engine.arm.failure:
            return Task('stepping', ERROR, engine.arm.failure, values)
        if now.missed > last.missed:
            return Task(
                'stepping', WARN, 'periods missed (busy machine or blocked subscriber)', values
            )
        if engine.waiting:
            return Task('stepping', OK, _reason_to_wait(engine), values)
        return Task('stepping', OK, 'running', values)

    def _commands(self, last: _Seen, now: _Seen) -> Task:
        seconds = now.seconds - last.seconds
        counts = self.stepper.receiver.counts
        age = f'{now.seconds - counts.newest:.3f}' if now.accepted else 'none'
        mismatched = self.graph.mismatched
        values: list[tuple[str, object]] = [
            ('accepted_per_s', f'{(now.accepted - last.accepted) / seconds:.1f}'),
            ('accepted', now.accepted),
            ('age_of_newest_s', age),
            ('endpoints_with_qos_or_type_mismatch', mismatched),
        ]
        for (source, verdict), (count, _) in sorted(counts.verdicts().items()):
            if verdict is not Verdict.ACCEPTED:
                values.append((f'{ROLE_OF_SOURCE[source]}.{verdict.label}', count))
        state = self.stepper.engine.state
        link, actuators = state.link, state.actuators
        values += [
            ('unknown_names', counts.unknown()[0]),
            ('watchdog_trips', link.timeouts),
            ('lost_commands', link.lost),
            ('saturated_steps', actuators.saturated),
            ('reflex_trips', actuators.trips),
        ]
        if actuators.tripped:
            text = f'protective stop, all joints braked until ~/reset: {actuators.reflex}'
            return Task('commands', ERROR, text, values)
        if link.timed_out:
            return Task('commands', WARN, 'no command for command_timeout', values)
        if now.rejected > last.rejected:
            return Task('commands', WARN, 'messages rejected', values)
        if mismatched:
            return Task('commands', WARN, 'QoS or type mismatch with another node', values)
        return Task('commands', OK, 'received' if now.accepted else 'no commands yet', values)

    def _simulation(self, last: _Seen, now: _Seen) -> Task:
        engine = self.stepper.engine
        settings, arm = engine.settings, engine.arm
        q, qd, tau = arm.q.copy(), arm.qd.copy(), arm.tau.copy()
        plant = arm.plant
        if self.kernels.scene is not plant.compiled.scene:
            # The scene has changed.
            self.kernels = MassKernels(arm)
        payload = plant.payload_input
        kinetic, potential = self.kernels.energy(q, qd, **payload)
        # A controller acts on each published state.
        period = settings.publish_every * settings.step_ns / NANOSECONDS
        level, message = (ERROR, arm.failure) if arm.failure else (OK, 'running')
        speed = speeding(arm)
        if speed is not None and now.fast > last.fast and not arm.failure:
            level, message = WARN, f'beyond the velocity limit: {speed.text}'
        return Task(
            'simulation',
            level,
            message,
            [
                ('robot', settings.robot),
                ('integrator', settings.integrator),
                ('method', settings.method),
                ('position_sums', settings.position_sums),
                ('error_estimate', f'{self.kernels.error_estimate(q, qd, tau, payload):.2g}'),
                ('kinetic_energy_J', f'{kinetic:.6g}'),
                ('potential_energy_J', f'{potential:.6g}'),
                ('largest_speed_over_limit', 0.0 if speed is None else f'{speed.ratio:.4g}'),
                ('cycles_beyond_velocity_limits', now.fast),
                ('control_period_s', period),
                *_external_wrench(engine),
                *_largest_gains(self.kernels.inertia(q, **payload), period, list(arm.order)),
            ],
        )

    def _recording(self, last: _Seen, now: _Seen) -> Task:
        session = self.stepper.session
        recorder = session.recorder
        if recorder is None:
            return Task('recording', OK, 'not requested', [('open', False)])
        values: list[tuple[str, object]] = [
            ('open', not recorder.failed),
            ('file', str(recorder.path)),
            ('waiting_share', f'{recorder.waiting_share:.4f}'),
            ('recorded', sum(recorder.recorded)),
            ('dropped', sum(recorder.dropped)),
            ('failed', recorder.failed),
        ]
        if recorder.failed:
            return Task('recording', ERROR, recorder.error, values)
        if now.not_recorded > last.not_recorded:
            return Task('recording', WARN, 'the disk is too slow', values)
        return Task('recording', OK, 'running', values)


def _reason_to_wait(engine: Engine) -> str:
    pace = engine.state.pace
    if not pace.active:
        return 'inactive'
    if engine.pace.follows_clock and not pace.paused:
        return 'waiting for the followed /clock'
    return 'paused' if pace.paused else 'waiting for a command (lockstep)'


def _external_wrench(engine: Engine) -> list[tuple[str, object]]:
    """Return the wrench on the tip link from the next step on, for an arm that takes one."""
    wrench = engine.state.wrench
    if wrench is None:
        return []
    return [
        ('external_wrench', ' '.join(f'{value:.6g}' for value in wrench.next.tolist())),
        ('external_wrench_frame', engine.arm.robot.tip),
        ('external_wrench_timeout_s', engine.settings.external_wrench_timeout),
    ]


def _largest_gains(
    inertia: NDArray[Any], period: float, order: Sequence[int]
) -> list[tuple[str, object]]:
    """Return bounds of stable gains, without delay, in one proportion for all joints."""
    try:
        limits = gain_limits(inertia, period)
    except np.linalg.LinAlgError:
        # The inertia matrix is not finite or singular.
        return []
    return [
        ('pd_limit.kp_over_kd', f'{limits.ratio:.6g}'),
        ('pd_limit.kd', _numbers(limits.velocity[order])),
        ('pd_limit.kp', _numbers(limits.position[order])),
        ('pd_limit.same_kd_for_all', f'{limits.equal_velocity:.4g}'),
    ]


def _numbers(values: Iterable[float]) -> str:
    return ' '.join(f'{value:.4g}' for value in values)


class DiagnosticsPublisher:
    """Publishes tasks on `/diagnostics`, stamped with the time of day."""

    def __init__(self, node: Node) -> None:
        self._name = node.get_fully_qualified_name().lstrip('/')
        self._publisher = node.create_publisher(
            DiagnosticArray,
            '/diagnostics',
            QoSProfile(depth=1),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def publish(self, tasks: Iterable[Task], record: Callable[[bytes], None]) -> None:
        """Record and publish the status of each task."""
        statuses = [
            Status(
                level=task.level[0],
                name=f'{self._name}: {task.name}',
                message=one_line(task.message, TEXT_LENGTH),
                hardware_id=self._name,
                values=[(key, one_line(value, TEXT_LENGTH)) for key, value in task.values],
            )
            for task in tasks
        ]
        data = encode_diagnostics(time.time_ns(), statuses)
        record(data)
        self._publisher.publish(data)
