# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The link to ROS nodes under test, in this process and in others, with timers or without.

Each message of the arm is followed by a barrier: the next one is published only when every node
has finished what follows from it. Nodes of this process are run until nothing is ready. A node
elsewhere, a peer, says so itself: an executor of one thread serves the parameter services of its
node after its subscriptions and timers, so a reply is a barrier. Nothing is installed in a node.

This rests on a property of the middleware: what one participant sends to another arrives in the
order in which it was sent, over all topics. Fast DDS has it, with one port a participant; DDS does
not promise it. `notes` reports what is seen of nodes that are not repeatable.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from inspect import iscoroutinefunction
import math
from time import perf_counter, time_ns
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter as NodeParameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.utilities import get_default_context, get_rmw_implementation_identifier, ok

from pfd_ros.arm.description import DescribedRobot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import (
    ARRAY,
    CLOCK,
    DESCRIPTION,
    NAMED,
    PAYLOAD_IN_USE,
    ROLES,
    STATES,
    TIP_WRENCH,
    Message,
    Verdict,
)
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.matching import OVERRIDABLE, mismatch
from pfd_ros.messages.text_and_arrays import encode_string
from pfd_ros.messages.topics import UNKNOWN_NODE, message_class, node_of, topic_of
from pfd_ros.motion.metrics import Array
from pfd_ros.testing.loop import Command, ControllerError, NoAnswerError, RejectedError, blocked
from pfd_ros.testing.patience import BlockedError, Watch
from pfd_ros.testing.process import ControllerProcess
from pfd_ros.text import listed, one_line

COMMANDS = (NAMED, ARRAY)
# Numbers of requests in a barrier after a state and after a tick. An executor may take the first
# one before it has seen the message. It serves the second one after the callback of the message,
# and the third one after the timers that the callback of the clock made due. A state and its tick
# have a barrier each: else a callback of the state would read the clock of either, by chance.
AFTER_STATE, AFTER_TICK = 2, 3
# The graph has to stay the same for so long before the first state, s; a first request without
# reply is repeated after AGAIN; a wait is at most LOOK long, and the graph is read as often.
QUIET_SECONDS, AGAIN_SECONDS, LOOK_SECONDS = 0.2, 0.5, 0.05
STATE_DEPTH, COMMAND_DEPTH = 10, 100
THREADS = 'several threads or a timer on wall time'
LATE = f'a command came after its node had said that it was done: it has {THREADS}'
BOTH = f'commands follow states as well as ticks: if that is not meant, there are {THREADS}'
# Middlewares in which publish() delivers to readers of the same process before it returns. With
# others, nodes of this process are peers.
DELIVER_AT_ONCE = ('rmw_fastrtps', 'rmw_cyclonedds')


class _Peer:
    """A node that this process does not run: its parameter services and what they said."""

    def __init__(self, node: Node, name: str) -> None:
        # Whether its clock may have a thread of its own, as the clock of rclcpp has.
        self.name, self.threaded = name, False
        self.sim_time: bool | None = None  # use_sim_time, None before the first reply
        # Its clock when last read, and whether it is being read.
        self.stamp_ns, self.reads, self.asked = 0, False, 0.0
        self.pending: list[Future] = []
        self._get = node.create_client(GetParameters, f'{name}/get_parameters')
        self._set = node.create_client(SetParameters, f'{name}/set_parameters')

    def greet(self, now: float) -> None:
        """Ask for use_sim_time until there is a reply; this has no effect on the node."""
        if self.pending and self.pending[0].done():
            values = self.pending[0].result().values
            self.sim_time = bool(values and values[0].bool_value)
        elif now - self.asked > AGAIN_SECONDS and self._get.service_is_ready():
            self.asked = now
            self.pending = [self._get.call_async(GetParameters.Request(names=['use_sim_time']))]

    def ask(self, count: int, role: str) -> None:
        """Send so many requests of a barrier, or one that reads the clock first."""
        self.reads = role == CLOCK and self.threaded
        if self.reads:
            # The event of this change, which changes nothing, is stamped with the node's time.
            value = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
            same = SetParameters.Request(parameters=[Parameter(name='use_sim_time', value=value)])
            self.pending = [self._set.call_async(same)]
        else:
            self.pending = [self._get.call_async(GetParameters.Request()) for _ in range(count)]

    def awaited(self, stamp_ns: int) -> Future | None:
        """Return a reply to wait for, None if the barrier is complete; send what else it needs."""
        for future in self.pending:
            if not future.done():
                return future
        if self.reads and self.stamp_ns == stamp_ns:
            # Taken in a later wait than the change, after the timers that the time made due.
            self.ask(1, STATES)
        elif self.reads:
            self.ask(1, CLOCK)
        else:
            return None
        return self.pending[0]


class _WithoutTimers:
    """A node without its timers, which the executor would run in no defined order."""

    timers = ()

    def __init__(self, node: Node, events: Any) -> None:
        self._node, self._events, self.executor = node, events, None
        self._awaiting: dict[Any, _AsTask] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)

    @property
    def subscriptions(self) -> list[Any]:
        return [
            self._awaiting.setdefault(one, _AsTask(one, self._events))
            if iscoroutinefunction(one.callback)
            else one
            for one in self._node.subscriptions
        ]


class _AsTask:
    """A subscription whose callback is a coroutine, which the executor does not await itself."""

    def __init__(self, subscription: Any, events: Any) -> None:
        self._subscription, run = subscription, subscription.callback
        self.callback = lambda *message: events.create_task(run, *message)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._subscription, name)


class _Executor:
    """The executor as a node of the test sees it: it runs all but the timers."""

    def __init__(self, events: Any) -> None:
        self._events = events

    def __getattr__(self, name: str) -> Any:
        return getattr(self._events, name)

    def add_node(self, node: Node) -> None:
        self._events.add_node(_WithoutTimers(node, self._events))

    def remove_node(self, node: Node) -> None:
        """Leave the node in: the executor ends with the link."""


def _mismatches(
    node: Node, topics: Mapping[str, tuple[Any, str]], made: Mapping[str, Any]
) -> Iterator[str]:
    """Yield why ends of other nodes are not connected to those of the arm, made or to be made."""
    for role, (_, topic) in topics.items():
        name, wanted = node.resolve_topic_name(topic), ROLES[role].type
        own = made[role].qos_profile if role in made else _offered(role)
        for publishes, found in (
            (True, node.get_publishers_info_by_topic(name)),
            (False, node.get_subscriptions_info_by_topic(name)),
        ):
            for info in found:
                if publishes == (role in COMMANDS) or info.topic_type != wanted:
                    text = mismatch(info, name, wanted, own, publishes=publishes)
                    if text:
                        yield text


def _offered(role: str) -> QoSProfile:
    """Return the QoS of the arm's publisher of a role."""
    latched = ROLES[role].latched
    return QoSProfile(
        depth=1 if latched or role == CLOCK else STATE_DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class NodeLink:
    """The topics of the arm, and the nodes at their other ends: here, as processes, elsewhere."""

    silent = False

    def __init__(
        self,
        described: DescribedRobot,
        engine: Engine,
        ros_args: Sequence[str],
        controllers: Sequence[Any],
    ) -> None:
        if not ok():
            raise RuntimeError(
                'rclpy is not initialised: let the test take the fixture ros_domain'
            )
        self._processes = [one for one in controllers if isinstance(one, ControllerProcess)]
        self._nodes = [one for one in controllers if not isinstance(one, ControllerProcess)]
        for node in self._nodes:
            if not isinstance(node, Node):
                raise TypeError(
                    f'spin got {one_line(repr(node), 100)}, expected nodes of rclpy or processes '
                    'of controller_process; run(controller, seconds) takes a function'
                )
            if node.executor is not None and node in node.executor.get_nodes():
                raise ControllerError(f'node {node.get_name()!r} is in an executor already')
        settings, self._engine = engine.state.settings, engine
        self._tick_ns = settings.clock_every * settings.step_ns
        # No services, log topic and event handlers: each makes every wait longer.
        self._node = Node(
            'sim_arm',
            cli_args=['--ros-args', *ros_args],
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[NodeParameter('start_type_description_service', value=False)],
        )
        try:
            self._make_ends(described, engine)
        except BaseException as error:
            # Within a process the middleware refuses a second type on a topic.
            refused = isinstance(error, rclpy_implementation.RCLError)
            found = list(_mismatches(self._node, self._topics, {})) if refused else []
            self._node.destroy_node()
            if found:
                raise ControllerError('; '.join(found)) from None
            raise
        # rclpy.experimental.EventsExecutor also enables faulthandler, which fails where pytest has
        # replaced stderr.
        self._events = rclpy_implementation.EventsExecutor(get_default_context())
        self._events.add_node(self._node)
        self._executor = _Executor(self._events)  # nodes have weak references to it
        for node in self._nodes:
            node.executor = self._executor
        self._peers: dict[str, _Peer] = {}
        self._timers: list[Any] = []
        # Commands that came: role, bytes, time of publication [ns].
        self._came: list[tuple[str, bytes, int]] = []
        self._after: set[str] = set()  # roles of the messages that commands followed
        self._time, self._commanded_ns, self._looked = 0.0, math.nan, 0.0
        self._answers, self._watch = 0, Watch(math.inf)
        self.seconds, self.notes, self._noted = math.nan, list[str](), set[str]()

    def _make_ends(self, described: DescribedRobot, engine: Engine) -> None:
        """Make publishers and readers of commands, before the clients of peers.

        Discovery keeps the order, so a peer that replies knows these ends.
        """
        settings = engine.state.settings
        topics = dict(described.topics)
        if settings.command_topic:
            topics[ARRAY] = settings.command_topic
        wrench = {TIP_WRENCH} if engine.plant.scene.external_wrench else set()
        roles = {STATES, PAYLOAD_IN_USE, *settings.outputs, *wrench}
        roles |= {CLOCK} if settings.publish_clock else set()
        roles |= {DESCRIPTION} if settings.publish_description else set()
        writes = PublisherEventCallbacks(use_default_callbacks=False)
        reads = SubscriptionEventCallbacks(use_default_callbacks=False)
        # Reliable, as that of the node: it has the same overrides.
        served = QoSProfile(depth=COMMAND_DEPTH)
        self._topics = {
            role: (message_class(row.type), topic_of(self._node, row.topic, topics.get(role, '')))
            for role, row in ROLES.items()
            if role in roles or role in COMMANDS
        }
        self._publishers = {
            role: self._node.create_publisher(
                *self._topics[role], _offered(role), event_callbacks=writes
            )
            for role in ROLES
            if role in roles
        }
        self._commands = {
            role: self._node.create_subscription(
                *self._topics[role],
                partial(self._on_command, role),
                served,
                raw=True,
                event_callbacks=reads,
                qos_overriding_options=OVERRIDABLE,
            )
            for role in COMMANDS
        }
        for end in self._commands.values():
            # The executor passes the message with its information as one argument.
            end._callback_type = end.CallbackType.WithMessageInfo
        # rclpy has no public access to what arguments and files give.
        given = getattr(self._node, '_parameter_overrides', {})
        unused = sorted(name for name in given if not self._node.has_parameter(name))
        if unused:
            raise ValueError(
                f'ros_args has the parameters {listed(unused)}, expected remappings and QoS of '
                'topics: give settings as arguments, sim_arm(robot=...)'
            )
        if settings.publish_description:
            self._publishers[DESCRIPTION].publish(encode_string(described.text))

    def __enter__(self) -> NodeLink:
        """Return the link."""
        return self

    def __exit__(self, *error: object) -> None:
        """Destroy the node of the arm, and release the other nodes for another run."""
        self._watch.__exit__()
        for node in self._nodes:
            node.executor = None
        self._events.shutdown()
        self._node.destroy_node()

    def begin(self, period: float | None, patience: float, start_patience: float) -> None:
        """Wait until discovery is complete: all nodes, and the ends of their topics.

        No message is published before, so timers on simulated time all begin at time 0. `period`
        is the longest simulated time between two commands, s, or None; `patience` is the longest
        wall time for a message, and `start_patience` for discovery, s.
        """
        self._period, self._patience = period, patience
        # Without the context, nothing of rclpy waits: clock.sleep_for() hears of no signal.
        self._watch = Watch(patience, get_default_context().try_shutdown)
        self._watch.__enter__()
        here = {self._node.get_fully_qualified_name()}
        if get_rmw_implementation_identifier().startswith(DELIVER_AT_ONCE):
            here |= {node.get_fully_qualified_name() for node in self._nodes}
        begun, seen, since = perf_counter(), None, 0.0
        while True:
            self._spin(Future(), LOOK_SECONDS / 5)
            now = perf_counter()
            self._find_peers(here, now)
            ends, matched = self._ends(), self._matched()
            missing = '; '.join(self._missing(ends, matched))
            if missing or (ends, matched) != seen:
                seen, since = (ends, matched), now
            elif now - since > QUIET_SECONDS:
                break
            self._check_processes()
            if now - begun > start_patience:
                raise NoAnswerError(
                    f'no controller within {start_patience:g} s: {missing or "they change"}'
                    f'{self._outputs()}'
                )
        self._counts, roles = matched, [role for role, _ in ends]
        self._read = [role for role in self._publishers if role in roles]
        self._ticks, self._several = CLOCK in roles, roles.count('commands') > 1
        for peer in self._peers.values():
            peer.pending = []
            peer.threaded = bool(peer.sim_time) and ('events', peer.name) in ends
        if any(peer.threaded for peer in self._peers.values()):
            topic = '/parameter_events'
            self._node.create_subscription(ParameterEvent, topic, self._on_event, COMMAND_DEPTH)
        self._drain()
        self._came.clear()

    def _find_peers(self, here: set[str], now: float) -> None:
        """Make a peer of each node that is not hidden and not run here."""
        pairs = self._node.get_node_names_and_namespaces()
        names = {
            f'{space.rstrip("/")}/{name}' for name, space in pairs if not name.startswith('_')
        }
        for name in sorted(names - here - self._peers.keys()):
            self._peers[name] = _Peer(self._node, name)
        self._peers = {name: self._peers[name] for name in sorted(self._peers.keys() & names)}
        for peer in self._peers.values():
            if peer.sim_time is None:
                peer.greet(now)

    def _ends(self) -> list[tuple[str, str]]:
        """Return role and node of each end of the arm's topics and each reader of events."""
        node = self._node
        read, written = node.get_subscriptions_info_by_topic, node.get_publishers_info_by_topic
        found = [('events', x) for x in read('/parameter_events')]
        for role, end in self._publishers.items():
            found += [(role, x) for x in read(end.topic_name)]
            if role in (STATES, CLOCK):
                found += [('arm', x) for x in written(end.topic_name)]
        for reader in self._commands.values():
            found += [('commands', x) for x in written(reader.topic_name)]
        return sorted((role, node_of(x)) for role, x in found)

    def _matched(self) -> tuple[int, ...]:
        """Return the numbers of ends with which those of the arm are connected."""
        ends = self._publishers.items()
        return (
            *(end.get_subscription_count() for _, end in ends),
            *(end.get_publisher_count() for end in self._commands.values()),
            *(
                self._node.count_publishers(end.topic_name)
                for role, end in ends
                if role in (STATES, CLOCK)
            ),
        )

    def _missing(self, ends: Sequence[tuple[str, str]], matched: Sequence[int]) -> Iterator[str]:
        """Yield what the run still needs."""
        roles = [role for role, _ in ends]
        if roles.count('arm') > 2:
            yield 'another node publishes states or the clock'
        if 'commands' not in roles:
            topics = [end.topic_name for end in self._commands.values()]
            yield f'nobody publishes commands on {" or ".join(topics)}'
        if STATES not in roles and CLOCK not in roles:
            yield f'nobody subscribes to {self._publishers[STATES].topic_name} or /clock'
        if len(self._peers) < len(self._processes):
            yield f'{len(self._peers)} of {len(self._processes)} nodes in other processes'
        for name, peer in self._peers.items():
            if peer.sim_time is None:
                yield f'{name} does not reply on {name}/get_parameters'
            elif peer.sim_time and CLOCK in self._publishers and (CLOCK, name) not in ends:
                yield f'{name} has use_sim_time and does not read /clock'
        if sum(matched) != len(roles) - roles.count('events') or UNKNOWN_NODE in str(ends):
            made = {**self._publishers, **self._commands}
            found = list(_mismatches(self._node, self._topics, made))
            yield from found or ['topics are not connected']

    def _on_command(self, role: str, *taken: Any) -> None:
        data, info = taken[0] if len(taken) == 1 else taken
        self._came.append((role, data, info['source_timestamp']))

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node in self._peers:
            stamp = event.stamp
            self._peers[event.node].stamp_ns = stamp.sec * NANOSECONDS + stamp.nanosec

    def answer(
        self, messages: Sequence[Message], time: float, measured: Array
    ) -> Sequence[Command]:
        """Publish messages one by one, each with what follows from it; return the commands."""
        self._time, stamp_ns, sent = time, self._engine.stamp_ns, dict[str, int]()
        for role, data, _ in messages:
            if role in self._read:
                sent[role] = time_ns()
                self._publishers[role].publish(data)
                self._settle(role, stamp_ns)
        if STATES in sent and not self._ticks:
            self._wait_for_answer()
        now = perf_counter()
        if now - self._looked > LOOK_SECONDS:
            self._looked = now
            if self._matched() != self._counts:
                self._note('a node joined or left the topics of the arm')
            self._check_processes()
        since = (stamp_ns - self._commanded_ns) / NANOSECONDS
        if self._period and since > self._period * (1 + 1e-6):
            last = self._commanded_ns / NANOSECONDS
            raise NoAnswerError(
                f'no command since t = {last:.6g} s, {self._where()}: the nodes have '
                f'finished their callbacks; one is expected every {self._period:g} s'
            )
        if self._came:
            self._commanded_ns = stamp_ns
        return self._commands_of(sent)

    def _commands_of(self, sent: dict[str, int]) -> list[Command]:
        """Return the commands that came after messages were sent, by role at times [ns]."""
        came, self._came = self._came, []
        first = min(sent.values(), default=0)
        for _, _, when in came:
            if when < first:
                self._note(LATE)
        if self._peers:
            self._note_unexplained(came, sent)
        if came:
            when = came[0][2]
            begun = sent.get(CLOCK, when)
            self.seconds = (
                when - (begun if begun < when else sent.get(STATES, when))
            ) / NANOSECONDS
            self._answers += len(came)
        if len(came) > 1:
            # The order between topics is chance: by topic, and in the order of each.
            came.sort(key=lambda command: COMMANDS.index(command[0]))
        return [(role, data) for role, data, _ in came]

    def _note_unexplained(self, came: Sequence[Any], sent: dict[str, int]) -> None:
        """Note commands of peers that no message of the arm explains."""
        for _, _, when in came:
            self._after.add(CLOCK if when >= sent.get(CLOCK, math.inf) else STATES)
        if self._several and len(came) > 1:
            self._note('several nodes commanded at once: their order is chance')
        if len(self._after) == 2 and not self._several:
            self._note(BOTH)

    def _wait_for_answer(self) -> None:
        """Wait for a command to a state; without a clock nothing else can make a node command."""
        deadline = perf_counter() + self._patience
        # The nodes said that they were done: a command that comes now is late.
        late = not self._came
        while not self._came:
            self._wait_for_command()
            self._drain()
            self._check_processes()
            if perf_counter() > deadline:
                names = listed(sorted({name for role, name in self._ends() if role == 'commands'}))
                said = (
                    f'commands stopped after {self._answers} answers'
                    if self._answers
                    else f'{names} never published a command'
                )
                raise NoAnswerError(
                    f'no answer for {self._patience:g} s to the state at t = {self._time:.6g} s: '
                    f'{said}, and the nodes have finished their callbacks{self._outputs()}'
                )
        if late and self._peers:
            self._note(LATE)

    def _wait_for_command(self) -> None:
        """Run callbacks until a command comes, for a short time at most."""
        # Timers on wall time are looked at between.
        until = perf_counter() + (LOOK_SECONDS / 50 if self._timers else LOOK_SECONDS)
        while not self._came and (left := until - perf_counter()) > 0.0:
            self._spin(None, left)

    def _settle(self, role: str, stamp_ns: int) -> None:
        """Return when every node has done all that follows from the last message."""
        if self._nodes:
            self._drain()
        # A chain of nodes needs a barrier for each node elsewhere, and as many again if nodes of
        # this process are between them.
        for _ in range(len(self._peers) * (2 if self._nodes else 1)):
            self._barrier(AFTER_TICK if role == CLOCK else AFTER_STATE, role, stamp_ns)

    def _barrier(self, count: int, role: str, stamp_ns: int) -> None:
        """Wait for replies of all peers, and run the nodes of this process."""
        deadline = perf_counter() + self._patience
        for peer in self._peers.values():
            peer.ask(count, role)
        for peer in self._peers.values():
            while (future := peer.awaited(stamp_ns)) is not None:
                self._spin(future, LOOK_SECONDS)
                if not future.done():
                    self._check_processes()
                if perf_counter() > deadline:
                    why = (
                        'its clock does not follow /clock'
                        if peer.reads
                        else 'it blocks or is gone'
                    )
                    raise NoAnswerError(
                        f'node {peer.name!r} does not finish what follows the {role} message '
                        f'within {self._patience:g} s {self._where()}: {why}{self._outputs()}'
                    )
        if self._nodes:
            self._drain()

    def _drain(self) -> None:
        """Run nodes of this process until nothing is ready, and take the commands."""
        deadline = perf_counter() + self._patience
        while True:
            # The future is never done: with 0 s, this runs callbacks until nothing is ready.
            self._spin(Future(), 0.0)
            timers = [timer for node in self._nodes for timer in node.timers]
            if timers != self._timers:
                self._timers = timers
                self._check_timers()
            due = [timer for timer in timers if timer.is_ready()]
            if not due:
                break
            # In the order in which they were made.
            for timer in due:
                timer.handle.call_timer()
                self._events.create_task(timer.callback)
            if perf_counter() > deadline:
                raise NoAnswerError(f'timers are due without end {self._where()}')

    def _spin(self, future: Future | None, seconds: float) -> None:
        """Run callbacks until a future is done, or one without a future, for so long at most."""
        watch = self._watch
        watch.since = perf_counter()
        try:
            if future is None:
                self._events.spin_once(seconds)
            else:
                self._events.spin_until_future_complete(future, seconds)
            watch.since = 0.0
        except BlockedError:
            pass
        except Exception as error:
            text = one_line(f'{type(error).__name__}: {error}')
            raise ControllerError(f'a node raised {self._where()}: {text}') from error
        if watch.stack:
            raise blocked(watch, self._patience, self._time, self._answers)

    def _check_timers(self) -> None:
        """Note timers of nodes of this process that do not follow the clock of the arm."""
        for node in self._nodes:
            for timer in node.timers:
                period = f'timer of {timer.timer_period_ns / 1e6:g} ms of node {node.get_name()!r}'
                if timer.clock.clock_type != ClockType.ROS_TIME:
                    self._note(f'the {period} runs on wall time (give it the clock of the node)')
                elif not timer.clock.ros_time_is_active:
                    self._note(f'the {period} runs on wall time (set use_sim_time)')
                elif timer.timer_period_ns % self._tick_ns:
                    tick = f'{self._tick_ns / 1e6:g} ms'
                    self._note(
                        f'the {period} is no multiple of the tick of {tick} (set clock_rate)',
                        'uneven',
                    )

    def _note(self, text: str, kind: str = 'not repeatable') -> None:
        """Note it once, with the time at which it was first seen."""
        if text not in self._noted:
            self._noted.add(text)
            self.notes.append(f'{kind}: {text}, at t = {self._time:.6g} s')

    def _where(self) -> str:
        return f'at t = {self._time:.6g} s, after {self._answers} answers'

    def _check_processes(self) -> None:
        """Raise NoAnswerError if a process has ended."""
        for process in self._processes:
            end = process.end()
            if end:
                raise NoAnswerError(f'{process} {end} {self._where()}{process.tail()}')

    def _outputs(self) -> str:
        return ''.join(f'; {process} runs{process.tail()}' for process in self._processes)

    def rejected(self, time: float, verdict: Verdict) -> Exception:
        """Return the error about a command that the arm rejected."""
        ends = self._ends()
        names = listed(sorted({name for role, name in ends if role == 'commands'}))
        return RejectedError(
            f'the arm rejected a command of {names} at t = {time:.6g} s: {verdict.label}: '
            f'{verdict.detail}'
        )

    def check_end(self, seconds: float) -> None:
        """Raise NoAnswerError if there was no command in the whole run, of so many seconds."""
        if not self._answers:
            raise NoAnswerError(
                f'no command in {seconds:g} s, though the nodes have finished their callbacks'
                f'{self._outputs()}'
            )
