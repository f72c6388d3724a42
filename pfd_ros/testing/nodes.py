# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The link to ROS nodes under test, in this process and in others, with timers or without.

Each message of the arm is followed by a barrier: the next one is published only when every node
has finished what follows from it. Nodes of this process are run until nothing is ready. A node
elsewhere, a peer, says so itself: an executor of one thread serves the parameter services of its
node after its subscriptions and timers, so a reply is a barrier. Nothing is installed in a node.
The barrier of a clock with a thread of its own, as in rclcpp, also sets use_sim_time to the value
that it has: a callback of the node for new parameters must accept it.

This rests on a property of the middleware: what one participant sends to another arrives in the
order in which it was sent, over all topics. Fast DDS has it, with one port a participant; DDS does
not promise it. `notes` reports what is seen of nodes that are not repeatable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from inspect import iscoroutinefunction
import math
from time import perf_counter, time_ns
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.clock_type import ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter as NodeParameter
from rclpy.task import Future
from rclpy.utilities import get_default_context, get_rmw_implementation_identifier, ok

from pfd_ros.arm import events
from pfd_ros.arm.description import DescribedRobot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import CLOCK, COMMANDS, DESCRIPTION, INPUTS, STATES, Message, Verdict
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.topics import UNKNOWN_NODE, node_of
from pfd_ros.messages.values import encode_string
from pfd_ros.motion.metrics import Array
from pfd_ros.node.endpoints import chosen_topics, create_endpoints, topic_roles
from pfd_ros.node.parameters import unknown_parameters
from pfd_ros.testing.loop import Command, ControllerError, NoAnswerError, RejectedError
from pfd_ros.testing.patience import BlockedError, Watch
from pfd_ros.testing.process import ControllerProcess, node_named
from pfd_ros.text import listed, one_line

# Commands of two topics at once are taken in this order, for that between topics is chance.
ORDER = tuple(role for role in events.ROLES if role in COMMANDS)
# Requests of a barrier, after a state and after a tick. An executor may take the first one before
# it has seen the message. It serves the second one after the callback of the message, and the
# third one after the timers that the callback of the clock made due. A state and its tick have a
# barrier each: else a callback of the state would read the clock of either, by chance.
REQUESTS = (2, 3)
# The graph has to stay the same for so long before the first state, s, for each process elsewhere:
# whether two of them know each other cannot be seen from here; by loopback.xml each announces
# itself twice in that time. A first request without reply is repeated after AGAIN; a wait is at
# most LOOK long, and the graph is read as often.
QUIET_SECONDS, AGAIN_SECONDS, LOOK_SECONDS = 0.2, 0.5, 0.05
COMMAND_DEPTH = 100
EVENTS = '/parameter_events'
# First bytes of the identifier of an end in DDS: those of its participant.
PARTICIPANT_BYTES = 12
# A run that ends without commands for so many of the longest intervals between them is noted.
SILENT_INTERVALS = 10
THREADS = 'several threads or a timer on wall time'
LATE = f'a command came after its node had said that it was done: it has {THREADS}'
UNREAD = 'its clock does not follow /clock, or it refuses to set use_sim_time again'
BOTH = f'commands follow states as well as ticks: if that is not meant, there are {THREADS}'
# Middlewares in which publish() delivers to readers of the same process before it returns. With
# others, nodes of this process are peers.
DELIVER_AT_ONCE = ('rmw_fastrtps', 'rmw_cyclonedds')


class _Peer:
    """A node that this process does not run, with its parameter services."""

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        # Its use_sim_time, None before the first reply; and whether its clock may have a thread
        # of its own, as the clock of rclcpp has.
        self.sim_time: bool | None = None
        self.threaded = False
        # Its clock when last read, and whether it is being read.
        self.stamp_ns, self.reads = 0, False
        self._asked, self.pending = 0.0, list[Future]()
        self._get = node.create_client(GetParameters, f'{name}/get_parameters')
        self._set = node.create_client(SetParameters, f'{name}/set_parameters')

    def greet(self, now: float) -> None:
        """Ask for use_sim_time until there is a reply; this has no effect on the node."""
        if self.pending and self.pending[0].done():
            values = self.pending[0].result().values
            self.sim_time = bool(values and values[0].bool_value)
        elif now - self._asked > AGAIN_SECONDS and self._get.service_is_ready():
            self._asked = now
            self.pending = [self._get.call_async(GetParameters.Request(names=['use_sim_time']))]

    def ask(self, role: str) -> None:
        """Send the requests of the barrier after a message."""
        self.reads = role == CLOCK and self.threaded
        if self.reads:
            # The event of this change, which changes nothing, is stamped with the node's time.
            value = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
            same = SetParameters.Request(parameters=[Parameter(name='use_sim_time', value=value)])
            self.pending = [self._set.call_async(same)]
        else:
            count, nothing = REQUESTS[role == CLOCK], GetParameters.Request()
            self.pending = [self._get.call_async(nothing) for _ in range(count)]

    def awaited(self, stamp_ns: int) -> Future | None:
        """Return a reply to wait for, None if the barrier is complete; send what else it needs."""
        pending = next((future for future in self.pending if not future.done()), None)
        if pending is None and self.reads and self.stamp_ns == stamp_ns:
            # Taken in a later wait than the change, after the timers that the time made due.
            self.reads, pending = False, self._get.call_async(GetParameters.Request())
            self.pending = [pending]
        elif pending is None and self.reads:
            self.ask(CLOCK)
            pending = self.pending[0]
        return pending


class _WithoutTimers:
    """A node as the executor of the link sees it: without timers, which it runs in no order.

    It does not await subscriptions whose callback is a coroutine; so these become tasks.
    """

    timers = ()

    def __init__(self, node: Node, executor: Any) -> None:
        self._node, self._runs, self.executor = node, executor, None
        self._awaiting: dict[Any, _Awaiting] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)

    @property
    def subscriptions(self) -> list[Any]:
        return [
            self._awaiting.setdefault(one, _Awaiting(one, self._runs))
            if iscoroutinefunction(one.callback)
            else one
            for one in self._node.subscriptions
        ]


class _Awaiting:
    """A subscription whose callback is a coroutine."""

    def __init__(self, subscription: Any, executor: Any) -> None:
        self._subscription, run = subscription, subscription.callback
        self.callback = lambda *message: executor.create_task(run, *message)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._subscription, name)


class _Executor(rclpy_implementation.EventsExecutor):  # type: ignore[misc]
    """The executor of the link.

    rclpy.experimental.EventsExecutor also enables faulthandler, which fails where pytest has
    replaced stderr.
    """

    def add_node(self, node: Node) -> None:
        super().add_node(_WithoutTimers(node, self))

    def remove_node(self, node: Node) -> None:
        """Leave the node in: the executor ends with the link."""


@contextmanager
def node_link(
    described: DescribedRobot,
    engine: Engine,
    ros_args: Sequence[str],
    controllers: Sequence[Any],
    patience: float,
) -> Iterator[NodeLink]:
    """Create the topics of an arm, and let nodes and processes of a test be run in a context.

    `patience` is the longest wall time that the nodes may need for a message, s. RuntimeError,
    TypeError or ControllerError for controllers that cannot be run, ValueError for `ros_args` and
    topics.
    """
    if not ok():
        raise RuntimeError('rclpy is not initialised: let the test take the fixture ros_domain')
    processes = [one for one in controllers if isinstance(one, ControllerProcess)]
    nodes = [one for one in controllers if not isinstance(one, ControllerProcess)]
    for node in nodes:
        if not isinstance(node, Node):
            raise TypeError(
                f'spin got {one_line(repr(node), 100)}, expected nodes of rclpy or processes of '
                'controller_process; run(controller, seconds) takes a function'
            )
        if node.executor is not None and node in node.executor.get_nodes():
            raise ControllerError(f'node {node.get_name()!r} is in an executor already')
    # Without the context, nothing of rclpy waits: clock.sleep_for() hears of no signal.
    watch = Watch(patience, get_default_context().try_shutdown)
    # No services, log topic and event handlers: each makes every wait longer.
    own = node_named(
        ros_args,
        start_parameter_services=False,
        parameter_overrides=[NodeParameter('start_type_description_service', value=False)],
    )
    executor = _Executor(get_default_context())  # nodes have weak references to it
    try:
        link = NodeLink(own, executor, watch, described, engine, nodes, processes)
        for node in (own, *nodes):
            node.executor = executor
        with watch:
            yield link
    finally:
        for node in nodes:
            # For another run.
            node.executor = None
        executor.shutdown()
        own.destroy_node()


class NodeLink:
    """The topics of the arm, and the nodes at their other ends: here, as processes, elsewhere."""

    silent = False

    def __init__(
        self,
        node: Node,
        executor: Any,
        watch: Watch,
        described: DescribedRobot,
        engine: Engine,
        nodes: Sequence[Node],
        processes: Sequence[ControllerProcess],
    ) -> None:
        self._node, self._executor, self._watch, self._engine = node, executor, watch, engine
        self._nodes, self._processes = nodes, processes
        self._period, self._patience = math.inf, watch.patience
        settings = engine.state.settings
        self._tick_ns, self._step_ns = settings.clock_every * settings.step_ns, settings.step_ns
        # Before the clients of peers: discovery keeps the order, so a peer that replies knows all.
        roles = topic_roles(settings).difference(INPUTS) | COMMANDS
        topics = chosen_topics(node, settings, described.topics)
        self._ends = create_endpoints(node, roles, topics, self._on_command, COMMAND_DEPTH)
        for end in self._ends.subscriptions.values():
            # The executor passes the message with its information as one argument.
            end._callback_type = end.CallbackType.WithMessageInfo
        unknown = unknown_parameters(node)
        if unknown:
            raise ValueError(
                f'ros_args has the parameters {listed(unknown)}, expected remappings and QoS of '
                'topics: give settings as arguments, sim_arm(robot=...)'
            )
        if settings.publish_description:
            self._ends.publishers[DESCRIPTION].publish(encode_string(described.text))
        # Nodes elsewhere by name, and their processes as far as the middleware tells them.
        self._peers: dict[str, _Peer] = {}
        self._places = set[Any]()
        self._twins = list[str]()
        self._timers: list[Any] = []
        # Commands that came: role, bytes, time of publication [ns].
        self._came: list[tuple[str, bytes, int]] = []
        self._after: set[str] = set()  # roles of the messages that commands followed
        self._time, self._looked = 0.0, 0.0
        # The stamp of the last state with commands, and the longest interval between such, ns.
        self._commanded_ns, self._interval_ns = engine.stamp_ns, 0
        self._answers, self.seconds = 0, math.nan
        self.notes, self._noted = list[str](), set[str]()

    def begin(self, period: float | None, start_patience: float, restored: bool) -> None:
        """Wait until discovery is complete: all nodes, and the ends of their topics.

        No message is published before, so timers on simulated time all begin at time 0, unless the
        arm was restored. `period` is the longest simulated time between two commands, s, None for
        any; `start_patience` the longest wait, s of wall time.
        """
        self._period = period or math.inf
        here = {self._node.get_fully_qualified_name()}
        if get_rmw_implementation_identifier().startswith(DELIVER_AT_ONCE):
            here |= {node.get_fully_qualified_name() for node in self._nodes}
        begun, seen, since = perf_counter(), None, 0.0
        while True:
            self._spin(Future(), LOOK_SECONDS / 5)
            now = perf_counter()
            self._find_peers(here, now)
            ends, matched = self._others(), self._matched()
            missing = '; '.join(self._missing(ends, matched))
            if missing or (ends, matched) != seen:
                seen, since = (ends, matched), now
            elif now - since > QUIET_SECONDS * max(1, len(self._places)):
                break
            self._check_processes()
            if now - begun > start_patience:
                raise NoAnswerError(
                    f'no controller within {start_patience:g} s: {missing or "they change"}'
                    f'{self._outputs()}'
                )
        self._counts, roles = matched, [role for role, _ in ends]
        self._read = self._ends.publishers.keys() & set(roles)
        self._several = roles.count('commands') > 1
        for peer in self._peers.values():
            peer.pending = []
            peer.threaded = bool(peer.sim_time) and ('events', peer.name) in ends
        if any(peer.threaded for peer in self._peers.values()):
            self._node.create_subscription(ParameterEvent, EVENTS, self._on_event, COMMAND_DEPTH)
        if restored and CLOCK in roles:
            self._note('the arm was restored: timers have another phase than before', 'uneven')
        self._drain()
        self._came.clear()

    def _find_peers(self, here: set[str], now: float) -> None:
        """Make a peer of each node that is not hidden and not run here."""
        pairs = self._node.get_node_names_and_namespaces()
        names = {f'{space.rstrip("/")}/{name}' for name, space in pairs if name[0] != '_'}
        self._peers = {
            name: self._peers.get(name) or _Peer(self._node, name) for name in sorted(names - here)
        }
        for peer in self._peers.values():
            if peer.sim_time is None:
                peer.greet(now)
        # The nodes of a process share the participant of the middleware, or count as several.
        ends = self._node.get_publishers_info_by_topic(EVENTS)
        places = {(node_of(x), bytes(x.endpoint_gid[:PARTICIPANT_BYTES])) for x in ends}
        counts = Counter(name for name, _ in places if name in names)
        self._twins = sorted(name for name, count in counts.items() if count > 1)
        self._places = {place for name, place in places if name in self._peers}
        self._places |= self._peers.keys() - counts.keys()

    def _others(self) -> list[tuple[str, str]]:
        """Return role and node of each end of the arm's topics and each reader of events."""
        node, ends = self._node, self._ends
        found = [('events', x) for x in node.get_subscriptions_info_by_topic(EVENTS)]
        for role, end in ends.publishers.items():
            found += [(role, x) for x in ends.others(role)]
            if role in (STATES, CLOCK):
                own = node.get_publishers_info_by_topic(end.topic_name)
                found += [(f'publisher of {role}', x) for x in own]
        found += [('commands', x) for role in ends.subscriptions for x in ends.others(role)]
        return sorted((role, node_of(x)) for role, x in found)

    def _matched(self) -> tuple[int, ...]:
        """Return the numbers of ends with which those of the arm are connected."""
        publishers, node = self._ends.publishers, self._node
        own = [publishers[role].topic_name for role in (STATES, CLOCK) if role in publishers]
        return (
            *(end.get_subscription_count() for end in publishers.values()),
            *(end.get_publisher_count() for end in self._ends.subscriptions.values()),
            *map(node.count_publishers, own),
        )

    def _missing(self, others: Sequence[tuple[str, str]], matched: Sequence[int]) -> Iterator[str]:
        ends, roles = self._ends, [role for role, _ in others]
        for role in (STATES, CLOCK):
            if roles.count(f'publisher of {role}') > 1:
                yield f'another node publishes {ends.topic(role)}'
        if 'commands' not in roles:
            yield f'nobody publishes commands on {" or ".join(map(ends.topic, ORDER))}'
        if STATES not in roles and CLOCK not in roles:
            yield f'nobody subscribes to {ends.topic(STATES)} or /clock'
        if len(self._places) < len(self._processes):
            yield f'nodes of {len(self._places)} of {len(self._processes)} processes'
        if self._twins:
            yield f'several processes have nodes with the names {self._twins}'
        for name, peer in self._peers.items():
            if peer.sim_time is None:
                yield f'{name} does not reply on {name}/get_parameters'
            elif peer.sim_time and CLOCK in ends.publishers and (CLOCK, name) not in others:
                yield f'{name} has use_sim_time and does not read /clock'
        if sum(matched) != len(roles) - roles.count('events') or UNKNOWN_NODE in str(others):
            found = (ends.misfit(role, info) for role in ends.all for info in ends.others(role))
            yield '; '.join(filter(None, found)) or 'topics are not connected'

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
                self._ends.publishers[role].publish(data)
                self._settle(role, stamp_ns)
        if STATES in sent and CLOCK not in self._read and not self._came:
            self._wait_for_answer()
        now = perf_counter()
        if now - self._looked > LOOK_SECONDS:
            self._looked = now
            if self._matched() != self._counts:
                self._note('a node joined or left the topics of the arm')
            self._check_processes()
        came, self._came = self._came, []
        since_ns = stamp_ns - self._commanded_ns
        if came:
            self._commanded_ns = stamp_ns
            self._interval_ns = max(self._interval_ns, since_ns)
            self._judge(came, sent)
        if self._answers and since_ns > self._period * (1 + 1e-6) * NANOSECONDS:
            last = (stamp_ns - since_ns) / NANOSECONDS
            raise NoAnswerError(
                f'no command since t = {last:.6g} s, {self._where()}: the nodes have '
                f'finished their callbacks; one is expected every {self._period:g} s'
            )
        self._answers += len(came)
        return [(role, data) for role, data, _ in came]

    def _judge(self, came: list[tuple[str, bytes, int]], sent: dict[str, int]) -> None:
        """Order commands that came after messages were sent, by role at times [ns].

        Measure their computation, and note commands that these messages do not explain.
        """
        if len(came) >= COMMAND_DEPTH:
            self._note(f'{COMMAND_DEPTH} commands or more at once: the oldest may be lost', 'lost')
        ticked = sent.get(CLOCK, math.inf)
        for _, _, when in came:
            if when < min(sent.values(), default=0):
                self._note(LATE)
            self._after.add(CLOCK if when >= ticked else STATES)
        first = came[0][2]
        self.seconds = (first - (ticked if ticked < first else sent.get(STATES, first))) * 1e-9
        if self._peers and self._several and len(came) > 1:
            self._note('several nodes commanded at once: their order is chance')
        if self._peers and len(self._after) == 2 and not self._several:
            self._note(BOTH)
        # The order between topics is chance: by topic, and in the order of each.
        came.sort(key=lambda command: ORDER.index(command[0]))

    def _wait_for_answer(self) -> None:
        """Wait for a command to a state; without a clock nothing else can make a node command."""
        deadline = perf_counter() + self._patience
        # Timers on wall time are looked at between.
        look = LOOK_SECONDS / 50 if self._timers else LOOK_SECONDS
        while not self._came:
            self._spin(None, look)
            self._drain()
            self._check_processes()
            if perf_counter() > deadline:
                said = f'commands stopped after {self._answers} answers'
                if not self._answers:
                    said = f'{self._commanders()} never published a command'
                raise NoAnswerError(
                    f'no answer for {self._patience:g} s to the state at t = {self._time:.6g} s: '
                    f'{said}, and the nodes have finished their callbacks{self._outputs()}'
                )
        if self._peers:
            # They said that they were done.
            self._note(LATE)

    def _settle(self, role: str, stamp_ns: int) -> None:
        """Return when every node has done all that follows from the last message."""
        if self._nodes:
            self._drain()
        # A chain of nodes needs a barrier for each node elsewhere, and as many again if nodes of
        # this process are between them.
        for _ in range(len(self._peers) * (2 if self._nodes else 1)):
            deadline = perf_counter() + self._patience
            for peer in self._peers.values():
                peer.ask(role)
            for peer in self._peers.values():
                self._await(peer, role, stamp_ns, deadline)
            if self._nodes:
                self._drain()

    def _await(self, peer: _Peer, role: str, stamp_ns: int, deadline: float) -> None:
        while (future := peer.awaited(stamp_ns)) is not None:
            self._spin(future, LOOK_SECONDS)
            if not future.done():
                self._check_processes()
            if perf_counter() > deadline:
                raise NoAnswerError(
                    f'node {peer.name!r} does not finish what follows the {role} message '
                    f'within {self._patience:g} s {self._where()}: '
                    f'{UNREAD if peer.reads else "it blocks or is gone"}{self._outputs()}'
                )

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
                self._executor.create_task(timer.callback)
            if perf_counter() > deadline:
                raise NoAnswerError(f'timers are due without end {self._where()}')

    def _spin(self, future: Future | None, seconds: float) -> None:
        """Run callbacks until a future is done, or one without a future, for so long at most."""
        watch = self._watch
        watch.since = perf_counter()
        try:
            if future is None:
                self._executor.spin_once(seconds)
            else:
                self._executor.spin_until_future_complete(future, seconds)
            watch.since = 0.0
        except BlockedError:
            pass
        except Exception as error:
            text = one_line(f'{type(error).__name__}: {error}')
            raise ControllerError(f'a node raised {self._where()}: {text}') from error
        if watch.stack:
            raise ControllerError(watch.report(self._time, self._answers))

    def _check_timers(self) -> None:
        """Note timers of nodes of this process that do not follow the clock of the arm."""
        for node, timer in [(one, timer) for one in self._nodes for timer in one.timers]:
            name = f'the timer of {timer.timer_period_ns / 1e6:g} ms of node {node.get_name()!r}'
            if timer.clock.clock_type != ClockType.ROS_TIME:
                self._note(f'{name} runs on wall time (give it the clock of the node)')
            elif not timer.clock.ros_time_is_active:
                self._note(f'{name} runs on wall time (set use_sim_time)')
            elif timer.timer_period_ns % self._tick_ns:
                remedy = 'step_size' if timer.timer_period_ns % self._step_ns else 'clock_rate'
                tick = f'the tick of {self._tick_ns / 1e6:g} ms (set {remedy})'
                self._note(f'{name} is no multiple of {tick}', 'uneven')

    def _note(self, text: str, kind: str = 'not repeatable') -> None:
        """Note it once, with the time at which it was first seen."""
        if text not in self._noted:
            self._noted.add(text)
            self.notes.append(f'{kind}: {text}, at t = {self._time:.6g} s')

    def _where(self) -> str:
        return f'at t = {self._time:.6g} s, after {self._answers} answers'

    def _commanders(self) -> str:
        return listed(sorted({name for role, name in self._others() if role == 'commands'}))

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
        return RejectedError(
            f'the arm rejected a command of {self._commanders()} at t = {time:.6g} s: '
            f'{verdict.label}: {verdict.detail}'
        )

    def check_end(self, seconds: float) -> None:
        """Raise NoAnswerError if no command came in so many seconds; note a long silence."""
        if not self._answers:
            raise NoAnswerError(
                f'no command in {seconds:g} s, though the nodes have finished their callbacks'
                f'{self._outputs()}'
            )
        if self._engine.stamp_ns - self._commanded_ns > SILENT_INTERVALS * self._interval_ns:
            last = self._commanded_ns / NANOSECONDS
            self._note(f'no command since t = {last:.6g} s', 'silent')
