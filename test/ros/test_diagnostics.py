# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of a real node, and the lengths of steps that they are made from."""

from __future__ import annotations

from types import SimpleNamespace

from bridge import (
    CommandCounts,
    Engine,
    EventQueue,
    Receiver,
    Settings,
    Source,
    StepLengths,
    Validation,
    Verdict,
    load_arm_robot,
)
import numpy as np
import pytest
from ros_processes import JOINTS, Processes

# Relative error of accelerations of an ordinary arm in float64, far above its rounding.
ROUNDING = 1e-13


def test_lengths_of_steps_are_those_since_the_last_look_and_the_newest_at_most() -> None:
    lengths = StepLengths()
    for cycle in range(1, 11):
        lengths.add(cycle, 100 * cycle)
    assert lengths.newest(0, 10).tolist() == [100 * cycle for cycle in range(1, 11)]
    assert lengths.newest(7, 10).tolist() == [800, 900, 1000]
    assert lengths.newest(10, 10).tolist() == []
    for cycle in range(11, 3 * StepLengths.COUNT):
        lengths.add(cycle, cycle)
    newest = lengths.newest(5, 3 * StepLengths.COUNT - 1)
    assert newest.tolist() == list(range(2 * StepLengths.COUNT, 3 * StepLengths.COUNT))


@pytest.mark.ros
def test_the_reported_energy_excludes_gravity_compensation() -> None:
    from bridge import MassKernels

    told = []
    for compensated in (False, True):
        settings = Settings(
            robot='planar2',
            gravity_compensation=compensated,
            joint_friction=(0.1, 0.1),
            joint_limits=True,
            restitution=0.5,
            motor_lag=(0.01, 0.01),
            external_wrench=True,
        )
        kernels = MassKernels(Engine(settings, load_arm_robot(settings)).arm)
        told.append(kernels.energy(np.array([0.3, -0.2]), np.ones(2)).tolist())
        assert 0.0 <= kernels.error_estimate(*np.ones((3, 2)), {}) < ROUNDING
    assert told[0] == told[1]
    assert all(told[0])


@pytest.mark.ros
def test_messages_that_are_rejected_are_a_warning_and_no_others() -> None:
    from bridge import (
        DIAGNOSTICS_OK,
        DIAGNOSTICS_WARN,
        ArmDiagnostics,
        LogSession,
        MassKernels,
        Stepper,
    )

    settings, counts = Settings(robot='planar2'), CommandCounts()
    engine, session = Engine(settings, load_arm_robot(settings)), LogSession()
    receiver = Receiver(EventQueue(), session.record, counts)
    stepper = Stepper(engine, receiver, session, {})
    diagnostics = ArmDiagnostics(stepper, SimpleNamespace(mismatched=0), MassKernels(engine.arm))

    def level(source: Source, verdict: Verdict) -> bytes:
        counts.add(source, Validation(verdict, ''))
        (task,) = (task for task in diagnostics.tasks() if task.name == 'commands')
        return task.level

    for source in Source:
        assert level(source, Verdict.ACCEPTED) == DIAGNOSTICS_OK
        assert level(source, Verdict.MALFORMED) == DIAGNOSTICS_WARN
    # A driver sends it until a controller has claimed the joint.
    assert level(Source.NAMED, Verdict.ALL_NAN) == DIAGNOSTICS_OK


@pytest.mark.ros
@pytest.mark.slow
def test_diagnostics_report_each_task_of_the_node(processes: Processes, peer_of) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import String

    # At depth 1 a busy machine would see some commands replaced by newer ones.
    depth = 'qos_overrides./joint_commands.subscription.depth:=10'
    settings = ('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.5', '-p', depth)
    arm = processes.faulty('reports_often', *settings)
    peer = peer_of(processes)
    came: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, '/diagnostics', came.append, 10)
    peer.connect()

    def of(task: str) -> tuple[bytes, str, dict[str, str]]:
        (status,) = (one for one in came[-1].status if one.name == f'sim_arm: {task}')
        assert status.hardware_id == 'sim_arm'
        return status.level, status.message, {pair.key: pair.value for pair in status.values}

    def told(task: str, key: str) -> str:
        return of(task)[2].get(key, '') if came else ''

    peer.wait(lambda: len(came) > 1)
    level, message, values = of('lifecycle')
    assert (level, message) == (b'\x00', 'active')
    _, _, values = of('simulation')
    assert (values['robot'], values['integrator']) == ('puma560', 'rk4')
    # At rest, at 1 kHz: kp/kd below 2/T.
    assert float(values['kinetic_energy_J']) == 0.0
    assert 0.0 <= float(values['error_estimate']) < ROUNDING
    assert values['pd_limit.kp_over_kd'] == '2000'
    limits = np.array(values['pd_limit.kd'].split(), float)
    assert limits.shape == (6,)
    assert (limits > 0).all()
    _, message, values = of('stepping')
    assert float(values['step_p50_us']) <= float(values['step_p99_us'])
    assert float(values['requested_real_time_factor']) == 0.5
    assert 0.0 < float(values['real_time_factor']) < 1.0
    _, message, values = of('recording')
    assert (values['open'], values['failed'], values['dropped']) == ('True', 'False', '0')

    # A foreign type, a wrong message, a name that is longer than any line.
    foreign = peer.node.create_publisher(String, '/sim_arm/set_state', 1)
    peer.wait(lambda: told('commands', 'endpoints_with_qos_or_type_mismatch') == '1')
    assert of('commands')[0] == b'\x01'
    peer.node.destroy_publisher(foreign)
    peer.wait(lambda: told('commands', 'endpoints_with_qos_or_type_mismatch') == '0')
    peer.command(JOINTS, [1.0] * 5)
    peer.command(['x' * 100_000, '\n%s{0}'], [1.0, 1.0])
    peer.wait(lambda: told('commands', 'joint_commands.ragged') == '1')
    peer.wait(lambda: told('commands', 'joint_commands.unknown_names') == '1')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: told('commands', 'accepted') == '1')
    assert 0.0 <= float(told('commands', 'age_of_newest_s')) < 1000.0
    peer.wait(lambda: float(told('simulation', 'kinetic_energy_J')) > 0.0)
    for status in came[-1].status:
        for text in (status.message, *(pair.value for pair in status.values)):
            assert len(text) < 250
            assert text.isprintable()
    arm.stop()
