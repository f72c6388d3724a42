# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real processes and a peer to talk to them, on a ROS domain of each test's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
import ctypes
from dataclasses import dataclass
from importlib import import_module
import importlib.util
import inspect
import itertools
import multiprocessing
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from faulty import put
import pytest

import pfd_core as pfd
from pfd_ros.testing.domains import LOOPBACK as DDS_LOOPBACK
from pfd_ros.testing.domains import environment as domain_environment
from pfd_ros.testing.domains import own_domain
from pfd_ros.testing.process import ChildProcess

ROOT = Path(__file__).resolve().parents[2]
# Of the package under test; an installation has byte code, which a checkout may not have.
PACKAGES = Path(pfd.__file__).parents[1]
MILLISECOND = 1_000_000
HAS_ROS = importlib.util.find_spec('rclpy') is not None
NODE = ('-m', 'pfd_ros.node.main')
JOINTS = tuple(f'joint{i}' for i in range(1, 7))
FAULTY = str(Path(__file__).with_name('faulty.py'))
# Workers of one run have neighbouring process ids; each starts so many domains from the next one.
APART = 13
_numbers = itertools.count()
# Longest wait for anything a process should do [s]: discovery alone may take three seconds, and
# compiling a robot on a machine with twenty times its load some minutes. Nothing is measured
# against it.
PATIENCE = 240.0


def _late() -> str:
    threads = ', '.join(thread.name for thread in threading.enumerate())
    return f'not within {PATIENCE:g} s; threads alive: {threads}'


def wait_until(
    done: Callable[[], Any], told: Callable[[], Any] = _late, pause: float = 1e-3
) -> None:
    """Poll every `pause` s until `done` is true; fail with the text of `told` after PATIENCE."""
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline, told()
        time.sleep(pause)


def threads_named(name: str) -> list[threading.Thread]:
    """Return the threads of this process with a name."""
    return [thread for thread in threading.enumerate() if thread.name == name]


def example_robot(path: str) -> Path:
    """Return a robot of the package example-robot-data, installed next to Pinocchio."""
    pinocchio = importlib.util.find_spec('pinocchio')
    assert pinocchio is not None
    assert pinocchio.origin is not None
    prefix = Path(pinocchio.origin).parents[4]
    return prefix / 'share' / 'example-robot-data' / 'robots' / path


def in_namespaces(*kinds: str) -> list[str]:
    """Return the command that runs another in Linux namespaces; skip the test where none may.

    Root may create them; other users may in a user namespace, unless the system forbids it.
    """
    for user in ((), ('--map-root-user',)):
        command = [shutil.which('unshare') or 'false', *user, *kinds]
        if subprocess.run([*command, 'true'], capture_output=True, check=False).returncode == 0:
            return command
    pytest.skip(f'this system lets no process of this user have namespaces ({", ".join(kinds)})')


def stamp_ns(message: Any) -> int:
    """Return the simulated time of a JointState or Clock."""
    stamp = getattr(message, 'clock', None) or message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def environment(domain: int) -> dict[str, str]:
    path = [os.environ.get('PYTHONPATH', ''), str(PACKAGES)]
    return domain_environment(os.environ, domain) | {
        'ROS_PYTHON_CHECK_FIELDS': '1',
        'PYTHONPATH': os.pathsep.join(part for part in path if part),
    }


def with_flags(*words: str) -> list[str]:
    """Return arguments for ROS, with -p before each parameter that follows no flag."""
    found: list[str] = []
    for word in words:
        if ':=' in word and found[-1:] not in (['-p'], ['-r']):
            found.append('-p')
        found.append(word)
    return found


class Process:
    """A process of ours and its output.

    Parameters
    ----------
    process
        Of subprocess, or a ForkedProcess.
    output
        The file with its stdout and stderr.
    """

    def __init__(self, process: Any, output: Path) -> None:
        self.process, self.output = process, output

    def text(self) -> str:
        """Return its stdout and stderr so far."""
        return self.output.read_text(encoding='utf-8', errors='replace')

    def wait_for_text(self, wanted: str) -> None:
        def came() -> bool:
            found = wanted in self.text()
            assert found or self.process.poll() is None, self.text()
            return found

        wait_until(came, self.text, pause=0.02)

    def stop(self) -> None:
        """End the process as Ctrl-C does; its status must be 0."""
        status = self.end(signal.SIGINT)
        assert status == 0, f'status {status}; {self.text()}'

    def end(self, *signals: signal.Signals) -> int:
        """Send signals and return the exit status."""
        for number in signals:
            self.process.send_signal(number)
            time.sleep(0.005)
        return self.process.wait(PATIENCE)


class Processes:
    """Starts processes and leaves none behind."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._claim = ExitStack()
        # None that another worker or run of tests has, nor that the tests just before had.
        start = APART * os.getpid() + next(_numbers)
        self.domain = self._claim.enter_context(own_domain(start=start))
        self.started: list[Process] = []

    def python(self, *command: str) -> Process:
        """Start an interpreter."""
        output, env = self._output(), environment(self.domain)
        child = ChildProcess([sys.executable, *command], output, env, self.folder)
        self.started.append(Process(child.process, output))
        return self.started[-1]

    def forked(
        self, module: str, *args: str, replaced: Mapping[str, Any] | None = None
    ) -> Process:
        """Start `main` of a module, in a process that need not import it: see ForkedProcess."""
        output, env = self._output(), environment(self.domain)
        output.touch()
        child = ForkedProcess(Job(module, args, output, env, self.folder, replaced or {}))
        self.started.append(Process(child, output))
        return self.started[-1]

    def _output(self) -> Path:
        return self.folder / f'output_{time.monotonic_ns()}.txt'

    def arm(self, *ros_args: str, ready: bool = True) -> Process:
        """Start a node, by parameters name:=value and other arguments for ROS; with `ready`,
        return once it steps.
        """
        return self._node('pfd_ros.node.main', (), ros_args, ready)

    def faulty(self, fault: str, *ros_args: str, ready: bool = True) -> Process:
        """Start a node with a fault in it; see faulty.py."""
        return self._node('faulty', (fault,), ros_args, ready)

    def _node(
        self, module: str, args: Sequence[str], ros_args: Sequence[str], ready: bool
    ) -> Process:
        # States tell the efforts that were sent, however fast a free joint turns by then.
        words = with_flags('torque_speed:=false', *ros_args)
        process = self.forked(module, *args, '--ros-args', *words)
        if ready:
            process.wait_for_text('until its first command')
        return process

    def close(self) -> None:
        for started in self.started:
            if started.process.poll() is None:
                started.process.kill()
                started.process.wait(PATIENCE)
        self._claim.close()


def qos(durability: str = 'transient_local', depth: int = 1) -> Any:
    """Return a reliable quality of service."""
    from rclpy.qos import DurabilityPolicy, QoSProfile

    return QoSProfile(depth=depth, durability=DurabilityPolicy[durability.upper()])


class Peer:
    """Another node of the system, in this process."""

    def __init__(self, domain: int, namespace: str = '') -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.parameter import Parameter
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        os.environ |= DDS_LOOPBACK
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        # Without services: each is two endpoints to discover, and to take down again.
        without = Parameter('start_type_description_service', value=False)
        self.node = rclpy.create_node(
            'peer',
            context=self.context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[without],
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states: list[Any] = []
        self.clocks: list[Any] = []
        self._senders: dict[str, Any] = {}
        self.node.create_subscription(JointState, 'joint_states', self._on_state, 10)
        self.node.create_subscription(Clock, '/clock', self._on_clock, 10)
        self.named = self.node.create_publisher(JointState, 'joint_commands', 10)
        self.plain = self.node.create_publisher(Float64MultiArray, 'sim_arm/commands', 10)

    def _on_state(self, message: Any) -> None:
        self.states.append(message)

    def _on_clock(self, message: Any) -> None:
        self.clocks.append(message)

    def wait(self, done: Callable[[], Any]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < deadline, f'timed out after {len(self.states)} states'
            self.executor.spin_once(timeout_sec=0.05)

    def connect(self) -> None:
        """Wait until both directions work."""
        self.wait(
            lambda: (
                self.states
                and self.named.get_subscription_count()
                and self.plain.get_subscription_count()
            )
        )

    def let_pass(self, count: int = 30) -> None:
        """Wait for some states more: what was sent has been taken by then, or never came."""
        target = len(self.states) + count
        self.wait(lambda: len(self.states) >= target)

    def command(self, names: Sequence[str], effort: Sequence[float], **other: Any) -> None:
        from sensor_msgs.msg import JointState

        message = JointState(name=list(names), effort=list(effort))
        for field, value in other.items():
            if field == 'stamp':
                message.header.stamp.sec = value
            else:
                setattr(message, field, value)
        self.named.publish(message)

    def plain_command(self, effort: Sequence[float]) -> None:
        from std_msgs.msg import Float64MultiArray

        self.plain.publish(Float64MultiArray(data=list(effort)))

    def send(self, topic: str, message: Any, durability: str = 'volatile') -> None:
        """Publish a message once it has a subscriber."""
        if topic not in self._senders:
            offer = qos(durability)
            self._senders[topic] = self.node.create_publisher(type(message), topic, offer)
        self.wait(self._senders[topic].get_subscription_count)
        self._senders[topic].publish(message)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def call(peer: Peer, kind: Any, name: str, **values: Any) -> Any:
    """Call a service of the node `sim_arm`, or by its full name, and return its response."""
    client = peer.node.create_client(kind, name if name[0] == '/' else f'/sim_arm/{name}')
    peer.wait(client.service_is_ready)
    future = client.call_async(kind.Request(**values))
    peer.wait(future.done)
    peer.node.destroy_client(client)
    return future.result()


def parameter(name: str, value: Any, kind: int | None = None) -> Any:
    """Return a parameter as it travels; `kind` is another type than its value has."""
    from rcl_interfaces.msg import Parameter, ParameterValue

    kinds = {bool: (1, 'bool_value'), int: (2, 'integer_value'), float: (3, 'double_value')}
    kinds |= {str: (4, 'string_value'), list: (8, 'double_array_value')}
    number, field = kinds[type(value)]
    found = ParameterValue(**{'type': number if kind is None else kind, field: value})
    return Parameter(name=name, value=found)


def set_parameters(peer: Peer, *parameters: Any) -> tuple[bool, str]:
    """Set all of some parameters of the node or none; return the success and the reason."""
    from rcl_interfaces.srv import SetParametersAtomically

    name = 'set_parameters_atomically'
    result = call(peer, SetParametersAtomically, name, parameters=list(parameters)).result
    return result.successful, result.reason


def trigger(peer: Peer, name: str) -> Any:
    """Call a service of the node without arguments."""
    from std_srvs.srv import Trigger

    return call(peer, Trigger, name)


def transition(peer: Peer, label: str = '', number: int = 0) -> bool:
    """Request a transition of the node by label or number; return whether it succeeded."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    wanted = Transition(id=number, label=label)
    return bool(call(peer, ChangeState, 'change_state', transition=wanted).success)


def description_publisher(
    peer: Peer, durability: str = 'transient_local'
) -> Callable[[str], None]:
    """Return a function that publishes a description of a robot."""
    from std_msgs.msg import String

    publisher = peer.node.create_publisher(String, 'robot_description', qos(durability))
    return lambda text: publisher.publish(String(data=text))


_FORKS = multiprocessing.get_context('forkserver')
# What nodes, sessions of pytest and pages import, also at their first use of it.
_FORKS.set_forkserver_preload(
    [
        *('pfd_ros.node.process', 'pfd_ros.cli.logs', 'pfd_ros.testing.arm', 'pfd_ros.page.page'),
        *('pfd_core.simulation.motors', 'pfd_core.model.urdf', 'rosbags.typesys.stores'),
        *('sensor_msgs.msg', 'geometry_msgs.msg', 'trajectory_msgs.msg', 'hypothesis', 'pytest'),
        *('type_description_interfaces.msg', 'rosidl_generator_py.import_type_support_impl'),
        __name__,
    ]
)
PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Job:
    """What a forked process runs.

    Attributes
    ----------
    module, args
        Whose function `main` returns the exit status, and its arguments.
    output
        A file for its stdout and stderr.
    env, cwd
        As for subprocess.Popen.
    replaced
        Dotted path -> what the process has in its place: a value that can be pickled.
    """

    module: str
    args: Sequence[str]
    output: Path
    env: Mapping[str, str]
    cwd: Path
    replaced: Mapping[str, Any]


class ForkedProcess:
    """A process that runs a job, with the methods of subprocess.Popen."""

    def __init__(self, job: Job) -> None:
        self._process = _FORKS.Process(target=_run, args=(job,))
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, seconds: float = PATIENCE) -> int:
        self._process.join(seconds)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self._process.name, seconds)
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _run(job: Job) -> None:
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    os.setsid()
    os.chdir(job.cwd)
    os.environ.clear()
    os.environ.update(job.env)
    with job.output.open('ab') as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    for name, value in job.replaced.items():
        put(name, value)
    sys.exit(import_module(job.module).main(list(job.args)))


# rclpy looks for the module that logs a line; for the first line it looks at every module.
inspect.getmodule(_run.__code__.replace(co_filename='of no module'))
