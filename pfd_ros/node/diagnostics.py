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

To add a value, add it to the table of its task.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message

import pfd_core as pfd
from pfd_ros.arm.advice import FEWEST_COMMANDS, gain_limits
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ACCEPTED, BUSY, COMMANDS
from pfd_ros.arm.plant import INPUT, Plant, acceleration_kernel
from pfd_ros.arm.state import NEXT
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.node.graph import GraphCheck
from pfd_ros.node.inbox import COMPILATION
from pfd_ros.node.report import Report, speed_of
from pfd_ros.node.stepping import Stepper
from pfd_ros.text import one_line

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
# Longest text of a value; a robot may have hundreds of joints.
TEXT_LENGTH = 200


def status(
    task: str, values: Mapping[str, object], usual: object, *troubles: tuple[bytes, object, object]
) -> DiagnosticStatus:
    """Return the status of a task: its values, and the first of the troubles that there is.

    A trouble is a level, whether there is one, and a sentence; `usual` is the one without trouble.
    """
    found = ((level, text) for level, exists, text in troubles if exists)
    level, text = next(found, (OK, usual))
    pairs = [KeyValue(key=key, value=one_line(x, TEXT_LENGTH)) for key, x in values.items()]
    short = one_line(text, TEXT_LENGTH)
    return DiagnosticStatus(level=level, name=task, message=short, values=pairs)


def message(node: str, tasks: Iterable[DiagnosticStatus]) -> bytes:
    """Return the message of the tasks of a node, stamped with the time of day."""
    found = DiagnosticArray()
    stamp = found.header.stamp
    stamp.sec, stamp.nanosec = divmod(time.time_ns(), NANOSECONDS)
    for task in tasks:
        task.name, task.hardware_id = f'{node}: {task.name}', node
        found.status.append(task)
    return bytes(serialize_message(found))


def compiled_scene(plant: Plant) -> pfd.Scene:
    """Return the scene that native code is compiled for: it may take the payload as an input."""
    return replace(plant.scene, payload=INPUT) if plant.inputs else plant.scene


class MassKernels:
    """Inertia matrix, energy and error of the accelerations of an arm in one scene, compiled.

    As for the outputs, the wrench on the tip and the gravity torques of the motors are left out.
    """

    def __init__(self, engine: Engine, plant: Plant | None = None) -> None:
        plant = plant or engine.plant
        robot, scene = engine.robot, compiled_scene(plant)
        self.digest = scene.digest
        alone = replace(scene, external_wrench=False, gravity_compensation=False)
        self.inertia: Any = pfd.compile_kernel(robot, scene=alone, quantity='inertia_matrix')
        self.energy: Any = pfd.compile_kernel(robot, scene=alone, quantity='energy')
        self._accelerations = acceleration_kernel(robot, scene, engine.state.settings.method)
        # Compiled before the stepping thread starts.
        zero = np.zeros(robot.n)
        self.error_estimate(zero, zero, zero, plant.inputs)

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
        stepper, state = self._stepper, self._engine.state
        return {
            'seconds': time.monotonic(),
            'simulated': self._engine.stamp_ns / NANOSECONDS,
            'cycles': state.cycle,
            'late': stepper.late,
            'missed': stepper.missed,
            'accepted': self._report.accepted(COMMANDS),
            'rejected': self._report.rejected(),
            'fast': int(state.motors.counts[1]),
        }

    def tasks(self) -> list[DiagnosticStatus]:
        """Return the status of each task since the last call."""
        last, now = self._seen, self._counts()
        self._seen, new = now, {key: count - last[key] for key, count in now.items()}
        tasks = self._stepping, self._commands, self._simulation, self._recording
        return [task(now, new) for task in tasks]

    def _stepping(self, now: Mapping[str, float], new: Mapping[str, float]) -> DiagnosticStatus:
        state, stepper = self._engine.state, self._stepper
        values = {
            'real_time_factor': f'{new["simulated"] / new["seconds"]:.4f}',
            'requested_real_time_factor': state.settings.real_time_factor,
            'simulated_time_s': now['simulated'],
            'cycles': now['cycles'],
            'late_steps': new['late'],
            'missed_periods': new['missed'],
            'missed_periods_total': now['missed'],
            'states_sent_again': stepper.resent,
        }
        lengths = 1e-3 * stepper.newest_lengths(int(new['cycles']))
        if len(lengths):
            for share, name in ((50, 'p50'), (99, 'p99'), (100, 'max')):
                values[f'step_{name}_us'] = f'{np.percentile(lengths, share):.1f}'
        return status(
            *('stepping', values, self._engine.awaited or 'running'),
            (ERROR, state.failure, state.failure),
            (WARN, new['missed'], BUSY),
        )

    def _commands(self, now: Mapping[str, float], new: Mapping[str, float]) -> DiagnosticStatus:
        state, graph, report = self._engine.state, self._graph, self._report
        newest = max(report.newest.get(role, 0.0) for role in COMMANDS)
        causes = {
            f'{role}.{label}': count
            for (role, label), (count, _) in sorted(report.inputs().items())
            if label != ACCEPTED.label
        }
        values = {
            'accepted_per_s': f'{new["accepted"] / new["seconds"]:.1f}',
            'accepted': now['accepted'],
            'age_of_newest_s': f'{now["seconds"] - newest:.3f}' if newest else 'none',
            'endpoints_with_qos_or_type_mismatch': graph.mismatched,
            **causes,
            **{f'{role}.publishers': ' '.join(x) for role, x in graph.publishers.items() if x},
            'watchdog_trips': state.timeouts,
            'lost_commands': state.lost,
            'saturated_steps': int(state.motors.counts[0]),
            'reflex_trips': state.trips,
        }
        stop = f'protective stop, all joints braked until ~/reset: {state.tripped}'
        return status(
            *('commands', values, 'received' if now['accepted'] else 'no commands yet'),
            (ERROR, state.tripped, stop),
            (WARN, state.timed_out, 'no command for command_timeout'),
            (WARN, new['rejected'], 'messages rejected'),
            (WARN, graph.mismatched, 'QoS or type mismatch with another node'),
        )

    def _simulation(self, now: Mapping[str, float], new: Mapping[str, float]) -> DiagnosticStatus:
        engine, state = self._engine, self._engine.state
        # Once: the stepping thread may take over another one at any time.
        plant = engine.plant
        settings, payload = state.settings, plant.inputs
        q, qd, tau = state.rows[state.now].copy()
        if self._kernels.digest != compiled_scene(plant).digest:
            with COMPILATION:
                self._kernels = MassKernels(engine, plant)
        kernels = self._kernels
        kinetic, potential = kernels.energy(q, qd, **payload)
        period = settings.publish_every * settings.step_ns / NANOSECONDS
        if new['accepted'] >= FEWEST_COMMANDS:
            # A controller may answer fewer states than are published.
            period *= max(1, round(new['simulated'] / (period * new['accepted'])))
        speed = speed_of(engine)
        values = {
            'robot': settings.robot,
            'integrator': settings.integrator,
            'method': settings.method,
            'position_sums': settings.position_sums,
            'error_estimate': f'{kernels.error_estimate(q, qd, tau, payload):.2g}',
            'kinetic_energy_J': f'{kinetic:.6g}',
            'potential_energy_J': f'{potential:.6g}',
            'largest_speed_over_limit': 0.0 if speed is None else f'{speed.ratio:.4g}',
            'cycles_beyond_velocity_limits': now['fast'],
            'control_period_s': period,
        }
        if engine.wrenched:
            values |= {
                'external_wrench': _numbers(state.wrench[NEXT], '.6g'),
                'external_wrench_frame': engine.robot.tip,
                'external_wrench_timeout_s': settings.external_wrench_timeout,
            }
        # The inertia matrix may be singular, or not finite.
        with suppress(np.linalg.LinAlgError):
            # Bounds of stable gains, without delay, in one proportion for all joints.
            limits = gain_limits(kernels.inertia(q, **payload), period)
            values |= {
                'pd_limit.kp_over_kd': f'{limits.ratio:.6g}',
                'pd_limit.kd': _numbers(limits.velocity[engine.order]),
                'pd_limit.kp': _numbers(limits.position[engine.order]),
                'pd_limit.same_kd_for_all': f'{limits.equal_velocity:.4g}',
            }
        text = '' if speed is None else f'beyond the velocity limit: {speed.text}'
        return status(
            *('simulation', values, 'running'),
            (ERROR, state.failure, state.failure),
            (WARN, text and new['fast'], text),
        )

    def _recording(self, *_: object) -> DiagnosticStatus:
        recorder = self._stepper.recorder
        if recorder is None:
            return status('recording', {'open': False}, 'not requested')
        values = {
            'open': not recorder.error,
            'file': self._engine.state.settings.recording,
            'waiting_share': f'{recorder.waiting_share:.4f}',
            'recorded': sum(recorder.recorded.values()),
        }
        return status('recording', values, 'running', (ERROR, recorder.error, recorder.error))


def _numbers(values: Iterable[float], form: str = '.4g') -> str:
    return ' '.join(format(value, form) for value in values)
