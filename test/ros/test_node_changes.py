# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a real node that are set while it runs, by clients that mean well or not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge import (
    RecordedLog,
    Settings,
    Source,
    decode_string,
    load_arm_robot,
    read_changes,
    read_recording,
)
import pytest
from ros_processes import Peer, Processes, call, chosen
from simulating import rows_of

pytestmark = pytest.mark.ros


class Client:
    """Calls the parameter services of `sim_arm`."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer

    def call(self, kind: str, **fields: Any) -> Any:
        from rcl_interfaces import srv

        name = ''.join(f'_{c.lower()}' if c.isupper() else c for c in kind)[1:]
        return call(self._peer, getattr(srv, kind), name, **fields)

    def set(self, *parameters: Any) -> tuple[bool, str]:
        """Set all of some parameters or none; return the success and the reason."""
        result = self.call('SetParametersAtomically', parameters=list(parameters)).result
        return result.successful, result.reason

    def get(self, name: str) -> Any:
        return self.call('GetParameters', names=[name]).values[0]

    def describe(self, name: str) -> Any:
        return self.call('DescribeParameters', names=[name]).descriptors[0]


def value_of(value: Any, kind: int | None = None) -> Any:
    """Return a parameter's value as it travels; `kind` is another type than it has."""
    from rcl_interfaces.msg import ParameterValue

    kinds = {bool: (1, 'bool_value'), int: (2, 'integer_value'), float: (3, 'double_value')}
    kinds |= {str: (4, 'string_value'), list: (8, 'double_array_value')}
    number, name = kinds[type(value)]
    return ParameterValue(**{'type': number if kind is None else kind, name: value})


def parameter(name: str, value: Any, kind: int | None = None) -> Any:
    from rcl_interfaces.msg import Parameter

    return Parameter(name=name, value=value_of(value, kind))


def recorded_changes(path: Path) -> list[dict[str, Any]]:
    """Return the changes of settings that a recording holds."""
    return [
        read_changes(decode_string(entry.data))
        for entry in RecordedLog(path).entries()
        if entry.role == 'parameters'
    ]


def test_a_node_takes_dynamic_parameters_and_refuses_all_else_with_a_reason(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'robot:=planar2', '-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    client = Client(peer)
    told = client.describe('real_time_factor')
    assert not told.read_only
    assert told.floating_point_range[0].to_value == 1000.0
    told = client.describe('integrator')
    assert told.read_only
    assert told.additional_constraints.startswith("one of ['auto', 'rk4'")
    peer.connect()

    assert client.set(parameter('real_time_factor', 0.5)) == (True, '')
    assert client.get('real_time_factor').double_value == 0.5
    reasons = {
        'read-only': [parameter('step_size', 0.002)],
        'out of range': [parameter('real_time_factor', float('nan'))],
        'expected 0 or 1e-06 and more': [parameter('real_time_factor', 1e-9)],
        'takes floating-point numbers: write 1.0': [parameter('real_time_factor', 1)],
        'value of unknown type': [parameter('real_time_factor', 1.0, kind=200)],
        'cannot be undeclared': [parameter('real_time_factor', 1.0, kind=0)],
        'Invalid access': [parameter('%s{0}\n\x01' + 'x' * 1000, 1.0)],
        'read-only parameter: robot': [
            parameter('real_time_factor', 2.0),
            parameter('robot', 'ur5'),
        ],
        'read-only parameter: gravity': [parameter('gravity', [0.0] * 100_000)],
    }
    for reason, parameters in reasons.items():
        successful, told = client.set(*parameters)
        assert not successful
        assert reason in told
    each = client.call(
        'SetParameters',
        parameters=[parameter('real_time_factor', 2.0), parameter('real_time_factor', 1.0, 77)],
    )
    assert [result.successful for result in each.results] == [False, False]
    assert client.get('real_time_factor').double_value == 0.5
    assert client.set(parameter('use_sim_time', False)) == (True, '')
    peer.let_pass()

    arm.stop()
    assert 'callback' not in arm.text()
    path = processes.folder / 'arm.mcap'
    assert recorded_changes(path) == [{'real_time_factor': 0.5}]
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert {row.source for row in rows_of(path)} == {Source.PARAMETERS}


@pytest.mark.slow
def test_a_node_takes_numbers_for_each_joint_payloads_and_wrenches(
    processes: Processes, peer_of
) -> None:
    from std_srvs.srv import Trigger

    (processes.folder / 'given.yaml').write_text(
        '/**:\n  ros__parameters:\n    robot: planar2\n    joints: [elbow, shoulder]\n'
        '    damping:\n      elbow: 0.5\n    friction.shoulder: 0.25\n    armature.elbwo: 1.0\n'
        '    payload: {mass: 0.5}\n    gravity: [0.0, 0.0, 0.0]\n    external_wrench: true\n'
    )
    arm = processes.arm(
        *('--params-file', 'given.yaml'),
        *('-p', 'damping.shoulder:=0.125', '-p', 'motor_lag.elbow:=0.001'),
        *('-p', 'recording:=arm.mcap'),
    )
    peer = peer_of(processes)
    client = Client(peer)
    for name, value in (
        ('damping.shoulder', 0.125),
        ('damping.elbow', 0.5),
        ('friction.elbow', 0.0),
        ('friction.shoulder', 0.25),
        ('motor_lag.elbow', 0.001),
        ('armature.elbow', 0.0),
        ('payload.mass', 0.5),
    ):
        assert client.get(name).double_value == value
    told = client.describe('damping.elbow')
    assert (told.read_only, told.name) == (True, 'damping.elbow')
    assert (
        "unknown parameters ignored: ['armature.elbwo']; similar names: ['armature.elbow']"
        in arm.text()
    )
    plant = Plant(peer)
    peer.connect()
    # Latched: its subscriber came late.
    peer.wait(lambda: [body.inertia.m for body in plant.payloads] == [0.5])
    peer.plain_command([0.0, 0.0])
    peer.wait(lambda: list(peer.states[-1].effort) == [0.0, 0.0])
    assert not any(peer.states[-1].velocity)
    assert client.set(parameter('bias.effort.shoulder', 0.5)) == (True, '')
    peer.wait(lambda: list(peer.states[-1].effort) == [0.0, 0.5])
    assert client.get('bias.effort.shoulder').double_value == 0.5
    plant.push('tip_link', 0.0, 20.0, 0.0)
    peer.wait(lambda: all(peer.states[-1].velocity))
    plant.push('nowhere', 0.0, 1e9, 0.0)
    answer = call(peer, Trigger, 'clear_external_wrench')
    assert answer.success
    assert answer.message.startswith('accepted: clear_wrench')
    plant.load('tip_link', 1.5)
    peer.wait(lambda: plant.payloads[-1].inertia.m == 1.5)
    assert client.set(
        parameter('payload.mass', 2.5), parameter('payload.center', [0.1, 0.0, 0.0])
    ) == (True, '')
    peer.wait(lambda: plant.payloads[-1].inertia.m == 2.5)
    assert plant.payloads[-1].inertia.com.x == 0.1
    assert plant.payloads[-1].header.frame_id == 'tip_link'
    successful, reason = client.set(parameter('payload.inertia', [1.0, 0.0, 0.0, 1.0, 0.0, 3.0]))
    assert not successful
    assert 'payload.inertia is not physically consistent' in reason
    assert client.set(parameter('gravity_compensation', True))[0]
    # A flood: the newest payload counts.
    for mass in range(100):
        plant.load('tip_link', 1.0 + mass)
    peer.wait(lambda: plant.payloads[-1].inertia.m == 100.0)
    plant.load('%s{0}\n', -1.0)
    peer.let_pass()

    arm.stop()
    assert 'callback' not in arm.text()
    assert 'unknown_names' in arm.text()
    path = processes.folder / 'arm.mcap'
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert summary.settings.joint_damping == (0.5, 0.125)
    assert summary.settings.joint_friction == (0.0, 0.25)
    assert summary.settings.joint_armature == ()
    changes = recorded_changes(path)
    assert {'payload_mass': 2.5, 'payload_center': (0.1, 0.0, 0.0)} in changes
    assert {'bias_effort': (0.0, 0.5)} in changes


class Plant:
    """Pushes the arm, loads it, and listens to its payload."""

    def __init__(self, peer: Peer) -> None:
        from geometry_msgs.msg import InertiaStamped, WrenchStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node = peer.node
        self.payloads: list[Any] = []
        self._peer, self._wrench, self._payload = peer, WrenchStamped, InertiaStamped
        self._pushes = node.create_publisher(WrenchStamped, 'sim_arm/external_wrench', 1)
        self._loads = node.create_publisher(InertiaStamped, 'sim_arm/payload', latched)
        topic = 'sim_arm/payload_in_use'
        node.create_subscription(InertiaStamped, topic, self.payloads.append, latched)

    def push(self, frame: str, x: float, y: float, z: float) -> None:
        message = self._wrench()
        message.header.frame_id = frame
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = x, y, z
        self._peer.wait(self._pushes.get_subscription_count)
        self._pushes.publish(message)

    def load(self, frame: str, mass: float) -> None:
        message = self._payload()
        message.header.frame_id = frame
        message.inertia.m = mass
        self._peer.wait(self._loads.get_subscription_count)
        self._loads.publish(message)


def test_a_node_that_is_configured_again_shows_the_defaults_of_the_new_arm(
    processes: Processes,
) -> None:
    from bridge import declare_joints, declare_parameters
    import rclpy

    given = ('autostart:=false', 'bias.effort.elbow:=0.5', 'friction.joint2:=0.25')
    context = rclpy.Context()
    rclpy.init(
        context=context,
        args=['--ros-args', *(part for name in given for part in ('-p', name))],
        domain_id=processes.domain,
    )
    node = rclpy.create_node('again', context=context, start_parameter_services=False)
    try:
        assert not declare_parameters(node)
        two = declare_joints(node, *arm_of(node, robot='planar2'))
        assert two.bias_effort == (0.0, 0.5)
        assert two.joint_friction == ()
        node.set_parameters([chosen('robot', 'puma560'), chosen('friction', True)])
        settings, robot = arm_of(node)
        six = declare_joints(node, settings, robot)
        assert six.bias_effort == ()
        expected = robot.friction.copy()
        expected[1] = 0.25
        assert six.joint_friction == tuple(expected.tolist())
        assert not node.has_parameter('bias.effort.elbow')
        assert node.get_parameter('friction.joint1').value == robot.friction[0]
    finally:
        node.destroy_node()
        context.try_shutdown()


def arm_of(node: Any, **values: str) -> tuple[Settings, Any]:
    """Return the settings and the robot that the parameters of a node say, after new values."""
    from bridge import read_parameters

    node.set_parameters([chosen(name, value) for name, value in values.items()])
    settings = read_parameters(node)
    return settings, load_arm_robot(settings)
